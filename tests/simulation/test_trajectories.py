import numpy as np
import pytest

from bayesid.effects.coefficients import base_coefficients
from bayesid.simulation.paper import paper_model
from bayesid.simulation.trajectories import (
    FourierTrajectory,
    MotionLimits,
    condition_number,
    exciting_trajectory,
    random_trajectory,
)

DURATION = 13.33
TIMES = np.linspace(0.0, DURATION, 667)


@pytest.fixture(scope="module")
def model():
    return paper_model()


@pytest.fixture(scope="module")
def coefficients(model):
    return base_coefficients(model)


@pytest.fixture(scope="module")
def trajectory(model, coefficients):
    return exciting_trajectory(model, coefficients, DURATION, seed=3)


def peaks(trajectory, seed=0):
    """Largest values at instants that no grid knows."""
    motion = trajectory.motion(np.random.default_rng(seed).uniform(0, 1 / trajectory.frequency, 20_000))
    return [np.abs(values).max(axis=0) for values in (motion.q, motion.dq, motion.ddq)]


def test_the_series_is_what_its_definition_says():
    sine, cosine = np.array([[0.5, -0.2], [0.1, 0.3]]), np.array([[0.0, 0.4], [-0.7, 0.05]])
    series = FourierTrajectory(0.25, sine, cosine, np.array([0.3, -1.1]))
    t, w = 1.7, 2 * np.pi * 0.25
    want = -1.1 + 0.1 * np.sin(w * t) + 0.3 * np.sin(2 * w * t) - 0.7 * np.cos(w * t) + 0.05 * np.cos(2 * w * t)
    assert series.motion(np.array([t])).q[0, 1] == pytest.approx(want, abs=1e-14)


def test_derivatives_agree_with_finite_differences():
    rng, h = np.random.default_rng(5), 1e-5
    series = FourierTrajectory(0.31, rng.normal(size=(3, 4)), rng.normal(size=(3, 4)), rng.normal(size=3))
    t = rng.uniform(-2, 9, 50)
    before, here, after = (series.motion(t + step) for step in (-h, 0.0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), here.dq, atol=2e-6)
    np.testing.assert_allclose((after.dq - before.dq) / (2 * h), here.ddq, atol=2e-5)


@pytest.mark.parametrize(("harmonics", "duration"), [(1, 13.33), (5, 2.0), (9, 60.0)])
def test_each_joint_touches_one_limit_and_breaks_none(harmonics, duration):
    limits = MotionLimits(lower=(-2.0, -3.0, -0.4), upper=(2.0, -0.1, 2.5), velocity=(3.0, 1.0, 2.0), acceleration=8.0)
    middle, half = np.array([0.0, -1.55, 1.05]), np.array([2.0, 1.45, 1.45])
    for seed in range(5):
        series = random_trajectory(3, duration, rng=seed, limits=limits, harmonics=harmonics)
        motion = series.motion(np.random.default_rng(seed).uniform(0, duration, 20_000))
        assert np.all(motion.q >= limits.lower)
        assert np.all(motion.q <= limits.upper)
        swing = np.abs(motion.q - series.centre).max(axis=0) / (half - np.abs(series.centre - middle))
        speed, push = np.abs(motion.dq).max(axis=0) / limits.velocity, np.abs(motion.ddq).max(axis=0) / 8.0
        used = np.maximum.reduce([swing, speed, push])
        assert np.all(used <= 1.0 + 1e-12)
        assert np.all(used > 0.97)


def test_exciting_trajectory_keeps_the_default_limits(trajectory):
    q, dq, ddq = peaks(trajectory)
    assert np.all(q <= 2.0)
    assert np.all(dq <= 3.0)
    assert np.all(ddq <= 15.0)


def test_condition_number_is_half_of_a_random_trajectory(model, coefficients, trajectory):
    found = condition_number(model, coefficients, trajectory.motion(TIMES))
    others = [random_trajectory(6, DURATION, rng=seed).motion(TIMES) for seed in range(40)]
    random = [condition_number(model, coefficients, other) for other in others]
    assert found < min(4.0, 0.45 * np.median(random), 0.7 * min(random))


def test_condition_number_agrees_with_an_svd_of_the_projected_rows(model, coefficients, trajectory):
    """The regressor of the coefficients recomputed without `kept`: Y B^+ has the same columns, Y = (Y B^+) B."""
    motion = trajectory.motion(TIMES)
    rows = model.robot.regressor(motion).reshape(-1, 60) @ np.linalg.pinv(coefficients.projection)
    values = np.linalg.svd(rows / np.sqrt((rows**2).sum(axis=0)), compute_uv=False)
    assert condition_number(model, coefficients, motion) == pytest.approx(values[0] / values[-1], rel=1e-9)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="duration"):
        random_trajectory(2, 0.0)
    with pytest.raises(ValueError, match="periods"):
        random_trajectory(2, 5.0, periods=0)
    with pytest.raises(ValueError, match="shape"):
        random_trajectory(3, 5.0, limits=MotionLimits(velocity=(1.0, 2.0)))
    for wrong in ({"lower": 1.0, "upper": 1.0}, {"velocity": 0.0}, {"upper": float("nan")}):
        with pytest.raises(ValueError, match="limit"):
            MotionLimits(**wrong)
    with pytest.raises(ValueError, match="frequency"):
        FourierTrajectory(0.0, np.ones((1, 1)), np.ones((1, 1)), np.zeros(1))
