import pickle
import re
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from conftest import real_log, small_robot, smooth_motion

import bayesid
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.drive import Delay
from bayesid.effects.model import Model
from bayesid.effects.sensors import Clipping
from bayesid.effects.tuning import TUNING
from bayesid.errors import InputError
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.monitor import stream_moments
from bayesid.motion import Motion
from bayesid.regression.noise import Noise
from bayesid.simulation.parameters import random_parameters

RATE = 100.0
SIGMA = np.array([0.4, 0.15, 0.02])
FINE = 1e-8
"""Normal equations square a condition number of some 100: rounding of 1e-16 grows to 1e-12 of the largest coefficient,
and more in those that are small."""


class Stream:
    """A simulated robot of three joints: N samples, efforts with noise of known colour, and its true parameters."""

    def __init__(self, duration=12.0, terms=STANDARD, noise=1.0):
        self.robot, self.motion = small_robot(3), smooth_motion(3, duration, RATE, seed=3)
        self.model = Model(self.robot, make_terms(terms, self.robot, self.motion))
        self.theta = random_parameters(self.model, rng=np.random.default_rng(4))
        self.coefficients = base_coefficients(self.model)
        self.beta = self.coefficients.project(self.theta)
        self.noise = noise * SIGMA
        self.effort = self.model.effort(self.motion, self.theta)
        rng = np.random.default_rng(5)
        self.measured = self.effort + self.noise * rng.normal(size=self.effort.shape)
        self.sign = (self.effort > 0.0).astype(float)

    def identified(self, theta=None, precision=None, correlation=None):
        n, r = 3, len(self.coefficients)
        white = np.full(n, 0.999) if correlation is None else np.full(n, 0.6)
        times = np.full(n, 0.01 if correlation is None else correlation)
        noise = Noise(self.noise * white, self.noise * np.sqrt(1.0 - white**2), times, np.ones(n))
        precision = np.zeros((r, r)) if precision is None else precision
        return IdentifiedModel(self.model, self.theta if theta is None else theta, noise, precision)

    def rows(self, sigma):
        """(N, n, r) columns over the noise (n,)."""
        return self.model.columns(self.motion)[:, :, self.coefficients.selected] / sigma[:, None]


@cache
def stream():
    return Stream()


def cuts_of(size, pieces, seed=0):
    inside = np.sort(np.random.default_rng(seed).choice(np.arange(1, size), pieces - 1, replace=False))
    return [slice(a, b) for a, b in zip([0, *inside], [*inside, size], strict=True)]


def fed(case, estimator, pieces=1, probability=None, moving=None, seed=0, effort=None):
    probability = case.sign if probability is None else probability
    effort = np.abs(case.measured) if effort is None else effort
    for part in cuts_of(len(case.motion), pieces, seed):
        here = None if moving is None else moving[part]
        estimator.add(case.motion[part], effort[part], probability[part], here)
    return estimator


def means(estimator):
    return np.array([one.mean for one in estimator.coefficients()])


def sds(estimator):
    return np.array([one.sd for one in estimator.coefficients()])


def everywhere(case):
    return np.ones(case.effort.shape, dtype=bool)


def signed_effort(case):
    return np.where(case.sign > 0.5, 1.0, -1.0) * np.abs(case.measured)


def earlier_precision(case):
    rows = case.rows(case.noise).reshape(-1, len(case.coefficients))
    return rows.T @ rows


def doubted(case, seed=1):
    """(N, n) probabilities that are more certain for larger efforts."""
    spread = np.random.default_rng(seed).uniform(0.2, 3.0, case.effort.shape)
    return 1.0 / (1.0 + np.exp(-2.0 * case.effort / (spread * case.effort.std(axis=0))))


def some_moving(case):
    return np.random.default_rng(8).uniform(size=case.effort.shape) < [0.9, 0.5, 0.2]


