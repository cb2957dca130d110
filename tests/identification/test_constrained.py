"""What is stated of parameters, from the call to the folder: it holds, it is stored, and what contradicts is said."""

import csv
import html
import json
import re
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
import tomli_w
from identified_arm import MODEL, ROBOT, THETA, by_least_squares, log_of, sampled

from bayesid.cli import main
from bayesid.effects.bodies import Payload
from bayesid.errors import InputError
from bayesid.identification.model_file import load
from bayesid.identification.payload import identify_payload
from bayesid.identification.pipeline import identify
from bayesid.log.gains import gains_of
from bayesid.posterior.sampler import Sampling
from bayesid.report.folders import save_identification
from bayesid.report.pages.identification_page import identification_page
from bayesid.report.report_data import report_data
from bayesid.report.summarise import summarise
from bayesid.robot import robot_table

NAMES = [parameter.name for parameter in MODEL.parameters]
TRUE = dict(zip(NAMES, THETA.tolist(), strict=True))
MASS = [TRUE[f"m{k}"] for k in (1, 2, 3)]


def about(name, share):
    return f"{name} = [{(1 - share) * TRUE[name]:.6f}, {(1 + share) * TRUE[name]:.6f}]"


def centre(k):
    return np.array([TRUE[f"mc{k}{axis}"] for axis in "xyz"]) / TRUE[f"m{k}"]


def right(p):
    """True of the arm, and narrower than the prior."""
    yield p.total_mass <= 1.15 * sum(MASS)
    yield p["m2"] >= 0.9 * TRUE["m2"]
    yield p["m2"] <= 1.1 * TRUE["m2"]
    yield p.com_in_box(2, centre(2) - 0.03, centre(2) + 0.04)
    yield cp.norm(p.first_moment(3) - centre(3) * p["m3"]) <= 0.05 * p["m3"]


@pytest.fixture(scope="module")
def constrained():
    few = Sampling(budget=0.0)
    return identify(ROBOT, log_of(0, signed=False), complete="off", constraints=right, posterior=few)


def test_what_is_stated_holds_and_says_more_of_what_the_log_leaves_open(constrained):
    stated, free = constrained.model.cone.stated, sampled()
    assert stated.contains(THETA)
    assert stated.contains(constrained.theta)
    assert stated.contains(constrained.fit.theta, 1e-5)
    draws = constrained.posterior.draws.theta.reshape(-1, len(NAMES))
    assert all(stated.contains(theta) for theta in draws[::5])
    assert constrained.posterior.theta[NAMES.index("m2")] == pytest.approx(TRUE["m2"], rel=0.1)
    sd, before = (dict(zip(NAMES, one.parameter_sd[0], strict=True)) for one in (constrained, free))
    assert sd["m2"] < 0.5 * before["m2"]
    assert sd["mc2x"] < 0.6 * before["mc2x"]
    assert sd["Fc2"] == pytest.approx(before["Fc2"], rel=0.35)
    decided = {row.name: row.decided_by for row in constrained.parameters_table()}
    assert (decided["m2"], decided["Fc2"], decided["J1xx"]) == ("constraints", "data", "prior")
    assert {row.decided_by for row in free.parameters_table()} == {"data", "prior"}
    signs = (constrained.probability >= 0.5) == (free.probability >= 0.5)
    assert signs.mean() > 0.99


def test_nothing_that_is_true_is_dear_and_what_contradicts_is_named():
    log = log_of(0)
    fine = identify(ROBOT, log, complete="off", constraints=right, posterior=False)
    assert max(one.nats for one in fine.constraints) < 6.0
    assert [one for one in fine.warnings if "constraint" in one] == []
    wrong = identify(
        ROBOT, log, complete="off", posterior=False, constraints=lambda p: [*right(p), p["Fc2"] <= 0.5 * TRUE["Fc2"]]
    )
    dear = max(wrong.constraints, key=lambda one: one.nats)
    assert dear.label.startswith("Fc2 <= ")
    assert sum(dear.label in said and f"costs {2.0 * dear.nats:.0f}" in said for said in wrong.warnings) == 1
    free = by_least_squares()
    place = NAMES.index("Fc2")
    off = (free.fit.theta[place] - 0.5 * TRUE["Fc2"]) / free.fit.sd[free.coefficients.names.index("Fc2")]
    assert dear.nats == pytest.approx(0.5 * off**2, rel=0.25), "half the square of the distance in sds"


