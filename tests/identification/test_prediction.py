"""Efforts of a new motion with their uncertainty, against closed forms, draws, and simulated logs."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.errors import InputError
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs, write_log
from bayesid.model.catalogue import make_effect, make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.posterior.labelled import DataFrame
from bayesid.results.folders import save_identification
from bayesid.results.model_file import load_model
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
NOISE = 0.05
Z = 1.959964


def motion_of(seed, duration=6.0):
    return smooth_motion(3, duration, 100.0, seed=seed)


@pytest.fixture(scope="module")
def model():
    robot = small_robot(3)
    return Model(robot, make_terms(TERMS, robot, motion_of(0)))


@pytest.fixture(scope="module")
def theta(model):
    return random_parameters(model, np.random.default_rng(4))


@pytest.fixture(scope="module")
def log(model, theta):
    return simulate(model, theta, motion_of(0), rng=np.random.default_rng(1), noise=NOISE, signed=True)


@pytest.fixture(scope="module")
def noise():
    coloured = np.array([0.1, 0.3, 0.2])
    return Noise(np.array([0.4, 0.1, 0.2]), coloured, np.full(3, 0.1), np.ones(3))


@pytest.fixture(scope="module")
def result(model, log):
    return identify(model.robot, log, TERMS, complete="off", posterior=False)


@pytest.fixture(scope="module")
def normal(model, theta, noise):
    """A model whose coefficients have a known, dense covariance."""
    size = len(base_coefficients(model))
    turn = np.random.default_rng(3).normal(size=(size, size))
    covariance = turn @ np.diag(np.geomspace(1e-4, 1e-2, size)) @ turn.T
    return IdentifiedModel(model, theta, noise, np.linalg.inv(covariance)), covariance


def rows_of(model, motion):
    """(N, n, r) columns of the coefficients, for efforts = rows beta, from the parameters' by the pseudoinverse."""
    return model.columns(motion) @ np.linalg.pinv(base_coefficients(model).projection)


# ---------------------------------------------------------------------------------------------------------------
# What is uncertain
# ---------------------------------------------------------------------------------------------------------------
def test_normal_coefficients_have_the_closed_form(model, theta, noise, normal):
    identified, covariance = normal
    motion = motion_of(7)
    predicted = identified.predict(motion)
    rows = rows_of(model, motion)
    variance = np.einsum("tjr,rs,tjs->tj", rows, covariance, rows)
    np.testing.assert_allclose(predicted.mean, model.columns(motion) @ theta, rtol=1e-12)
    np.testing.assert_allclose(predicted.sd_of_mean, np.sqrt(variance), rtol=1e-6)
    np.testing.assert_allclose(predicted.sd, np.sqrt(variance + noise.white**2 + noise.coloured**2), rtol=1e-6)
    np.testing.assert_allclose(predicted.upper - predicted.mean, Z * predicted.sd, rtol=1e-6)
    np.testing.assert_allclose(predicted.mean - predicted.lower, Z * predicted.sd, rtol=1e-6)
    assert (predicted.basis, predicted.holds) == (
        "by the information matrix",
        "parameters and noise, by the information matrix",
    )


def test_what_the_model_may_lack_widens_the_band(model, normal):
    identified, covariance = normal
    motion, rows = motion_of(7), rows_of(model, motion_of(7))
    lacking = np.zeros_like(covariance)
    lacking[2:4, 2:4] = [[0.5, 0.2], [0.2, 0.3]]
    wider = replace(identified, lacking=lacking).predict(motion, noise=False)
    variance = np.einsum("tjr,rs,tjs->tj", rows, covariance + lacking, rows)
    np.testing.assert_allclose(wider.sd, np.sqrt(variance), rtol=1e-6)


def test_without_noise_the_band_is_that_of_the_models_effort(normal):
    identified, _ = normal
    predicted = identified.predict(motion_of(7), noise=False)
    np.testing.assert_array_equal(predicted.sd, identified.predict(motion_of(7)).sd_of_mean)
    assert predicted.holds == "parameters, by the information matrix"


