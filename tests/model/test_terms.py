import json
import math
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from conftest import smooth_motion
from oracles import (
    STEP,
    actuator_efforts,
    assert_close,
    built_in_table,
    dh_chain,
    gear,
    joint_torques,
    parameters_of,
    random_clouds,
    random_motion,
    random_table,
)
from scipy.linalg import expm

import bayesid.model.terms
from bayesid.errors import InputError
from bayesid.model.catalogue import make_effect, make_terms
from bayesid.model.effects import Scene
from bayesid.model.model import Model
from bayesid.model.parameters import Cone
from bayesid.model.robot import robot_from_table
from bayesid.model.terms import CATALOGUE, STANDARD, ActuatorTerm, Term
from bayesid.motion import STANDSTILL, Motion

TABLES = {
    "kr5": built_in_table("kr5"),
    "tx40": built_in_table("tx40"),
    "random": random_table("modified", 4, seed=1),
    "coupled": random_table("standard", 3, seed=2, coupled=True),
}


# ---------------------------------------------------------------------------------------------------------------
# Every term's effort, written by hand
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Entry:
    """What a term of the catalogue is.

    Attributes:
        effort: (N, n) of a robot's table, a motion, the parameters, and the numbers of the shape by name.
        nonnegative: symbols of the parameters that cannot be negative.
        shape: of n actuators; if not given, the motion shows it and the effort knows how.
    """

    effort: Callable
    nonnegative: tuple[str, ...] = ()
    shape: Callable | None = None


def rigid_body(table, motion, theta):
    """Each link's ten parameters as those of ten point masses, of either sign: the torque is linear in them."""
    axes = np.eye(3)
    points = np.array([np.zeros(3), *axes, *-axes, *(1 - axes)])
    one_each = np.array([parameters_of([(points[k : k + 1], np.ones(1))]) for k in range(10)]).T
    clouds = [(points, np.linalg.solve(one_each, link)) for link in theta.reshape(-1, 10)]
    torques = joint_torques(dh_chain(table), clouds, np.array(table["gravity"]), motion)
    return actuator_efforts(torques, table.get("transmission"))


def payload(table, motion, theta):
    """The same on an arm whose links weigh nothing."""
    return rigid_body(table, motion, np.concatenate([np.zeros(10 * (len(table["joints"]) - 1)), theta]))


def tool_wrench(table, motion, theta, turns_with_tool):
    """Virtual work: what the actuators supply is minus the wrench's work per unit of each joint's motion."""
    chain, torques = dh_chain(table), []
    for q in motion.q:
        tool = chain(q)[0][-1]
        force, couple = np.append(theta, np.zeros(6 - len(theta))).reshape(2, 3)
        if turns_with_tool:
            force, couple = tool[:3, :3] @ force, tool[:3, :3] @ couple
        moves = [chain(q + 1j * STEP * e)[0][-1].imag / STEP for e in np.eye(len(q))]
        spins = [move[:3, :3] @ tool[:3, :3].T for move in moves]
        works = [force @ m[:3, 3] + couple @ [w[2, 1], w[0, 2], w[1, 0]] for m, w in zip(moves, spins, strict=True)]
        torques.append(-np.array(works))
    return actuator_efforts(np.array(torques), table.get("transmission"))


def top_speeds(table, motion):
    return np.abs(gear(table, motion.dq)).max(axis=0)


def direction(table, motion, smoothing=None):
    """Of the motors' motion; smoothed over a hundredth of each one's highest speed."""
    smoothing = 0.01 * top_speeds(table, motion) if smoothing is None else smoothing
    return np.tanh(gear(table, motion.dq) / smoothing)


def slipping(u, width, smooth):
    """(N,) state of one elastic element that slips, sample by sample; it begins at rest."""
    states = [0.0]
    for before, after in pairwise(u):
        way, towards = abs(after - before) / width, np.sign(after - before)
        if smooth:  # dz/dx = towards - z over this way
            end = (expm(way * np.array([[-1.0, towards], [0.0, 0.0]])) @ [states[-1], 1.0])[0]
        else:
            end = towards * min(towards * states[-1] + way, 1.0)
        states.append(end)
    return states


def hysteresis(table, motion, theta, width, smooth):
    u = gear(table, motion.q)
    return theta * np.transpose([slipping(u[:, j], w, smooth) for j, w in enumerate(width)])


