"""Motions before a robot runs them: a designed one, and any planned one against limits, with poses and distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array, Integers
from bayesid.excitation.design import ExcitationDesign
from bayesid.motion import Motion
from bayesid.report.plot.drawing import SIZE, draw, dress, new_figure
from bayesid.report.plot.figure import BLUE, INK, MAGENTA, ORANGE, Boxes, Figure, Line, Panel
from bayesid.report.thinning import evenly
from bayesid.robot import Robot
from bayesid.robot.kinematics import pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MatplotlibFigure

_POINTS = 500
"""Of a curve, at most, beside its highest and its lowest: twice as many as a column has pixels."""
_POSES = 500
"""Instants at which extreme poses are looked for, at most: a period of the fastest harmonic has tens of them."""
_WIDTH, _ROW, _FOOT = 11.0, 1.15, 4.6
"""in: the width, the height of a joint, and that of poses and distances below."""
_ROOM = 0.12
"""Share of what a panel shows that is left free above and below."""
_PAD = 16.0
"""Points between a column's title and its first panel: a line of words fits between."""
_VIEWS = (("side", 0, 2), ("top", 0, 1))
"""Name and the two coordinates of the base frame that are seen: to the right, and up."""
_LOOKS = ((BLUE, "-"), (ORANGE, "-"), (MAGENTA, "-"), (INK, "-"), (BLUE, "--"), (ORANGE, "--"), (MAGENTA, "--"))
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


def _excitation(design: ExcitationDesign) -> Figure:
    n, t = design.model.robot.n_joints, design.motion.t
    shares, shown = design.of_limits, evenly(len(design.motion), _POINTS)
    within = Boxes(None, ([-1.0], [1.0]), INK, "", 0.1)
    ends = float(t[0]), float(t[-1])
    rows: list[list[Panel | None]] = []
    for name, values in (("position", shares.q), ("velocity", shares.dq), ("acceleration", shares.ddq)):
        rows.append([])
        for j in range(n):
            title = f"joint {j + 1}" if name == "position" else ""
            marks = within, Line(t[shown], values[shown, j], BLUE, "", 1.0)
            y_name = f"{name} / limit" if j == 0 else ""
            rows[-1].append(Panel(marks, "", y_name, title, x_limits=ends, y_limits=(-1.1, 1.1)))
    rows.append([_expected(design, j) for j in range(n)])
    return Figure(rows, 6.4, max(3.0, 1.7 * n), key=True)


def _expected(design: ExcitationDesign, joint: int) -> Panel:
    """|effort|, those of weak segments in orange."""
    quality, t = design.reached, design.motion.t
    segments, magnitude = quality.segments, quality.magnitude[:, joint]
    here = np.flatnonzero(segments.joint == joint)
    lines = []
    for weak, colour, label in ((False, BLUE, "expected |effort|"), (True, ORANGE, "its sign is easily mistaken")):
        curve = np.full(len(t), np.nan)
        for k in here[quality.weak[here] == weak]:
            rows = slice(segments.start[k], segments.end[k] + 1)  # to the next one's first sample
            curve[rows] = magnitude[rows]
        lines.append(Line(t, curve, colour, label, 1.2))
    most = 1.05 * float(magnitude.max()) or 1.0
    y_name = "|effort|, N m (N)" if joint == 0 else ""
    return Panel(lines, "time, s", y_name, x_limits=(float(t[0]), float(t[-1])), y_limits=(0.0, most))


# ---------------------------------------------------------------------------------------------------------------
# A planned motion
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class JointLimits:
    """Limits of n joints, each None where nothing is known.

    Attributes:
        lower: (n,) lowest positions, rad (m); infinite where there is none, as with all limits.
        upper: (n,) highest positions, rad.
        velocity: (n,) highest speeds, rad/s.
        acceleration: (n,) highest accelerations, rad/s^2.
        effort: (n,) highest efforts, N m (N).
    """

    lower: Array | None = None
    upper: Array | None = None
    velocity: Array | None = None
    acceleration: Array | None = None
    effort: Array | None = None

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if value is not None:
                kept = np.array(value, dtype=float)
                kept.setflags(write=False)
                object.__setattr__(self, one.name, kept)


