"""Figures of an identification: efforts over time with signs, residuals, coefficients, and the proof."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.identification import Identification
from bayesid.report.plot import figure as fig
from bayesid.report.plot.drawing import chosen_joints, draw
from bayesid.report.report_data import VARIABLES, ReportData, read_report_data, report_data
from bayesid.report.tuning import TUNING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Source = Identification | ReportData | str | Path
"""An identification, its findings, or its result folder."""


def findings_of(result: Source) -> ReportData:
    """The data of the figures.

    Raises:
        InputError: a folder holds no result.
    """
    if isinstance(result, ReportData):
        return result
    return report_data(result) if isinstance(result, Identification) else read_report_data(result)


def _joint_by_joint(
    findings: ReportData,
    panel: Callable[[ReportData, int], fig.Panel],
    joints: Sequence[int] | None,
    axes: Any,
    **look: Any,
) -> list[Axes]:
    panels = [panel(findings, joint) for joint in chosen_joints(findings.n_joints, joints)]
    return draw(fig.Figure(fig.rows_of(panels, 1), look.pop("height", 2.1) * len(panels), **look), axes)


# ---------------------------------------------------------------------------------------------------------------
# Efforts over time
# ---------------------------------------------------------------------------------------------------------------
def torques(result: Source, joints: Sequence[int] | None = None, axes: Any = None, key: bool = True) -> list[Axes]:
    """Efforts over time: recorded, with signs, and of the model; bands show the sign of each segment.

    Blue bands are plus and orange ones minus; paler ones are less certain. Hatched bands with a question mark are
    ambiguous. This is the figure of Gaz and De Luca's paper, with confidences.

    Example:
        >>> first, second = bayesid.plot.torques(result, joints=[1, 3])
        >>> first.figure.savefig("torques.png")
    """
    return _joint_by_joint(findings_of(result), torque_panel, joints, axes, height=2.6, width=fig.WIDE, key=key)


def torque_panel(findings: ReportData, joint: int, most: int = TUNING.curve) -> fig.Panel:
    """Panel of `torques` for a joint (from 1); curves have about `most` points."""
    samples, j = findings.samples, joint - 1
    hidden = joint not in findings.summary.signed_joints
    curves = [
        fig.Line(samples.t, samples.recorded[:, j], fig.INK, "recorded, without sign", 1.1, 0.9, "dotted"),
        fig.Line(samples.t, samples.signed[:, j], fig.INK, "with signs" if hidden else "recorded", 2.0, 0.9),
        fig.Line(samples.t, samples.predicted[:, j], fig.MAGENTA, "model", 0.7),
    ]
    lines = fig.thinned(curves if hidden else curves[1:], most)
    return _over_time(findings, joint, samples.t, [*_signs(findings, j), *lines])


def validation(result: Source, joints: Sequence[int] | None = None, axes: Any = None, key: bool = True) -> list[Axes]:
    """Efforts of another log: measured, predicted, and the 95 % band."""
    findings = findings_of(result)
    if findings.prediction is None:
        raise ValueError("nothing was validated: use `report_data.with_validation(result.validate(log))`")
    return _joint_by_joint(findings, validation_panel, joints, axes, height=2.6, width=fig.WIDE, key=key)


def validation_panel(findings: ReportData, joint: int, most: int = TUNING.curve) -> fig.Panel:
    """Panel of `validation` for a joint (from 1); curves have about `most` points."""
    prediction, j = findings.prediction, joint - 1
    assert prediction is not None
    t = prediction.t
    curves = (
        fig.Band(t, prediction.lower[:, j], prediction.upper[:, j], fig.BLUE, "95 % band"),
        fig.Line(t, prediction.measured[:, j], fig.INK, "measured", 1.6, 0.9),
        fig.Line(t, prediction.predicted[:, j], fig.MAGENTA, "predicted", 1.0),
    )
    marks = fig.thinned(curves, most)
    return _over_time(findings, joint, prediction.t, marks)


def _over_time(findings: ReportData, joint: int, t: Array, marks: Sequence[fig.Mark]) -> fig.Panel:
    y_name = f"joint {joint}: effort, {findings.effort_unit[joint - 1]}"
    return fig.Panel(marks, "time, s", y_name, x_limits=(float(t[0]), float(t[-1])))


def _signs(findings: ReportData, j: int) -> list[fig.Boxes]:
    """A box behind the curves for each segment, with its sign above."""
    table = findings.segments
    boxes = []
    for sign, colour, name in ((1, fig.BLUE, "+"), (-1, fig.ORANGE, "\N{MINUS SIGN}")):
        here = np.flatnonzero((table.joint == j) & (table.sign == sign))
        alpha = 0.05 + 0.29 * (2.0 * table.confidence[here] - 1.0)  # a guess is nearly white, certainty hides no curve
        letters = [f"{name}?" if table.ambiguous[k] else name for k in here]
        details = [f"{table.confidence[k]:.2f}" for k in here]
        ends = table.start[here], table.end[here]
        if len(here):
            boxes.append(fig.Boxes(ends, None, colour, f"sign {name}", alpha, letters=letters, details=details))
    doubtful = (table.joint == j) & table.ambiguous
    if doubtful.any():
        boxes.append(fig.Boxes((table.start[doubtful], table.end[doubtful]), None, fig.INK, "ambiguous", hatched=True))
    return boxes


# ---------------------------------------------------------------------------------------------------------------
# Residuals
# ---------------------------------------------------------------------------------------------------------------
def residuals(result: Source, variable: str = "t", joints: Sequence[int] | None = None, axes: Any = None) -> list[Axes]:
    """Residuals in motion over a variable, with their means over equally many samples and twice the standard errors.

    Standard errors assume independent samples. Where the means differ from zero, an effect is missing.

    Example:
        >>> (ax,) = bayesid.plot.residuals(result, "velocity", joints=[2])
        >>> ax.get_ylabel()
        'residual 2, N m'
    """
    if variable not in VARIABLES:
        raise ValueError(f"{variable!r} is not one of {', '.join(VARIABLES)}")
    return _joint_by_joint(findings_of(result), partial(residual_panel, variable=variable), joints, axes)


def residual_panel(findings: ReportData, joint: int, variable: str, most: int = TUNING.scatter) -> fig.Panel:
    """Panel of `residuals` for a joint (from 1), with at most `most` dots."""
    centre, mean, error = findings.trend(joint - 1, variable)
    position = findings.position_unit[joint - 1]
    x_name = {"t": "time, s", "velocity": f"velocity, {position}/s", "position": f"position, {position}"}[variable]
    marks = (
        fig.Dots(*findings.scatter(joint - 1, variable, most), fig.BLUE, size=2.0, alpha=0.4),
        fig.level(0.0),
        *fig.means(centre, mean, 2.0 * error, fig.ORANGE),
    )
    return fig.Panel(marks, x_name, f"residual {joint}, {findings.effort_unit[joint - 1]}")


def autocorrelation(result: Source, joints: Sequence[int] | None = None, axes: Any = None) -> list[Axes]:
    """Autocorrelation of the residuals in motion; 95 % of white noise's values lie in the grey band."""
    return _joint_by_joint(findings_of(result), autocorrelation_panel, joints, axes)