def by_hand(case, sigma, effort, used, weight):
    """Weighted least squares by all rows: coefficients and information."""
    rows = case.rows(sigma) * np.sqrt(weight)[:, None, None]
    effort = effort / sigma * np.sqrt(weight)[:, None]
    rows, effort = rows[used], effort[used]
    return np.linalg.lstsq(rows, effort, rcond=None)[0], rows.T @ rows


def weights_of(case, estimator):
    noise = estimator.model().noise
    return noise.sigma * np.sqrt(noise.autocorrelation)


@pytest.mark.parametrize(("pieces", "seed"), [(1, 0), (150, 2)])
def test_coefficients_are_those_of_one_fit_to_all_chunks(pieces, seed):
    case = stream()
    probability, moving = doubted(case), some_moving(case)
    estimator = fed(case, bayesid.RecursiveEstimator(case.identified()), pieces, probability, moving, seed)
    weights = weights_of(case, estimator)
    expected = (2.0 * probability - 1.0) * np.abs(case.measured)
    beta, information = by_hand(case, weights, expected, moving, np.ones(len(case.motion)))
    np.testing.assert_allclose(means(estimator), beta, rtol=FINE, atol=FINE * np.abs(beta).max())
    known = np.where(moving, (2.0 * probability - 1.0) ** 2, 0.0)
    rows = case.rows(weights)
    information = np.einsum("nj,njr,njs->rs", known, rows, rows)
    np.testing.assert_allclose(sds(estimator), np.sqrt(np.diag(np.linalg.inv(information))), rtol=FINE)


def test_with_forgetting_they_are_those_of_weighted_least_squares():
    case = stream()
    estimator = fed(case, bayesid.RecursiveEstimator(case.identified(), forget=3.0), 40, moving=some_moving(case))
    weight = np.exp((case.motion.t - case.motion.t[-1]) / 3.0)
    beta, information = by_hand(case, weights_of(case, estimator), signed_effort(case), some_moving(case), weight)
    np.testing.assert_allclose(means(estimator), beta, rtol=FINE, atol=FINE * np.abs(beta).max())
    np.testing.assert_allclose(sds(estimator), np.sqrt(np.diag(np.linalg.inv(information))), rtol=FINE)
    time = estimator.model().noise.autocorrelation
    np.testing.assert_allclose(estimator.effective_samples, weight @ some_moving(case) / time, rtol=FINE)


def test_the_sd_is_that_of_the_estimates_for_coloured_noise():
    case, scores = stream(), []
    identified = case.identified(correlation=0.05)
    rng = np.random.default_rng(0)
    for noise in np.moveaxis(identified.noise.draw(len(case.motion), 40, RATE, rng), 2, 0):
        measured = case.effort + noise
        running = bayesid.RecursiveEstimator(identified, signed=[True] * 3)
        running.add(case.motion, measured, case.sign, np.ones(measured.shape, dtype=bool))
        scores.append((means(running) - case.beta) / sds(running))
    # 40 draws of 20 and more correlated coefficients: some 10 independent ones, 5 % of a standard deviation.
    # Effective samples assume a motion that is slow beside the noise, which adds some error.
    assert 0.8 < np.std(scores) < 1.25


def test_coefficients_without_information_keep_the_models_values():
    case = stream()
    running = bayesid.RecursiveEstimator(case.identified())
    np.testing.assert_allclose(means(running), case.beta)
    assert np.isinf(sds(running)).all()
    assert {one.decided_by for one in running.coefficients()} == {"prior"}
    moving = np.zeros(case.effort.shape, dtype=bool)
    moving[:, 2] = True
    fed(case, running, moving=moving)
    unfelt = [k for k, name in enumerate(case.coefficients.names) if name in ("Fc1", "Fv1", "Fc2", "Fv2")]
    np.testing.assert_allclose(means(running)[unfelt], case.beta[unfelt], rtol=1e-12)
    assert np.isinf(sds(running)[unfelt]).all()
    assert running.coefficient("Fc3").decided_by == "data"