@dataclass(frozen=True)
class Poses:
    """Poses of a robot, and the way of its tip.

    Attributes:
        points: (K, F, 3) the skeleton in each pose as one line, m, in the base's frame; a row of nan breaks the line.
        labels: K of them, what each pose is.
        tip: (N, 3) the way of the tip, m; None if it is not shown.
        floor: height of the floor, m; None where there is none.
    """

    points: Array
    labels: tuple[str, ...]
    tip: Array | None = None
    floor: float | None = None


@dataclass(frozen=True)
class MotionPicture:
    """What `planned_motion` draws.

    Attributes:
        robot: its name.
        joint_names: n of them.
        motion: N instants of n joints.
        limits: of the joints.
        effort: (N, n) expected efforts, N m (N); None if they are not shown.
        effort_band: (N, n) lower and (N, n) upper ends of the efforts' band; None if there is none.
        poses: extreme ones; None if they are not shown.
        distance: (N,) least distance to itself and the floor, m; None if nothing was checked.
        margin: that the distance has to keep, m; None if there is none.
        not_checked: what is said in the place of the distance.
    """

    robot: str
    joint_names: tuple[str, ...]
    motion: Motion
    limits: JointLimits = JointLimits()
    effort: Array | None = None
    effort_band: tuple[Array, Array] | None = None
    poses: Poses | None = None
    distance: Array | None = None
    margin: float | None = None
    not_checked: str = "Distances to itself and to the floor were not checked."

    def __post_init__(self) -> None:
        shape = self.motion.q.shape
        band = self.effort_band or ()
        arrays = [*([] if self.effort is None else [self.effort]), *band]
        if any(np.shape(one) != shape for one in arrays) or len(self.joint_names) != shape[1]:
            raise ValueError("efforts and names must be of the motion's joints and instants")
        if self.distance is not None and np.shape(self.distance) != shape[:1]:
            raise ValueError("there must be a distance for each instant of the motion")


@dataclass(frozen=True)
class _Quantity:
    """A column: its title, (N, n) curves, (N, n) ends of a band, (n,) limits."""

    title: str
    values: Array
    lower: Array | None
    upper: Array | None
    band: tuple[Array, Array] | None = None


def planned_motion(picture: MotionPicture) -> MatplotlibFigure:
    """Positions, velocities, accelerations and efforts against limits; extreme poses from two sides; distances.

    A row a joint, a column a quantity: curves are blue, limits orange. Above a panel is how much of a limit is used, of
    positions how much is left; what goes beyond its limit says so in magenta.

    Args:
        picture: what to show.

    Returns:
        A figure of its own; `savefig` saves it.
    """
    n = picture.motion.n_joints
    columns = _quantities(picture)
    figure = new_figure(_ROW * n + _FOOT, _WIDTH)
    parts: Any = figure.subfigures(2, 1, height_ratios=[_ROW * n, _FOOT])
    above, below = parts
    above.set_facecolor("none")
    below.set_facecolor("none")
    axes = above.subplots(n, len(columns), squeeze=False, sharex=True)
    for j in range(n):
        for ax, quantity in zip(axes[j], columns, strict=True):
            _curve(ax, picture.motion.t, quantity, j)
        _above(axes[j, 0], f"{j + 1}  {picture.joint_names[j]}", 0.0, color=INK, weight="bold")
    for ax, quantity in zip(axes[0], columns, strict=True):
        ax.set_title(quantity.title, fontsize=SIZE, color=INK, pad=_PAD)
    for ax in axes[-1]:
        ax.set_xlabel("time, s", fontsize=SIZE - 1.0, color=INK)
    _foot(below, picture)
    duration = float(picture.motion.t[-1] - picture.motion.t[0])
    figure.suptitle(f"{picture.robot}, planned motion of {duration:.4g} s", fontsize=SIZE + 1.0, color=INK)
    return figure


def skeleton_line(robot: Robot, q: ArrayLike) -> Array:
    """(F, 3) a robot's links in one pose as one line, m: from joint to joint, and a row of nan after each link."""
    broken = np.full((1, 3), np.nan)
    return np.concatenate([part for line in pose(robot, q).lines for part in (line, broken)])


