import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from exported_robots import ROBOTS, dofs, in_mujoco, in_pinocchio
from oracles import assert_close, dh_chain, parameters_of, random_clouds, random_motion, random_table, turn
from oracles import joint_torques as torques_of_points

from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.export import urdf
from bayesid.export.model_text import roll_pitch_yaw
from bayesid.robot import robot_from_table, robot_from_urdf

HELD = {"staubli_tx40": [1, 1, 1, 1, 1, 0]}
"""Of robots with a transmission: whether a motor's friction is its joint's; the TX40's motor 6 turns with 5 and 6."""
MUJOCO = 1e-9 if int(mujoco.__version__.split(".")[0]) >= 4 else 1e-6
"""Share of the torques; before version 4 MuJoCo diagonalises a URDF's inertias to seven digits."""


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


@pytest.fixture
def model(robot):
    return Model(robot, make_terms(STANDARD, robot, random_motion(robot.n_joints)))


@pytest.fixture
def theta(model):
    n = model.robot.n_joints
    return np.concatenate([parameters_of(random_clouds(n, seed=n)), np.random.default_rng(5).uniform(0.1, 2.0, 4 * n)])


def joint_torques(model, motion, theta):
    """Torques at the joints, before any motor coupling, of the rigid bodies."""
    return replace(model.robot, transmission=None).inverse_dynamics(motion, theta[: 10 * model.robot.n_joints])


def test_pinocchio_and_mujoco_find_the_same_torques(model, theta):
    """MuJoCo reads gravity too, from an element of its own."""
    text, motion, n = urdf(model, theta), random_motion(model.robot.n_joints, 20), model.robot.n_joints
    expected = joint_torques(model, motion, theta)
    assert_close(in_pinocchio(pin.buildModelFromXML(text), model.robot.gravity, motion), expected, 1e-12)
    loaded = mujoco.MjModel.from_xml_string(text)
    held, order = HELD.get(model.robot.name, np.ones(n)), dofs(loaded)
    np.testing.assert_allclose(loaded.dof_damping[order], theta[10 * n : 11 * n] * held, rtol=1e-15)
    np.testing.assert_allclose(loaded.dof_frictionloss[order], theta[11 * n : 12 * n] * held, rtol=1e-15)
    loaded.dof_damping[:] = loaded.dof_frictionloss[:] = 0.0
    assert_close(in_mujoco(loaded, motion), expected, MUJOCO)


def test_bayesid_loads_it_again(model, theta):
    """In the exported robot the links' frames are the joints'; the point masses are moved there by hand."""
    n = model.robot.n_joints
    again = replace(robot_from_urdf(urdf(model, theta), "test"), gravity=model.robot.gravity)
    frames = [joint.link_frame for joint in model.robot.joints]
    clouds = zip(random_clouds(n, seed=n), frames, strict=True)
    moved = [(points @ frame[:3, :3].T + frame[:3, 3], masses) for (points, masses), frame in clouds]
    motion = random_motion(n, 5)
    assert_close(again.inverse_dynamics(motion, parameters_of(moved)), joint_torques(model, motion, theta), 1e-12)
    for joint, original in zip(again.joints, model.robot.joints, strict=True):
        np.testing.assert_allclose(joint.placement, original.placement, rtol=0, atol=1e-15)
        np.testing.assert_allclose(joint.axis, original.axis, rtol=0, atol=1e-15)
    own_frames = all(np.array_equal(frame, np.eye(4)) for frame in frames)
    assert again.same_kinematics(replace(model.robot, transmission=None)) == own_frames


SPEED = 0.4  # rad/s, of the tanh that stands for the direction of motion
DAMPING = [1.5, 0.0, 2.0 + 0.25, 0.0, 0.75, 0.0]  # N m s/rad, of the terms below
DRY = [0.0, 6.0, 4.0 + 1.0, 3.0 + 2.0, 0.0, 7.0]  # N m


def loaded_arm(convention):
    """A robot's table and a model: a payload, and friction of several terms in some joints, in no order."""
    table = random_table(convention, 6, seed=8)
    terms = [
        ("coulomb_friction", {"joints": [3], "smoothing": [SPEED]}, [4.0]),
        ("viscous_friction", {"joints": [5, 1, 3]}, [0.75, 1.5, 2.0]),
        ("payload", {}, parameters_of([PAYLOAD])),
        ("coulomb_friction", {"joints": [6, 4], "smoothing": [SPEED] * 2}, [7.0, 3.0]),
        ("rigid_body", {}, parameters_of(random_clouds(6, seed=8))),
        ("viscous_friction", {"joints": [3]}, [0.25]),
        ("coulomb_friction", {"joints": [2, 3, 4], "smoothing": [SPEED] * 3}, [6.0, 1.0, 2.0]),
    ]
    model = Model(robot_from_table(table, "test"), tuple(make_effect(name, shape) for name, shape, _ in terms))
    return table, model, np.concatenate([values for *_, values in terms])


