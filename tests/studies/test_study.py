import json
import os
import pickle
import random
import re
import signal
import subprocess
import sys
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
from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.studies import load, real
from bayesid.studies import study as machinery
from bayesid.studies.record import read_rows
from bayesid.studies.study import in_turn, run_study
from bayesid.study import STUDIES, runner
from bayesid.study.runner import Outcome

FAILED = 5
"""Number of the trial that fails."""
REAL = ("constraints", "real", "real_discrepancy")
FIELDS = "trial seed name level window error worker_died draws sum grows absent positive empty timings"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A run in this process: its folder and result."""
    folder = tmp_path_factory.mktemp("undisturbed") / "rows"
    return folder, run_study(toy_study(), workers=0, out=folder)


def rows_of(folder):
    return (folder / "rows.parquet").read_bytes()


def refusal(*arguments, **options):
    with pytest.raises(InputError) as error:
        run_study(*arguments, **options)
    assert "\n" not in str(error.value)
    assert error.value.remedy
    return in_options(str(error.value))


def test_a_row_a_trial_and_a_failing_trial_is_one(undisturbed):
    finished = undisturbed[1]
    rows, failed = finished.rows, finished.rows[FAILED]
    assert [(row["trial"], row["name"], row["seed"]) for row in rows] == [
        (2 * k + j, scenario.name, k) for k in range(6) for j, scenario in enumerate(SCENARIOS)
    ]
    assert list(rows[0]) == FIELDS.split()
    assert [row["window"] for row in rows[:2]] == [[1, 2], []]
    assert set(rows[0]["timings"]) == {"trial", "seconds", "worker", "clock"}
    assert (failed["name"], failed["seed"]) == FAILS
    assert (failed["error"], failed["worker_died"]) == ("ArithmeticError: fails by design", False)
    assert failed["sum"] is failed["draws"] is failed["positive"] is None
    assert (finished.failed, len(finished.good)) == ([failed], 11)
    assert finished.report.splitlines() == ["11 good rows", "trial 5 failed: ArithmeticError: fails by design"]


def test_the_same_rows_by_other_processes(undisturbed, tmp_path):
    """For a cluster: test_kill.py."""
    found = run_study(toy_study(tmp_path / "marks", nap=0.02), workers=2, out=tmp_path / "rows")
    assert rows_of(tmp_path / "rows") == rows_of(undisturbed[0])
    assert len({pid for pid, _ in marks_in(tmp_path / "marks")} - {os.getpid()}) == 2
    for here, there in zip(found.rows, undisturbed[1].rows, strict=True):
        assert repr({**here, "timings": 0}) == repr({**there, "timings": 0})


def test_the_same_rows_in_whatever_order_they_come(undisturbed, tmp_path, monkeypatch):
    def reordered(*arguments):
        outcomes = [outcome for batch in runner.run(*arguments) for outcome in batch]
        random.Random(1).shuffle(outcomes)
        outcomes.sort(key=lambda outcome: outcome.index != FAILED)
        yield from (outcomes[k : k + 3] for k in range(0, len(outcomes), 3))

    monkeypatch.setattr(machinery, "run", reordered)
    run_study(toy_study(), workers=0, out=tmp_path)
    assert rows_of(tmp_path) == rows_of(undisturbed[0])


def odd(scenario, seed):
    return {"value": [seed, 0.5, "text", 2**70, object(), None][seed]}


def clashing(scenario, seed):
    return {"level": 1.0, "seed": 3}


def test_a_result_that_no_column_holds_is_an_error_of_its_trial(tmp_path):
    rows = run_study(replace(toy_study(), plan=in_turn(SCENARIOS[:1]), trial=odd), 6, workers=0, out=tmp_path).rows
    assert [row["value"] for row in rows] == [0.0, 0.5, None, None, None, None]
    assert [bool(row["error"]) for row in rows] == [False, False, True, True, True, False]
    assert read_rows(tmp_path) == rows
    with pytest.raises(ValueError, match="level, seed"):  # named like a field: a fault of the study
        run_study(replace(toy_study(), trial=clashing), 1, workers=0)


def test_resumed_it_runs_what_is_missing(undisturbed, tmp_path, monkeypatch):
    """The trial that failed is not missing; with more trials, only these are."""
    study, folder = toy_study(tmp_path / "marks"), tmp_path / "rows"
    run_study(study, 7, workers=0, out=folder)
    assert executions(tmp_path / "marks") == dict.fromkeys(range(7), 1)
    calls = []
    run_study(study, workers=0, out=folder, resume=True, progress=lambda *counts: calls.append(counts))
    assert executions(tmp_path / "marks") == dict.fromkeys(range(12), 1)
    assert calls == [(done, 12, 1) for done in range(8, 13)]
    monkeypatch.setattr(runner, "Processes", None)  # nothing is started when nothing is missing
    finished = run_study(study, 4, workers=2, out=folder, resume=True)
    assert executions(tmp_path / "marks").total() == 12
    assert [row["trial"] for row in finished.rows] == [0, 1, 2, 3]
    assert rows_of(folder) == rows_of(undisturbed[0])


def test_trials_whose_workers_died_are_tried_again(undisturbed, tmp_path, monkeypatch):
    def deadly(*arguments):
        for batch in runner.run(*arguments):
            lost = [Outcome(one.index, None, "WorkerDied: 3", died=True) for one in batch if one.index in (1, 8)]
            yield [*lost, *(one for one in batch if one.index not in (1, 8))]

    study, folder = toy_study(tmp_path / "marks"), tmp_path / "rows"
    with monkeypatch.context() as patch:
        patch.setattr(machinery, "run", deadly)
        finished = run_study(study, workers=0, out=folder)
    assert [(row["trial"], row["worker_died"]) for row in finished.failed] == [(1, True), (FAILED, False), (8, True)]
    (tmp_path / "marks").unlink()
    finished = run_study(study, workers=0, out=folder, resume=True)
    assert [row["trial"] for row in finished.failed] == [FAILED]
    assert executions(tmp_path / "marks") == {1: 1, 8: 1}
    assert rows_of(folder) == rows_of(undisturbed[0])


def test_rows_of_another_run_are_not_resumed(tmp_path, monkeypatch):
    run_study(toy_study(), 4, workers=0, out=tmp_path)
    before = rows_of(tmp_path)
    again = {"workers": 0, "out": tmp_path, "resume": True}
    assert "name of trial 0" in refusal(replace(toy_study(), plan=in_turn(SCENARIOS[::-1])), 4, **again)
    wider = in_turn([SCENARIOS[0], replace(SCENARIOS[1], window=(3,))])
    assert "window of trial 1" in refusal(replace(toy_study(), plan=wider), 4, **again)
    monkeypatch.setattr(machinery, "version", lambda name: "0.0.0")
    assert "not 0.0.0" in refusal(toy_study(), 4, **again)
    assert rows_of(tmp_path) == before


@pytest.mark.parametrize("fault", [KeyboardInterrupt, RuntimeError])
def test_what_ends_a_study_early_leaves_the_rows_that_came(undisturbed, tmp_path, fault):
    def stop(done, total, failed):
        if done == 6:
            raise fault("a fault of ours")

    with pytest.raises(fault) as error:
        run_study(toy_study(), workers=0, out=tmp_path, progress=stop)
    assert ("6 of 12 trials" in str(error.value)) == (fault is KeyboardInterrupt)
    assert [row["trial"] for row in read_rows(tmp_path)] == list(range(6))
    run_study(toy_study(), workers=0, out=tmp_path, resume=True)
    assert rows_of(tmp_path) == rows_of(undisturbed[0])
    if fault is KeyboardInterrupt:
        with pytest.raises(fault, match="nothing was written"):
            run_study(toy_study(), workers=0, progress=stop)


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
    """A command that ends with code 2 and one line with these words, and changes nothing."""

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


def test_commands_that_are_refused(refused, toy):
    refused("tango", says="'tango'")
    for option, value in [
        ("--trials", "0"),
        ("--trials", "many"),
        ("--workers", "0"),
        ("--seed", -1),
        ("--seed", 2**63),
    ]:
        refused("toy", option, value, says=f"argument {option}: '{value}'")
    refused("toy", "--scheduler", "here", says="--scheduler: 'here'")
    (toy / "mine").mkdir()
    (toy / "mine" / "thesis.tex").write_text("years of work")
    refused("toy", "--out", "mine", says="thesis.tex")
    refused("toy", "--out", "mine/thesis.tex", says="is not a folder")
    run_study(toy_study(), 3, workers=0, out=toy / "rows")
    refused("toy", "--out", "rows", says="--resume")
    refused("toy", "--out", "rows", "--resume", "--seed", 1, says="seed of trial 0")
    refused("noise", "--out", "rows", "--resume", says="study toy, not noise")
    (toy / "rows" / "rows.parquet").write_bytes(b"PAR1")
    refused("toy", "--out", "rows", "--resume", says="rows.parquet: cannot be read")
    for option, trials, seed in (("--trials", 0, 0), ("--seed", 1, -1)):
        assert option in refusal(toy_study(), trials, seed, workers=0)


def test_what_a_command_leaves(toy, capfd):
    assert cli.main(["study", "toy", "--trials", "6", "--workers", "1"]) == 0
    folder = toy / "bayesid-study-toy"
    assert {path.name for path in folder.iterdir()} == {"rows.parquet", "timings.parquet", "report.txt", "figure.svg"}
    report = (folder / "report.txt").read_text()
    assert report == "5 good rows\ntrial 5 failed: ArithmeticError: fails by design\n"
    assert report in capfd.readouterr().out
    before = {path.name: path.read_bytes() for path in folder.glob("*[!g]")}
    assert cli.main(["study", "toy", "--trials", "6", "--resume", "--quiet"]) == 0
    assert capfd.readouterr().out == ""
    assert {path.name: path.read_bytes() for path in folder.glob("*[!g]")} == before


def test_ctrl_c_ends_the_command(undisturbed, tmp_path):
    """Ctrl-C goes to all processes of the terminal: one line is printed, rows are kept, no process remains."""
    marks, folder = tmp_path / "marks", tmp_path / "rows"
    gate(marks, GATES[0]).touch()
    with toy_client(marks, 0.3, "--out", folder, "--workers", 2) as client:
        wait_until(lambda: (folder / "rows.parquet").exists(), "rows stand there")
        os.killpg(client.pid, signal.SIGINT)
        out, err = client.communicate(timeout=PATIENCE)
        rows = read_rows(folder)
        assert 0 < len(rows) < 12
        assert (client.returncode, out) == (130, "")
        assert err == f"bayesid: interrupted; {len(rows)} of 12 trials are in {folder}; continue with --resume\n"
        assert not any(alive(pid) for pid, _ in marks_in(marks))
    gate(marks, GATES[0]).unlink()
    run_study(toy_study(marks), workers=0, out=folder, resume=True)
    assert rows_of(folder) == rows_of(undisturbed[0])


def test_the_command_line_lists_all_studies_and_loads_none(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["study", "--help"])
    listed = re.findall(r"^  (\w+)  +\w", capsys.readouterr().out.partition("studies:")[2], re.M)
    assert (end.value.code, listed) == (0, list(STUDIES))
    script = "import sys; import bayesid.cli.arguments as p; p.BAYESID; print('bayesid.studies' in sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout == "False\n"
    files = [path for path in Path(studies.__file__).parent.glob("*.py") if path.stem != "real_floor"]  # real --floor
    assert {path.stem for path in files if re.search(r"^STUDY\b", path.read_text(), re.M)} == set(STUDIES)


def check_plan(name):
    """A longer plan goes on with a shorter one, but for `discrepancy`'s."""
    study = load(name)
    plan = study.plan(40, 3)
    assert (study.name, len(plan)) == (name, 40)
    if name != "discrepancy":
        assert list(study.plan(11, 3)) == list(plan[:11])
    for scenario, seed in plan[:5]:
        fields = asdict(scenario)
        assert type(seed) is int
        assert not {"trial", "seed", "error", "worker_died", "timings"} & set(fields)
        assert json.loads(json.dumps(fields)) == json.loads(json.dumps(fields, default=str)), "numbers, texts, tuples"
        assert pickle.loads(pickle.dumps((study.trial, scenario))) == (study.trial, scenario)


def test_every_study_can_be_planned_and_sent():
    for name in STUDIES:
        if name not in REAL or DATA.is_dir():
            check_plan(name)


@pytest.mark.parametrize("name", REAL)
def test_without_real_logs_a_study_of_them_names_the_variable_of_their_folder(name, monkeypatch, tmp_path):
    monkeypatch.setattr(real, "DATA", tmp_path / "nowhere")
    with pytest.raises(InputError) as error:
        load(name).plan(5, 0)
    assert "$BAYESID_DATA" in in_options(str(error.value))
