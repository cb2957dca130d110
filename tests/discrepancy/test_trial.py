import numpy as np
import pytest
from conftest import small_robot, smooth_motion
from made_trials import RATE, made_trial
from scipy.signal import butter, sosfiltfilt

from bayesid.discrepancy.case import make_trial, noise_floor, shortened, where_it_shows
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.log.signals import prepare
from bayesid.motion import Motion
from bayesid.regression.noise import Noise
from bayesid.regression.selection.error_model import fit_error


def periodic_motion(periods, period=4.0, samples=0):
    """Two joints, each a sum of two harmonics."""
    t = np.arange(int(periods * period * RATE) + samples) / RATE
    q, dq, ddq = np.zeros((3, len(t), 2))
    for j, terms in enumerate((((0.5, 1, 0.3), (0.2, 3, 1.0)), ((0.3, 2, 2.0), (0.25, 1, 0.4)))):
        for size, harmonic, phase in terms:
            w = 2.0 * np.pi * harmonic / period
            q[:, j] += size * np.sin(w * t + phase)
            dq[:, j] += size * w * np.cos(w * t + phase)
            ddq[:, j] -= size * w**2 * np.sin(w * t + phase)
    return Motion(t, q, dq, ddq)


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def test_gap_is_the_rms_residual():
    """Joint 1 is signed, joint 2 has the signs of the prediction: 3 and -2 have a residual of 5 and of 1."""
    motion = smooth_motion(2, 1.0, RATE)
    used = np.arange(100)[:, None] >= np.array([10, 60])
    effort = np.where(used, 3.0, 99.0)
    trial = made_trial(motion, effort, used, signed=[True, False])
    predicted = np.full((100, 2), -2.0)
    np.testing.assert_allclose(trial.gap(predicted), [5.0, 1.0])
    predicted[1::2] = 17.0
    assert (trial.gap(predicted) > 5.0).all()
    np.testing.assert_array_equal(trial.nearest(predicted)[61], [3.0, 3.0])
    np.testing.assert_array_equal(trial.nearest(predicted)[60], [3.0, -3.0])


def test_samples_count_in_motion_and_away_from_the_ends():
    """Above 2.5 % of the highest speed; half a period of the cut-off from the ends."""
    robot, motion = small_robot(2), smooth_motion(2, 8.0, RATE, seed=5)
    q = motion.q.copy()
    q[300:, 1] = np.concatenate([np.full(100, q[299, 1]), q[300 : len(q) - 100, 1]])  # and continues from there
    model = Model(robot, make_terms(["rigid_body"], robot, motion))
    signals = prepare(Log(motion.t, q, np.abs(motion.q) + 1.0, np.zeros(2, bool)), cutoff=10.0)
    trial = make_trial(model, signals)
    t, speed = signals.motion.t, np.abs(signals.motion.dq)
    inside = (t >= t[0] + 0.05) & (t <= t[-1] - 0.05)
    expected = (speed > 0.025 * speed.max(axis=0)) & inside[:, None]
    np.testing.assert_array_equal(trial.used, expected)
    assert not trial.used[320:380, 1].any()
    assert trial.used.mean() > 0.8
    np.testing.assert_array_equal(trial.magnitude, signals.raw_effort)


def noise_of(white, coloured, correlation=(0.1, 0.1)):
    return Noise(np.array(white), np.array(coloured), np.array(correlation), np.ones(len(white)))


def periodic_trial(noise, periods=3, seed=0, samples=0, signed=False):
    motion = periodic_motion(periods, samples=samples)
    effort = np.stack([9.0 + 5.0 * np.sin(motion.q[:, 0] * 4.0), 20.0 * motion.ddq[:, 1]], axis=1)
    noisy = effort + noise.draw(len(motion), 1, RATE, np.random.default_rng(seed))[:, :, 0]
    return made_trial(motion, noisy, signed=signed), noisy - effort


@pytest.mark.parametrize(
    ("noise", "periods", "samples"),
    [(noise_of((0.3, 2.0), (1e-9, 1e-9)), 2, 1), (noise_of((0.1, 0.5), (0.4, 1.2)), 3, 170)],
)
def test_floor_of_repeated_periods_is_the_sd_between_them(noise, periods, samples):
    """Within 4.5 sd of the estimate, for any residuals of the model and the earlier log.

    N pairs; 21 count as one for noise with a correlation time of 0.1 s, 1.5 times as many for three periods.
    """
    trial, _ = periodic_trial(noise, periods, samples=samples, signed=True)
    bad = np.random.default_rng(1).standard_normal(trial.used.shape) * 50.0
    floor = noise_floor(trial, bad, noise_of((40.0, 40.0), (40.0, 40.0)))
    assert floor.origin == ("repeated periods",) * 2
    assert floor.reliable.all()
    as_one = 1.0 + 20.0 * (noise.coloured[0] > 0.01)
    pairs = (len(trial.used) - 400) / as_one / (1.5 if periods > 2 else 1.0)
    np.testing.assert_allclose(floor.rms, noise.sigma, rtol=4.5 / np.sqrt(2.0 * pairs))


