"""Findings: against what they are of, by other ways; and the file that keeps them."""

import json
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from made_findings import make_findings, with_alternatives

import bayesid
from bayesid.errors import InputError
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import ParameterPrior
from bayesid.report import report_data as module
from bayesid.report.folders import save_identification
from bayesid.report.grading import verdict
from bayesid.report.report_data import FILE, read_report_data, report_data, write_findings
from bayesid.report.summary import as_json
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import check_findings
from bayesid.robot import robot_from_table, robot_table
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Assignment
from bayesid.simulation.logs import simulate_log

JOINTS = (
    {"a": 0.0, "alpha": 0.3, "d": 0.3, "theta": 0.1},
    {"a": 0.3, "alpha": -1.2, "d": 0.1, "theta": 0.4, "type": "prismatic"},
)
ROBOT = robot_from_table({"name": "slider", "convention": "modified", "joints": list(JOINTS)}, "test")
TRANSMISSION = {**robot_table(ROBOT), "name": "coupled", "transmission": [[40.0, 3.0], [-7.0, 60.0]]}
SINGLE = 2.0**-23
"""Relative spacing of numbers in single precision: half of it is lost in the file."""


def quick(robot, log):
    return identify(robot, log, search=Certified(), posterior=False, complete="off")


@pytest.fixture(scope="module")
def logs():
    """Two of |effort|, two with signs."""
    (first, first_signed), (second, second_signed) = (
        simulate_log(ROBOT, duration, 100.0, 0.04, [], seed) for duration, seed in ((5.0, 3), (4.0, 4))
    )
    return first, second, first_signed, second_signed


@pytest.fixture(scope="module")
def half_signed(logs):
    """The slider's sign is known; the clock counts from 1970."""
    signed = np.array([False, True])
    log = replace(
        logs[2], effort=np.where(signed, logs[2].effort, np.abs(logs[2].effort)), signed=signed, t=logs[2].t + 1.7e9
    )
    return quick(ROBOT, log)


@pytest.fixture(scope="module")
def sampled(logs):
    prior = ParameterPrior(nominal={"m1": (9.0, 1.0), "J2xy": (0.01, 0.3)})
    sampling = Sampling(rng=5)
    search = Certified()
    return identify(ROBOT, logs[0], search=search, posterior=sampling, prior=prior, complete="off")


@pytest.fixture(scope="module")
def pooled(logs):
    return quick(ROBOT, join_logs([logs[0], logs[1]]))


@pytest.fixture(scope="module")
def coupled():
    """Motors that move two joints each."""
    robot = robot_from_table(TRANSMISSION, "test")
    return quick(robot, simulate_log(robot, 5.0, 100.0, 0.03, [], 6)[0])


KINDS = ("half_signed", "sampled", "pooled", "coupled")


@pytest.fixture(params=KINDS)
def any_of_them(request):
    return request.getfixturevalue(request.param)


def same(one, other, path=""):
    """Equal, but for what is kept in single precision."""
    if is_dataclass(one):
        assert type(one) is type(other)
        for part in (part for part in fields(one) if part.compare):  # not where they are kept
            same(getattr(one, part.name), getattr(other, part.name), f"{path}.{part.name}")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, path
        single = path.split(".")[1] in ("samples", "prediction") and one.ndim == 2
        np.testing.assert_allclose(other, one, rtol=SINGLE if single else 0.0, atol=1e-37, err_msg=path)
    else:
        assert one == other, path


def kept(findings, folder):
    """Written into a folder and read back."""
    (folder / "summary.json").write_text(json.dumps(as_json(findings.summary)))
    write_findings(findings, folder / FILE)
    return read_report_data(folder)


def test_a_folder_holds_the_same(any_of_them, tmp_path):
    found = report_data(any_of_them)
    folder = save_identification(any_of_them, tmp_path / "result", report=False)
    back = read_report_data(folder)
    same(found, back)
    assert (found.folder, back.folder) == ("", str(folder))
    assert (found.draws is None) == (any_of_them.posterior is None)
    written = json.loads((folder / "summary.json").read_text())
    assert written.pop("verdict") == verdict(check_findings(back))
    assert written.pop("not_written") == {}
    assert as_json(found.summary) == written


