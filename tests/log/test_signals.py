import numpy as np
import pytest
from conftest import smooth_motion
from scipy.interpolate import CubicSpline

from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.log.signals import choose_cutoff, lowpass, prepare, signed_effort
from bayesid.motion import Motion


def make_log(motion: Motion, effort=None, signed=False, dq=None) -> Log:
    n = motion.n_joints
    effort = np.abs(motion.ddq) + 0.1 if effort is None else effort
    return Log(motion.t, motion.q, effort, np.full(n, signed), dq)


@pytest.mark.parametrize("measured", [False, True])
def test_derivatives_are_those_of_the_motion_up_to_the_ends(measured):
    """Motion below 1 Hz, cut-off 8 Hz: the filter passes it to 1e-3, the spline differentiates it to 1e-4."""
    motion = smooth_motion(3, 12.0, 100.0, seed=1)
    signals = prepare(make_log(motion, dq=motion.dq if measured else None), cutoff=8.0)
    for name in ("q", "dq", "ddq"):
        truth, found = getattr(motion, name), getattr(signals.motion, name)
        inner = slice(50, -50)
        assert np.abs(found - truth)[inner].max() < 2e-3 * np.abs(truth).max(), name
        assert np.abs(found - truth).max() < 0.1 * np.abs(truth).max(), f"{name} at the ends"


def test_jitter_and_repeated_rows():
    rng = np.random.default_rng(2)
    even = smooth_motion(2, 10.0, 100.0, seed=3)
    t = even.t + rng.uniform(-3e-3, 3e-3, len(even))
    t.sort()
    exact = np.stack([np.interp(t, even.t, even.q[:, j]) for j in range(2)], axis=1)
    held = np.repeat(np.arange(len(t)), 3)
    times = np.sort(np.concatenate([t, t + 1e-3, t + 2e-3]))
    log = Log(times, exact[held], np.abs(exact[held]) + 0.5, np.zeros(2, bool))
    signals = prepare(log, cutoff=5.0)
    assert signals.processing["repeated_rows_dropped"] == 2 * len(t)
    assert signals.rate == pytest.approx(100.0, rel=0.1)
    reference = np.stack([np.interp(signals.motion.t, even.t, even.q[:, j]) for j in range(2)], axis=1)
    assert np.abs(signals.motion.q - reference)[20:-20].max() < 5e-3


def test_a_standstill_is_not_lost_with_its_repeated_rows():
    motion = smooth_motion(1, 4.0, 100.0)
    q = np.concatenate([motion.q[:100], np.repeat(motion.q[99:100], 150, axis=0), motion.q[100:250]])
    effort = np.abs(motion.q) + 1.0
    effort[100:250] = 7.0
    signals = prepare(Log(motion.t, q, effort, np.zeros(1, bool)), cutoff=10.0)
    np.testing.assert_allclose(signals.raw_effort[120:230], 7.0)
    assert np.abs(signals.motion.dq[150:200]).max() < 0.05 * np.abs(motion.dq).max()


def test_lowpass_has_no_delay_and_keeps_an_asymmetric_pulse_in_place():
    t = np.arange(400) / 100.0
    pulse = np.exp(-((t - 1.3) ** 2) / 0.08)
    smooth = lowpass(pulse[:, None], 5.0, 100.0)[:, 0]
    assert np.argmax(smooth) == np.argmax(pulse)
    assert smooth == pytest.approx(pulse, abs=0.02)
    assert np.std(lowpass(np.random.default_rng(0).standard_normal((4000, 1)), 5.0, 100.0)) == pytest.approx(
        np.sqrt(5.0 / 50.0), rel=0.15
    )


def cutoff_of(q):
    return choose_cutoff([(joint, None) for joint in q.T], 200.0)


def test_the_cutoff_follows_the_motion_not_the_noise():
    slow = smooth_motion(2, 20.0, 200.0, seed=4)
    four_times = np.stack([np.interp((4 * slow.t) % 19, slow.t, q) for q in slow.q.T], axis=1)
    noisy = slow.q + 1e-5 * np.random.default_rng(1).standard_normal(slow.q.shape)
    assert cutoff_of(noisy) == pytest.approx(cutoff_of(slow.q), rel=0.2)
    assert cutoff_of(four_times) > 2 * cutoff_of(slow.q)


def test_signed_effort_has_no_cusps():
    """Filtering |sin| rounds its cusps off; signing it first gives the sine back."""
    motion = smooth_motion(1, 8.0, 100.0)
    truth = 3.0 * np.sin(2 * np.pi * 0.4 * motion.t)[:, None] + 0.7
    signals = prepare(make_log(motion, np.abs(truth)), cutoff=4.0)
    restored = signed_effort(signals, np.sign(truth))
    assert np.abs(restored - truth)[50:-50].max() < 0.01
    assert np.abs(signals.effort - np.abs(truth))[50:-50].max() > 0.05


def test_a_cutoff_that_cannot_be():
    for cutoff in (0.0, -1.0, 50.0, 1e9, np.nan):
        with pytest.raises(InputError, match="cut-off"):
            prepare(make_log(smooth_motion(2, 4.0, 100.0)), cutoff=cutoff)


