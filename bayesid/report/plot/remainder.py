"""What the model leaves of each joint's efforts: over time, velocity and position, and how long it lasts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes


from bayesid.report.plot.ink import BLUE, INK, ORANGE, SIZE
from bayesid.report.plot.source import Source, findings_of
from bayesid.report.plot.style import dress, each_joint

VARIABLES = ("t", "velocity", "position")
"""Over which a residual can be drawn; names as in `bayesid.report.findings.Samples`."""
_HEIGHT = 2.1
"""in, of a joint."""
_POINTS = 1200
"""Samples of a scatter, at most: more would hide each other."""


def residuals(
    result: Source, variable: str = "t", joints: Sequence[int] | None = None, axes: Sequence[Axes] | Axes | None = None
) -> list[Axes]:
    """Residuals in motion over a variable, with their means over equally many samples and twice the standard errors.

    Samples are taken as independent for the standard errors. Where the means leave zero, an effect is missing.

    Args:
        result: an identification, its findings, or a result folder.
        variable: "t", "velocity" or "position", of the actuators.
        joints: from 1; all by default.
        axes: one for each joint, or the one of a single joint; new ones by default.

    Returns:
        One Axes for each joint.

    Raises:
        InputError: the folder holds no result.
        ValueError: there is no such variable or joint, or not one Axes for each.

    Example:
        >>> (ax,) = bayesid.plot.residuals(result, "velocity", joints=[2])
        >>> ax.get_ylabel()
        'residual 2, N m'
    """
    if variable not in VARIABLES:
        raise ValueError(f"{variable!r} is none of {', '.join(VARIABLES)}")
    findings = findings_of(result)
    drawn = each_joint(findings.n_joints, joints, axes, _HEIGHT)
    for joint, ax in drawn:
        ax.scatter(
            *findings.scatter(joint - 1, variable, _POINTS),
            s=4.0,
            color=BLUE,
            alpha=0.4,
            linewidths=0.0,
            rasterized=True,
        )
        centre, mean, error = findings.trend(joint - 1, variable)
        ax.errorbar(
            centre, mean, yerr=2.0 * error, color=ORANGE, linewidth=1.4, marker="o", markersize=3.0, capsize=2.0
        )
        ax.axhline(0.0, color=INK, linewidth=0.8)
        unit = {
            "t": "s",
            "velocity": f"{findings.position_unit[joint - 1]}/s",
            "position": findings.position_unit[joint - 1],
        }
        ax.set_xlabel(f"{'time' if variable == 't' else variable}, {unit[variable]}", fontsize=SIZE, color=INK)
        ax.set_ylabel(f"residual {joint}, {findings.effort_unit[joint - 1]}", fontsize=SIZE, color=INK)
        dress(ax)
    return [ax for _, ax in drawn]


def autocorrelation(
    result: Source, joints: Sequence[int] | None = None, axes: Sequence[Axes] | Axes | None = None
) -> list[Axes]:
    """Autocorrelation of the residuals in motion; 95 % of white noise's values lie in the grey band.

    Args:
        result: an identification, its findings, or a result folder.
        joints: from 1; all by default.
        axes: one for each joint, or the one of a single joint; new ones by default.

    Returns:
        One Axes for each joint.

    Raises:
        InputError: the folder holds no result.
        ValueError: there is no such joint, or not one Axes for each.

    Example:
        >>> from matplotlib.figure import Figure
        >>> left, right = Figure().subplots(1, 2)
        >>> bayesid.plot.autocorrelation(result, joints=[1, 2], axes=[left, right]) == [left, right]
        True
    """
    findings = findings_of(result)
    drawn = each_joint(findings.n_joints, joints, axes, _HEIGHT)
    table = findings.correlation
    for joint, ax in drawn:
        bound = float(table.bound[joint - 1])
        ax.axhspan(-bound, bound, color=INK, alpha=0.25, linewidth=0.0, zorder=0)
        ax.plot(table.lag, table.value[joint - 1], color=BLUE, linewidth=1.4)
        ax.axhline(0.0, color=INK, linewidth=0.8)
        ax.set_xlabel("lag, s", fontsize=SIZE, color=INK)
        ax.set_ylabel(f"autocorrelation {joint}", fontsize=SIZE, color=INK)
        dress(ax)
    return [ax for _, ax in drawn]
