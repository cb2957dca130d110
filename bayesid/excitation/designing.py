"""The public `design_excitation`: for a robot without a result, or after one."""

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
    """Designs a motion from rest to rest: one that shows a robot's coefficients, or what a result leaves open.

    Args:
        subject: a robot, its name or file, or a model, which has its own terms. Or a result: an identification, an
            identified model with its uncertainty, or a discrepancy, whose effects that its log cannot tell apart are
            then told apart by default.
        terms: of a robot: names of the catalogue, or terms of your own; what is to be identified.
        about: after a result: names of coefficients, parameters or effects, or `gains`, `payload`, `signs`; without any
            all coefficients that are not known to 10 %.
        between: after a result: hypotheses to tell apart instead, as in ("stribeck_friction:3", "thermal_drift:3"), or
            classes of them.
        settings: duration, rate, limits and changes to try; after a result also the start and what tells collisions.
        prior: of a robot: parameters that are known beforehand (CAD); others are drawn.
        recorded: the motion of the result's log, where the result is a model alone: without it hypotheses are taken to
            be as open as before that log.
        criterion: after a result: "D" for the information about all together, "A" for their mean variance.
        rng: of a robot: of the random starts and of the expected robots; a generator, a seed, or None for others each
            time.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Returns:
        A `bayesid.types.ExcitationDesign` of a robot, a `bayesid.types.NextExperiment` after a result.

    Raises:
        InputError: the subject, a name, a number or a limit cannot be used, an option is not of this form, or the robot
            cannot even stand still at the start.

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
                raise InputError("is of a result", field=name, remedy="give a result first: bayesid.load(folder)")
        chosen = STANDARD if terms is None else terms
        return design_for_robot(subject, chosen, settings=settings, prior=prior, seed=seed_of(rng), progress=progress)
    if terms is not None:
        raise InputError(
            "cannot be given with a result, which has its own", field="terms", remedy="leave them out, or say `about`"
        )
    return design_next(
        subject, about, between, settings=settings, recorded=recorded, criterion=criterion, progress=progress
    )
