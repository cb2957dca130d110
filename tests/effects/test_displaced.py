"""Parts of a robot moved, against tables with another number."""

import numpy as np
import pytest
from oracles import random_table

from bayesid.effects.kinematic_errors import JointZero, LinkLength, LinkOffset, LinkTwist, is_distal
from bayesid.robot import Joint, Robot, robot_from_table
from bayesid.robot.kinematics import pose

STEP = 0.03
Q = np.array([0.3, -0.8, 0.5, 1.1])
NUMBERS = {"a": LinkLength, "alpha": LinkTwist, "d": LinkOffset, "theta": JointZero}


def changed(table, row, number):
    rows = [{**one, number: one[number] + STEP * (i == row)} for i, one in enumerate(table["joints"])]
    return robot_from_table({**table, "joints": rows}, "changed")


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("number", NUMBERS)
def test_moves_are_those_of_the_table(convention, number):
    table = random_table(convention, 4, seed=2)
    robot = robot_from_table(table, "told")
    assert is_distal(robot) == (convention == "standard")
    for row in range(4):
        moved = NUMBERS[number](joints=(row + 1,), error=(STEP,)).building(robot)
        expected = changed(table, row, number)
        np.testing.assert_allclose(pose(moved, Q).flange, pose(expected, Q).flange, atol=1e-12)
        ends = [pose(one, Q).joint_frames @ np.stack([j.link_frame for j in one.joints]) for one in (moved, expected)]
        np.testing.assert_allclose(*ends, atol=1e-12)  # links are where the changed table has them


def test_of_a_robot_without_a_table_the_common_normal_grows():
    """Two skew axes, neither along z, the second frame away from the common normal: distance and angle change alone."""
    turned = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turned, [0.3, -0.2, 0.5]
    joints = Joint(np.eye(4), np.array([0.0, 1.0, 0.0])), Joint(place, np.array([0.6, 0.0, 0.8]), parent=0)
    robot = Robot("arm", joints, np.array([0.0, 0.0, -9.81]))

    def numbers(one):
        here = pose(one)
        line, (first, second) = here.lines[1], here.axes
        return np.linalg.norm(line[2] - line[1]), np.arccos(first @ second)

    distance, angle = numbers(robot)
    longer, twisted = (kind(joints=(2,), error=(STEP,)).building(robot) for kind in (LinkLength, LinkTwist))
    np.testing.assert_allclose(numbers(longer), (distance + STEP, angle), rtol=1e-12)
    np.testing.assert_allclose(numbers(twisted)[0], distance, rtol=1e-12)
    assert abs(abs(numbers(twisted)[1] - angle) - STEP) < 1e-12
