import csv
import json
import shutil
import tomllib
from dataclasses import fields, replace
from functools import partial

import arviz as az
import numpy as np
import pinocchio as pin
import pytest
import tomli_w
from conftest import small_robot, smooth_motion
from oracles import urdf_text
from scipy import linalg, stats

import bayesid
from bayesid.errors import InputError
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.pipeline import identify, identify_again
from bayesid.log.log import join_logs, read_log
from bayesid.model.catalogue import make_effect, make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.distortions import CATALOGUE as DISTORTIONS
from bayesid.model.model import Model
from bayesid.model.robot import load_robot, robot_from_urdf
from bayesid.model.terms import CATALOGUE, STANDARD, ActuatorTerm, RigidBody
from bayesid.motion import Motion
from bayesid.posterior.sampler import Sampling
from bayesid.report.findings import as_json, read_findings, summarise
from bayesid.report.tables import coefficient_rows, inference_data, parameter_rows
from bayesid.results import folders as results
from bayesid.results.folders import check_result_folder, make_report, save_identification, save_validation
from bayesid.results.model_file import load_model, model_table
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

save = partial(save_identification, report=False)
"""Without the report, which takes seconds and has tests of its own."""
PROMISED = {
    "summary.json",
    "segments.csv",
    "signed_log.csv",
    "coefficients.csv",
    "parameters.csv",
    "model.toml",
    "robot.urdf",
    "robot.xml",
    "findings.npz",
}


def simulated(robot, signed=False, terms=STANDARD, seed=4, duration=6.0, start=0.0):
    t = np.arange(int(100 * duration) + 1) / 100.0
    motion = random_trajectory(robot.n_joints, duration, seed=seed).motion(t)
    model = Model(robot, make_terms(terms, robot, motion))
    rng = np.random.default_rng(seed)
    log = simulate(model, random_parameters(model, rng), motion, rng=rng, noise=0.03, signed=signed)
    return replace(log, t=t + start)


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="session")
def result():
    """Joint 2 keeps its sign; time counts from 1970."""
    robot = small_robot(3)
    return identify(robot, simulated(robot, signed=[False, True, False], start=1.7e9), posterior=False)


@pytest.fixture(scope="module")
def sampled(result):
    """The same log, its posterior sampled."""
    return identify(result.model.robot, result.log, posterior=Sampling(seed=3))


@pytest.fixture(scope="module")
def sampled_folder(sampled, tmp_path_factory):
    return save(sampled, tmp_path_factory.mktemp("sampled") / "result")


@pytest.fixture(scope="session")
def folder(result, tmp_path_factory):
    return save_identification(result, tmp_path_factory.mktemp("results") / "result")


@pytest.fixture(scope="session")
def validation(result):
    return result.validate(simulated(result.model.robot, seed=11))


# ---------------------------------------------------------------------------------------------------------------
# What the files hold
# ---------------------------------------------------------------------------------------------------------------
def test_a_result_folder_holds_what_is_promised(folder):
    assert {path.name for path in folder.iterdir()} == PROMISED | {"report.html"}
    assert [path for path in folder.parent.iterdir() if path != folder] == []
    assert folder.stat().st_mode & 0o777 == 0o755


def strict(text):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_the_summary_has_the_promised_keys(result, folder):
    content = strict((folder / "summary.json").read_text())
    assert {"n_samples", "n_segments", "n_coefficients", "search", "posterior"} <= set(content)
    assert {"noise", "timings", "warnings"} <= set(content)
    assert {"method", "cost", "certified", "lower_bound", "seconds", "sdp_solves"} <= set(content["search"])
    assert content["n_samples"] == len(result.log) == 601
    assert content["n_segments"] == len(table(folder / "segments.csv"))
    assert content["n_coefficients"] == len(table(folder / "coefficients.csv"))
    assert content["signed_joints"] == [2]
    assert content["search"]["method"] == "certified"
    assert content["search"]["certified"] is True
    assert content["search"]["lower_bound"] == pytest.approx(content["search"]["cost"], rel=1e-4)
    assert content["search"]["gap"] == content["search"]["cost"] - content["search"]["lower_bound"]
    assert content["search"]["assignments"] >= 1
    assert 0.0 < content["search"]["missed_mass"] <= 1e-3
    assert 0.9 < content["search"]["settled_share"] <= 1.0
    assert content["search"]["cost"] > 0.0
    assert content["search"]["sdp_solves"] > 0
    assert content["noise"]["sd"] == result.fit.noise.sigma.tolist()
    assert all(seconds >= 0.0 for seconds in content["timings"].values())
    assert content["warnings"] == list(result.warnings)
    assert content["posterior"] is None
    assert content["signs"] == {"model": list(STANDARD), "weight": 1.0, "doubt": [0.0, 0.0, 0.0]}
    assert content["noise"]["residual_sd"] == result.fit.residual.sigma.tolist()
    speed = np.abs(result.signals.motion.dq)
    moving = (speed > 0.01 * speed.max(axis=0)).sum(axis=0)
    np.testing.assert_allclose(
        content["noise"]["effective_samples"], moving / content["noise"]["samples_that_count_as_one"], rtol=0.02
    )


def test_a_summary_without_finite_numbers_is_json_too(result, tmp_path):
    fit = replace(result.fit, condition=np.inf, relative_residual=np.array([np.nan, 1.0, -np.inf]))
    content = strict((save(replace(result, fit=fit), tmp_path / "r") / "summary.json").read_text())
    assert content["fit"]["condition_number"] is None
    assert content["fit"]["relative_residual"] == [None, 1.0, None]


def test_segments_cover_the_log(result, folder):
    rows = table(folder / "segments.csv")
    assert list(rows[0]) == ["joint", "start", "end", "n_samples", "sign", "confidence"]
    period = 1.0 / result.signals.rate
    for joint in ("1", "2", "3"):
        mine = [row for row in rows if row["joint"] == joint]
        starts, ends = (np.array([float(row[key]) for row in mine]) for key in ("start", "end"))
        counts = np.array([int(row["n_samples"]) for row in mine])
        assert starts[0] == result.log.t[0]
        assert ends[-1] == pytest.approx(result.log.t[-1], abs=period)
        np.testing.assert_allclose(starts[1:] - ends[:-1], period, atol=1e-3 * period)
        np.testing.assert_allclose(ends - starts, (counts - 1) * period, atol=1e-3 * period)
        assert counts.sum() == len(result.signals.motion)
    assert {row["sign"] for row in rows} == {"-1", "1"}
    assert all(0.5 <= float(row["confidence"]) <= 1.0 for row in rows)