PARTS = (0.25, 0.5, 1.0)


def layered_hysteresis(table, motion, theta, width):
    u, per_joint = gear(table, motion.q), theta.reshape(-1, 3)
    return np.transpose(
        [per_joint[j] @ [slipping(u[:, j], part * w, False) for part in PARTS] for j, w in enumerate(width)]
    )


def elastic_return(u, w):
    """(N,) dz/dx = towards while the element is relieved, towards - z while it is strained."""
    states = [0.0]
    for before, after in pairwise(u):
        way, towards, z = abs(after - before) / w, np.sign(after - before), states[-1]
        back = min(way, abs(z)) if towards * z < 0 else 0.0
        z += towards * back
        states.append((expm((way - back) * np.array([[-1.0, towards], [0.0, 0.0]])) @ [z, 1.0])[0])
    return states


def elastic_hysteresis(table, motion, theta, width):
    u = gear(table, motion.q)
    return theta * np.transpose([elastic_return(u[:, j], w) for j, w in enumerate(width)])


def warmth(motion, time):
    return 1 - np.exp((motion.t[0] - motion.t)[:, None] / np.array(time))


def asymmetric_coulomb(table, motion, theta):
    forwards, backwards = theta.reshape(-1, 2).T
    way = direction(table, motion)
    return np.where(way > 0, forwards, backwards) * way


def stribeck_friction(table, motion, theta):
    kinetic, extra = theta.reshape(-1, 2).T
    slowness = 10 * gear(table, motion.dq) / top_speeds(table, motion)
    return (kinetic + extra / np.exp(slowness**2)) * direction(table, motion)


def cable_drag(table, motion, theta, start, side):
    stretch = gear(table, motion.q) - start
    return theta * np.where(np.sign(stretch) == side, stretch, 0.0)


def cable_stiffening(table, motion, theta, start):
    cubic, linear = theta.reshape(-1, 2).T
    bent = gear(table, motion.q) - start
    return (cubic * bent**2 + linear) * bent


def joint_spring(table, motion, theta):
    stiffness, constant = theta.reshape(-1, 2).T
    return constant + stiffness * gear(table, motion.q)


def waves(table, motion, theta, harmonic):
    """Imaginary and real parts of turning pointers."""
    pointers = np.exp(1j * gear(table, motion.q) * harmonic)
    return theta[0::2] * pointers.imag + theta[1::2] * pointers.real


def two_harmonics(table, motion, theta):
    u = gear(table, motion.q)
    s1, c1, s2, c2 = theta.reshape(-1, 4).T
    return s1 * np.sin(u) + c1 * np.cos(u) + 2 * s2 * np.sin(u) * np.cos(u) + c2 * (1 - 2 * np.sin(u) ** 2)


def drifting(motion, theta, time, what):
    """What changes from its first amplitude by its second, as the joint warms up."""
    cold, warm = theta.reshape(-1, 2).T
    return (cold + warm * warmth(motion, time)) * what


def friction_drift(table, motion, theta, smoothing, time):
    dry, viscous = theta.reshape(-1, 2, 2).swapaxes(0, 1)
    way = direction(table, motion, smoothing)
    return drifting(motion, dry, time, way) + drifting(motion, viscous, time, gear(table, motion.dq))


def load_dependent_friction(table, motion, theta, smoothing, links):
    return theta * np.abs(rigid_body(table, motion, np.array(links))) * direction(table, motion, smoothing)


LEARNED = {
    "joints": [2],
    "number": [1.0],
    "component": [0.0, 0.0, 1.0, 1.0, 2.0, 3.0, 3.0],
    "quantity": [0.0, 1.0, 3.0, 4.0, 0.0, 2.0, 1.0],
    "of_joint": [1.0, 2.0, 1.0, 0.0, 3.0, 3.0, 1.0],
    "family": [0.0, 4.0, 2.0, 5.0, 1.0, 3.0, 6.0],
    "low": [-0.6, -1.0, -900.0, 0.0, -1.0, -2.0, -1.0],
    "high": [0.9, 1.0, 900.0, 1.0, 1.0, 2.0, 1.0],
    "order": [0.0, 0.3, 1.0, 0.07, 2.0, 2.0, 1.0],
    "count": [3.0, 1.0, 1.0, 2.0, 3.0, 1.0, 1.0],
    "kept": [2.0, 1.0, 1.0, 1.0],
    "weights": [0.3, -1.0, 0.7, 0.2, 0.1, 2.0, *(0.01, -0.02), *(0.4, 1.5, -0.6), 0.25],
}
"""Four functions: of q1 and the direction of joint 2, of the load of joint 1 and time, of q3, of ddq3 and the speed of
joint 1. The ranges are shorter than what joints do, but for the load's."""


