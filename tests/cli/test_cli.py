"""Commands that succeed: what they leave and say; and that what fails leaves what was there."""

import csv
import json
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from command_line import QUICK, assert_refused, everything, identify, no_large_files, run
from oracles import urdf_text

import bayesid
from bayesid.cli.arguments import parse
from bayesid.effects import STANDARD
from bayesid.errors import SolverError

RESULT = {"summary.json", "segments.csv", "signed_log.csv", "coefficients.csv", "parameters.csv"}
RESULT |= {"model.toml", "bayesid.toml", "robot.urdf", "robot.xml", "findings.npz"}
"""What section 7 of the design promises and more; with draws posterior.nc too, and report.html where it is made."""
EVERY = ("identify", "validate", "simulate", "demo", "predict", "discrepancy", "payload", "report", "excite", "study")
HERE = {"arm.toml", "log.csv"}


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def names(folder):
    return {path.name for path in folder.iterdir()}


def summary(folder):
    return json.loads((folder / "summary.json").read_text())


@pytest.mark.parametrize("command", ["", *EVERY, "completion", "robot", "robot new", "robot show", "robot list"])
def test_examples_of_the_help_can_be_typed(command, capfd):
    """Each command has some, and all of their words are options that there are."""
    assert run(*command.split(), "--help") == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert all(one in out for one in EVERY) if not command else out.startswith(f"usage: bayesid {command}")
    assert "--quiet" in out or command not in EVERY
    examples = [line.strip() for line in out.partition("examples:")[2].splitlines() if line.startswith("  bayesid ")]
    assert examples
    for example in examples:
        words = shlex.split(example.partition(" > ")[0].partition(" | ")[0])
        assert parse(words[1:]).command == words[1]
        assert " ".join(words[1:]).startswith(command)


@pytest.mark.parametrize("command", [(), ("robot",)])
def test_a_program_alone_shows_its_help(command, capfd):
    assert run(*command) == 0
    out, err = capfd.readouterr()
    assert (out.startswith("usage: bayesid"), "examples:" in out, err) == (True, True, "")


def test_completion_names_every_command(capfd):
    for shell in ("zsh", "tcsh", "bash"):
        assert run("completion", shell) == 0
        out, err = capfd.readouterr()
        assert err == ""
        assert all(word in out for word in (*EVERY, "robot", "--constraints", "--convention"))


def test_identify_leaves_what_is_promised(arm_place, capfd):
    """With as few draws as there can be, which do not satisfy: said aloud, and no failure."""
    assert run(*identify(), "--posterior-budget", 0) == 0
    out, err = capfd.readouterr()
    assert names(arm_place / "out") == RESULT | {"posterior.nc", "report.html"}
    assert names(arm_place) == HERE | {"out"}
    assert "arm: 601 rows" in out
    assert "posterior: not converged: R-hat " in out
    assert "converged" not in err, "the verdict says it"
    assert "Verdict: bad. " in out
    assert "--posterior-budget" in out.partition("Verdict: ")[2]
    assert summary(arm_place / "out")["posterior"]["converged"] is False
    assert out.endswith("\nopen out/report.html\n")


def test_a_warning_that_the_verdict_has_no_room_for_is_printed(arm_place, capfd, monkeypatch):
    """Only what the terminal shows is not told twice: the page may say more than three things."""
    told = [bayesid.identification.checks.Check(f"Bad {k}", "bad", f"fault {k}", f"do {k}") for k in range(5)]
    monkeypatch.setattr("bayesid.report.verdicts.check_findings", lambda _: tuple(told))
    real = bayesid.identify

    def warned(*arguments, **named):
        return replace(real(*arguments, **named), warnings=tuple(map(str, told)))

    monkeypatch.setattr("bayesid.cli.identify.identify", warned)
    assert run(*identify(), "--no-posterior", "--no-report", "--complete", "off") == 0
    out, err = capfd.readouterr()
    assert [(out + err).count(f"fault {k}") for k in range(5)] == [1] * 5