def test_segments_agree_with_the_signed_log(result, folder):
    """A segment of high confidence has its sign in nearly every row."""
    signed = table(folder / "signed_log.csv")
    t = np.array([float(row["t"]) for row in signed])
    for row in table(folder / "segments.csv"):
        if float(row["confidence"]) > 0.999 and int(row["n_samples"]) > 10 and row["joint"] != "2":
            inside = np.flatnonzero((t >= float(row["start"])) & (t <= float(row["end"])))
            signs = [float(signed[i][f"tau{row['joint']}"]) * int(row["sign"]) > 0.0 for i in inside]
            assert np.mean(signs) > 0.9


def test_the_signed_log_has_the_rows_of_the_log(result, folder):
    rows = table(folder / "signed_log.csv")
    assert list(rows[0]) == ["t", "tau1", "tau2", "tau3", "p1", "p2", "p3"]
    values = np.array([[float(value) for value in row.values()] for row in rows])
    t, tau, p = values[:, 0], values[:, 1:4], values[:, 4:]
    np.testing.assert_array_equal(t, result.log.t)
    np.testing.assert_array_equal(np.abs(tau), np.abs(result.log.effort))
    np.testing.assert_array_equal(tau[:, 1], result.log.effort[:, 1])
    assert p.min() >= 0.0
    assert p.max() <= 1.0
    np.testing.assert_array_equal(np.sign(tau), np.where(p >= 0.5, 1.0, -1.0) * (tau != 0.0))
    np.testing.assert_array_equal(p[:, 1], result.log.effort[:, 1] >= 0.0)
    np.testing.assert_allclose(p, result.probability, atol=1e-6)  # the log is even: its rows are the grid's


def test_each_row_of_a_jittered_log_has_the_nearest_probability(result, tmp_path):
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(601, 400, replace=False))
    t = result.log.t[rows] + rng.uniform(-0.004, 0.004, 400)
    effort = result.log.effort[rows] * np.array([1.0, -1.0, 1.0])  # a signed joint's sign is the log's, nobody else's
    some = replace(result.log, t=t, q=result.log.q[rows], effort=effort)
    written = table(save(replace(result, log=some), tmp_path / "r") / "signed_log.csv")
    p = np.array([[float(row[f"p{j}"]) for j in (1, 3)] for row in written])
    np.testing.assert_allclose(p, result.probability[rows][:, [0, 2]], atol=1e-6)
    assert [(float(row["tau2"]), float(row["p2"])) for row in written] == [(e, float(e >= 0.0)) for e in effort[:, 1]]


def test_the_signed_log_can_be_read_as_a_log(result, folder, tmp_path):
    """Add q, and it is a log of signed efforts."""
    signed, log = (folder / "signed_log.csv").read_text().splitlines(), result.log
    q = [",".join(["q1", "q2", "q3"]), *(",".join(map(repr, row)) for row in log.q.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(signed, q, strict=True)))
    again = read_log(tmp_path / "log.csv")
    assert again.signed.all()
    np.testing.assert_array_equal(np.abs(again.effort), np.abs(log.effort))


# ---------------------------------------------------------------------------------------------------------------
# Several logs as one
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def recordings():
    """Signed logs of one robot: three clocks, three lengths, and the second begins between two samples of the grid."""
    robot, logs = small_robot(3), []
    told = ((4, 5.0, 1.7e9, "a.csv"), (5, 3.0, -7.003, "b, two.csv"), (6, 4.0, 0.0, "c.csv"))
    for seed, duration, start, name in told:
        t = np.arange(int(100 * duration) + 1) / 100.0
        motion = random_trajectory(3, duration, seed=seed).motion(t)
        model = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
        theta, rng = random_parameters(model, np.random.default_rng(0)), np.random.default_rng(seed)
        log = simulate(model, theta, motion, rng=rng, noise=0.02, signed=True)
        logs.append(replace(log, t=t * 1.003 + start, source=name))
    return logs


@pytest.fixture(scope="module")
def pooled(recordings):
    """All of them as one, the sign of joint 2 known."""
    joined = join_logs(recordings)
    signed = np.array([False, True, False])
    log = replace(joined, effort=np.where(signed, joined.effort, np.abs(joined.effort)), signed=signed)
    return identify(small_robot(3), log, ["rigid_body", "viscous_friction"], posterior=False)


@pytest.fixture(scope="module")
def pooled_folder(pooled, tmp_path_factory):
    return save(pooled, tmp_path_factory.mktemp("pooled") / "result")


def test_segments_of_several_logs_are_told_on_their_own_clocks(recordings, pooled, pooled_folder):
    """Of each log and joint they follow one another from its first to its last instant, none in between."""
    rows = table(pooled_folder / "segments.csv")
    assert list(rows[0]) == ["joint", "start", "end", "n_samples", "sign", "confidence", "log"]
    assert [(row["joint"], row["log"]) for row in rows] == sorted((row["joint"], row["log"]) for row in rows)
    period = 1.0 / pooled.signals.rate
    for log in recordings:
        for joint in "123":
            mine = [row for row in rows if row["joint"] == joint and row["log"] == log.source]
            starts, ends = (np.array([float(row[key]) for row in mine]) for key in ("start", "end"))
            counts = np.array([int(row["n_samples"]) for row in mine])
            clock = 0.01 * period + 1e-6  # s, to which a sample belongs to a row, and seconds since 1970 are told
            assert log.t[0] - clock <= starts[0] < log.t[0] + period
            assert log.t[-1] + clock >= ends[-1] > log.t[-1] - period
            np.testing.assert_allclose(starts[1:] - ends[:-1], period, atol=clock)
            np.testing.assert_allclose(ends - starts, (counts - 1) * period, atol=clock)
            assert abs(counts.sum() - len(log)) <= 1
    told = sum(int(row["n_samples"]) for row in rows) / 3
    assert len(pooled.signals.motion) - told == pytest.approx(2 * 3.0 / period, abs=5), "two pauses of 3 s are left out"


def test_signs_of_several_logs_are_those_of_each(recordings, pooled_folder):
    """Looked up in the logs themselves, by their own time."""
    rows, signed = table(pooled_folder / "segments.csv"), table(pooled_folder / "signed_log.csv")
    for log in recordings:
        mine = [row for row in signed if row["log"] == log.source]
        for j in range(3):
            truth = log.effort[:, j]
            strong = np.abs(truth) > 0.05 * np.abs(truth).max()
            found = np.array([float(row[f"tau{j + 1}"]) for row in mine])
            np.testing.assert_array_equal(np.abs(found), np.abs(truth))
            assert np.mean(np.sign(found) == np.sign(truth), where=strong) > 0.99
            of_segments = np.zeros(len(log))
            for row in rows:
                if (row["joint"], row["log"]) == (str(j + 1), log.source):
                    inside = (log.t > float(row["start"]) - 0.005) & (log.t < float(row["end"]) + 0.005)
                    of_segments[inside] = row["sign"]
            assert np.mean(of_segments == np.sign(truth), where=strong) > 0.98