def test_stamps_that_jitter_around_an_even_clock_are_evened_out():
    """The controller sampled evenly, only its stamps are off: accelerations must not suffer from that."""
    motion = smooth_motion(2, 10.0, 250.0, seed=8)
    rng = np.random.default_rng(3)
    stamps = motion.t + np.clip(1.2e-3 * rng.standard_normal(len(motion)), -1.9e-3, 1.9e-3)
    signals = prepare(Log(stamps, motion.q, np.abs(motion.q) + 1.0, np.zeros(2, bool)), cutoff=8.0)
    assert signals.processing["time_stamps"] == "evened out"
    as_stamped = CubicSpline(stamps, motion.q)(signals.motion.t)
    jittered = prepare(Log(signals.motion.t, as_stamped, np.abs(as_stamped) + 1.0, np.zeros(2, bool)), cutoff=8.0)

    def error(found):
        truth = np.stack([np.interp(found.motion.t, motion.t, motion.ddq[:, j]) for j in range(2)], axis=1)
        return np.std((found.motion.ddq - truth)[100:-100])

    assert error(signals) < 0.3 * error(jittered)
    assert prepare(make_log(motion), cutoff=8.0).processing["time_stamps"] == "as logged"
    honest = np.sort(motion.t + np.random.default_rng(4).uniform(-1e-3, 1e-3, len(motion)))
    q = CubicSpline(motion.t, motion.q)(np.clip(honest, motion.t[0], motion.t[-1]))
    log = Log(honest, q, np.abs(q) + 1.0, np.zeros(2, bool))
    assert prepare(log, cutoff=8.0).processing["time_stamps"] == "as logged", "taken when the stamps say"


def test_nothing_is_known_in_a_pause():
    """In no joint."""
    motion = smooth_motion(2, 10.0, 100.0, seed=2)
    keep = (motion.t < 4.0) | (motion.t > 5.5)
    log = Log(motion.t[keep], motion.q[keep], np.abs(motion.q[keep]) + 1.0, np.zeros(2, bool))
    signals = prepare(log, cutoff=5.0)
    t = signals.motion.t
    expected = (t < 3.99 - 0.1) | (t > 5.51 + 0.1)
    np.testing.assert_array_equal(signals.measured, np.stack([expected, expected], axis=1))


@pytest.fixture(scope="module")
def mixed():
    """Joint 2 is signed; the efforts of both are far from what is filtered."""
    motion = smooth_motion(2, 4.0, 100.0, seed=6)
    effort = np.array([3.0, 0.0]) + np.random.default_rng(1).standard_normal((400, 2))
    effort[:, 0] = np.abs(effort[:, 0])
    return prepare(Log(motion.t, motion.q, effort, np.array([False, True])), cutoff=8.0)


def test_the_nearest_effort_has_the_predictions_sign_where_none_is_known(mixed):
    predicted = np.random.default_rng(2).standard_normal((400, 2))
    nearest = mixed.nearest(predicted)
    np.testing.assert_array_equal(nearest[:, 0], np.sign(predicted[:, 0]) * mixed.raw_effort[:, 0])
    np.testing.assert_array_equal(nearest[:, 1], mixed.raw_effort[:, 1])
    assert (mixed.raw_effort[:, 1] < 0.0).any()
    np.testing.assert_array_equal(np.abs(mixed.nearest(np.zeros((400, 2)))), mixed.magnitude)  # np.sign(0) is 0
    assert mixed.magnitude.min(axis=0)[0] > 0.0
    probability = mixed.with_known_signs(np.full((400, 2), 0.7))
    np.testing.assert_array_equal(probability[:, 0], 0.7)
    np.testing.assert_array_equal(probability[:, 1], mixed.raw_effort[:, 1] >= 0.0)


def test_no_grid_is_larger_than_what_was_recorded_needs():
    """Rows that arrive ten at a time and a pause of years are refused; a pause of minutes is not."""

    def log(t):
        q = np.sin(np.arange(len(t)) / 30.0)[:, None]
        return Log(t=t, q=q, effort=np.abs(q) + 1.0, signed=np.array([False]), source="odd.csv")

    k, t = np.arange(900), np.arange(500) * 0.01
    for odd in (*((k // 10) * 0.1 + (k % 10) * step for step in (1e-9, 1e-12)), np.concatenate([t, 1e9 + t])):
        with pytest.raises(InputError, match=r"odd.csv: \d+ instants over .* even grid of .* samples; give each"):
            prepare(log(odd))
    assert len(prepare(log(np.concatenate([t, 300.0 + t]))).motion) == 30_500


def test_a_long_log_is_thinned_once_it_is_filtered():
    """Motion and light low-pass are those of all samples; only then are some left out: one in two of 110,000."""
    t = np.arange(110_000) / 500.0
    q = np.stack([np.sin(2.0 * t), 0.5 * np.cos(3.1 * t)], axis=1)
    log = Log(t, q, np.abs(np.stack([np.cos(2.0 * t), np.sin(3.1 * t)], axis=1)), np.zeros(2, dtype=bool))
    thin = prepare(log, cutoff=10.0)
    part = prepare(Log(t[:90_000], log.q[:90_000], log.effort[:90_000], log.signed), cutoff=10.0)
    assert (thin.rate, len(thin.motion)) == (250.0, 55_000)
    assert thin.processing["thinned"] == "one sample in 2 of 500 Hz"
    assert "thinned" not in part.processing
    for name in ("q", "dq", "ddq"):
        whole, found = getattr(part.motion, name)[:80_000:2], getattr(thin.motion, name)[:40_000]
        np.testing.assert_allclose(found, whole, atol=1e-9 * np.abs(whole).max())
    np.testing.assert_allclose(thin.effort[:40_000], part.effort[:80_000:2], atol=1e-9)
    assert thin.measured.shape == thin.effort.shape
    assert prepare(log, cutoff=60.0).rate == 500.0, "six samples a period of the cut-off stay"
