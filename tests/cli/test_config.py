"""bayesid.toml: what a robot's logs have in common, for `identify` from a file, for other commands from the result."""

import os
import tomllib

import numpy as np
import pytest
from command_line import QUICK, assert_refused, run

import bayesid
from bayesid.cli.arguments import BAYESID
from bayesid.files.config import CONFIG, OF_MODEL, OF_READING, OF_RUN

FAST = *QUICK[1:], "--complete", "off", "--terms", "rigid_body,viscous_friction"
GAINS = [2.0, 4.0, 5.0]


@pytest.fixture
def odd(arm_place):
    """A log in degrees and ampere under foreign names, its robot in another folder, and a file that says so."""
    log = bayesid.read_log("log.csv")
    table = np.column_stack([1e3 * log.t, np.degrees(log.q), log.effort / GAINS])
    header = ",".join(["Zeit [ms]", *(f"Achse{j}" for j in (1, 2, 3)), *(f"Strom{j}" for j in (1, 2, 3))])
    np.savetxt("odd.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    (arm_place / "cell").mkdir()
    (arm_place / "arm.toml").rename(arm_place / "cell" / "arm.toml")
    (arm_place / "cell" / CONFIG).write_text(
        'robot = "arm.toml"\ngains = [2, 4, 5]\nunsigned = "all"\ndegrees = true\n'
        'columns = {t = "Zeit [ms]", q = "Achse{}", i = "Strom{}"}\n'
    )
    return arm_place


def test_the_keys_are_the_options_of_identify():
    identify = next(one for one in BAYESID.commands if one.name == "identify")
    known = {*OF_READING, *OF_MODEL, *OF_RUN}
    assert {f"--{key}" for key in known} == {
        name for name in identify.names if name.startswith("--") and name not in ("--config", "--out", "--force")
    }


def test_a_file_stands_in_place_of_options(odd, capfd):
    """Its paths are relative to it; a result holds what its other commands and the next identification need."""
    assert run("identify", "odd.csv", "--config", f"cell/{CONFIG}", *FAST, "--out", "result") == 0
    err = capfd.readouterr().err
    assert f"options of cell/{CONFIG}: --robot=cell/arm.toml --gains=2,4,5" in err
    kept = tomllib.loads((odd / "result" / CONFIG).read_text())
    assert kept == {
        "robot": str(odd / "cell" / "arm.toml"),
        "terms": "rigid_body,viscous_friction",
        "complete": "off",
        "gains": GAINS,
        "unsigned": "all",
        "degrees": True,
        "columns": {"t": "Zeit [ms]", "q": "Achse{}", "i": "Strom{}"},
    }
    assert "reading" not in tomllib.loads((odd / "result" / "model.toml").read_text())
    (odd / CONFIG).write_text((odd / "result" / CONFIG).read_text())
    assert run("identify", "odd.csv", *QUICK, "--out", "again") == 0
    assert capfd.readouterr().out == ""
    same = [(odd / name / "coefficients.csv").read_bytes() for name in ("result", "again")]
    assert same[0] == same[1]
    log = bayesid.read_log("log.csv")
    np.testing.assert_allclose(bayesid.read_log("result/signed_log.csv").q, log.q, atol=1e-6)


def test_later_commands_need_no_option_of_reading(odd, capfd):
    assert run("identify", "odd.csv", "--config", f"cell/{CONFIG}", *FAST, "--quiet", "--out", "result") == 0
    table = np.genfromtxt("odd.csv", delimiter=",", skip_header=1)
    header = (odd / "odd.csv").read_text().splitlines()[0]
    table[:, 4:] *= 1.0 + 0.01 * np.sin(table[:, :1])  # another recording
    np.savetxt("other.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    quick = "--posterior-budget", 0
    for command in (
        ("validate", "result", "other.csv", "--strict"),
        ("predict", "result", "other.csv"),
        ("discrepancy", "result", "other.csv", "--no-posterior", "--out", "found"),
        ("payload", "result", "other.csv", *quick),
        ("track", "result", "other.csv"),
        ("excite", "--for", "result", "--duration", 4, "--rate", 50, "--changes", 60),
    ):
        assert run(*command) == 0, command
        err = capfd.readouterr().err
        assert ("read like the result's log" in err) == (command[0] != "excite"), err
        assert "Gains(" not in err
        assert "differs from that of the result" not in err
    assert (odd / "found" / CONFIG).read_text() == (odd / "result" / CONFIG).read_text()
    assert run("validate", "result", "other.csv", "--gains", "2,4,6") == 0
    assert "--gains differs from that of the result" in capfd.readouterr().err


def test_what_is_typed_counts_and_contradictions_are_said(odd, capfd):
    (odd / CONFIG).write_text((odd / "cell" / CONFIG).read_text().replace("arm.toml", "cell/arm.toml"))
    assert run("identify", "odd.csv", *FAST, "--gains", "2,4,6", "--unsigned", "all", "--out", "result") == 0
    err = capfd.readouterr().err
    assert err.startswith(f"options of {CONFIG}: --robot=cell/arm.toml")
    assert f"warning: the command line overrides --gains of {CONFIG}" in err
    assert "--unsigned" not in err.splitlines()[1]
    assert bayesid.load("result").reading["gains"].value.tolist() == [2.0, 4.0, 6.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('robott = "arm.toml"', "did you mean robot?"),
        ("robot = ", "not valid TOML"),
        ("gains = [[1, 2]]", "gains"),
        ('cutoff = "low"', "--cutoff"),
        ('complete = "all"', "--complete"),
        ('out = "result"', "give --out on the command line"),
    ],
)
def test_files_that_cannot_be_used(odd, capfd, text, says):
    (odd / CONFIG).write_text(f"{text}\n")
    assert_refused(capfd, ("identify", "odd.csv"), [CONFIG, says])
    assert_refused(capfd, ("identify", "odd.csv", "--config", "nowhere.toml"), ["nowhere.toml"])


def test_what_is_replaced_need_not_be_usable(odd, capfd):
    (odd / CONFIG).write_text('cutoff = "low"\n')
    assert run("identify", "nowhere.csv", "--cutoff", 7, "--robot", "cell/arm.toml", "--quiet") == 2
    warned, refused = capfd.readouterr().err.splitlines()
    assert warned == f"warning: the command line overrides --cutoff of {CONFIG}"
    assert "nowhere.csv" in refused


def test_a_robot_is_needed_from_somewhere(odd, capfd):
    for command in (("identify", "odd.csv"), ("excite", "--log", "odd.csv"), ("simulate", "--out", "new.csv")):
        assert_refused(capfd, command, ["--robot"])
    os.chdir("cell")
    assert run("excite", "--log", "../odd.csv", "--quiet") == 0
    assert capfd.readouterr().err.count("options of") == 0


def test_the_file_of_a_result_may_be_edited(odd, capfd):
    assert run("identify", "odd.csv", "--config", f"cell/{CONFIG}", *FAST, "--quiet", "--out", "result") == 0
    path = odd / "result" / CONFIG
    text = path.read_text()
    path.write_text(text.replace("gains", "gain"))
    assert_refused(capfd, ("validate", "result", "odd.csv"), [str(path.relative_to(odd)), "did you mean gains?"])
    path.write_text(text.replace("degrees = true", "degrees = 3"))
    assert_refused(capfd, ("validate", "result", "odd.csv"), ["degrees = 3"])
    path.write_text(text.replace('unsigned = "all"', "unsigned = [1, 2, 3]"))
    assert run("validate", "result", "odd.csv", "--quiet") == 0