def autocorrelation_panel(findings: ReportData, joint: int) -> fig.Panel:
    """Panel of `autocorrelation` for a joint (from 1)."""
    table = findings.correlation
    bound = float(table.bound[joint - 1])
    marks = (
        fig.Boxes(None, ([-bound], [bound]), fig.INK, "white noise", 0.25),
        fig.level(0.0),
        fig.Line(table.lag, table.value[joint - 1], fig.BLUE, "autocorrelation"),
    )
    return fig.Panel(marks, "lag, s", f"autocorrelation {joint}")


# ---------------------------------------------------------------------------------------------------------------
# Coefficients and proof
# ---------------------------------------------------------------------------------------------------------------
def coefficients(result: Source, ax: Axes | None = None) -> Axes:
    """Mean, 95 % interval and nominal value of every coefficient, over its size.

    Orange ones are decided by the prior, not by the data. The size of a coefficient is that of its mean, or of half its
    interval where that is larger.
    """
    table = findings_of(result).coefficients
    place, beyond = np.arange(len(table.mean)), 2.5  # sizes: longer intervals are cut off
    mean, low, high, nominal = (values.clip(-beyond, beyond) for values in table.bar)
    marks: list[fig.Mark] = []
    for colour, name, chosen in (
        (fig.BLUE, "decided by data", table.by_data),
        (fig.ORANGE, "by the prior", ~table.by_data),
    ):
        if chosen.any():
            row, ends = place[chosen], (np.minimum(mean, 0.0)[chosen], np.maximum(mean, 0.0)[chosen])
            marks.append(fig.Boxes(ends, (row - 0.3, row + 0.3), colour, name, 0.35))
            marks.append(fig.Strokes((low[chosen], high[chosen]), (row, row), colour, width=2.0))
    if (known := np.isfinite(nominal)).any():
        row, value = place[known], nominal[known]
        marks.append(fig.Strokes((value, value), (row - 0.4, row + 0.4), fig.INK, "nominal", 1.6))
    marks.append(fig.upright(0.0))
    return draw(fig.listing(marks, table.name, "value over its size", 1.0 + 0.19 * len(place)), ax)[0]


def alternatives(result: Source, ax: Axes | None = None) -> Axes:
    """Costs above that of the best assignment: alternatives that the proof does not exclude, and its limit.

    An assignment with a cost that is larger by x is exp(-x / 2) times as probable, up to the volume of its cone.
    """
    return draw(alternatives_figure(findings_of(result)), ax)[0]


def alternatives_figure(findings: ReportData) -> fig.Figure:
    """Of `alternatives`."""
    search = findings.summary.search
    if search.lower_bound is None or search.cost is None:
        raise ValueError("nothing is proven about the signs")
    above = (findings.alternatives.cost - search.cost)[: TUNING.bars]
    count = max(1, len(above))
    marks: list[fig.Mark] = []
    if search.certified:
        within = search.optimality_gap or 0.0
        marks.append(
            fig.Boxes(
                ([within], [max(1.6 * within, 1.0)]),
                None,
                fig.INK,
                f"all others: over {np.exp(0.5 * within):.0f} times less likely",
                0.18,
            )
        )
        marks.append(fig.upright(within, width=1.2, style="dashed"))
    else:
        open_costs = [search.lower_bound - search.cost], [0.0]
        marks.append(fig.Boxes(open_costs, None, fig.MAGENTA, "not ruled out", 0.25))
    if len(above) > 1:
        marks.append(fig.Dots(above[1:], np.arange(1, count), fig.ORANGE, "alternative", 7.0))
    marks.append(fig.Dots([0.0], [0.0], fig.BLUE, "best found", 8.0))
    return fig.listing(marks, (), "cost above that of the best assignment", 1.1 + 0.22 * count, rows=count)
