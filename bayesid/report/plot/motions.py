"""Motions before a robot runs them: a designed one, and any planned one against limits, with poses and distances."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array
from bayesid.excitation.design import ExcitationDesign
from bayesid.motion import Motion
from bayesid.report.findings import evenly
from bayesid.report.plot import figure as fig
from bayesid.report.plot.drawing import SIZE, draw, draw_panel, handle, new_figure
from bayesid.report.tuning import TUNING
from bayesid.robot import Robot
from bayesid.robot.kinematics import pose
from bayesid.simulation.trajectories import MotionLimits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MatplotlibFigure

_LOOKS: tuple[tuple[str, fig.Style], ...] = (
    *((colour, "solid") for colour in (fig.BLUE, fig.ORANGE, fig.MAGENTA, fig.INK)),
    *((colour, "dashed") for colour in (fig.BLUE, fig.ORANGE, fig.MAGENTA)),
)
"""Colour and line of the poses."""


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
    return draw(_excitation(design), axes)


def excitation_figure(design: ExcitationDesign) -> MatplotlibFigure:
    """`excitation` in a figure of its own."""
    return cast("MatplotlibFigure", excitation(design)[0].figure)


def _excitation(design: ExcitationDesign) -> fig.Figure:
    n, t = design.model.robot.n_joints, design.motion.t
    shares, shown = design.of_limits, evenly(len(design.motion), TUNING.curve)
    within = fig.Boxes(None, ([-1.0], [1.0]), fig.INK, "", 0.1)
    ends = float(t[0]), float(t[-1])
    rows: list[list[fig.Panel | None]] = []
    for name, values in (("position", shares.q), ("velocity", shares.dq), ("acceleration", shares.ddq)):
        rows.append([])
        for j in range(n):
            title = f"joint {j + 1}" if name == "position" else ""
            marks = within, fig.Line(t[shown], values[shown, j], fig.BLUE, "", 1.0)
            y_name = f"{name} / limit" if j == 0 else ""
            rows[-1].append(fig.Panel(marks, "", y_name, title, x_limits=ends, y_limits=(-1.1, 1.1)))
    rows.append([_expected(design, j) for j in range(n)])
    return fig.Figure(rows, 6.4, max(3.0, 1.7 * n), key=True)


def _expected(design: ExcitationDesign, joint: int) -> fig.Panel:
    """|effort|, those of weak segments in orange."""
    quality, t = design.reached, design.motion.t
    segments, magnitude = quality.segments, quality.magnitude[:, joint]
    here = np.flatnonzero(segments.joint == joint)
    lines = []
    for weak, colour, label in (
        (False, fig.BLUE, "expected |effort|"),
        (True, fig.ORANGE, "its sign is easily mistaken"),
    ):
        curve = np.full(len(t), np.nan)
        for k in here[quality.weak[here] == weak]:
            rows = slice(segments.start[k], segments.end[k] + 1)  # to the next one's first sample
            curve[rows] = magnitude[rows]
        lines.append(fig.Line(t, curve, colour, label, 1.2))
    most = 1.05 * float(magnitude.max()) or 1.0
    y_name = "|effort|, N m (N)" if joint == 0 else ""
    return fig.Panel(lines, "time, s", y_name, x_limits=(float(t[0]), float(t[-1])), y_limits=(0.0, most))


# ---------------------------------------------------------------------------------------------------------------
# A planned motion
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Poses:
    """Poses of a robot, and the way of its tip."""

    #: (K, F, 3) the skeleton in each pose as one line, m, in the base's frame; a row of nan breaks the line
    points: Array
    labels: tuple[str, ...]  #: K of them, what each pose is
    tip: Array  #: (N, 3) the way of the tip, m


@dataclass(frozen=True)
class MotionPicture:
    """What `planned_motion` draws."""

    robot: str  #: its name
    joint_names: tuple[str, ...]  #: n of them
    motion: Motion  #: N instants of n joints
    limits: MotionLimits  #: of the joints; infinite where there is none
    effort: Array  #: (N, n) expected efforts, N m (N)
    effort_band: tuple[Array, Array]  #: (N, n) lower and (N, n) upper ends of the efforts' band
    poses: Poses  #: extreme ones
    distance: Array | None = None  #: (N,) least distance to itself and the floor, m; None if nothing was checked
    margin: float | None = None  #: that the distance has to keep, m; None if there is none
    #: what is said in the place of the distance
    not_checked: str = "Distances to itself and to the floor were not checked."


def planned_motion(picture: MotionPicture) -> MatplotlibFigure:
    """Positions, velocities, accelerations and efforts against limits; extreme poses from two sides; distances.

    A row a joint, a column a quantity: curves are blue, limits orange. Above a panel is how much of a limit is used, of
    positions how much is left; what goes beyond its limit says so in magenta.
    """
    motion, limits, n = picture.motion, picture.limits, picture.motion.n_joints
    effort = np.inf if limits.effort is None else limits.effort
    columns = [
        ("position, rad (m)", motion.q, (motion.q, motion.q), limits.lower, limits.upper),
        ("velocity, rad/s (m/s)", motion.dq, (motion.dq, motion.dq), np.negative(limits.velocity), limits.velocity),
        (
            "acceleration, rad/s² (m/s²)",
            motion.ddq,
            (motion.ddq, motion.ddq),
            np.negative(limits.acceleration),
            limits.acceleration,
        ),
        ("effort, N m (N)", picture.effort, picture.effort_band, np.negative(effort), effort),
    ]
    figure = new_figure(1.15 * n + 4.6, 11.0)
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.15 * n, 4.6])
    for part in parts:
        part.set_facecolor("none")
    axes = parts[0].subplots(n, len(columns), squeeze=False, sharex=True)
    for column, (title, values, (low, high), *ends) in zip(axes.T, columns, strict=True):
        lower, upper = (np.broadcast_to(np.asarray(end, dtype=float), (n,)) for end in ends)
        for j, ax in enumerate(column):
            x_name = "time, s" if j == n - 1 else ""
            draw_panel(ax, _curve(motion.t, values[:, j], low[:, j], high[:, j], (lower[j], upper[j]), x_name))
            ax.tick_params(labelsize=SIZE - 2.5)
            _say_use(ax, float(low[:, j].min()), float(high[:, j].max()), lower[j], upper[j], values is motion.q)
        column[0].set_title(title, fontsize=SIZE, color=fig.INK, pad=16.0)  # a line of words fits between
    for j, ax in enumerate(axes[:, 0]):
        _say(ax, f"{j + 1}  {picture.joint_names[j]}", 0.0, color=fig.INK, weight="bold")
    _foot(parts[1], picture)
    duration = float(motion.t[-1] - motion.t[0])
    figure.suptitle(f"{picture.robot}, planned motion of {duration:.4g} s", fontsize=SIZE + 1.0, color=fig.INK)
    return figure


def skeleton_line(robot: Robot, q: ArrayLike) -> Array:
    """(F, 3) a robot's links in one pose as one line, m: from joint to joint, and a row of nan after each link."""
    broken = np.full((1, 3), np.nan)
    return np.concatenate([part for line in pose(robot, q).lines for part in (line, broken)])