def test_several_logs_count_as_one(arm_place, capfd):
    """And without --out the folder is called after the first of them; without a posterior none is written."""
    (arm_place / "runs").mkdir()
    for name in ("b", "a"):
        shutil.copy("log.csv", f"runs/{name}.csv")
    beam = "--no-posterior", "--search", "beam", "--complete", "off"
    assert run("identify", "runs/*.csv", "--robot", "arm.toml", *beam) == 0
    assert re.search(r"posterior: +not sampled", capfd.readouterr().out)
    assert names(arm_place / "bayesid-a") == RESULT | {"report.html"}
    said = summary(arm_place / "bayesid-a")
    assert said["posterior"] is None
    assert said["n_samples"] == 2 * 601
    assert said["log"] == "runs/a.csv + runs/b.csv"
    assert said["logs"] == [{"source": name, "n_samples": 601} for name in ("runs/a.csv", "runs/b.csv")]
    found = rows(arm_place / "bayesid-a" / "signed_log.csv")
    assert [row["log"] for row in found] == ["runs/a.csv"] * 601 + ["runs/b.csv"] * 601
    assert [row["t"] for row in found[:601]] == [row["t"] for row in found[601:]]
    assert {row["log"] for row in rows(arm_place / "bayesid-a" / "segments.csv")} == {"runs/a.csv", "runs/b.csv"}


def test_the_signs_are_right_and_the_terminal_says_what_the_summary_does(arm_shop):
    signed, truth = (rows(arm_shop / name) for name in ("result/signed_log.csv", "log_signed.csv"))
    for j in range(1, 4):
        effort, found = (np.array([float(row[f"tau{j}"]) for row in table]) for table in (truth, signed))
        strong = np.abs(effort) > 0.05 * np.abs(effort).max()
        np.testing.assert_array_equal(np.abs(found), np.abs(effort))
        assert np.mean(np.sign(found) == np.sign(effort), where=strong) > 0.999
    result = summary(arm_shop / "result")["posterior"]
    (printed,) = [x for x in (arm_shop / "terminal.txt").read_text().splitlines() if x.startswith("posterior: ")]
    for number in (f"R-hat <= {result['max_rhat']:.3f}", f"{result['min_ess']:.0f}", f"{result['seconds']:.1f} s"):
        assert number in printed
    assert (result["converged"], result["seed"]) == (True, 7)


def test_the_same_seed_gives_the_same_files(arm_shop, arm_place):
    """Sampled twice until it has converged."""
    assert run(*identify(), "--quiet", "--seed", 7, "--no-report") == 0
    for name in ("coefficients.csv", "parameters.csv", "segments.csv", "signed_log.csv", "model.toml", "robot.urdf"):
        assert (arm_place / "out" / name).read_bytes() == (arm_shop / "result" / name).read_bytes(), name


def test_options_reach_the_identification(arm_place, monkeypatch):
    seen = {}

    def spy(*arguments, **named):
        seen.update(zip(("robot", "log"), arguments, strict=True), **named)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesid.cli.identify.identify", spy)
    options = "--unsigned", "1,3", "--beam-width", 7, "--initial-segments", 4, "--cutoff", "11.5", "--seed", 8
    options += "--search", "beam", "--search-budget", 2.5, "--posterior-budget", 3.5, "--nominal", "cad.csv"
    options += "--complete", "only-uncertainty", "--kinematic-tolerance", "3mm,0.5deg"
    (arm_place / "cad.csv").write_text("name,mean,sd\nm2,1.5,0.25\nm1,2.0,\n")
    assert run(*identify(), "--terms", "rigid_body,torque_offset", *options) == 130
    assert (seen["robot"].origin.source, seen["terms"]) == ("arm.toml", ["rigid_body", "torque_offset"])
    assert seen["search"] == bayesid.Beam(width=7, initial_segments=4, budget=2.5)
    assert seen["preprocessing"] == bayesid.Preprocessing(cutoff=11.5)
    assert seen["posterior"] == bayesid.Sampling(budget=3.5, rng=8)
    assert seen["prior"].nominal == {"m2": (1.5, 0.25)}  # the other line has no sd
    assert (seen["prior"].length_sd, seen["prior"].angle_sd) == pytest.approx((3e-3, np.radians(0.5)))
    assert seen["complete"] == "only-uncertainty"
    assert seen["log"].signed.tolist() == [False, True, False]
    limits = "--search-budget", 2.5, "--beam-width", 3, "--time-limit", 9, "--kinematic-tolerance", "2cm, 1mrad"
    assert run(*identify(), *limits) == 130
    assert (seen["prior"].length_sd, seen["prior"].angle_sd) == pytest.approx((0.02, 1e-3))
    assert seen["search"] == bayesid.Certified(budget=2.5, time_limit=9.0, fallback=bayesid.Beam(width=3))
    assert seen["posterior"] == bayesid.Sampling(time_limit=9.0)
    assert run(*identify(), "--no-posterior") == 130
    assert (seen["posterior"], dict(seen["prior"].nominal), seen["search"]) == (False, {}, bayesid.Certified())
    assert (seen["complete"], tuple(seen["terms"])) == ("auto", STANDARD)


