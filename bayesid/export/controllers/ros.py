"""ROS 2: the motion as a trajectory_msgs/msg/JointTrajectory in YAML."""

from __future__ import annotations

import json

import numpy as np

from bayesid.export.controllers.planned import PlannedMotion
from bayesid.export.controllers.via_points import quintic, via_points

_ARGUMENT = 120_000
"""Bytes of the file, about: Linux passes 128 KiB (MAX_ARG_STRLEN) as one argument, which "$(cat FILE)" is."""
_NUMBER, _AROUND = 11, 100
"""Bytes of a number and of what stands around those of a point, at most."""
_LEAD = 10.0
"""s, to get to the start pose, which a controller does from wherever the robot is: half a turn then peaks at 0.6 rad/s,
as a quintic from rest to rest peaks at 15 / 8 of its mean. A round number."""
_NANO = 1_000_000_000


def joint_trajectory(planned: PlannedMotion) -> str:
    """joint_trajectory.yaml: points with positions, velocities and accelerations, the first after a lead.

    Between points a joint_trajectory_controller puts quintics when it is given all three.

    Raises:
        InputError: as many points as one argument of a command holds do not tell the motion.
    """
    most = _ARGUMENT // (_AROUND + 3 * planned.n_joints * _NUMBER)
    points = via_points(planned, most, quintic)
    head = planned.head(
        "#",
        f"between its points, which quintics join, it is {points.deviation:.2g} rad (m) from the motion at most",
        f"the first {_LEAD:g} s bring the robot to the start pose from wherever it is: move it near by hand before",
    )
    lines = [
        *head,
        "# ros2 topic pub --once /joint_trajectory_controller/joint_trajectory trajectory_msgs/msg/JointTrajectory "
        '"$(cat joint_trajectory.yaml)"',
        "header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}",
        f"joint_names: {json.dumps(planned.joint_names)}",
        "points:",
    ]
    motion = points.motion
    for t, *rows in zip(motion.t, motion.q, motion.dq, motion.ddq, strict=True):
        seconds, nanoseconds = divmod(round((_LEAD + t) * _NANO), _NANO)
        q, dq, ddq = ([f"{value:.6f}" for value in (np.round(row, 6) + 0.0).tolist()] for row in rows)
        lines.append(
            f"- {{positions: [{', '.join(q)}], velocities: [{', '.join(dq)}], accelerations: [{', '.join(ddq)}], "
            f"time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}}}"
        )
    return "\n".join(lines) + "\n"