def test_the_signed_log_of_several_logs_has_their_rows_and_times(recordings, pooled_folder):
    rows = table(pooled_folder / "signed_log.csv")
    assert list(rows[0]) == ["t", "tau1", "tau2", "tau3", "p1", "p2", "p3", "log"]
    assert [row["log"] for row in rows] == [log.source for log in recordings for _ in log.t]
    np.testing.assert_array_equal([float(row["t"]) for row in rows], np.concatenate([log.t for log in recordings]))


def test_a_segment_that_spans_a_pause_is_cut_there(pooled):
    """Signs and confidences of all others stay what they were; those of its parts follow from the parts' samples."""
    segments, signs, confidence = pooled.recorded_segments
    before = zip(pooled.segments.joint, pooled.segments.start, pooled.segments.end, strict=True)
    known = dict(zip(before, zip(pooled.signs, pooled.confidence, strict=True), strict=True))
    where = list(zip(segments.joint, segments.start, segments.end, strict=True))
    same = [k for k, one in enumerate(where) if one in known]
    assert [(signs[k], confidence[k]) for k in same] == [known[where[k]] for k in same]
    cut = [k for k in range(len(where)) if k not in same]
    assert 6 <= len(cut) <= 12, "two pauses, three joints, and what ends or begins exactly there"
    for k in cut:
        j, a, b = where[k]
        energy = pooled.signals.raw_effort[a:b, j] ** 2
        plus = (energy * pooled.probability[a:b, j]).sum() / energy.sum()
        assert signs[k] == (1 if plus >= 0.5 else -1)
        assert confidence[k] == pytest.approx(max(plus, 1.0 - plus))


def test_the_summary_of_several_logs_names_them(recordings, pooled, pooled_folder):
    content = strict((pooled_folder / "summary.json").read_text())
    assert content["log"] == "a.csv + b, two.csv + c.csv"
    assert content["logs"] == [{"source": log.source, "n_samples": len(log)} for log in recordings]
    assert content["n_samples"] == sum(map(len, recordings))
    assert content["n_segments"] == len(table(pooled_folder / "segments.csv"))
    nothing = replace(pooled, search=replace(pooled.search, settled=np.zeros(len(pooled.searched), dtype=bool)))
    ambiguous = summarise(nothing).search.ambiguous
    assert len(ambiguous) == len(pooled.searched)
    spans = {log.source: (log.t[0] - 1e-6, log.t[-1] + 1e-6) for log in recordings}
    for row in ambiguous:
        assert spans[row.log][0] <= row.start <= row.end <= spans[row.log][1]
    assert {row.log for row in ambiguous} == set(spans)


def test_one_log_is_not_called_several(result, folder):
    content = strict((folder / "summary.json").read_text())
    assert "logs" not in content
    assert all("log" not in row for row in content["search"]["ambiguous"])
    segments, signs, confidence = result.recorded_segments
    assert segments is result.segments
    assert (signs is result.signs, confidence is result.confidence) == (True, True)


def test_a_validation_on_several_logs(recordings, pooled, tmp_path):
    validation = pooled.validate(join_logs(recordings))
    place = save_validation(validation, tmp_path / "v")
    rows = table(place / "prediction.csv")
    assert list(rows[0])[-1] == "log"
    for log in recordings:
        mine = [row for row in rows if row["log"] == log.source]
        t, tau, predicted = (np.array([float(row[key]) for row in mine]) for key in ("t", "tau1", "predicted1"))
        assert abs(len(mine) - len(log)) <= 1
        effort = np.interp(t, log.t, log.effort[:, 0])
        assert np.corrcoef(predicted, effort)[0, 1] > 0.99
        assert np.corrcoef(tau, effort)[0, 1] > 0.99
    assert [row["log"] for row in table(place / "signed_log.csv")] == [log.source for log in recordings for _ in log.t]
    names = [(one["source"], one["n_samples"]) for one in strict((place / "summary.json").read_text())["logs"]]
    assert names == [(log.source, len(log)) for log in recordings]


# ---------------------------------------------------------------------------------------------------------------
# Coefficients and parameters
# ---------------------------------------------------------------------------------------------------------------
def test_the_coefficients_are_those_of_the_fit(result, folder):
    rows = table(folder / "coefficients.csv")
    assert list(rows[0])[:7] == ["name", "expression", "mean", "sd", "rsd_percent", "q2.5", "q97.5"]
    assert [row["name"] for row in rows] == list(result.coefficients.names)
    assert [row["expression"] for row in rows] == list(result.coefficients.expressions)
    for row, mean, sd in zip(rows, result.fit.beta, result.fit.sd, strict=True):
        numbers = [float(row[key]) for key in ("mean", "sd", "rsd_percent", "q2.5", "q97.5")]
        expected = [mean, sd, 100.0 * sd / abs(mean), stats.norm.ppf(0.025, mean, sd), stats.norm.ppf(0.975, mean, sd)]
        np.testing.assert_allclose(numbers, expected, rtol=1e-7)


def test_a_coefficient_of_zero_has_no_relative_deviation(result):
    nothing = replace(result.identified, theta=np.zeros_like(result.theta))
    rows = coefficient_rows(replace(result, identified=nothing))
    assert all(row["rsd_percent"] == np.inf for row in rows)


# ---------------------------------------------------------------------------------------------------------------
# Data or prior
# ---------------------------------------------------------------------------------------------------------------
def test_only_what_the_efforts_show_is_decided_by_the_data(result, folder):
    """Parameters that can change without a trace in the efforts of a random motion are decided by the prior."""
    rng = np.random.default_rng(3)
    q, dq, ddq = rng.uniform(-3.0, 3.0, (3, 200, 3))
    columns = result.model.columns(Motion(np.arange(200.0), q, dq, ddq)).reshape(600, -1)
    size = np.linalg.norm(columns, axis=0).max()
    silent = linalg.null_space(columns, rcond=1e-10)
    assert silent.shape[1] == columns.shape[1] - len(result.coefficients)
    may_change = np.abs(silent).max(axis=1) > 1e-7
    rows = table(folder / "parameters.csv")
    assert [row["name"] for row in rows] == [parameter.name for parameter in result.model.parameters]
    assert [row["decided_by"] for row in rows] == ["prior" if free else "data" for free in may_change]
    for _ in range(5):
        step = silent @ rng.standard_normal(silent.shape[1])
        assert np.abs(columns @ step).max() < 1e-9 * size
        moved = np.abs(step) > 1e-7
        assert all(row["decided_by"] == "prior" for row, changed in zip(rows, moved, strict=True) if changed)


