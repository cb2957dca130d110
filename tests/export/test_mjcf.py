"""MuJoCo gives the model's torques for the exported MJCF."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from exported_robots import COUPLED, ROBOTS, branched, dofs, in_mujoco, in_pinocchio
from oracles import assert_close, dh_chain, joint_torques, parameters_of, random_clouds, random_table

from bayesid.effects import RigidBody, ViscousFriction
from bayesid.effects.catalogue import make_effect
from bayesid.effects.model import Model
from bayesid.export import mjcf, urdf
from bayesid.motion import Motion
from bayesid.robot import BUILT_IN, load_robot, robot_from_table
from bayesid.simulation.parameters import random_parameters

AT_REST = 0.001  # rad/s, over which the model smooths dry friction
EFFECTS = ("rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia")
MORE = (*EFFECTS, "joint_spring", "payload")


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


def model_of(robot, names=EFFECTS):
    shapes = {"coulomb_friction": {"smoothing": [AT_REST] * robot.n_joints}}
    return Model(robot, tuple(make_effect(name, shapes.get(name, {})) for name in names))


def parameters(model):
    return random_parameters(model, rng=np.random.default_rng(6))


def random_states(robot, samples=20, seed=0):
    """Random states without standstill of a motor: tanh(0.02 / AT_REST) is 1 to rounding."""
    rng = np.random.default_rng(seed)
    shape = (samples, robot.n_joints)
    motors = rng.uniform(0.02, 3.0, shape) * rng.choice([-1.0, 1.0], shape)
    q, ddq = rng.uniform(-3.0, 3.0, shape), rng.uniform(-9.0, 9.0, shape)
    return Motion(np.arange(float(samples)), q, np.linalg.solve(robot.coupling, motors.T).T, ddq)


def load(model, theta):
    return mujoco.MjModel.from_xml_string(mjcf(model, theta))


def in_joints(model, motion, theta):
    """(N, n) joint torques of the model: its efforts are the motors', and virtual work is the same in both."""
    return model.effort(motion, theta) @ model.robot.coupling


def assert_each_close(found, expected, relative):
    """Relative to each joint's largest torque: a wrist's torques are a thousandth of a shoulder's."""
    np.testing.assert_array_less(np.abs(found - expected).max(axis=0), relative * np.abs(expected).max(axis=0))


def test_mujoco_finds_the_models_torques_and_accelerates_as_it_says(robot):
    """Controls are efforts: forward dynamics undoes inverse dynamics, through motors, gears and tendons."""
    model, motion = model_of(robot, MORE), random_states(robot)
    theta = parameters(model)
    text = mjcf(model, theta)
    assert not [line for line in head_of(text) if ": F" in line or ": Ia" in line], "nothing is left out"
    loaded = mujoco.MjModel.from_xml_string(text)
    assert_each_close(in_mujoco(loaded, motion), in_joints(model, motion, theta), 1e-11)
    loaded.opt.tolerance = 0.0
    data, order = mujoco.MjData(loaded), dofs(loaded)
    motors = [loaded.actuator(f"motor{i + 1}").id for i in range(robot.n_joints)]
    found = []
    for q, dq, effort in zip(motion.q, motion.dq, model.effort(motion, theta), strict=True):
        data.qpos[order], data.qvel[order], data.ctrl[motors] = q, dq, effort
        mujoco.mj_forward(loaded, data)
        found.append(data.qacc[order])
    assert_close(np.array(found), motion.ddq, 1e-6)


def test_every_built_in_robot_is_the_same_in_mujoco():
    for robot in map(load_robot, BUILT_IN):
        model, motion = model_of(robot), random_states(robot, 3)
        theta = parameters(model)
        assert_each_close(in_mujoco(load(model, theta), motion), in_joints(model, motion, theta), 1e-11)


@pytest.mark.parametrize(("points", "tolerance"), [(8, 1e-12), (1, 1e-8), (2, 1e-8), (3, 1e-8)])
def test_rigid_bodies_are_those_of_point_masses_with_or_without_thickness(points, tolerance):
    for convention in ("standard", "modified"):
        table = random_table(convention, 6, seed=12)
        clouds = [(places[:points], masses[:points]) for places, masses in random_clouds(6, seed=12)]
        model, motion = Model(robot_from_table(table, "test"), (RigidBody(),)), random_states(ROBOTS["ur10e"])
        expected = joint_torques(dh_chain(table), clouds, np.array(table["gravity"]), motion)
        assert_close(in_mujoco(load(model, parameters_of(clouds)), motion), expected, tolerance)


