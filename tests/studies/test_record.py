import math
import os

import pyarrow as pa
import pytest
from pyarrow import parquet

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.studies.record import MisfitError, Record, read_rows

MARKS = {"study": "toy", "bayesid": "1.0"}


def kept(folder, *values):
    """Values under one name, a row each, written and read back."""
    book = Record(folder, MARKS, resume=False)
    for k, value in enumerate(values):
        book.add({"trial": k, "value": value}, {"seconds": 1.0})
    book.save(now=True)
    return [row["value"] for row in read_rows(folder)]


def fill(folder, trials, resume=False):
    book = Record(folder, MARKS, resume)
    for k in trials:
        book.add({"trial": k, "value": k / 2}, {"seconds": 1.0})
        book.save(now=True)
    return book


def refusal(of, *arguments):
    with pytest.raises(InputError) as error:
        of(*arguments)
    assert "\n" not in str(error.value)
    assert error.value.remedy
    return in_options(str(error.value))


def test_rows_come_back_in_order_with_their_timings(tmp_path):
    book = Record(tmp_path, MARKS, resume=False)
    for k in (2, 0, 1):
        book.add({"trial": k, "name": "abc"[k]}, {"seconds": 10.0 * k})
    book.save(now=True)
    timings = [{"trial": k, "seconds": 10.0 * k} for k in range(3)]
    assert read_rows(tmp_path) == [{"trial": k, "name": "abc"[k], "timings": timings[k]} for k in range(3)]
    assert parquet.read_table(tmp_path / "rows.parquet").column_names == ["trial", "name"]


def test_columns_widen(tmp_path):
    columns = (
        (1, 2.5, 3),
        (None, 1, None, 2.5),
        ([], [1], [2.5], None, [None]),
        ([[1], []], [[2.5]]),
        ("a", None, ""),
        (True, None, False),
        (0.1, 1e-320, math.inf, 1 / 3),
        ({"a": 1}, {"b": [2.5]}),
    )
    for k, values in enumerate(columns):
        expected = [{"a": None, "b": None} | value if isinstance(value, dict) else value for value in values]
        assert kept(tmp_path / f"{k}", *values) == expected


def test_a_misfit_leaves_no_trace(tmp_path):
    book = fill(tmp_path, [0])
    for value in ("text", [1.0], True, 1j, 2**64, 2**60 + 1, "\ud800", object(), {}):
        with pytest.raises(MisfitError):
            book.add({"trial": 1, "value": value, "more": 1}, {"seconds": 1.0})
    book.add({"trial": 2, "value": 7.0}, {"seconds": 1.0})
    book.save(now=True)
    rows = read_rows(tmp_path)
    assert [(row["trial"], row["value"]) for row in rows] == [(0, 0.0), (2, 7.0)]
    assert "more" not in rows[0]
    for k, values in enumerate([(2**60 + 1, 0.5), (0.5, 2**60 + 1), ([2**60 + 1], [0.5]), ({}, {"a": 1})]):
        with pytest.raises(MisfitError):
            kept(tmp_path / f"{k}", *values)


def test_the_same_rows_make_the_same_file(tmp_path):
    fill(tmp_path / "a", range(10))
    fill(tmp_path / "b", reversed(range(10)))
    fill(tmp_path / "c", [3, 1, 4])
    fill(tmp_path / "c", [9, 2, 6, 5, 8, 7, 0], resume=True)
    contents = [(tmp_path / name / "rows.parquet").read_bytes() for name in "abc"]
    assert contents[0] == contents[1] == contents[2]


def test_resumed_it_holds_what_was_there(tmp_path):
    fill(tmp_path, [0, 2])
    before = (tmp_path / "rows.parquet").read_bytes()
    book = Record(tmp_path, MARKS, resume=True)
    assert {k: row["value"] for k, row in book.rows.items()} == {0: 0.0, 2: 1.0}
    book.save(now=True)
    assert (tmp_path / "rows.parquet").read_bytes() == before
    book.add({"trial": 1, "value": 5.0}, {"seconds": 3.0})
    book.forget([2, 17])
    book.save(now=True)
    found = [(row["trial"], row["value"], row["timings"]["seconds"]) for row in read_rows(tmp_path)]
    assert found == [(0, 0.0, 1.0), (1, 5.0, 3.0)]
    assert not Record(tmp_path / "new", MARKS, resume=True).rows


@pytest.mark.parametrize("file", ["rows", "timings"])
def test_what_goes_wrong_in_a_save_leaves_the_file_before(tmp_path, monkeypatch, file):
    book = fill(tmp_path, [0, 1])
    book.add({"trial": 2, "value": 1.0}, {"seconds": 1.0})
    write = parquet.write_table

    def half_written(table, path, *rest):
        write(table, path, *rest)
        if file in str(path):
            path.write_bytes(path.read_bytes()[:100])
            raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(parquet, "write_table", half_written)
        with pytest.raises(OSError, match="no space"):
            book.save(now=True)
    assert [row["trial"] for row in read_rows(tmp_path)] == [0, 1]
    assert {path.name for path in tmp_path.iterdir()} == {"rows.parquet", "timings.parquet"}
    book.save(now=True)
    assert [row["trial"] for row in read_rows(tmp_path)] == [0, 1, 2]


def test_rows_of_something_else_and_files_of_others_are_refused_and_left(tmp_path, monkeypatch):
    fill(tmp_path, range(3))
    file, before = tmp_path / "rows.parquet", (tmp_path / "rows.parquet").read_bytes()
    assert "3 rows" in refusal(Record, tmp_path, MARKS, False)
    for key, value in (("study", "noise"), ("bayesid", "1.1"), ("more", "yes")):
        message = refusal(Record, tmp_path, MARKS | {key: value}, True)
        assert all(word in message for word in (key, MARKS.get(key, "unknown"), value))
    assert file.read_bytes() == before
    timings = tmp_path / "timings.parquet"
    timings.write_bytes(timings.read_bytes()[:100])
    assert "timings.parquet: cannot be read" in refusal(read_rows, tmp_path)
    for keep in (0, 4, 100, -1):
        file.write_bytes(before[:keep])
        assert "rows.parquet: cannot be read" in refusal(Record, tmp_path, MARKS, True)
    for table, said in (({"x": [1, 2]}, "no rows of a study"), ({"trial": [1, 2]}, "unknown, not toy")):
        parquet.write_table(pa.table(table), file)
        assert said in refusal(Record, tmp_path, MARKS, True)
    assert "is not a folder" in refusal(Record, file / "rows", MARKS, False)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write everywhere
    assert "write-protected" in refusal(Record, tmp_path / "new", MARKS, False)