def test_parameters_have_a_deviation_where_the_data_decide_them(result, folder):
    rows = table(folder / "parameters.csv")
    assert {row["decided_by"] for row in rows} == {"data", "prior"}
    for row, value in zip(rows, result.fit.theta, strict=True):
        assert float(row["mean"]) == pytest.approx(value, rel=1e-8)
        if row["decided_by"] == "data":
            assert float(row["sd"]) > 0.0
        else:
            assert row["sd"] == ""
    alone = {row["name"]: row for row in table(folder / "coefficients.csv") if row["name"] == row["expression"]}
    both = [row for row in rows if row["name"] in alone]
    assert {"Fv1", "Fc2", "offset3"} <= set(alone)
    for row in both:
        assert row["decided_by"] == "data"
        assert float(row["sd"]) == pytest.approx(float(alone[row["name"]]["sd"]), rel=1e-6)
        assert float(row["mean"]) == pytest.approx(float(alone[row["name"]]["mean"]), rel=1e-5, abs=1e-9)


def test_what_the_log_does_not_excite_is_left_to_the_prior(result):
    blind = result.coefficients.names.index("Fc2")
    covariance = result.fit.covariance.copy()
    covariance[blind] = covariance[:, blind] = 0.0
    covariance[blind, blind] = np.inf
    rows = {row["name"]: row for row in parameter_rows(replace(result, fit=replace(result.fit, covariance=covariance)))}
    assert rows["Fc2"]["decided_by"] == "prior"
    assert rows["Fc2"]["sd"] == ""
    before = {row["name"]: row for row in parameter_rows(result)}
    assert {name for name in rows if rows[name] != before[name]} == {"Fc2"}


# ---------------------------------------------------------------------------------------------------------------
# With a posterior
# ---------------------------------------------------------------------------------------------------------------
def draws_in(folder):
    """(K, P), (K, r) and (K, n) as ArviZ reads them, and the file's attributes."""
    data = az.from_netcdf(folder / "posterior.nc")
    theta, beta, noise = (data.posterior[name].values for name in ("theta", "beta", "noise"))
    return *(values.reshape(-1, values.shape[-1]) for values in (theta, beta, noise)), data


def test_a_sampled_result_has_its_draws_beside_it(sampled_folder):
    assert {path.name for path in sampled_folder.iterdir()} == PROMISED | {"posterior.nc"}


def test_coefficients_are_those_of_the_draws(sampled, sampled_folder):
    """Of those in the file, of which some may have been left out: within a tenth of an sd, quantiles a fifth."""
    _, beta, _, data = draws_in(sampled_folder)
    rows = table(sampled_folder / "coefficients.csv")
    assert data.posterior.coefficient.values.tolist() == [row["name"] for row in rows]
    found = {key: np.array([float(row[key]) for row in rows]) for key in ("mean", "sd", "rsd_percent", "q2.5", "q97.5")}
    of_log, every = (
        draws.beta.reshape(-1, len(rows)) for draws in (sampled.posterior.draws, sampled.posterior.uncertain)
    )
    np.testing.assert_allclose(found["mean"], of_log.mean(axis=0), rtol=1e-6, atol=1e-9)
    about = np.sqrt(np.mean((every - of_log.mean(axis=0)) ** 2, axis=0))
    np.testing.assert_allclose(found["sd"], about, rtol=1e-3)
    np.testing.assert_allclose(found["rsd_percent"], 100.0 * found["sd"] / np.abs(found["mean"]), rtol=1e-6)
    free = np.array([not row["name"].startswith(("Fv", "Fc", "Ia")) for row in rows])  # else it is the shortest one
    for key, share in (("q2.5", 0.025), ("q97.5", 0.975)):
        np.testing.assert_allclose(found[key][free], np.quantile(every, share, axis=0)[free], rtol=1e-7, atol=1e-12)
        assert np.abs(found[key] - np.quantile(beta, share, axis=0))[free].max() < 0.2 * found["sd"].max()
    held = np.mean((every >= found["q2.5"]) & (every <= found["q97.5"]), axis=0)
    np.testing.assert_allclose(held, 0.95, atol=2e-3)
    assert np.abs((beta.mean(axis=0) - every.mean(axis=0)) / found["sd"]).max() < 0.1
    assert np.abs((every.mean(axis=0) - found["mean"]) / found["sd"]).max() < 0.25, "the cone holds some moves back"
    assert np.all((found["q2.5"] < found["mean"]) & (found["mean"] < found["q97.5"]))


def test_the_model_of_a_sampled_result_is_the_mean_and_feasible(sampled, sampled_folder):
    theta, _, noise, _ = draws_in(sampled_folder)
    loaded = load_model(sampled_folder)
    mean = sampled.posterior.draws.theta.reshape(-1, theta.shape[1]).mean(axis=0)
    np.testing.assert_allclose(loaded.theta, mean, rtol=1e-9, atol=1e-12)
    assert np.abs((theta.mean(axis=0) - mean) / theta.std(axis=0)).max() < 0.3, "links' own parameters mix slowly"
    assert loaded.model.cone.contains(loaded.theta)
    assert loaded.model.cone.smallest_eigenvalues(loaded.theta).min() > 0.0
    np.testing.assert_array_equal(loaded.draws.theta, theta)
    np.testing.assert_array_equal(loaded.draws.sigma, noise)
    rows = table(sampled_folder / "parameters.csv")
    np.testing.assert_allclose([float(row["mean"]) for row in rows], loaded.theta, rtol=1e-8, atol=1e-12)
    off = sampled.posterior.uncertain.theta.reshape(-1, theta.shape[1]) - mean
    np.testing.assert_allclose([float(row["sd"]) for row in rows], np.sqrt(np.mean(off**2, axis=0)), rtol=1e-8)


def test_what_decides_a_parameter_of_a_sampled_result(sampled, sampled_folder):
    """At most a tenth of the prior's variance left, in the normal distribution of prior and least squares."""
    rows = table(sampled_folder / "parameters.csv")
    prior = json.loads((sampled_folder / "summary.json").read_text())["posterior"]["prior_sd"]
    assert list(prior) == [row["name"] for row in rows]
    sd, projection = np.array(list(prior.values())), sampled.coefficients.projection
    precision = projection.T @ np.linalg.solve(sampled.fit.covariance, projection) + np.diag(sd**-2.0)
    left = np.diag(np.linalg.inv(precision)) / sd**2
    clear = (left < 0.05) | (left > 0.2)
    assert clear.mean() > 0.7
    for row, share in zip(rows, left, strict=True):
        if not 0.05 < share < 0.2:
            assert row["decided_by"] == ("data" if share < 0.1 else "prior"), row["name"]
    assert {row["decided_by"] for row in rows} == {"data", "prior"}
    decided = {row["name"]: row["decided_by"] for row in rows}
    assert decided["Fv1"] == decided["offset3"] == "data"
    assert decided["m1"] == "prior"


