"""How efforts change with the geometry: against tables with changed numbers, and dynamics worked out apart."""

from copy import deepcopy
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from oracles import (
    actuator_efforts,
    assert_close,
    dh_chain,
    joint_torques,
    parameters_of,
    random_clouds,
    random_motion,
    random_table,
)
from scipy.spatial.transform import Rotation

from bayesid.regression.knowledge import KinematicTolerance
from bayesid.regression.selection.unseen import kinematic_columns
from bayesid.robot import robot_from_table

JOINTS = 3
TOLERANCE = KinematicTolerance(length=0.002, angle=0.005)
STEP = 1e-5
"""m or rad, of central differences: their error is some 1e-9 of the efforts, and so is that of the columns."""
CLOSE = 1e-6


def made(seed=4, coupled=False):
    table = random_table("modified", JOINTS, seed, coupled=coupled)
    return table, random_motion(JOINTS, samples=5, seed=seed), random_clouds(JOINTS, seed=seed)


def columns_of(table, motion, clouds, tolerance=TOLERANCE):
    return kinematic_columns(robot_from_table(table, "test"), motion, parameters_of(clouds), tolerance)


def slope(table, motion, clouds, joint, key):
    """(N, n) derivative of the efforts by one number of the table: point masses, the principle of virtual work."""
    efforts = []
    for step in (STEP, -STEP):
        changed = deepcopy(table)
        changed["joints"][joint][key] += step
        torques = joint_torques(dh_chain(changed), clouds, np.array(table["gravity"]), motion)
        gears = table.get("transmission")
        efforts.append(torques if gears is None else actuator_efforts(torques, np.array(gears)))
    return (efforts[0] - efforts[1]) / (2.0 * STEP)


def displacement(row, key):
    """(6,) of a joint's own frame, by a number of its row: shift and turn, as its own axes see them.

    A frame is reached from the one before it by a turn alpha about x, a step a along x, a turn theta about z and a step
    d along z; a turn about the x axis of the frame before carries the origin, which is off that axis, along.
    """
    to_own = Rotation.from_euler("z", row["theta"]).inv()
    along_x = to_own.apply([1.0, 0.0, 0.0])
    changes = {
        "a": (along_x, np.zeros(3)),
        "alpha": (to_own.apply(np.cross([1.0, 0.0, 0.0], [row["a"], 0.0, row["d"]])), along_x),
        "d": (np.array([0.0, 0.0, 1.0]), np.zeros(3)),
        "theta": (np.zeros(3), np.array([0.0, 0.0, 1.0])),
    }
    return np.concatenate(changes[key])


@pytest.mark.parametrize("coupled", [False, True])
def test_numbers_of_the_table_are_displacements_of_joints(coupled):
    """Of every one of them, the second joint of three sliding; of a coupled one, efforts are the motors'."""
    table, motion, clouds = made(coupled=coupled)
    unit = columns_of(table, motion, clouds).reshape(5, JOINTS, JOINTS, 6) / np.repeat(
        [TOLERANCE.length, TOLERANCE.angle], 3
    )
    for joint, key in product(range(JOINTS), ("a", "alpha", "d", "theta")):
        expected = slope(table, motion, clouds, joint, key)
        found = unit[:, :, joint] @ displacement(table["joints"][joint], key)
        np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE * np.abs(unit).max())  # a shifted base: nothing


def test_in_the_standard_convention_they_are_the_numbers_of_the_table():
    """After those of the base: d, theta, a and alpha of each row; links' frames, and what is stated in them, go along.

    Of a sliding joint d changes nothing, and of the row of the last link everything is about its own frame.
    """
    table, motion, clouds = random_table("standard", JOINTS, 8), random_motion(JOINTS, 5, 8), random_clouds(JOINTS, 8)
    columns = columns_of(table, motion, clouds)
    assert columns.shape == (5, JOINTS, 6 + 4 * JOINTS)
    unit = columns[:, :, 6:].reshape(5, JOINTS, JOINTS, 4) / ([TOLERANCE.length, TOLERANCE.angle] * 2)
    for joint, (k, key) in product(range(JOINTS), enumerate(("d", "theta", "a", "alpha"))):
        expected = slope(table, motion, clouds, joint, key)
        assert joint < JOINTS - 1 or np.abs(expected).max() > 1e-3 * np.abs(unit).max()
        np.testing.assert_allclose(unit[:, :, joint, k], expected, rtol=0, atol=CLOSE * np.abs(unit).max())


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_of_a_known_robot_only_later_joints_are_elsewhere(convention):
    """Not its base, and its links' parameters stay about the axes that they were identified about."""
    table, motion, links = random_table(convention, JOINTS, 8), random_motion(JOINTS, 5, 8), random_clouds(JOINTS, 8)
    robot, parameters = robot_from_table(table, "test"), parameters_of(links)
    known = kinematic_columns(robot, motion, parameters, TOLERANCE, known=True)
    assert known.shape == (5, JOINTS, 6 * (JOINTS - 1))
    every = kinematic_columns(robot, motion, parameters, TOLERANCE)
    assert convention == "standard" or np.array_equal(known, every[:, :, 6:])
    step, shifted = 1e-5, []
    for sign in (1.0, -1.0):
        joint = replace(robot.joints[2], placement=robot.joints[2].placement @ shift_along_y(sign * step))
        there = replace(robot, joints=(*robot.joints[:2], joint))
        shifted.append(there.inverse_dynamics(motion, parameters))
    assert_close(known[:, :, 7], TOLERANCE.length * (shifted[0] - shifted[1]) / (2.0 * step), CLOSE)


def shift_along_y(length):
    move = np.eye(4)
    move[1, 3] = length
    return move


@pytest.mark.parametrize(("length", "angle", "kept"), [(0.0, 0.005, [3, 4, 5]), (0.002, 0.0, [0, 1, 2])])
def test_what_is_exact_has_no_columns(length, angle, kept):
    table, motion, clouds = made()
    every = columns_of(table, motion, clouds).reshape(5, JOINTS, JOINTS, 6)
    found = columns_of(table, motion, clouds, KinematicTolerance(length=length, angle=angle))
    np.testing.assert_array_equal(found, every[..., kept].reshape(5, JOINTS, -1))


def test_what_is_no_tolerance_is_refused():
    for length, angle in ((-1e-3, 0.1), (1e-3, -0.1), (np.nan, 0.1), (1e-3, np.inf)):
        with pytest.raises(ValueError, match="tolerance"):
            KinematicTolerance(length=length, angle=angle)