def extreme_poses(robot: Robot, motion: Motion, distance: Array | None = None) -> Poses:
    """The start, where the tip is lowest, highest and farthest out, and the least of the distances (N,), m."""
    rows = evenly(len(motion), TUNING.poses)
    tip = np.stack([pose(robot, q).flange[:3, 3] for q in motion.q[rows]])
    found = {
        "start": 0,
        "lowest tip": rows[np.argmin(tip[:, 2])],
        "highest tip": rows[np.argmax(tip[:, 2])],
        "farthest out": rows[np.argmax(np.hypot(tip[:, 0], tip[:, 1]))],
    }
    if distance is not None:
        found["least distance"] = np.argmin(distance)
    named: dict[int, list[str]] = {}
    for label, row in found.items():
        named.setdefault(int(row), []).append(label)
    labels = tuple(f"{', '.join(names)} ({motion.t[row]:.3g} s)" for row, names in named.items())
    return Poses(np.stack([skeleton_line(robot, motion.q[row]) for row in named]), labels, tip)


def _curve(t: Array, curve: Array, low: Array, high: Array, ends: tuple[float, float], x_name: str) -> fig.Panel:
    shown = np.union1d(evenly(len(t), TUNING.curve), [np.argmin(curve), np.argmax(curve)])
    lines = [end for end in ends if np.isfinite(end)]
    marks: list[fig.Mark] = [fig.Line(t[shown], curve[shown], fig.BLUE, "curve", 1.0)]
    if (low < high).any():
        marks.append(fig.Band(t[shown], low[shown], high[shown], fig.BLUE, "band", 0.3))
    if lines:
        marks.append(fig.Strokes(None, (lines, lines), fig.ORANGE, "limit"))
    values = np.array([low.min(), high.max(), *lines])
    room = 0.12 * (np.ptp(values) or 1.0)
    y_limits = float(values.min() - room), float(values.max() + room)
    return fig.Panel(marks, x_name, x_limits=(float(t[0]), float(t[-1])), y_limits=y_limits)