def test_the_summary_of_a_sampled_result(sampled, sampled_folder):
    content = strict((sampled_folder / "summary.json").read_text())
    told, draws = content["posterior"], sampled.posterior.draws
    assert set(told) == {
        "converged",
        "max_rhat",
        "min_ess",
        "max_rhat_of_parameters",
        "draws",
        "ensembles",
        "walkers",
        "seed",
        "seconds",
        "prior",
        "prior_sd",
        "noise_scale",
        "mode",
        "assignments",
        "assignments_elsewhere",
        "excluded",
        "pressed_windows",
    }
    search = content["search"]
    assert search["cost_parts"]["data"] + search["cost_parts"]["pull"] == pytest.approx(search["cost"])
    assert 0.0 < search["cost_parts"]["pull"] < 1.0
    assert len(search["noise_weights"]) == 3
    assert told["converged"] is True
    assert 0.99 < told["max_rhat"] <= 1.01
    assert told["min_ess"] >= 400.0
    assert told["draws"] == draws.theta[..., 0].size == draws.sweeps * told["ensembles"] * told["walkers"]
    assert told["seed"] == 3
    np.testing.assert_allclose(told["noise_scale"], np.exp(draws.log_scale).reshape(-1, 3).mean(axis=0))
    assert sum(mode["weight"] for mode in content["modes"]) == pytest.approx(1.0)
    assert len(told["assignments"]) == content["search"]["assignments"]
    assert sum(told["assignments"]) + told["assignments_elsewhere"] == pytest.approx(1.0)
    assert content["signs"] == {"model": list(STANDARD), "weight": 1.0, "doubt": sampled.sign_doubt.tolist()}
    assert content["fit"]["standard_deviations"] == "of the posterior"
    assert {"posterior", "smooth"} <= set(content["timings"])


def test_the_file_of_draws_says_where_it_comes_from(sampled, sampled_folder):
    _, _, noise, data = draws_in(sampled_folder)
    assert (data.attrs["robot"], data.attrs["converged"], data.attrs["seed"]) == ("arm3", 1, 3)
    assert json.loads(data.attrs["terms"]) == list(STANDARD)
    assert data.attrs["bayesid_version"] == bayesid.__version__
    assert {"numpy_version", "emcee_version", "arviz_version"} <= set(data.attrs)
    assert data.posterior.joint.values.tolist() == ["A1", "A2", "A3"]
    assert data.posterior.sizes["chain"] * data.posterior.sizes["draw"] <= 4096
    np.testing.assert_allclose(data.constant_data.sigma_ref, sampled.posterior.noise.sigma)
    np.testing.assert_allclose(noise.mean(axis=0), sampled.fit.noise.sigma, rtol=0.2)
    start = data.observed_data.start.values
    assert start.min() >= 1.7e9
    assert data.observed_data.end.values.max() <= sampled.log.t[-1]


def test_without_draws_there_is_nothing_to_keep(result):
    with pytest.raises(ValueError, match="no posterior"):
        inference_data(result)


@pytest.mark.parametrize("damage", ["cut", "text", "empty", "other"])
def test_damaged_draws_are_bad_input(sampled_folder, tmp_path, damage):
    """One line that names the file, not a model without its draws."""
    place = shutil.copytree(sampled_folder, tmp_path / "r")
    path, whole = place / "posterior.nc", (sampled_folder / "posterior.nc").read_bytes()
    if damage == "other":
        content = tomllib.loads((place / "model.toml").read_text())
        content["terms"] = [term for term in content["terms"] if term["name"] != "torque_offset"]
        del content["knowledge"]
        (place / "model.toml").write_text(tomli_w.dumps(content))
    else:
        path.write_bytes({"cut": whole[: len(whole) // 2], "text": b"draws", "empty": b""}[damage])
    with pytest.raises(InputError) as refusal:
        load_model(place)
    assert refusal.value.where == str(path)
    assert "\n" not in str(refusal.value)
    path.unlink()
    assert load_model(place).draws is None


def test_an_earlier_sampled_result_leaves_no_draws_behind(result, sampled_folder, tmp_path):
    """Its posterior.nc beside another model would be read as that model's."""
    place = shutil.copytree(sampled_folder, tmp_path / "r")
    save(result, place)
    assert {path.name for path in place.iterdir()} == PROMISED


# ---------------------------------------------------------------------------------------------------------------
# Models that come back
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="session", params=["dh", "tx40", "urdf"])
def stored(request, result, tmp_path_factory):
    """An identification, its folder and what is read from it; signed logs are identified in no time."""
    if request.param != "dh":
        robot = load_robot("tx40") if request.param == "tx40" else robot_from_urdf(urdf_text(), "test")
        result = identify(robot, simulated(robot, signed=True), posterior=False)
    folder = save(result, tmp_path_factory.mktemp("stored") / request.param)
    return result, folder, load_model(folder)


def test_a_model_comes_back_the_same(stored):
    result, _, loaded = stored
    assert loaded.model.robot.same_kinematics(result.model.robot)
    assert loaded.draws is None
    np.testing.assert_array_equal(loaded.model.robot.coupling, result.model.robot.coupling)
    assert loaded.model.robot.name == result.model.robot.name
    assert loaded.model.terms == result.model.terms
    assert loaded.model.parameters == result.model.parameters
    np.testing.assert_allclose(loaded.theta, result.fit.theta, rtol=1e-12, atol=0.0)
    for key, values in vars(result.fit.noise).items():
        np.testing.assert_allclose(getattr(loaded.noise, key), values, rtol=1e-12)
    predicted = loaded.model.effort(result.signals.motion[:50], loaded.theta)
    np.testing.assert_allclose(predicted, result.fit.predicted[:50], rtol=1e-9, atol=1e-9)


def test_the_urdf_has_the_torques_of_the_rigid_bodies(stored):
    result, folder, _ = stored
    robot, n = replace(result.model.robot, transmission=None), result.model.robot.n_joints
    loaded = pin.buildModelFromUrdf(str(folder / "robot.urdf"))
    loaded.gravity.linear = robot.gravity
    data, motion = loaded.createData(), result.signals.motion[::20]
    found = [pin.rnea(loaded, data, *sample) for sample in zip(motion.q, motion.dq, motion.ddq, strict=True)]
    expected = robot.inverse_dynamics(motion, result.fit.theta[: 10 * n])
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def edited(folder, tmp_path, change):
    content = tomllib.loads((folder / "model.toml").read_text())
    change(content)
    (tmp_path / "model.toml").write_text(tomli_w.dumps(content))
    return tmp_path


def put(*path):
    *keys, value = path

    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(lambda content, key=key: content.pop(key) for key in ("robot", "terms", "values", "noise")),
        lambda content: content["values"].pop("m1"),
        lambda content: content["noise"].pop("white"),
        lambda content: content["terms"].append(content["terms"][1]),
        lambda content: content["robot"].pop("joints"),
        lambda content: content["robot"]["joints"][0].pop("axis"),
        put("robot", 1),
        put("terms", 1),
        put("terms", [1]),
        put("terms", []),
        put("values", 1),
        put("noise", 1),
        put("values", "m1", "x"),
        put("values", "m1", float("nan")),
        put("values", "m1", float("inf")),
        put("values", "m1", [1.0]),
        put("terms", 0, {"name": "magic"}),
        put("terms", 0, {"shape": {}}),
        put("terms", 0, "shape", {"x": [1.0]}),
        put("terms", 2, "shape", {}),
        put("terms", 2, "shape", {"smoothing": [1.0]}),
        put("terms", 2, "shape", {"smoothing": [0.0, 0.0, 0.0]}),
        put("terms", 2, "shape", {"smoothing": 1.0}),
        put("terms", 2, "shape", {"smoothing": ["a", "b", "c"]}),
        put("terms", 2, "shape", 3),
        put("noise", "white", [1.0]),
        put("noise", "white", [float("nan")] * 3),
        put("noise", "white", [-1.0] * 3),
        put("noise", "white", ["a"] * 3),
        put("noise", "other", [1.0] * 3),
        put("robot", "joints", 3),
        put("robot", "joints", [3]),
        put("robot", "joints", 0, "parent", 9),
        put("robot", "joints", 0, "parent", "x"),
        put("robot", "joints", 0, "placement", [1.0]),
        put("robot", "lengths", 3),
        put("robot", "gravity", "down"),
        put("robot", "convention", "own"),
    ],
)
def test_a_broken_model_file_is_bad_input(folder, tmp_path, change):
    with pytest.raises(InputError) as refusal:
        load_model(edited(folder, tmp_path, change))
    assert str(tmp_path / "model.toml") in refusal.value.where
    assert "\n" not in str(refusal.value)


