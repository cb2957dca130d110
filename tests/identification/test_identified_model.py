"""Efforts of a new motion with their uncertainty, and models held against new logs: closed forms, draws, simulation."""

from dataclasses import replace

import numpy as np
import pytest
from identified_arm import MODEL, NOISE, ROBOT, THETA, by_least_squares, log_of, motion_of
from pandas import DataFrame

from bayesid.effects.catalogue import make_effect
from bayesid.effects.coefficients import base_coefficients
from bayesid.errors import InputError
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.identification.model_file import load
from bayesid.identification.options import hashes
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.regression.noise import Noise
from bayesid.report.folders import save_identification
from bayesid.simulation.logs import simulate

Z = 1.959964


@pytest.fixture(scope="module")
def noise():
    coloured = np.array([0.1, 0.3, 0.2])
    return Noise(np.array([0.4, 0.1, 0.2]), coloured, np.full(3, 0.1), np.ones(3))


@pytest.fixture(scope="module")
def normal(noise):
    """A model whose coefficients have a known, dense covariance."""
    size = len(base_coefficients(MODEL))
    turn = np.random.default_rng(3).normal(size=(size, size))
    covariance = turn @ np.diag(np.geomspace(1e-4, 1e-2, size)) @ turn.T
    return IdentifiedModel(MODEL, THETA, noise, np.linalg.inv(covariance)), covariance


def rows_of(MODEL, motion):
    """(N, n, r) columns of the coefficients, for efforts = rows beta, from the parameters' by the pseudoinverse."""
    return MODEL.columns(motion) @ np.linalg.pinv(base_coefficients(MODEL).projection)


def test_normal_coefficients_have_the_closed_form(noise, normal):
    identified, covariance = normal
    motion = motion_of(7)
    predicted = identified.predict(motion)
    rows = rows_of(MODEL, motion)
    variance = np.einsum("tjr,rs,tjs->tj", rows, covariance, rows)
    np.testing.assert_allclose(predicted.mean, MODEL.columns(motion) @ THETA, rtol=1e-12)
    np.testing.assert_allclose(predicted.sd_of_mean, np.sqrt(variance), rtol=1e-6)
    np.testing.assert_allclose(predicted.sd, np.sqrt(variance + noise.white**2 + noise.coloured**2), rtol=1e-6)
    np.testing.assert_allclose(predicted.upper - predicted.mean, Z * predicted.sd, rtol=1e-6)
    np.testing.assert_allclose(predicted.mean - predicted.lower, Z * predicted.sd, rtol=1e-6)
    model_error_covariance = np.zeros_like(covariance)  # what the model may lack widens the band
    model_error_covariance[2:4, 2:4] = [[0.5, 0.2], [0.2, 0.3]]
    wider = replace(identified, model_error_covariance=model_error_covariance).predict(motion, noise=False)
    variance = np.einsum("tjr,rs,tjs->tj", rows, covariance + model_error_covariance, rows)
    np.testing.assert_allclose(wider.sd, np.sqrt(variance), rtol=1e-6)


def test_draws_have_the_mean_and_covariance_that_the_band_says(normal, noise):
    """Of 4000 draws: the sd is known to 1.1 %, five of which hold for all of 3 x 20 instants."""
    identified, covariance = normal
    motion = motion_of(7)[:20]
    count, rows = 4000, rows_of(MODEL, motion)
    for predicted in (identified.predict(motion, draws=count, noise=noisy, rng=5) for noisy in (True, False)):
        assert predicted.draws.shape == (count, 20, 3)
        np.testing.assert_allclose(predicted.draws.std(axis=0) / predicted.sd, 1.0, atol=5 * 0.011)
        off = (predicted.draws.mean(axis=0) - predicted.mean) / predicted.sd
        assert np.abs(off).max() < 5.0 / np.sqrt(count)
    joint = predicted.draws[:, [0, 15], 1]  # without noise
    expected = rows[[0, 15], 1] @ covariance @ rows[[0, 15], 1].T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.cov(joint.T) / scale, expected / scale, atol=0.1)
    whole = replace(identified, precision=np.zeros((0, 0))).predict(motion_of(7), draws=60)
    off = whole.draws - whole.mean
    after = (off[:, 1:] * off[:, :-1]).mean(axis=(0, 1)) / (off**2).mean(axis=(0, 1))
    colour = np.exp(-0.1) * noise.coloured**2 / (noise.coloured**2 + noise.white**2)
    np.testing.assert_allclose(after, colour, atol=0.04)  # 0.01 s of a memory of 0.1 s
    same = identified.predict(motion, draws=3, rng=5).draws
    np.testing.assert_array_equal(same, identified.predict(motion, draws=3, rng=5).draws)
    assert not np.array_equal(same, identified.predict(motion, draws=3, rng=6).draws)


