"""The skeleton of a robot, to compare with a drawing of its maker's."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array
from bayesid.report.plot.drawing import SIZE, dress, given_axes, new_figure
from bayesid.report.plot.figure import BLUE, INK, MAGENTA, ORANGE, WIDE
from bayesid.robot import Robot, load_robot
from bayesid.robot.kinematics import Pose, pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_VIEWS = (("side", 0, 2), ("top", 0, 1))
"""Name and the two coordinates of the base frame that are seen: to the right, and up."""
_ARROW = 0.11
"""Length of an axis over the size of the picture."""
_SHORTEST = 1e-4
"""m; a shorter piece of a link is rounding."""
_EDGE_ON = 0.3
"""Share of an axis that is seen below which it counts as pointing at the viewer or away."""
_CAPTION = (
    "Joints turn the right-handed way about their arrows; a dot in a ring is an arrow towards you, a cross one away. "
    "Lengths in mm."
)


def skeleton(robot: Robot | str | Path, q: ArrayLike | None = None, axes: Sequence[Axes] | None = None) -> list[Axes]:
    """Links, joints and their axes from the side and from above, with lengths in mm.

    A joint's axis is an arrow, about which it turns the right-handed way; where it points at the viewer it is a ring
    with a dot, and with a cross where it points away. A link goes from joint to joint as its table does: straight to
    the next axis, then along it. The arrow g in the corner is gravity.

    Args:
        robot: a robot, a built-in name or a file.
        q: (n,) joint positions, rad (m); zero by default.
        axes: of the side view, x and z of the base frame, and of the top view, x and y; new ones by default.

    Raises:
        InputError: no such robot, or no such positions.
        ValueError: there are not two Axes.

    Example:
        >>> side, top = bayesid.plot.skeleton("ur10e", np.deg2rad([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))
        >>> side.get_title()
        'ur10e, side'
    """
    here = pose(robot if isinstance(robot, Robot) else load_robot(robot), q)
    given = new_figure(5.4, WIDE).subplots(1, len(_VIEWS)) if axes is None else axes
    drawn: list[Axes] = given_axes(given, len(_VIEWS)).tolist()
    points = np.concatenate([np.zeros((1, 3)), *here.lines])
    size = max(float(np.ptp(points, axis=0).max()), _SHORTEST)
    for ax, (name, right, up) in zip(drawn, _VIEWS, strict=True):
        seen = [right, up]
        labels = Labels(ax, _frame(ax, points[:, seen], size))
        _draw_gravity(ax, here.robot, seen, size, labels)
        _draw_links(ax, here, seen, labels)
        _draw_base(ax, seen, size, labels)
        _draw_joints(ax, here, seen, size, labels)
        _draw_flange(ax, here, seen, size, labels)
        labels.draw()
        dress(ax, f"{'xyz'[right]}, m", f"{'xyz'[up]}, m", f"{here.robot.name}, {name}")
    if axes is None:  # another's figure has captions of its own
        drawn[0].figure.supxlabel(f"q = {positions_text(here)}\n{_CAPTION}", fontsize=SIZE - 1.5, color=INK)
    return drawn


def skeleton_figure(robot: Robot, q: ArrayLike | None = None) -> Figure:
    """`skeleton` in a figure of its own."""
    return cast("Figure", skeleton(robot, q)[0].figure)


def positions_text(here: Pose) -> str:
    """The joint positions, in degrees and m."""
    pairs = zip(here.robot.joints, here.q.tolist(), strict=True)
    return ", ".join(f"{value:.4g} m" if joint.prismatic else f"{np.degrees(value):.4g}°" for joint, value in pairs)


def _frame(ax: Axes, points: Array, size: float) -> float:
    """The same scale for all views, and room for arrows and labels; the width of what is seen, m."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    half = (0.5 + 1.5 * _ARROW) * size  # room for an arrow and its label
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.set_aspect("equal")
    return 2.0 * half


def _draw_gravity(ax: Axes, robot: Robot, seen: Sequence[int], size: float, labels: Labels) -> None:
    """An arrow in the corner, where the view shows its direction."""
    down = robot.gravity[list(seen)] / (np.linalg.norm(robot.gravity) or 1.0)
    if np.linalg.norm(down) >= _EDGE_ON:
        corner = np.array([ax.get_xlim()[0], ax.get_ylim()[1]]) + _ARROW * size * np.array([1.0, -1.0])
        start, tip = corner - 0.4 * _ARROW * size * down, corner + 0.4 * _ARROW * size * down
        _arrow(ax, start, tip, INK, labels)
        labels.add("g", corner, INK, SIZE - 1.0)


def _draw_links(ax: Axes, here: Pose, seen: Sequence[int], labels: Labels) -> None:
    """All pieces; the length of each, where it is seen whole, or else in the view that shows most of it."""
    for number, line in enumerate(here.lines, start=1):
        flat = line[:, seen]
        ax.plot(*flat.T, color=BLUE, linewidth=4.0, solid_capstyle="round", alpha=0.8, gid=f"link {number}")
        for start, end in pairwise(line):
            length = float(np.linalg.norm(end - start))
            most = max(_seen(end - start, (right, up)) for _, right, up in _VIEWS)
            labels.keep_clear(start[seen], end[seen])
            if length > _SHORTEST and _seen(end - start, seen) > min(0.99 * length, most) - _SHORTEST:
                labels.add(f"{1e3 * length:.2f}".rstrip("0").rstrip("."), (start + end)[seen] / 2.0, BLUE, SIZE - 2.0)


def _seen(piece: Array, view: Sequence[int]) -> float:
    """Length that a view shows."""
    return float(np.linalg.norm(piece[list(view)]))


def _draw_base(ax: Axes, seen: Sequence[int], size: float, labels: Labels) -> None:
    labels.add("base", np.zeros(2), INK, SIZE - 1.0, first=True)
    for axis in seen:
        tip = _ARROW * size * np.eye(3)[axis][seen]
        _arrow(ax, np.zeros(2), tip, INK, labels)
        labels.add("xyz"[axis], tip, INK, SIZE - 1.0)


def _draw_joints(ax: Axes, here: Pose, seen: Sequence[int], size: float, labels: Labels) -> None:
    """Each joint's axis where the skeleton meets it; joints that are seen in one place have one label."""
    places = here.joint_points[:, seen]
    towards = np.cross(np.eye(3)[seen[0]], np.eye(3)[seen[1]])  # the viewer
    for place, axis in zip(places, here.axes, strict=True):
        if np.linalg.norm(axis[seen]) >= _EDGE_ON:
            _arrow(ax, place, place + _ARROW * size * axis[seen], ORANGE, labels)
            ax.plot(*place, "o", color=ORANGE, markersize=5.0)
        else:
            ax.plot(*place, "o", color=ORANGE, markersize=11.0, fillstyle="none", markeredgewidth=1.5)
            ax.plot(*place, "." if axis @ towards > 0.0 else "x", color=ORANGE, markersize=6.0)
    for members in _groups(places, 0.012 * size):
        labels.add(", ".join(str(i + 1) for i in members), places[members[0]], ORANGE, SIZE + 1.0, first=True)


def _draw_flange(ax: Axes, here: Pose, seen: Sequence[int], size: float, labels: Labels) -> None:
    place, z = here.flange[:3, 3][seen], here.flange[:3, 2][seen]
    ax.plot(*place, "s", color=MAGENTA, markersize=7.0, gid="flange")
    _arrow(ax, place, place + 0.8 * _ARROW * size * z, MAGENTA, labels)
    labels.add("flange", place, MAGENTA, SIZE - 1.0, first=True)


def _arrow(ax: Axes, start: Array, end: Array, colour: str, labels: Labels) -> None:
    if np.linalg.norm(end - start) > 0.0:
        look = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0.0, "shrinkB": 0.0}
        ax.annotate("", tuple(end), tuple(start), arrowprops=look)
        labels.keep_clear(start, end)


