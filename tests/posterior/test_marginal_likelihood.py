import numpy as np
import pytest
from posterior_problems import disc, quadrature, simulate, target_in
from scipy import stats

from bayesid.effects.parameters import Cone
from bayesid.posterior.feasible_set import FeasibleSet
from bayesid.posterior.modes import Normal, bridge, integrate, mode_weights, truncate, truncate_by_splitting
from bayesid.posterior.sampler import Sampling, sample
from bayesid.robot.inertia import from_pseudo_inertia

MANY = {"groups": 10, "walkers": 400}


def test_two_dimensions_match_quadrature(rng):
    theta = (1.5, -1.0)
    target = simulate(target_in(disc(), np.zeros(2)), np.array(theta), np.zeros(1), rng, rows=20, segments=5)
    axes = [np.linspace(-1, 1, 400), np.linspace(-0.3, 1, 260), np.linspace(-1.2, 1.2, 20)]
    exact = quadrature(target, axes)[0]
    draws = sample(target, np.array(theta), Sampling(walkers=32))
    mass = integrate(target, draws, **MANY)
    assert abs(mass.log_value - exact) < max(4 * mass.standard_error, 0.06)


@pytest.mark.parametrize("mean", [0.5, -12.0])
def test_share_of_a_half_line(mean):
    region = FeasibleSet.of(Cone.orthant(1))
    normal = Normal(np.array([[4.0]]), np.array([4.0 * mean]))
    exact = stats.norm.logcdf(2.0 * mean)
    for method in (truncate, truncate_by_splitting):
        theta, log_mass = method(region, normal, np.ones(1), np.random.RandomState(0), **MANY)
        error = log_mass.std(ddof=1) / np.sqrt(10)
        assert abs(log_mass.mean() - normal.log_integral - exact) < max(4 * error, 0.03)
        assert np.all(theta > 0.0)


def test_share_of_a_rigid_body_matches_rejection(rng):
    region, body = FeasibleSet.of(Cone.rigid_bodies(1)), from_pseudo_inertia(np.diag([0.3, 0.5, 0.8, 1.0]))
    share = region.contains((body + 0.5 * rng.standard_normal((400_000, 10))).T).mean()
    normal = Normal(4.0 * np.eye(10), 4.0 * body)
    _, log_mass = truncate(region, normal, body, np.random.RandomState(0), **MANY)
    error = log_mass.std(ddof=1) / np.sqrt(10)
    assert abs(log_mass.mean() - normal.log_integral - np.log(share)) < max(4 * error, 0.05)


def test_bridge_between_two_normal_distributions(rng):
    a, b = rng.standard_normal(20_000), 1.0 + 2.0 * rng.standard_normal(10_000)

    def log_ratio(x):
        return -0.5 * x**2 + 0.125 * (x - 1.0) ** 2

    assert abs(bridge(log_ratio(a), log_ratio(b)) - np.log(0.5)) < 0.03


def test_weights_sum_to_one():
    weights = mode_weights(np.array([-1000.0, -1001.0, -2000.0]))
    assert np.isclose(weights.sum(), 1.0)
    assert np.isclose(weights[1] / weights[0], np.exp(-1.0))