# ---------------------------------------------------------------------------------------------------------------
# Extended models that come back
# ---------------------------------------------------------------------------------------------------------------
NUMBERS = {
    "smoothing": 0.03,
    "speed": 0.1,
    "harmonic": 23.7,
    "width": 0.07,
    "time": 1.9,
    "start": -0.3,
    "side": -1.0,
    "gain": 1.1,
    "lag": 0.013,
    "angle": 0.07,
    "limit": 31.7,
}


def made(name, joints, n=3):
    """An effect of a catalogue, on some of the joints."""
    kind = {**CATALOGUE, **DISTORTIONS}[name]
    needed = {one.name for one in fields(kind)} - {"joints", "links"}
    count = {key: kind.counts.get(key, len(joints)) for key in needed}
    shape = {key: [NUMBERS.get(key, 0.37) * (1.0 + i / 7.0) for i in range(count[key])] for key in needed}
    shape |= {key: ["tool1"] for key in kind.words}
    shape |= {"links": np.linspace(-1.0, 2.0, 10 * n).tolist()} if name == "load_dependent_friction" else {}
    if (issubclass(kind, ActuatorTerm) or name in DISTORTIONS) and name != "base_tilt":
        shape["joints"] = joints
    return make_effect(name, shape)


def of_everything(rng, terms=(), distortions=()):
    """A stored model with numbers that no decimals can write."""
    model = Model(small_robot(3), (RigidBody(), *terms), distortions)
    size = len(base_coefficients(model))
    root = rng.standard_normal((size, size - 2)) * np.geomspace(1e-3, 1e3, size)[:, None]
    noise = Noise(*rng.uniform(0.1, 1.0, (len(fields(Noise)), 3)))
    return IdentifiedModel(model, rng.standard_normal(len(model.parameters)), noise, root @ root.T)


def there_and_back(stored, folder):
    (folder / "model.toml").write_text(tomli_w.dumps(model_table(stored)))
    return load_model(folder)


def assert_same(found, stored):
    assert found.model.terms == stored.model.terms
    assert found.model.distortions == stored.model.distortions
    assert found.model.parameters == stored.model.parameters
    for one, other in (
        (found.theta, stored.theta),
        (found.precision, stored.precision),
        *zip(vars(found.noise).values(), vars(stored.noise).values(), strict=True),
    ):
        np.testing.assert_array_equal(one, other)
    motion = smooth_motion(3, 1.0, 50.0)
    effort = stored.model.effort(motion, stored.theta)
    np.testing.assert_allclose(found.model.effort(motion, found.theta), effort, rtol=1e-12, atol=1e-12)


NOT_MADE_HERE = ("rigid_body", "learned_effect")  # the latter comes back in tests/discrepancy/test_unnamed.py


@pytest.mark.parametrize("name", [name for name in (*CATALOGUE, *DISTORTIONS) if name not in NOT_MADE_HERE])
def test_every_effect_of_the_catalogues_comes_back(name, tmp_path, rng):
    effects = [made(name, joints) for joints in ((2,), (3, 1))] if made(name, (2,)).joints else [made(name, ())]
    terms, distortions = ((), effects) if name in DISTORTIONS else (effects, ())
    stored = of_everything(rng, terms, tuple(distortions))
    assert_same(there_and_back(stored, tmp_path), stored)


def test_a_model_of_every_effect_comes_back(tmp_path, rng):
    """Terms of one name in different joints, all distortions one after the other."""
    names = [name for name in CATALOGUE if name not in NOT_MADE_HERE]
    terms = dict.fromkeys(made(name, joints) for joints in ((2,), (3, 1)) for name in names)
    stored = of_everything(rng, terms, tuple(made(name, (1, 3)) for name in reversed(DISTORTIONS)))
    names = [parameter.name for parameter in stored.model.parameters]
    assert len(set(names)) == len(names)
    found = there_and_back(stored, tmp_path)
    assert_same(found, stored)
    assert found.knowledge.model == found.model
    np.testing.assert_array_equal(found.knowledge.precision, stored.precision)


def test_without_knowledge_nothing_is_known(tmp_path, rng):
    """The file of a nominal model."""
    stored = of_everything(rng, [made("payload", ())], (made("delay", (1,)),))
    content = model_table(stored)
    del content["knowledge"]
    (tmp_path / "model.toml").write_text(tomli_w.dumps(content))
    assert_same(load_model(tmp_path), replace(stored, precision=np.zeros_like(stored.precision)))