def extreme_poses(robot: Robot, motion: Motion, distance: Array | None = None, floor: float | None = None) -> Poses:
    """The start and the poses in which the tip is lowest, highest and farthest out, and that of the least distance.

    Args:
        robot: whose joints move.
        motion: N instants of them.
        distance: (N,) least distances, m; none by default.
        floor: height of the floor, m; none by default.
    """
    rows = evenly(len(motion), _POSES)
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
    return Poses(np.stack([skeleton_line(robot, motion.q[row]) for row in named]), labels, tip, floor)


def _quantities(picture: MotionPicture) -> list[_Quantity]:
    motion, limits = picture.motion, picture.limits
    shown = [_Quantity("position, rad (m)", motion.q, limits.lower, limits.upper)]
    rest: list[tuple[str, Array | None, Array | None, tuple[Array, Array] | None]] = [
        ("velocity, rad/s (m/s)", motion.dq, limits.velocity, None),
        ("acceleration, rad/s² (m/s²)", motion.ddq, limits.acceleration, None),
        ("effort, N m (N)", picture.effort, limits.effort, picture.effort_band),
    ]
    for title, values, limit, band in rest:
        if values is not None:
            shown.append(_Quantity(title, values, None if limit is None else -limit, limit, band))
    return shown


def _above(ax: Axes, text: str, right: float, **look: Any) -> None:
    """A word above a panel, at its left end (0) or its right one (1)."""
    across = "right" if right else "left"
    ax.text(right, 1.03, text, transform=ax.transAxes, ha=across, va="bottom", fontsize=SIZE - 2.0, **look)


def _curve(ax: Axes, t: Array, quantity: _Quantity, joint: int) -> None:
    """One joint's curve, its band and its limits, and how much of them is used."""
    curve = quantity.values[:, joint]
    low, high = curve, curve
    shown = np.union1d(evenly(len(t), _POINTS), [np.argmin(curve), np.argmax(curve)])
    ax.plot(t[shown], curve[shown], color=BLUE, linewidth=1.0, gid="curve")
    if quantity.band is not None:
        low, high = (end[:, joint] for end in quantity.band)
        ax.fill_between(t[shown], low[shown], high[shown], color=BLUE, alpha=0.3, linewidth=0.0, gid="band")
    ends = [None if limit is None else float(limit[joint]) for limit in (quantity.lower, quantity.upper)]
    lines = [end for end in ends if end is not None and np.isfinite(end)]
    for end in lines:
        ax.axhline(end, color=ORANGE, linewidth=1.2, gid="limit")
    values = np.array([low.min(), high.max(), *lines])
    room = _ROOM * (np.ptp(values) or 1.0)
    ax.set_ylim(values.min() - room, values.max() + room)
    dress(ax)
    ax.tick_params(labelsize=SIZE - 2.5)
    if lines:
        text, beyond = _use(float(low.min()), float(high.max()), ends, quantity.title.startswith("position"))
        _above(ax, text, 1.0, color=MAGENTA if beyond else INK, weight="bold" if beyond else "normal")


def _use(low: float, high: float, ends: Sequence[float | None], position: bool) -> tuple[str, bool]:
    """How much of the limits values from low to high use or leave, in words, and whether they go beyond."""
    lower, upper = (end if end is not None else bound for end, bound in zip(ends, (-np.inf, np.inf), strict=True))
    left = min(low - lower, upper - high)
    if position:
        return (f"{-left:.2g} beyond a limit", True) if left < 0.0 else (f"{left:.2g} to a limit", False)
    share = max(-low, high) / upper
    return f"{100.0 * share:.0f} % of the limit", share > 1.0


def _foot(figure: Any, picture: MotionPicture) -> None:
    """Poses from two sides, and the distance over time."""
    columns = [1.0, 1.0, 1.2] if picture.poses is not None else [1.0]
    axes = figure.subplots(1, len(columns), squeeze=False, width_ratios=columns)[0]
    if picture.poses is not None:
        _draw_poses(axes[:2], picture.poses)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside lower left", ncols=4, frameon=False, fontsize=SIZE - 1.0, labelcolor=INK
        )
    _draw_distance(axes[-1], picture)


