"""The public `find_discrepancy`: compares a log with a result, or several logs of one robot."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import overload

from bayesid.discrepancy.comparison import ChangeReport, compare_logs
from bayesid.discrepancy.workflow import Discrepancy, explain_log
from bayesid.effects import STANDARD, Term
from bayesid.errors import InputError
from bayesid.identification.identification import Identification
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.options import Preprocessing
from bayesid.identification.pipeline import QUICK
from bayesid.log.reading import LogSource
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.selection.fitted_effects import Thresholds
from bayesid.regression.stated import ConstraintFunction
from bayesid.robot import Robot
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search


@overload
def find_discrepancy(
    earlier: Identification | IdentifiedModel,
    log: LogSource,
    holdout: LogSource | None = None,
    *,
    search: Search | None = None,
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    thresholds: Thresholds = Thresholds(),
    progress: Progress | Show = SILENT,
) -> Discrepancy: ...


@overload
def find_discrepancy(
    earlier: Robot | str | Path,
    log: Sequence[LogSource],
    holdout: LogSource | None = None,
    *,
    terms: Iterable[str | Term] | None = None,
    constraints: ConstraintFunction | str | Path | None = None,
    search: Search | None = None,
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    progress: Progress | Show = SILENT,
) -> ChangeReport: ...


def find_discrepancy(  # noqa: PLR0913  options of either form
    earlier: Identification | IdentifiedModel | Robot | str | Path,
    log: LogSource | Sequence[LogSource],
    holdout: LogSource | None = None,
    *,
    terms: Iterable[str | Term] | None = None,
    constraints: ConstraintFunction | str | Path | None = None,
    search: Search | None = None,
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    thresholds: Thresholds = Thresholds(),
    progress: Progress | Show = SILENT,
) -> Discrepancy | ChangeReport:
    """Finds what a model lacks to explain a log, or what changed over several logs of one robot.

    Args:
        earlier: an identification of the robot, or a stored one. Or the robot, its name or file: then the first log
            gives the model.
        log: a log of the same robot, or anything that `bayesid.read_log` reads. With a robot a list of two or more, the
            earliest first.
        holdout: another log for cross-validation, of the robot in its last state; by default blocks of the log are
            held back.
        terms: terms of the model, with a robot: names of the catalogue, or your own terms.
        constraints: constraints of the model, with a robot, as for `identify`; those on the last link do not count in
            logs with a payload.
        search: sign search; by default a short one, and that of `identify` for the first of several logs.
        posterior: sampling of the extended model's posterior, or whether to sample.
        preprocessing: filtering and segmentation.
        thresholds: thresholds of the selection of effects, with a result.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Returns:
        A `Discrepancy` of one log, a `bayesid.types.ChangeReport` of several.

    Raises:
        InputError: a log is of another robot, too short, without motion, given twice, or the model was identified from
            it; or an option does not fit this form.
        SolverError: an optimisation failed.

    Example:
        >>> found = bayesid.find_discrepancy(result, "another_log.csv", posterior=False)
        >>> found.status, (found.after / found.floor.rms).round(1)
        ('no_discrepancy', array([1.1, 0.9, 0.8]))
        >>> both = bayesid.find_discrepancy(robot, [log, other_log], terms=terms, posterior=False)
        >>> both.dates.texts, len(both.found)
        (('1', '2'), 1)
    """
    if isinstance(earlier, Identification | IdentifiedModel):
        for name, value in (("terms", terms), ("constraints", constraints)):
            if value is not None:
                raise InputError("cannot be given with a result, which has its own", field=name, remedy="leave it out")
        return explain_log(
            earlier,
            log,  # type: ignore[arg-type]  # a list is joined
            holdout,
            search=QUICK if search is None else search,
            posterior=posterior,
            preprocessing=preprocessing,
            progress=progress,
            thresholds=thresholds,
        )
    if not isinstance(earlier, Robot) and os.path.isdir(earlier):
        raise InputError("is a folder", str(earlier), f"give the result in it: bayesid.load({str(earlier)!r})")
    if thresholds != Thresholds():
        raise InputError("can be given with a result and one log only", field="thresholds", remedy="leave it out")
    if not isinstance(log, list | tuple):
        remedy = "give a list of two or more, or one log and a result: bayesid.find_discrepancy(result, log)"
        raise InputError("one log and a robot cannot be compared", field="log", remedy=remedy)
    return compare_logs(
        earlier,
        log,
        STANDARD if terms is None else terms,
        holdout,
        constraints=constraints,
        search=Certified() if search is None else search,
        posterior=posterior,
        preprocessing=preprocessing,
        progress=progress,
    )
