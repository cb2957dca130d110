import csv
import io
import json
import resource
import shlex
import shutil
import subprocess
import sys
import tomllib
from contextlib import contextmanager, redirect_stdout

import numpy as np
import pytest
import tomli_w
from oracles import urdf_text

import bayesid
from bayesid import cli
from bayesid.cli.parser import parse
from bayesid.errors import SolverError
from bayesid.model.terms import STANDARD

RESULT = {
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
"""What section 7 of the design promises and more; with draws posterior.nc too, and report.html where it is made."""
QUICK = "--quiet", "--no-posterior", "--no-report"
UNUSED = {"arviz", "cvxpy", "distributed", "emcee", "h5py", "jinja2", "matplotlib", "pandas", "pyarrow", "xarray"}
"""What an identification without posterior and report has no use for."""
COMMANDS = ("identify", "validate", "simulate", "demo")
ARM = """
name = "arm"
convention = "modified"
[[joints]]
a = 0.0
alpha = 0.0
d = 0.3
theta = 0.0
[[joints]]
a = 0.15
alpha = -1.2
d = 0.1
theta = 0.3
[[joints]]
a = 0.4
alpha = 0.5
d = 0.2
theta = -0.4
"""


def run(*arguments):
    """Exit code of `bayesid ARGUMENTS`."""
    try:
        return cli.main([str(argument) for argument in arguments])
    except SystemExit as end:
        return end.code


@pytest.fixture(scope="session")
def shop(tmp_path_factory):
    """A robot file, a log that `simulate` made of it, and what `identify` made of that."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(ARM)
    options = ("--duration", 6, "--noise", 0.03, "--seed", 2, "--effect", "viscous_friction:1:0.3")
    assert run("simulate", "--robot", place / "arm.toml", "--out", place / "log.csv", *options) == 0
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert run(*identify(place / "log.csv", place / "arm.toml", place / "result"), "--seed", 7, "--no-report") == 0
    (place / "terminal.txt").write_text(printed.getvalue())
    return place


@pytest.fixture
def place(shop, tmp_path, monkeypatch):
    """A folder of one's own with robot and log in it; commands run there, so what they leave is seen."""
    for name in ("arm.toml", "log.csv"):
        (tmp_path / name).write_bytes((shop / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def everything(folder):
    return {path.relative_to(folder): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.fixture
def refused(place, capfd):
    """Runs a command that must be refused: code 2, one line that says the given words, nothing printed or written."""

    def check(*arguments, says):
        capfd.readouterr()
        before = everything(place)
        assert run(*arguments) == 2
        out, err = capfd.readouterr()
        assert out == ""
        assert err.endswith("\n")
        assert err.count("\n") == 1
        assert err.startswith("bayesid")
        what, _, remedy = err.partition("; ")
        assert remedy.strip()
        for word in says:
            assert word in what
        assert everything(place) == before

    return check


def identify(log="log.csv", robot="arm.toml", out="out"):
    return "identify", log, "--robot", robot, "--out", out


# ---------------------------------------------------------------------------------------------------------------
# Commands that succeed
# ---------------------------------------------------------------------------------------------------------------
def test_version(capfd):
    assert run("--version") == 0
    assert capfd.readouterr().out == f"bayesid {bayesid.__version__}\n"


def test_help(capfd):
    assert run("--help") == 0
    out = capfd.readouterr().out
    assert all(command in out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(command, capfd):
    assert run(command, "--help") == 0
    out, err = capfd.readouterr()
    assert out.startswith(f"usage: bayesid {command}")
    assert "--out" in out
    assert err == ""


def test_identify_leaves_what_is_promised(place, capfd):
    """With as few draws as there can be, which do not satisfy: said aloud, and no failure."""
    assert run(*identify(), "--posterior-budget", 0) == 0
    out, err = capfd.readouterr()
    assert {path.name for path in (place / "out").iterdir()} == RESULT | {"posterior.nc", "report.html"}
    assert {path.name for path in place.iterdir()} == {"arm.toml", "log.csv", "out"}
    assert out.count("\n") == 10
    assert "intervals: this log cannot tell a balancing spring from the links: if joint 2 has one" in out
    assert "arm: 601 rows" in out
    assert "posterior: not converged: R-hat " in out
    (warning,) = [line for line in err.splitlines() if "converged" in line]
    assert warning.startswith("warning: the posterior has not converged (R-hat ")
    assert "--posterior-budget" in warning
    posterior = json.loads((place / "out" / "summary.json").read_text())["posterior"]
    assert posterior["converged"] is False
    assert out.endswith("written to out/\n")


def test_two_logs_count_as_one(place):
    shutil.copy(place / "log.csv", place / "again.csv")
    assert run("identify", "log.csv", "again.csv", "--robot", "arm.toml", "--out", "out", *QUICK) == 0
    summary = json.loads((place / "out" / "summary.json").read_text())
    assert summary["n_samples"] == 2 * 601
    assert summary["log"] == "log.csv + again.csv"
    assert summary["logs"] == [{"source": name, "n_samples": 601} for name in ("log.csv", "again.csv")]
    assert summary["search"]["certified"] is True
    found = rows(place / "out" / "signed_log.csv")
    assert [row["log"] for row in found] == ["log.csv"] * 601 + ["again.csv"] * 601
    assert [row["t"] for row in found[:601]] == [row["t"] for row in found[601:]]
    assert {row["log"] for row in rows(place / "out" / "segments.csv")} == {"log.csv", "again.csv"}


def test_a_quoted_pattern_names_logs(place, monkeypatch):
    """The folder is called after the first of them."""
    seen = []

    def spy(robot, log, *_, **__):
        seen.append([piece.source for piece in log.pieces])
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesid.cli.commands.identify.identify", spy)
    (place / "runs").mkdir()
    for name in ("c", "a", "b"):
        shutil.copy(place / "log.csv", place / "runs" / f"{name}.csv")
    assert run("identify", "runs/*.csv", "log.csv", "--robot", "arm.toml") == 130
    assert seen == [["runs/a.csv", "runs/b.csv", "runs/c.csv", "log.csv"]]
    named = "bayesid.cli.commands.identify.check_result_folder"
    monkeypatch.setattr(named, lambda folder: seen.append(folder.name) or folder)
    assert run("identify", "runs/*.csv", "--robot", "arm.toml") == 130
    assert seen[1] == "bayesid-a"


def test_logs_that_cannot_be_named_so(place, refused):
    """A pattern without a file, a log named twice, and a result in the folder of a log that a pattern names."""
    (place / "runs").mkdir()
    shutil.copy(place / "log.csv", place / "runs" / "a.csv")
    refused(*identify("runs/*.txt"), says=["runs/*.txt", "matches no file"])
    refused("identify", "log.csv", "log.csv", "--robot", "arm.toml", says=["log.csv", "twice"])
    refused("identify", "runs/*", "runs/a.csv", "--robot", "arm.toml", says=["runs/a.csv", "twice"])
    (place / "runs" / "summary.json").touch()
    (place / "runs" / "a.csv").rename(place / "runs" / "log.csv")
    refused(*identify("runs/l*", out="runs"), says=["runs", "holds the log"])


def test_an_option_that_is_no_budget(place, refused):
    refused(*identify(), "--search-budget", "-1", says=["--search-budget", "-1"])
    refused(*identify(), "--search-budget", "nan", says=["--search-budget", "nan"])


def test_no_time_to_sample_is_said_aloud(place, capfd):
    assert run(*identify(), "--quiet", "--posterior-budget", 0, "--no-report") == 0
    assert "has not converged" in capfd.readouterr().err


def test_without_a_posterior_none_is_written(place, capfd):
    assert run(*identify(), "--no-posterior") == 0
    assert {path.name for path in (place / "out").iterdir()} == RESULT | {"report.html"}
    out = capfd.readouterr().out
    assert out.splitlines()[3].startswith("posterior: no posterior was sampled")
    assert json.loads((place / "out" / "summary.json").read_text())["posterior"] is None


def test_the_terminal_says_of_the_posterior_what_the_summary_does(shop, capfd):
    result = json.loads((shop / "result" / "summary.json").read_text())["posterior"]
    printed = (shop / "terminal.txt").read_text().splitlines()[3]
    figures = f"R-hat {result['max_rhat']:.3f}, effective sample size {result['min_ess']:.0f}, at worst"
    assert printed == f"posterior: converged: {figures}; {result['seconds']:.1f} s"
    assert result["converged"] is True
    assert result["seed"] == 7


def test_the_same_seed_gives_the_same_files(shop, place):
    """Sampled twice until it has converged."""
    assert run(*identify(), "--quiet", "--seed", 7, "--no-report") == 0
    for name in ("coefficients.csv", "parameters.csv", "segments.csv", "signed_log.csv", "model.toml", "robot.urdf"):
        assert (place / "out" / name).read_bytes() == (shop / "result" / name).read_bytes(), name


def test_nominal_values_are_believed(place):
    """The first link's mass leaves no trace in the efforts; a parameters.csv with an sd in one line alone will do."""
    (place / "cad.csv").write_text("name,unit,mean,sd\nm1,kg,27.0,0.5\nm2,kg,3.0,\n")
    assert run(*identify(), "--quiet", "--posterior-budget", 0, "--no-report", "--nominal", "cad.csv") == 0
    found = {row["name"]: row for row in rows(place / "out" / "parameters.csv")}
    assert float(found["m1"]["mean"]) == pytest.approx(27.0, abs=0.5)
    assert float(found["m1"]["sd"]) == pytest.approx(0.5, rel=0.5)
    prior = json.loads((place / "out" / "summary.json").read_text())["posterior"]["prior_sd"]
    assert prior["m1"] == 0.5
    assert prior["m2"] == prior["m3"] > 1.0, "any link's, by the robot's lengths and efforts"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name,mean,sd\nm9,1.0,0.1\n", ["'m9'"]),
        ("name,mean,sd\nm2,1.0,-0.1\n", ["m2"]),
        ("name,mean,sd\nm2,heavy,0.1\n", ["cad.csv, line 2", "'heavy'"]),
        ("name,value\nm2,1.0\n", ["cad.csv", "sd"]),
        ("", ["cad.csv", "columns"]),
        (None, ["cad.csv", "read"]),
    ],
)
def test_nominal_values_that_cannot_be_used(place, refused, text, says):
    if text is not None:
        (place / "cad.csv").write_text(text)
    refused(*identify(), "--nominal", "cad.csv", says=says)


def test_damaged_draws_are_not_taken_for_none(shop, place, refused):
    shutil.copytree(shop / "result", place / "result")
    whole = (place / "result" / "posterior.nc").read_bytes()
    (place / "result" / "posterior.nc").write_bytes(whole[:5000])
    refused("validate", "result", "log.csv", "--out", "out", says=["posterior.nc", "damaged"])


def test_without_out_the_folder_is_called_after_the_log(place):
    assert run("identify", "log.csv", "--robot", "arm.toml", "--no-posterior", "--seed", 5, "--search", "beam") == 0
    assert {path.name for path in (place / "bayesid-log").iterdir()} == RESULT | {"report.html"}


def test_the_signs_are_right(shop):
    signed, truth = (rows(shop / name) for name in ("result/signed_log.csv", "log_signed.csv"))
    for j in range(1, 4):
        effort, found = (np.array([float(row[f"tau{j}"]) for row in table]) for table in (truth, signed))
        strong = np.abs(effort) > 0.05 * np.abs(effort).max()
        np.testing.assert_array_equal(np.abs(found), np.abs(effort))
        assert np.mean(np.sign(found) == np.sign(effort), where=strong) > 0.999


@contextmanager
def no_large_files(size):
    """A disk on which no file grows beyond a size, bytes: writing more fails in the middle of the file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("options", [(), ("--cutoff", 12, "--beam-width", 3, "--initial-segments", 3)])
def test_quiet_prints_nothing(place, capfd, options):
    assert run(*identify(), *QUICK, *options) == 0
    out, err = capfd.readouterr()
    assert out == ""
    assert all(line.startswith("warning: ") for line in err.splitlines())


def test_warnings_go_to_stderr_and_into_the_summary(shop, place, capfd):
    """Rotor inertias and offsets of a robot that has none are on the edge, or the links are."""
    assert run(*identify(), *QUICK, "--terms", "rigid_body, viscous_friction") == 0
    err = capfd.readouterr().err
    summary = json.loads((place / "out" / "summary.json").read_text())
    assert err == "".join(f"warning: {warning}\n" for warning in summary["warnings"])
    assert summary["terms"] == ["rigid_body", "viscous_friction"]


def test_options_reach_the_identification(place, monkeypatch):
    seen = {}

    def spy(*arguments, **named):
        seen.update(zip(("robot", "log"), arguments, strict=True), **named)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesid.cli.commands.identify.identify", spy)
    options = "--unsigned", "1,3", "--beam-width", 7, "--initial-segments", 4, "--cutoff", "11.5"
    options += "--search", "beam", "--search-budget", 2.5, "--posterior-budget", 3.5, "--seed", 8
    options += "--nominal", "cad.csv"
    (place / "cad.csv").write_text("name,mean,sd\nm2,1.5,0.25\n")
    assert run(*identify(), "--terms", "rigid_body,torque_offset", *options) == 130
    assert (seen["robot"].origin.source, seen["terms"]) == ("arm.toml", ["rigid_body", "torque_offset"])
    assert seen["search"] == bayesid.Beam(width=7, initial_segments=4, budget=2.5)
    assert seen["preparation"] == bayesid.Preparation(cutoff=11.5)
    assert seen["posterior"] == bayesid.Sampling(budget=3.5, seed=8)
    assert seen["beliefs"].nominal == {"m2": (1.5, 0.25)}
    assert seen["log"].signed.tolist() == [False, True, False]
    assert run(*identify(), "--search-budget", 2.5, "--beam-width", 3, "--repeatable") == 130
    assert seen["search"] == bayesid.Certified(budget=2.5, fallback=bayesid.Beam(width=3), repeatable=True)
    assert seen["posterior"] == bayesid.Sampling(repeatable=True)
    assert run(*identify(), "--no-posterior") == 130
    assert (seen["posterior"], dict(seen["beliefs"].nominal), seen["search"]) == (False, {}, bayesid.Certified())


def test_currents_need_gains(place, refused):
    text = (place / "log.csv").read_text().replace("tau", "i")
    (place / "currents.csv").write_text(text)
    refused(*identify("currents.csv"), says=["currents.csv", "gains"])
    assert run(*identify("currents.csv"), "--gains", "2,2,2", *QUICK) == 0
    effort, measured = rows(place / "out" / "signed_log.csv"), rows(place / "currents.csv")
    assert all(abs(float(a["tau2"])) == 2 * float(b["i2"]) for a, b in zip(effort, measured, strict=True))


def test_validate_prints_a_table(shop, place, capfd):
    assert run("validate", shop / "result", shop / "log_signed.csv") == 0
    out, err = capfd.readouterr()
    assert err == ""
    *figures, held = out.splitlines()
    assert "in the 95 % band" in figures[0]
    assert held == "the band holds parameters and noise, by the posterior"
    assert [line.split()[0] for line in figures[1:]] == ["1", "2", "3"]
    shares = [float(line.rstrip("%").split()[-1]) for line in figures[1:]]
    assert all(90.0 < share < 99.0 for share in shares), "its own log"
    assert set(everything(place)) == {place.joinpath(name).relative_to(place) for name in ("arm.toml", "log.csv")}


def test_validate_on_its_own_log_agrees_with_identify(shop, place):
    """But for the posterior's mean, which is not where least squares is: by a fraction of the standard deviations."""
    assert run("validate", shop / "result", "log.csv", "--out", "checked") == 0
    assert {path.name for path in (place / "checked").iterdir()} == {"summary.json", "signed_log.csv", "prediction.csv"}
    found = json.loads((place / "checked" / "summary.json").read_text())["relative_residual"]
    expected = json.loads((shop / "result" / "summary.json").read_text())["fit"]["relative_residual"]
    np.testing.assert_allclose(found, expected, rtol=0.2)


def test_simulate_leaves_the_log_and_its_signs(place, capfd):
    options = "--duration", 2, "--rate", 50, "--noise", 0, "--effect", "coulomb_friction:2:0.2", "--seed", 4
    assert run("simulate", "--robot", "arm.toml", "--out", "new/s.csv", *options) == 0
    assert {path.name for path in (place / "new").iterdir()} == {"s.csv", "s_signed.csv"}
    assert capfd.readouterr().out.count("\n") == 1
    log, signed = bayesid.read_log(place / "new/s.csv"), bayesid.read_log(place / "new/s_signed.csv")
    assert len(log) == 101
    assert not log.signed.any()
    assert signed.signed.any()
    np.testing.assert_array_equal(log.effort, np.abs(signed.effort))


def test_simulate_does_what_the_seed_says(place):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert run("simulate", "--robot", "arm.toml", "--duration", 2, "--seed", seed, "--out", f"{name}.csv") == 0
    a, b, c = ((place / f"{name}.csv").read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_a_urdf_robot(place, capfd):
    """Two joints that turn and one that slides, fixed joints between them."""
    (place / "odd.urdf").write_text(urdf_text())
    assert run("simulate", "--robot", "odd.urdf", "--duration", 6, "--out", "odd.csv") == 0
    assert run(*identify("odd_signed.csv", "odd.urdf"), *QUICK) == 0
    assert run("validate", "out", "odd.csv") == 0
    assert capfd.readouterr().out.endswith("the band holds parameters and noise, by the information matrix\n")


def test_demo_is_the_papers_experiment(shop, place, capfd):
    """With as few draws as there can be; the result of an earlier demo is replaced."""
    shutil.copytree(shop / "result", place / "bayesid-demo")
    (place / "bayesid-demo" / "log.csv").write_text("of the earlier demo")
    assert run("demo", "--seed", 1, "--posterior-budget", 0) == 0
    out, _ = capfd.readouterr()
    left = {path.name for path in (place / "bayesid-demo").iterdir()}
    assert left == RESULT | {"log.csv", "posterior.nc", "report.html"}
    assert bayesid.load_model(place / "bayesid-demo").model.robot.name != "arm"
    assert len(bayesid.read_log(place / "bayesid-demo" / "log.csv")) == 667
    assert "0 of " in out
    assert "segments above 5 % have the wrong sign" in out
    true, measured = (
        next(x for x in out.splitlines() if x.startswith(f"  against {what}")) for what in ("the", "meas")
    )
    shown = bayesid.read_findings(place / "bayesid-demo").prediction.relative_residual
    assert measured.split(":")[1].split() == [f"{share:.2%}" for share in shown]
    assert all(float(error[:-1]) < 2.0 for error in true.split(":")[1].split())
    assert sum(line.lstrip()[:2].strip().isdigit() for line in out.splitlines()) >= 27


def test_as_a_program(shop, tmp_path):
    """The whole of it in a process of its own: what the libraries below print would show up here."""

    def program(*arguments):
        command = [sys.executable, "-m", "bayesid.cli", *map(str, arguments)]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    version = program("--version")
    assert (version.returncode, version.stdout, version.stderr) == (0, f"bayesid {bayesid.__version__}\n", "")
    result = program("validate", shop / "result", shop / "log_signed.csv")
    assert (result.returncode, result.stderr) == (0, "")
    (tmp_path / "bad.urdf").write_text('<robot name="x"><link name="a"/><link name="b"/></robot>')
    bad = program("identify", shop / "log.csv", "--robot", "bad.urdf")
    assert (bad.returncode, bad.stdout, bad.stderr.count("\n")) == (2, "", 1)
    assert bad.stderr.startswith("bayesid: bad.urdf: ")
    assert [path.name for path in tmp_path.iterdir()] == ["bad.urdf"]


def test_an_identification_imports_what_it_uses(place):
    arguments = [*identify(), *QUICK]
    script = (
        f"import json, sys\nfrom bayesid.cli import main\nmain({arguments!r})\nprint(json.dumps(list(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not {name.partition(".")[0] for name in json.loads(done.stdout)} & UNUSED
    assert (place / "out" / "summary.json").is_file()


# ---------------------------------------------------------------------------------------------------------------
# Bad logs
# ---------------------------------------------------------------------------------------------------------------
def cell(row, column, value):
    """Another value in a row (the header is row 1) and column."""

    def edit(table):
        table[row - 1][table[0].index(column)] = value

    return edit


def still(column, value):
    """A column, or all of a kind."""

    def edit(table):
        for k in [k for k, name in enumerate(table[0]) if name.rstrip("123") == column or name == column]:
            for i, row in enumerate(table[1:]):
                row[k] = value(i)

    return edit


def without(column):
    def edit(table):
        place = table[0].index(column)
        for row in table:
            del row[place]

    return edit


def twice(column):
    def edit(table):
        place = table[0].index(column)
        for row in table:
            row.append(row[place])

    return edit


def cut(table):
    del table[-1][3:]


BAD_LOGS = {
    **{f"no {c}": (without(c), ["row 1", f"column {c}", "missing"]) for c in ("t", "q1", "q2", "tau1", "tau3")},
    "no q3": (without("q3"), ["row 1", "column tau3", "no q"]),
    **{f"two {c}": (twice(c), ["row 1", f"column {c}", "twice"]) for c in ("t", "q2", "tau3")},
    "text": (cell(18, "q2", "hello"), ["row 18", "q2", "'hello'"]),
    "empty cell": (cell(18, "tau2", ""), ["row 18", "tau2", "''"]),
    "nan": (cell(20, "tau2", "nan"), ["row 20", "tau2", "nan"]),
    "nan in t": (cell(20, "t", "nan"), ["row 20", "t", "nan"]),
    "inf": (cell(21, "q3", "inf"), ["row 21", "q3", "inf"]),
    "-inf": (cell(21, "tau1", "-inf"), ["row 21", "tau1", "-inf"]),
    "1e400": (cell(602, "tau1", "1e400"), ["row 602", "tau1", "inf"]),
    "1e280": (cell(2, "q1", "1e280"), ["row 2", "q1", "1e+280"]),
    "1e280 in t": (cell(300, "t", "1e280"), ["row 300", "1e+280"]),
    "truncated": (cut, ["row 602", "3 values"]),
    "too long a row": (lambda table: table[40].append("1.0"), ["row 41", "8 values"]),
    "backwards": (cell(102, "t", "0.5"), ["row 102", "backwards", "0.5"]),
    "one second over and over": (still("t", lambda i: "1.0"), ["time never advances"]),
    "too few": (lambda table: table.__delitem__(slice(31, None)), ["30 rows"]),
    "header only": (lambda table: table.__delitem__(slice(1, None)), ["0 rows"]),
    "nothing": (list.clear, ["header"]),
    "constant joints": (still("q", lambda i: "0.5"), ["positions", "constant"]),
    "no motion": (still("q", lambda i: f"{0.5 + 1e-7 * (i % 2)}"), ["no joint moves"]),
    "no effort": (still("tau", lambda i: "0.0"), ["efforts", "zero"]),
}


@pytest.mark.parametrize("name", BAD_LOGS)
def test_bad_logs(name, place, refused):
    edit, says = BAD_LOGS[name]
    table = [line.split(",") for line in (place / "log.csv").read_text().splitlines()]
    edit(table)
    (place / "bad.csv").write_text("".join(",".join(row) + "\n" for row in table))
    refused(*identify("bad.csv"), says=["bad.csv", *says])


@pytest.mark.parametrize("command", [identify, lambda log: ("validate", "result", log)])
def test_logs_that_are_no_logs(shop, place, refused, command):
    shutil.copytree(shop / "result", place / "result")
    (place / "binary.csv").write_bytes(np.random.default_rng(0).bytes(4000))
    (place / "zeros.csv").write_bytes(bytes(1000))
    (place / "picture.csv").write_bytes((place / "log.csv").read_bytes()[:2000] + b"\xff\xd8\x00" * 100)
    (place / "empty.csv").touch()
    for log in ("nowhere.csv", "no/where.csv", "result", "binary.csv", "zeros.csv", "picture.csv", "empty.csv"):
        refused(*command(log), says=[log])


# ---------------------------------------------------------------------------------------------------------------
# Bad robots
# ---------------------------------------------------------------------------------------------------------------
BAD_ROBOTS = {
    "one joint too few": ("arm.toml", ARM[: ARM.rindex("[[")], ["3 joints", "arm has 2"]),
    "no a": ("x.toml", ARM.replace("a = 0.15", ""), ["x.toml", "joint 2", "'a'", "missing"]),
    "no joints": ("x.toml", ARM[: ARM.index("[[")], ["x.toml", "'joints'", "missing"]),
    "no convention": ("x.toml", ARM.replace("convention", "konvention"), ["x.toml", "'convention'", "missing"]),
    "other convention": ("x.toml", ARM.replace("modified", "odd"), ["x.toml", "convention 'odd'"]),
    "text for a number": ("x.toml", ARM.replace("0.15", '"far"'), ["x.toml", "joint 2", "'a'"]),
    "infinite length": ("x.toml", ARM.replace("0.15", "inf"), ["x.toml", "joint 2", "'a'"]),
    "joint of another type": ("x.toml", ARM + 'type = "screw"', ["x.toml", "joint 3", "'screw'"]),
    "gravity of two numbers": ("x.toml", "gravity = [0, 1]\n" + ARM, ["x.toml", "'gravity'"]),
    "singular transmission": ("x.toml", f"transmission = {[[1, 0, 0]] * 3}\n" + ARM, ["x.toml", "'transmission'"]),
    "not toml": ("x.toml", "a = = b", ["x.toml", "not valid TOML"]),
    "broken xml": ("x.urdf", "<robot><link>", ["x.urdf", "URDF"]),
    "text": ("x.urdf", "a robot", ["x.urdf", "URDF"]),
    "another xml": ("x.urdf", "<html/>", ["x.urdf", "<html>"]),
    "no links": ("x.urdf", '<robot name="x"/>', ["x.urdf", "0 links"]),
    "a loop": ("x.urdf", urdf_text().replace('child link="part7"', 'child link="part2"'), ["x.urdf", "two joints"]),
    "a planar joint": ("x.urdf", urdf_text().replace("continuous", "planar"), ["odd has 2", "joint j1 is planar"]),
    "a zero axis": ("x.urdf", urdf_text().replace("0.0 3.0 4.0", "0 0 0"), ["x.urdf", "j1", "axis"]),
}


@pytest.mark.parametrize("name", BAD_ROBOTS)
def test_bad_robots(name, place, refused):
    file, text, says = BAD_ROBOTS[name]
    (place / file).write_text(text)
    refused(*identify(robot=file), says=says)


@pytest.mark.parametrize("command", [identify, lambda robot: ("simulate", "--robot", robot, "--out", "s.csv")])
def test_robots_that_are_no_robots(place, refused, command):
    (place / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (place / "binary.urdf").write_bytes(b"\xff\xfe\x00")
    for robot in ("r2d2", "nowhere.toml", str(place), "binary.toml", "binary.urdf"):
        refused(*command(robot=robot), says=[robot])


def test_the_wrong_robot(refused):
    refused(*identify(robot="kr5"), says=["log.csv", "3 joints", "has 6"])


# ---------------------------------------------------------------------------------------------------------------
# Bad options
# ---------------------------------------------------------------------------------------------------------------
BAD_OPTIONS = [
    ("--search=guess", ["--search", "'guess'"]),
    ("--terms=rigid_body,magic", ["--terms", "'magic'"]),
    ("--terms=rigid_body,rigid_body", ["--terms", "'rigid_body'", "twice"]),
    ("--terms=rigid_body,torque_offset,torque_offset", ["--terms", "'torque_offset'", "twice"]),
    ("--terms=rigid_body,", ["--terms", "''"]),
    ("--terms=", ["--terms", "rigid_body", "missing"]),
    ("--terms=viscous_friction", ["--terms", "rigid_body", "missing"]),
    ("--gains=1,2,3", ["log.csv", "gains"]),
    ("--gains=1,two,3", ["--gains", "'1,two,3'"]),
    ("--gains=", ["--gains", "''"]),
    *(
        (f"--unsigned={value}", ["--unsigned", repr(word)])
        for value, word in (
            ("", ""),
            ("0", "0"),
            ("4", "4"),
            ("some", "some"),
            ("1,,2", ""),
            ("-1", "-1"),
            ("1.5", "1.5"),
            ("1,9", "9"),
        )
    ),
    *((f"--cutoff={value}", ["--cutoff", value]) for value in ("0", "-3", "50.5", "1000", "nan", "inf", "high")),
    *((f"--beam-width={value}", ["--beam-width", value]) for value in ("0", "-2", "1.5", "wide")),
    *((f"--initial-segments={value}", ["--initial-segments", value]) for value in ("0", "-2", "13", "1.5", "few")),
    *((f"--seed={value}", ["--seed", value]) for value in ("-1", "1.5", "lucky")),
    *((f"--posterior-budget={value}", ["--posterior-budget", value]) for value in ("-1", "nan", "inf", "long")),
    ("--robots=ur10e", ["--robots"]),
]


@pytest.mark.parametrize(("option", "says"), BAD_OPTIONS, ids=[option for option, _ in BAD_OPTIONS])
def test_bad_options(option, says, refused):
    refused(*identify(), option, says=says)


@pytest.mark.parametrize(
    ("gains", "says"),
    [("1,2", "2 gains"), ("1,0,2", "zero"), ("1,nan,2", "finite"), ("1,inf,2", "finite"), ("1;2;3", "'1;2;3'")],
)
def test_bad_gains(place, refused, gains, says):
    (place / "currents.csv").write_text((place / "log.csv").read_text().replace("tau", "i"))
    refused(*identify("currents.csv"), "--gains", gains, says=["--gains", says])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "COMMAND"),
        (("identity", "log.csv"), "'identity'"),
        (("identify",), "log"),
        (("identify", "log.csv"), "--robot"),
        (("identify", "log.csv", "--robot"), "--robot"),
        (("validate", "result"), "log"),
        (("simulate", "--robot", "kr5"), "--out"),
        (("demo", "more"), "more"),
    ],
)
def test_bad_commands(refused, arguments, says):
    refused(*arguments, says=[says])


@pytest.mark.parametrize(
    ("arguments", "nearest"),
    [
        (("identfy", "log.csv"), "identify"),
        (("identify", "log.csv", "--robt", "kr5"), "--robot"),
        (("identify", "log.csv", "--seach=beam"), "--search"),
        (("demo", "--no-degree"), None),
        (("excite", "--no-degress", "--robot", "kr5"), "--no-degrees"),
        (("study", "nois"), "noise"),
        (("identify", "log.csv", "--robot", "kr5", "--search", "certifed"), "certified"),
        (("--versoin",), "--version"),
    ],
)
def test_a_mistyped_name_suggests_the_nearest(refused, capfd, arguments, nearest):
    refused(*arguments, says=[f"did you mean {nearest}?"] if nearest else ["there is no option --no-degree"])


def test_the_default_terms_are_the_catalogues():
    """The parser spells them out, so that it need not import the catalogue."""
    assert tuple(parse(["identify", "log.csv", "--robot", "kr5"]).terms.split(",")) == STANDARD


# ---------------------------------------------------------------------------------------------------------------
# Places that cannot be written
# ---------------------------------------------------------------------------------------------------------------
WRITERS = {
    "identify": ("identify", "log.csv", "--robot", "arm.toml", "--out"),
    "validate": ("validate", "result", "log.csv", "--out"),
    "demo": ("demo", "--out"),
}


@pytest.mark.parametrize("command", WRITERS.values(), ids=WRITERS)
def test_out_must_be_new_or_an_earlier_result(shop, place, refused, command):
    shutil.copytree(shop / "result", place / "result")
    (place / "full").mkdir()
    (place / "full" / "thesis.tex").touch()
    refused(*command, "full", says=["full", "other files", "thesis.tex"])
    refused(*command, "log.csv", says=["log.csv", "not a folder"])
    refused(*command, "log.csv/out", says=["log.csv/out", "not a folder"])
    refused(*command, ".", says=["."])
    (place / "result" / "notes.txt").touch()
    refused(*command, "result", says=["result", "other files"])


def test_a_validation_never_replaces_the_result(shop, place, refused):
    shutil.copytree(shop / "result", place / "result")
    refused("validate", "result", "log.csv", "--out", "result", says=["result", "other files"])


def test_a_result_never_replaces_its_own_log(shop, place, refused):
    """As in `bayesid identify bayesid-demo/log.csv --out bayesid-demo`."""
    shutil.copytree(shop / "result", place / "result")
    shutil.copy(place / "log.csv", place / "result")
    refused(*identify("result/log.csv", out="result"), says=["result", "holds the log"])


def test_simulate_needs_a_place_for_a_file(place, refused):
    (place / "folder").mkdir()
    for out, says in (("folder", "folder"), (".", "folder"), ("log.csv/s.csv", "not a folder"), ("", "folder")):
        refused("simulate", "--robot", "arm.toml", "--duration", 2, "--out", out, says=[says])


def test_an_earlier_result_is_replaced_whole(shop, place):
    shutil.copytree(shop / "result", place / "out")
    (place / "out" / "report.html").write_text("of the earlier result")
    assert run(*identify(), "--terms", "rigid_body,viscous_friction", *QUICK) == 0
    assert {path.name for path in (place / "out").iterdir()} == RESULT
    assert json.loads((place / "out" / "summary.json").read_text())["terms"] == ["rigid_body", "viscous_friction"]
    assert {path.name for path in place.iterdir()} == {"arm.toml", "log.csv", "out"}


def test_a_run_that_fails_leaves_the_earlier_result(shop, place, refused, capfd):
    shutil.copytree(shop / "result", place / "out")
    refused(*identify("nowhere.csv"), says=["nowhere.csv"])
    refused(*identify(), "--cutoff", "900", says=["--cutoff"])
    before = everything(place)
    with no_large_files(20_000):
        assert run(*identify(), *QUICK) == 2
    assert "File too large" in capfd.readouterr().err
    assert everything(place) == before


@pytest.mark.parametrize(
    ("fault", "code", "says"),
    [
        (SolverError("cone least squares", "MaxIterations"), 1, "MaxIterations"),
        (OSError(5, "Input/output error"), 1, "Input/output error"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_faults_have_their_own_codes(place, monkeypatch, capfd, fault, code, says):
    def fail(*_, **__):
        raise fault

    monkeypatch.setattr("bayesid.cli.commands.identify.identify", fail)
    before = everything(place)
    assert run(*identify()) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
    assert everything(place) == before


# ---------------------------------------------------------------------------------------------------------------
# validate
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture
def edit_model(shop, place):
    """Writes result/model.toml with something changed in it."""

    def edit(change):
        shutil.copytree(shop / "result", place / "result", dirs_exist_ok=True)
        path = place / "result" / "model.toml"
        content = tomllib.loads(path.read_text())
        change(content)
        path.write_text(tomli_w.dumps(content))

    return edit


def test_validate_needs_a_result(shop, place, refused):
    (place / "empty").mkdir()
    for folder in ("nowhere", "empty", "log.csv"):
        refused("validate", folder, "log.csv", says=[folder, "model.toml"])
    (place / "odd" / "model.toml").mkdir(parents=True)
    refused("validate", "odd", "log.csv", says=["odd"])


NO_MODELS = [b"gar = = bage", b"\xff\xfe\x00", b"", b"robot = 1\nterms = 1\nvalues = 1\nnoise = 1"]


@pytest.mark.parametrize("content", NO_MODELS)
def test_validate_with_a_model_file_that_is_none(place, refused, content):
    (place / "result").mkdir()
    (place / "result" / "model.toml").write_bytes(content)
    refused("validate", "result", "log.csv", "--out", "out", says=["model.toml"])


def test_validate_with_half_a_model_file(shop, place, refused):
    (place / "result").mkdir()
    content = (shop / "result" / "model.toml").read_bytes()
    for size in (len(content) // 4, len(content) // 2, len(content) - 30):
        (place / "result" / "model.toml").write_bytes(content[:size])
        refused("validate", "result", "log.csv", says=["model.toml"])


@pytest.mark.parametrize("key", ["robot", "terms", "values", "noise"])
def test_validate_with_a_key_missing(edit_model, refused, key):
    edit_model(lambda content: content.pop(key))
    refused("validate", "result", "log.csv", says=["model.toml", f"'{key}'", "missing"])


def test_validate_with_a_value_missing_or_wrong(edit_model, refused):
    edit_model(lambda content: content["values"].pop("J2xy"))
    refused("validate", "result", "log.csv", says=["model.toml", "'J2xy'", "missing"])
    edit_model(lambda content: content["values"].update(J2xy="heavy"))
    refused("validate", "result", "log.csv", says=["model.toml", "'heavy'"])
    edit_model(lambda content: content["values"].update(J2xy=float("nan")))
    refused("validate", "result", "log.csv", says=["model.toml", "not finite"])


def test_validate_with_an_unknown_term(edit_model, refused):
    edit_model(lambda content: content["terms"][1].update(name="magic"))
    refused("validate", "result", "log.csv", says=["model.toml", "'magic'"])


def test_validate_with_a_log_of_another_robot(shop, place, refused):
    shutil.copytree(shop / "result", place / "result")
    columns = [line.split(",") for line in (place / "log.csv").read_text().splitlines()]
    (place / "two.csv").write_text("".join(",".join(row[:3] + row[4:6]) + "\n" for row in columns))
    refused("validate", "result", "two.csv", says=["two.csv", "2 joints", "arm has 3"])


@pytest.mark.parametrize(
    ("option", "says"),
    [("--cutoff=900", "--cutoff"), ("--cutoff=x", "--cutoff"), ("--gains=1,2,3", "gains"), ("--unsigned=9", "'9'")],
)
def test_validate_with_bad_options(shop, place, refused, option, says):
    shutil.copytree(shop / "result", place / "result")
    refused("validate", "result", "log.csv", option, "--out", "out", says=[says])


# ---------------------------------------------------------------------------------------------------------------
# simulate and demo
# ---------------------------------------------------------------------------------------------------------------
BAD_SIMULATIONS = [
    *(
        f"--effect={value}"
        for value in (
            "",
            "friction",
            "magic:1:0.1",
            "viscous_friction:0:0.1",
            "viscous_friction:4:0.1",
            "viscous_friction:one:0.1",
            "viscous_friction:1:much",
            "viscous_friction:1:-0.1",
            "viscous_friction:1:nan",
            "viscous_friction:1:inf",
            "rigid_body:1:0.1",
            "viscous_friction:1",
            "viscous_friction:1:0.1:2",
        )
    ),
    *(f"--duration={value}" for value in ("0", "-1", "0.5", "nan", "inf", "long")),
    *(f"--rate={value}" for value in ("0", "-1", "5", "nan", "inf", "fast")),
    *(f"--noise={value}" for value in ("-0.1", "nan", "inf", "loud")),
    *(f"--seed={value}" for value in ("-1", "1.5", "lucky")),
]


@pytest.mark.parametrize("option", BAD_SIMULATIONS)
def test_bad_simulations(refused, option):
    name, _, value = option.partition("=")
    refused("simulate", "--robot", "arm.toml", "--out", "s.csv", option, says=[name, value])


def test_demo_with_a_bad_seed(refused):
    refused("demo", "--seed", "-1", says=["--seed"])


# ---------------------------------------------------------------------------------------------------------------
# report, completion, and what all commands share
# ---------------------------------------------------------------------------------------------------------------
EVERY = (*COMMANDS, "predict", "discrepancy", "payload", "report", "excite", "study", "completion")


@pytest.fixture
def result_here(shop, place):
    """The result folder, to be changed."""
    shutil.copytree(shop / "result", place / "result")
    return place / "result"


def test_report_is_made_anew_with_a_validation(result_here, place, capfd):
    """A page with the new log in it; the folder keeps what it shows, and the next report shows it again."""
    others = everything(result_here)
    assert run("report", "result", "--validation", "log.csv", "--out", "to_send.html") == 0
    out, err = capfd.readouterr()
    assert "in the 95 % band" in out
    assert out.endswith("written to to_send.html\n")
    assert err == ""
    text = (place / "to_send.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert "log.csv. The band accounts for" in text
    changed = {path for path, content in everything(result_here).items() if others.get(path) != content}
    assert {path.name for path in changed} == {"findings.npz"}
    assert bayesid.report.findings.read_findings("result").prediction.source == "log.csv"


def test_report_replaces_that_of_the_folder(result_here, place, capfd):
    (result_here / "report.html").write_text("an old one")
    assert run("report", "result") == 0
    assert (result_here / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert capfd.readouterr() == ("written to result/report.html\n", "")
    assert {path.name for path in place.iterdir()} == {"arm.toml", "log.csv", "result"}
    assert not list(result_here.glob(".*"))


def test_folders_above_a_report_are_made(result_here, place, capfd):
    assert run("report", "result", "--out", "to/send/report.html") == 0
    assert capfd.readouterr().out == "written to to/send/report.html\n"
    assert (place / "to" / "send" / "report.html").is_file()


def test_a_report_that_cannot_be_made(result_here, place, refused):
    (place / "folder").mkdir()
    refused("report", "nowhere", says=["nowhere", "no summary.json"])
    refused("report", "result", "--out", "folder", says=["folder", "is a folder"])
    refused("report", "result", "--out", "log.csv/report.html", says=["log.csv"])
    refused("report", "result", "--validation", "no.csv", says=["no.csv"])
    refused("report", "result", "--validation", "log.csv", "--cutoff", "900", says=["--cutoff"])
    (result_here / "findings.npz").write_bytes((result_here / "findings.npz").read_bytes()[:-100])
    refused("report", "result", says=["result", "cannot be read"])
    (result_here / "findings.npz").unlink()
    refused("report", "result", says=["result", "no findings.npz"])


def test_a_report_that_fails_leaves_the_old_one(result_here, place, capfd):
    (result_here / "report.html").write_text("an old one")
    before = everything(place)
    with no_large_files(20_000):
        assert run("report", "result") == 2
    assert "File too large" in capfd.readouterr().err
    assert everything(place) == before


def test_identify_without_a_report(place):
    assert run(*identify(), *QUICK) == 0
    assert not (place / "out" / "report.html").exists()
    assert run("report", "out", "--quiet") == 0
    assert (place / "out" / "report.html").exists()


def test_quiet_commands_print_nothing(result_here, place, capfd):
    for arguments in (
        ("validate", "result", "log.csv", "--out", "validation"),
        ("report", "result"),
        ("report", "result", "--validation", "log.csv"),
        ("simulate", "--robot", "arm.toml", "--duration", 2, "--out", "s.csv"),
    ):
        assert run(*arguments, "--quiet") == 0
        assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("command", [one for one in EVERY if one != "completion"])
def test_every_command_can_be_quiet(command, capfd):
    assert run(command, "--help") == 0
    assert "--quiet" in capfd.readouterr().out


@pytest.mark.parametrize("command", ["", *EVERY])
def test_examples_of_the_help_can_be_typed(command, capfd):
    """Each command has some, and all of their words are options that there are."""
    assert run(*([command] if command else []), "--help") == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert all(len(line) <= 120 for line in out.splitlines())
    examples = [line.strip() for line in out.partition("examples:")[2].splitlines() if line.startswith("  bayesid ")]
    assert examples
    for example in examples:
        words = shlex.split(example.partition(" > ")[0])
        assert parse(words[1:]).command == words[1]
        assert words[1] == command or not command


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_names_every_command(shell, capfd):
    assert run("completion", shell) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert all(command in out for command in EVERY)
    assert "--validation" in out


def test_bash_completes(tmp_path, capfd):
    """As a shell would ask: the second word, then an option of a command."""
    assert run("completion", "bash") == 0
    script = tmp_path / "bayesid.sh"
    script.write_text(capfd.readouterr().out)
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("bash is not installed")
    for words, expected in ((["bayesid", "rep"], {"report"}), (["bayesid", "report", "--val"], {"--validation"})):
        asked = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}"
        code = f'source {script}; {asked}; _shtab_bayesid bayesid; echo "${{COMPREPLY[@]}}"'
        done = subprocess.run([bash, "--norc", "-c", code], capture_output=True, text=True, check=True)
        assert set(done.stdout.split()) == expected


def test_completion_for_a_shell_that_is_not_known(refused):
    refused("completion", "abacus", says=["abacus"])
    refused("completion", says=["shell"])
