from dataclasses import replace

import numpy as np
import pytest
from oracles import (
    actuator_efforts,
    assert_close,
    built_in_table,
    dh_chain,
    joint_torques,
    parameters_of,
    random_clouds,
    random_motion,
    random_table,
)

from bayesid.errors import InputError
from bayesid.model import Model
from bayesid.motion import STANDSTILL, Motion
from bayesid.robot import robot_from_table
from bayesid.terms import CATALOGUE, DEFAULT, Cone, Term, make_term, make_terms

TABLES = {
    "kr5": built_in_table("kr5"),
    "tx40": built_in_table("tx40"),
    "random": random_table("modified", 4, seed=1),
    "coupled": random_table("standard", 3, seed=2, coupled=True),
}


def gear(table, values):
    """Joint speeds (or accelerations) to those of the motors, divided by the gear ratios."""
    if "transmission" not in table:
        return values
    gears = np.array(table["transmission"])
    return values @ gears.T / np.abs(np.diag(gears))


def rigid_body(table, motion, theta):
    """Each link's ten parameters as those of ten point masses, of either sign: the torque is linear in them."""
    axes = np.eye(3)
    points = np.array([np.zeros(3), *axes, *-axes, *(1 - axes)])
    one_each = np.array([parameters_of([(points[k : k + 1], np.ones(1))]) for k in range(10)]).T
    clouds = [(points, np.linalg.solve(one_each, link)) for link in theta.reshape(-1, 10)]
    torques = joint_torques(dh_chain(table), clouds, np.array(table["gravity"]), motion)
    return actuator_efforts(torques, table.get("transmission"))


# The effort of each term of the catalogue, written by hand; a new term needs a line here.
EFFORTS = {
    "rigid_body": rigid_body,
    "viscous_friction": lambda table, motion, theta: theta * gear(table, motion.dq),
    "coulomb_friction": lambda table, motion, theta: (
        theta * np.tanh(gear(table, motion.dq) / (0.01 * np.abs(gear(table, motion.dq)).max(axis=0)))
    ),
    "torque_offset": lambda table, motion, theta: np.tile(theta, (len(motion), 1)),
    "rotor_inertia": lambda table, motion, theta: theta * gear(table, motion.ddq),
}


@pytest.fixture(params=TABLES)
def table(request):
    return TABLES[request.param]


@pytest.fixture
def robot(table):
    return robot_from_table(table, "test")


@pytest.fixture
def motion(robot):
    """Some of the speeds are near zero, where dry friction is smoothed."""
    motion = random_motion(robot.n_joints, 12)
    return replace(motion, dq=motion.dq * np.where(np.arange(12) % 3, 1.0, 0.005)[:, None])


@pytest.fixture(params=CATALOGUE)
def term(request, robot, motion):
    return make_terms([request.param], robot, motion)[0]


def sensible(term, robot, seed=0):
    """A physical point of the term's cone."""
    if term.name == "rigid_body":
        return parameters_of(random_clouds(robot.n_joints, seed))
    return np.random.default_rng(seed).uniform(0.1, 2.0, len(term.parameters(robot)))


def test_columns_are_the_efforts_of_each_parameter(term, table, robot, motion):
    columns = term.columns(robot, motion)
    assert columns.shape == (len(motion), robot.n_joints, len(term.parameters(robot)))
    found = np.moveaxis(columns, 2, 0)
    base, steps = sensible(term, robot), np.eye(columns.shape[2])
    effort = EFFORTS[term.name]
    differences = [effort(table, motion, base + e) - effort(table, motion, base) for e in steps]
    assert_close(found, np.array(differences), 1e-11)
    assert_close(columns @ base, effort(table, motion, base), 1e-12)


def test_columns_of_a_part_are_a_part_of_the_columns(term, robot, motion):
    columns = term.columns(robot, motion)
    for rows in (slice(0, 5), slice(5, None), np.array([7, 2, 2]), np.arange(12) % 2 == 0):
        np.testing.assert_allclose(term.columns(robot, motion[rows]), columns[rows], rtol=1e-14, atol=0)


def test_cone_fits_the_parameters(term, robot):
    cone, theta = term.cone(robot), sensible(term, robot)
    assert cone.size == len(theta) == len(term.parameters(robot))
    assert cone.contains(theta)
    for index in [*cone.nonnegative, *cone.bodies[:, 9]]:
        bad = theta.copy()
        bad[index] *= -1
        assert not cone.contains(bad)


@pytest.mark.parametrize("name", ["viscous_friction", "coulomb_friction", "rotor_inertia"])
def test_nothing_drives_itself(name, robot, motion):
    cone = make_terms([name], robot, motion)[0].cone(robot)
    np.testing.assert_array_equal(cone.nonnegative, np.arange(robot.n_joints))


def test_offset_may_have_either_sign(robot):
    assert make_term("torque_offset", {}).cone(robot).contains(np.linspace(-1, 1, robot.n_joints))


def test_term_describes_itself(term, robot):
    assert isinstance(term, Term)
    assert CATALOGUE[term.name] is type(term)
    assert term.physics[0].isupper()
    assert term.physics.endswith(".")
    assert ". " not in term.physics
    assert "\n" not in term.physics
    for parameter in term.parameters(robot):
        assert parameter.unit
        assert 1 <= parameter.joint <= robot.n_joints
        assert str(parameter.joint) in parameter.name


def test_term_comes_back_from_its_name_and_shape(term, robot, motion):
    shape = {key: [float(repr(value)) for value in values] for key, values in term.shape.items()}
    again = make_term(term.name, shape)
    assert again == term
    np.testing.assert_array_equal(again.columns(robot, motion), term.columns(robot, motion))


def test_model_stacks_its_terms(table, robot, motion):
    terms = make_terms(CATALOGUE, robot, motion)
    model = Model(robot, terms[:2]).extend(terms[2])
    for term in terms[3:]:
        model = model.extend(term)
    names = [parameter.name for parameter in model.parameters]
    assert len(set(names)) == len(names)
    theta = np.concatenate([sensible(term, robot, seed) for seed, term in enumerate(terms)])
    assert model.cone.size == len(theta) == len(names)
    assert model.cone.contains(theta)
    by_hand = [EFFORTS[term.name](table, motion, sensible(term, robot, seed)) for seed, term in enumerate(terms)]
    assert_close(model.effort(motion, theta), sum(by_hand), 1e-12)
    bad = theta.copy()
    bad[names.index("Fc2")] = -0.1
    assert not model.cone.contains(bad)


def test_model_efforts_do_not_depend_on_the_chunks(monkeypatch, robot, motion):
    model = Model(robot, make_terms(DEFAULT, robot, motion))
    theta = np.random.default_rng(0).normal(size=len(model.parameters))
    whole = model.effort(motion, theta)
    monkeypatch.setattr("bayesid.model.CHUNK", 5)
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
        (["rigid_body", "stiction"], "--terms: unknown term 'stiction'"),
        ([""], "--terms: unknown term ''"),
        (["rigid_body", "torque_offset", "rigid_body"], "--terms: term 'rigid_body' comes twice"),
    ],
)
def test_bad_names(names, said):
    robot = robot_from_table(TABLES["random"], "test")
    with pytest.raises(InputError, match=said) as caught:
        make_terms(iter(names), robot, random_motion(4))
    assert "\n" not in str(caught.value)
