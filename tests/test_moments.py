import numpy as np
import pytest
from conftest import random_motion, small_robot

from bayesid import model as model_module
from bayesid.coefficients import base_coefficients
from bayesid.model import Model
from bayesid.moments import moments
from bayesid.segments import Segments
from bayesid.terms import DEFAULT, make_terms


@pytest.fixture(scope="module")
def case():
    robot, motion = small_robot(3), random_motion(3, 250, seed=1)
    model = Model(robot, make_terms(DEFAULT, robot, motion))
    coefficients = base_coefficients(model)
    effort = np.abs(np.random.default_rng(2).normal(size=(250, 3))) + np.array([0.1, 0.5, 1.0])
    joint, start, end = np.array([0, 0, 1, 2, 2]), np.array([0, 40, 3, 0, 100]), np.array([40, 170, 250, 99, 101])
    segments = Segments(joint, start, end, np.array([0, 0, 1, 0, 0]), np.ones(5, dtype=bool))
    return model, coefficients, motion, effort, segments


def test_cost_equals_the_sum_over_rows(case):
    model, coefficients, motion, effort, segments = case
    m = moments(model, coefficients, motion, effort, segments)
    rng = np.random.default_rng(0)
    theta, signs = rng.normal(size=len(model.parameters)), np.array([1, -1, 1, -1, -1])
    sigma = np.array([0.5, 2.0, 3.0])
    torque = model.effort(motion, theta)
    by_hand = sum(
        np.sum((s * effort[a:b, j] - torque[a:b, j]) ** 2) / sigma[j] ** 2
        for j, a, b, s in zip(segments.joint, segments.start, segments.end, signs, strict=True)
    )
    assert m.scaled(sigma).cost(coefficients.project(theta), signs) == pytest.approx(by_hand, rel=1e-10)
    assert m.count.tolist() == [40, 130, 247, 99, 1]


def test_chunks_add_to_the_whole(case, monkeypatch):
    model, coefficients, motion, effort, segments = case
    whole = moments(model, coefficients, motion, effort, segments)
    monkeypatch.setattr(model_module, "CHUNK", 37)
    chunked = moments(model, coefficients, motion, effort, segments)
    for name in ("hessian", "gradient", "energy"):
        np.testing.assert_allclose(getattr(chunked, name), getattr(whole, name), rtol=1e-11, atol=1e-9)


def test_two_logs_join(case):
    model, coefficients, motion, effort, segments = case
    m = moments(model, coefficients, motion, effort, segments)
    both = m.join(m)
    beta, signs = np.random.default_rng(3).normal(size=len(coefficients)), np.array([1, 1, -1, 1, -1])
    twice = np.concatenate([signs, -signs])
    assert both.cost(beta, twice) == pytest.approx(m.cost(beta, signs) + m.cost(beta, -signs))


def test_moments_of_different_segments_do_not_add(case):
    model, coefficients, motion, effort, segments = case
    m = moments(model, coefficients, motion, effort, segments)
    double = m + m
    np.testing.assert_allclose(double.gradient, 2 * m.gradient)
    with pytest.raises(ValueError, match="same segments"):
        m + moments(model, coefficients, motion, effort, segments[np.array([0, 1])])


def test_residuals_by_joint_equal_those_of_the_rows(case):
    model, coefficients, motion, effort, segments = case
    m = moments(model, coefficients, motion, effort, segments)
    theta = np.random.default_rng(5).normal(size=len(model.parameters))
    signs, torque = np.array([1, -1, 1, -1, 1]), model.effort(motion, theta)
    errors: list[list[float]] = [[], [], []]
    for j, a, b, s in zip(segments.joint, segments.start, segments.end, signs, strict=True):
        errors[j] += (s * effort[a:b, j] - torque[a:b, j]).tolist()
    by_hand = [np.sqrt(np.mean(np.square(values))) for values in errors]
    np.testing.assert_allclose(m.residual_sd(coefficients.project(theta), signs, 3), by_hand, rtol=1e-9)
    assert m.rms_effort(3)[2] == pytest.approx(np.sqrt(np.mean(effort[np.r_[0:99, 100:101], 2] ** 2)))
