"""Robots: kinematics, transmission, shapes, and their files."""

from bayesid.robot.arm import Joint, Robot
from bayesid.robot.dh_table import robot_from_table, robot_table
from bayesid.robot.load import BUILT_IN, check_joints, load_robot
from bayesid.robot.urdf import robot_from_urdf

__all__ = [
    "BUILT_IN",
    "Joint",
    "Robot",
    "check_joints",
    "load_robot",
    "robot_from_table",
    "robot_from_urdf",
    "robot_table",
]
