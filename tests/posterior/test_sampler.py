from dataclasses import replace

import numpy as np
import pytest
from posterior_problems import disc, quadrature, simulate, target_in

from bayesid.errors import InputError
from bayesid.posterior.feasible_set import barrier_minimum
from bayesid.posterior.sampler import Sampling, sample

FEW = Sampling(walkers=16)


def small(rng, **kwargs):
    return simulate(target_in(disc(), np.zeros(2)), np.array([0.9, -0.2]), np.zeros(2), rng, **kwargs)


def test_runs_until_converged(rng):
    target = small(rng)
    draws = sample(target, np.array([0.9, -0.2]), FEW)
    assert draws.converged
    assert draws.diagnostics.max_rhat <= 1.01
    assert draws.diagnostics.min_ess >= 400
    assert draws.theta.shape == (draws.sweeps, 4, 16, 2)
    assert draws.log_density.shape == draws.theta.shape[:3]
    assert np.allclose(target.log_density(draws.coordinates), draws.log_density.ravel())
    axes = [np.linspace(-1, 1, 80), np.linspace(-0.3, 1, 80), np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)]
    _, mean, sd = quadrature(target, axes)
    assert np.all(np.abs(draws.coordinates.mean(axis=0) - mean) < 0.2 * sd)


def test_the_end_of_a_budget_is_reported(rng):
    calls = []
    for ends, timed_out in (({"budget": 0.0}, False), ({"time_limit": 0.0}, True)):
        options = Sampling(walkers=4, **ends)
        draws = sample(small(rng), np.array([0.9, -0.2]), options, lambda done, total: calls.append((done, total)))
        assert not draws.converged
        assert draws.timed_out == timed_out
        assert draws.sweeps == 8 == calls[-1][0]


def test_a_long_run_forgets_its_first_quarter(rng):
    target = small(rng)
    options = Sampling(walkers=4, warm_up=10, first_check=20, max_sweeps=30, min_ess=1e9)
    short, long = (sample(target, np.array([0.9, -0.2]), replace(options, max_sweeps=most)) for most in (30, 60))
    assert short.sweeps == 30  # the warm-up is a quarter of all
    assert long.sweeps == 52  # of 70
    assert np.array_equal(long.theta[:22], short.theta[8:])


def test_barrier_has_the_right_derivatives():
    region, theta = disc(), np.array([0.3, 0.4])
    slope, curvature = region.barrier_derivatives(theta)
    step = 1e-5 * np.eye(2)
    value = [[region.barrier(theta + sign * e) for sign in (1, -1)] for e in step]
    assert np.allclose(slope, np.diff(value)[:, 0] / -2e-5, rtol=1e-6)
    slopes = [[region.barrier_derivatives(theta + sign * e)[0] for sign in (1, -1)] for e in step]
    numeric = [(after - before) / 2e-5 for after, before in slopes]
    assert np.allclose(curvature, numeric, rtol=1e-6)


def test_centre_is_inside_however_far_outside_the_optimum(rng):
    target = small(rng, rows=4000, noise=0.01)
    centre = target.centre(np.array([5.0, -3.0]), np.zeros(2))
    assert target.prior.region.contains(centre.theta[:, None])[0]
    precision = 1e8 * np.eye(2)
    centre = barrier_minimum(disc(), precision, precision @ np.array([4.0, 3.0]), np.zeros(2))
    assert np.allclose(centre.theta, [0.8, 0.6], atol=1e-3)


def test_an_invalid_budget_is_refused():
    for budget in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError) as error:
            Sampling(budget=budget)
        assert error.value.field == "Sampling.budget"


@pytest.mark.parametrize("field", ["min_ess", "max_rhat", "per_walker"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_goal_that_is_no_number_is_refused(field, value):
    """An endless sample size was sampled for, and then could not be named in the checks."""
    with pytest.raises(InputError) as error:
        Sampling(**{field: value})
    assert error.value.field == f"Sampling.{field}"