def _draw_poses(axes: Sequence[Axes], poses: Poses) -> None:
    """All poses in both views, at one scale, with the floor."""
    known = np.concatenate([poses.points.reshape(-1, 3), *([] if poses.tip is None else [poses.tip]), np.zeros((1, 3))])
    if poses.floor is not None:
        known = np.vstack([known, [0.0, 0.0, poses.floor]])
    lowest, highest = np.nanmin(known, axis=0), np.nanmax(known, axis=0)
    middle, half = (lowest + highest) / 2.0, (0.5 + _ROOM / 2.0) * float((highest - lowest).max() or 1.0)
    for ax, (name, right, up) in zip(axes, _VIEWS, strict=True):
        ax.set_xlim(middle[right] - half, middle[right] + half)
        ax.set_ylim(middle[up] - half, middle[up] + half)
        ax.set_aspect("equal")
        if poses.floor is not None and name == "side":  # seen from above it is everywhere
            ax.axhline(poses.floor, color=INK, linewidth=1.5, gid="floor", label="floor")
            ax.axhspan(middle[up] - 2.0 * half, poses.floor, color=INK, alpha=0.15, linewidth=0.0)
        if poses.tip is not None:
            way = poses.tip
            ax.plot(way[:, right], way[:, up], color=INK, linewidth=0.8, alpha=0.6, gid="tip", label="way of the tip")
        for k, (line, label) in enumerate(zip(poses.points, poses.labels, strict=True)):
            colour, dashes = _LOOKS[k % len(_LOOKS)]
            look: dict[str, Any] = {"color": colour, "linestyle": dashes, "linewidth": 2.4, "alpha": 0.85}
            ax.plot(line[:, right], line[:, up], marker=".", markersize=5.0, gid=f"pose {k}", label=label, **look)
        ax.set_title(f"from {'the side' if name == 'side' else 'above'}", fontsize=SIZE, color=INK)
        ax.set_xlabel(f"{'xyz'[right]}, m", fontsize=SIZE - 1.0, color=INK)
        ax.set_ylabel(f"{'xyz'[up]}, m", fontsize=SIZE - 1.0, color=INK)
        dress(ax)


def _draw_distance(ax: Axes, picture: MotionPicture) -> None:
    """The least distance over time with its margin, or a line of text that there is none."""
    if picture.distance is None:
        ax.set_axis_off()
        ax.text(0.5, 0.5, picture.not_checked, ha="center", va="center", wrap=True, fontsize=SIZE, color=INK)
        return
    shown: Integers = np.union1d(evenly(len(picture.motion), _POINTS), [np.argmin(picture.distance)])
    t, distance = picture.motion.t[shown], picture.distance[shown]
    ax.plot(t, distance, color=BLUE, linewidth=1.2, gid="distance")
    least = int(np.argmin(distance))
    ax.plot(t[least], distance[least], "o", color=BLUE, markersize=5.0, gid="least")
    title = f"least distance {1e3 * distance[least]:.0f} mm, at {t[least]:.3g} s"
    lowest = min(0.0, float(distance.min()))
    if picture.margin is not None:
        ax.axhline(picture.margin, color=ORANGE, linewidth=1.2, gid="margin", label="margin")
        ax.axhspan(2.0 * lowest - 1.0, picture.margin, color=ORANGE, alpha=0.12, linewidth=0.0)
        title += f"; margin {1e3 * picture.margin:.0f} mm"
    beyond = picture.margin is not None and distance[least] < picture.margin
    highest = max(float(distance.max()), picture.margin or 0.0)
    ax.set_ylim(lowest, highest + _ROOM * (highest - lowest or 1.0))
    ax.set_title(title, fontsize=SIZE, color=MAGENTA if beyond else INK)
    ax.set_xlabel("time, s", fontsize=SIZE - 1.0, color=INK)
    ax.set_ylabel("distance to itself and the floor, m", fontsize=SIZE - 1.0, color=INK)
    dress(ax)