def learned_effect(table, motion, theta, links, **_):
    """Sample by sample; what is beyond a range is drawn back to it, or to half a range further."""
    load, efforts = rigid_body(table, motion, np.array(links)), np.zeros(motion.q.shape)
    u, du, ddu = (gear(table, x) for x in (motion.q, motion.dq, motion.ddq))
    for i, t in enumerate(motion.t - motion.t[0]):
        place = (min(max(u[i, 0], -0.6), 0.9) + 0.6 + 0.225) / 1.95  # of 1.5 rad, and 15 % more at either end
        cosines = [1.0, math.cos(math.pi * place), math.cos(2 * math.pi * place)]
        first = (0.3 * theta[0] - theta[1]) * cosines[0] + (0.7 * theta[0] + 0.2 * theta[1]) * cosines[1]
        first += (0.1 * theta[0] + 2.0 * theta[1]) * cosines[2]
        second = load[i, 0] * (0.01 - 0.02 / math.exp(t / 0.07))
        third = 0.4 + 1.5 * math.cos(2 * u[i, 2]) - 0.6 * math.sin(2 * u[i, 2])
        pushed, speed = min(max(ddu[i, 2], -4.0), 4.0), min(max(du[i, 0], -2.0), 2.0)
        last = 0.25 * pushed * abs(pushed) * abs(speed)
        efforts[i, 1] = first * math.tanh(du[i, 1] / 0.3) + theta[2] * second + theta[3] * third + theta[4] * last
    return efforts


def places(n):
    return np.linspace(-0.7, 0.9, n)


def times(n):
    """Of the order of the test's motion, s."""
    return np.linspace(0.04, 0.2, n)


def smoothings(n):
    return np.linspace(0.02, 0.7, n)