PAYLOAD = random_clouds(1, seed=30)[0]


def by_hand(table, motion):
    """Torques of point masses, those of the payload on the last link, with viscous friction."""
    *clouds, (points, masses) = random_clouds(6, seed=8)
    last = np.concatenate([points, PAYLOAD[0]]), np.concatenate([masses, PAYLOAD[1]])
    rigid = torques_of_points(dh_chain(table), [*clouds, last], np.array(table["gravity"]), motion)
    return rigid + DAMPING * motion.dq


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_payload_and_friction_of_some_joints(convention):
    table, model, theta = loaded_arm(convention)
    text, motion = urdf(model, theta), random_motion(6, 20)
    loaded = pin.buildModelFromXML(text)
    np.testing.assert_allclose(loaded.damping, DAMPING, rtol=1e-15)
    np.testing.assert_allclose(loaded.friction, DRY, rtol=1e-15)
    found = in_pinocchio(loaded, model.robot.gravity, motion) + loaded.damping * motion.dq
    assert_close(found, by_hand(table, motion), 1e-11)
    assert_close(found + loaded.friction * np.tanh(motion.dq / SPEED), model.effort(motion, theta), 1e-12)
    simulated = mujoco.MjModel.from_xml_string(text)
    np.testing.assert_allclose(simulated.dof_frictionloss, DRY, rtol=1e-15)
    simulated.dof_frictionloss[:] = 0.0
    assert_close(in_mujoco(simulated, motion), by_hand(table, motion), MUJOCO)
    dynamics = [joint.find("dynamics") for joint in ET.fromstring(text).findall("joint")]
    kinds = [{"damping"}, {"friction"}, {"damping", "friction"}, {"friction"}, {"damping"}, {"friction"}]
    assert [set(element.attrib) for element in dynamics] == kinds
    assert "link6 includes the payload" in text
    assert [name for name in ("mcxp6", "Fc") if name in text] == []


def test_angles_give_the_rotation_back():
    def rotation(roll, pitch, yaw):
        return turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)

    angles = (-3.1, -np.pi / 2, -0.4, 0.0, 1e-9, np.pi / 2, 1.2, np.pi)
    for roll, pitch, yaw in product(angles, (*angles, np.pi / 2 - 1e-8, 1e-12 - np.pi / 2), angles):
        expected = rotation(roll, pitch, yaw)
        np.testing.assert_allclose(rotation(*roll_pitch_yaw(expected)), expected, rtol=0, atol=2e-15)


EDGES = {  # points in each body, their masses' share of the usual, and how far the moments of inertia are off
    "points": ([1] * 6, [1.0] * 6, 0.0),
    "rods": ([2] * 6, [1.0] * 6, 0.0),
    "plates": ([3] * 6, [1.0] * 6, 0.0),
    "outside": ([1, 2, 3, 1, 2, 3], [1.0] * 6, -1e-13),  # where a solver may end
    "heavy and light": ([2, 3, 3, 1, 2, 1], [1e6, 1e5, 1e4, 1e-9, 1.0, 1e-12], 0.0),
}


@pytest.mark.parametrize("edge", EDGES)
def test_bodies_without_thickness_load_everywhere(edge):
    """MuJoCo refuses inertias that rounding has put outside the triangle inequality, or that are zero."""
    table, (counts, shares, off) = random_table("standard", 6, seed=11), EDGES[edge]
    robot = robot_from_table(table, "test")
    full = zip(random_clouds(6, seed=11), counts, shares, strict=True)
    clouds = [(points[:count], share * masses[:count]) for (points, masses), count, share in full]
    theta = parameters_of(clouds).reshape(6, 10)
    theta[:, [0, 3, 5]] *= 1.0 + off
    text, motion = urdf(Model(robot, (RigidBody(),)), theta.ravel()), random_motion(6, 20)
    expected = torques_of_points(dh_chain(table), clouds, robot.gravity, motion)
    assert_close(in_mujoco(mujoco.MjModel.from_xml_string(text), motion), expected, max(MUJOCO, 1e-8))
    assert_close(in_pinocchio(pin.buildModelFromXML(text), robot.gravity, motion), expected, 1e-8)