def test_branches_move_as_in_the_model_whatever_their_order():
    model = model_of(branched([-1, -1, 0, 1, 0, 3, 2, 2, 5, 4, 9]))  # breadth before depth; eleven
    motion, theta = random_states(model.robot), parameters(model)
    loaded = load(model, theta)
    assert dofs(loaded) != sorted(dofs(loaded))
    assert_each_close(in_mujoco(loaded, motion), in_joints(model, motion, theta), 1e-11)


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
    assert_each_close(in_mujoco(loaded, motion), in_joints(model, motion, theta), 1e-8)  # joint 1's: 1e-9 N m/rad
    np.testing.assert_array_equal(loaded.dof_armature, [0.0, 0.0, 0.0, 0.125, 0.0, 0.0])
    np.testing.assert_array_equal(loaded.tendon_armature, [0.75])


@pytest.mark.parametrize("name", ["standard", "urdf"])
def test_pinocchio_reads_the_same_from_both_formats(name, tmp_path):
    """The MJCF's rotor inertia included, for which a URDF has no place."""
    model, motion = model_of(ROBOTS[name]), random_states(ROBOTS[name])
    theta = parameters(model)
    (tmp_path / "robot.xml").write_text(mjcf(model, theta), encoding="utf-8")
    ours, other = pin.buildModelFromMJCF(str(tmp_path / "robot.xml")), pin.buildModelFromXML(urdf(model, theta))
    other.armature = theta[-model.robot.n_joints :]
    for loaded in (ours, other):
        rigid = in_pinocchio(loaded, model.robot.gravity, motion)
        torques = rigid + loaded.damping * motion.dq + loaded.friction * np.sign(motion.dq)
        assert_each_close(torques, in_joints(model, motion, theta), 1e-12)


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


@pytest.mark.parametrize("robot", [ROBOTS["ur10e"], ROBOTS["tx40"], COUPLED], ids=["ur10e", "tx40", "coupled"])
def test_an_arm_falls_without_gaining_energy(robot, tmp_path):
    """Friction takes energy at every step, and the arm moves."""
    model = model_of(robot)
    (tmp_path / "robot.xml").write_text(mjcf(model, parameters(model)))
    data, energy = fallen(mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml")))
    assert np.all(np.diff(energy) <= 1e-9 * np.ptp(energy))
    assert np.abs(data.qvel).max() > 0.01


def head_of(text):
    return [line.strip() for line in text[text.index("<!--") : text.index("-->")].splitlines()]


def test_what_a_format_cannot_hold_is_in_the_comment():
    names = ("rigid_body", "torque_offset", "viscous_friction", "payload", "asymmetric_coulomb")
    shapes = {"asymmetric_coulomb": {"smoothing": [AT_REST], "joints": [2]}}
    terms = tuple(make_effect(name, shapes.get(name, {})) for name in names)
    model = Model(ROBOTS["ur10e"], terms, (make_effect("base_tilt", {"angle": [0.25, -0.5]}),))
    theta = parameters(model)
    values = dict(zip((p.name for p in model.parameters), theta.tolist(), strict=True))
    lines = head_of(mjcf(model, theta))
    remarks = [f"torque_offset: offset{i} = {values[f'offset{i}']!r} N m" for i in range(1, 7)]
    remarks += [f"asymmetric_coulomb: {p.name} = {values[p.name]!r} N m" for p in model.parameters[-2:]]
    remarks += ["base_tilt: tilt1 = 0.25 rad", "base_tilt: tilt2 = -0.5 rad"]
    start = lines.index(remarks[0])
    assert lines[start : start + 10] == remarks
    assert "joint limits" in lines[start - 1]
    assert "link6 includes the payload" in lines[start - 2]
    plain, coupled = (head_of(mjcf(model, parameters(model))) for model in map(model_of, (ROBOTS["ur10e"], COUPLED)))
    assert [any("motor speeds" in line for line in head) for head in (plain, coupled)] == [False, True]


def test_parameters_must_fit_the_model():
    robot, theta = ROBOTS["ur10e"], parameters_of(random_clouds(6))
    for export in (mjcf, urdf):
        with pytest.raises(ValueError, match="rigid_body"):
            export(Model(robot, (ViscousFriction(),)), np.ones(6))
        with pytest.raises(ValueError, match="theta has shape"):
            export(Model(robot, (RigidBody(),)), theta[1:])
        for mass in (0.0, -1.0):
            light = theta.copy()
            light[29] = mass
            with pytest.raises(ValueError, match="link3 has mass"):
                export(Model(robot, (RigidBody(),)), light)
