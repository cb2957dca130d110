"""A planned motion as tables and programs of robot controllers, at 10, 30 and 100 % of its speed.

Nothing here checks limits or collisions; the head of each file states what the caller has checked.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.excitation.next_motion import SPEEDS
from bayesid.export.tuning import TUNING
from bayesid.files.writing import write_motion
from bayesid.motion import Motion

Between = Callable[[Motion, Array], Array]
"""Interpolation of a controller: positions (N, n) at times (N,), from points."""


@dataclass(frozen=True)
class PlannedMotion:
    """A motion from rest to rest, defined at every instant; `slowed` gives slower versions."""

    robot: str  #: name of the robot
    joint_names: tuple[str, ...]  #: (n,) in the order of the motion's columns
    prismatic: tuple[bool, ...]  #: (n,) prismatic joints have positions in m, others in rad
    at: Callable[[Array], Motion]  #: the motion, with exact derivatives, at times t (N,) from 0 to `duration`, s
    duration: float  #: s
    rate: float  #: of the controller, Hz
    checked: tuple[str, ...] = ()  #: what was checked, as "collisions of links"; for the heads of files
    not_checked: tuple[str, ...] = ()  #: what was not checked
    convention: str = "the convention of the log and the model that the motion was planned with"  #: of positions
    share: float = 1.0  #: of the planned speed; 1 unless `slowed`

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.joint_names)

    def slowed(self, share: float) -> PlannedMotion:
        """The same path at a share of the speed, above 0 and at most 1: q(t) = q(share t)."""
        full = self.at

        def at(t: Array) -> Motion:
            motion = full(share * t)
            return Motion(t, motion.q, share * motion.dq, share**2 * motion.ddq)

        return replace(self, at=at, duration=self.duration / share, share=share * self.share)

    def sampled(self, cycle: float | None = None) -> Motion:
        """The motion once per cycle, s, 1 / rate by default; the last row, at or after the end, is the end pose."""
        step = 1.0 / self.rate if cycle is None else cycle
        cycles = int(np.ceil(self.duration / step - 1e-6))  # a duration of whole cycles, but for rounding
        t = step * np.arange(cycles + 1, dtype=np.float64)
        motion = self.at(np.minimum(t, self.duration))
        return Motion(t, motion.q, motion.dq, motion.ddq)

    def points(self, most: int, between: Between) -> tuple[Motion, float]:
        """The motion at equidistant points, and the largest deviation, rad (m), of their interpolation.

        There are at most `most` intervals; InputError if the deviation is then too large.
        """
        intervals = min(TUNING.fewest_intervals, most)
        while True:
            t = np.linspace(0.0, self.duration, intervals + 1)
            dense = np.linspace(0.0, self.duration, TUNING.samples_per_interval * intervals + 1)
            motion = self.at(t)
            deviation = float(np.abs(between(motion, dense) - self.at(dense).q).max())
            if deviation <= TUNING.fine or intervals == most:
                break
            intervals = min(2 * intervals, most)
        if not deviation <= TUNING.coarse:
            limit = f"at most {TUNING.coarse:g} is allowed"
            problem = f"{intervals} intervals are too few: interpolation deviates by {deviation:.2g} rad (m), {limit}"
            raise InputError(problem, self.robot, "plan a shorter or slower motion")
        return Motion(t, motion.q, motion.dq, motion.ddq), deviation

    def head(self, mark: str, *more: str) -> list[str]:
        """Comment lines: robot, duration, checks made and not made, then the given lines."""
        never = "the way to the start pose", "the controller's own limits"
        lines = [
            f"robot: {self.robot}, joints: {', '.join(self.joint_names)}",
            f"duration: {self.duration:.9g} s, at {100.0 * self.share:.3g} % of the planned speed",
            f"checked: {'; '.join(self.checked) or 'nothing'}",
            f"NOT checked: {'; '.join(dict.fromkeys((*self.not_checked, *never)))}",
            f"positions follow {self.convention}: compare one pose first",
            "made by bayesid; not run on a controller",
            *more,
        ]
        return [f"{mark} {part}" for line in lines for part in textwrap.wrap(_ascii(line), 100)]


def cubic(points: Motion, t: Array) -> Array:
    """Cubic spline through points, at rest at both ends; approximates a controller's unpublished spline."""
    values: Array = scipy.interpolate.CubicSpline(points.t, points.q, bc_type="clamped")(t)
    return values


def quintic(points: Motion, t: Array) -> Array:
    """Positions of the quintics that meet positions, velocities and accelerations at both ends of each interval."""
    table = np.stack([points.q, points.dq, points.ddq], axis=1)
    values: Array = scipy.interpolate.BPoly.from_derivatives(points.t, table)(t)
    return values


def _decimals(values: Array) -> list[list[str]]:
    """Rows of numbers (N, n) with six decimals, without -0."""
    return [[f"{value:.6f}" for value in row] for row in (np.round(values, 6) + 0.0).tolist()]


