import numpy as np
import pytest
from scipy.stats import t
from smoothing_oracles import noise_of, ornstein_uhlenbeck, size_at_rest, weighed_paths

from bayesid.signs.smoothing import smooth

RATE = 100.0


@pytest.mark.parametrize("seed", [1, 2])
def test_against_monte_carlo(seed):
    """Six samples near zero, where every path matters; the grid's own error is below 0.02."""
    rng = np.random.default_rng(seed)
    predicted = np.array([0.9, 0.5, 0.1, -0.2, -0.5, -1.0]) + 0.2 * rng.standard_normal(6)
    effort = np.abs(predicted + 0.4 * rng.standard_normal(6))
    rng = np.random.default_rng(0)
    steps = [ornstein_uhlenbeck(0.5, np.exp(-1 / (0.03 * RATE)), rng)] * 5
    expected, error = weighed_paths(effort, predicted, 0.4, 0.5 * rng.standard_normal(400_000), steps)
    found = smooth(effort[:, None], predicted[:, None], np.ones((6, 1), dtype=bool), noise_of(0.4, 0.5, 0.03), RATE)
    np.testing.assert_allclose(found[:, 0], expected, atol=4 * error + 0.02)


def test_probabilities_are_calibrated():
    """Data drawn from the model itself: of the signs given P in a bin, that share is +, within 4 binomial sd."""
    rng = np.random.default_rng(7)
    n, white, coloured, correlation = 6000, 0.5, 0.6, 0.05
    memory = np.exp(-1 / (correlation * RATE))
    b = np.empty((n, 1))
    b[0] = coloured * rng.standard_normal()
    for i in range(1, n):
        b[i] = memory * b[i - 1] + coloured * np.sqrt(1 - memory**2) * rng.standard_normal()
    predicted = 1.2 * np.sin(np.arange(n) / 40.0)[:, None] + 0.3
    value = predicted + b + white * rng.standard_normal((n, 1))
    moving = np.ones((n, 1), dtype=bool)
    found = smooth(np.abs(value), predicted, moving, noise_of(white, coloured, correlation), RATE)[:, 0]
    for low, high in [(0.02, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.98), (0.98, 1.0)]:
        inside = (found >= low) & (found < high)
        count, share = inside.sum(), (value[inside, 0] > 0).mean()
        sd = np.sqrt(found[inside].mean() * (1 - found[inside].mean()) / count)
        assert count > 50
        assert share == pytest.approx(found[inside].mean(), abs=4 * 1.5 * sd + 0.005), (low, high)


REST_TIME, TURNS = 0.5, 0.5
"""s in which static friction builds up, and the probability that it turns round at once in a standstill."""


@pytest.mark.parametrize("seed", [1, 2])
def test_standstill_against_weighed_paths(seed):
    """Eleven samples, five of them at rest, where friction moves the prediction from below to above zero.

    Steps are wider, and friction may turn round, into a standstill, within it and out of it.
    """
    rng = np.random.default_rng(seed)
    predicted = np.concatenate([[-1.1, -1.0, -0.9], np.full(5, 0.15), [0.8, 0.9, 1.0]])
    effort = np.abs(predicted + 0.25 * rng.standard_normal(11))
    moving = np.ones(11, dtype=bool)
    moving[3:8] = False
    rng, wide, chance = (
        np.random.default_rng(0),
        size_at_rest(effort, predicted, moving, 0.3),
        1 - (1 - TURNS) ** (1 / 6),
    )
    slow = ornstein_uhlenbeck(wide, np.exp(-1.0 / (REST_TIME * RATE)), rng)

    def resting(b):
        return np.where(rng.random(len(b)) < chance, wide * rng.standard_normal(len(b)), slow(b))

    quick = ornstein_uhlenbeck(0.3, np.exp(-1.0 / (0.04 * RATE)), rng)
    steps = [quick] * 2 + [resting] * 6 + [quick] * 2
    expected, error = weighed_paths(effort, predicted, 0.3, 0.3 * rng.standard_normal(400_000), steps)
    found = smooth(effort[:, None], predicted[:, None], moving[:, None], noise_of(0.3, 0.3, 0.04), RATE)[:, 0]
    assert 0.1 < expected[5] < 0.9, "in doubt"
    np.testing.assert_allclose(found, expected, atol=4.0 * error + 0.01)  # the grid's error


def test_more_readings_of_a_standstill_are_no_less_sure():
    """Half a second, in which static friction holds more than the model has it; the effort's steady course tells."""
    model_error_probability = []
    for rate in (50.0, 500.0):
        time = np.arange(int(1.5 * rate)) / rate
        shape = np.interp(time, [0.5, 0.65, 0.85, 1.0], [0.0, 1.0, 1.0, 0.0])[:, None]
        moving = ((time < 0.5) | (time >= 1.0))[:, None]
        found = smooth(1.2 - 0.6 * shape, 1.2 + (-0.3 - 1.2) * shape, moving, noise_of(0.1, 0.05, 0.1), rate)
        assert found.min() > 0.5
        model_error_probability.append((1.0 - found[~moving]).mean())
    assert model_error_probability[1] < model_error_probability[0] < 0.01


def test_an_outlier_is_no_proof_of_its_sign():
    """Without coloured noise every sample stands alone: Student's t, four degrees. A normal would be certain."""
    for outlier in (0.9, 1.5, 3.0):
        predicted, effort = np.full((80, 1), 0.3), np.full((80, 1), 0.3)
        effort[40] = outlier
        found = smooth(effort, predicted, np.ones((80, 1), dtype=bool), noise_of(0.1, 1e-6, 0.1), RATE)[:, 0]
        up, down = t(4).pdf((outlier - 0.3) / 0.1), t(4).pdf((outlier + 0.3) / 0.1)
        assert found[40] == pytest.approx(up / (up + down), abs=1e-4)
        assert found[40] < 0.97
        assert np.delete(found, 40).min() > 0.99


def test_joints_of_known_signs_are_not_smoothed():
    """The others are smoothed as without them: the noise of a joint with known signs does not matter."""
    rng = np.random.default_rng(3)
    predicted, moving = np.sin(np.arange(400)[:, None] / [30.0, 20.0, 25.0]), np.ones((400, 3), dtype=bool)
    effort = np.abs(predicted + 0.3 * rng.standard_normal((400, 3)))
    noise = noise_of(0.3, 0.2, 0.05, 3)
    whole = smooth(effort, predicted, moving, noise, RATE)
    noise.white[1] = noise.coloured[1] = 7.0
    found = smooth(effort, predicted, moving, noise, RATE, known=np.array([False, True, False]))
    np.testing.assert_array_equal(found[:, [0, 2]], whole[:, [0, 2]])
    np.testing.assert_array_equal(found[:, 1], 0.5)
    assert np.all(smooth(effort, predicted, moving, noise, RATE, known=np.ones(3, dtype=bool)) == 0.5)