def test_a_result_keeps_them_and_loading_needs_no_cvxpy(constrained, tmp_path, monkeypatch):
    folder = save_identification(constrained, tmp_path / "result", report=True)
    summary = json.loads((folder / "summary.json").read_text())
    assert [one["label"] for one in summary["constraints"]] == list(constrained.model.constraints.labels)
    assert summary["constraints"] == [vars(one) for one in summarise(constrained).constraints]
    with open(folder / "parameters.csv", newline="") as file:
        decided = {row["name"]: row["decided_by"] for row in csv.DictReader(file)}
    assert decided["m2"] == "constraints"
    monkeypatch.setitem(__import__("sys").modules, "cvxpy", None)
    stored = load(folder)
    theta = constrained.theta + 0.01
    np.testing.assert_allclose(stored.model.cone.stated.slack(theta), constrained.model.cone.stated.slack(theta))
    np.testing.assert_allclose(stored.model.cone.stated.matrices(theta), constrained.model.cone.stated.matrices(theta))
    extended = stored.model.extend(Payload())
    assert extended.cone.stated.labels == stored.model.constraints.labels
    reading = identify_payload(stored, log_of(2, signed=False), posterior=Sampling(budget=0.0))
    cone = reading.identification.model.cone
    assert all(cone.stated.contains(theta) for theta in reading.posterior.draws.theta.reshape(-1, cone.size)[::9])
    again = reading.posterior.uncertain.theta.reshape(-1, cone.size)
    assert all(cone.stated.contains(theta) for theta in again[::9]), "what the model may lack included"


def test_what_holds_draws_back_is_named_on_the_page_in_the_summary_and_the_warnings(constrained):
    summary, labels = summarise(constrained), constrained.model.constraints.labels
    active_bounds = [one.label for one in summary.constraints if one.presses]
    assert 0 < len(active_bounds) <= len(labels)
    assert active_bounds == list(constrained.posterior.active_constraints)
    (said,) = [warning for warning in constrained.warnings if "limited by constraint" in warning]
    for one in summary.constraints:
        assert (f"{one.label} ({100.0 * one.at_edge:.1f} % of the draws at its edge)" in said) == one.presses
    assert all("--links" not in warning for warning in constrained.warnings)
    page = identification_page(report_data(constrained))
    table = page.split('id="constraints"')[1].split("</section>")[0]
    rows = [re.sub("(<[^>]*>)+", "|", html.unescape(row)).split("|") for row in table.split("<tr")[2:]]
    for row, one in zip(rows, summary.constraints, strict=True):
        assert {f"{100.0 * one.at_edge:.1f}\xa0%", "yes" if one.presses else "no"} <= set(row)
        assert ("none: the best fit satisfies it" in row) == (one.nats == 0.0)
    assert 'id="constraints"' not in identification_page(report_data(sampled()))


def test_draws_that_completion_widens_satisfy_them():
    log = log_of(0, signed=False)
    wide, free = (
        identify(ROBOT, log, complete="only-uncertainty", constraints=says, posterior=Sampling(budget=0.0))
        for says in (right, None)
    )
    assert wide.posterior.shift is not None
    stated = wide.model.cone.stated
    draws = wide.posterior.uncertain.theta.reshape(-1, len(NAMES))
    assert all(stated.contains(theta) for theta in draws[::5])
    before = free.posterior.uncertain.theta.reshape(-1, len(NAMES))
    assert np.mean([stated.contains(theta) for theta in before[::5]]) < 0.5
    friction = [wide.coefficients.names.index(f"Fc{j}") for j in (1, 2, 3)]
    np.testing.assert_allclose(wide.sd[friction], free.sd[friction], rtol=0.6)


def test_the_command_takes_a_file_and_refuses_a_bad_one_in_one_line(tmp_path, capsys):
    log_of(0).save(tmp_path / "log.csv")
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(robot_table(ROBOT)))
    known = tmp_path / "known.toml"
    known.write_text(f"total_mass = [0.2, {1.2 * sum(MASS):.4f}]\n[bounds]\n{about('m2', 0.1)}\n")
    call = ["identify", str(tmp_path / "log.csv"), "--robot", str(tmp_path / "robot.toml"), "--constraints", str(known)]
    call += ["--complete", "off", "--no-posterior", "--no-report", "--quiet"]
    assert main([*call, "--out", str(tmp_path / "result")]) == 0
    assert load(tmp_path / "result").model.constraints.labels == ("total_mass", "bounds.m2")
    summary = json.loads((tmp_path / "result" / "summary.json").read_text())
    assert f"constraints='{known}'" in summary["provenance"]["call"]
    assert summary["provenance"]["options"]["constraints"] == str(known)
    capsys.readouterr()
    for text, said in (
        ("[bounds]\nmm2 = [1, 2]", "did you mean m2"),
        (f"total_mass = [0.1, 0.2]\n[bounds]\n{about('m2', 0.1)}\n", "total_mass and bounds.m2 contradict each other"),
    ):
        known.write_text(text)
        assert main([*call, "--out", str(tmp_path / "refused")]) == 2
        line = capsys.readouterr().err
        assert said in line
        assert line.count("\n") == 1
        assert "Traceback" not in line
        assert not (tmp_path / "refused").exists()


