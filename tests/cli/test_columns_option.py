"""`--columns`: what the log calls its columns, the same for every command that reads one."""

import csv
import shlex

import numpy as np
import pytest
from command_line import run

import bayesid

pytestmark = pytest.mark.usefixtures("any_motion")

COLUMNS = 't="Zeit [ms]",q="Lage {} [Grad]",i=Strom{}'
GAINS = "4,3,2,2,1,1"


@pytest.fixture(scope="module")
def recorded():
    """A log of a KR5 with its signs."""
    return bayesid.simulate("kr5", duration=3.0, rng=3, signed=True)


@pytest.fixture
def place(recorded, tmp_path, monkeypatch):
    """A folder with a log in a stranger's words: milliseconds, degrees, currents, decimal commas."""
    gains = np.array([float(gain) for gain in GAINS.split(",")])
    cells = np.column_stack([1e3 * recorded.t, np.rad2deg(recorded.q), recorded.effort / gains]).tolist()
    names = ["Zeit [ms]", *(f"Lage {j} [Grad]" for j in range(6)), *(f"Strom{j}" for j in range(6)), "Bemerkung"]
    with (tmp_path / "messung.csv").open("w", newline="", encoding="utf-16") as file:
        writer = csv.writer(file, delimiter=";")
        writer.writerows([names, *([*(repr(x).replace(".", ",") for x in row), "läuft"] for row in cells)])
    (tmp_path / "columns.toml").write_text('t = "Zeit [ms]"\nq = "Lage {} [Grad]"\ni = "Strom{}"\n')
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def seen(monkeypatch):
    """The logs that `identify` is called with; it goes no further."""
    logs = []

    def spy(robot, log, **options):
        logs.append(log)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesid.cli.identify.identify", spy)
    return logs


def test_the_next_command_of_excite_reads_the_log_as_excite_did(place, recorded, seen, capfd):
    reading = ("--gains", GAINS, "--unsigned", "none", "--columns", COLUMNS)
    assert run("excite", "--robot", "kr5", "--log", "messung.csv", *reading) == 0
    command = capfd.readouterr().out.partition("next: bayesid ")[2]
    assert run(*shlex.split(command)) == 130
    np.testing.assert_allclose(seen[0].effort, recorded.effort, rtol=1e-12)


def test_a_strangers_log_is_read_by_the_columns_named(place, recorded, seen):
    arguments = ("identify", "messung.csv", "--robot", "kr5", "--gains", GAINS, "--unsigned", "none")
    assert run(*arguments, "--columns", COLUMNS) == 130
    np.testing.assert_allclose(seen[0].t, recorded.t, atol=1e-12)
    np.testing.assert_allclose(seen[0].q, recorded.q, atol=1e-13)
    np.testing.assert_allclose(seen[0].effort, recorded.effort, rtol=1e-12)


def test_columns_may_stand_in_a_file(place):
    judged = ("excite", "--robot", "kr5", "--log", "messung.csv", "--gains", GAINS)
    assert run(*judged, "--columns", "columns.toml") == 0
    assert run(*judged) == 2