def test_draws_have_the_mean_and_covariance_that_the_band_says(model, normal, noise):
    """Of 4000 draws: the sd is known to 1.1 %, five of which hold for all of 3 x 20 instants."""
    identified, covariance = normal
    motion = motion_of(7)[:20]
    count, rows = 4000, rows_of(model, motion)
    for predicted in (identified.predict(motion, draws=count, noise=noisy, seed=5) for noisy in (True, False)):
        assert predicted.draws.shape == (count, 20, 3)
        np.testing.assert_allclose(predicted.draws.std(axis=0) / predicted.sd, 1.0, atol=5 * 0.011)
        off = (predicted.draws.mean(axis=0) - predicted.mean) / predicted.sd
        assert np.abs(off).max() < 5.0 / np.sqrt(count)
    joint = predicted.draws[:, [0, 15], 1]  # without noise
    expected = rows[[0, 15], 1] @ covariance @ rows[[0, 15], 1].T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.cov(joint.T) / scale, expected / scale, atol=0.1)
    same = identified.predict(motion, draws=3, seed=5).draws
    np.testing.assert_array_equal(same, identified.predict(motion, draws=3, seed=5).draws)
    assert not np.array_equal(same, identified.predict(motion, draws=3, seed=6).draws)


def test_drawn_noise_has_the_colour_of_the_noise(model, theta, noise):
    """One step apart, 0.01 s of a memory of 0.1 s: exp(-0.1) of the coloured part's variance is left."""
    draws = IdentifiedModel(model, theta, noise, np.zeros((0, 0))).predict(motion_of(7), draws=60).draws
    off = draws - model.effort(motion_of(7), theta)
    after = (off[:, 1:] * off[:, :-1]).mean(axis=(0, 1)) / (off**2).mean(axis=(0, 1))
    expected = np.exp(-0.1) * noise.coloured**2 / (noise.coloured**2 + noise.white**2)
    np.testing.assert_allclose(after, expected, atol=0.04)


