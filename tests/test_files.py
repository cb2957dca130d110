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
from bayesid.files.writing import check_folder, replace_file, save_folder, write_columns

NAMES = frozenset({"summary.json", *(f"part{k}.txt" for k in range(20))})
WRITER = """
import ctypes, sys
from pathlib import Path
from bayesid.files import writing as files
if sys.argv[3] == "two renames":  # as where the system cannot exchange names
    def no_library(*_, **__):
        raise OSError
    ctypes.CDLL = no_library
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


def hidden(folder):
    """What is written aside, or left there."""
    return [path for path in folder.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("how", ["exchange", "two renames"])
@pytest.mark.parametrize("count", [6, pytest.param(100, marks=pytest.mark.long)])
def test_a_kill_leaves_the_old_folder_or_the_new(tmp_path, how, count):
    """Where names cannot be exchanged, the next start, which begins with `check_folder`, puts the old one back."""
    place, rng = tmp_path / "result", np.random.default_rng(0)
    save(place, "0")
    for k in range(1, count + 1):
        killed_writer(place, str(k), how, rng.uniform(0.0, 0.05))
        if how == "two renames":
            check_folder(place, NAMES, "summary.json")
        assert whole(place) in (str(k - 1), str(k))
        assert place.with_name("result.csv").read_text() in (str(k - 1) * 1000, str(k) * 1000)
        save(place, str(k))
        assert sorted(path.name for path in tmp_path.iterdir()) == ["result", "result.csv"]


def test_a_kill_between_two_renames(tmp_path):
    """The moment itself: the old one is aside, the new one not yet there."""
    place, aside = tmp_path / "result", []
    save_folder(place, NAMES, "summary.json", lambda new: (filled("old")(new), aside.append(new.parent)))
    own = f"{os.getpid()}-"
    left = tmp_path / aside[0].name.replace(own, f"{2**22 + 1}-")  # no process has so high a number
    left.mkdir()
    place.rename(left / "old")
    check_folder(place, NAMES, "summary.json")
    assert whole(place) == "old"
    assert not hidden(tmp_path)


def test_what_a_living_neighbour_writes_stays(tmp_path):
    """And so does what is only named alike, or is of another machine."""
    place, aside = tmp_path / "result", []
    save_folder(place, NAMES, "summary.json", lambda new: (filled("old")(new), aside.append(new.parent.name)))
    neighbour = aside[0].replace(f"{os.getpid()}-", f"{os.getppid()}-")
    names = [neighbour, ".result-elsewhere-7-abc", ".result-notes", ".results-1"]
    for name in names:
        (tmp_path / name).mkdir()
    save(place, "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "result", "result.csv"])


def test_both_ways_replace_and_leave_nothing(tmp_path, monkeypatch):
    def no_library(*_, **__):
        raise OSError

    place = tmp_path / "result"
    save(place, "1")
    save(place, "2")
    assert whole(place) == "2"
    monkeypatch.setattr("ctypes.CDLL", no_library)
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


def test_long_tables_are_written_in_order(tmp_path):
    """Rows are made in blocks, of which copies of the process may make several at a time."""
    n = 95_000
    t, values = 0.1 * np.arange(n), np.random.default_rng(0).integers(0, 100, (n, 2)) / 4.0
    path = tmp_path / "log.csv"
    write_columns(path, ["t", "a", "b"], t, values.__getitem__, sources=[f"log,{k}" for k in range(n)])
    header, *rows = csv.reader(path.read_text().splitlines())
    assert header == ["t", "a", "b", "log"]
    np.testing.assert_array_equal(np.array([row[:3] for row in rows], dtype=float), np.column_stack([t, values]))
    assert [row[3] for row in rows] == [f"log,{k}" for k in range(n)]
