"""Summaries of a posterior's draws."""

from dataclasses import replace

import numpy as np
import pytest
from posterior_logs import FEW, LOG_SCALE_SD, infer_from, make_log, near_symmetric
from posterior_problems import whole_space
from scipy.stats import norm, truncnorm

from bayesid.effects.parameters import Cone
from bayesid.posterior.feasible_set import FeasibleSet
from bayesid.posterior.inference import Posterior, widened
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.modes import Mode, SampledMode
from bayesid.posterior.sampler import Diagnostics, Draws, Sampling
from bayesid.posterior.target import Target, TruncatedGaussian


def test_parameters_decided_by_the_data():
    # the first and the third parameter show in their sum alone; the fourth not at all
    log = make_log(
        (1.0, -0.7, 0.8, 0.5),
        rows=(30, 40, 30),
        known=(1, 0, 0),
        sd=(1.0, 0.5, 2.0, 0.1),
        mean=(0.5, 0.0, 0.5, 0.5),
        sigma=(0.3,),
        projection=[[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]],
    )
    posterior = infer_from(log, options=Sampling(walkers=4, budget=0.0))
    assert np.array_equal(posterior.decided_by_data, [False, True, False, False])


def numbered(sweeps, ensembles=4, walkers=16):
    """A posterior with numbered draws, two parameters and one coefficient."""
    sweep, place = np.meshgrid(np.arange(sweeps), np.arange(ensembles * walkers), indexing="ij")
    theta = np.stack([sweep, place], axis=-1).astype(float).reshape(sweeps, ensembles, walkers, 2)
    projection = np.array([[1.0, 10.0], [0.5, -1.0]])
    zero = np.zeros((1, 2, 2)), np.zeros(1), np.ones(1), np.zeros((1, 2)), np.zeros(1, dtype=int)
    likelihood = Likelihood(projection, *zero, np.zeros(1, dtype=int), np.ones(1))
    prior = TruncatedGaussian(whole_space(2), np.zeros(2), np.ones(2), np.full(1, LOG_SCALE_SD), np.zeros(2))
    log_scale = theta @ np.array([[0.0], [1e-3]]) + 1.0
    none = Diagnostics(np.ones(1), np.ones(1), np.ones(1))
    draws = Draws(theta, log_scale, theta @ projection.T, theta[..., 0], none, none, True, 1.0)
    mode = SampledMode(Mode(np.zeros(2), np.ones(1, dtype=int), 0.0), draws, None, 1.0)
    return Posterior(Target(prior, likelihood), None, None, (mode,), draws, np.ones(1), np.empty(0), None, 1.0, FEW)


@pytest.mark.parametrize(("sweeps", "count"), [(8, 24), (51, 24), (24, 256), (255, 256), (510, 256)])
def test_spread_draws_come_from_all_sweeps_and_walkers_alike(sweeps, count):
    posterior = numbered(sweeps)
    theta, log_scale = posterior.spread(count)
    assert theta.shape == (count, 2)
    assert log_scale.shape == (count, 1)
    assert np.allclose(log_scale[:, 0], 1.0 + 1e-3 * theta[:, 1])
    assert len(np.unique(theta, axis=0)) == count
    for values, size, parts in ((theta[:, 0], sweeps, 8), (theta[:, 1], 64, 4), (theta[:, 1], 64, 8)):
        counted = np.bincount((values * parts / size).astype(int), minlength=parts)
        assert np.all(np.abs(counted - count / parts) <= 0.35 * count / parts)
    early = theta[:, 0] < 0.5 * sweeps
    assert abs(np.mean(theta[early, 1]) - np.mean(theta[~early, 1])) < 10.0


def test_figures_of_the_draws():
    posterior = numbered(11)
    sweep, place = (values.ravel() for values in np.meshgrid(np.arange(11.0), np.arange(64.0)))
    assert np.allclose(posterior.theta, [5.0, 31.5])
    assert np.allclose(posterior.parameter_sd, [sweep.std(), place.std()])
    a, b = np.var(sweep), np.var(place)  # independent by their make
    covariance = np.array([[a + 100.0 * b, 0.5 * a - 10.0 * b], [0.5 * a - 10.0 * b, 0.25 * a + b]])
    assert np.allclose(posterior.covariance, covariance * 704 / 703)
    beta = np.stack([sweep + 10.0 * place, 0.5 * sweep - place])
    low, high = posterior.interval(0.8)
    for ends, share in ((low, 0.1), (high, 0.9)):
        assert np.allclose([np.mean(values < end) for values, end in zip(beta, ends, strict=True)], share, atol=0.02)


@pytest.mark.parametrize(("mean", "from_zero"), [(-1.0, True), (0.3, True), (8.0, False)])
def test_a_coefficient_that_cannot_be_negative_has_the_shortest_interval(mean, from_zero):
    """Normal draws cut at zero; far from it the shortest interval is the central one, of the free one it always is."""
    posterior = normal_draws(np.eye(2), cone=Cone.orthant(1) + Cone.free(1))
    drawn = truncnorm.rvs(-mean, np.inf, loc=mean, size=(400, 4, 16), random_state=1)
    beta = np.stack([drawn, drawn], axis=-1)
    posterior = replace(posterior, draws=replace(posterior.draws, theta=beta, beta=beta))
    low, high = posterior.interval(0.95)
    assert (low[0] == 0.0) == from_zero
    np.testing.assert_allclose([low[1], high[1]], np.quantile(drawn, [0.025, 0.975]))
    share = norm.sf(0.0, mean)
    expected = mean + norm.isf(0.05 * share) if from_zero else mean + norm.isf(0.025)
    assert high[0] == pytest.approx(expected, abs=0.06)


