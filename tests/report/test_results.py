"""What the files of a result folder hold."""

from dataclasses import replace

import numpy as np
import pytest
from saved_results import PROMISED, contents, identified, numbers, save, strict, table, validated
from scipy import linalg, stats

from bayesid.log.reading import read_log
from bayesid.log.signals import prepare
from bayesid.motion import Motion
from bayesid.report.folders import save_identification, save_validation
from bayesid.report.report_data import read_report_data
from bayesid.report.result_files import inference_data, parameter_rows


@pytest.fixture(scope="module")
def result():
    return identified()


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    return save_identification(result, tmp_path_factory.mktemp("results") / "result")


def test_a_result_folder_holds_what_is_promised(folder):
    assert set(contents(folder)) == PROMISED | {"report.html"}
    assert [path for path in folder.parent.iterdir() if path != folder] == []
    assert folder.stat().st_mode & 0o777 == 0o755
    assert read_report_data(folder).prediction is None


def test_the_summary_has_the_promised_keys(result, folder):
    content = strict((folder / "summary.json").read_text())
    assert {"noise", "timings", "warnings"} <= set(content)
    assert {"method", "cost", "certified", "lower_bound", "seconds", "sdp_solves"} <= set(content["search"])
    assert content["n_samples"] == len(result.log) == 601
    assert content["n_segments"] == len(table(folder / "segments.csv"))
    assert content["n_coefficients"] == len(table(folder / "coefficients.csv"))
    assert content["signed_joints"] == [2]
    search = content["search"]
    assert (search["method"], search["certified"]) == ("branch and bound", True)
    assert [way["name"] for way in search["ways"]][-1] == "branch and bound"
    assert search["unlisted_probability"] == 0.0
    assert search["lower_bound"] == pytest.approx(search["cost"], rel=1e-4)
    assert search["gap"] == search["cost"] - search["lower_bound"]
    assert search["assignments"] >= 1
    assert 0.0 < search["missed_mass"] <= 1e-3
    assert 0.9 < search["persistent_share"] <= 1.0
    assert content["noise"]["sd"] == result.fit.noise.sigma.tolist()
    assert content["noise"]["residual_sd"] == result.fit.residual.sigma.tolist()
    assert all(seconds >= 0.0 for seconds in content["timings"].values())
    assert content["warnings"] == list(result.warnings)
    assert content["posterior"] is None
    speed = np.abs(result.signals.motion.dq)
    moving = (speed > 0.01 * speed.max(axis=0)).sum(axis=0)
    expected = moving / content["noise"]["samples_that_count_as_one"]
    np.testing.assert_allclose(content["noise"]["effective_samples"], expected, rtol=0.02)


def test_segments_cover_the_log_and_agree_with_its_signs(result, folder):
    rows, signed = table(folder / "segments.csv"), table(folder / "signed_log.csv")
    assert list(rows[0]) == ["joint", "start", "end", "n_samples", "sign", "confidence"]
    period, t = 1.0 / result.signals.rate, numbers(signed, "t")
    for joint in ("1", "2", "3"):
        mine = [row for row in rows if row["joint"] == joint]
        starts, ends, counts = numbers(mine, "start", "end", "n_samples").T
        assert starts[0] == result.log.t[0]
        assert ends[-1] == pytest.approx(result.log.t[-1], abs=period)
        np.testing.assert_allclose(starts[1:] - ends[:-1], period, atol=1e-3 * period)
        np.testing.assert_allclose(ends - starts, (counts - 1) * period, atol=1e-3 * period)
        assert counts.sum() == len(result.signals.motion)
        tau = numbers(signed, f"tau{joint}")
        for row in mine:
            if float(row["confidence"]) > 0.999 and int(row["n_samples"]) > 10 and joint != "2":
                inside = (t >= float(row["start"])) & (t <= float(row["end"]))
                assert np.mean(tau[inside] * int(row["sign"]) > 0.0) > 0.9
    assert {row["sign"] for row in rows} == {"-1", "1"}
    assert all(0.5 <= float(row["confidence"]) <= 1.0 for row in rows)


def test_the_signed_log_has_the_rows_of_the_log_and_is_one(result, folder, tmp_path):
    """`read_log` reads it: efforts with their signs, the same positions, and velocities that suit them."""
    rows, log = table(folder / "signed_log.csv"), result.log
    names = [f"{kind}{j}" for kind in ("tau", "p", "q", "dq") for j in (1, 2, 3)]
    assert list(rows[0]) == ["t", *names]
    values = numbers(rows, *rows[0])
    t, tau, p, q, dq = values[:, 0], values[:, 1:4], values[:, 4:7], values[:, 7:10], values[:, 10:]
    np.testing.assert_array_equal(t, log.t)
    np.testing.assert_array_equal(q, log.q)
    np.testing.assert_array_equal(np.abs(tau), np.abs(log.effort))
    np.testing.assert_array_equal(tau[:, 1], log.effort[:, 1])
    assert (p.min() >= 0.0, p.max() <= 1.0) == (True, True)
    np.testing.assert_array_equal(np.sign(tau), np.where(p >= 0.5, 1.0, -1.0) * (tau != 0.0))
    np.testing.assert_array_equal(p[:, 1], log.effort[:, 1] >= 0.0)
    np.testing.assert_allclose(p, result.probability, atol=1e-6)  # the log is even: its rows are the grid's
    again = read_log(folder / "signed_log.csv")
    assert again.signed.all()
    for one, other in ((again.effort, tau), (again.q, q), (again.dq, dq)):
        np.testing.assert_array_equal(one, other)
    speed = prepare(again).motion.dq - result.signals.motion.dq
    assert log.dq is None
    assert np.sqrt(np.mean(speed[25:-25] ** 2)) < 1e-3 * np.sqrt(np.mean(result.signals.motion.dq**2))
    measured = save(replace(result, log=replace(log, dq=2.0 * dq)), tmp_path / "r") / "signed_log.csv"
    np.testing.assert_array_equal(numbers(table(measured), "dq1", "dq2", "dq3"), 2.0 * dq)


