"""The public `design_excitation`: for a robot without a result, or after a result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from bayesid.arrays import seed_of
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects import STANDARD, Term
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.design import ExcitationDesign, design_for_robot
from bayesid.excitation.hypotheses import Hypotheses
from bayesid.excitation.next_motion import NextExperiment, design_next
from bayesid.excitation.settings import MotionSettings
from bayesid.identification.identification import Identification
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.motion import Motion
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot


@overload
def design_excitation(
    subject: Robot | Model | str | Path,
    terms: Iterable[str | Term] | None = None,
    *,
    settings: MotionSettings = MotionSettings(),
    prior: ParameterPrior = ParameterPrior(),
    rng: np.random.Generator | int | None = 0,
    progress: Progress | Show = SILENT,
) -> ExcitationDesign: ...


@overload
def design_excitation(
    subject: Identification | IdentifiedModel | Discrepancy,
    *,
    about: Sequence[str] = (),
    between: Sequence[str] | Hypotheses = (),
    settings: MotionSettings = MotionSettings(),
    recorded: Motion | None = None,
    criterion: str = "D",
    progress: Progress | Show = SILENT,
) -> NextExperiment: ...


def design_excitation(  # noqa: PLR0913  options of either form
    subject: Robot | Model | str | Path | Identification | IdentifiedModel | Discrepancy,
    terms: Iterable[str | Term] | None = None,
    *,
    about: Sequence[str] = (),
    between: Sequence[str] | Hypotheses = (),
    settings: MotionSettings = MotionSettings(),
    prior: ParameterPrior = ParameterPrior(),
    recorded: Motion | None = None,
    criterion: str = "D",
    rng: np.random.Generator | int | None = 0,
    progress: Progress | Show = SILENT,
) -> ExcitationDesign | NextExperiment:
    """Designs a motion from rest to rest that determines a robot's coefficients, or those a result leaves undetermined.

    Args:
        subject: a robot, its name or file, or a model with its own terms. Or a result: an identification, an identified
            model with its uncertainty, or a discrepancy. By default a discrepancy's equivalent effects are
            distinguished.
        terms: for a robot: effects to be identified, names of the catalogue or terms of your own.
        about: after a result: names of coefficients, parameters or effects, or `gains`, `payload`, `signs`; by default
            all coefficients that are not known to 10 %.
        between: after a result: hypotheses to distinguish instead, as in ("stribeck_friction:3", "thermal_drift:3"), or
            classes of them.
        settings: duration, rate, limits and search time; after a result also start and collision model.
        prior: for a robot: parameters known beforehand (CAD); the others are drawn.
        recorded: motion of the result's log, if the result is a model alone. Without it, hypotheses are as uncertain as
            before that log.
        criterion: after a result: "D" minimises the log determinant of the covariance, "A" the mean variance.
        rng: for a robot: of the random starts and plausible robots; a generator, a seed, or None for a random seed.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Returns:
        A `bayesid.types.ExcitationDesign` for a robot, a `bayesid.types.NextExperiment` after a result.

    Raises:
        InputError: the subject, a name, a number or a limit cannot be used, an option belongs to the other form, or the
            start pose violates a limit.

    Example:
        >>> settings = bayesid.MotionSettings(duration=4.0, changes=40)
        >>> bayesid.design_excitation(robot, terms, settings=settings).motion.q.shape
        (401, 3)
        >>> design = bayesid.design_excitation(result, about=["Fc2"], settings=settings)
        >>> friction = design.predicted.names.index("Fc2")
        >>> bool(design.predicted.sd[friction] < design.predicted.sd_now[friction])
        True
    """
    if isinstance(subject, Robot | Model | str | Path):
        for name, given in (("about", about), ("between", between), ("recorded", recorded)):
            if given not in ((), None):
                raise InputError("needs a result", field=name, remedy="give a result first: bayesid.load(folder)")
        chosen = STANDARD if terms is None else terms
        return design_for_robot(subject, chosen, settings=settings, prior=prior, seed=seed_of(rng), progress=progress)
    if terms is not None:
        raise InputError(
            "cannot be given with a result, which has its own", field="terms", remedy="leave them out, or give `about`"
        )
    return design_next(
        subject, about, between, settings=settings, recorded=recorded, criterion=criterion, progress=progress
    )