def test_uncertain_gains_do_not_make_a_known_friction_zero():
    """A factor of 7 common to all coefficients: no information whether a friction is absent."""
    posterior = normal_draws(np.eye(2), cone=Cone.orthant(2))
    rng = np.random.default_rng(3)
    log_gain = 1.4 * rng.standard_normal((400, 4, 16, 1))
    known, absent = 8.0 + 0.4 * rng.standard_normal(log_gain.shape), np.abs(rng.standard_normal(log_gain.shape))
    beta = np.concatenate([known, absent], axis=-1) * np.exp(log_gain)
    drawn = replace(posterior.draws, theta=beta, beta=beta)
    (low, zero), (high, _) = replace(posterior, draws=drawn, log_gain=log_gain).interval(0.95)
    assert zero == 0.0
    np.testing.assert_allclose(np.log([low / 8.0, high / 8.0]), np.array([-1.96, 1.96]) * 1.4, rtol=0.03)


def test_model_error_widens_by_the_closed_form():
    """A normal posterior: theta moves by Cov(theta, beta) H e; nothing else moves."""
    plain = normal_draws(np.array([[2.0, 0.6], [0.6, 0.5]]))
    information = np.linalg.inv(plain.covariance_of_log)
    model_error_covariance = np.array([[3.0, -1.1], [-1.1, 0.7]])
    wide = widened(plain, information, model_error_covariance)
    error = 4.5 * np.sqrt(2.0 / plain.draws.log_density.size) * np.array([[5.0, 3.0], [3.0, 1.5]])
    assert np.all(np.abs(wide.covariance - plain.covariance - model_error_covariance) < error)
    np.testing.assert_array_equal(wide.theta, plain.theta)
    np.testing.assert_array_equal(wide.covariance_of_log, plain.covariance_of_log)
    assert np.all(wide.parameter_sd > 1.2 * plain.parameter_sd)
    np.testing.assert_array_equal(widened(plain, information, model_error_covariance).shift, wide.shift)


def test_model_error_leaves_no_friction_below_zero():
    """The second parameter is nonnegative; the first one is unbounded."""
    log = near_symmetric(0.6)
    posterior = infer_from(log, options=Sampling(walkers=8, budget=0.0))
    information = np.diag([50.0, 50.0])
    wide = widened(posterior, information, np.diag([0.09, 4.0]))
    assert np.all(wide.uncertain.theta[..., 1] >= 0.0)
    assert np.any(wide.uncertain.theta[..., 1] == 0.0)
    assert np.all(posterior.uncertain.theta == posterior.draws.theta)
    of_mode = wide.mode_of_draws == 0
    assert np.all(np.sign(wide.draws.theta[of_mode][:, 0]) == np.sign(wide.theta[0]))
    assert wide.shift[..., 1].std() > 0.0


def test_model_error_shifts_sums_of_parameters_both_ways():
    """One coefficient a + 2 m with a mass near zero; bounding the mass would move the sum to one side only."""
    plain = normal_draws(np.array([[2.0, -0.9], [-0.9, 0.5]]), cone=Cone.free(1) + Cone.orthant(1))
    sums = np.array([[1.0, 2.0]])
    likelihood = replace(plain.target.likelihood, projection=sums, hessian=np.zeros((1, 1, 1)))
    theta = np.abs(plain.draws.theta - [0.0, -3.0])
    draws = replace(plain.draws, theta=theta, beta=theta @ sums.T)
    target, modes = replace(plain.target, likelihood=likelihood), (replace(plain.modes[0], draws=draws),)
    plain = replace(plain, target=target, draws=draws, modes=modes)
    wide = widened(plain, np.linalg.inv(plain.covariance_of_log), np.array([[9.0]]))
    shift = (wide.uncertain.beta - plain.draws.beta).ravel()
    assert np.any(wide.uncertain.theta[..., 1] < 0.0)
    assert abs(shift.mean()) < 4.5 * 3.0 / np.sqrt(shift.size)
    assert shift.std() == pytest.approx(3.0, rel=4.5 / np.sqrt(2.0 * shift.size))


def normal_draws(covariance, cone=None):
    """A posterior of two free parameters whose draws are normal, and are the coefficients."""
    posterior = numbered(40)
    theta = np.random.default_rng(5).multivariate_normal([1.0, -3.0], covariance, size=(400, 4, 16))
    likelihood = replace(posterior.target.likelihood, projection=np.eye(2))
    draws = replace(posterior.draws, theta=theta, beta=theta, log_density=theta[..., 0], log_scale=theta[..., :1])
    mode = replace(posterior.modes[0], draws=draws)
    target = replace(posterior.target, likelihood=likelihood)
    if cone is not None:
        target = replace(target, prior=replace(target.prior, region=FeasibleSet.of(cone), inside=np.ones(2)))
    return replace(posterior, target=target, draws=draws, modes=(mode,))


def test_the_mean_of_two_modes_on_an_edge_is_inside():
    log = near_symmetric(0.6)
    log = replace(log, nominal=replace(log.nominal, mean=np.array([0.6, -3.0]), sd=np.array([2.0, 0.3])))
    posterior = infer_from(log, options=Sampling(walkers=4, budget=0.0))
    region = posterior.target.prior.region
    assert region.contains(posterior.theta[:, None])[0]
    assert np.all(region.contains(posterior.spread()[0].T))
    assert posterior.theta[1] < 3.0 * posterior.parameter_sd[1]  # near the edge