def test_a_motion_that_nearly_repeats_is_not_repeated():
    """The amplitude grows by 2 % per period."""
    noise = noise_of((0.3, 2.0), (0.1, 0.1))
    trial, error = periodic_trial(noise)
    motion = trial.signals.motion
    grown = Motion(motion.t, motion.q * (1.0 + 0.005 * motion.t[:, None]), motion.dq, motion.ddq)
    floor = noise_floor(made_trial(grown, trial.signals.raw_effort), error, noise)
    assert floor.origin == ("earlier model's residual",) * 2


def other_trial(noise, seed=0):
    motion = smooth_motion(2, 30.0, RATE, seed=4)
    effort = np.stack([9.0 + 5.0 * np.sin(motion.q[:, 0] * 4.0), 20.0 * motion.ddq[:, 1]], axis=1)
    error = noise.draw(len(motion), 1, RATE, np.random.default_rng(seed))[:, :, 0]
    return made_trial(motion, effort + error, signed=True), error


def test_floor_is_the_earlier_noise_where_the_earlier_model_was_good():
    """Below a fifth of the effort in joint 1, above it in joint 2, whose floor is from differences of neighbours."""
    trial, error = other_trial(noise_of((0.3, 2.0), (0.5, 0.2)))
    size = rms(trial.signals.raw_effort)
    earlier = noise_of((0.3, 0.6 * size[1]), (0.5, 0.6 * size[1]))
    floor = noise_floor(trial, error, earlier)
    assert floor.origin == ("earlier model's residual", "fast part of the residual")
    assert floor.reliable.tolist() == [True, False]
    assert floor.rms[0] == pytest.approx(np.hypot(0.3, 0.5), rel=0.05)
    assert floor.rms[1] == pytest.approx(2.0, rel=0.05)
    refit = noise_floor(trial, error, earlier, np.array([5.0, 3.3]))
    assert refit.origin == ("earlier model's residual", "refit with standard effects")
    assert refit.rms.tolist() == [floor.rms[0], 3.3]


def test_the_fast_part_is_white_noise_beside_slow_errors_and_gaps():
    trial, _ = other_trial(noise_of((0.3, 2.0), (0.5, 0.2)))
    motion, white = trial.signals.motion, np.random.default_rng(3).standard_normal(trial.used.shape) * [0.3, 2.0]
    used = np.arange(len(motion))[:, None] % np.array([50, 37]) > 4
    residual = np.where(used, 8.0 * np.sin(motion.t)[:, None] + white, 0.0)
    gaps = made_trial(motion, trial.signals.raw_effort, used)
    np.testing.assert_allclose(noise_floor(gaps, residual, noise_of(*[(99.0, 99.0)] * 2)).rms, [0.3, 2.0], rtol=0.06)


@pytest.mark.parametrize(("cutoff", "order"), [(4.0, 2), (8.0, 4)])
def test_the_lag_grows_for_a_low_passed_log(cutoff, order):
    """Half the mean squared difference of filtered noise is sd^2 (1 - r), r its correlation at the lag.

    It is almost 0 between neighbours and grows as lag^2. Wrong signs are jumps.
    """
    trial, _ = other_trial(noise_of((0.3, 2.0), (0.5, 0.2)))
    rng = np.random.default_rng(6)
    white = np.array([0.3, 2.0]) * rng.standard_normal((len(trial.used), 2))
    passed = sosfiltfilt(butter(order, cutoff, fs=RATE, output="sos"), white, axis=0)
    passed[rng.random(len(passed)) < 0.02] *= -1.0
    floor = noise_floor(trial, passed, noise_of(*[0.6 * rms(trial.signals.raw_effort)] * 2))
    assert floor.origin == ("fast part of the residual of a log that was low-passed",) * 2
    share = floor.rms / passed.std(axis=0)
    assert np.all((share > 0.4) & (share < 1.0))


def test_a_mostly_coloured_floor_is_a_models_residual():
    """Above 1.25 times the white noise, 0.3 and 2 N m; repeated periods need no model."""
    size = rms(other_trial(noise_of((0.3, 2.0), (0.1, 0.1)))[0].signals.raw_effort)
    trial, error = other_trial(noise_of((0.3, 2.0), (0.28, 1.0)))
    floor = noise_floor(trial, error, noise_of((0.3, 2.0), (0.28, 1.0)))
    assert floor.mostly_coloured.tolist() == [True, False]
    np.testing.assert_allclose(floor.white, [0.3, 2.0], rtol=0.05)
    poor = noise_of(size, size)
    assert not noise_floor(trial, error, poor).mostly_coloured.any()
    assert noise_floor(trial, error, poor, np.array([0.3, 9.0])).mostly_coloured.tolist() == [False, True]
    trial, error = periodic_trial(noise_of((0.3, 2.0), (0.6, 4.0)))
    assert not noise_floor(trial, error, noise_of((0.3, 2.0), (0.6, 4.0))).mostly_coloured.any()


