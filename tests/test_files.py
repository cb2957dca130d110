"""Files and folders that are whole or not there, and the tables that are written into them."""

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.files import bounded
from bayesid.files.bounded import read_source
from bayesid.files.writing import check_folder, plain, read_json, replace_file, save_folder, write_columns, write_json

NAMES = frozenset({"summary.json", *(f"part{k}.txt" for k in range(20))})
WRITER = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from test_files import save
print("ready", flush=True)
while True:
    save(Path(sys.argv[2]), sys.argv[3])
"""


def save(place, text):
    def write(new):
        for name in sorted(NAMES):
            (new / name).write_text(text)

    save_folder(place, NAMES, "summary.json", write)
    replace_file(place.with_name(f"{place.name}.csv"), lambda aside: aside.write_text(text * 1000))


def whole(place):
    """The one text that all files of a folder hold."""
    assert {path.name for path in place.iterdir()} == NAMES
    (text,) = {path.read_text() for path in place.iterdir()}
    return text


@pytest.mark.parametrize("count", [6, pytest.param(100, marks=pytest.mark.long)])
def test_a_kill_leaves_the_old_folder_or_the_new(tmp_path, count):
    """Killed between two renames, the old one stands aside."""
    place, rng = tmp_path / "result", np.random.default_rng(0)
    save(place, "0")
    for k in range(1, count + 1):
        command = [sys.executable, "-c", WRITER, os.path.dirname(__file__), str(place), str(k)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
            assert running.stdout.readline() == "ready\n"
            time.sleep(rng.uniform(0.0, 0.05))
            running.send_signal(signal.SIGKILL)
        aside = sorted(tmp_path.glob(".result-*/old"), key=lambda path: path.stat().st_mtime)
        assert whole(place if place.exists() else aside[-1]) in (str(k - 1), str(k))
        assert place.with_name("result.csv").read_text() in (str(k - 1) * 1000, str(k) * 1000)
        save(place, str(k))


def test_a_folder_that_somebody_filled_meanwhile_is_not_touched(tmp_path):
    place = tmp_path / "result"

    def write(new):
        place.mkdir()
        (place / "thesis.tex").write_text("months of work")

    with pytest.raises(InputError, match="other files"):
        save_folder(place, NAMES, "summary.json", write)
    assert (place / "thesis.tex").read_text() == "months of work"
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_long_tables_are_written_in_order(tmp_path):
    """Rows are made in blocks."""
    n = 25_000
    t, values = 0.1 * np.arange(n), np.random.default_rng(0).integers(0, 100, (n, 2)) / 4.0
    path = tmp_path / "log.csv"
    write_columns(path, ["t", "a", "b"], t, values.__getitem__, sources=[f"log,{k}" for k in range(n)])
    header, *rows = csv.reader(path.read_text().splitlines())
    assert header == ["t", "a", "b", "log"]
    np.testing.assert_array_equal(np.array([row[:3] for row in rows], dtype=float), np.column_stack([t, values]))
    assert [row[3] for row in rows] == [f"log,{k}" for k in range(n)]


def test_texts_that_are_too_long_and_folders_that_are_files(tmp_path, monkeypatch):
    path = tmp_path / "arm.toml"
    path.write_text("name")
    monkeypatch.setattr(bounded, "MOST_BYTES", 4)
    assert read_source(path, "give another") == "name"
    monkeypatch.setattr(bounded, "MOST_BYTES", 3)
    with pytest.raises(InputError, match="is longer than"):
        read_source(path, "give another")
    with pytest.raises(InputError, match="is not a folder"):
        check_folder(path, NAMES, "summary.json")


@dataclass
class Counted:
    size: float | None
    names: tuple[str, ...] = ()


def test_json_is_read_as_what_was_written(tmp_path):
    path = tmp_path / "a.json"
    assert plain((np.float64(np.inf), np.int64(3))) == [None, 3]
    write_json(path, {"size": np.inf, "names": ("a", "b"), "of a later version": {}})
    assert read_json(path, Counted, "again") == Counted(None, ("a", "b"))
    for content, said in (
        ("{", "truncated"),
        ("[]", "Expected `object`"),
        ('{"size": "a"}', r"got `str` - at `\$\.size`"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=said):
            read_json(path, Counted, "again")