def _groups(places: Array, near: float) -> list[list[int]]:
    """Indices of points, those together that are near the first of their group."""
    groups: list[list[int]] = []
    for i, place in enumerate(places):
        for group in groups:
            if np.linalg.norm(place - places[group[0]]) <= near:
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


# ---------------------------------------------------------------------------------------------------------------
# Labels that do not lie on each other
# ---------------------------------------------------------------------------------------------------------------
_DIRECTIONS = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1), (0, 1), (1, 0), (0, -1), (-1, 0)])


class Labels:
    """Words at places, each in the direction in which it covers least.

    Args:
        ax: where they are written.
        width: of what it shows, m.
    """

    def __init__(self, ax: Axes, width: float) -> None:
        self._ax, self._scale = ax, 300.0 / width  # points of a view in a figure made here
        self._labels: list[tuple[bool, str, Array, str, float]] = []
        self._clear: list[Array] = []

    def keep_clear(self, start: Array, end: Array) -> None:
        """A line that labels should not lie on, (2,) and (2,) m."""
        count = 2 + int(np.linalg.norm(end - start) * self._scale / 3.0)
        self._clear.append(self._scale * np.linspace(start, end, count))

    def add(self, text: str, place: Array, colour: str, size: float, first: bool = False) -> None:
        """A word at a place, (2,) m; those that are `first` choose before the others."""
        self._labels.append((not first, text, place, colour, size))

    def draw(self) -> None:
        """Writes all of them."""
        lines, taken = np.concatenate(self._clear), np.empty((0, 4))
        for _, text, place, colour, size in sorted(self._labels, key=lambda label: label[0]):
            offsets = np.concatenate([distance * _DIRECTIONS for distance in (5.0, 11.0, 18.0)])
            half = 0.5 * np.array([0.62 * size * len(text), size])
            centres = offsets + np.sign(offsets) * half
            boxes = np.hstack([centres - half, centres + half]) + np.tile(self._scale * place, 2)
            best = int(np.argmin([_covered(box, lines, taken) for box in boxes]))
            taken = np.vstack([taken, boxes[best]])
            look: dict[str, Any] = {"ha": "center", "va": "center", "color": colour, "fontsize": size}
            self._ax.annotate(text, tuple(place), tuple(centres[best]), textcoords="offset points", **look)


def _covered(box: Array, lines: Array, taken: Array) -> float:
    """How much a box (4,), left, bottom, right, top, lies on points of lines (N, 2) and on other boxes (K, 4)."""
    inside = np.all((lines >= box[:2] - 1.0) & (lines <= box[2:] + 1.0), axis=1).sum()
    shared = np.minimum(taken[:, 2:], box[2:] + 1.0) - np.maximum(taken[:, :2], box[:2] - 1.0)
    return float(inside + np.prod(np.maximum(shared, 0.0), axis=1).sum())