@pytest.mark.parametrize("factor", [1.3, 3.0])
def test_increased_white_noise_raises_the_floor_up_to_a_bound(factor):
    """At most by half: more is a finding."""
    trial, error = other_trial(noise_of((0.6 * factor, 2.0 * factor), (1e-9, 1e-9)))
    floor = noise_floor(trial, error, noise_of((0.6, 2.0), (0.1, 0.1)))
    np.testing.assert_allclose(floor.rms, np.hypot(min(factor, 1.5) * np.array([0.6, 2.0]), 0.1), rtol=0.05)


def test_limits_let_the_earlier_noise_pass_and_no_larger_one():
    """Twenty draws each; a fitted white or coloured part above its limit is more than noise."""
    earlier = noise_of((0.3, 1.0), (0.2, 0.8))
    passed = {1.0: [], 2.0: []}
    for factor, found in passed.items():
        for seed in range(20):
            trial, error = other_trial(noise_of((0.3, 1.0), factor * np.array([0.2, 0.8])), seed)
            limits = noise_floor(trial, error, earlier).limits
            for j in range(2):
                fitted = fit_error(error[:, j], trial.used[:, j], RATE)[0]
                found.append(fitted.white <= limits[j, 0] and fitted.coloured <= limits[j, 1])
    assert np.mean(passed[1.0]) > 0.9
    assert np.mean(passed[2.0]) < 0.1


def where_case(seed=0):
    """Two joints with almost uncorrelated positions, speeds, accelerations and loads."""
    rng = np.random.default_rng(seed)
    motion = smooth_motion(2, 40.0, RATE, seed=9)
    load = 10.0 * np.sin(1.3 * motion.t[:, None] + np.array([0.3, 1.1])) + motion.q
    noise = 0.1 * rng.standard_normal((len(motion), 2))
    return made_trial(motion, np.abs(load)), load, noise


RESIDUALS = {
    "velocity": (lambda m, load: m.dq[:, 1], 0.9, 1.0),
    "acceleration": (lambda m, load: m.ddq[:, 1], 0.88, 1.0),
    "load": (lambda m, load: load[:, 1], 0.3, 0.45),
    "time": (lambda m, load: m.t, 0.7, 1.0),
}


@pytest.mark.parametrize("name", RESIDUALS)
def test_the_variable_and_its_range_are_named(name):
    """A residual of 1 N m in a range of a variable, to within a bin of a twelfth of the samples."""
    trial, load, noise = where_case()
    of, low, high = RESIDUALS[name]
    values = of(trial.actuators, load)
    edges = np.quantile(values, [low, high])
    residual = noise.copy()
    residual[:, 1] += (values >= edges[0]) & (values <= edges[1])
    used = np.ones_like(trial.used)
    used[500:600] = False
    trial = made_trial(trial.signals.motion, trial.signals.raw_effort, used)
    residual = np.where(used, residual, 0.0)
    floor = np.array([0.1, 0.1])
    quiet, found = where_it_shows(trial, residual, load, floor, [0, 1])
    assert (quiet.joint, found.joint) == (1, 2)
    assert quiet.excess < 0.02
    assert found.excess == pytest.approx(np.sqrt(np.mean(residual[used[:, 1], 1] ** 2) - 0.01), rel=1e-6)
    assert found.variable == name
    place = [np.mean(values[used[:, 1]] <= edge) for edge in found.range]
    assert place[0] == pytest.approx(low, abs=1.0 / 12.0 + 0.01)
    assert place[1] == pytest.approx(high, abs=1.0 / 12.0 + 0.01)


def test_a_long_log_is_shortened_to_stretches():
    motion = smooth_motion(1, 137.0, RATE, seed=2)
    trial = made_trial(motion, 5.0 + motion.q)
    short = shortened(trial)
    assert len(short.used) == 10_000
    steps = np.diff(short.signals.motion.t)
    assert (steps > 0.0).all()
    seams = np.flatnonzero(steps > 1.5 / RATE) + 1
    assert len(seams) == 7
    rows = np.searchsorted(motion.t, short.signals.motion.t - 1e-9)
    assert (rows[0], rows[-1]) == (0, len(motion) - 1)
    for name in ("raw_effort", "effort"):
        np.testing.assert_array_equal(getattr(short.signals, name), getattr(trial.signals, name)[rows])
    np.testing.assert_array_equal(short.actuators.ddq, motion.ddq[rows])
    assert short.signals.motion.origin == motion.origin
    for seam in (*seams, 0, 10_000):
        assert not short.used[max(0, seam - 10) : seam + 10].any()
    assert short.used.sum() == 10_000 - 8 * 20
    few = made_trial(smooth_motion(1, 100.0, RATE), np.ones((10_000, 1)))
    assert shortened(few) is few
