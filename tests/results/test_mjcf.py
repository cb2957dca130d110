"""MuJoCo, as independent of bayesid as a simulator can be, finds the model's torques in what is exported to it."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from oracles import assert_close, dh_chain, joint_torques, parameters_of, random_clouds, random_table

from bayesid.model.catalogue import make_effect
from bayesid.model.model import Model
from bayesid.model.robot import BUILT_IN, Joint, Robot, load_robot, robot_from_table
from bayesid.model.terms import RigidBody, ViscousFriction
from bayesid.motion import Motion
from bayesid.results.export import mjcf, urdf
from bayesid.simulation.parameters import random_parameters

AT_REST = 0.001  # rad/s, over which the model smooths dry friction
ROBOTS = {name: load_robot(name) for name in BUILT_IN} | {
    "standard": robot_from_table(random_table("standard", 6, seed=1), "test"),
    "modified": robot_from_table(random_table("modified", 7, seed=2), "test"),
    "coupled": robot_from_table(random_table("modified", 4, seed=3, coupled=True), "test"),
}
EFFECTS = ("rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia")


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


def model_of(robot, names=EFFECTS):
    shapes = {"coulomb_friction": {"smoothing": [AT_REST] * robot.n_joints}}
    return Model(robot, tuple(make_effect(name, shapes.get(name, {})) for name in names))


def random_states(robot, samples=20, seed=0):
    """Random states without standstill of a motor: tanh(0.02 / AT_REST) is 1 to rounding."""
    rng = np.random.default_rng(seed)
    shape = (samples, robot.n_joints)
    motors = rng.uniform(0.02, 3.0, shape) * rng.choice([-1.0, 1.0], shape)
    q, ddq = rng.uniform(-3.0, 3.0, shape), rng.uniform(-9.0, 9.0, shape)
    return Motion(np.arange(float(samples)), q, np.linalg.solve(robot.coupling, motors.T).T, ddq)


def load(model, theta):
    return mujoco.MjModel.from_xml_string(mjcf(model, theta))


def dofs(loaded):
    """Which of MuJoCo's joints is joint 1, 2, ...: it counts depth first."""
    names = sorted(loaded.joint(i).name for i in range(loaded.njnt))
    return [loaded.joint(name).dofadr[0] for name in names]


def inverse(loaded, motion):
    """(N, n) joint torques that MuJoCo finds."""
    data, order, found = mujoco.MjData(loaded), dofs(loaded), []
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        data.qpos[order], data.qvel[order], data.qacc[order] = q, dq, ddq
        mujoco.mj_inverse(loaded, data)
        found.append(data.qfrc_inverse[order])
    return np.array(found)


def in_joints(model, motion, theta):
    """(N, n) joint torques of the model: its efforts are the motors', and virtual work is the same in both."""
    return model.effort(motion, theta) @ model.robot.coupling


def assert_each_close(found, expected, relative):
    """Every joint by its own scale: a wrist's torques are a thousandth of a shoulder's."""
    np.testing.assert_array_less(np.abs(found - expected).max(axis=0), relative * np.abs(expected).max(axis=0))


# ---------------------------------------------------------------------------------------------------------------
# Torques
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("names", [EFFECTS, (*EFFECTS, "joint_spring", "payload"), ("rigid_body",)], ids=len)
def test_mujoco_finds_the_models_torques(robot, names):
    model, motion = model_of(robot, names), random_states(robot)
    theta = random_parameters(model, np.random.default_rng(6))
    assert_each_close(inverse(load(model, theta), motion), in_joints(model, motion, theta), 1e-11)


def test_mujoco_accelerates_as_the_model_says_under_its_efforts(robot):
    """Controls are efforts: forward dynamics undoes inverse dynamics, through motors, gears and tendons."""
    model, motion = model_of(robot), random_states(robot, 10)
    theta = random_parameters(model, np.random.default_rng(6))
    loaded = load(model, theta)
    loaded.opt.tolerance = 0.0
    data = mujoco.MjData(loaded)
    motors = [loaded.actuator(f"motor{i + 1}").id for i in range(robot.n_joints)]
    found = []
    for q, dq, effort in zip(motion.q, motion.dq, model.effort(motion, theta), strict=True):
        data.qpos[:], data.qvel[:], data.ctrl[motors] = q, dq, effort
        mujoco.mj_forward(loaded, data)
        found.append(data.qacc.copy())
    assert_close(np.array(found), motion.ddq, 1e-6)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_rigid_bodies_are_those_of_point_masses(convention):
    table, clouds = random_table(convention, 6, seed=12), random_clouds(6, seed=12)
    model, motion = Model(robot_from_table(table, "test"), (RigidBody(),)), random_states(ROBOTS["kr5"])
    expected = joint_torques(dh_chain(table), clouds, np.array(table["gravity"]), motion)
    assert_close(inverse(load(model, parameters_of(clouds)), motion), expected, 1e-12)


