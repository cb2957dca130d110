"""Efforts over time: recorded, signed and modelled, with the segments' signs; and those of a new log, with bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.report.findings import Findings
from bayesid.report.plot.ink import BLUE, INK, MAGENTA, ORANGE, SIZE
from bayesid.report.plot.source import Source, findings_of
from bayesid.report.plot.style import dress, each_joint, legend, root_figure
from bayesid.report.thinning import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDE = 10.0
"""in, of a figure over time: as wide as a page."""
_HEIGHT = 2.6
"""in, of a joint in it: three joints stand on a screen."""
_DENSITY = 300
"""Points of a curve, at most about, an inch of the figure; some four a pixel."""
_FAINTEST = 0.05
"""Opacity of a band whose sign is a guess: hardly to be seen."""
_STRONGEST = 0.34
"""Opacity of a band whose sign is certain: curves in front of it keep their colours; as in style.css."""
_NARROW = 0.13
"""in; a band that is less wide has no room for its sign."""


def torques(
    result: Source, joints: Sequence[int] | None = None, axes: Sequence[Axes] | Axes | None = None, key: bool = True
) -> list[Axes]:
    """Efforts over time: recorded, with signs, and by the model; bands tell the sign of each segment.

    Blue bands are plus and orange ones minus, the paler the less sure; hatched ones are ambiguous and bear a question
    mark. This is the figure of Gaz and De Luca's paper, with confidences.

    Args:
        result: an identification, its findings, or a result folder.
        joints: from 1; all by default.
        axes: one for each joint, or the one of a single joint; new ones by default, whose `figure` can be saved.
        key: whether to say what colours and lines mean.

    Returns:
        One Axes for each joint.

    Raises:
        InputError: the folder holds no result.
        ValueError: there is no such joint, or not one Axes for each.

    Example:
        >>> first, second = bayesid.plot.torques(result, joints=[1, 3])
        >>> first.figure.savefig("torques.png")
    """
    findings = findings_of(result)
    drawn = each_joint(findings.n_joints, joints, axes, _HEIGHT, WIDE)
    for joint, ax in drawn:
        _bands(ax, findings, joint - 1)
        _curves(ax, findings, joint - 1)
        ax.set_xlim(float(findings.samples.t[0]), float(findings.samples.t[-1]))
        ax.set_xlabel("time, s", fontsize=SIZE, color=INK)
        ax.set_ylabel(f"joint {joint}: effort, {findings.effort_unit[joint - 1]}", fontsize=SIZE, color=INK)
        dress(ax)
    if key:
        legend(drawn[0][1])
    return [ax for _, ax in drawn]


def validation(
    result: Source, joints: Sequence[int] | None = None, axes: Sequence[Axes] | Axes | None = None, key: bool = True
) -> list[Axes]:
    """Efforts of a log that the model has not seen: measured, predicted, and the band that holds 95 % of them.

    Args:
        result: findings with a validation (`Findings.with_validation`).
        joints: from 1; all by default.
        axes: one for each joint, or the one of a single joint; new ones by default.
        key: whether to say what colours and lines mean.

    Returns:
        One Axes for each joint.

    Raises:
        ValueError: there is no validation, no such joint, or not one Axes for each.

    Example:
        >>> (ax,) = bayesid.plot.validation(findings.with_validation(check), joints=[2])
        >>> ax.figure.savefig("validation.svg")
    """
    findings = findings_of(result)
    if findings.prediction is None:
        raise ValueError("nothing was validated: use Findings.with_validation(result.validate(log))")
    prediction = findings.prediction
    drawn = each_joint(findings.n_joints, joints, axes, _HEIGHT, WIDE)
    for joint, ax in drawn:
        j = joint - 1
        most = round(_DENSITY * _width(ax))
        rows = np.union1d(envelope(prediction.upper[:, j], most // 2), envelope(prediction.lower[:, j], most // 2))
        look: dict[str, Any] = {"color": BLUE, "alpha": 0.25, "linewidth": 0.0}
        band = ax.fill_between(
            prediction.t[rows], prediction.lower[rows, j], prediction.upper[rows, j], label="95 % band", **look
        )
        band.set_gid("x-band")
        _curve(ax, prediction.t, prediction.measured[:, j], "measured", INK, 1.6, 0.9)
        _curve(ax, prediction.t, prediction.predicted[:, j], "predicted", MAGENTA, 1.0)
        ax.set_xlim(float(prediction.t[0]), float(prediction.t[-1]))
        ax.set_xlabel("time, s", fontsize=SIZE, color=INK)
        ax.set_ylabel(f"joint {joint}: effort, {findings.effort_unit[j]}", fontsize=SIZE, color=INK)
        dress(ax)
    if key:
        legend(drawn[0][1])
    return [ax for _, ax in drawn]


def _curves(ax: Axes, findings: Findings, j: int) -> None:
    samples = findings.samples
    hidden = j + 1 not in findings.summary.signed_joints
    if hidden:
        _curve(ax, samples.t, samples.recorded[:, j], "recorded, without sign", INK, 1.1, 0.9, "dotted")
    _curve(ax, samples.t, samples.signed[:, j], "with signs" if hidden else "recorded", INK, 1.6, 0.9)
    _curve(ax, samples.t, samples.predicted[:, j], "model", MAGENTA, 1.0)


def _curve(
    ax: Axes, t: Array, values: Array, name: str, colour: str, width: float, alpha: float = 1.0, style: str = "solid"
) -> None:
    rows = envelope(values, round(_DENSITY * _width(ax)))
    look: dict[str, Any] = {"color": colour, "linewidth": width, "alpha": alpha, "linestyle": style}
    (line,) = ax.plot(t[rows], values[rows], label=name, **look)
    line.set_gid(f"x-{name.partition(' ')[0].strip(',')}-{name.count(' ')}")


def _width(ax: Axes) -> float:
    """Of the figure, in."""
    figure = root_figure(ax)
    return WIDE if figure is None else float(figure.get_figwidth())


def _bands(ax: Axes, findings: Findings, j: int) -> None:
    """Behind the curves: a band a segment; above them its sign, where there is room."""
    table = findings.segments
    room = _NARROW / (ax.get_position().width * _width(ax)) * float(findings.samples.t[-1] - findings.samples.t[0])
    for sign, colour, name in ((1, BLUE, "+"), (-1, ORANGE, "\N{MINUS SIGN}")):
        here = np.flatnonzero((table.joint == j) & (table.sign == sign))
        shades = [(colour, _opacity(float(table.confidence[k]))) for k in here]
        _broken(ax, findings, here.tolist(), f"x-{'plus' if sign > 0 else 'minus'}", facecolors=shades)
        ax.fill_between([], [], [], color=colour, alpha=_STRONGEST, linewidth=0.0, label=f"sign {name}")
        for k in here:
            if table.end[k] - table.start[k] > room:
                middle = 0.5 * (table.start[k] + table.end[k])
                glyph = f"{name}?" if table.ambiguous[k] else name
                look: dict[str, Any] = {"ha": "center", "va": "bottom", "color": INK, "fontsize": SIZE - 1.0}
                letter = ax.annotate(
                    glyph,
                    (middle, 0.999),
                    (0.0, 3.0),
                    ax.get_xaxis_transform(),
                    "offset points",
                    annotation_clip=True,
                    **look,
                )
                letter.set_gid(f"glyph-{k}")
    doubtful = np.flatnonzero((table.joint == j) & table.ambiguous).tolist()
    if doubtful:
        _broken(ax, findings, doubtful, "x-doubt", facecolors="none", edgecolors=INK, hatch="////", alpha=0.5)
        ax.fill_between([], [], [], facecolor="none", edgecolor=INK, hatch="////", linewidth=0.0, label="ambiguous")


def _opacity(confidence: float) -> float:
    """From a guess (0.5) to certainty (1)."""
    return _FAINTEST + (_STRONGEST - _FAINTEST) * (2.0 * confidence - 1.0)


def _broken(ax: Axes, findings: Findings, chosen: Sequence[int], name: str, **look: Any) -> None:
    table = findings.segments
    ranges = [(table.start[k], table.end[k] - table.start[k]) for k in chosen]
    bands = ax.broken_barh(ranges, (0.0, 1.0), transform=ax.get_xaxis_transform(), linewidth=0.0, zorder=0, **look)
    bands.set_gid(name)