def test_currents_need_gains(arm_place, capfd):
    (arm_place / "currents.csv").write_text((arm_place / "log.csv").read_text().replace("tau", "i"))
    for gains in ((), ("--gains", "1,2"), ("--gains", "1,0,2")):
        assert_refused(capfd, (*identify("currents.csv"), *gains), ["gains"])
    assert run(*identify("currents.csv"), "--gains", "2,2,2", *QUICK) == 0
    effort, measured = rows(arm_place / "out" / "signed_log.csv"), rows(arm_place / "currents.csv")
    assert all(abs(float(a["tau2"])) == 2 * float(b["i2"]) for a, b in zip(effort, measured, strict=True))


def test_an_earlier_result_is_replaced_whole(arm_shop, arm_place, capfd):
    """Where --force asks for it: quietly, but for warnings, which are those of the summary."""
    shutil.copytree(arm_shop / "result", "out")
    (arm_place / "out" / "report.html").write_text("of the earlier result")
    quick = "--terms", "rigid_body, viscous_friction", "--cutoff", 12, *QUICK
    assert_refused(capfd, (*identify(), *quick), ["out", "--force", "out-2"])
    assert run(*identify(), *quick, "--force") == 0
    out, err = capfd.readouterr()
    said = summary(arm_place / "out")
    assert (out, err) == ("", "".join(f"warning: {warning}\n" for warning in said["warnings"]))
    assert said["terms"] == ["rigid_body", "viscous_friction"]
    assert names(arm_place / "out") == RESULT
    assert names(arm_place) == HERE | {"out"}


def test_nothing_is_replaced_before_it_is_asked_for(arm_result, arm_place, capfd):
    """By any command: refused at once, with a name that is free."""
    for name in ("taken.csv", "free_signed.csv", "taken.toml", "taken.png", "taken.html"):
        (arm_place / name).touch()
    for folder, marker in (("payload", "payload.json"), ("stream", "stream.json"), ("motion", "design.json")):
        (arm_place / folder).mkdir()
        (arm_place / folder / marker).touch()
    robot = "--robot", "arm.toml"
    for command, free in (
        (identify(out="result"), "result-2"),
        (("discrepancy", "log.csv", "log_2.csv", *robot, "--out", "result"), "result-2"),
        (("payload", "result", "log.csv", "--out", "payload"), "payload-2"),
        (("track", "result", "log.csv", "--out", "stream"), "stream-2"),
        (("excite", *robot, "--out", "motion"), "motion-2"),
        (("predict", "result", "log.csv", "--out", "taken.csv"), "taken-2.csv"),
        (("simulate", *robot, "--out", "taken.csv"), "taken-2.csv"),
        (("simulate", *robot, "--out", "free.csv"), "free_signed-2.csv"),
        (("report", "result", "--out", "taken.html"), "taken-2.html"),
        (("robot", "new", "--out", "taken.toml"), "taken-2.toml"),
        (("robot", "show", "arm.toml", "--out", "taken.png"), "taken-2.png"),
        (("study", "noise", "--out", "motion"), "motion-2"),
    ):
        if command[0] == "discrepancy":
            shutil.copy("log.csv", "log_2.csv")
        assert_refused(capfd, command, ["--force", free] if command[0] != "study" else [])


def test_a_bad_verdict_is_an_exit_code_where_that_is_asked_for(arm_result, arm_place, capfd):
    """After all has been written; the model does not predict a log of another arm's efforts."""
    table = bayesid.read_log("log.csv")
    other = bayesid.Log(table.t, table.q, 3.0 * table.effort + 1.0, table.signed)
    other.save("other.csv")
    command = "validate", "result", "other.csv"
    strict = ("--strict", "--out", "checked"), ("--strict", "--quiet")
    for options, code in (((), 0), (("--quiet",), 0), *((each, 3) for each in strict)):
        assert run(*command, *options) == code
        out, err = capfd.readouterr()
        assert ("Verdict: bad. " in out) != ("--quiet" in options)
        assert err.count("Verdict: bad. ") == (code == 3 or "--quiet" in options)
    assert (arm_place / "checked" / "summary.json").is_file()
    assert run("validate", "result", "log.csv", "--strict") == 0


