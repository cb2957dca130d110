"""Figures of designed motions, and of planned ones with limits, poses and distances."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array
from bayesid.excitation.design import ExcitationDesign
from bayesid.motion import Motion
from bayesid.number_text import percent
from bayesid.report.plot.drawing import SIZE, dress, given_axes, legend, new_figure
from bayesid.report.plot.figure import BLUE, INK, MAGENTA, ORANGE
from bayesid.report.report_data import evenly
from bayesid.report.tuning import TUNING
from bayesid.robot import Robot
from bayesid.robot.kinematics import pose
from bayesid.simulation.trajectories import MotionLimits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOKS = [(colour, "solid") for colour in (BLUE, ORANGE, MAGENTA, INK)]
_LOOKS += [(colour, "dashed") for colour in (BLUE, ORANGE, MAGENTA)]
"""Colour and line of the poses."""


def excitation(design: ExcitationDesign, axes: Any = None) -> list[Axes]:
    """Positions, velocities and accelerations as shares of their limits, and expected |effort|; one column per joint.

    Blue: segments. Orange: weak segments, whose signs become wrong first as the noise grows.

    Args:
        design: a designed motion.
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
    n, t, shares = design.model.robot.n_joints, design.motion.t, design.of_limits
    quantities = {"position": shares.q, "velocity": shares.dq, "acceleration": shares.ddq}
    made = new_figure(6.4, max(3.0, 1.7 * n)).subplots(4, n, squeeze=False, sharex=True) if axes is None else axes
    given, shown = given_axes(made, 4 * n).reshape(4, n), evenly(len(design.motion), TUNING.curve)
    for row, (name, values) in zip(given, quantities.items(), strict=False):
        for j, ax in enumerate(row):
            ax.axhspan(-1.0, 1.0, color=INK, alpha=0.1, linewidth=0.0, zorder=0.0)
            ax.plot(t[shown], values[shown, j], color=BLUE, linewidth=1.0)
            ax.set(xlim=(t[0], t[-1]), ylim=(-1.1, 1.1))
            dress(ax, "", f"{name} / limit" * (j == 0), f"joint {j + 1}" * (name == "position"))
    for j, ax in enumerate(given[3]):
        _draw_expected(ax, design, j)
        dress(ax, "time, s", "|effort|, N m (N)" * (j == 0))
    handles, names = given[3, 0].get_legend_handles_labels()
    legend(given[3, 0], handles, names, outside=axes is None)
    return cast("list[Axes]", given.ravel().tolist())


def excitation_figure(design: ExcitationDesign) -> Figure:
    """`excitation` as a new figure."""
    return cast("Figure", excitation(design)[0].figure)


def _draw_expected(ax: Axes, design: ExcitationDesign, joint: int) -> None:
    quality, t = design.reached, design.motion.t
    segments, magnitude = quality.segments, quality.magnitude[:, joint]
    here = np.flatnonzero(segments.joint == joint)
    for weak, colour, label in ((False, BLUE, "expected |effort|"), (True, ORANGE, "its sign is uncertain")):
        curve = np.full(len(t), np.nan)
        for k in here[quality.weak[here] == weak]:
            rows = slice(segments.start[k], segments.end[k] + 1)  # to the next one's first sample
            curve[rows] = magnitude[rows]
        ax.plot(t, curve, color=colour, linewidth=1.2, label=label)
    ax.set(xlim=(t[0], t[-1]), ylim=(0.0, 1.05 * float(magnitude.max()) or 1.0))


# ---------------------------------------------------------------------------------------------------------------
# A planned motion
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Poses:
    """Poses of a robot, and the path of its tip."""

    #: (K, F, 3) the skeleton in each pose as one line, m, in the base's frame; a row of nan breaks the line
    points: Array
    labels: tuple[str, ...]  #: K of them
    tip: Array  #: (N, 3) path of the tip, m