def test_the_earlier_log_counts_with_earlier():
    case = stream()
    precision = earlier_precision(case)
    identified = case.identified(precision=precision)
    running = fed(case, bayesid.RecursiveEstimator(identified, forget=10.0, earlier=True), moving=some_moving(case))
    weight = np.exp((case.motion.t - case.motion.t[-1]) / 10.0)
    beta, information = by_hand(case, weights_of(case, running), signed_effort(case), some_moving(case), weight)
    left = np.exp(-(case.motion.t[-1] - case.motion.t[0]) / 10.0) * precision
    expected = np.linalg.solve(information + left, information @ beta + left @ case.beta)
    np.testing.assert_allclose(means(running), expected, rtol=FINE, atol=FINE * np.abs(beta).max())
    np.testing.assert_allclose(running.covariance, np.linalg.inv(information + left), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(("sharper", "decided_by"), [(0.01, "data"), (100.0, "earlier log")])
def test_decided_by_the_stream_or_the_earlier_log(sharper, decided_by):
    """By their information alone: both sd include possibly missing effects."""
    case = stream()
    model_error_covariance, by_gains = (np.diag(np.full(len(case.beta), size)) for size in (3.0, 1.0))
    precision = sharper * earlier_precision(case)
    model = replace(
        case.identified(precision=precision), model_error_covariance=model_error_covariance, by_gains=by_gains
    )
    running = fed(case, bayesid.RecursiveEstimator(model, earlier=True), moving=everywhere(case))
    table = running.coefficients()
    assert {one.decided_by for one in table} == {decided_by}
    expected = np.sqrt(np.diag(np.linalg.inv(precision)) + 4.0)
    np.testing.assert_allclose([one.prior_sd for one in table], expected, rtol=1e-6)
    assert all(2.0 < one.sd < one.prior_sd for one in table)
    alone = fed(case, bayesid.RecursiveEstimator(model), moving=everywhere(case)).coefficients()
    assert {one.decided_by for one in alone} == {"data"}
    assert np.isnan([one.prior_sd for one in alone]).all()


def test_records_of_a_tracker_are_chunks():
    """With missing readings, samples that are not fresh, and first samples without values."""
    case, signed = stream(), [False, True, False]
    tracker = bayesid.SignTracker(case.identified(), RATE, lag=0.05, signed=signed)
    readings = np.where(signed, case.measured, np.abs(case.measured))
    readings[300:320, 2] = np.nan
    q = case.motion.q.copy()
    q[500] = np.nan
    records = [tracker.update(*row) for row in zip(case.motion.t, q, readings, strict=True)]
    records.insert(400, replace(records[399], fresh=False))
    by_records, by_chunks = (bayesid.RecursiveEstimator(case.identified(), signed=np.array(signed)) for _ in range(2))
    for part in (records[:3], records[3:450], records[450:]):
        by_records.add_tracked(part)
    used = [one for one in records if one.fresh and np.isfinite(one.predicted).all()]
    assert len(used) > 1100
    parts = {name: np.array([getattr(one, name) for one in used]) for name in ("t", "q", "dq", "ddq")}
    effort = np.array([one.effort for one in used])
    moving = (np.array([one.state for one in used]) == "moving") & np.isfinite(effort)
    assert (np.isnan(effort).sum(axis=0) == [0, 0, 20]).all()
    probability = np.array([one.probability for one in used])
    by_chunks.add(Motion(**parts), np.nan_to_num(effort), probability, moving)
    np.testing.assert_allclose(means(by_records), means(by_chunks), rtol=1e-9)
    np.testing.assert_allclose(sds(by_records), sds(by_chunks), rtol=1e-9)
    assert np.abs((means(by_records) - case.beta) / sds(by_records)).max() < 6.0
    with pytest.raises(InputError, match="tool1"):
        bayesid.RecursiveEstimator(case.identified()).add_tracked(records, payload="tool1")


def test_the_model_is_in_the_cone_and_near_the_coefficients():
    case = stream()
    running = fed(case, bayesid.RecursiveEstimator(case.identified()), 3, moving=everywhere(case))
    model = running.model()
    assert case.model.cone.contains(model.theta)
    spread = case.coefficients.project(model.theta) - case.beta
    assert np.sqrt(spread @ model.precision @ spread) < 2.0 * np.sqrt(len(case.beta))  # chi of as many, 5 sd
    assert model.predict(case.motion, noise=False).sd_of_mean.shape == case.effort.shape


def test_effective_samples_follow_the_rate_of_the_stream():
    case, step = stream(), 4
    running = bayesid.RecursiveEstimator(case.identified(correlation=0.1))
    running.add(case.motion[::step], np.abs(case.measured)[::step], case.sign[::step], case.effort[::step] != 0.0)
    expected = case.identified(correlation=0.1).noise.with_time_of_model(RATE / step).autocorrelation
    np.testing.assert_allclose(running.effective_samples, len(case.motion[::step]) / expected, rtol=1e-9)


def test_standstill_does_not_count_for_any_chunks():
    case = stream()
    speed = np.abs(case.motion.dq)
    moving = speed > 0.01 * np.maximum.accumulate(speed)
    assert 0.0 < np.mean(~moving) < 0.2
    expected = fed(case, bayesid.RecursiveEstimator(case.identified()), 1, moving=moving)
    for pieces in (1, 31):
        own = fed(case, bayesid.RecursiveEstimator(case.identified()), pieces)
        own.add(case.motion[:0], case.effort[:0], case.sign[:0])  # an empty chunk changes nothing
        np.testing.assert_allclose(own.effective_samples, expected.effective_samples, rtol=1e-12)
        np.testing.assert_allclose(means(own), means(expected), rtol=FINE, atol=FINE)


def test_readings_that_show_no_effort_do_not_count():
    case = Stream(duration=8.0)
    limit = float(np.quantile(np.abs(case.measured[:, 1]), 0.7))
    case.model = case.model.extend(Clipping(joints=(2,), limit=(limit,)))
    clipped, moving = case.model.read(case.measured), everywhere(case)
    below = case.model.invert_sensor(np.abs(clipped))[1]
    assert 0.6 < below[:, 1].mean() < 0.8
    running = fed(case, bayesid.RecursiveEstimator(case.identified()), 4, effort=np.abs(clipped), moving=moving)
    expected = fed(case, bayesid.RecursiveEstimator(case.identified()), 1, moving=below)
    np.testing.assert_allclose(means(running), means(expected), rtol=FINE, atol=FINE)


def test_effects_with_a_memory_continue_over_chunks(monkeypatch):
    case = Stream(duration=8.0)
    case.model = case.model.extend(Delay(lag=(0.023,)))
    monkeypatch.setattr(stream_moments, "EFFECTS", replace(TUNING, look_back=64))  # a spline decays by 0.27 per sample
    moving = everywhere(case)
    whole = fed(case, bayesid.RecursiveEstimator(case.identified()), 1, moving=moving)
    parts = fed(case, bayesid.RecursiveEstimator(case.identified()), 23, moving=moving)
    columns = case.model.columns(case.motion)[: -TUNING.look_ahead, :, case.coefficients.selected]
    rows = (columns / weights_of(case, whole)[:, None]).reshape(-1, columns.shape[2])
    effort = signed_effort(case)[: -TUNING.look_ahead] / weights_of(case, whole)
    beta = np.linalg.lstsq(rows, effort.ravel(), rcond=None)[0]
    for one in (whole, parts):
        assert one.effective_samples == pytest.approx(whole.effective_samples, rel=1e-12)
        np.testing.assert_allclose(means(one), beta, rtol=1e-6, atol=1e-6)  # 0.27^16 = 1e-9 at the ends


FLIPPED = ((1, 2.0, 2.6), (0, 5.1, 5.9), (2, 8.0, 8.3))
"""Joint, start and end, s, of wrong signs."""


def flipped(case):
    probability = case.sign.copy()
    for j, start, end in FLIPPED:
        rows = (case.motion.t >= start) & (case.motion.t < end)
        probability[rows, j] = 1.0 - probability[rows, j]
    return probability


@pytest.mark.parametrize(("pieces", "forget"), [(1, None), (60, 30.0)])
def test_flipped_segments_are_found(pieces, forget):
    case = stream()
    check = fed(case, bayesid.RecursiveEstimator(case.identified(), forget), pieces, flipped(case)).check_signs()
    assert check.certified
    assert check.differ
    assert check.cost < check.cost_used
    assert "joint 1," in repr(check)
    for j, start, end in FLIPPED:
        found = [one for one in check.segments if one.joint == j + 1 and one.start < end and one.end > start]
        rows = (case.motion.t >= start) & (case.motion.t < end)
        strong = case.motion.t[rows & (np.abs(case.effort[:, j]) > 3.0 * case.noise[j])]
        covered = [any(one.start <= t <= one.end for one in found) for t in strong]
        assert np.mean(covered) > 0.9
    for one in check.segments:
        assert any(one.joint == j + 1 and start <= one.start and one.end < end for j, start, end in FLIPPED)
        assert (one.persistent, one.merged) == (True, False)
        assert one.cost > 9.0


def test_the_check_does_not_depend_on_the_chunks_nor_on_how_many_segments_are_kept():
    case = stream()
    many, few, merged = (
        fed(
            case, bayesid.RecursiveEstimator(case.identified(), most_individual=most), pieces, flipped(case)
        ).check_signs()
        for pieces, most in ((90, 10_000), (1, 10_000), (40, 3))
    )
    assert few.cost == pytest.approx(many.cost, rel=1e-6)
    assert [(one.joint, one.start, one.end) for one in few.segments] == [
        (one.joint, one.start, one.end) for one in many.segments
    ]
    assert merged.cost_used == pytest.approx(few.cost_used, rel=1e-6)  # merged segments add up
    assert merged.cost >= few.cost * (1.0 - 1e-6)


def test_a_joint_that_is_flipped_as_a_whole_is_found_though_its_segments_were_merged():
    case = stream()
    right = fed(case, bayesid.RecursiveEstimator(case.identified()), 9).check_signs()
    assert (right.certified, right.differ) == (True, False)
    probability = case.sign.copy()
    probability[:, 1] = 1.0 - probability[:, 1]
    running = fed(case, bayesid.RecursiveEstimator(case.identified(), most_individual=3), 40, probability)
    check = running.check_signs()
    assert check.certified
    assert [one.joint for one in check.segments if one.merged] == [2]


def test_memory_stays_bounded():
    case, sizes = stream(), []
    running = bayesid.RecursiveEstimator(case.identified(), forget=20.0, most_individual=10)
    for k in range(8):
        later = replace(case.motion, t=case.motion.t + 12.0 * k)
        for part in cuts_of(len(later), 10, k):
            running.add(later[part], np.abs(case.measured)[part], case.sign[part])
        sizes.append(len(pickle.dumps(running)))
    assert max(sizes[4:]) < 1.3 * max(sizes[:4])


def test_a_restored_estimator_continues_exactly():
    case = stream()
    running = bayesid.RecursiveEstimator(case.identified(), forget=5.0)
    probability = doubted(case)
    fed(case, running, probability=probability)
    restored, later = pickle.loads(pickle.dumps(running)), replace(case.motion, t=case.motion.t + 12.0)
    for one in (running, restored):
        for part in cuts_of(len(later), 6, 4):
            one.add(later[part], np.abs(case.measured)[part], probability[part])
    np.testing.assert_array_equal(restored.covariance, running.covariance)
    np.testing.assert_array_equal(restored.model().theta, running.model().theta)
    assert restored.check_signs().cost == running.check_signs().cost


def test_bad_chunks_are_refused_and_change_nothing():
    case = stream()
    running = bayesid.RecursiveEstimator(case.identified())
    with pytest.raises(InputError, match="no sample in motion"):
        running.check_signs()
    motion, effort, sign = case.motion[:50], np.abs(case.measured[:50]), case.sign[:50]
    running.add(motion, effort, sign)
    before = means(running)
    later = case.motion[50:100]
    broken = effort.copy()
    broken[3, 1] = np.nan
    backwards, loaded = later[np.array([0, 2, 1])], replace(later, payload=np.array("box"))
    for message, call in {
        "2 joints": (later.joints([0, 1]), effort[:, :2], sign[:, :2]),
        "begins at 0.2 s": (case.motion[20:70], effort, sign),
        "sample 2: time goes from 0.52 to 0.51 s": (backwards, effort[:3], sign[:3]),
        "no payload 'box'": (loaded, effort, sign),
        "effort, sample 3, joint 2": (later, broken, sign),
        "effort: values of shape (49, 3)": (later, effort[1:], sign),
        "effort: holds": (later, [["a"]], sign),
        "probability: holds": (later, effort, 2.0 * sign),
        "moving: values of shape (3,)": (later, effort, sign, [True] * 3),
    }.items():
        with pytest.raises(InputError, match=re.escape(message)):
            running.add(*call)
    np.testing.assert_array_equal(means(running), before)
    running.add(later, effort, sign)


def test_invalid_options_are_refused():
    case = stream()
    for options in ({"forget": 0.0}, {"forget": np.inf}, {"signed": [True]}, {"most_individual": -1}):
        with pytest.raises(InputError, match=next(iter(options))):
            bayesid.RecursiveEstimator(case.identified(), **options)
    with pytest.raises(InputError, match="did you mean Fc"):
        bayesid.RecursiveEstimator(case.identified()).coefficient("Fc7")
    for make in (bayesid.RecursiveEstimator, partial(bayesid.SignTracker, rate=RATE)):
        for given, remedy in ((Path("ur"), "'ur'"), (3, "folder")):
            with pytest.raises(InputError, match=re.escape(f"bayesid.load({remedy})")):
                make(given)


@pytest.mark.real
def test_a_real_stream_agrees_with_the_identification_of_its_log():
    log = bayesid.read_log(real_log("ur10e/a_50s.csv")).rectified()
    search = bayesid.Certified(budget=5.0)
    offline = bayesid.identify("ur10e", log, search=search, posterior=False, complete="off")
    signals, fit = offline.signals, offline.fit
    used = (offline.segments.per_sample(offline.segments.fitted, *offline.probability.shape) > 0) & signals.inner
    running = bayesid.RecursiveEstimator(offline)
    for part in cuts_of(len(signals.motion), 25):
        running.add(signals.motion[part], signals.raw_effort[part], offline.probability[part], used[part])
    # The offline fit has other weights and is in the cone: two sd of the least certain coefficients.
    for beta in (means(running), offline.coefficients.project(running.model().theta)):
        assert np.abs((beta - fit.beta) / fit.sd).max() < 2.5
        assert np.sqrt(np.mean(((beta - fit.beta) / fit.sd) ** 2)) < 1.0
    ratio = sds(running) / fit.sd
    assert np.all((ratio >= 1.0) & (ratio < 1.2))  # uncertain signs have less information
    np.testing.assert_allclose(running.model().noise.autocorrelation, offline.noise.autocorrelation, rtol=1e-9)
    check = running.check_signs(search)
    assert (check.certified, check.differ) == (True, False)