@pytest.mark.parametrize("points", [1, 2, 3])
def test_bodies_without_thickness_load(points):
    table = random_table("modified", 6, seed=12)
    clouds = [(places[:points], masses[:points]) for places, masses in random_clouds(6, seed=12)]
    model, motion = Model(robot_from_table(table, "test"), (RigidBody(),)), random_states(ROBOTS["kr5"])
    expected = joint_torques(dh_chain(table), clouds, np.array(table["gravity"]), motion)
    assert_close(inverse(load(model, parameters_of(clouds)), motion), expected, 1e-8)


def test_branches_move_as_in_the_model_whatever_their_order():
    parents, rng = [-1, -1, 0, 1, 0, 3, 2, 2, 5, 4, 9], np.random.default_rng(0)  # breadth before depth; eleven
    frames = np.tile(np.eye(4), (11, 1, 1))
    frames[:, :3, 3] = rng.normal(size=(11, 3))
    frames[:, :3, :3] = np.linalg.qr(rng.normal(size=(11, 3, 3)))[0]
    frames[:, :3, 0] *= np.linalg.det(frames[:, :3, :3])[:, None]
    joints = tuple(Joint(f, np.eye(3)[i % 3], i % 4 == 1, parents[i]) for i, f in enumerate(frames))
    model = model_of(Robot("tree", joints, np.array([1.0, -2.0, -9.0])))
    motion = random_states(model.robot)
    theta = random_parameters(model, rng)
    loaded = load(model, theta)
    assert dofs(loaded) != sorted(dofs(loaded))
    assert_each_close(inverse(loaded, motion), in_joints(model, motion, theta), 1e-11)


def test_effects_of_some_joints_and_of_several_terms():
    robot = ROBOTS["tx40"]  # motor 4 turns backwards, motor 6 with joints 5 and 6
    terms = (
        ("coulomb_friction", {"joints": [6, 2], "smoothing": [AT_REST] * 2}, [2.0, 3.0]),
        ("joint_spring", {"joints": [4, 6]}, [1.5, 0.75, 2.5, 2.5]),  # the tendon rests at -1, which is MuJoCo's none
        ("rigid_body", {}, parameters_of(random_clouds(6))),
        ("rotor_inertia", {"joints": [6]}, [0.5]),
        ("joint_spring", {"joints": [4, 1]}, [0.25, -3.0, 0.0, 0.125]),
        ("rotor_inertia", {"joints": [4, 6]}, [0.125, 0.25]),
    )
    model = Model(robot, tuple(make_effect(name, shape) for name, shape, _ in terms))
    theta, motion = np.concatenate([values for *_, values in terms]), random_states(robot)
    loaded = load(model, theta)
    assert_each_close(inverse(loaded, motion), in_joints(model, motion, theta), 1e-8)  # joint 1's: 1e-9 N m/rad
    np.testing.assert_array_equal(loaded.dof_armature, [0.0, 0.0, 0.0, 0.125, 0.0, 0.0])
    np.testing.assert_array_equal(loaded.tendon_armature, [0.75])


# ---------------------------------------------------------------------------------------------------------------
# Pinocchio
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", [name for name in ROBOTS if ROBOTS[name].transmission is None])
def test_pinocchio_reads_the_same_from_both_formats(name, tmp_path):
    """The MJCF's rotor inertia included, for which a URDF has no place; Pinocchio reads gravity from neither."""
    model, motion = model_of(ROBOTS[name]), random_states(ROBOTS[name])
    theta = random_parameters(model, np.random.default_rng(6))
    (tmp_path / "robot.xml").write_text(mjcf(model, theta), encoding="utf-8")
    ours, other = pin.buildModelFromMJCF(str(tmp_path / "robot.xml")), pin.buildModelFromXML(urdf(model, theta))
    ours.gravity.linear = other.gravity.linear = model.robot.gravity
    other.armature = theta[-model.robot.n_joints :]
    torques = []
    for loaded in (ours, other):
        data = loaded.createData()
        rigid = [pin.rnea(loaded, data, *sample) for sample in zip(motion.q, motion.dq, motion.ddq, strict=True)]
        torques.append(np.array(rigid) + loaded.damping * motion.dq + loaded.friction * np.sign(motion.dq))
    assert_each_close(torques[0], torques[1], 1e-12)
    assert_each_close(torques[0], in_joints(model, motion, theta), 1e-12)


# ---------------------------------------------------------------------------------------------------------------
# Simulation
# ---------------------------------------------------------------------------------------------------------------
def fallen(loaded):
    """MuJoCo's state after a second of falling from rest, and its energy at every step, J."""
    loaded.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, energy = mujoco.MjData(loaded), []
    data.qpos[:] = np.random.default_rng(1).uniform(-1.0, 1.0, loaded.nq)
    for _ in range(round(1.0 / loaded.opt.timestep)):
        mujoco.mj_step(loaded, data)
        energy.append(data.energy.sum())
    assert not data.warning.number.any()
    return data, np.array(energy)