def test_the_posteriors_draws_make_mean_and_band(noise):
    names = [parameter.name for parameter in MODEL.parameters]
    k, rng = names.index("Fv2"), np.random.default_rng(3)
    drawn = np.tile(THETA, (200, 1))
    drawn[:, k] += 0.3 * rng.standard_normal(200)
    sigma = np.abs(rng.normal(1.0, 0.2, (200, 3))) * noise.sigma
    identified = IdentifiedModel(MODEL, THETA, noise, np.zeros((0, 0)), ParameterDraws(drawn, sigma))
    predicted = identified.predict(motion_of(7), draws=40, noise=False)
    column = MODEL.columns(motion_of(7))[:, :, k]
    np.testing.assert_allclose(predicted.sd, np.abs(column) * drawn[:, k].std(), rtol=1e-9, atol=1e-9)
    covered = identified.spread.sd(MODEL.columns(motion_of(7)))  # N - 1 in place of N
    np.testing.assert_allclose(covered * np.sqrt(199 / 200), predicted.sd, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(predicted.sd_of_noise, np.sqrt((sigma**2).mean(axis=0)))
    possible = MODEL.columns(motion_of(7)[[100]]) @ drawn.T
    chosen = np.abs(predicted.draws[:, 100, 1][:, None] - possible[0, 1]).min(axis=1)
    assert chosen.max() < 1e-9
    assert len(np.unique(predicted.draws[:, 100, 1])) == 40
    assert predicted.holds == "parameters, by the posterior"


def test_what_the_log_has_not_shown_is_unknown(noise, normal):
    """Joint 1 has its own friction: without a word about it, only its effort is unknown, and only while it moves."""
    identified, covariance = normal
    names = list(base_coefficients(MODEL).names)
    others = [k for k, name in enumerate(names) if name != "Fv1"]
    precision = np.zeros_like(covariance)
    precision[np.ix_(others, others)] = np.linalg.inv(covariance[np.ix_(others, others)])
    motion = motion_of(7)
    still = np.array(motion.dq)
    still[:50, 0] = 0.0
    predicted = replace(identified, precision=precision).predict((motion.t, motion.q, still, motion.ddq))
    assert np.isinf(predicted.sd[50:, 0]).mean() > 0.9
    assert np.isfinite(predicted.sd[:50, 0]).all()
    assert np.isfinite(predicted.sd[:, 1:]).all()


def test_where_nothing_is_known_the_noise_is_alone(noise):
    nominal = IdentifiedModel(MODEL, THETA, noise, np.zeros((0, 0)))
    predicted = nominal.predict(motion_of(7))
    np.testing.assert_allclose(predicted.sd, np.broadcast_to(noise.sigma, predicted.sd.shape))
    assert predicted.holds == predicted.basis == "noise alone"
    with pytest.raises(InputError, match="`noise=False`: nothing is known"):
        nominal.predict(motion_of(7), noise=False)


def test_drawn_efforts_are_read_once_by_the_sensor(noise, normal):
    """A sensor that takes 0.4 N m off: once, whatever is known of the parameters."""
    sensor = make_effect("dead_zone.shrinking", {"joints": (2,), "width": (0.4,)})
    motion = motion_of(7)
    quiet = replace(noise, white=1e-9 * noise.white, coloured=1e-9 * noise.coloured)
    certain = replace(normal[0], model=MODEL.extend(sensor), noise=quiet, precision=1e18 * normal[0].precision)
    for one in (certain, replace(certain, precision=np.zeros((0, 0)))):
        predicted = one.predict(motion, draws=2)
        np.testing.assert_allclose(predicted.draws[1], predicted.mean, atol=1e-5)
        off = np.abs(MODEL.effort(motion, THETA)) - np.abs(predicted.mean)
        assert off[:, 1].max() == pytest.approx(0.4)


def test_a_motion_comes_in_many_forms(tmp_path):
    """Noiseless positions: their derivatives are found again but for the filter, and for its ends."""
    motion, model = motion_of(7), by_least_squares()
    expected = model.predict(motion)
    np.testing.assert_array_equal(model.predict((motion.t, motion.q, motion.dq, motion.ddq)).mean, expected.mean)
    header = ["t", "q1", "q2", "q3"]
    values = np.column_stack([motion.t, motion.q])
    path = tmp_path / "motion.csv"
    np.savetxt(path, values, delimiter=",", header=",".join(header), comments="", fmt="%.17g")
    largest = np.abs(expected.mean).max(axis=0)
    for form in (
        [motion.t.tolist(), motion.q.tolist()],
        (motion.t, motion.q, motion.dq, None),
        DataFrame(dict(zip(header, values.T, strict=True))),
        DataFrame({"t": motion.t, "note": "x"} | {f"q{j + 1}[deg]": np.rad2deg(motion.q[:, j]) for j in range(3)}),
        path,
    ):
        predicted = model.predict(form)
        np.testing.assert_allclose(predicted.t, motion.t, atol=1e-12)
        error = np.abs(predicted.mean - expected.mean)[30:-30] / largest
        assert np.quantile(error, 0.99) < 0.02
    log = log_of(0)
    validated, predicted = model.validate(log), model.predict(log)
    np.testing.assert_allclose(predicted.mean, validated.predicted, atol=1e-8)
    np.testing.assert_allclose(predicted.upper, validated.upper, atol=1e-8)
    assert len(model.predict(join_logs([log, log])).t) == 2 * len(log)


def test_what_is_no_motion_is_refused():
    t, q = np.arange(60) / 100.0, np.sin(np.arange(180.0)).reshape(60, 3)
    for given, says in (
        ((t, q[:, :2]), "the motion has 2 joints, the model's robot arm3 has 3"),
        ((t[1:], q), r"t has shape \(59,\), but q has shape \(60, 3\)"),
        ((t, q, q[1:]), r"dq has shape \(59, 3\)"),
        ((t, np.where(np.arange(60)[:, None] == 7, np.nan, q)), "row 8: column q1 holds nan"),
        ((t[::-1], q, q, q), "time decreases"),
        ((t, q, q, q[1:]), "ddq has shape"),
        (([], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))), "has no samples"),
        ((["a"], q), "t holds values that are not numbers"),
        ((t[:20], q[:20]), "holds 20 rows"),
        (3.0, "float is not a motion"),
        ((t,), "1 arrays are not a motion"),
        (DataFrame({"t": t, "q2": t}), "column q1 is missing"),
        ("absent.csv", "absent.csv: no such file"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            by_least_squares().predict(given)
        assert "\n" not in str(caught.value)


def test_a_prediction_is_the_same_from_a_folder_and_in_frames_datasets_and_files(tmp_path):
    size = len(by_least_squares().coefficients)
    model_error_covariance = replace(by_least_squares(), model_error_covariance=np.diag(np.arange(1.0, size + 1.0)))
    save_identification(model_error_covariance, tmp_path / "result", report=False)
    there = load(tmp_path / "result")
    np.testing.assert_array_equal(there.model_error_covariance, model_error_covariance.model_error_covariance)
    predicted, again = (one.predict(motion_of(7), draws=5) for one in (model_error_covariance, there))
    np.testing.assert_allclose(again.mean, predicted.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(again.sd, predicted.sd, rtol=1e-6)
    header = ["t", *(f"{kind}{j}" for kind in ("tau", "sd", "lower", "upper") for j in (1, 2, 3))]
    frame, data = predicted.to_dataframe(), predicted.to_xarray()
    assert list(frame.columns) == header
    np.testing.assert_array_equal(frame["upper3"], predicted.upper[:, 2])
    assert data.draws.dims == ("draw", "time", "joint")
    assert "draws" not in there.predict(motion_of(7)).to_xarray()
    np.testing.assert_array_equal(data.lower.sel(joint=2), predicted.lower[:, 1])
    path = predicted.save(tmp_path / "new" / "prediction.csv")
    assert path.read_text().splitlines()[0] == ",".join(header)
    values = np.loadtxt(path, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(values[:, 0], predicted.t)
    np.testing.assert_allclose(values[:, 1:4], predicted.mean, rtol=1e-8)


NEW = log_of(21)
EFFORT = MODEL.effort(motion_of(21), THETA)


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


SIZE = NOISE * rms(MODEL.effort(motion_of(0), THETA))
ASSUMED = Noise(white=SIZE, coloured=0.2 * SIZE, correlation=np.full(3, 0.1), autocorrelation=np.ones(3))


def validate(log, theta=THETA, noise=ASSUMED, cutoff=None, draws=None, model=MODEL):
    return IdentifiedModel(model, theta, noise, np.zeros((0, 0)), draws).validate(log, cutoff)


def hidden(log):
    return replace(log, effort=np.abs(log.effort), signed=np.zeros(log.n_joints, dtype=bool))


def in_motion(result):
    speed = np.abs(result.signals.motion.dq)
    return speed > 0.01 * speed.max(axis=0)


@pytest.mark.parametrize("signs", ["known", "hidden"])
def test_the_true_model_predicts_a_new_log_within_its_noise(signs):
    """The measured efforts pass a low-pass at a quarter of Nyquist's frequency, and so does a quarter of the noise."""
    result = validate(NEW if signs == "known" else hidden(NEW))
    np.testing.assert_allclose(result.predicted, EFFORT, atol=0.03 * rms(EFFORT).max())
    assert np.all(result.relative_residual < NOISE)
    assert np.all(result.relative_residual > 0.25 * NOISE)
    strong = np.abs(EFFORT) >= 0.05 * np.abs(EFFORT).max(axis=0)
    assert np.all(((result.probability >= 0.5) == (EFFORT > 0.0))[strong])
    moving = in_motion(result)
    for j in range(3):
        error, measured = (result.measured - result.predicted)[moving[:, j], j], result.measured[moving[:, j], j]
        assert result.rms_error[j] == pytest.approx(rms(error))
        assert result.relative_residual[j] == pytest.approx(rms(error) / rms(measured))


def test_a_joint_without_efforts_is_not_compared():
    """Its column holds zeros: no error, no share, and it is said."""
    dead = replace(NEW, effort=NEW.effort * [1.0, 0.0, 1.0])
    result, whole = validate(dead), validate(NEW)
    for name in ("rms_error", "relative_residual", "coverage"):
        found = getattr(result, name)
        assert np.isnan(found[1])
        np.testing.assert_allclose(found[[0, 2]], getattr(whole, name)[[0, 2]])
    assert result.not_compared == {2: "no effort recorded"}
    assert "joint 2: no effort recorded" in repr(result)
    assert whole.not_compared == {}


def test_a_log_that_the_model_was_identified_from_is_marked():
    seen = IdentifiedModel(MODEL, THETA, ASSUMED, np.zeros((0, 0)), logs=hashes(NEW))
    assert seen.validate(NEW).seen
    assert not seen.validate(replace(NEW, effort=1.01 * NEW.effort)).seen
    assert not validate(NEW).seen


def test_wrong_parameters_are_seen():
    """Ten noise sd of wrong effort in some joint, whatever the signs; a model far off has probabilities too."""
    names = [parameter.name for parameter in MODEL.parameters]
    right = validate(NEW).relative_residual
    for name in ("m3", "Fc1", "mc2x"):
        column, wrong = MODEL.columns(motion_of(21))[:, :, names.index(name)], THETA.copy()
        wrong[names.index(name)] += 10.0 / np.max(rms(column) / (NOISE * rms(EFFORT)))
        for log in (NEW, hidden(NEW)):
            assert np.max(validate(log, wrong).relative_residual / right) > 5.0
    sure = replace(ASSUMED, white=0.1 * ASSUMED.white, coloured=0.1 * ASSUMED.coloured)
    half = validate(hidden(NEW), 0.5 * THETA, sure)
    assert np.isfinite(half.probability).all()
    np.testing.assert_allclose(half.relative_residual, 0.5, atol=0.1)


def test_a_model_with_the_wrong_signs_does_not_pass():
    """|effort| of -theta is that of theta: only signs, or the cone while identifying, tell them apart."""
    plus, minus = (validate(hidden(NEW), values) for values in (THETA, -THETA))
    np.testing.assert_allclose(minus.relative_residual, plus.relative_residual, rtol=1e-6)
    np.testing.assert_allclose(minus.probability, 1.0 - plus.probability, atol=1e-5)  # beliefs are single numbers
    assert validate(NEW, -THETA).relative_residual.min() > 1.5


def test_a_log_of_another_robot_and_a_cutoff_out_of_range_are_refused():
    two = replace(NEW, q=NEW.q[:, :2], effort=NEW.effort[:, :2], signed=NEW.signed[:2])
    with pytest.raises(InputError, match=r"2 joints.*arm3 has 3"):
        validate(two)
    assert validate(NEW, cutoff=12.0).signals.cutoff == 12.0
    with pytest.raises(InputError, match="`cutoff`: "):
        validate(NEW, cutoff=60.0)


@pytest.mark.parametrize(("colour", "time"), [(0.0, 1.0), (0.8, 1.8 / 0.2)])
def test_the_band_of_the_true_model_holds_what_it_promises(colour, time):
    """The right noise, white or AR(1): 95 % of four logs' samples, as many of which count as the noise's memory allows.

    Memory of indicators is shorter than that of the noise itself: the error is no larger than this.
    """
    inside, count, size = np.zeros(3), np.zeros(3), NOISE * rms(EFFORT)
    own = replace(ASSUMED, white=0.8 * size, coloured=0.6 * size)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        log = simulate(MODEL, THETA, motion_of(21), rng=rng, noise=NOISE, colour=colour, signed=True)
        result = validate(log, noise=own)
        assert result.band == "noise alone"
        np.testing.assert_allclose(result.upper - result.predicted, np.tile(1.959964 * size, (601, 1)), rtol=1e-6)
        np.testing.assert_allclose(result.predicted - result.lower, np.tile(1.959964 * size, (601, 1)), rtol=1e-6)
        within = (log.effort >= result.lower) & (log.effort <= result.upper) & in_motion(result)
        np.testing.assert_allclose(result.coverage, within.sum(axis=0) / in_motion(result).sum(axis=0))
        inside, count = inside + within.sum(axis=0), count + in_motion(result).sum(axis=0) / time
    error = np.sqrt(0.05 * 0.95 / count)
    assert np.all(np.abs(inside / (time * count) - 0.95) < 4.0 * error)
    assert np.all(4.0 * error < 0.06), "a band of 99.5 or 85 % would be seen"


def test_an_identified_models_band_holds_a_new_log():
    """Six noisy seconds: the band of another motion, its noise the same in N m, holds 95 % of its samples."""
    log = simulate(MODEL, THETA, motion_of(0), rng=np.random.default_rng(5), noise=4.0 * NOISE, signed=True)
    sampled = identify(ROBOT, log)
    draws = sampled.identified.draws
    np.testing.assert_allclose(draws.sigma.mean(axis=0), 4.0 * SIZE, rtol=0.2)
    noisy = EFFORT + 4.0 * SIZE * np.random.default_rng(22).standard_normal(EFFORT.shape)
    result = sampled.validate(replace(NEW, effort=noisy))
    assert result.band == "parameters and noise, by the posterior"
    binomial = np.sqrt(0.05 * 0.95 / in_motion(result).sum(axis=0))
    np.testing.assert_array_less(np.abs(result.coverage - 0.95), 4.0 * binomial)
    certain = ParameterDraws(np.tile(sampled.theta, (len(draws.theta), 1)), draws.sigma)
    narrow = validate(replace(NEW, effort=noisy), sampled.theta, sampled.fit.noise, None, certain, sampled.model)
    wider = (result.upper - result.lower) / (narrow.upper - narrow.lower)
    assert wider.min() > 1.0
    assert np.all(wider.max(axis=0) > 1.01)
    np.testing.assert_array_equal(result.predicted, narrow.predicted)