def _say(ax: Axes, text: str, right: float, **look: Any) -> None:
    """A word above a panel, at its left end (0) or its right one (1)."""
    across = "right" if right else "left"
    ax.text(right, 1.03, text, transform=ax.transAxes, ha=across, va="bottom", fontsize=SIZE - 2.0, **look)


def _say_use(ax: Axes, low: float, high: float, lower: float, upper: float, position: bool) -> None:
    """How much of the limits values from low to high use or, of positions, leave; in magenta beyond them."""
    if not np.isfinite([lower, upper]).any():
        return
    if position:
        left = min(low - lower, upper - high)
        beyond, text = left < 0.0, f"{-left:.2g} beyond a limit" if left < 0.0 else f"{left:.2g} to a limit"
    else:
        share = max(-low, high) / upper
        beyond, text = share > 1.0, f"{100.0 * share:.0f} % of the limit"
    _say(ax, text, 1.0, color=fig.MAGENTA if beyond else fig.INK, weight="bold" if beyond else "normal")


def _foot(figure: Any, picture: MotionPicture) -> None:
    """Poses from two sides, and the distance over time."""
    axes = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.2])
    views = _views(picture.poses)
    for ax, view in zip(axes, views, strict=False):
        draw_panel(ax, view)
        ax.set_aspect("equal")
    look: dict[str, Any] = {"ncols": 4, "frameon": False, "fontsize": SIZE - 1.0, "labelcolor": fig.INK}
    handles = [handle(mark) for mark in views[0].labelled.values()]
    figure.legend(handles, list(views[0].labelled), loc="outside lower left", **look)
    if picture.distance is None:
        axes[2].set_axis_off()
        axes[2].text(0.5, 0.5, picture.not_checked, ha="center", va="center", wrap=True, fontsize=SIZE, color=fig.INK)
    else:
        draw_panel(axes[2], _distance(picture, picture.distance))


def _views(poses: Poses) -> list[fig.Panel]:
    """All poses from the side and from above, at one scale."""
    known = np.concatenate([poses.points.reshape(-1, 3), poses.tip, np.zeros((1, 3))])
    lowest, highest = np.nanmin(known, axis=0), np.nanmax(known, axis=0)
    middle, half = (lowest + highest) / 2.0, (0.5 + 0.06) * float((highest - lowest).max() or 1.0)
    panels = []
    for title, right, up in (("from the side", 0, 2), ("from above", 0, 1)):
        marks: list[fig.Mark] = [fig.Line(poses.tip[:, right], poses.tip[:, up], fig.INK, "way of the tip", 0.8, 0.6)]
        for line, label, (colour, style) in zip(poses.points, poses.labels, cycle(_LOOKS), strict=False):
            marks.append(fig.Line(line[:, right], line[:, up], colour, label, 2.4, 0.85, style))
            marks.append(fig.Dots(line[:, right], line[:, up], colour))
        ends = [(float(middle[k] - half), float(middle[k] + half)) for k in (right, up)]
        names = f"{'xyz'[right]}, m", f"{'xyz'[up]}, m"
        panels.append(fig.Panel(marks, *names, title, x_limits=ends[0], y_limits=ends[1]))
    return panels


def _distance(picture: MotionPicture, distance: Array) -> fig.Panel:
    """The least distance over time with its margin."""
    t, margin, least = picture.motion.t, picture.margin, int(np.argmin(distance))
    shown = np.union1d(evenly(len(t), TUNING.curve), [least])
    title = f"least distance {1e3 * distance[least]:.0f} mm, at {t[least]:.3g} s"
    lowest, highest = min(0.0, float(distance.min())), max(float(distance.max()), margin or 0.0)
    marks: list[fig.Mark] = [fig.Line(t[shown], distance[shown], fig.BLUE, "distance", 1.2)]
    marks.append(fig.Dots([t[least]], [distance[least]], fig.BLUE, "least", 5.0))
    if margin is not None:
        marks += [
            fig.level(margin, fig.ORANGE, 1.2, label="margin"),
            fig.Boxes(None, ([lowest], [margin]), fig.ORANGE, "", 0.12),
        ]
        title += f"; margin {1e3 * margin:.0f} mm"
    beyond = margin is not None and distance[least] < margin
    room = 0.12 * (highest - lowest or 1.0)
    y_name = "distance to itself and the floor, m"
    return fig.Panel(
        marks, "time, s", y_name, title, fig.MAGENTA if beyond else fig.INK, y_limits=(lowest, highest + room)
    )
