import json

import numpy as np
import pytest
from saved_results import table

import bayesid
from bayesid.cli import main
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.files.config import CONFIG
from bayesid.log.reading import read_log
from bayesid.robot import robot_from_table
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.study.batch import identify_each

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
OPTIONS = {"terms": TERMS, "search": bayesid.Certified(), "posterior": False, "complete": "off"}
ARM = """convention = "standard"
name = "arm"
joints = [
  {a = 0.0, alpha = 1.5707963267948966, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.0, theta = 0.0},
]
"""


@pytest.fixture(scope="module")
def week(tmp_path_factory):
    """Three logs of one arm; in the last one joint 2 has half as much viscous friction again."""
    place = tmp_path_factory.mktemp("week")
    (place / "arm.toml").write_text(ARM)
    robot = bayesid.load_robot(place / "arm.toml")
    t = np.arange(801) / 100.0
    for k, day in enumerate(("mon", "tue", "wed")):
        motion = random_trajectory(2, 8.0, rng=k).motion(t)
        model = Model(robot, make_terms(TERMS, robot, motion))
        theta = random_parameters(model, rng=np.random.default_rng(5))
        names = [parameter.name for parameter in model.parameters]
        theta[names.index("Fv2")] *= 1.0 if day != "wed" else 1.5
        simulate(model, theta, motion, rng=np.random.default_rng(10 + k), noise=0.05).save(place / f"{day}.csv")
    return place


@pytest.fixture(scope="module")
def separate(week, tmp_path_factory):
    """All three logs, in this process: where the results stand, and what they are."""
    out = tmp_path_factory.mktemp("separate") / "out"
    return out, identify_each(week / "arm.toml", sorted(week.glob("*.csv")), out, workers=0, **OPTIONS)


def test_each_result_is_that_of_its_log_alone(week, separate):
    out, result = separate
    for log, run in zip(sorted(week.glob("*.csv")), result.runs, strict=True):
        alone = bayesid.identify(week / "arm.toml", log, **OPTIONS)
        assert run.error == ""
        assert run.folder == out / log.stem
        assert [row["mean"] for row in run.coefficients] == alone.beta.tolist()
        written = [float(row["mean"]) for row in table(run.folder / "coefficients.csv")]
        np.testing.assert_allclose(written, alone.beta, rtol=1e-7)
        assert json.loads((run.folder / "summary.json").read_text())["n_samples"] == len(read_log(log))
    assert [row["folder"] for row in table(out / "runs.csv")] == ["mon", "tue", "wed"]
    assert len(table(out / "agreement.csv")) == len(alone.beta)


def test_a_change_between_logs_shows_in_the_coefficient_that_changed(separate):
    agreement = separate[1].agreement
    p = dict(zip(agreement.names, agreement.p, strict=True))
    assert p.pop("Fv2") < 1e-6
    assert min(p.values()) > 1e-4


@pytest.mark.long
def test_workers_give_the_same_and_a_table_of_the_robot_will_do(week, separate, tmp_path):
    joints = [{"a": 0.0, "alpha": np.pi / 2, "d": 0.4, "theta": 0.0}, {"a": 0.35, "alpha": 0.0, "d": 0.0, "theta": 0.0}]
    robot = robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "arm")
    logs = [week / "mon.csv", week / "tue.csv"]
    told = []
    options = OPTIONS | {"progress": lambda *call: told.append(call)}
    by_workers = identify_each(robot, logs, tmp_path / "out", workers=2, **options)
    assert (told[0], told[-1]) == (("logs", 0, 2), ("logs", 2, 2))
    for here, there in zip(separate[1].runs, by_workers.runs, strict=False):
        assert not there.error
        assert [row["mean"] for row in here.coefficients] == [row["mean"] for row in there.coefficients]


def test_a_bad_log_is_named_and_the_rest_is_complete(week, tmp_path, capsys):
    (tmp_path / "short.csv").write_text("".join((week / "mon.csv").read_text().splitlines(keepends=True)[:20]))
    out = tmp_path / "out"
    logs = [week / "mon.csv", tmp_path / "short.csv", week / "tue.csv"]
    run = f"--each --robot {week}/arm.toml --terms {','.join(TERMS)} --no-posterior --no-report --complete off"
    code = main(["identify", *map(str, logs), *run.split(), "--workers", "1", "--out", str(out)])
    printed = capsys.readouterr()
    assert code == 2
    assert all(one in printed.err for one in ("short.csv", "too few", "1 of 3 logs"))
    assert "Traceback" not in printed.err
    assert sorted(path.name for path in out.iterdir()) == ["agreement.csv", "mon", "runs.csv", "tue"]
    assert [bool(row["error"]) for row in table(out / "runs.csv")] == [False, True, False]
    assert "2 runs" in printed.out
    assert main(["identify", str(logs[0]), *run.split()[1:], "--out", str(tmp_path / "alone")]) == 0
    for name in ("mon", "tue"):
        assert (out / name / CONFIG).read_text() == (tmp_path / "alone" / CONFIG).read_text(), "options of later logs"


@pytest.mark.parametrize("theirs", ["", "notes.txt", "mon/notes.txt", "mon/mon.csv"])
def test_other_files_are_not_replaced(week, tmp_path, theirs):
    """A file in place of the folder, other files in it, the log itself."""
    place, log = tmp_path / "out" / theirs, week / "mon.csv"
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(log.read_bytes())
    with pytest.raises(bayesid.InputError):
        identify_each(
            week / "arm.toml", [place if place.name == log.name else log], tmp_path / "out", workers=0, **OPTIONS
        )
    assert place.read_bytes() == log.read_bytes()
    assert not (tmp_path / "out" / "runs.csv").exists()


def test_a_bad_robot_or_option_is_named_once(week, tmp_path, capsys):
    for bad, says in ((["--each", "--robot", "nosuch"], "nosuch"), (["--workers", "2", "--robot", "kr5"], "--each")):
        assert main(["identify", f"{week}/mon.csv", *bad, "--out", f"{tmp_path}/out"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert says in line


def test_logs_of_one_name_get_folders_of_their_own(week, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "log.csv").write_text((week / "mon.csv").read_text())
    logs = [tmp_path / "a" / "log.csv", tmp_path / "b" / "log.csv"]
    result = identify_each(week / "arm.toml", logs, tmp_path / "out", workers=0, **OPTIONS)
    assert [run.folder.name for run in result.runs] == ["a-log", "b-log"]
    for wrong, says in (([logs[0], logs[0]], "name"), (["-"], "is a stream")):
        with pytest.raises(bayesid.InputError, match=says):
            identify_each(week / "arm.toml", wrong, tmp_path / "more", workers=0, **OPTIONS)