EFFORTS = {
    "rigid_body": Entry(rigid_body),
    "viscous_friction": Entry(lambda table, motion, theta: theta * gear(table, motion.dq), ("Fv",)),
    "viscous_friction.saturating": Entry(
        lambda table, motion, theta, knee: theta * (1.0 - 2.0 / (1.0 + np.exp(2.0 * gear(table, motion.dq) / knee))),
        ("Fe",),
        lambda n: {"knee": np.linspace(0.6, 2.4, n)},
    ),
    "coulomb_friction": Entry(lambda table, motion, theta: theta * direction(table, motion), ("Fc",)),
    "torque_offset": Entry(lambda table, motion, theta: np.tile(theta, (len(motion), 1))),
    "rotor_inertia": Entry(lambda table, motion, theta: theta * gear(table, motion.ddq), ("Ia",)),
    "asymmetric_coulomb": Entry(asymmetric_coulomb, ("Fp", "Fm")),
    "stribeck_friction": Entry(stribeck_friction, ("Fk", "Fs")),
    "load_dependent_friction": Entry(
        load_dependent_friction,
        ("Fl",),
        lambda n: {"smoothing": smoothings(n), "links": parameters_of(random_clouds(n, seed=7))},
    ),
    "joint_spring": Entry(joint_spring, ("k",)),
    "gravity_spring": Entry(partial(waves, harmonic=1.0)),
    "gravity_spring.free_length": Entry(two_harmonics),
    "torque_ripple": Entry(waves, shape=lambda n: {"harmonic": np.linspace(3.3, 17.9, n)}),
    "hysteresis": Entry(partial(hysteresis, smooth=False), ("Fh",), lambda n: {"width": np.linspace(0.8, 4.0, n)}),
    "hysteresis.smooth": Entry(
        partial(hysteresis, smooth=True), ("Fhs",), lambda n: {"width": np.linspace(0.8, 4.0, n)}
    ),
    "hysteresis.layers": Entry(
        layered_hysteresis, ("Fha", "Fhb", "Fhc"), lambda n: {"width": np.linspace(0.8, 4.0, n)}
    ),
    "hysteresis.elastic": Entry(elastic_hysteresis, ("Fhe",), lambda n: {"width": np.linspace(0.8, 4.0, n)}),
    "cable_drag": Entry(cable_drag, ("kd",), lambda n: {"start": places(n), "side": (-1.0) ** np.arange(n)}),
    "cable_drag.friction": Entry(
        lambda table, motion, theta, smoothing, start: (
            theta * np.sqrt((gear(table, motion.q) - start) ** 2) * direction(table, motion, smoothing)
        ),
        ("Fd",),
        lambda n: {"smoothing": smoothings(n), "start": places(n)},
    ),
    "cable_drag.stiffening": Entry(cable_stiffening, ("kd3_",), lambda n: {"start": places(n)}),
    "thermal_drift": Entry(
        lambda table, motion, theta, smoothing, time: drifting(
            motion, theta, time, direction(table, motion, smoothing)
        ),
        shape=lambda n: {"smoothing": smoothings(n), "time": times(n)},
    ),
    "thermal_drift.viscous": Entry(
        lambda table, motion, theta, time: drifting(motion, theta, time, gear(table, motion.dq)),
        shape=lambda n: {"time": times(n)},
    ),
    "thermal_drift.both": Entry(friction_drift, shape=lambda n: {"smoothing": smoothings(n), "time": times(n)}),
    "thermal_drift.offset": Entry(
        lambda table, motion, theta, time: drifting(motion, theta, time, 1.0), shape=lambda n: {"time": times(n)}
    ),
    "learned_effect": Entry(
        learned_effect, shape=lambda n: {**LEARNED, "links": parameters_of(random_clouds(n, seed=7))}
    ),
    "payload": Entry(payload),
    "payload.carried": Entry(
        lambda table, motion, theta, label: payload(table, motion, theta) * (motion.payload == label[0])[:, None],
        shape=lambda n: {"label": ("tool1",)},
    ),
    "tool_wrench": Entry(partial(tool_wrench, turns_with_tool=False)),
    "tool_wrench.couple": Entry(partial(tool_wrench, turns_with_tool=False)),
    "tool_wrench.following": Entry(partial(tool_wrench, turns_with_tool=True)),
    "tool_wrench.following_couple": Entry(partial(tool_wrench, turns_with_tool=True)),
}
"""Of each term of the catalogue; a new term needs an entry here."""
NEED_A_SHAPE = [name for name, entry in EFFORTS.items() if entry.shape is not None]
OF_JOINTS = [name for name, kind in CATALOGUE.items() if issubclass(kind, ActuatorTerm)]
MEMORYLESS = [name for name, kind in CATALOGUE.items() if not kind.memory]
VARIABLES = ("velocity", "position", "acceleration", "load", "time")


def by_hand(name, table, motion, theta):
    """(N, n) the effort that the entry of a term makes."""
    entry = EFFORTS[name]
    return entry.effort(table, motion, theta, **(entry.shape(len(table["joints"])) if entry.shape else {}))


def made(name, robot, motion):
    """The term that the entry speaks of."""
    entry = EFFORTS[name]
    return make_effect(name, entry.shape(robot.n_joints)) if entry.shape else make_terms([name], robot, motion)[0]


# ---------------------------------------------------------------------------------------------------------------
# Fixtures
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(params=TABLES)
def table(request):
    return TABLES[request.param]


@pytest.fixture
def robot(table):
    return robot_from_table(table, "test")


@pytest.fixture
def motion(robot):
    """Some of the speeds are near zero, where dry friction is smoothed; the clock begins at 3 s; there are payloads."""
    motion = random_motion(robot.n_joints, 12)
    dq = motion.dq * np.where(np.arange(12) % 3, 1.0, 0.005)[:, None]
    return Motion(motion.t + 3.0, motion.q, dq, motion.ddq, payload=np.resize(["", "tool1", "tool2", "tool1"], 12))


@pytest.fixture(params=CATALOGUE)
def term(request, robot, motion):
    return made(request.param, robot, motion)