def test_each_row_of_a_jittered_log_has_the_nearest_probability(result, tmp_path):
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(601, 400, replace=False))
    t = result.log.t[rows] + rng.uniform(-0.004, 0.004, 400)
    effort = result.log.effort[rows] * np.array([1.0, -1.0, 1.0])  # a signed joint's sign is the log's, nobody else's
    some = replace(result.log, t=t, q=result.log.q[rows], effort=effort)
    written = table(save(replace(result, log=some), tmp_path / "r") / "signed_log.csv")
    np.testing.assert_allclose(numbers(written, "p1", "p3"), result.probability[rows][:, [0, 2]], atol=1e-6)
    np.testing.assert_array_equal(numbers(written, "tau2", "p2"), np.stack([effort[:, 1], effort[:, 1] >= 0.0], axis=1))


def test_the_coefficients_are_those_of_the_fit(result, folder):
    rows = table(folder / "coefficients.csv")
    assert list(rows[0])[:7] == ["name", "expression", "mean", "sd", "rsd_percent", "q2.5", "q97.5"]
    assert [row["name"] for row in rows] == list(result.coefficients.names)
    assert [row["expression"] for row in rows] == list(result.coefficients.expressions)
    mean, sd = result.fit.beta, result.fit.sd
    ends = (stats.norm.ppf(share, mean, sd) for share in (0.025, 0.975))
    expected = np.column_stack([mean, sd, 100.0 * sd / abs(mean), *ends])
    np.testing.assert_allclose(numbers(rows, "mean", "sd", "rsd_percent", "q2.5", "q97.5"), expected, rtol=1e-7)


def test_only_what_the_efforts_show_is_decided_by_the_data(result, folder):
    """Parameters that can change without a trace in the efforts of a random motion are decided by the prior."""
    rng = np.random.default_rng(3)
    q, dq, ddq = rng.uniform(-3.0, 3.0, (3, 200, 3))
    columns = result.model.columns(Motion(np.arange(200.0), q, dq, ddq)).reshape(600, -1)
    silent = linalg.null_space(columns, rcond=1e-10)
    assert silent.shape[1] == columns.shape[1] - len(result.coefficients)
    may_change = np.abs(silent).max(axis=1) > 1e-7
    rows = table(folder / "parameters.csv")
    assert [row["name"] for row in rows] == [parameter.name for parameter in result.model.parameters]
    assert [row["decided_by"] for row in rows] == ["prior" if free else "data" for free in may_change]


def test_what_the_log_does_not_excite_is_left_to_the_prior(result):
    blind = result.coefficients.names.index("Fc2")
    covariance = result.fit.covariance.copy()
    covariance[blind] = covariance[:, blind] = 0.0
    covariance[blind, blind] = np.inf
    unseen = replace(result, fit=replace(result.fit, covariance=covariance))
    before, rows = ({row["name"]: row for row in parameter_rows(one)} for one in (result, unseen))
    assert (rows["Fc2"]["decided_by"], rows["Fc2"]["sd"]) == ("prior", "")
    assert {name for name in rows if rows[name] != before[name]} == {"Fc2"}
    with pytest.raises(ValueError, match="no posterior"):
        inference_data(result)


def test_a_validation_folder(tmp_path):
    validation, place = validated(), save_validation(validated(), tmp_path / "v")
    assert set(contents(place)) == {"summary.json", "signed_log.csv", "prediction.csv"}
    content = strict((place / "summary.json").read_text())
    assert content["n_samples"] == 601
    for key, values in (("rms_error", "rms_error"), ("relative_residual",) * 2, ("coverage_95", "coverage")):
        np.testing.assert_allclose(content[key], getattr(validation, values))
    assert content["band"] == "parameters and noise, by the information matrix"
    rows, names = table(place / "prediction.csv"), ("tau", "predicted", "lower", "upper")
    assert list(rows[0]) == ["t", *(f"{name}{j}" for name in names for j in (1, 2, 3))]
    values = numbers(rows, *rows[0])
    np.testing.assert_array_equal(values[:, 0], validation.signals.motion.t)
    parts = [validation.measured, validation.predicted, validation.lower, validation.upper]
    np.testing.assert_allclose(values[:, 1:], np.hstack(parts), rtol=1e-7)
    assert len(table(place / "signed_log.csv")) == len(validation.log)
    save_validation(validation, place)
    assert list(tmp_path.iterdir()) == [place]
