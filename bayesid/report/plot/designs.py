"""The figure of a designed motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bayesid.excitation.design import ExcitationDesign
from bayesid.report.plot.ink import BLUE, INK, ORANGE, SIZE
from bayesid.report.plot.style import dress, grid_of_axes, legend
from bayesid.report.thinning import evenly

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 1000
"""Of a curve, at most: some six a pixel of a joint's column."""
_HEIGHT = 6.4
"""in, of the figure."""
_WIDTH = 1.7
"""in, of a joint in it: seven joints fill a screen."""
_ROWS = ("position", "velocity", "acceleration")


def excitation(design: ExcitationDesign, axes: Any = None) -> list[Axes]:
    """Positions, velocities and accelerations as shares of their limits, and expected |effort|, a column a joint.

    Segments are blue; orange are those that are weak: the first to have a wrong sign when the noise grows.

    Args:
        design: what to show.
        axes: (4, n) of them; new ones by default.

    Returns:
        4 n Axes, row by row.

    Raises:
        ValueError: there are not as many Axes.

    Example:
        >>> axes = bayesid.plot.excitation(design)
        >>> len(axes), axes[0].get_ylabel()
        (12, 'position / limit')
    """
    n = design.model.robot.n_joints
    axes = grid_of_axes(axes, 4, n, _HEIGHT, max(3.0, _WIDTH * n), sharex=True)
    shares, shown = design.of_limits, evenly(len(design.motion), _POINTS)
    for row, name, values in zip(axes[:3], _ROWS, (shares.q, shares.dq, shares.ddq), strict=True):
        for ax, curve in zip(row, values.T, strict=True):
            ax.plot(design.motion.t[shown], curve[shown], color=BLUE, linewidth=1.0)
            ax.axhspan(-1.0, 1.0, color=INK, alpha=0.1, linewidth=0.0)
            ax.set_ylim(-1.1, 1.1)
        row[0].set_ylabel(f"{name} / limit", fontsize=SIZE - 1.0, color=INK)
    for j, ax in enumerate(axes[3]):
        _efforts(ax, design, j)
        ax.set_xlabel("time, s", fontsize=SIZE - 1.0, color=INK)
        axes[0, j].set_title(f"joint {j + 1}", fontsize=SIZE, color=INK)
    axes[3, 0].set_ylabel("|effort|, N m (N)", fontsize=SIZE - 1.0, color=INK)
    for colour, name in ((BLUE, "expected |effort|"), (ORANGE, "its sign is easily mistaken")):
        axes[3, 0].plot([], [], color=colour, label=name)
    for ax in axes.flat:
        dress(ax)
    legend(axes[3, 0])
    return list(axes.flat)


def excitation_figure(design: ExcitationDesign) -> Figure:
    """`excitation` in a figure of its own."""
    return cast("Figure", excitation(design)[0].figure)


def _efforts(ax: Axes, design: ExcitationDesign, joint: int) -> None:
    """|effort|, a curve a segment."""
    from matplotlib.collections import LineCollection  # with what draws it, which pages do without

    quality, t = design.reached, design.motion.t
    segments, magnitude = quality.segments, quality.magnitude[:, joint]
    here = np.flatnonzero(segments.joint == joint)
    ranges = [slice(segments.start[k], segments.end[k] + 1) for k in here]  # to the next one's first sample
    curves = [np.column_stack([t[rows], magnitude[rows]]) for rows in ranges]
    colours = [ORANGE if quality.weak[k] else BLUE for k in here]
    ax.add_collection(LineCollection(curves, colors=colours, linewidths=1.2))
    ax.autoscale_view()
    ax.set_ylim(bottom=0.0)