def test_a_run_that_fails_leaves_the_earlier_result(arm_result, arm_place, capfd):
    (arm_result / "report.html").write_text("an old one")
    for command in (identify("nowhere.csv", out="result"), (*identify(out="result"), "--cutoff", "900")):
        assert_refused(capfd, (*command, "--force"), [])
    before = everything(arm_place)
    for command in ((*identify(out="result"), *QUICK, "--force"), ("report", "result")):
        with no_large_files(20_000):
            assert run(*command) == 2
        assert "File too large" in capfd.readouterr().err
        assert everything(arm_place) == before


@pytest.mark.parametrize(
    ("fault", "code", "says"),
    [
        (SolverError("cone least squares", "MaxIterations"), 1, "MaxIterations"),
        (OSError(5, "Input/output error"), 1, "Input/output error"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_faults_have_their_own_codes(arm_place, monkeypatch, capfd, fault, code, says):
    def fail(*_, **__):
        raise fault

    monkeypatch.setattr("bayesid.cli.identify.identify", fail)
    before = everything(arm_place)
    assert run(*identify()) == code
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert says in err
    assert everything(arm_place) == before


def test_validate_prints_a_table_and_agrees_with_identify(arm_shop, arm_place, capfd):
    """But for the posterior's mean, which is not where least squares is: by a fraction of the standard deviations."""
    assert run("validate", arm_shop / "result", arm_shop / "log_signed.csv") == 0
    out, err = capfd.readouterr()
    assert err == ""
    figures, said = out.split("\n\n")
    *figures, held = figures.splitlines()
    assert said.startswith("Verdict: good. ")
    assert "in the 95 % band" in figures[0]
    assert "by the posterior" in held
    assert [line.split()[0] for line in figures[1:]] == ["1", "2", "3"]
    shares = [float(line.rstrip("%").split()[-1]) for line in figures[1:]]
    assert all(90.0 < share < 99.0 for share in shares), "its own log"
    assert names(arm_place) == HERE
    assert run("validate", arm_shop / "result", "log.csv") == 0
    out = capfd.readouterr().out
    assert ("No validation" in out, "log that the model has not seen" in out, "bayesid report" in out) == (1, 1, 0)
    assert run("validate", arm_shop / "result", "log.csv", "--out", "checked") == 0
    assert names(arm_place / "checked") == {"summary.json", "signed_log.csv", "prediction.csv"}
    found, expected = summary(arm_place / "checked"), summary(arm_shop / "result")["fit"]
    np.testing.assert_allclose(found["relative_residual"], expected["relative_residual"], rtol=0.2)


def test_a_validation_is_on_the_report(arm_result, arm_place, capfd):
    """A page with the new log in it; the folder keeps what it shows, and the next report shows it again."""
    others = everything(arm_result)
    assert_refused(capfd, ("report", "result", "--out", "to/send.html"), ["folder to"])
    (arm_place / "to").mkdir()
    log = bayesid.read_log("log.csv")
    replace(log, effort=1.01 * log.effort).save("other.csv")
    assert run("validate", "result", "other.csv") == 0
    out, err = capfd.readouterr()
    assert "in the 95 % band" in out
    assert "open result/report.html, where this log replaces " in out
    assert err == ""
    changed = {path for path, content in everything(arm_result).items() if others.get(path) != content}
    assert {path.name for path in changed} == {"findings.npz", "report.html"}
    assert bayesid.report.report_data.read_report_data("result").prediction.source == "other.csv"
    shown = everything(arm_result)
    assert run("validate", "result", "log.csv", "--quiet") == 0
    assert everything(arm_result) == shown, "a log that the model has seen is no validation"
    assert run("report", "result", "--out", "to/send.html", "--quiet") == 0
    assert capfd.readouterr() == ("", "")
    text = (arm_place / "to" / "send.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert "other.csv: errors of the predicted efforts" in text
    assert not list(arm_result.glob(".*"))


def test_figures_of_a_validation_stand_without_its_page(arm_result, arm_place, capfd):
    log = bayesid.read_log("log.csv")
    replace(log, effort=1.01 * log.effort).save("other.csv")
    with no_large_files(20_000):
        assert run("validate", "result", "other.csv") == 1
    out, err = capfd.readouterr()
    assert "in the 95 % band" in out
    assert "File too large" in err


def test_simulate_leaves_the_log_and_its_signs(arm_place, capfd):
    options = "--duration", 2, "--rate", 50, "--noise", 0, "--effect", "coulomb_friction:2:0.2"
    (arm_place / "new").mkdir()
    for name, seed in (("new/s", 4), ("same", 4), ("other", 5)):
        assert run("simulate", "--robot", "arm.toml", "--out", f"{name}.csv", *options, "--seed", seed) == 0
    assert names(arm_place / "new") == {"s.csv", "s_signed.csv"}
    last = capfd.readouterr().out.splitlines()
    assert [line.partition("next: ")[2] for line in last][1:] == [
        f"bayesid identify {name}.csv --robot arm.toml" for name in ("same", "other")
    ]
    log, signed = bayesid.read_log("new/s.csv"), bayesid.read_log("new/s_signed.csv")
    assert len(log) == 101
    assert not log.signed.any()
    assert signed.signed.any()
    np.testing.assert_array_equal(log.effort, np.abs(signed.effort))
    one, same, other = ((arm_place / f"{name}.csv").read_bytes() for name in ("new/s", "same", "other"))
    assert one == same != other


def test_a_urdf_robot_in_a_process_of_its_own(tmp_path, monkeypatch, capfd):
    """Two joints that turn and one that slides. What the libraries below print would show up here."""

    def program(*arguments):
        command = [sys.executable, "-m", "bayesid.cli", *map(str, arguments)]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.urdf").write_text(urdf_text())
    assert run("simulate", "--robot", "odd.urdf", "--duration", 6, "--out", "odd.csv", "--quiet") == 0
    assert capfd.readouterr() == ("", "")
    assert run(*identify("odd_signed.csv", "odd.urdf"), *QUICK, "--complete", "off") == 0
    result = program("validate", "out", "odd.csv")
    assert (result.returncode, result.stderr) == (0, "")
    assert "by the information matrix" in result.stdout
    before = names(tmp_path)
    (tmp_path / "odd.urdf").write_text('<robot name="x"><link name="a"/><link name="b"/></robot>')
    bad = program("identify", "odd.csv", "--robot", "odd.urdf")
    assert (bad.returncode, bad.stdout, bad.stderr.count("\n")) == (2, "", 1)
    assert bad.stderr.startswith("bayesid: odd.urdf: ")
    assert names(tmp_path) == before
    assert run("--version") == 0
    assert capfd.readouterr().out.endswith(f"bayesid {bayesid.__version__}\n")


def test_demo_is_the_papers_experiment(arm_shop, arm_place, capfd):
    """With as few draws as there can be; the result of an earlier demo is replaced if that is asked for."""
    shutil.copytree(arm_shop / "result", "bayesid-demo")
    (arm_place / "bayesid-demo" / "log.csv").write_text("of the earlier demo")
    assert_refused(capfd, ("demo",), ["bayesid-demo", "--force"])
    assert run("demo", "--seed", 1, "--posterior-budget", 0, "--force", "--strict") == 3
    out, _ = capfd.readouterr()
    assert names(arm_place / "bayesid-demo") == RESULT | {"log.csv", "posterior.nc", "report.html"}
    assert bayesid.load("bayesid-demo").model.robot.name != "arm"
    assert len(bayesid.read_log("bayesid-demo/log.csv")) == 667
    assert "0 of " in out
    shown = json.loads((arm_place / "bayesid-demo" / "summary.json").read_text())["verdict"]
    bad = {reason["check"] for reason in shown["reasons"] if reason["state"] == "bad"}
    assert bad == {"Sampling"}, "of a demo that is perfect but for draws"
    true, measured = (
        next(x for x in out.splitlines() if x.startswith(f"  against {what}")) for what in ("the", "meas")
    )
    shown = bayesid.load("bayesid-demo").report_data().prediction.relative_residual
    assert measured.split(":")[1].split()[::2] == [f"{100.0 * share:.2f}" for share in shown]
    assert all(float(error) < 2.0 for error in true.split(":")[1].split()[::2])
    coefficients = [line for line in out.splitlines() if line.lstrip()[:2].strip().isdigit()]
    assert len(coefficients) >= 27
    assert all(("kg m^2 " in line) == ("J" in line) for line in coefficients)