@dataclass(frozen=True)
class MotionPicture:
    """Input of `planned_motion`."""

    robot: str  #: its name
    joint_names: tuple[str, ...]  #: n of them
    motion: Motion  #: N instants of n joints
    limits: MotionLimits  #: of the joints; infinite without a limit
    effort: Array  #: (N, n) expected efforts, N m (N)
    effort_band: tuple[Array, Array]  #: (N, n) lower and (N, n) upper ends of the efforts' band
    poses: Poses  #: extreme ones
    distance: Array | None = None  #: (N,) least distance to itself and the floor, m; None if nothing was checked
    margin: float | None = None  #: least allowed distance, m; None if not checked
    #: text in place of the distance
    not_checked: str = "Distances to itself and to the floor were not checked."
    sliding: tuple[bool, ...] = ()  #: n, whether a joint slides; empty if none does


def planned_motion(picture: MotionPicture) -> Figure:
    """Positions, velocities, accelerations and efforts against limits; extreme poses from two sides; distances.

    One row per joint, one column per quantity; curves are blue, limits orange. The text above a panel is the used share
    of the limit, or the distance to the position limit; it is magenta beyond a limit.
    """
    motion, limits, n = picture.motion, picture.limits, picture.motion.n_joints
    effort = np.inf if limits.effort is None else limits.effort
    columns = [
        ("position, rad (m)", motion.q, (motion.q, motion.q), limits.lower, limits.upper),
        ("velocity, rad/s (m/s)", motion.dq, (motion.dq, motion.dq), None, limits.velocity),
        ("acceleration, rad/s² (m/s²)", motion.ddq, (motion.ddq, motion.ddq), None, limits.acceleration),
        ("effort, N m (N)", picture.effort, picture.effort_band, None, effort),
    ]
    figure = new_figure(1.15 * n + 4.6, 11.0)
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.15 * n, 4.6])
    for part in parts:
        part.set_facecolor("none")
    axes = parts[0].subplots(n, len(columns), squeeze=False, sharex=True)
    for column, (title, values, (low, high), least, most) in zip(axes.T, columns, strict=True):
        ends = np.broadcast_arrays(np.negative(most) if least is None else least, most, np.zeros(n))
        for j, ax in enumerate(column):
            limit = float(ends[0][j]), float(ends[1][j])
            _draw_curve(ax, motion.t, values[:, j], (low[:, j], high[:, j]), limit)
            dress(ax, "time, s" * (j == n - 1))
            ax.tick_params(labelsize=SIZE - 2.5)
            unit = "m" if any(picture.sliding[j : j + 1]) else "rad"
            used = float(low[:, j].min()), float(high[:, j].max())
            _write_use(ax, *used, *limit, of_distance=unit if values is motion.q else "")
        column[0].set_title(title, fontsize=SIZE, color=INK, pad=16.0)  # a line of words fits between
    for j, ax in enumerate(axes[:, 0]):
        _write(ax, f"{j + 1}  {picture.joint_names[j]}", 0.0, color=INK, weight="bold")
    side, above, last = parts[1].subplots(1, 3, width_ratios=[1.0, 1.0, 1.2])
    _draw_poses(picture.poses, side, above)
    look: dict[str, Any] = {"ncols": 4, "frameon": False, "fontsize": SIZE - 1.0, "labelcolor": INK}
    parts[1].legend(*side.get_legend_handles_labels(), loc="outside lower left", **look)
    if picture.distance is None:
        last.set_axis_off()
        last.text(0.0, 0.5, _folded(picture.not_checked), va="center", fontsize=SIZE, color=INK)
    else:
        _draw_distance(last, motion.t, picture.distance, picture.margin)
    duration = float(motion.t[-1] - motion.t[0])
    figure.suptitle(
        f"{picture.robot}, planned motion of {duration:.4g} s (orange: limits)", fontsize=SIZE + 1.0, color=INK
    )
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