def test_an_arm_falls_without_gaining_energy(robot, tmp_path):
    """Friction takes energy at every step, and the arm moves."""
    model = model_of(robot)
    (tmp_path / "robot.xml").write_text(mjcf(model, random_parameters(model, np.random.default_rng(6))))
    data, energy = fallen(mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml")))
    assert np.all(np.diff(energy) <= 1e-9 * np.ptp(energy))
    assert np.abs(data.qvel).max() > 0.01


def test_grease_as_thick_as_pitch_is_stable():
    """Friction of a motor that moves several joints is implicit in time too: h d / m is 1000 and more."""
    model = model_of(ROBOTS["coupled"])
    theta = random_parameters(model, np.random.default_rng(6))
    theta[40:44] *= 1e4
    _, energy = fallen(load(model, theta))
    assert np.all(np.diff(energy) <= 1e-9 * np.abs(energy).max())


def test_a_joint_that_sticks_stays():
    robot = ROBOTS["ur10e"]
    model, bodies = model_of(robot, ("rigid_body", "coulomb_friction")), parameters_of(random_clouds(6))
    motion = Motion(np.zeros(1), np.full((1, 6), 0.5), np.zeros((1, 6)), np.zeros((1, 6)))
    weight = np.abs(robot.inverse_dynamics(motion, bodies))[0]
    loaded = load(model, np.concatenate([bodies, 1.25 * weight + 0.5]))
    data = mujoco.MjData(loaded)
    data.qpos[:] = 0.5
    for _ in range(1000):
        mujoco.mj_step(loaded, data)
    np.testing.assert_allclose(data.qpos, 0.5, atol=2e-3)


# ---------------------------------------------------------------------------------------------------------------
# The text
# ---------------------------------------------------------------------------------------------------------------
def head_of(text):
    return [line.strip() for line in text[text.index("<!--") : text.index("-->")].splitlines()]


def test_what_has_no_place_stands_at_the_head():
    robot = ROBOTS["kr5"]
    names = ("rigid_body", "torque_offset", "viscous_friction", "payload", "asymmetric_coulomb")
    shapes = {"asymmetric_coulomb": {"smoothing": [AT_REST], "joints": [2]}}
    terms = tuple(make_effect(name, shapes.get(name, {})) for name in names)
    model = Model(robot, terms, (make_effect("base_tilt", {"angle": [0.25, -0.5]}),))
    theta = random_parameters(model, np.random.default_rng(6))
    values = dict(zip((p.name for p in model.parameters), theta.tolist(), strict=True))
    lines = head_of(mjcf(model, theta))
    start = lines.index("Identified by bayesid. link6 includes the payload. Not in this MJCF:")
    remarks = [f"torque_offset: offset{i} = {values[f'offset{i}']!r} N m" for i in range(1, 7)]
    remarks += [f"asymmetric_coulomb: {p.name} = {values[p.name]!r} N m" for p in model.parameters[-2:]]
    remarks += ["base_tilt: tilt1 = 0.25 rad", "base_tilt: tilt2 = -0.5 rad"]
    assert lines[start + 1 : start + 12] == ["joint limits (not identified)", *remarks]
    assert "Controls" in lines[start + 12]


def test_nothing_is_left_out_of_an_ordinary_model(robot):
    model = model_of(robot)
    lines = head_of(mjcf(model, random_parameters(model, np.random.default_rng(6))))
    assert not [line for line in lines if ": F" in line or ": Ia" in line]
    assert any("motor speeds" in line for line in lines) == (robot.transmission is not None)


def test_text_is_plain_mjcf():
    robot = replace(ROBOTS["tx40"], name='a "b" & <c> é')
    model = model_of(robot)
    text = mjcf(model, random_parameters(model, np.random.default_rng(6)))
    root = ET.fromstring(text)
    assert root.get("model") == robot.name
    assert [e.get("name") for e in root.iter("body")] == [f"link{i}" for i in range(1, 7)]
    assert [e.get("name") for e in root.findall("actuator/motor")] == [f"motor{i}" for i in range(1, 7)]
    assert [e.get("gear") for e in root.findall("actuator/motor")] == ["1.0", "1.0", "1.0", "-1.0", "1.0", None]
    assert [(e.get("joint"), e.get("coef")) for e in root.findall("tendon/fixed/joint")] == [
        ("joint5", "1.0"),
        ("joint6", "1.0"),
    ]
    assert root.find("worldbody//geom") is None
    assert text.endswith("</mujoco>\n")


def test_a_solvers_negative_zero_is_no_negative_friction():
    model = model_of(ROBOTS["kr5"])
    theta = random_parameters(model, np.random.default_rng(6))
    theta[60:] = -1e-12
    loaded = load(model, theta)
    assert not loaded.dof_damping.any()
    assert not loaded.dof_frictionloss.any()
    assert not loaded.dof_armature.any()


def test_parameters_must_fit_the_model():
    robot, theta = ROBOTS["kr5"], parameters_of(random_clouds(6))
    with pytest.raises(ValueError, match="no rigid_body term"):
        mjcf(Model(robot, (ViscousFriction(),)), np.ones(6))
    with pytest.raises(ValueError, match="theta has shape"):
        mjcf(Model(robot, (RigidBody(),)), theta[1:])
    theta[29] = 0.0
    with pytest.raises(ValueError, match="link3 has mass"):
        mjcf(Model(robot, (RigidBody(),)), theta)
