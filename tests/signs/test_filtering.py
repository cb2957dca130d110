"""Signs as they come, against what smoothing makes of the same readings, and against Monte Carlo."""

import numpy as np
import pytest
from smoothing_oracles import noise_of, ornstein_uhlenbeck, size_at_rest, weighed_paths

from bayesid.signs.filtering import SignFilter
from bayesid.signs.smoothing import smooth

RATE = 100.0


def filtered(effort, predicted, noise, at_rest, look_ahead=0, rate=RATE, moving=None):
    """(N', n) P(sign = +) of all samples but the last L."""
    of = SignFilter.of(noise, at_rest, rate, look_ahead)
    belief, zero = of.begin(), np.zeros(effort.shape[1])
    moving = np.ones(effort.shape, dtype=bool) if moving is None else moving
    rows = [of.update(belief, e, p, zero, moves)[0] for e, p, moves in zip(effort, predicted, moving, strict=True)]
    return np.array([row for row in rows if row is not None])


@pytest.mark.parametrize("look_ahead", [0, 3])
def test_against_monte_carlo(look_ahead):
    """Near zero, where every path matters; the grid's own error is below 0.02, as that of smoothing."""
    rng = np.random.default_rng(2)
    predicted = np.array([0.9, 0.5, 0.1, -0.2, -0.5, -1.0]) + 0.2 * rng.standard_normal(6)
    effort = np.abs(predicted + 0.4 * rng.standard_normal(6))
    rng = np.random.default_rng(0)
    steps = [ornstein_uhlenbeck(0.5, np.exp(-1 / (0.03 * RATE)), rng)] * 5
    expected, error = weighed_paths(effort, predicted, 0.4, 0.5 * rng.standard_normal(300_000), steps, look_ahead)
    found = filtered(effort[:, None], predicted[:, None], noise_of(0.4, 0.5, 0.03), np.array([0.5]), look_ahead)
    np.testing.assert_allclose(found[:, 0], expected, atol=4 * error + 0.02)


@pytest.mark.parametrize("rate", [100.0, 300.0, 1000.0])
def test_the_error_decays_at_its_own_pace_at_any_rate(rate):
    """E[b'] = b exp(-stride / (tau f)) of an Ornstein-Uhlenbeck process, well inside the grid."""
    of = SignFilter.of(noise_of(0.3, 0.5, 0.1), np.array([0.5]), rate)
    grid, inside = of.grid[0], np.abs(of.grid[0]) < 1.0
    expected = grid * np.exp(-of.stride / (0.1 * rate))
    np.testing.assert_allclose((of.backwards[0] @ grid)[inside], expected[inside], atol=0.01)


def a_stream(samples=300):
    rng = np.random.default_rng(5)
    time = np.arange(samples) / RATE
    truth = np.stack([3.0 * np.sin(2.1 * time) + 0.4, 2.0 * np.cos(3.3 * time) - 0.7], axis=1)
    predicted = truth + 0.4 * np.sin(7.0 * time + 1.0)[:, None]
    return np.abs(truth + 0.3 * rng.standard_normal(truth.shape)), predicted


@pytest.mark.parametrize("rests", [0, 50])
def test_a_filter_with_full_delay_equals_smoothing(rests):
    """With a standstill of 0.5 s, the length at which both take friction to turn round as readily."""
    effort, predicted = a_stream()
    model, moving = noise_of(0.3, 0.5, 0.1, n=2), np.ones(effort.shape, dtype=bool)
    moving[120 : 120 + rests, 0] = False
    whole = smooth(effort, predicted, moving, model, RATE)
    at_rest = np.array([size_at_rest(effort[:, j], predicted[:, j], moving[:, j], 0.5) for j in range(2)])
    late = filtered(effort, predicted, model, at_rest, look_ahead=90, moving=moving)
    np.testing.assert_allclose(late, whole[: len(late)], atol=2e-3)


def test_a_reading_that_is_missing_leaves_the_sign_to_the_model():
    of = SignFilter.of(noise_of(0.3, 0.5, 0.1, n=2), np.array([0.5, 0.5]), RATE)
    belief, zero, moving = of.begin(), np.zeros(2), np.ones(2, dtype=bool)
    for _ in range(20):
        of.update(belief, np.array([2.0, 2.0]), np.array([1.9, -2.1]), zero, moving)
    spread = of.forwards[0] @ belief.weights[0]
    expected = spread[of.grid[0] + 0.2 > 0.0].sum() / spread.sum()
    _, now = of.update(belief, np.array([np.nan, 2.0]), np.array([0.2, -0.2]), zero, moving)
    assert 0.6 < expected < 0.9
    np.testing.assert_allclose(now[0], expected, rtol=1e-5)  # single precision
    assert now[1] < 0.5
