"""Files and folders that are whole or not there, whenever their writer is killed."""

import csv
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.files import writing as files
from bayesid.files.writing import check_folder, replace_file, save_folder, write_columns

NAMES = frozenset({"summary.json", *(f"part{k}.txt" for k in range(20))})
WRITER = """
import os, sys, time
from pathlib import Path
from bayesid.files import writing as files
if sys.argv[3] == "two renames":
    files._exchanged = lambda one, other: False
names = {"summary.json", *(f"part{k}.txt" for k in range(20))}
def write(place):
    for name in sorted(names):
        (place / name).write_text(sys.argv[2])
print("ready", flush=True)
while True:
    files.save_folder(sys.argv[1], names, "summary.json", write)
    files.replace_file(Path(sys.argv[1] + ".csv"), lambda aside: aside.write_text(sys.argv[2] * 1000))
"""


def filled(text):
    def write(place):
        for name in sorted(NAMES):
            (place / name).write_text(text)

    return write


def save(place, text):
    save_folder(place, NAMES, "summary.json", filled(text))
    replace_file(place.with_name(f"{place.name}.csv"), lambda aside: aside.write_text(text * 1000))


def killed_writer(place, text, how, seconds):
    """A process that saves again and again, killed after some time."""
    command = [sys.executable, "-c", WRITER, str(place), text, how]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert running.stdout.readline() == "ready\n"
    time.sleep(seconds)
    running.send_signal(signal.SIGKILL)
    running.communicate()


def whole(place):
    """The one text that all files of a folder hold."""
    assert {path.name for path in place.iterdir()} == NAMES
    (text,) = {path.read_text() for path in place.iterdir()}
    return text


@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.long)])
def test_a_kill_leaves_the_old_folder_or_the_new(tmp_path, count):
    place, rng = tmp_path / "result", np.random.default_rng(0)
    save(place, "0")
    for k in range(1, count + 1):
        killed_writer(place, str(k), "exchange", rng.uniform(0.0, 0.05))
        assert whole(place) in (str(k - 1), str(k))
        assert place.with_name("result.csv").read_text() in (str(k - 1) * 1000, str(k) * 1000)
        save(place, str(k))
        assert sorted(path.name for path in tmp_path.iterdir()) == ["result", "result.csv"]


@pytest.mark.parametrize("count", [8, pytest.param(100, marks=pytest.mark.long)])
def test_where_names_cannot_be_exchanged_the_next_start_puts_it_back(tmp_path, count):
    place, rng = tmp_path / "result", np.random.default_rng(1)
    save(place, "0")
    for k in range(1, count + 1):
        before = whole(place)
        killed_writer(place, str(k), "two renames", rng.uniform(0.0, 0.05))
        check_folder(place, NAMES, "summary.json")  # what every command begins with
        assert whole(place) in (before, str(k))
        assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["result"]


def test_a_kill_between_two_renames(tmp_path, monkeypatch):
    """The moment itself: the old one is aside, the new one not yet there."""
    place = tmp_path / "result"
    save(place, "old")
    monkeypatch.setattr(files, "_exchanged", lambda one, other: False)
    aside = tmp_path / f"{files._aside(place)}{2**22 + 1}-abc"  # no process has so high a number
    aside.mkdir()
    place.rename(aside / "old")
    check_folder(place, NAMES, "summary.json")
    assert whole(place) == "old"
    assert not aside.exists()


def test_what_a_living_neighbour_writes_stays(tmp_path):
    """And so does what is only named alike, or is of another machine."""
    place = tmp_path / "result"
    names = [f"{files._aside(place)}{os.getppid()}-abc", ".result-elsewhere-7-abc", ".result-notes", ".results-1"]
    for name in names:
        (tmp_path / name).mkdir()
    save(place, "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "result", "result.csv"])


def test_both_ways_replace_and_leave_nothing(tmp_path, monkeypatch):
    place = tmp_path / "result"
    save(place, "1")
    assert files._exchanged(place, place) in (True, False)
    save(place, "2")
    monkeypatch.setattr(files, "_exchanged", lambda one, other: False)
    save(place, "3")
    assert whole(place) == "3"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result", "result.csv"]


def test_a_folder_that_somebody_filled_meanwhile_is_not_touched(tmp_path):
    place = tmp_path / "result"

    def write(new):
        filled("mine")(new)
        place.mkdir()
        (place / "thesis.tex").write_text("months of work")

    with pytest.raises(InputError, match="other files"):
        save_folder(place, NAMES, "summary.json", write)
    assert (place / "thesis.tex").read_text() == "months of work"


def test_blocks_that_copies_of_the_process_make_stand_in_order(tmp_path, monkeypatch):
    monkeypatch.setattr("bayesid.files.writing._BLOCK", 3)
    monkeypatch.setattr("bayesid.files.writing._TOGETHER", 4)
    t, values = 0.1 * np.arange(29), np.random.default_rng(0).normal(size=(29, 2))
    written = []
    for processors in ("1", "2"):
        monkeypatch.setenv("OMP_NUM_THREADS", processors)
        path = tmp_path / f"by{processors}.csv"
        write_columns(path, ["t", "a", "b"], t, values.__getitem__, sources=[f"log,{k}" for k in range(29)])
        written.append(path.read_bytes())
    assert written[0] == written[1]
    header, *rows = csv.reader(written[0].decode().splitlines())
    assert header == ["t", "a", "b", "log"]
    np.testing.assert_array_equal([[float(x) for x in row[:3]] for row in rows], np.column_stack([t, values]))
    assert [row[3] for row in rows] == [f"log,{k}" for k in range(29)]