def test_a_robot_that_took_up_a_payload_comes_back(result, tmp_path):
    """What the two logs tell of the last link and the payload each is more than one log without the other can tell."""
    terms = (made("payload", ()), make_effect("hysteresis", {"width": [0.1], "joints": [2]}))
    model = Model(result.model.robot, (*result.model.terms, *terms), (made("delay", (1,)),))
    theta = np.concatenate([result.theta, [0.01, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.0, 0.3, 0.2]])
    motion = random_trajectory(3, 6.0, seed=8).motion(result.log.t - result.log.t[0])
    log = simulate(model, theta, motion, rng=np.random.default_rng(1), noise=0.03, signed=True)
    again = identify_again(model, log, result.knowledge, theta)
    own = base_coefficients(model)
    assert len(again.coefficients) == len(own) + 10
    loaded = load_model(save(again, tmp_path / "r"))
    assert loaded.model.terms == model.terms
    assert loaded.model.distortions == model.distortions
    np.testing.assert_allclose(loaded.theta, again.theta, rtol=1e-12, atol=0.0)
    size = np.sqrt(np.diag(again.fit.information))
    covariance = np.linalg.inv(again.fit.information / np.outer(size, size)) / np.outer(size, size)
    turn = own.projection @ np.linalg.pinv(again.coefficients.projection)
    np.testing.assert_allclose(turn @ covariance @ turn.T @ loaded.precision, np.eye(len(own)), atol=1e-5)


@pytest.fixture
def extended(tmp_path, rng):
    """A file of a model with two terms of one name and two distortions."""
    terms = [made("hysteresis", (2,)), made("hysteresis", (3, 1)), made("load_dependent_friction", (2,))]
    there_and_back(of_everything(rng, terms, (made("gain_error", (3, 1)), made("clipping", (2,)))), tmp_path)
    return tmp_path


def knowing(change):
    """A change of the precision."""

    def changed(content):
        precision = np.array(content["knowledge"]["precision"])
        content["knowledge"]["precision"] = change(precision).tolist()

    return changed


def unsymmetric(precision):
    precision[0, 1] += 1e-3 * np.sqrt(precision[0, 0] * precision[1, 1])
    return precision


def indefinite(precision):
    """In the smallest of all entries."""
    k = np.argmin(np.diag(precision))
    precision[k, k] *= 0.5
    return precision


def holed(precision):
    precision[1, 2] = np.nan
    return precision


def boundless(precision):
    precision[1, 1] = np.inf
    return precision


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (put("distortions", 0, "name", "magic"), "unknown distortion 'magic'"),
        (put("distortions", 0, "name", "hysteresis"), "unknown distortion 'hysteresis'"),
        (put("terms", 1, "name", "gain_error"), "unknown term 'gain_error'"),
        (put("distortions", 0, "name", 3), "unknown distortion 3"),
        (put("distortions", 0, "name", [3]), "unhashable"),
        (lambda content: content["distortions"][0].pop("name"), "'name'"),
        (lambda content: content["distortions"][0].pop("shape"), "gain"),
        (put("distortions", 1), "not"),
        (put("distortions", [1]), "not"),
        (put("distortions", 0, "gain"), "indices"),
        (put("distortions", 0, "shape", 3), "int"),
        (put("distortions", 0, "shape", {"gain": [1.1], "joints": [3, 1]}), "gain has 1 numbers"),
        (put("distortions", 0, "shape", {"gain": [1.1, 0.9]}), "gain has 2 numbers"),
        (put("distortions", 0, "shape", "lag", [0.1]), "lag"),
        (put("distortions", 0, "shape", "gain", 1.0), "float"),
        (put("distortions", 0, "shape", "gain", ["a", "b"]), "could not convert"),
        (put("distortions", 0, "shape", "gain", [1.0, float("nan")]), "not finite"),
        (put("distortions", 0, "shape", "gain", [1.0, float("inf")]), "not finite"),
        (put("distortions", 0, "shape", "gain", [1.0, 10**400]), "not finite"),
        (put("distortions", 1, "shape", "limit", [-1.0]), "negative"),
        (put("distortions", 0, {"name": "base_tilt", "shape": {"angle": [0.1]}}), "angle has 1 numbers"),
        (put("distortions", 0, {"name": "base_tilt", "shape": {"angle": [0.1, 0.2], "joints": [1]}}), "all joints"),
        (put("distortions", 0, {"name": "delay", "shape": {"lag": [0.1, 0.1]}}), "lag has 2 numbers"),
        *(
            (put(group, 1, "shape", "joints", joints), says)
            for group in ("terms", "distortions")
            for joints, says in (
                *(([j], "are not joints") for j in (0, 4, -1, 10**30)),
                *(([j], "whole numbers") for j in (1.5, float("inf"), "1", True)),
                (2, "int"),
                ([1, 2], "numbers"),
                ([], "numbers"),
            )
        ),
        (put("terms", 2, "shape", "joints", [3, 3]), "are not joints"),
        (put("terms", 2, "shape", "joints", [3, 2]), "comes twice"),
        (put("terms", 1, "shape", "width", [0.0]), "shape cannot be used"),
        (put("terms", 3, "shape", "links", [0.0] * 29), "links has 29 numbers"),
        (put("knowledge", 3), "int"),
        (put("knowledge", []), "list"),
        (put("knowledge", {}), "'coefficients'"),
        (lambda content: content["knowledge"].pop("precision"), "'precision'"),
        (put("knowledge", "coefficients", []), "other coefficients"),
        (put("knowledge", "coefficients", 0, "m9"), "other coefficients"),
        (put("knowledge", "precision", 1.0), "shape"),
        (put("knowledge", "precision", []), "shape"),
        (put("knowledge", "precision", 0, [1.0]), "inhomogeneous"),
        (put("knowledge", "precision", 0, 0, "a"), "convert"),
        (knowing(lambda precision: precision[1:]), "shape"),
        (knowing(lambda precision: precision[1:, 1:]), "shape"),
        (knowing(np.diag), "shape"),
        (knowing(lambda precision: -precision), "normal distribution"),
        (knowing(unsymmetric), "normal distribution"),
        (knowing(indefinite), "normal distribution"),
        (knowing(holed), "not finite"),
        (knowing(boundless), "not finite"),
    ],
)
def test_a_broken_extension_is_bad_input(extended, change, says):
    with pytest.raises(InputError, match=says) as refusal:
        load_model(edited(extended, extended, change))
    assert str(extended / "model.toml") in refusal.value.where
    assert "\n" not in str(refusal.value)


