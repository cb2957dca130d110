from dataclasses import replace

import numpy as np
import pytest
from posterior_problems import Rotated, disc, information_of, quadrature, samples_of, simulate, target_in, whole_space
from scipy import stats

from bayesid.effects.parameters import Cone
from bayesid.posterior.feasible_set import FeasibleSet
from bayesid.posterior.moves import Conditional, HitAndRun, MoveSequence, NoiseScales
from bayesid.robot.inertia import from_pseudo_inertia


def test_information_does_not_depend_on_the_noise_scale(rng):
    temperature = 3.0
    make, log_scale = target_in(whole_space(3), np.zeros(3), prior_sd=0.8), np.array([0.9, -0.6])
    target = simulate(make, np.array([1.0, -0.5, 0.2]), log_scale, rng, rows=24, segments=6, known=1.0)
    columns = rng.standard_normal((9, 3)) * np.array([3.0, 1.0, 0.0]) + rng.standard_normal((9, 1))
    effort = columns @ np.array([-0.6, 0.9, 1.5]) + rng.standard_normal(9)
    target = replace(target, information=information_of(columns, effort))
    data, weight = target.likelihood, np.exp(-2.0 * log_scale)
    precision = np.tensordot(weight, data.hessian, 1) + target.information.hessian + np.eye(3) / 0.8**2
    mean = np.linalg.solve(precision, weight @ data.fixed_gradient + target.information.gradient)
    covariance = temperature * np.linalg.inv(precision)
    move = HitAndRun(target, Rotated(np.linalg.cholesky(covariance)), temperature)
    start = np.concatenate([np.zeros((200, 3)), np.tile(log_scale, (200, 1))], axis=1)
    draws = samples_of(move, start, 100, np.random.RandomState(1), burn=30)
    assert_matches(draws[..., :3], mean, np.sqrt(np.diag(covariance)))
    centred = draws[..., :3] - mean
    products = np.einsum("dwi,dwj->wij", centred, centred) / len(draws)
    assert np.all(np.abs(products.mean(axis=0) - covariance) < 4.5 * products.std(axis=0, ddof=1) / np.sqrt(200))


def moves_of(target, size):
    return MoveSequence([HitAndRun(target, Rotated(np.eye(size))), NoiseScales(target)])


def assert_matches(draws, mean, sd):
    walkers = draws.mean(axis=0)
    error = walkers.std(axis=0, ddof=1) / np.sqrt(walkers.shape[0])
    assert np.all(np.abs(walkers.mean(axis=0) - mean) < 4.5 * error)
    squares = ((draws - mean) ** 2).mean(axis=0)
    error = squares.std(axis=0, ddof=1) / np.sqrt(walkers.shape[0])
    assert np.all(np.abs(squares.mean(axis=0) - sd**2) < 4.5 * error)


def test_two_parameters_in_a_cone_and_the_noise_match_quadrature(rng):
    theta = np.array([0.85, -0.25])
    target = simulate(target_in(disc(), np.zeros(2)), theta, np.zeros(1), rng, rows=20, segments=5, known=0.6)
    _, mean, sd = quadrature(target, [np.linspace(-1, 1, 150), np.linspace(-0.3, 1, 150), np.linspace(-1.2, 1.2, 80)])
    draws = samples_of(moves_of(target, 2), np.zeros((200, 3)), 300, np.random.RandomState(0))
    assert_matches(draws, mean, sd)
    assert target.prior.region.contains(draws[..., :2].reshape(-1, 2).T).all()


def test_a_rigid_body_matches_rejection(rng):
    region = FeasibleSet.of(Cone.rigid_bodies(1))
    body = from_pseudo_inertia(np.diag([0.3, 0.5, 0.8, 1.0]))
    sd = np.full(10, 0.3)
    proposals = body + sd * rng.standard_normal((200_000, 10))
    kept = proposals[region.contains(proposals.T)]
    assert 2_000 < len(kept) < 190_000
    make = target_in(region, body)
    nothing = simulate(make, body, np.zeros(1), rng, rows=10, segments=2, known=1.0, noise=1e6)
    target = replace(nothing, prior=replace(nothing.prior, mean=body, sd=sd))
    move = HitAndRun(target, Conditional(np.diag(sd**2), np.zeros(10, dtype=np.int64), np.eye(10)))
    draws = samples_of(move, np.tile(np.append(body, 0.0), (200, 1)), 150, np.random.RandomState(0))[..., :10]
    walkers = draws.mean(axis=0)
    error = np.hypot(walkers.std(axis=0, ddof=1) / np.sqrt(len(walkers)), kept.std(axis=0) / np.sqrt(len(kept)))
    assert np.all(np.abs(walkers.mean(axis=0) - kept.mean(axis=0)) < 4.5 * error)
    for k in range(10):
        assert stats.ks_2samp(draws[::50, :, k].ravel(), kept[:, k]).pvalue > 1e-4


@pytest.mark.long
def test_simulation_based_calibration():
    """Ranks of prior draws among posterior draws are uniform (Talts et al. 2018): the moves are right as a whole."""
    rng, random = np.random.default_rng(5), np.random.RandomState(5)
    make = target_in(disc(), np.zeros(2))
    walkers, trials = 19, 240
    ranks = np.empty((trials, 4), dtype=int)
    for trial in range(trials):
        theta = rng.standard_normal((50, 2))
        theta = theta[disc().contains(theta.T)][0]
        log_scale = 0.3 * rng.standard_normal(1)
        target = simulate(make, theta, log_scale, rng, rows=12, segments=4, known=0.5)
        start = np.concatenate([0.1 * rng.standard_normal((walkers, 2)), np.zeros((walkers, 1))], axis=1)
        draws = samples_of(moves_of(target, 2), start, 1, random, burn=30)[0]
        truth = np.append(theta, log_scale)
        ranks[trial, :3] = np.sum(draws < truth, axis=0)
        ranks[trial, 3] = np.sum(target.log_density(draws) < target.log_density(truth)[0])
    for k in range(4):
        counts = np.bincount(ranks[:, k] // 2, minlength=10)
        assert stats.chisquare(counts).pvalue > 1e-3, (k, counts)