def test_uncertain_gains_bear_ratios_but_no_bounds():
    log = log_of(0)
    uncertain = replace(log, gains=gains_of("1~20%,1~20%,1~20%", 3))
    with pytest.raises(InputError, match=r"total_mass <= 50 cannot .* uncertain gains.*--nominal"):
        identify(ROBOT, uncertain, complete="off", posterior=False, constraints=lambda p: [p.total_mass <= 50])
    found = identify(
        ROBOT, uncertain, complete="off", posterior=Sampling(budget=0.0), constraints=lambda p: list(right(p))[3:]
    )
    stated = found.model.cone.stated
    draws = found.posterior.uncertain.theta.reshape(-1, len(NAMES))
    assert all(stated.contains(theta, 1e-9) for theta in draws[::5])


def equal(p):
    """Of the arm, exactly: a weighed link, its centre by CAD, two frictions of known ratio and one that is known."""
    yield p["m2"] == TRUE["m2"]
    yield p.first_moment(2) == centre(2) * p["m2"]
    yield p["Fc2"] == (TRUE["Fc2"] / TRUE["Fc3"]) * p["Fc3"]
    yield p["Fv1"] == TRUE["Fv1"]


@pytest.fixture(scope="module")
def in_plane():
    few = Sampling(budget=0.0)
    return identify(ROBOT, log_of(0, signed=False), complete="only-uncertainty", constraints=equal, posterior=few)


def test_equalities_hold_exactly_in_fit_draws_and_files(in_plane, tmp_path):
    stated, free = in_plane.model.cone.stated, sampled()
    for draws in (in_plane.posterior.draws, in_plane.posterior.uncertain):
        theta = draws.theta.reshape(-1, len(NAMES))
        assert np.abs(stated.gap(theta.T)).max() < 1e-12
    for theta in (in_plane.theta, in_plane.fit.theta):
        assert stated.contains(theta)
        assert theta[NAMES.index("Fv1")] == TRUE["Fv1"]
    rows, before = ({row.name: row for row in one.parameters_table()} for one in (in_plane, free))
    for name in ("m2", "mc2y", "Fv1"):
        assert (rows[name].sd, rows[name].decided_by) == (0.0, "constraints")
        assert rows[name].mean == pytest.approx(TRUE[name], rel=1e-14)
    assert rows["Fc2"].decided_by == "data"
    assert in_plane.posterior.active_constraints == {}, "to hold exactly is not to press"
    known = in_plane.coefficient("Fv1")
    assert (known.mean, known.sd, known.lower, known.upper) == (TRUE["Fv1"], 0.0, TRUE["Fv1"], TRUE["Fv1"])
    precision = [1.0 / before[name].sd ** 2 for name in ("Fc2", "Fc3")]
    both = 1.0 / np.sqrt(precision[0] + precision[1] / (TRUE["Fc2"] / TRUE["Fc3"]) ** 2)
    exact = identify(ROBOT, log_of(0, signed=False), complete="off", constraints=equal, posterior=False)
    sd = dict(zip(exact.coefficients.names, exact.fit.sd.tolist(), strict=True))
    assert sd["Fv1"] == 0.0
    assert 0.75 * both < sd["Fc2"] < 1.05 * both, "two joints show one number"
    assert sd["Fc3"] / sd["Fc2"] == pytest.approx(TRUE["Fc3"] / TRUE["Fc2"])
    assert max(one.nats for one in in_plane.constraints) < 6.0
    folder = save_identification(in_plane, tmp_path / "result", report=True)
    with open(folder / "parameters.csv", newline="") as file:
        written = {row["name"]: row for row in csv.DictReader(file)}
    assert (float(written["m2"]["mean"]), float(written["m2"]["sd"])) == (float(f"{TRUE['m2']:.9g}"), 0.0)
    stored = load(folder)
    assert stored.model.cone.stated.contains(in_plane.theta)
    np.testing.assert_array_equal(stored.model.cone.plane().basis, in_plane.model.cone.plane().basis)
    reading = identify_payload(stored, log_of(2, signed=False), posterior=Sampling(budget=0.0))
    cone, theta = reading.identification.model.cone, reading.posterior.draws.theta
    assert np.abs(cone.stated.gap(theta.reshape(-1, cone.size).T)).max() < 1e-12


def test_an_equality_that_is_wrong_costs_what_the_log_knows_better():
    place, free = NAMES.index("Fc2"), by_least_squares()
    sd = free.fit.sd[free.coefficients.names.index("Fc2")]
    value = float(free.fit.theta[place] - 6.0 * sd)
    found = identify(ROBOT, log_of(0), complete="off", posterior=False, constraints=lambda p: p["Fc2"] == value)
    (price,) = found.constraints
    assert price.nats == pytest.approx(18.0, rel=0.2), "half the square of the distance in sds"
    assert [price.label in said for said in found.warnings].count(True) == 1


def test_uncertain_gains_bear_no_equality():
    uncertain = replace(log_of(0), gains=gains_of("1~20%,1~20%,1~20%", 3))
    with pytest.raises(InputError, match="Fv1 == Fv2 cannot be used with uncertain gains"):
        identify(ROBOT, uncertain, complete="off", posterior=False, constraints=lambda p: p["Fv1"] == p["Fv2"])