# ---------------------------------------------------------------------------------------------------------------
# Writing aside
# ---------------------------------------------------------------------------------------------------------------
def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_an_earlier_result_is_replaced(result, tmp_path):
    place = save(result, tmp_path / "r")
    other = replace(result, warnings=("another result",))
    (place / "posterior.nc").write_text("of the earlier result")
    assert save(other, place) == place
    assert set(contents(place)) == PROMISED
    assert b"another result" in contents(place)["summary.json"]
    assert list(tmp_path.iterdir()) == [place]


def test_an_empty_folder_and_folders_yet_to_be_made_will_do(result, tmp_path):
    (tmp_path / "empty").mkdir()
    for place in (tmp_path / "empty", tmp_path / "new" / "er" / "est"):
        assert set(contents(save(result, place))) == PROMISED


def test_a_link_to_a_result_stays_a_link(result, tmp_path):
    save(result, tmp_path / "r")
    (tmp_path / "link").symlink_to(tmp_path / "r")
    save(replace(result, warnings=("another result",)), tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert b"another result" in contents(tmp_path / "r")["summary.json"]


@pytest.mark.parametrize("name", ["notes.txt", "summary.json.bak", "model.toml"])
def test_other_files_are_never_deleted(result, tmp_path, name):
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / name).write_text("mine")
    with pytest.raises(InputError, match="holds other files"):
        save(result, tmp_path / "r")
    assert contents(tmp_path / "r") == {name: b"mine"}


def test_a_folder_with_a_summary_of_something_else_is_not_deleted(result, tmp_path):
    (tmp_path / "r").mkdir()
    for name in ("summary.json", "thesis.tex"):
        (tmp_path / "r" / name).write_text("mine")
    with pytest.raises(InputError, match=r"holds other files \(thesis.tex\)"):
        save(result, tmp_path / "r")
    assert set(contents(tmp_path / "r")) == {"summary.json", "thesis.tex"}


def test_a_validation_does_not_replace_the_model_it_is_of(result, validation, tmp_path):
    place = save(result, tmp_path / "r")
    before = contents(place)
    with pytest.raises(InputError, match="holds other files"):
        save_validation(validation, place)
    assert contents(place) == before


def test_a_log_that_was_seen_takes_no_validations_place(result, validation, tmp_path):
    """It may stand there, marked, until there is a validation."""
    place = save(result, tmp_path / "r")
    make_report(place, result.validate(result.log))
    assert read_findings(place).prediction.seen
    make_report(place, validation)
    before = contents(place)
    with pytest.raises(InputError, match="is a log that the model was identified from, and would take the place of"):
        make_report(place, result.validate(result.log))
    assert contents(place) == before
    assert not read_findings(place).prediction.seen


def test_the_folder_one_is_in_is_not_pulled_away(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for place in (".", tmp_path):
        with pytest.raises(InputError, match="is the folder you are in"):
            save(result, place)
    assert list(tmp_path.iterdir()) == []


def test_files_are_not_folders(tmp_path):
    (tmp_path / "file").write_text("mine")
    for place in ("file", "file/r", "file/r/s"):
        with pytest.raises(InputError, match="not a folder"):
            check_result_folder(tmp_path / place)


def full_disk(*_):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("earlier", [True, False])
def test_a_full_disk_leaves_everything_as_it_was(result, tmp_path, monkeypatch, earlier):
    place = tmp_path / "r"
    before = contents(save(result, place)) if earlier else None
    monkeypatch.setattr(results, "_write_signed_log", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        save(replace(result, warnings=("another result",)), place)
    assert [path.name for path in tmp_path.iterdir()] == (["r"] if earlier else [])
    assert not earlier or contents(place) == before


@pytest.mark.parametrize("fault", [ValueError, KeyboardInterrupt])
def test_whatever_goes_wrong_nothing_is_left_behind(result, tmp_path, monkeypatch, fault):
    def fail(*_):
        raise fault

    monkeypatch.setattr(results, "coefficient_rows", fail)
    with pytest.raises(fault):
        save(result, tmp_path / "r")
    assert list(tmp_path.iterdir()) == []


def test_a_rename_that_fails_puts_the_earlier_result_back(result, tmp_path, monkeypatch):
    place = save(result, tmp_path / "r")
    before, rename = contents(place), results.Path.rename

    def fail_once(path, target):
        if target == place and path.name == "new":
            raise OSError(13, "Permission denied")
        return rename(path, target)

    monkeypatch.setattr(results.Path, "rename", fail_once)
    monkeypatch.setattr("bayesid.files.writing._exchanged", lambda one, other: False)
    with pytest.raises(InputError, match="Permission denied"):
        save(replace(result, warnings=("another result",)), place)
    assert list(tmp_path.iterdir()) == [place]
    assert contents(place) == before


# ---------------------------------------------------------------------------------------------------------------
# Validations
# ---------------------------------------------------------------------------------------------------------------
def test_a_validation_folder(validation, tmp_path):
    place = save_validation(validation, tmp_path / "v")
    assert {path.name for path in place.iterdir()} == {"summary.json", "signed_log.csv", "prediction.csv"}
    content = strict((place / "summary.json").read_text())
    assert content["n_samples"] == 601
    np.testing.assert_allclose(content["rms_error"], validation.rms_error)
    np.testing.assert_allclose(content["relative_residual"], validation.relative_residual)
    rows = table(place / "prediction.csv")
    assert list(rows[0]) == ["t", *(f"{name}{j}" for name in ("tau", "predicted", "lower", "upper") for j in (1, 2, 3))]
    values = np.array([[float(value) for value in row.values()] for row in rows])
    np.testing.assert_array_equal(values[:, 0], validation.signals.motion.t)
    np.testing.assert_allclose(values[:, 1:4], validation.measured, rtol=1e-7)
    np.testing.assert_allclose(values[:, 4:7], validation.predicted, rtol=1e-7)
    np.testing.assert_allclose(values[:, 7:10], validation.lower, rtol=1e-7)
    np.testing.assert_allclose(values[:, 10:], validation.upper, rtol=1e-7)
    np.testing.assert_allclose(content["coverage_95"], validation.coverage)
    assert content["band"] == "parameters and noise, by the information matrix"
    assert len(table(place / "signed_log.csv")) == 601
    save_validation(validation, place)
    assert list(tmp_path.iterdir()) == [place]


def test_a_result_is_not_written_over_a_validation(result, validation, tmp_path):
    place = save_validation(validation, tmp_path / "v")
    with pytest.raises(InputError, match=r"prediction.csv"):
        save(result, place)


def test_the_summary_is_plain(result):
    content = as_json(summarise(result))
    assert json.loads(json.dumps(content)) == content
