from dataclasses import replace

import numpy as np
import pytest
from posterior_problems import Rotated, quadrature, samples_of, simulate, target_in, whole_space
from scipy import stats

from bayesid.posterior.moves import Conditional, HitAndRun, MoveSequence, NoiseScales
from bayesid.posterior.target import Target
from bayesid.studies import sbc
from bayesid.studies.sbc import LAST, Calibration, draw_prior, setting
from bayesid.studies.study import run_study

FALSE_ALARM = 1e-4
"""Kolmogorov and Smirnov's p is exact and Bonferroni's bound holds for any dependence: this is no estimate."""


def calibration(trials, flaw="", workers=0):
    study = sbc.FLAWED[flaw] if flaw else sbc.STUDY
    return Calibration.of(run_study(study, trials, workers=workers).good)


@pytest.mark.long
def test_no_gross_miscalibration():
    ranks = calibration(24)
    assert ranks.p > FALSE_ALARM, ranks


@pytest.mark.long
def test_half_the_noise_is_found():
    ranks = calibration(24, "noise")
    assert ranks.p < FALSE_ALARM
    assert np.all(ranks.shift[[ranks.names.index(f"log noise {j}") for j in (1, 2)]] < FALSE_ALARM)


@pytest.mark.long
def test_calibrated():
    ranks = calibration(200, workers=2)
    assert ranks.p > FALSE_ALARM, ranks
    assert len(ranks.names) * ranks.chi_square.min() > FALSE_ALARM, ranks


@pytest.mark.long
@pytest.mark.long
def test_the_truth_comes_from_the_prior_that_is_stated(rng):
    """Rejection against hit-and-run, which has the prior's region and density from the code under test."""
    prior = setting().prior
    truths, scales = (np.array(values) for values in zip(*(draw_prior(rng) for _ in range(300)), strict=True))
    assert prior.region.contains(truths.T).all()
    assert stats.kstest((scales / prior.log_scale_sd).ravel(), "norm").pvalue > 1e-4
    effort = np.ones((len(setting().motion), 2))
    data = sbc.target_of(effort, np.ones(len(setting().segments), dtype=np.int64), "").likelihood
    nothing = replace(data, **{name: 0.0 * getattr(data, name) for name in ("hessian", "gradient", "energy")})
    target = Target(prior, nothing)
    move = HitAndRun(target, Conditional.of(prior.region, np.diag(prior.sd**2)))
    start = np.tile(np.append(prior.inside, [0.0, 0.0]), (300, 1))
    drawn = samples_of(move, start, 1, np.random.RandomState(0), burn=250)[0, :, :-2]
    smallest = [stats.ks_2samp(truths[:, k], drawn[:, k]).pvalue for k in range(drawn.shape[1])]
    assert len(smallest) * min(smallest) > 1e-3
    density = prior.log_density(truths, scales), prior.log_density(drawn, scales)
    assert stats.ks_2samp(*density).pvalue > 1e-3


def test_the_target_knows_the_signs_that_are_given_and_no_others(rng):
    theta, log_scale = draw_prior(rng)
    effort, signs = sbc.simulated(theta, log_scale, rng)
    summed = setting().summed
    assert 0.2 <= summed.mean() <= 0.3
    likelihood = sbc.target_of(effort, signs, "").likelihood
    assert np.array_equal(likelihood.fixed, np.where(summed, 0, signs))
    assert np.allclose(likelihood.count, [240.0, 120.0])
    turned = np.where(summed, -signs, signs)  # what the target does not know changes nothing
    effort *= setting().segments.per_sample(np.where(summed, -1, 1), *effort.shape)
    other = sbc.target_of(effort, turned, "").likelihood
    assert np.isclose(
        likelihood.log_likelihood(theta[None], log_scale[None]), other.log_likelihood(theta[None], log_scale[None])
    )


def ranks_of(truth, draws):
    ranks = np.sum(draws < truth, axis=1)[:, None]
    return Calibration(("x",), ranks, np.random.default_rng(0).random(ranks.shape))


def test_ranks_separate_right_draws_from_wrong_ones_with_false_alarms_as_rare_as_stated(rng):
    for mean, sd, uniform in ((0, 1, True), (0.4, 1, False), (0, 0.6, False), (0, 1.7, False)):
        ranks = ranks_of(rng.standard_normal((200, 1)), mean + sd * rng.standard_normal((200, LAST)))
        assert (ranks.p > 1e-3) == uniform
        assert (ranks.chi_square[0] > 1e-3) == uniform
    ranks = rng.integers(LAST + 1, size=(20, 500))
    calibrated = Calibration(tuple("x" * 500), ranks, rng.random(ranks.shape))
    for p in (calibrated.shift, calibrated.spread):
        assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert calibrated.bins == 4


def test_noise_far_from_its_reference_does_not_hold_the_walkers(rng):
    """Walkers start at the reference; a proposal without the prior was accepted there once in 300 sweeps."""
    scale, make = 1.7, target_in(whole_space(2), np.zeros(2), log_scale_sd=0.5)
    target = simulate(make, np.array([1.0, -1.0]), np.full(2, scale), rng, rows=240, segments=12, known=1.0)
    moves = MoveSequence([HitAndRun(target, Rotated(np.eye(2))), NoiseScales(target)])
    drawn = samples_of(moves, np.zeros((400, 4)), 1, np.random.RandomState(0), burn=15)[0]
    centre = drawn.mean(axis=0)
    axes = [np.linspace(c - 6 * s, c + 6 * s, 25) for c, s in zip(centre, drawn.std(axis=0), strict=True)]
    _, mean, sd = quadrature(target, axes)
    assert np.all(np.abs(centre - mean) < 4.5 * sd / np.sqrt(400))
    assert np.all(np.abs(drawn.std(axis=0) / sd - 1.0) < 4.5 / np.sqrt(2 * 400))
    assert np.all(np.abs(drawn[:, 2:] - scale) < 0.5)
