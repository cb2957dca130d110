import xml.etree.ElementTree as ET
from dataclasses import fields, replace
from itertools import product

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from exported_robots import COUPLED, ROBOTS, branched, dofs, in_mujoco, in_pinocchio
from oracles import assert_close, dh_chain, parameters_of, random_clouds, random_motion, random_table, turn
from oracles import joint_torques as torques_of_points

from bayesid.model.catalogue import make_effect, make_terms
from bayesid.model.distortions import CATALOGUE as DISTORTIONS
from bayesid.model.model import Model
from bayesid.model.robot import robot_from_table, robot_from_urdf
from bayesid.model.terms import CATALOGUE, STANDARD, ActuatorTerm, RigidBody, ViscousFriction
from bayesid.model.terms.learned_effect import LearnedEffect
from bayesid.motion import Motion
from bayesid.results.export import urdf
from bayesid.results.export.urdf_text import roll_pitch_yaw

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


@pytest.mark.parametrize("name", ["ur10e", "standard", "tree"])
def test_friction_completes_the_torques_as_urdf_defines_it(name):
    """damping * q' + friction * sign(q'), wherever the motion is no standstill: in MuJoCo itself, and by hand."""
    robot, rng = ROBOTS[name], np.random.default_rng(4)
    n = robot.n_joints
    q, ddq = rng.uniform(-3.0, 3.0, (2, 20, n))
    motion = Motion(np.arange(20.0), q, rng.uniform(0.5, 3.0, (20, n)) * rng.choice([-1.0, 1.0], (20, n)), ddq)
    shape = {"smoothing": [0.02] * n}  # rad/s: tanh(0.5 / 0.02) is 1 to rounding
    friction = ViscousFriction(), make_effect("coulomb_friction", shape)
    model = Model(replace(robot, transmission=None), (RigidBody(), *friction))
    theta = np.concatenate([parameters_of(random_clouds(n, seed=7)), rng.uniform(0.5, 3.0, 2 * n)])
    text, expected = urdf(model, theta), model.effort(motion, theta)
    loaded = pin.buildModelFromXML(text)
    rigid = in_pinocchio(loaded, robot.gravity, motion)
    assert_close(rigid + loaded.damping * motion.dq + loaded.friction * np.sign(motion.dq), expected, 1e-12)
    assert_close(in_mujoco(mujoco.MjModel.from_xml_string(text), motion), expected, MUJOCO)


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
        in_joint = HELD.get(model.robot.name, np.ones(model.robot.n_joints))[parameter.joint - 1]
        held = parameter.name[:2] in ("Fv", "Fc") and in_joint
        assert (f"{parameter.name} = {float(value)!r} {parameter.unit}" in comment) != held
    assert f"gravity = {' '.join(map(str, model.robot.gravity.tolist()))} m/s^2" in comment
    assert ("motor speeds" in comment) == (model.robot.transmission is not None)
    joints = ET.fromstring(text).findall("joint")
    held = HELD.get(model.robot.name, np.ones(model.robot.n_joints))
    assert [joint.find("dynamics") is not None for joint in joints] == list(map(bool, held))


# ---------------------------------------------------------------------------------------------------------------
# Models with effects in some joints
# ---------------------------------------------------------------------------------------------------------------
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


def comment_of(text):
    """The lines at the head, of text that is an XML document."""
    ET.fromstring(text)
    return [line.strip() for line in text[text.index("<!--") : text.index("-->")].splitlines()]


@pytest.mark.parametrize("robot", [ROBOTS["standard"], COUPLED], ids=["standard", "coupled"])
def test_every_other_term_stands_at_the_head_with_its_numbers(robot):
    """Unless a URDF has a place for it, which it has not for what a motor does that moves several joints."""
    rng = np.random.default_rng(9)
    numbers = {"smoothing": 0.05, "speed": 0.125, "harmonic": 23.5, "width": 0.375, "time": 17.5}
    numbers |= {"start": -0.25, "side": -1.0}
    unit = "m" if robot.joints[2].prismatic else "rad"
    units = {"speed": f"{unit}/s", "harmonic": f"1/{unit}", "width": unit, "time": "s", "start": unit}
    bodies = parameters_of(random_clouds(robot.n_joints))
    for name, kind in ((name, kind) for name, kind in CATALOGUE.items() if kind not in (RigidBody, LearnedEffect)):
        needed = {one.name for one in fields(kind)} - {"joints", "links"}
        shape = {key: [numbers.get(key, 0.625)] for key in needed}
        shape |= {"joints": [3]} if issubclass(kind, ActuatorTerm) else {}
        if name == "load_dependent_friction":
            shape["links"] = rng.uniform(size=10 * robot.n_joints).tolist()
        term = make_effect(name, shape)
        parameters = term.parameters(robot)
        values = rng.uniform(0.1, 2.0, len(parameters))
        lines = comment_of(urdf(Model(robot, (RigidBody(), term)), np.concatenate([bodies, values])))
        remarks = {f"{name}: {p.name} = {float(v)!r} {p.unit}" for p, v in zip(parameters, values, strict=True)}
        has_place = "urdf" in kind.places
        assert has_place or name not in ("viscous_friction", "coulomb_friction")
        in_the_robot = name == "payload" or (has_place and robot is not COUPLED)
        assert not remarks & set(lines) if in_the_robot else remarks <= set(lines)
        own = (needed - {"smoothing", "side"}) & set(units)
        assert {f"{name}: {key}3 = {numbers[key]} {units[key]}" for key in own} <= set(lines)


