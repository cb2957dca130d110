"""ROS 2: the motion as a trajectory_msgs/msg/JointTrajectory in YAML."""

from __future__ import annotations

import json

from bayesid.export.controllers.planned import PlannedMotion, decimals, quintic
from bayesid.export.tuning import TUNING

_NUMBER, _AROUND = 11, 100
"""Bytes of a number and of what stands around those of a point, at most."""


def joint_trajectory(planned: PlannedMotion) -> str:
    """joint_trajectory.yaml: points with positions, velocities and accelerations, the first after a lead.

    Between points a joint_trajectory_controller puts quintics when it is given all three.

    Raises:
        InputError: as many points as one argument of a command holds do not tell the motion.
    """
    points, deviation = planned.points(TUNING.ros_bytes // (_AROUND + 3 * planned.n_joints * _NUMBER), quintic)
    head = planned.head(
        "#",
        f"between its points, which quintics join, it is {deviation:.2g} rad (m) from the motion at most",
        f"the first {TUNING.ros_lead:g} s bring the robot to the start pose from wherever it is: move it near by hand "
        "before",
    )
    lines = [
        *head,
        "# ros2 topic pub --once /joint_trajectory_controller/joint_trajectory trajectory_msgs/msg/JointTrajectory "
        '"$(cat joint_trajectory.yaml)"',
        "header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}",
        f"joint_names: {json.dumps(planned.joint_names)}",
        "points:",
    ]
    for t, *rows in zip(points.t, decimals(points.q), decimals(points.dq), decimals(points.ddq), strict=True):
        seconds, nanoseconds = divmod(round((TUNING.ros_lead + t) * 1_000_000_000), 1_000_000_000)
        q, dq, ddq = (", ".join(row) for row in rows)
        lines.append(
            f"- {{positions: [{q}], velocities: [{dq}], accelerations: [{ddq}], "
            f"time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}}}"
        )
    return "\n".join(lines) + "\n"
