import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from oracles import assert_close, parameters_of, random_clouds, random_motion, random_table, turn, urdf_text

from bayesid.export import _roll_pitch_yaw, urdf
from bayesid.model import Model
from bayesid.robot import BUILT_IN, Joint, Robot, load_robot, robot_from_table, robot_from_urdf
from bayesid.terms import DEFAULT, RigidBody, ViscousFriction, make_terms

MOVES = {name: load_robot(name) for name in BUILT_IN} | {
    "standard": robot_from_table(random_table("standard", 6, seed=1), "test"),
    "modified": robot_from_table(random_table("modified", 7, seed=2), "test"),
    "coupled": robot_from_table(random_table("standard", 4, seed=3, coupled=True), "test"),
    "urdf": replace(robot_from_urdf(urdf_text(), "test"), gravity=np.array([1.0, -2.0, -9.0])),
}


@pytest.fixture(params=MOVES)
def robot(request):
    return MOVES[request.param]


@pytest.fixture
def model(robot):
    return Model(robot, make_terms(DEFAULT, robot, random_motion(robot.n_joints)))


@pytest.fixture
def theta(model):
    n = model.robot.n_joints
    return np.concatenate([parameters_of(random_clouds(n, seed=n)), np.random.default_rng(5).uniform(0.1, 2.0, 4 * n)])


def joint_torques(model, motion, theta):
    """Torques at the joints, before any motor coupling, of the rigid bodies."""
    return replace(model.robot, transmission=None).inverse_dynamics(motion, theta[: 10 * model.robot.n_joints])


def test_pinocchio_finds_the_same_torques(model, theta):
    loaded = pin.buildModelFromXML(urdf(model, theta))
    loaded.gravity.linear = model.robot.gravity
    data, motion = loaded.createData(), random_motion(model.robot.n_joints, 20)
    found = [pin.rnea(loaded, data, *sample) for sample in zip(motion.q, motion.dq, motion.ddq, strict=True)]
    assert_close(np.array(found), joint_torques(model, motion, theta), 1e-12)


def test_mujoco_finds_the_same_torques(model, theta):
    options = '<mujoco><compiler balanceinertia="false" inertiafromgeom="false" discardvisual="true"/></mujoco>'
    loaded = mujoco.MjModel.from_xml_string(urdf(model, theta).replace("</robot>", f"{options}</robot>"))
    n = model.robot.n_joints
    held = model.robot.transmission is None
    np.testing.assert_allclose(loaded.dof_damping, theta[10 * n : 11 * n] * held, rtol=1e-15)
    np.testing.assert_allclose(loaded.dof_frictionloss, theta[11 * n : 12 * n] * held, rtol=1e-15)
    loaded.dof_damping[:], loaded.dof_frictionloss[:], loaded.opt.gravity[:] = 0.0, 0.0, model.robot.gravity
    data, motion, found = mujoco.MjData(loaded), random_motion(n, 20), []
    for sample in zip(motion.q, motion.dq, motion.ddq, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = sample
        mujoco.mj_inverse(loaded, data)
        found.append(data.qfrc_inverse.copy())
    assert_close(np.array(found), joint_torques(model, motion, theta), 1e-9)


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


def test_effects_without_a_place_are_in_the_comment(model, theta):
    text = urdf(model, theta)
    comment = text[text.index("<!--") : text.index("-->")]
    for parameter, value in list(zip(model.parameters, theta, strict=True))[10 * model.robot.n_joints :]:
        held = parameter.name[:2] in ("Fv", "Fc") and model.robot.transmission is None
        assert (f"{parameter.name} = {float(value)!r} {parameter.unit}" in comment) != held
    assert f"gravity = {' '.join(map(str, model.robot.gravity.tolist()))} m/s^2" in comment
    assert ("motor speeds" in comment) == (model.robot.transmission is not None)
    assert (ET.fromstring(text).find("joint/dynamics") is None) == (model.robot.transmission is not None)


def test_terms_may_be_absent_or_come_in_another_order():
    robot = MOVES["standard"]
    bodies, friction = parameters_of(random_clouds(6)), np.array([0.1, 0.2, -1e-12, 0.4, 0.5, 0.6])
    root = ET.fromstring(urdf(Model(robot, (ViscousFriction(), RigidBody())), np.concatenate([friction, bodies])))
    found = [element.attrib for element in root.findall("joint/dynamics")]
    assert found == [{"damping": str(value)} for value in (0.1, 0.2, 0.0, 0.4, 0.5, 0.6)]
    assert ET.fromstring(urdf(Model(robot, (RigidBody(),)), bodies)).find("joint/dynamics") is None


def test_branches_keep_their_order():
    rng = np.random.default_rng(0)
    parents = [-1, 0, -1, 2, 3, 2, 0, -1, 1, 1, 4, -1]
    order = [0, 1, 8, 9, 6, 2, 3, 4, 10, 5, 7, 11]  # depth first, as pinocchio numbers joints
    parents = [order.index(parents[i]) if parents[i] >= 0 else -1 for i in order]
    frames = np.tile(np.eye(4), (12, 1, 1))
    frames[:, :3, 3] = rng.normal(size=(12, 3))
    joints = tuple(Joint(frame, np.eye(3)[i % 3], i % 2 == 0, parents[i]) for i, frame in enumerate(frames))
    robot = Robot("tree", joints, np.array([0.0, 0.0, -9.81]))
    text = urdf(Model(robot, (RigidBody(),)), parameters_of(random_clouds(12)))
    assert robot_from_urdf(text, "test").same_kinematics(robot)


ANGLES = (-3.1, -np.pi / 2, -0.4, 0.0, 1e-9, np.pi / 2, 1.2, np.pi)


@pytest.mark.parametrize("pitch", [*ANGLES, np.pi / 2 - 1e-8, 1e-12 - np.pi / 2])
def test_angles_give_the_rotation_back(pitch):
    def rotation(roll, pitch, yaw):
        return turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)

    for roll, yaw in product(ANGLES, ANGLES):
        expected = rotation(roll, pitch, yaw)
        np.testing.assert_allclose(rotation(*_roll_pitch_yaw(expected)), expected, rtol=0, atol=2e-15)


def test_text_is_plain_urdf():
    text = urdf(Model(replace(MOVES["standard"], name='a "b" & <c>'), (RigidBody(),)), parameters_of(random_clouds(6)))
    root = ET.fromstring(text)
    assert root.get("name") == 'a "b" & <c>'
    assert [link.get("name") for link in root.findall("link")] == ["base", *(f"link{i}" for i in range(1, 7))]
    assert {joint.get("type") for joint in root.findall("joint")} == {"revolute", "prismatic"}
    assert all(joint.find("limit") is not None for joint in root.findall("joint"))
    assert text.endswith("</robot>\n")


@pytest.mark.parametrize("mass", [0.0, -1.0])
def test_infeasible_mass_is_refused(mass):
    theta = parameters_of(random_clouds(6))
    theta[39] = mass
    with pytest.raises(ValueError, match="link4 has mass"):
        urdf(Model(MOVES["standard"], (RigidBody(),)), theta)


def test_parameters_must_fit_the_model():
    with pytest.raises(ValueError, match="no rigid_body term"):
        urdf(Model(MOVES["standard"], (ViscousFriction(),)), np.ones(6))
    with pytest.raises(ValueError, match="theta has shape"):
        urdf(Model(MOVES["standard"], (RigidBody(),)), np.ones(59))
