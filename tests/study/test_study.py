import json
import os
import pickle
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType

import pytest
from conftest import DATA
from toy_study import (
    FAILS,
    GATES,
    PATIENCE,
    SCENARIOS,
    alive,
    executions,
    gate,
    marks_in,
    toy_client,
    toy_study,
    wait_until,
)

from bayesid import cli, studies
from bayesid.errors import InputError
from bayesid.studies import load
from bayesid.study import runner
from bayesid.study import study as machinery
from bayesid.study.names import STUDIES
from bayesid.study.record import read_rows
from bayesid.study.runner import Outcome
from bayesid.study.study import Finished, in_turn, mixed, run_study

FAILED = 5
"""Number of the trial that fails."""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A run in this process: its folder, and what it gave."""
    folder = tmp_path_factory.mktemp("undisturbed") / "rows"
    return folder, run_study(toy_study(), workers=0, out=folder)


def rows_of(folder):
    return (folder / "rows.parquet").read_bytes()


def refusal(*arguments, **options):
    with pytest.raises(InputError) as error:
        run_study(*arguments, **options)
    assert "\n" not in str(error.value)
    assert error.value.remedy
    return error.value.on_command_line


# ---------------------------------------------------------------------------------------------------------------
# Rows
# ---------------------------------------------------------------------------------------------------------------
def test_a_row_a_trial(undisturbed):
    rows = undisturbed[1].rows
    assert [(row["trial"], row["name"], row["seed"]) for row in rows] == [
        (2 * k + j, scenario.name, k) for k in range(6) for j, scenario in enumerate(SCENARIOS)
    ]
    assert list(rows[0]) == [
        "trial",
        "seed",
        "name",
        "level",
        "window",
        "error",
        "worker_died",
        "draws",
        "sum",
        "grows",
        "absent",
        "positive",
        "empty",
        "timings",
    ]
    assert [row["window"] for row in rows[:2]] == [[1, 2], []]
    assert set(rows[0]["timings"]) == {"trial", "seconds", "worker", "clock"}


def test_rows_hold_nothing_of_the_clock(undisturbed, tmp_path):
    run_study(toy_study(), workers=0, out=tmp_path)
    assert rows_of(tmp_path) == rows_of(undisturbed[0])
    timings = [(folder / "timings.parquet").read_bytes() for folder in (tmp_path, undisturbed[0])]
    assert timings[0] != timings[1]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_same_rows_by_other_processes(undisturbed, tmp_path, workers):
    """test_kill.py says the same of a cluster."""
    found = run_study(toy_study(tmp_path / "marks", nap=0.02), workers=workers, out=tmp_path / "rows")
    assert rows_of(tmp_path / "rows") == rows_of(undisturbed[0])
    assert len({pid for pid, _ in marks_in(tmp_path / "marks")} - {os.getpid()}) == workers
    for here, there in zip(found.rows, undisturbed[1].rows, strict=True):
        assert repr({**here, "timings": 0}) == repr({**there, "timings": 0})


@pytest.mark.parametrize("order", range(8))
def test_the_same_rows_in_whatever_order_they_come(undisturbed, tmp_path, monkeypatch, order):
    def shuffled(*arguments):
        outcomes = [outcome for batch in runner.run(*arguments) for outcome in batch]
        random.Random(order).shuffle(outcomes)
        yield from (outcomes[k : k + 3] for k in range(0, len(outcomes), 3))

    monkeypatch.setattr(machinery, "run", shuffled)
    run_study(toy_study(), workers=0, out=tmp_path)
    assert rows_of(tmp_path) == rows_of(undisturbed[0])


def test_fewer_trials_are_the_first_ones():
    plan = in_turn(SCENARIOS)
    assert plan(7, 3) == plan(100, 3)[:7] == [(SCENARIOS[k % 2], 3 + k // 2) for k in range(7)]


def test_another_seed_gives_other_rows(undisturbed):
    found = run_study(toy_study(), 4, seed=7, workers=0).rows
    assert [row["seed"] for row in found] == [7, 7, 8, 8]
    assert found[0]["sum"] != undisturbed[1].rows[0]["sum"]


# ---------------------------------------------------------------------------------------------------------------
# Trials that fail
# ---------------------------------------------------------------------------------------------------------------
def test_a_failing_trial_is_a_row(undisturbed):
    finished = undisturbed[1]
    row = finished.rows[FAILED]
    assert (row["name"], row["seed"]) == FAILS
    assert (row["error"], row["worker_died"]) == ("ArithmeticError: fails by design", False)
    assert row["sum"] is row["draws"] is row["positive"] is None
    assert finished.failed == [row]
    assert finished.good == [other for other in finished.rows if other is not row]
    assert finished.report.splitlines() == ["11 good rows", "trial 5 failed: ArithmeticError: fails by design"]


def test_a_first_trial_that_fails_does_not_shift_columns(undisturbed, tmp_path):
    def delayed(*arguments):
        outcomes = [outcome for batch in runner.run(*arguments) for outcome in batch]
        yield [outcomes[FAILED]]
        yield [outcome for outcome in outcomes if outcome.index != FAILED]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machinery, "run", delayed)
        run_study(toy_study(), workers=0, out=tmp_path)
    assert rows_of(tmp_path) == rows_of(undisturbed[0])


def test_no_trial_succeeds():
    finished = Finished(toy_study(), run_study(toy_study(), 1, workers=0).rows)
    finished.rows[0]["error"] = "KeyError: 1"
    assert finished.report == "no trial has a result\ntrial 0 failed: KeyError: 1"


def odd(scenario, seed):
    return {"value": [seed, 0.5, "text", 2**70, object(), None][seed]}


def test_a_result_that_no_column_holds_is_an_error_of_its_trial(tmp_path):
    rows = run_study(replace(toy_study(), plan=in_turn(SCENARIOS[:1]), trial=odd), 6, workers=0, out=tmp_path).rows
    assert [row["value"] for row in rows] == [0.0, 0.5, None, None, None, None]
    assert [row["error"][:25] for row in rows] == ["", "", *["the result cannot be kept"] * 3, ""]
    assert read_rows(tmp_path) == rows


def test_a_result_named_like_a_field_is_a_fault_of_the_study():
    with pytest.raises(ValueError, match="named like a field of the scenario: level, seed"):
        run_study(replace(toy_study(), trial=clashing), 1, workers=0)


def clashing(scenario, seed):
    return {"level": 1.0, "seed": 3}


# ---------------------------------------------------------------------------------------------------------------
# Going on
# ---------------------------------------------------------------------------------------------------------------
def test_resumed_it_runs_what_is_missing(undisturbed, tmp_path):
    """The trial that failed is not missing; with more trials, only these are."""
    study, folder = toy_study(tmp_path / "marks"), tmp_path / "rows"
    run_study(study, 7, workers=0, out=folder)
    assert executions(tmp_path / "marks") == dict.fromkeys(range(7), 1)
    calls = []
    run_study(study, workers=0, out=folder, resume=True, progress=lambda *counts: calls.append(counts))
    assert executions(tmp_path / "marks") == dict.fromkeys(range(12), 1)
    assert rows_of(folder) == rows_of(undisturbed[0])
    assert calls == [(done, 12, 1) for done in range(8, 13)]
    finished = run_study(study, 4, workers=0, out=folder, resume=True)
    assert executions(tmp_path / "marks").total() == 12
    assert [row["trial"] for row in finished.rows] == [0, 1, 2, 3]
    assert rows_of(folder) == rows_of(undisturbed[0])


def test_nothing_is_started_when_nothing_is_missing(undisturbed, monkeypatch, tmp_path):
    run_study(toy_study(), 3, workers=0, out=tmp_path)
    monkeypatch.setattr(runner, "Processes", None)
    assert len(run_study(toy_study(), 3, workers=2, out=tmp_path, resume=True).rows) == 3


def test_trials_whose_workers_died_are_tried_again(undisturbed, tmp_path, monkeypatch):
    def deadly(*arguments):
        for batch in runner.run(*arguments):
            lost = [Outcome(one.index, None, "WorkerDied: 3", died=True) for one in batch if one.index in (1, 8)]
            yield [*lost, *(one for one in batch if one.index not in (1, 8))]

    study, folder = toy_study(tmp_path / "marks"), tmp_path / "rows"
    with monkeypatch.context() as patch:
        patch.setattr(machinery, "run", deadly)
        finished = run_study(study, workers=0, out=folder)
    assert [row["trial"] for row in finished.failed] == [1, FAILED, 8]
    assert [row["worker_died"] for row in finished.failed] == [True, False, True]
    (tmp_path / "marks").unlink()
    finished = run_study(study, workers=0, out=folder, resume=True)
    assert [row["trial"] for row in finished.failed] == [FAILED]
    assert executions(tmp_path / "marks") == {1: 1, 8: 1}
    assert rows_of(folder) == rows_of(undisturbed[0])


def test_rows_of_another_run_are_not_resumed(tmp_path):
    run_study(toy_study(), 4, workers=0, out=tmp_path)
    before = rows_of(tmp_path)
    again = {"workers": 0, "out": tmp_path, "resume": True}
    assert "seed of trial 0 was 0" in refusal(toy_study(), 4, 1, **again)
    swapped = replace(toy_study(), plan=in_turn(SCENARIOS[::-1]))
    assert "name of trial 0 was 'low'" in refusal(swapped, 4, **again)
    wider = replace(toy_study(), plan=in_turn([SCENARIOS[0], replace(SCENARIOS[1], window=(3,))]))
    assert "window of trial 1 was []" in refusal(wider, 4, **again)
    assert "rows of study toy, not other" in refusal(replace(toy_study(), name="other"), 4, **again)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machinery, "version", lambda name: "0.0.0")
        assert "not 0.0.0" in refusal(toy_study(), 4, **again)
    assert "--resume" in refusal(toy_study(), 4, workers=0, out=tmp_path)
    assert rows_of(tmp_path) == before


def test_options_that_are_no_options(tmp_path):
    assert "--trials: 0 trials" in refusal(toy_study(), 0)
    assert "--seed: -1" in refusal(toy_study(), 1, -1)
    assert "--seed: 9223372036854775808" in refusal(toy_study(), 1, 2**63)
    assert "--workers: -2 workers" in refusal(toy_study(), 1, workers=-2, out=tmp_path / "rows")
    assert not (tmp_path / "rows").exists()


@pytest.mark.parametrize("stopped_at", [1, 6])
def test_interrupted_it_leaves_what_came(undisturbed, tmp_path, stopped_at):
    def stop(done, total, failed):
        if done == stopped_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as interrupt:
        run_study(toy_study(), workers=0, out=tmp_path, progress=stop)
    assert str(interrupt.value) == f"{stopped_at} of 12 trials stand in {tmp_path}; --resume goes on"
    assert [row["trial"] for row in read_rows(tmp_path)] == list(range(stopped_at))
    run_study(toy_study(), workers=0, out=tmp_path, resume=True)
    assert rows_of(tmp_path) == rows_of(undisturbed[0])


def test_interrupted_without_a_folder():
    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="nothing was written"):
        run_study(toy_study(), workers=0, progress=stop)


def test_what_breaks_the_study_does_not_take_its_rows(tmp_path):
    def broken(done, total, failed):
        if done == 4:
            raise RuntimeError("a fault of ours")

    with pytest.raises(RuntimeError, match="a fault of ours"):
        run_study(toy_study(), workers=0, out=tmp_path, progress=broken)
    assert len(read_rows(tmp_path)) == 4


# ---------------------------------------------------------------------------------------------------------------
# On the command line
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture
def toy(monkeypatch, tmp_path):
    """`bayesid study toy` in a folder of its own."""
    module = ModuleType("bayesid.studies.toy")
    module.STUDY = toy_study()
    monkeypatch.setitem(sys.modules, "bayesid.studies.toy", module)
    monkeypatch.setitem(STUDIES, "toy", "nothing")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(toy, capfd):
    """A command that ends with code 2 and one line that says these words, and changes nothing."""

    def check(*arguments, says):
        capfd.readouterr()
        before = {path: path.read_bytes() for path in toy.rglob("*") if path.is_file()}
        try:
            code = cli.main(["study", *map(str, arguments)])
        except SystemExit as end:
            code = end.code
        out, err = capfd.readouterr()
        assert (code, out, err.count("\n"), err[-1:]) == (2, "", 1, "\n")
        assert err.startswith("bayesid")
        assert says in err
        assert {path: path.read_bytes() for path in toy.rglob("*") if path.is_file()} == before

    return check


def test_commands_that_are_refused(refused):
    refused("tango", says="'tango'")
    for option, value in [("--trials", "0"), ("--trials", "-3"), ("--trials", "many"), ("--workers", "0")]:
        refused("toy", option, value, says=f"argument {option}: '{value}' is not a whole number from 1 up")
    refused("toy", "--seed", "-1", says="argument --seed: ")
    refused("toy", "--seed", 2**63, says="argument --seed: '9223372036854775808' is not a whole number")
    refused("toy", "--scheduler", "here", says="--scheduler: 'here' is no address of a scheduler")


def test_folders_that_are_refused(refused, toy):
    (toy / "mine").mkdir()
    (toy / "mine" / "thesis.tex").write_text("years of work")
    refused("toy", "--out", "mine", says="mine: holds other files (thesis.tex)")
    refused("toy", "--out", "mine/thesis.tex", says="mine/thesis.tex: is not a folder")
    refused("toy", "--out", "mine/thesis.tex/rows", says="thesis.tex is not a folder")
    run_study(toy_study(), 3, workers=0, out=toy / "rows")
    refused("toy", "--out", "rows", says="rows.parquet: holds 3 rows of an earlier run; go on with it by --resume")
    refused("toy", "--out", "rows", "--resume", "--seed", 1, says="rows: holds rows of another run (seed of trial 0")
    refused("noise", "--out", "rows", "--resume", says="holds rows of study toy, not noise")
    (toy / "rows" / "rows.parquet").write_bytes(b"PAR1")
    refused("toy", "--out", "rows", "--resume", says="rows.parquet: cannot be read")


def test_what_a_command_leaves(toy, capfd):
    assert cli.main(["study", "toy", "--trials", "6", "--workers", "1"]) == 0
    folder = toy / "bayesid-study-toy"
    assert {path.name for path in folder.iterdir()} == {"rows.parquet", "timings.parquet", "report.txt", "figure.svg"}
    report = "5 good rows\ntrial 5 failed: ArithmeticError: fails by design\n"
    assert (folder / "report.txt").read_text() == report
    out, err = capfd.readouterr()
    assert out == f"{report}written to bayesid-study-toy/\n"
    assert err == "warning: trial 5 failed: ArithmeticError: fails by design\n"
    before = {path.name: path.read_bytes() for path in folder.glob("*[!g]")}
    assert cli.main(["study", "toy", "--trials", "6", "--resume", "--quiet"]) == 0
    assert capfd.readouterr().out == ""
    assert {path.name: path.read_bytes() for path in folder.glob("*[!g]")} == before


def test_ctrl_c_ends_the_command(undisturbed, tmp_path):
    """Ctrl-C goes to all processes of the terminal; one line is said, the rows stand, and no process is left."""
    marks, folder = tmp_path / "marks", tmp_path / "rows"
    gate(marks, GATES[0]).touch()
    with toy_client(marks, 0.3, "--out", folder, "--workers", 2) as client:
        wait_until(lambda: (folder / "rows.parquet").exists(), "rows stand there")
        os.killpg(client.pid, signal.SIGINT)
        out, err = client.communicate(timeout=PATIENCE)
        rows = read_rows(folder)
        assert (client.returncode, out) == (130, "")
        assert err == f"bayesid: interrupted; {len(rows)} of 12 trials stand in {folder}; --resume goes on\n"
        assert not any(alive(pid) for pid, _ in marks_in(marks))
    gate(marks, GATES[0]).unlink()
    assert 0 < len(rows) < 12
    run_study(toy_study(marks), workers=0, out=folder, resume=True)
    assert rows_of(folder) == rows_of(undisturbed[0])


def test_ctrl_c_while_workers_start(tmp_path):
    with toy_client(tmp_path / "marks", 0.3, "--out", tmp_path / "rows", "--workers", 2) as client:
        children = Path(f"/proc/{client.pid}/task/{client.pid}/children")
        wait_until(lambda: len(children.read_text().split()) >= 3, "workers and their resource tracker are born")
        time.sleep(0.5)  # now they load their modules
        os.killpg(client.pid, signal.SIGINT)
        out, err = client.communicate(timeout=PATIENCE)
    assert (client.returncode, out) == (130, "")
    assert err == f"bayesid: interrupted; 0 of 12 trials stand in {tmp_path / 'rows'}; --resume goes on\n"


# ---------------------------------------------------------------------------------------------------------------
# All studies
# ---------------------------------------------------------------------------------------------------------------
def test_the_command_line_lists_all_studies_and_loads_none(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["study", "--help"])
    listed = re.findall(r"^  (\w+)  +\w", capsys.readouterr().out.partition("studies:")[2], re.M)
    assert (end.value.code, listed) == (0, list(STUDIES))
    script = "import sys; import bayesid.cli.parser as p; p.make_parser(); print('bayesid.studies' in sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout == "False\n"


def test_every_module_with_a_study_is_in_the_list():
    folder = Path(studies.__file__).parent
    modules = {path.stem for path in folder.glob("*.py") if re.search(r"^STUDY\b", path.read_text(), re.M)}
    assert modules == set(STUDIES)


def test_a_study_of_no_name():
    with pytest.raises(InputError, match="'tango' is no study"):
        load("tango")


def planned(name, trials, seed):
    """Where a plan needs real logs that are not here, it says so."""
    study = load(name)
    if not name.startswith("real") or DATA.is_dir():
        return study.plan(trials, seed)
    with pytest.raises(InputError, match="set BAYESID_DATA"):
        study.plan(trials, seed)
    return pytest.skip(f"real logs are not in {DATA}; set BAYESID_DATA to the folder that holds them")


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_can_be_planned_and_sent(name):
    study, plan = load(name), planned(name, 5, 0)
    assert study.name == name
    assert study.trials >= 1
    assert len(plan) == 5
    for scenario, seed in plan:
        fields = asdict(scenario)
        assert type(seed) is int
        assert not {"trial", "seed", "error", "worker_died", "timings"} & set(fields)
        assert json.loads(json.dumps(fields)) == json.loads(json.dumps(fields, default=str)), "numbers, texts, tuples"
        assert pickle.loads(pickle.dumps((study.trial, scenario))) == (study.trial, scenario)


@pytest.mark.parametrize("name", [name for name in STUDIES if name != "discrepancy"])
def test_a_longer_plan_goes_on_with_a_shorter_one(name):
    """But for `discrepancy`, which says so."""
    assert list(planned(name, 40, 3))[:11] == list(planned(name, 11, 3))


def test_parts_are_mixed_evenly_and_each_keeps_its_order():
    order = mixed(["abcdef", [1, 2, 3], [], ["only"]])
    assert [x for x in order if x in list("abcdef")] == list("abcdef")
    assert [x for x in order if x in (1, 2, 3)] == [1, 2, 3]
    assert order[:3] == ["a", 1, "only"]
    assert order.index(3) > order.index("d")