def test_distortions_stand_at_the_head():
    robot = ROBOTS["standard"]
    unit = ["N" if joint.prismatic else "N m" for joint in robot.joints]
    numbers = {
        "gain_error": ({"gain": [1.125, 0.75], "joints": [2, 5]}, ["gain2 = 1.125 1", "gain5 = 0.75 1"]),
        "delay": ({"lag": [0.0125]}, ["lag = 0.0125 s"]),
        "base_tilt": ({"angle": [0.25, -0.0625]}, ["tilt1 = 0.25 rad", "tilt2 = -0.0625 rad"]),
        "clipping": ({"limit": [50.5], "joints": [1]}, [f"limit1 = 50.5 {unit[0]}"]),
        "dead_zone": ({"width": [0.5] * 6}, [f"width{j + 1} = 0.5 {unit[j]}" for j in range(6)]),
        "dead_zone.shrinking": ({"width": [0.75], "joints": [6]}, [f"width6 = 0.75 {unit[5]}"]),
    }
    assert set(numbers) <= set(DISTORTIONS)
    made = tuple(make_effect(name, shape) for name, (shape, _) in numbers.items())
    bodies = parameters_of(random_clouds(6))
    plain, distorted = (urdf(Model(robot, (RigidBody(),), some), bodies) for some in ((), made))
    remarks = [f"{name}: {line}" for name, (_, lines) in numbers.items() for line in lines]
    assert comment_of(distorted) == [*comment_of(plain)[:-1], *remarks, ""]
    assert distorted[distorted.index("-->") :] == plain[plain.index("-->") :]


def test_branches_keep_their_order():
    parents = [-1, 0, -1, 2, 3, 2, 0, -1, 1, 1, 4, -1]
    order = [0, 1, 8, 9, 6, 2, 3, 4, 10, 5, 7, 11]  # depth first, as pinocchio numbers joints
    robot = branched([order.index(parents[i]) if parents[i] >= 0 else -1 for i in order])
    text = urdf(Model(robot, (RigidBody(),)), parameters_of(random_clouds(12)))
    again = replace(robot_from_urdf(text, "test"), gravity=robot.gravity)
    assert [joint.parent for joint in again.joints] == [joint.parent for joint in robot.joints]
    for joint, original in zip(again.joints, robot.joints, strict=True):
        np.testing.assert_allclose(joint.placement, original.placement, rtol=0, atol=1e-15)


def test_angles_give_the_rotation_back():
    def rotation(roll, pitch, yaw):
        return turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)

    angles = (-3.1, -np.pi / 2, -0.4, 0.0, 1e-9, np.pi / 2, 1.2, np.pi)
    for roll, pitch, yaw in product(angles, (*angles, np.pi / 2 - 1e-8, 1e-12 - np.pi / 2), angles):
        expected = rotation(roll, pitch, yaw)
        np.testing.assert_allclose(rotation(*roll_pitch_yaw(expected)), expected, rtol=0, atol=2e-15)


def test_text_is_plain_urdf():
    text = urdf(Model(replace(ROBOTS["standard"], name='a "b" & <c>'), (RigidBody(),)), parameters_of(random_clouds(6)))
    root = ET.fromstring(text)
    assert root.get("name") == 'a "b" & <c>'
    assert [link.get("name") for link in root.findall("link")] == ["base", *(f"link{i}" for i in range(1, 7))]
    assert {joint.get("type") for joint in root.findall("joint")} == {"revolute", "prismatic"}
    assert all(joint.find("limit") is not None for joint in root.findall("joint"))
    assert text.endswith("</robot>\n")


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