def test_samples_are_the_log_and_the_model(any_of_them):
    """The residual by |recorded| and the model alone: the sign of an effort is that of its likelier side."""
    samples, signals = report_data(any_of_them).samples, any_of_them.signals
    n, effort = any_of_them.model.robot.n_joints, signals.raw_effort
    predicted = any_of_them.model.columns(signals.motion) @ any_of_them.theta
    np.testing.assert_allclose(samples.predicted, predicted, rtol=1e-9, atol=1e-9 * np.abs(predicted).max())
    assert samples.t[0] == 0.0
    np.testing.assert_allclose(samples.t, np.arange(len(effort)) / signals.rate, atol=3e-7)  # of a clock since 1970
    np.testing.assert_array_equal(samples.recorded, effort)
    for j in range(n):
        likelier = np.sign(any_of_them.probability[:, j] - 0.5 + 1e-300)
        signed = effort[:, j] if signals.signed[j] else effort[:, j] * likelier
        np.testing.assert_allclose(samples.residual[:, j], signed - predicted[:, j], atol=1e-9 * np.abs(signed).max())
    assert np.abs(samples.residual[samples.used]).mean() < np.abs(effort[samples.used]).mean()
    assert samples.every == 1


def test_position_and_velocity_are_of_the_motors(coupled):
    """q_m = T q over each motor's own gear, by the transmission that was given."""
    samples, motion = report_data(coupled).samples, coupled.signals.motion
    (q1, q2), (dq1, dq2) = motion.q.T, motion.dq.T
    np.testing.assert_allclose(samples.position.T, [q1 + 3 / 40 * q2, q2 - 7 / 60 * q1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(samples.velocity.T, [dq1 + 3 / 40 * dq2, dq2 - 7 / 60 * dq1], rtol=1e-9, atol=1e-12)


def test_segments_are_those_of_the_table(any_of_them, tmp_path):
    """A segment ends where the next one begins, one sample after its last; none reaches over a pause between logs."""
    found, period = report_data(any_of_them).segments, 1.0 / any_of_them.signals.rate
    rows = bayesid.report.result_files.segment_rows(any_of_them)
    t = any_of_them.signals.motion.t - any_of_them.signals.motion.origin
    assert len(rows) == len(found.joint)
    for k, row in enumerate(rows):
        assert [found.joint[k] + 1, found.sign[k]] == [row["joint"], row["sign"]]
        assert found.confidence[k] == row["confidence"]
        lasts = found.end[k] - found.start[k]
        at_the_end = found.end[k] == t[-1]
        assert lasts == pytest.approx((row["n_samples"] - at_the_end) * period, abs=2e-6)
    np.testing.assert_array_equal(found.ambiguous, found.confidence < 0.95)
    known = np.arange(any_of_them.model.robot.n_joints) == 1
    half_known = report_data(replace(any_of_them, log=replace(any_of_them.log, signed=known))).segments
    np.testing.assert_array_equal(half_known.ambiguous, found.ambiguous & (found.joint != 1))
    if not any_of_them.log.pooled:
        for j in range(any_of_them.model.robot.n_joints):
            mine = found.joint == j
            np.testing.assert_array_equal(found.end[mine][:-1], found.start[mine][1:])
            assert (found.start[mine][0], found.end[mine][-1]) == (0.0, t[-1])


def test_the_autocorrelation_by_brute_force(pooled):
    """Over pairs of samples that are both in motion, about zero."""
    found = report_data(pooled)
    residual, used = found.samples.residual, found.samples.used
    assert found.correlation.lag[:3] == pytest.approx([0.0, 1.0 / pooled.signals.rate, 2.0 / pooled.signals.rate])
    assert found.correlation.value.shape == (2, int(0.5 * pooled.signals.rate))
    for j in range(2):
        for lag in (0, 1, 7, 30):
            pairs = [
                (residual[i, j], residual[i + lag, j])
                for i in range(len(residual) - lag)
                if used[i, j] and used[i + lag, j]
            ]
            mean = sum(a * b for a, b in pairs) / len(pairs)
            variance = np.mean(residual[used[:, j], j] ** 2)
            assert found.correlation.value[j, lag] == pytest.approx(mean / variance, rel=1e-9, abs=1e-12)
        assert found.correlation.bound[j] == pytest.approx(1.96 / np.sqrt(used[:, j].sum()), rel=1e-4)


def test_draws_come_in_the_order_of_sweeps(sampled):
    """All walkers of an ensemble's first sweep first."""
    found, draws = report_data(sampled).draws, sampled.posterior.uncertain
    sweeps, ensembles, walkers, r = draws.beta.shape
    assert (found.shape[0], found.shape[2]) == (ensembles, r)
    np.testing.assert_array_equal(found[:, -walkers:], draws.beta[-1])  # the last sweep is kept
    assert sweeps * walkers >= found.shape[1]


def test_what_differs_in_other_assignments(half_signed):
    """A search that left three assignments: the second differs in segments 1 and 4, but proves nothing about 4."""
    searched, search = half_signed.searched, half_signed.search
    signs = [search.signs.copy() for _ in range(3)]
    signs[1][[1, 4]] *= -1
    signs[2][[0, 2, 3]] *= -1
    decided = np.ones((3, len(search.signs)), dtype=bool)
    decided[1, 4] = False
    costs = search.cost + np.array([0.0, 2.5, 4.25])
    branches = tuple(Assignment(one, search.theta, cost, search.cost) for one, cost in zip(signs, costs, strict=True))
    found = report_data(replace(half_signed, search=replace(search, branches=branches, decided=decided))).alternatives
    np.testing.assert_allclose(found.cost - found.cost[0], [0.0, 2.5, 4.25])
    np.testing.assert_array_equal(found.branch, [1, 2, 2, 2])
    different = [1, 0, 2, 3]
    np.testing.assert_array_equal(found.joint, searched.joint[different])
    period = 1.0 / half_signed.signals.rate
    np.testing.assert_allclose(found.start, searched.start[different] * period, atol=3e-7)
    np.testing.assert_allclose(found.end, (searched.end[different] - 1) * period, atol=3e-7)
    assert np.isnan(found.mass).all()


def test_long_logs_are_thinned(half_signed, monkeypatch, tmp_path):
    whole, validation = report_data(half_signed), half_signed.validate(half_signed.log)
    monkeypatch.setattr(module, "TUNING", replace(TUNING, samples=100))
    thin = report_data(half_signed).with_validation(validation)
    count = len(whole.samples.t)
    assert thin.samples.every == round(count / 100) == 5
    assert len(thin.samples.t) == len(thin.prediction.t) == 100
    assert (thin.samples.t[0], thin.samples.t[-1]) == (whole.samples.t[0], whole.samples.t[-1])
    rows = np.searchsorted(whole.samples.t, thin.samples.t)
    for name in ("position", "recorded", "signed", "predicted", "residual", "probability", "used"):
        np.testing.assert_array_equal(getattr(thin.samples, name), getattr(whole.samples, name)[rows])
    np.testing.assert_array_equal(thin.correlation.value, whole.correlation.value)  # of all samples
    np.testing.assert_array_equal(thin.segments.end, whole.segments.end)
    same(thin, kept(thin, tmp_path))
    other = with_alternatives(make_findings(draws=False, validated=True))
    same(other, kept(other, tmp_path))
    with np.load(tmp_path / FILE) as file:  # an earlier version did not say whether the model had seen the log
        np.savez(tmp_path / "findings", **{key: file[key] for key in file.files if key != "prediction.seen"})
    same(other, read_report_data(tmp_path))


def test_what_is_scattered_is_in_motion_and_even():
    found = make_findings()
    value, residual = found.scatter(1, "velocity", 50)
    used = np.flatnonzero(found.samples.used[:, 1])
    rows = used[np.round(np.linspace(0, len(used) - 1, 50)).astype(int)]
    np.testing.assert_array_equal(value, found.samples.velocity[rows, 1])
    np.testing.assert_array_equal(residual, found.samples.residual[rows, 1])
    assert len(found.scatter(0, "t", 10**6)[0]) == found.samples.used[:, 0].sum()
    still = replace(found, samples=replace(found.samples, used=np.zeros_like(found.samples.used)))
    assert [len(one) for one in still.scatter(0, "t", 10)] == [0, 0]
    assert [len(one) for one in still.trend(0, "t")] == [0, 0, 0]


def test_the_worst_decided_come_first():
    """By sd over the prior's sd: 4 / 4.71 for the seventh; without priors by the relative sd."""
    found = make_findings()
    ratio = found.coefficients.sd / found.coefficients.prior_sd
    assert found.worst(3).tolist() == sorted(range(8), key=lambda k: -ratio[k])[:3]
    bare = replace(found, coefficients=replace(found.coefficients, prior_sd=np.full(8, np.nan)))
    relative = found.coefficients.sd / np.abs(found.coefficients.mean)
    assert bare.worst(4).tolist() == sorted(range(8), key=lambda k: -relative[k])[:4]
    assert len(found.worst(100)) == 8
    scaled = found.standardised(np.array([6, 2]))
    by_hand = (found.draws[1, 5, 6] - found.coefficients.mean[6]) / found.coefficients.prior_sd[6]
    assert scaled[1, 5, 0] == pytest.approx(by_hand, rel=1e-12)


def test_bars_are_in_units_of_a_coefficients_own_size():
    """mean 2, interval 1 to 3: size 2; mean 0.5, interval -1.5 to 2.5: size 2; nothing known: the line has no end."""
    table = replace(
        make_findings().coefficients,
        mean=np.array([2.0, 0.5, -4.0]),
        sd=np.array([0.5, 1.0, np.inf]),
        low=np.array([1.0, -1.5, -np.inf]),
        high=np.array([3.0, 2.5, np.inf]),
        nominal=np.array([2.2, np.nan, -5.0]),
    )
    ends = [0.5, -0.75, -np.inf], [1.5, 1.25, np.inf]
    np.testing.assert_allclose(table.bar, [[1.0, 0.25, -1.0], *ends, [1.1, np.nan, -1.25]])
    np.testing.assert_allclose(table.relative_sd, [0.25, 2.0, np.inf])


def test_what_is_no_findings_is_refused_in_one_line(tmp_path):
    """Damage of all kinds is in tests/fuzz."""
    kept(make_findings(draws=False), tmp_path)
    whole = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    summary = json.loads(whole["summary.json"])
    del summary["provenance"]
    with np.load(tmp_path / FILE) as file:
        lacking = {key: file[key] for key in file.files if key != "coefficients.sd"}
    np.savez(tmp_path / "lacking.npz", **lacking)
    np.savez(tmp_path / "pickled.npz", **{"samples.t": np.array([{"a": 1}], dtype=object)})
    for name, damaged, says in (
        ("summary.json", None, "no summary.json"),
        ("summary.json", b"{", ""),
        ("summary.json", b"[]", ""),
        ("summary.json", json.dumps(summary).encode(), "provenance"),
        (FILE, None, f"no {FILE}"),
        (FILE, whole[FILE][: len(whole[FILE]) // 2], ""),
        (FILE, (tmp_path / "lacking.npz").read_bytes(), "coefficients.sd"),
        (FILE, (tmp_path / "pickled.npz").read_bytes(), ""),
        ("posterior.nc", b"\x89HDF\r\n\x1a\n and no more", "posterior"),
    ):
        if damaged is None:
            (tmp_path / name).unlink()
        else:
            (tmp_path / name).write_bytes(damaged)
        with pytest.raises(InputError) as caught:
            read_report_data(tmp_path)
        line = str(caught.value)
        assert "\n" not in line
        assert line.startswith(str(tmp_path))
        assert line.endswith("identify again")
        assert says in line
        for each, intact in whole.items():
            (tmp_path / each).write_bytes(intact)