@pytest.fixture
def scene(robot):
    """Ten seconds of a rigid robot with dry friction."""
    motion = smooth_motion(robot.n_joints, 10.0, 6.0)
    model = Model(robot, make_terms(["rigid_body", "coulomb_friction"], robot, motion))
    theta = np.concatenate([sensible(term, robot) for term in model.terms])
    effort = model.effort(motion, theta)
    return Scene(
        robot=robot,
        motion=motion,
        actuators=robot.actuators(motion),
        effort=effort,
        measured=np.abs(effort),
        links=theta[: 10 * robot.n_joints],
        effort_with=lambda other, moving: replace(model, robot=other).effort(moving, theta),
    )


def sensible(term, robot, seed=0):
    """A physical point of the term's cone."""
    size = len(term.parameters(robot))
    if len(term.cone(robot).bodies):
        return parameters_of(random_clouds(size // 10, seed))
    return np.random.default_rng(seed).uniform(0.1, 2.0, size)


def of_joints(term, joints, n):
    """The term in some of its n joints only."""
    shape = {
        key: tuple(values[j - 1] for j in joints) if len(values) == n else values for key, values in term.shape.items()
    }
    return make_effect(term.name, {**shape, "joints": joints})


# ---------------------------------------------------------------------------------------------------------------
# Properties of every term
# ---------------------------------------------------------------------------------------------------------------
def test_every_term_has_an_entry():
    assert set(EFFORTS) == set(CATALOGUE)


def test_catalogue_holds_every_file_of_the_folder():
    files = {one.name for one in pkgutil.iter_modules(bayesid.model.terms.__path__)} - {"base"}
    assert {name.split(".")[0] for name in CATALOGUE} == files
    assert all(kind.__module__ == f"bayesid.model.terms.{name.split('.')[0]}" for name, kind in CATALOGUE.items())
    assert set(STANDARD) <= set(CATALOGUE)


def test_columns_are_the_efforts_of_each_parameter(term, table, robot, motion):
    columns = term.columns(robot, motion)
    assert columns.shape == (len(motion), robot.n_joints, len(term.parameters(robot)))
    found = np.moveaxis(columns, 2, 0)
    base, steps = sensible(term, robot), np.eye(columns.shape[2])
    effort = partial(by_hand, term.name, table, motion)
    differences = [effort(base + e) - effort(base) for e in steps]
    assert_close(found, np.array(differences), 1e-11)
    assert_close(columns @ base, effort(base), 1e-12)


@pytest.mark.parametrize("term", MEMORYLESS, indirect=True)
def test_columns_of_a_part_are_a_part_of_the_columns(term, robot, motion):
    columns = term.columns(robot, motion)
    for rows in (slice(0, 5), slice(5, None), np.array([7, 2, 2]), np.arange(12) % 2 == 0):
        np.testing.assert_allclose(term.columns(robot, motion[rows]), columns[rows], rtol=1e-14, atol=0)


def test_chunks_have_the_columns_of_the_whole(monkeypatch, term, robot, motion):
    monkeypatch.setattr("bayesid.model.model.CHUNK", 5)
    whole, model = term.columns(robot, motion), Model(robot, (term,))
    pieces = list(model.chunks(motion))
    assert [len(columns) for _, columns in pieces] == [5, 5, 2]
    assert_close(np.concatenate([columns for _, columns in pieces]), whole, 1e-14)
    alone = np.concatenate([model.columns(motion[rows]) for rows, _ in pieces])
    assert np.allclose(alone, whole, rtol=1e-12, atol=0) is not term.memory


@pytest.mark.parametrize("term", OF_JOINTS, indirect=True)
def test_term_in_some_joints_has_the_columns_of_these(term, robot, motion):
    columns, parameters = term.columns(robot, motion), term.parameters(robot)
    for joints in ((2,), (3, 1)):
        part = of_joints(term, joints, robot.n_joints)
        part.check(robot.n_joints)
        chosen = [k for j in joints for k, parameter in enumerate(parameters) if parameter.joint == j]
        assert part.joints == joints
        assert part.parameters(robot) == tuple(parameters[k] for k in chosen)
        np.testing.assert_array_equal(part.columns(robot, motion), columns[:, :, chosen])
        chosen_too = [k for k, index in enumerate(chosen) if index in term.cone(robot).nonnegative]
        np.testing.assert_array_equal(part.cone(robot).nonnegative, chosen_too)
        others = np.delete(np.arange(robot.n_joints), np.array(joints) - 1)
        assert not part.columns(robot, motion)[:, others].any()


def test_cone_fits_the_parameters(term, robot):
    cone, theta = term.cone(robot), sensible(term, robot)
    assert cone.size == len(theta) == len(term.parameters(robot))
    assert cone.contains(theta)
    for index in [*cone.nonnegative, *cone.bodies[:, 9]]:
        bad = theta.copy()
        bad[index] *= -1
        assert not cone.contains(bad)


def test_only_what_cannot_be_negative_is_kept_from_it(term, robot):
    names = [parameter.name for parameter in term.parameters(robot)]
    symbols = EFFORTS[term.name].nonnegative
    kept = {f"{symbol}{j + 1}" for symbol in symbols for j in range(robot.n_joints)}
    assert {names[k] for k in term.cone(robot).nonnegative} == kept
    bodies = {"rigid_body": robot.n_joints, "payload": 1, "payload.carried": 1}.get(term.name, 0)
    assert term.cone(robot).bodies.shape == (bodies, 10)
    if not bodies:
        assert term.cone(robot).contains(np.where([name in kept for name in names], 1.0, -1.0))


def test_term_describes_itself(term, robot):
    assert isinstance(term, Term)
    assert CATALOGUE[term.name] is type(term)
    assert term.name.split(".")[0] in CATALOGUE
    assert term.physics[0].isupper()
    assert term.physics.endswith(".")
    assert ". " not in term.physics
    assert term.variable in VARIABLES
    for text in (term.physics, term.reference, term.shown_by):
        assert text.strip() == text != ""
        assert "\n" not in text
    for parameter in term.parameters(robot):
        assert parameter.unit
        assert 1 <= parameter.joint <= robot.n_joints
        assert str(parameter.joint) in parameter.name or parameter.name.endswith(term.payloads)


@pytest.mark.parametrize("name", OF_JOINTS)
def test_joint_that_slides_has_forces_and_metres(name):
    kind = CATALOGUE[name]
    assert len(kind.units) == len(kind.symbols)
    for turning, sliding in kind.units:
        assert sliding == turning.replace("N m", "N").replace("rad", "m").replace("kg m^2", "kg")


def test_term_comes_back_from_its_name_and_shape(term, robot, motion):
    shape = {key: json.loads(json.dumps(values)) for key, values in term.shape.items()}
    again = make_effect(term.name, shape)
    assert again == term
    np.testing.assert_array_equal(again.columns(robot, motion), term.columns(robot, motion))


def test_check_takes_only_numbers_of_this_robot(term, robot):
    n = robot.n_joints
    term.check(n)
    for key, values in term.shape.items():
        for wrong in (values[:-1], [*values, values[0]]):
            with pytest.raises(ValueError, match=f"{key} has {len(wrong)} numbers"):
                make_effect(term.name, {**term.shape, key: wrong}).check(n)
    if isinstance(term, ActuatorTerm):
        for joints in ((n + 1,), (0,), (2, 2)):
            first = [min(max(j, 1), n) for j in joints]
            shape = {**of_joints(term, first, n).shape, "joints": joints}
            with pytest.raises(ValueError, match="not joints of the robot"):
                make_effect(term.name, shape).check(n)


@pytest.mark.parametrize("name", NEED_A_SHAPE)
def test_shape_that_no_motion_tells_is_asked_for(name, robot, motion):
    with pytest.raises(InputError, match=r"bayesid discrepancy|carrying") as caught:
        CATALOGUE[name].for_motion(robot.actuators(motion))
    assert caught.value.where == "--terms"
    assert caught.value.what.startswith(f"{name} ")
    with pytest.raises(InputError, match=r"bayesid discrepancy|carrying"):
        make_terms(["rigid_body", name], robot, motion)


# ---------------------------------------------------------------------------------------------------------------
# Forms in which an effect may be hidden
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", CATALOGUE)
def test_variants_are_terms_of_this_robot(name, robot, scene):
    variants = list(CATALOGUE[name].variants(scene))
    assert len(set(variants)) == len(variants)
    if not CATALOGUE[name].can_be_missing:
        assert not variants
        return
    joints = {(j + 1,) for j in range(robot.n_joints)} if name in OF_JOINTS else {()}
    assert {one.joints for one in variants} == joints
    for one in variants:
        one.check(robot.n_joints)
        assert type(one) is CATALOGUE[name]
        assert make_effect(name, one.shape) == one
        assert {type(value) for values in one.shape.values() for value in values} <= {int, float}  # as in TOML
    for one in variants[:: max(1, len(variants) // 40)]:
        columns = one.columns(robot, scene.motion)
        assert columns.shape == (len(scene.motion), robot.n_joints, len(one.parameters(robot)))
        assert len(one.parameters(robot)) == one.cone(robot).size
        assert np.isfinite(columns).all()
        assert columns.any()


def test_variants_go_through_what_the_log_can_tell(robot, scene):
    """Positions that were reached, ways that were covered, speeds that were passed, waves that were sampled."""
    u, speeds, last = scene.actuators.q, np.abs(scene.actuators.dq), scene.motion.t[-1]

    def values(name, key, j):
        return np.array([getattr(one, key)[0] for one in CATALOGUE[name].variants(scene) if one.joints == (j + 1,)])

    for j in range(robot.n_joints):
        for name in ("cable_drag", "cable_drag.friction", "cable_drag.stiffening"):
            starts = values(name, "start", j)
            assert u[:, j].min() < starts.min() < np.median(u[:, j]) < starts.max() < u[:, j].max()
            assert len(set(starts)) >= 9
        assert set(values("cable_drag", "side", j)) == {-1.0, 1.0}
        for name in ("hysteresis", "hysteresis.layers", "hysteresis.smooth", "hysteresis.elastic"):
            widths = values(name, "width", j)
            assert 0 < widths.min() <= 0.02
            assert widths.max() < np.ptp(u[:, j]) / 2
        assert 0 < values("stribeck_friction", "speed", j).min() < values("stribeck_friction", "speed", j).max()
        assert values("stribeck_friction", "speed", j).max() < speeds[:, j].max() / 2
        knees = values("viscous_friction.saturating", "knee", j)
        assert 0.05 * speeds[:, j].max() < knees.min() < 0.2 * speeds[:, j].max()
        assert 0.5 * speeds[:, j].max() < knees.max() < speeds[:, j].max()
        for name in ("thermal_drift", "thermal_drift.viscous", "thermal_drift.both", "thermal_drift.offset"):
            times = values(name, "time", j)
            assert 0 < times.min() < last < times.max() < 2 * last
        waves = values("torque_ripple", "harmonic", j)
        usual = np.percentile(speeds[:, j], 80)
        assert waves.max() * usual < np.pi * 6.0 <= 2 * (waves.max() + np.diff(waves)[0]) * usual
        assert np.diff(waves).max() * np.ptp(u[:, j]) < np.pi or len(waves) >= 400
        for name in ("coulomb_friction", "load_dependent_friction", "stribeck_friction", "cable_drag.friction"):
            np.testing.assert_allclose(values(name, "smoothing", j), 0.01 * speeds[:, j].max(), rtol=1e-14)


# ---------------------------------------------------------------------------------------------------------------
# Hysteresis
# ---------------------------------------------------------------------------------------------------------------
def test_presliding_forgets_what_lies_two_widths_back(monkeypatch, robot):
    """A difference of two states never grows: stretched fully once, it is gone; gradually, it falls with the way."""
    motion = smooth_motion(robot.n_joints, 4.0, 50.0)
    monkeypatch.setattr("bayesid.model.model.CHUNK", 40)
    monkeypatch.setattr("bayesid.model.model.LOOK_BACK", 60)
    u = robot.actuators(motion).q
    ways = [np.abs(np.diff(u[s - 60 : s + 1], axis=0)).sum(axis=0) for s in (80, 120, 160)]
    ranges = [np.ptp(u[s - 60 : s + 1], axis=0) for s in (80, 120, 160)]
    width = 0.1 * np.min(ranges, axis=0)
    for name, error in (("hysteresis", 0.0), ("hysteresis.smooth", 2 * np.exp(-np.min(ways, axis=0) / width).max())):
        term = make_effect(name, {"width": width})
        whole = term.columns(robot, motion)
        pieces = np.concatenate([columns for _, columns in Model(robot, (term,)).chunks(motion)])
        assert error < 1e-3
        np.testing.assert_allclose(pieces, whole, rtol=0, atol=error + 1e-13)


@pytest.mark.parametrize("name", ["hysteresis", "hysteresis.smooth"])
def test_presliding_is_dry_friction_over_long_ways(name):
    robot = robot_from_table(TABLES["kr5"], "test")
    motion = smooth_motion(6, 10.0, 100.0)
    term = make_effect(name, {"width": [1e-4] * 6})
    state = term.columns(robot, motion)[1:, 0, 0]
    step = np.diff(motion.q[:, 0])
    fast = np.abs(step) > 40e-4  # of two widths, or e^-40
    assert fast.sum() > 100
    np.testing.assert_allclose(state[fast], np.sign(step[fast]), rtol=0, atol=1e-15)


def test_presliding_of_a_robot_at_rest_is_nothing():
    robot = robot_from_table(TABLES["kr5"], "test")
    rest = Motion(np.arange(5.0), np.ones((5, 6)), np.zeros((5, 6)), np.zeros((5, 6)))
    for name in ("hysteresis", "hysteresis.smooth"):
        term = make_effect(name, {"width": [0.1] * 6})
        for still in (rest, rest[:1]):
            np.testing.assert_array_equal(term.columns(robot, still), 0.0)


# ---------------------------------------------------------------------------------------------------------------
# Models
# ---------------------------------------------------------------------------------------------------------------
def test_model_stacks_its_terms(table, robot, motion):
    terms = [made(name, robot, motion) for name in CATALOGUE]
    model = Model(robot, tuple(terms[:2])).extend(terms[2])
    for term in terms[3:]:
        model = model.extend(term)
    names = [parameter.name for parameter in model.parameters]
    assert len(set(names)) == len(names)
    theta = np.concatenate([sensible(term, robot, seed) for seed, term in enumerate(terms)])
    assert model.cone.size == len(theta) == len(names)
    assert model.cone.contains(theta)
    efforts = [by_hand(term.name, table, motion, sensible(term, robot, seed)) for seed, term in enumerate(terms)]
    assert_close(model.effort(motion, theta), sum(efforts), 1e-12)
    bad = theta.copy()
    bad[names.index("Fc2")] = -0.1
    assert not model.cone.contains(bad)


def test_model_efforts_do_not_depend_on_the_chunks(monkeypatch, robot, motion):
    model = Model(robot, make_terms(STANDARD, robot, motion))
    theta = np.random.default_rng(0).normal(size=len(model.parameters))
    whole = model.effort(motion, theta)
    monkeypatch.setattr("bayesid.model.model.CHUNK", 5)
    model.forget()
    assert [len(columns) for _, columns in model.chunks(motion)] == [5, 5, 2]
    assert_close(model.effort(motion, theta), whole, 1e-14)


def test_model_without_terms_has_an_empty_cone(robot):
    assert Model(robot, ()).cone.size == 0
    assert Cone.free(0).contains(np.empty(0))


def test_dry_friction_is_smoothed_below_standstill_of_each_actuator(table, robot, motion):
    (term,) = make_terms(["coulomb_friction"], robot, motion)
    top = np.abs(gear(table, motion.dq)).max(axis=0)
    assert STANDSTILL == 0.01
    np.testing.assert_allclose(term.smoothing, 0.01 * top, rtol=1e-14)


@pytest.mark.filterwarnings("error")
def test_actuator_that_never_moves_has_no_dry_friction():
    robot = robot_from_table(TABLES["kr5"], "test")
    dq = np.ones((5, 6)) * [0.1, 0.2, 0.0, 0.4, 0.5, 0.6]
    still = Motion(np.arange(5.0), np.ones((5, 6)), dq, np.zeros((5, 6)))
    columns = make_terms(["coulomb_friction"], robot, still)[0].columns(robot, still)
    np.testing.assert_array_equal(columns[:, 2], 0.0)
    assert np.isfinite(columns).all()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["rigid_body", "stiction"], "terms: unknown term 'stiction'"),
        ([""], "terms: unknown term ''"),
        (["rigid_body", "torque_offset", "rigid_body"], "terms: term 'rigid_body' comes twice"),
    ],
)
def test_bad_names(names, said):
    robot = robot_from_table(TABLES["random"], "test")
    with pytest.raises(InputError, match=said) as caught:
        make_terms(iter(names), robot, random_motion(4))
    assert "\n" not in str(caught.value)
