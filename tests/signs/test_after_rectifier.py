"""A low-pass after the rectifier: found where there is one, and its signs no surer than they are right."""

from dataclasses import replace
from functools import cache, partial
from itertools import product

import numpy as np
import pytest
from scipy.signal import butter, filtfilt, lfilter, lfilter_zi
from simulated_arms import BUDGET, Simulated

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.low_pass import AfterRectifier, LowPass
from bayesid.log.segments import USUAL, find_segments
from bayesid.log.signals import prepare
from bayesid.regression.noise import Noise
from bayesid.signs.after_rectifier import find_unfiltered_signs, noise_taken, significance
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import find_signs
from bayesid.signs.smoothing import smooth

RATE = 100.0
SEARCH = Certified(budget=BUDGET)


def with_delay(order, cutoff, values):
    sections = butter(order, cutoff, fs=RATE)
    return lfilter(*sections, values, axis=0, zi=lfilter_zi(*sections)[:, None] * values[:1])[0]


KINDS = {
    "rc 8 Hz": partial(with_delay, 1, 8.0),
    "2nd 3 Hz": partial(with_delay, 2, 3.0),
    "zero phase 8 Hz": lambda values: filtfilt(*butter(2, 8.0, fs=RATE), values, axis=0),
}


@cache
def signed_log():
    return Simulated(0.1).log(signed=True, noise=0.03)


def read(effort):
    return replace(signed_log(), effort=np.maximum(effort, 0.0), signed=np.zeros(3, dtype=bool))


def started(log):
    robot, signals = Simulated(0.1).robot, prepare(log)
    model = Model(robot, make_terms(STANDARD, robot, signals.motion))
    return model, signals, find_segments(signals, robot.actuators(signals.motion))


@cache
def unfiltered(kind):
    model, signals, segments = started(read(KINDS[kind](np.abs(signed_log().effort))))
    return find_unfiltered_signs(model, signals, segments, SEARCH, USUAL)[0]


def wrong_and_sure(sign_solution):
    """How many of the samples that are given 0.999 are wrong, and how many are given that."""
    probability = sign_solution.probability
    sure = np.maximum(probability, 1.0 - probability) >= 0.999
    return int(((probability >= 0.5) != (signed_log().effort >= 0.0))[sure].sum()), int(sure.sum())


@pytest.mark.parametrize(("kind", "cutoff"), [("rc 8 Hz", 8.0), ("2nd 3 Hz", 3.0), ("zero phase 8 Hz", 8.0)])
def test_a_low_pass_is_found_and_signs_are_no_surer_than_right(kind, cutoff):
    sign_solution = unfiltered(kind)
    found = sign_solution.log_data.signals.after_rectifier
    assert found is not None
    assert found.low_pass.cutoff == pytest.approx(cutoff, rel=0.1)
    wrong, sure = wrong_and_sure(sign_solution)
    assert sure > 0.6 * sign_solution.probability.size
    assert wrong <= 1e-3 * sure


@pytest.mark.parametrize("kind", ["none", "2nd 3 Hz"])
def test_what_was_not_filtered_or_before_the_rectifier_is_left_alone(kind):
    effort = signed_log().effort if kind == "none" else KINDS[kind](signed_log().effort)
    model, signals, segments = started(read(np.abs(effort)))
    expected = find_signs(model, signals, segments, SEARCH)
    sign_solution, as_before = find_unfiltered_signs(model, signals, segments, SEARCH, USUAL)
    assert sign_solution.log_data.signals is signals
    assert as_before is segments
    np.testing.assert_array_equal(sign_solution.probability, expected.probability)


def test_significance_bounds_the_share_of_all_signs():
    contrast = np.array([0.9, 0.8, 0.75, 0.6, 0.5, 0.5, 0.3, 0.2, -0.1])
    sums = [signs @ contrast for signs in product((-1.0, 1.0), repeat=len(contrast))]
    share = np.mean(np.array(sums) >= contrast.sum() - 1e-9)
    assert share <= significance(contrast) < 0.1
    assert significance(-contrast) == 1.0
    assert significance(np.zeros(0)) == 1.0


@pytest.mark.parametrize(("white", "slow"), [(0.5, 0.0), (0.3, 0.4)])
def test_the_noise_that_a_low_pass_took_is_what_is_missing(white, slow):
    rng, low_pass = np.random.default_rng(2), LowPass(2, 3.0, zero_phase=False)
    memory = np.exp(-1.0 / (0.5 * RATE))
    error = lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], slow * rng.standard_normal(60_000))
    before = white * rng.standard_normal(60_000) + error
    passed = low_pass.apply(before, RATE)
    expected = np.sqrt(before.var() - passed.var())
    assert noise_taken(low_pass, passed, np.ones(60_000, dtype=bool), RATE) == pytest.approx(expected, rel=0.25)


def test_an_unfiltered_residual_gives_the_least_removed_noise():
    """White noise of the sensor behind it: nothing is missing, so the least there is, by the variance."""
    residual = np.random.default_rng(4).normal(size=20_000)
    taken = noise_taken(LowPass(2, 3.0, zero_phase=False), residual, np.ones(20_000, dtype=bool), RATE)
    assert taken == pytest.approx(residual.std(), rel=0.02)


def test_probabilities_are_calibrated_behind_a_low_pass():
    """Model error that lasts and noise before a low-pass of known cut-off: of all bins, the share that is right."""
    rng, count, n = np.random.default_rng(8), 1500, 12
    t = np.arange(count)[:, None] / RATE
    predicted = 2.0 * np.sin(2.0 * np.pi * (0.3 + 0.05 * np.arange(n)) * t + np.arange(n))
    memory = np.exp(-1.0 / (1.0 * RATE))
    error = lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], 0.15 * rng.standard_normal((count, n)), axis=0)
    truth = predicted + error + 0.2 * rng.standard_normal((count, n))
    low_pass = LowPass(2, 4.0, zero_phase=False)
    after = AfterRectifier(low_pass, low_pass.apply(np.abs(truth), RATE), np.full(n, 0.2))
    noise = Noise(np.full(n, 0.03), np.full(n, 0.16), np.full(n, 0.8), np.ones(n))
    moving = np.ones(truth.shape, dtype=bool)
    found = smooth(after.read, predicted, moving, noise, RATE, after=after)
    confidence, right = np.maximum(found, 1.0 - found), (found >= 0.5) == (truth >= 0.0)
    places = np.digitize(confidence, [0.6, 0.7, 0.8, 0.9, 0.95, 0.99])
    off = [abs((right - confidence)[places == k].sum()) for k in range(7)]
    assert sum(off) / right.size < 0.01
    assert right[confidence >= 0.999].mean() > 0.999
    assert (confidence >= 0.999).mean() > 0.5
    as_read = smooth(after.read, predicted, moving, noise, RATE)
    sure = np.maximum(as_read, 1.0 - as_read) >= 0.999
    assert ((as_read >= 0.5) != (truth >= 0.0))[sure].mean() > 5e-3, "taken for unfiltered, readings mislead"
