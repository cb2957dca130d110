import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from oracles import assert_close, random_motion, random_table

from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.friction import CoulombFriction, ThermalDrift
from bayesid.effects.model import Model
from bayesid.robot import load_robot, robot_from_table

DIFFERENT = ("kr5", "panda", "ur10e", "tx40")  # standard, modified, parallel axes, coupled wrist
ROBOTS = {name: load_robot(name) for name in DIFFERENT} | {
    "standard1": robot_from_table(random_table("standard", 1, seed=1), "test"),
    "prismatic": robot_from_table(random_table("standard", 5, seed=5), "test"),
    "modified4": robot_from_table(random_table("modified", 4, seed=4, coupled=True), "test"),
}


def evaluate(expression, model, theta):
    """The value of 'J1yy + 2 a1 mc1x - a2^2 M2', for parameters in the last axis of theta."""
    values = {parameter.name: theta[..., k] for k, parameter in enumerate(model.parameters)}
    n = model.robot.n_joints
    values |= {f"M{i}": sum(values[f"m{j}"] for j in range(i, n + 1)) for i in range(1, n + 1)}
    python = re.sub(r"(?<=[\w)]) (?=[\w(])", "*", expression.replace("^", "**"))
    return eval(python, {"__builtins__": {}}, values | dict(model.robot.lengths))


@cache
def standard(name):
    """The robot with all standard effects, and its coefficients."""
    robot = ROBOTS[name]
    model = Model(robot, make_terms(STANDARD, robot, random_motion(robot.n_joints)))
    return model, base_coefficients(model)


@pytest.fixture(params=ROBOTS)
def name(request):
    return request.param


def torque_rows(robot, samples, seed):
    """Efforts of unit parameters by Newton-Euler, scaled to columns of unit length; the ones of zero dropped."""
    motion = random_motion(robot.n_joints, samples, seed)
    base = np.tile(np.eye(10)[9], robot.n_joints)  # Newton-Euler needs masses
    without = robot.inverse_dynamics(motion, base)
    columns = [(robot.inverse_dynamics(motion, base + e) - without).ravel() for e in np.eye(10 * robot.n_joints)]
    lengths = np.linalg.norm(columns, axis=1)
    return np.array([c / length for c, length in zip(columns, lengths, strict=True) if length > 1e-9 * lengths.max()]).T


def test_rank_is_that_of_newton_euler(name):
    singular = np.linalg.svd(torque_rows(ROBOTS[name], 150, seed=7), compute_uv=False)
    singular = np.append(singular, 1e-16)  # a full rank ends at rounding
    rank = int(np.argmax(singular[:-1] / singular[1:])) + 1
    assert singular[rank - 1] > 1e6 * singular[rank], "the gap is clear"
    assert len(base_coefficients(Model(ROBOTS[name], (RigidBody(),)))) == rank


def test_expressions_say_what_is_computed(name):
    model = Model(ROBOTS[name], (RigidBody(),))
    coefficients, theta = base_coefficients(model), np.random.default_rng(3).normal(size=(4, len(model.parameters)))
    found = np.array([evaluate(expression, model, theta) for expression in coefficients.expressions]).T
    exact = all(not re.search(r"\d\.\d", expression) for expression in coefficients.expressions)
    assert exact or name not in DIFFERENT, "every length of a built-in robot is spelled out"
    assert_close(found, coefficients.project(theta), 1e-9 if exact else 1e-5)


def test_efforts_depend_on_the_coefficients_alone(name):
    model, coefficients = standard(name)
    rng = np.random.default_rng(1)
    theta, motion = rng.normal(size=(3, len(model.parameters))), random_motion(model.robot.n_joints, 20, seed=8)
    columns = model.columns(motion)
    expected = columns @ theta.T
    assert_close(columns[:, :, coefficients.selected] @ coefficients.project(theta).T, expected, 1e-10)
    assert_close(columns @ coefficients.lift(coefficients.project(theta)).T, expected, 1e-10)
    beta = rng.normal(size=(3, len(coefficients)))
    np.testing.assert_allclose(coefficients.project(coefficients.lift(beta)), beta, rtol=0, atol=1e-11)
    np.testing.assert_allclose(coefficients.project(coefficients.lift(beta[0])), beta[0], rtol=0, atol=1e-11)
    r = len(coefficients)
    assert len(set(coefficients.names)) == len(set(coefficients.expressions)) == len(coefficients.units) == r
    assert list(coefficients.names) == [model.parameters[k].name for k in coefficients.selected]
    np.testing.assert_array_equal(coefficients.projection[:, coefficients.selected], np.eye(r))
    assert all(np.diff(coefficients.selected) > 0)


def test_neither_another_seed_nor_an_earlier_model_of_the_same_structure_changes_anything():
    for name in ("tx40", "modified4"):
        model, first = standard(name)
        for second in (base_coefficients(model, seed=11), base_coefficients(model, earlier=model)):
            assert first.names == second.names
            np.testing.assert_allclose(first.projection, second.projection, rtol=0, atol=1e-8)
        assert first.expressions == base_coefficients(model, seed=11).expressions


def test_gravity_decides_what_the_first_link_shows():
    """About a vertical first axis only Jzz shows; a tilted base adds two first moments."""
    for gravity, expected in (([0.0] * 3, ("J1zz",)), ([4.0, 2.0, -8.0], ("J1zz", "mc1x", "mc1y"))):
        robot = replace(load_robot("panda"), gravity=np.array(gravity))
        names = base_coefficients(Model(robot, (RigidBody(),))).names
        assert tuple(name for name in names if name[1:2] == "1" or name[2:3] == "1") == expected


def with_payload(name):
    """The robot with all standard effects, and the same with a payload."""
    robot = ROBOTS[name]
    part = Model(robot, make_terms(STANDARD, robot, random_motion(robot.n_joints)))
    return part, part.extend(make_effect("payload", {}))


@pytest.mark.parametrize("name", ["ur10e", "tx40", "modified4", "standard1"])
def test_a_payload_is_no_news_but_to_one_who_knew_the_robot_without_it(name):
    """As many coefficients more as the last link has of its own, by singular values."""
    part, whole = with_payload(name)
    r = len(base_coefficients(part))
    assert len(base_coefficients(whole)) == r
    columns = whole.columns(random_motion(ROBOTS[name].n_joints, 150, seed=7))[:, :, -10:].reshape(-1, 10)
    lengths = np.linalg.norm(columns, axis=0)
    seen = columns[:, lengths > 1e-9 * lengths.max()] / lengths[lengths > 1e-9 * lengths.max()]
    own = np.linalg.matrix_rank(seen, tol=1e-6)
    both = base_coefficients(whole, earlier=part)
    assert len(both) == r + own
    assert set(base_coefficients(part).names) <= set(both.names)


def test_columns_that_are_nearly_one_leave_no_tiny_terms_in_expressions():
    """Coulomb friction and the cold friction of thermal drift, at two slightly different standstill speeds."""
    coulomb = CoulombFriction(smoothing=tuple(np.linspace(0.0084673, 0.02, 6).tolist()))
    terms = (RigidBody(), coulomb, ThermalDrift(joints=(1,), smoothing=(0.0084657,), time=(6.0,)))
    expressions = base_coefficients(Model(ROBOTS["ur10e"], terms)).expressions
    assert [text for text in expressions if "Fcold1" in text] == ["Fc1 + Fcold1"]
