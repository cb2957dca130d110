"""Workers, clients and schedulers are killed in mid-run; the rows are those of a run that nothing disturbed."""

import os
import signal

import pytest
from toy_study import (
    GATES,
    PATIENCE,
    alive,
    dask_cluster,
    executions,
    gate,
    marks_in,
    toy_client,
    toy_study,
    wait_until,
)

from bayesid.studies.record import read_rows
from bayesid.studies.study import run_study
from bayesid.study.runner import LostSchedulerError

TRIALS = 40
NAP = 0.1
"""s that a trial takes."""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The expected file of rows."""
    folder = tmp_path_factory.mktemp("undisturbed")
    run_study(toy_study(), TRIALS, workers=0, out=folder)
    return folder


def without_timings(rows):
    return [{**row, "timings": None} for row in rows]


def stand(folder):
    """Rows that stand in a folder, which can be read at any time."""
    return read_rows(folder) if (folder / "rows.parquet").exists() else []


def check_stand(folder, undisturbed):
    """Rows of an unfinished run are the expected ones, and no worker died."""
    rows, expected = stand(folder), read_rows(undisturbed)
    assert 0 < len(rows) < TRIALS
    assert without_timings(rows) == without_timings([expected[row["trial"]] for row in rows])
    return {row["trial"] for row in rows}


def check_end(folder, undisturbed, marks, kept=(), begun=()):
    """Rows equal those of an undisturbed run; stored trials did not run again."""
    assert (folder / "rows.parquet").read_bytes() == (undisturbed / "rows.parquet").read_bytes()
    assert {trial: executions(marks)[trial] for trial in kept} == {trial: begun[trial] for trial in kept}
    assert set(executions(marks)) == set(range(TRIALS))


def test_worker_and_client_are_killed(undisturbed, tmp_path):
    marks, folder = tmp_path / "marks", tmp_path / "rows"
    options = ["--trials", TRIALS, "--out", folder, "--workers", 2]
    early, late = (gate(marks, seed) for seed in GATES)
    early.touch(), late.touch()
    with toy_client(marks, NAP, *options) as client:
        wait_until(lambda: len(stand(folder)) >= 4, "a few rows stand there")
        os.kill(marks_in(marks)[-1][0], signal.SIGKILL)
        before = len(stand(folder))
        early.unlink()
        wait_until(lambda: len(stand(folder)) >= before + 8, "more rows stand there")
        client.kill()
        client.wait()
        late.unlink()
        kept = check_stand(folder, undisturbed)
        begun = executions(marks)
        wait_until(lambda: not any(alive(pid) for pid, _ in marks_in(marks)), "the workers have ended too")
    with toy_client(marks, 0.0, *options, "--resume", "--quiet") as client:
        _, err = client.communicate(timeout=PATIENCE)
        assert (client.returncode, err) == (0, "warning: trial 5 failed: ArithmeticError: fails by design\n")
    check_end(folder, undisturbed, marks, kept, begun)


def test_the_same_rows_by_a_cluster_whose_scheduler_is_killed_later(undisturbed, tmp_path):
    marks, folder = tmp_path / "marks", tmp_path / "rows"
    with dask_cluster(tmp_path, workers=1) as doomed:
        run_study(toy_study(tmp_path / "first"), TRIALS, scheduler=doomed.address, out=tmp_path / "whole")
        check_end(tmp_path / "whole", undisturbed, tmp_path / "first")
        assert os.getpid() not in {pid for pid, _ in marks_in(tmp_path / "first")}

        def doom(done, total, failed):
            if done >= 4:
                doomed.scheduler.kill()

        gate(marks, GATES[1]).touch()
        with pytest.raises(LostSchedulerError, match="connection to the scheduler was lost"):
            run_study(toy_study(marks, NAP), TRIALS, scheduler=doomed.address, out=folder, progress=doom)
    gate(marks, GATES[1]).unlink()
    kept = check_stand(folder, undisturbed)
    assert len(kept) >= 4
    begun = executions(marks)
    run_study(toy_study(marks), TRIALS, workers=0, out=folder, resume=True)
    check_end(folder, undisturbed, marks, kept, begun)
