"""The skeleton of a robot, to compare with its manufacturer's drawing."""

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
"""Projected length of an axis over its length, below which it points towards or away from the viewer."""
_DIRECTIONS = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1), (0, 1), (1, 0), (0, -1), (-1, 0)])
"""Directions from its position in which a label may be placed."""
_CAPTION = (
    "Joints turn about their arrows by the right-hand rule; a dot in a ring points towards you, a cross away. "
    "Lengths in mm."
)


def skeleton(robot: Robot | str | Path, q: ArrayLike | None = None, axes: Sequence[Axes] | None = None) -> list[Axes]:
    """Links, joints and their axes from the side and from above, with lengths in mm.

    A joint's axis is an arrow, about which the joint turns by the right-hand rule. A ring with a dot points towards the
    viewer, a ring with a cross away. A link follows the robot's table: straight to the next axis, then along it. The
    arrow g is gravity.

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
    for ax, (name, right, up) in zip(drawn, _VIEWS, strict=True):
        view = _View(ax, here, points, [right, up])
        view.draw_gravity()
        view.draw_links()
        view.draw_base()
        view.draw_joints()
        view.draw_flange()
        view.draw_labels()
        dress(ax, f"{'xyz'[right]}, m", f"{'xyz'[up]}, m", f"{here.robot.name}, {name}")
    if axes is None:  # another's figure has captions of its own
        drawn[0].figure.supxlabel(f"q = {positions_text(here)}\n{_CAPTION}", fontsize=SIZE - 1.5, color=INK)
    return drawn


def skeleton_figure(robot: Robot, q: ArrayLike | None = None) -> Figure:
    """`skeleton` as a new figure."""
    return cast("Figure", skeleton(robot, q)[0].figure)


def positions_text(here: Pose) -> str:
    """The joint positions, in degrees and m."""
    pairs = zip(here.robot.joints, here.q.tolist(), strict=True)
    return ", ".join(f"{value:.4g} m" if joint.prismatic else f"{np.degrees(value):.4g}°" for joint, value in pairs)


class _View:
    """A pose seen along one axis of the base frame; labels are placed where they cover least."""

    def __init__(self, ax: Axes, here: Pose, points: Array, seen: list[int]) -> None:
        """The same scale for all views, with margins for arrows and labels."""
        self._ax, self._here, self._seen = ax, here, seen
        size = max(float(np.ptp(points, axis=0).max()), _SHORTEST)
        flat = points[:, seen]
        middle, half = (flat.min(axis=0) + flat.max(axis=0)) / 2.0, (0.5 + 1.5 * _ARROW) * size
        (x, y), self._arrow_size, self._near = middle, _ARROW * size, 0.012 * size
        ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
        self._scale = 150.0 / half  # points of a view in a figure made here
        self._labels: list[tuple[bool, str, Array, str, float]] = []
        self._clear: list[Array] = []

    def draw_gravity(self) -> None:
        """An arrow in the corner, unless it points towards or away from the viewer."""
        gravity = self._here.robot.gravity
        down = gravity[self._seen] / (np.linalg.norm(gravity) or 1.0)
        if np.linalg.norm(down) >= _EDGE_ON:
            corner = np.array([self._ax.get_xlim()[0], self._ax.get_ylim()[1]]) + self._arrow_size * np.array([1, -1])
            self._arrow(corner - 0.4 * self._arrow_size * down, 0.8 * self._arrow_size * down, INK)
            self._label("g", corner, INK, SIZE - 1.0)

    def draw_links(self) -> None:
        """All pieces; each with its length in the view that shows its full length, or most of it."""
        seen = self._seen
        for number, line in enumerate(self._here.lines, start=1):
            look: dict[str, Any] = {"linewidth": 4.0, "solid_capstyle": "round", "alpha": 0.8, "gid": f"link {number}"}
            self._ax.plot(*line[:, seen].T, color=BLUE, **look)
            for start, end in pairwise(line):
                length = float(np.linalg.norm(end - start))
                most = max(float(np.linalg.norm((end - start)[[right, up]])) for _, right, up in _VIEWS)
                shown = float(np.linalg.norm((end - start)[seen]))
                self._keep_clear(start[seen], end[seen])
                if length > _SHORTEST and shown > min(0.99 * length, most) - _SHORTEST:
                    text = f"{1e3 * length:.2f}".rstrip("0").rstrip(".")
                    self._label(text, (start + end)[seen] / 2.0, BLUE, SIZE - 2.0)

    def draw_base(self) -> None:
        """Its frame's axes."""
        self._label("base", np.zeros(2), INK, SIZE - 1.0, first=True)
        for axis in self._seen:
            tip = self._arrow_size * np.eye(3)[axis][self._seen]
            self._arrow(np.zeros(2), tip, INK)
            self._label("xyz"[axis], tip, INK, SIZE - 1.0)

    def draw_joints(self) -> None:
        """Each joint's axis; joints in the same place of the view share a label."""
        seen, places = self._seen, self._here.joint_points[:, self._seen]
        towards = np.cross(np.eye(3)[seen[0]], np.eye(3)[seen[1]])  # the viewer
        for place, axis in zip(places, self._here.axes, strict=True):
            if np.linalg.norm(axis[seen]) >= _EDGE_ON:
                self._arrow(place, self._arrow_size * axis[seen], ORANGE)
                self._ax.plot(*place, "o", color=ORANGE, markersize=5.0)
            else:
                self._ax.plot(*place, "o", color=ORANGE, markersize=11.0, fillstyle="none", markeredgewidth=1.5)
                self._ax.plot(*place, "." if axis @ towards > 0.0 else "x", color=ORANGE, markersize=6.0)
        remaining = list(range(len(places)))
        while remaining:
            place = places[remaining[0]]
            near = [i for i in remaining if np.linalg.norm(places[i] - place) <= self._near]
            self._label(", ".join(str(i + 1) for i in near), place, ORANGE, SIZE + 1.0, first=True)
            remaining = [i for i in remaining if i not in near]

    def draw_flange(self) -> None:
        """With its z axis."""
        place, z = self._here.flange[:3, 3][self._seen], self._here.flange[:3, 2][self._seen]
        self._ax.plot(*place, "s", color=MAGENTA, markersize=7.0, gid="flange")
        self._arrow(place, 0.8 * self._arrow_size * z, MAGENTA)
        self._label("flange", place, MAGENTA, SIZE - 1.0, first=True)

    def _arrow(self, start: Array, along: Array, colour: str) -> None:
        if np.linalg.norm(along) > 0.0:
            look = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0.0, "shrinkB": 0.0}
            self._ax.annotate("", tuple(start + along), tuple(start), arrowprops=look)
            self._keep_clear(start, start + along)

    def _keep_clear(self, start: Array, end: Array) -> None:
        count = 2 + int(np.linalg.norm(end - start) * self._scale / 3.0)
        self._clear.append(self._scale * np.linspace(start, end, count))

    def _label(self, text: str, place: Array, colour: str, size: float, first: bool = False) -> None:
        """A label at a place (2,), m; labels with `first` are placed before the others."""
        self._labels.append((not first, text, place, colour, size))

    def draw_labels(self) -> None:
        """Places all labels where they cover lines and each other least."""
        lines, taken = np.concatenate(self._clear), np.empty((0, 4))
        offsets = np.concatenate([distance * _DIRECTIONS for distance in (5.0, 11.0, 18.0)])
        for _, text, place, colour, size in sorted(self._labels, key=lambda label: label[0]):
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