def _ascii(text: str) -> str:
    """A text on one line, in ASCII, which all controllers read."""
    return printable(text).encode("ascii", "backslashreplace").decode("ascii")


# ---- ROS 2 ----
def joint_trajectory(planned: PlannedMotion) -> str:
    """joint_trajectory.yaml: points with positions, velocities and accelerations, the first after a lead time.

    From all three a joint_trajectory_controller interpolates quintics. InputError if the deviation is too large for a
    file that fits into one command-line argument.
    """
    bytes_of_point = 100 + 3 * 11 * planned.n_joints  # at most 11 per number
    points, deviation = planned.points(TUNING.ros_bytes // bytes_of_point, quintic)
    head = planned.head(
        "#",
        f"largest deviation from the motion: {deviation:.2g} rad (m), with quintics between the points",
        f"the first {TUNING.ros_lead:g} s move the robot from its current pose to the start pose: jog it near it first",
    )
    lines = [
        *head,
        "# ros2 topic pub --once /joint_trajectory_controller/joint_trajectory trajectory_msgs/msg/JointTrajectory "
        '"$(cat joint_trajectory.yaml)"',
        "header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}",
        f"joint_names: {json.dumps(planned.joint_names)}",
        "points:",
    ]
    for t, *rows in zip(points.t, _decimals(points.q), _decimals(points.dq), _decimals(points.ddq), strict=True):
        seconds, nanoseconds = divmod(round((TUNING.ros_lead + t) * 1_000_000_000), 1_000_000_000)
        q, dq, ddq = (", ".join(row) for row in rows)
        lines.append(
            f"- {{positions: [{q}], velocities: [{dq}], accelerations: [{ddq}], "
            f"time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}}}"
        )
    return "\n".join(lines) + "\n"


# ---- Universal Robots: The URScript Programming Language, Universal Robots A/S, versions 3.2 and 5 ----
def urscript(planned: PlannedMotion) -> str:
    """motion.script: movej to the start pose, a servoj for each cycle of the motion, stopj.

    The cycle is the multiple of the controller's nearest to 1 / rate. InputError unless the robot has six revolute
    joints.
    """
    if planned.n_joints != 6 or any(planned.prismatic):
        found = f"{planned.n_joints} joints{', some prismatic' if any(planned.prismatic) else ''}"
        problem = f"a UR robot has six revolute joints, this one has {found}"
        raise InputError(problem, planned.robot, "use joint_trajectory.yaml or motion.csv")
    of_controller = 0.002  # s, cycle since version 5; 0.008 s in version 3
    cycle = of_controller * max(1, round(1.0 / (planned.rate * of_controller)))
    lookahead, gain, stop = 0.1, 300, 2.0  # of servoj, s and 1, and of stopj, rad/s^2: the manual's defaults
    poses = [f"[{','.join(row)}]" for row in _decimals(planned.sampled(cycle).q)]
    head = planned.head(
        "#",
        "URScript program of the motion, rad",
        f"one servoj per {1e3 * cycle:g} ms cycle (t); the path lags by its lookahead time, {lookahead:g} s",
        "set the payload first; keep the speed slider at 100 %",
    )
    lines = [
        *head,
        "def motion():",
        "  def to(q):",
        f"    servoj(q, 0, 0, {cycle:.3f}, {lookahead:g}, {gain})",
        "  end",
        f"  movej({poses[0]}, {TUNING.urscript_approach})",
        "  sleep(1.0)",
        *(f"  to({pose})" for pose in poses),
        f"  stopj({stop:g})",
        "end",
    ]
    return "\n".join(lines) + "\n"


# ---- KUKA: names of axes, units (degrees, mm), PTP_SPLINE with SPTP segments and TIME_BLOCK as in KUKA System Software
# 8.3, Operating and Programming Instructions for System Integrators, KUKA Roboter GmbH 2015
_AXIS = re.compile(r"(?:.*_)?([AE][1-6])", re.IGNORECASE)
"""A joint's name that ends with a KRL axis name: A1, e1, joint_a1."""


def krl_program(planned: PlannedMotion) -> str:
    """motion.src: slow PTP to the start pose, then the motion as a spline block of SPTP segments with TIME_BLOCK.

    InputError if KRL has no names for the joints (`krl_axes`), or the motion needs too many segments.
    """
    axes = krl_axes(planned)
    points, deviation = planned.points(TUNING.krl_intervals, cubic)
    units = _krl_units(planned)
    poses = [f"{{{_named(axes, row)}}}" for row in _decimals(points.q * units)]
    head = planned.head(
        ";",
        "KRL program of the motion, axes in degrees (mm if prismatic)",
        f"largest deviation from the motion: {(deviation * units).max():.2g} degrees (mm), with a cubic spline "
        "between the points; the controller uses its own spline, and exceeds TIME_BLOCK END where an axis is too slow",
        "set the load data of the flange first; run the program in T1 first",
    )
    part = 100.0 / (len(poses) - 1)
    lines = [
        "&ACCESS RVP",
        "DEF motion( )",
        *head,
        "BAS(#INITMOV,0)",
        f"BAS(#VEL_PTP,{TUNING.krl_approach})",
        f"BAS(#ACC_PTP,{TUNING.krl_approach})",
        f"PTP {poses[0]}",
        "WAIT SEC 1.0",
        "BAS(#VEL_PTP,100)",
        "BAS(#ACC_PTP,100)",
        "PTP_SPLINE",
        f"  SPTP {poses[0]}",
        "  TIME_BLOCK START",
        *(f"  SPTP {pose}\n  TIME_BLOCK PART = {part:.6f}" for pose in poses[1:]),
        f"  TIME_BLOCK END = {planned.duration:.4f}",
        "ENDSPLINE",
        "END",
    ]
    return "\n".join(lines) + "\n"


def rsi_table(planned: PlannedMotion) -> str:
    """rsi.csv: axis corrections from the start pose, one row per RSI cycle, of the cycle nearest to 1 / rate."""
    axes = krl_axes(planned)
    cycle = min((0.004, 0.012), key=lambda seconds: abs(seconds - 1.0 / planned.rate))  # IPO_FAST and IPO
    q = planned.sampled(cycle).q
    start = _decimals(q[:1] * _krl_units(planned))[0]
    head = planned.head(
        "#",
        f"table of axis corrections for RSI: one row per {1e3 * cycle:g} ms, degrees (mm for prismatic axes)",
        "corrections are relative to the start pose (absolute mode), not to the previous row; move there first:",
        _named(axes, start),
    )
    rows = [",".join(row) for row in _decimals((q - q[0]) * _krl_units(planned))]
    return "\n".join([*head, ",".join(axes), *rows]) + "\n"


def krl_axes(planned: PlannedMotion) -> list[str]:
    """KRL's axis names: from the ends of the joints' names (A1, joint_e1), or A1 to A6 in order.

    InputError if there are more than six joints and their names do not end with KRL axis names.
    """
    found = [match and match[1].upper() for match in map(_AXIS.fullmatch, planned.joint_names)]
    named = [axis for axis in found if axis]
    if len(set(named)) == planned.n_joints:
        return named
    if planned.n_joints > 6:
        problem = f"{planned.n_joints} joints need names that end with KRL's axes, A1 to A6 and E1 to E6"
        raise InputError(problem, planned.robot, "name the joints in the robot's file, such as joint_a1 and joint_e1")
    return [f"A{j}" for j in range(1, planned.n_joints + 1)]


def _krl_units(planned: PlannedMotion) -> Array:
    return np.where(planned.prismatic, 1e3, np.degrees(1.0))


def _named(axes: list[str], row: list[str]) -> str:
    return ", ".join(f"{axis} {value}" for axis, value in zip(axes, row, strict=True))


# ---- All programs, in one folder per speed ----
_TABLE = "motion.csv"
_WRITERS: Mapping[str, Callable[[PlannedMotion], str]] = {
    "joint_trajectory.yaml": joint_trajectory,
    "motion.script": urscript,
    "motion.src": krl_program,
    "rsi.csv": rsi_table,
}
PROGRAM_FILES = frozenset({_TABLE, *_WRITERS})
"""Files of a speed's folder."""


def _speed_folder(share: float) -> str:
    return f"speed_{100.0 * share:.0f}"


PROGRAM_FOLDERS = frozenset(map(_speed_folder, SPEEDS))
"""Folders that `save_programs` writes."""


@dataclass(frozen=True)
class Programs:
    """Files that `save_programs` wrote."""

    folders: tuple[Path, ...]  #: one per speed, the slowest first
    files: tuple[str, ...]  #: names of the files in each of them
    left_out: Mapping[str, str]  #: files that were not written for this robot, with the reason


def save_programs(planned: PlannedMotion, place: Path, shares: Sequence[float] = SPEEDS) -> Programs:
    """Writes the motion as a table and as programs of controllers, into one folder per share of its speed."""
    left_out, files = {}, [_TABLE]
    folders = tuple(place / _speed_folder(share) for share in shares)
    motions = [planned.slowed(share) for share in shares]
    for folder, motion in zip(folders, motions, strict=True):
        folder.mkdir()
        write_motion(folder / _TABLE, motion.sampled())
    for name, text in _WRITERS.items():
        try:
            texts = [text(motion) for motion in motions]
        except InputError as error:
            left_out[name] = str(error)
            continue
        files.append(name)
        for folder, content in zip(folders, texts, strict=True):
            (folder / name).write_text(content, encoding="ascii", newline="\n")
    return Programs(folders, tuple(sorted(files)), left_out)


def check_programs(folder: Path) -> None:
    """InputError if the folders of an earlier motion hold files other than programs."""
    for name in sorted(PROGRAM_FOLDERS):
        inside = folder / name
        foreign = {path.name for path in inside.iterdir()} - PROGRAM_FILES if inside.is_dir() else set()
        if foreign:
            raise InputError(f"holds other files ({min(foreign)})", str(inside), "give `folder` a new folder")