def test_the_posteriors_draws_make_mean_and_band(model, theta, noise):
    names = [parameter.name for parameter in model.parameters]
    k, rng = names.index("Fv2"), np.random.default_rng(3)
    drawn = np.tile(theta, (200, 1))
    drawn[:, k] += 0.3 * rng.standard_normal(200)
    sigma = np.abs(rng.normal(1.0, 0.2, (200, 3))) * noise.sigma
    identified = IdentifiedModel(model, theta, noise, np.zeros((0, 0)), ParameterDraws(drawn, sigma))
    predicted = identified.predict(motion_of(7), draws=40, noise=False)
    column = model.columns(motion_of(7))[:, :, k]
    np.testing.assert_allclose(predicted.sd, np.abs(column) * drawn[:, k].std(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(predicted.sd_of_noise, np.sqrt((sigma**2).mean(axis=0)))
    possible = model.columns(motion_of(7)[[100]]) @ drawn.T
    chosen = np.abs(predicted.draws[:, 100, 1][:, None] - possible[0, 1]).min(axis=1)
    assert chosen.max() < 1e-9
    assert len(np.unique(predicted.draws[:, 100, 1])) == 40
    assert predicted.holds == "parameters, by the posterior"


def test_what_the_log_has_not_shown_is_unknown(model, theta, noise, normal):
    """Joint 1 has its own friction: without a word about it, only its effort is unknown, and only while it moves."""
    identified, covariance = normal
    names = list(base_coefficients(model).names)
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


def test_where_nothing_is_known_the_noise_is_alone(model, theta, noise):
    nominal = IdentifiedModel(model, theta, noise, np.zeros((0, 0)))
    predicted = nominal.predict(motion_of(7))
    np.testing.assert_allclose(predicted.sd, np.broadcast_to(noise.sigma, predicted.sd.shape))
    assert predicted.holds == predicted.basis == "noise alone"
    with pytest.raises(InputError, match="noise=False: nothing is known"):
        nominal.predict(motion_of(7), noise=False)


def test_drawn_efforts_are_read_once_by_the_sensor(model, theta, noise, normal):
    """A sensor that takes 0.4 N m off: once, whatever is known of the parameters."""
    sensor = make_effect("dead_zone.shrinking", {"joints": (2,), "width": (0.4,)})
    motion = motion_of(7)
    quiet = replace(noise, white=1e-9 * noise.white, coloured=1e-9 * noise.coloured)
    certain = replace(normal[0], model=model.extend(sensor), noise=quiet, precision=1e18 * normal[0].precision)
    for one in (certain, replace(certain, precision=np.zeros((0, 0)))):
        predicted = one.predict(motion, draws=2)
        np.testing.assert_allclose(predicted.draws[1], predicted.mean, atol=1e-5)
        off = np.abs(model.effort(motion, theta)) - np.abs(predicted.mean)
        assert off[:, 1].max() == pytest.approx(0.4)


def test_the_band_holds_a_new_log(model, theta, result):
    """95 % of four logs' efforts, white noise of the size of the first log's: within the binomial error."""
    size = NOISE * np.sqrt(np.mean(model.effort(motion_of(0), theta) ** 2, axis=0))
    inside, count = np.zeros(3), 0
    for seed in range(11, 15):
        motion, rng = motion_of(seed), np.random.default_rng(seed)
        measured = model.effort(motion, theta) + size * rng.standard_normal(motion.q.shape)
        predicted = result.predict(motion)
        inside += ((measured >= predicted.lower) & (measured <= predicted.upper)).sum(axis=0)
        count += len(motion)
    assert np.all(np.abs(inside / count - 0.95) < 4.0 * np.sqrt(0.05 * 0.95 / count))


def test_the_truth_lies_within_the_band_of_the_mean(model, theta, result):
    motion = motion_of(21)
    predicted = result.predict(motion, noise=False)
    z = (predicted.mean - model.effort(motion, theta)) / predicted.sd
    assert 0.2 < np.sqrt(np.mean(z**2)) < 2.0
    assert np.all(predicted.sd < 0.5 * predicted.sd_of_noise)


# ---------------------------------------------------------------------------------------------------------------
# Motions in every form
# ---------------------------------------------------------------------------------------------------------------
def test_a_motion_comes_in_many_forms(model, result, log, tmp_path):
    """Noiseless positions: their derivatives are found again but for the filter, and for its ends."""
    motion = motion_of(7)
    expected = result.predict(motion)
    np.testing.assert_array_equal(result.predict((motion.t, motion.q, motion.dq, motion.ddq)).mean, expected.mean)
    header = ["t", "q1", "q2", "q3"]
    values = np.column_stack([motion.t, motion.q])
    np.savetxt(tmp_path / "motion.csv", values, delimiter=",", header=",".join(header), comments="", fmt="%.17g")
    degrees = DataFrame({"t": motion.t, "note": "x"} | {f"q{j + 1}[deg]": np.rad2deg(motion.q[:, j]) for j in range(3)})
    forms = {
        "positions": (motion.t, motion.q),
        "lists": [motion.t.tolist(), motion.q.tolist()],
        "velocities too": (motion.t, motion.q, motion.dq),
        "no accelerations": (motion.t, motion.q, motion.dq, None),
        "frame": DataFrame(dict(zip(header, values.T, strict=True))),
        "degrees": degrees,
        "file": tmp_path / "motion.csv",
        "text": str(tmp_path / "motion.csv"),
    }
    largest = np.abs(expected.mean).max(axis=0)
    for name, form in forms.items():
        predicted = result.predict(form)
        np.testing.assert_allclose(predicted.t, motion.t, atol=1e-12, err_msg=name)
        error = np.abs(predicted.mean - expected.mean)[30:-30] / largest
        assert np.quantile(error, 0.99) < 0.02, name


def test_a_log_and_its_file_are_motions(result, log, tmp_path):
    write_log(tmp_path / "log.csv", log)
    validated, predicted = result.validate(log), result.predict(log)
    np.testing.assert_allclose(predicted.mean, validated.predicted, atol=1e-8)
    np.testing.assert_allclose(predicted.upper, validated.upper, atol=1e-8)
    np.testing.assert_allclose(result.predict(tmp_path / "log.csv").mean, predicted.mean, atol=1e-8)
    assert validated.band == "parameters and noise, by the information matrix"
    assert len(result.predict(join_logs([log, log])).t) == 2 * len(log)


def test_every_row_has_its_effort(result):
    """Rows that repeat, and a pause: as many efforts as rows, and those of the repeated rows are the same."""
    motion = motion_of(7)
    rows = np.repeat(np.arange(len(motion)), 2)
    whole, twice = result.predict((motion.t, motion.q)), result.predict((motion.t[rows], motion.q[rows]))
    np.testing.assert_allclose(twice.mean, whole.mean[rows], atol=1e-9)


def test_a_joint_may_stand_still(model, theta, result):
    """A log of it would be refused; gravity and the others' motion load it all the same."""
    motion = motion_of(7)
    q = np.array(motion.q)
    q[:, 1] = 0.7
    still = np.zeros(len(motion))
    dq, ddq = (np.column_stack([part[:, 0], still, part[:, 2]]) for part in (motion.dq, motion.ddq))
    expected = result.predict((motion.t, q, dq, ddq)).mean
    error = np.abs(result.predict((motion.t, q)).mean - expected)[30:-30] / np.abs(expected).max(axis=0)
    assert np.quantile(error, 0.98) < 0.02


def test_one_pose_is_a_motion(model, theta, result):
    pose = ([0.0], [[0.3, -0.2, 0.9]], [[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
    predicted = result.predict(pose, draws=4)
    assert predicted.mean.shape == (1, 3)
    assert np.isfinite(predicted.draws).all()


T, Q = np.arange(60) / 100.0, np.sin(np.arange(180.0)).reshape(60, 3)
BAD = {
    "two joints": ((T, Q[:, :2]), "the motion has 2 joints, the model's robot arm3 has 3"),
    "shapes": ((T[1:], Q), r"t has shape \(59,\) beside q of \(60, 3\)"),
    "velocities": ((T, Q, Q[1:]), r"dq has shape \(59, 3\)"),
    "not finite": ((T, np.where(np.arange(60)[:, None] == 7, np.nan, Q)), "row 8: column q1 holds nan"),
    "time": ((T[::-1], Q), "time runs backwards"),
    "exact time": ((T[::-1], Q, Q, Q), "time runs backwards"),
    "exact shapes": ((T, Q, Q, Q[1:]), "ddq has shape"),
    "empty": (([], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))), "holds no instant"),
    "words": ((["a"], Q), "t holds something else than numbers"),
    "few": ((T[:20], Q[:20]), "holds 20 rows"),
    "number": (3.0, "float is no motion"),
    "one": ((T,), "1 arrays are no motion"),
    "frame": (DataFrame({"t": T, "q2": T}), "column q1 is missing"),
    "no file": ("absent.csv", "absent.csv: no such file"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_motion_is_refused(result, name):
    given, says = BAD[name]
    with pytest.raises(InputError, match=says) as caught:
        result.predict(given)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------------------------------------------------------
# Out of the door
# ---------------------------------------------------------------------------------------------------------------
def test_a_result_folder_predicts_the_same(result, tmp_path):
    save_identification(result, tmp_path / "result", report=False)
    here, there = (one.predict(motion_of(7)) for one in (result, load_model(tmp_path / "result")))
    np.testing.assert_allclose(there.mean, here.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(there.sd, here.sd, rtol=1e-6)
    assert there.basis == here.basis


def test_what_the_model_may_lack_is_kept_in_the_folder(result, tmp_path):
    size = len(result.coefficients)
    lacking = replace(result.identified, lacking=np.diag(np.arange(1.0, size + 1.0)))
    save_identification(replace(result, identified=lacking), tmp_path / "result", report=False)
    there = load_model(tmp_path / "result")
    np.testing.assert_array_equal(there.lacking, lacking.lacking)
    np.testing.assert_allclose(there.predict(motion_of(7)).sd, lacking.predict(motion_of(7)).sd, rtol=1e-6)


def test_a_completed_model_without_draws_keeps_what_it_may_lack(model, log):
    """Least squares of a model that may lack something: the band is that of the coefficients' covariance."""
    completed = identify(model.robot, log, TERMS, complete="only-uncertainty", posterior=False)
    motion = motion_of(7)
    rows = rows_of(model, motion)
    expected = np.sqrt(np.einsum("tjr,rs,tjs->tj", rows, completed.covariance, rows))
    np.testing.assert_allclose(completed.predict(motion, noise=False).sd, expected, rtol=1e-3)


def test_frames_and_datasets_hold_the_same(result):
    predicted = result.predict(motion_of(7), draws=5)
    frame, data = predicted.to_dataframe(), predicted.to_xarray()
    kinds = [f"{kind}{j}" for kind in ("tau", "sd", "lower", "upper") for j in (1, 2, 3)]
    assert list(frame.columns) == ["t", *kinds]
    np.testing.assert_array_equal(frame["upper3"], predicted.upper[:, 2])
    assert list(data.joint.values) == [1, 2, 3]
    assert data.draws.dims == ("draw", "time", "joint")
    assert data.attrs["band"] == predicted.holds
    assert data["mean"].attrs["units"] == "N m"
    np.testing.assert_array_equal(data.lower.sel(joint=2), predicted.lower[:, 1])


def test_a_file_of_a_prediction_is_read_back(result, tmp_path):
    predicted = result.predict(motion_of(7))
    bayesid_file = predicted.save(tmp_path / "new" / "prediction.csv")
    lines = bayesid_file.read_text().splitlines()
    assert lines[0] == "t," + ",".join(f"{k}{j}" for k in ("tau", "sd", "lower", "upper") for j in (1, 2, 3))
    values = np.loadtxt(bayesid_file, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(values[:, 0], predicted.t)
    np.testing.assert_allclose(values[:, 1:4], predicted.mean, rtol=1e-8)
    assert [path.name for path in bayesid_file.parent.iterdir()] == ["prediction.csv"]
    assert len(repr(predicted)) < 500
    assert "601" not in repr(predicted)
    assert "600 instants of 3 joints" in repr(predicted)
    assert bayesid.PredictedEfforts is type(predicted)