def _draw_curve(ax: Axes, t: Array, curve: Array, band: tuple[Array, Array], ends: tuple[float, float]) -> None:
    shown = np.union1d(evenly(len(t), TUNING.curve), [np.argmin(curve), np.argmax(curve)])
    low, high = band
    ax.plot(t[shown], curve[shown], color=BLUE, linewidth=1.0, gid="curve")
    if (low < high).any():
        ax.fill_between(t[shown], low[shown], high[shown], color=BLUE, alpha=0.3, linewidth=0.0, gid="band")
    for end in ends:
        if np.isfinite(end):
            ax.axhline(end, color=ORANGE, linewidth=1.2, gid="limit")
    values = np.array([low.min(), high.max(), *(end for end in ends if np.isfinite(end))])
    room = 0.12 * (np.ptp(values) or 1.0)
    ax.set(xlim=(t[0], t[-1]), ylim=(values.min() - room, values.max() + room))


def _write(ax: Axes, text: str, right: float, **look: Any) -> None:
    across = "right" if right else "left"
    ax.text(right, 1.03, text, transform=ax.transAxes, ha=across, va="bottom", fontsize=SIZE - 2.0, **look)


def _folded(text: str) -> str:
    return "\n".join(textwrap.fill(line, 44) for line in text.splitlines())


def _write_use(ax: Axes, low: float, high: float, lower: float, upper: float, *, of_distance: str) -> None:
    """Text: the share of the limits that values from low to high use, or the distance left; magenta beyond limits.

    `of_distance` is the unit of the distance, empty for the share.
    """
    if not np.isfinite([lower, upper]).any():
        return
    if of_distance:
        room = min(low - lower, upper - high)
        beyond, text = room < 0.0, f"{abs(room):.2g} {of_distance} {'beyond' if room < 0.0 else 'to'} a limit"
    else:
        share = max(-low, high) / upper
        beyond, text = share > 1.0, f"{percent(share, 0)} of the limit"
    _write(ax, text, 1.0, color=MAGENTA if beyond else INK, weight="bold" if beyond else "normal")


def _draw_poses(poses: Poses, *views: Axes) -> None:
    known = np.concatenate([poses.points.reshape(-1, 3), poses.tip, np.zeros((1, 3))])
    lowest, highest = np.nanmin(known, axis=0), np.nanmax(known, axis=0)
    middle, half = (lowest + highest) / 2.0, (0.5 + 0.06) * float((highest - lowest).max() or 1.0)
    for ax, title, right, up in zip(views, ("from the side", "from above"), (0, 0), (2, 1), strict=True):
        ax.plot(poses.tip[:, right], poses.tip[:, up], color=INK, linewidth=0.8, alpha=0.6, label="way of the tip")
        for line, label, (colour, style) in zip(poses.points, poses.labels, cycle(_LOOKS), strict=False):
            look: dict[str, Any] = {"linestyle": style, "marker": "o", "markersize": 3.0, "alpha": 0.85, "gid": label}
            ax.plot(line[:, right], line[:, up], color=colour, linewidth=2.4, label=label, **look)
        x, y = middle[[right, up]]
        ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
        dress(ax, f"{'xyz'[right]}, m", f"{'xyz'[up]}, m", title)


def _draw_distance(ax: Axes, t: Array, distance: Array, margin: float | None) -> None:
    least = int(np.argmin(distance))
    shown = np.union1d(evenly(len(t), TUNING.curve), [least])
    title = f"least distance {1e3 * distance[least]:.0f} mm, at {t[least]:.3g} s"
    lowest, highest = min(0.0, float(distance.min())), max(float(distance.max()), margin or 0.0)
    ax.plot(t[shown], distance[shown], color=BLUE, linewidth=1.2, gid="distance")
    ax.plot(t[least], distance[least], "o", color=BLUE, markersize=5.0, gid="least")
    if margin is not None:
        ax.axhline(margin, color=ORANGE, linewidth=1.2, gid="margin")
        ax.axhspan(lowest, margin, color=ORANGE, alpha=0.12, linewidth=0.0, zorder=0.0)
        title += f"; margin {1e3 * margin:.0f} mm"
    ax.set(ylim=(lowest, highest + 0.12 * (highest - lowest or 1.0)))
    ax.margins(x=0.05)
    dress(ax, "time, s", "distance to itself and the floor, m", title)
    if margin is not None and distance[least] < margin:
        ax.title.set_color(MAGENTA)
