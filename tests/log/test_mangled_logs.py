"""A log in the forms of spreadsheets, recorders and hands: read right, or one line that leads on; never wrong."""

import gzip
import io
import json
import zipfile
from datetime import datetime, timedelta

import numpy as np
import pytest
from conftest import real_log

from bayesid import cli
from bayesid.errors import InputError
from bayesid.log.log import read_log

ROWS, N = 300, 3
NAMES = ["t", *(f"{kind}{j}" for kind in ("q", "dq", "tau") for j in range(1, N + 1))]


@pytest.fixture(scope="module")
def values():
    """(ROWS, 10) a log of three joints at 100 Hz with velocities."""
    t = np.arange(ROWS) / 100.0
    w, phase = np.array([2.0, 3.1, 4.3]), np.array([0.3, 1.1, 2.0])
    q, dq = np.sin(w * t[:, None] + phase), w * np.cos(w * t[:, None] + phase)
    return np.column_stack([t, q, dq, 30.0 * q - 4.0 * dq])


def lines(values, names=NAMES, separator=",", cell="{:.7f}".format):
    return [separator.join(names), *(separator.join(map(cell, row)) for row in values)]


def save(path, rows, encoding="utf-8", end="\n"):
    path.write_bytes((end.join(rows) + end).encode(encoding))
    return path


def assert_same(log, values):
    np.testing.assert_allclose(log.t - log.t[0], values[:, 0], atol=1e-6)
    np.testing.assert_allclose(log.q, values[:, 1:4], atol=1e-6)
    np.testing.assert_allclose(log.effort, values[:, 7:], atol=1e-6)
    if log.dq is not None:
        np.testing.assert_allclose(log.dq, values[:, 4:7], atol=1e-6)


def refusal(source, *arguments, **options):
    with pytest.raises(InputError) as caught:
        read_log(source, *arguments, **options)
    line = caught.value.on_command_line
    assert "\n" not in line
    assert caught.value.remedy
    return line


def scaled(values, **factors):
    """The same with its columns of some kinds in another unit."""
    changed, places = values.copy(), {"t": slice(0, 1), "q": slice(1, 4), "dq": slice(4, 7), "tau": slice(7, 10)}
    for kind, factor in factors.items():
        changed[:, places[kind]] *= factor
    return changed


# ---------------------------------------------------------------------------------------------------------------
# Read right at once
# ---------------------------------------------------------------------------------------------------------------
START = datetime(2026, 2, 3, 10, 59, 58, 500_000)
CLOCKS = {
    "German": "%d.%m.%Y %H:%M:%S.%f",
    "American": "%m/%d/%Y %I:%M:%S.%f %p",
    "year first": "%Y/%m/%d %H:%M:%S.%f",
    "minutes and seconds": "%M:%S.%f",
    "thousandths behind a colon": "%H:%M:%S:%f",
    "zone": "%Y-%m-%dT%H:%M:%S.%f+01:00",
}


@pytest.mark.parametrize("form", CLOCKS)
def test_clocks(tmp_path, values, form):
    """Over a change of the minute, and of the hour where there are hours."""
    start = START if "%H" in CLOCKS[form] else datetime(2026, 2, 3, 10, 13, 58)
    cells = [(start + timedelta(seconds=t)).strftime(CLOCKS[form]) for t in values[:, 0]]
    rows = [
        f"{cell};{line.partition(';')[2]}" for cell, line in zip(cells, lines(values, separator=";")[1:], strict=True)
    ]
    assert_same(read_log(save(tmp_path / "log.csv", [";".join(NAMES), *rows])), values)


def inserted(rows, at, *more):
    return [*rows[:at], *more, *rows[at:]]


READ = {
    "remarks between": lambda v: inserted(lines(v), 100, "# marker: second motion", "% and a third"),
    "a remark at the end": lambda v: [*lines(v), "", "# 300 rows"],
    "every line in quotes": lambda v: [f'"{line}"' for line in lines(v)],
    "every line in quotes, with quotes": lambda v: ['"' + line.replace("t,", '""t"",', 1) + '"' for line in lines(v)],
    "signs of minus": lambda v: [lines(v)[0], *(line.replace("-", "\u2212") for line in lines(v)[1:])],
    "a separator behind every line": lambda v: [line + "," for line in lines(v)],
    "tabs and spaces": lambda v: [line.replace(",", "\t ") for line in lines(v)],
    "lines that end in CR": lambda v: ["\r".join(lines(v))],
    "revolutions": lambda v: lines(scaled(v, q=0.5 / np.pi), ["t", *(f"q{j} [rev]" for j in (1, 2, 3)), *NAMES[4:]]),
    "N mm": lambda v: lines(scaled(v, tau=1e3), [*NAMES[:7], *(f"tau{j} [Nmm]" for j in (1, 2, 3))]),
    "minutes": lambda v: lines(scaled(v, t=1.0 / 60.0), ["t [min]", *NAMES[1:]], cell="{:.10f}".format),
    "commands beside": lambda v: lines(np.column_stack([v, v[:, 1:4] + 1.0]), [*NAMES, "q1_cmd", "q2_cmd", "q3_cmd"]),
    "Chinese words beside": lambda v: [f"{line},{'备注' if k == 0 else '正常'}" for k, line in enumerate(lines(v))],
}


@pytest.mark.parametrize("form", READ)
@pytest.mark.parametrize(("encoding", "end"), [("utf-8", "\n"), ("utf-16", "\r\n")])
def test_forms_that_are_read(tmp_path, values, form, encoding, end):
    assert_same(read_log(save(tmp_path / "log.csv", READ[form](values), encoding, end)), values)


def test_a_count_of_rows_is_a_time(tmp_path, values):
    """`--columns t="sample[10ms]"`: each row is 10 ms."""
    counted = scaled(values, t=100.0)
    path = save(tmp_path / "log.csv", lines(counted, ["sample", *NAMES[1:]]))
    assert 'with --columns t="sample",q="q{}",tau="tau{}"' in refusal(path)
    said = refusal(path, columns={"t": "sample"})
    assert 'milliseconds or rows?; name the column sample[ms], or give --columns t="sample[ms]" ' in said
    assert said.endswith('t="sample[8ms]" if it counts rows of 8 ms')
    assert_same(read_log(path, columns={"t": "sample[10ms]"}), values)


# ---------------------------------------------------------------------------------------------------------------
# Refused in one line
# ---------------------------------------------------------------------------------------------------------------
def packed(values, archive):
    content, file = "\n".join(lines(values)).encode(), io.BytesIO()
    if archive == "gzip":
        return gzip.compress(content)
    with zipfile.ZipFile(file, "w") as folder:
        folder.writestr("xl/workbook.xml" if archive == "excel" else "log.csv", content)
    return file.getvalue()


def records(values):
    return [dict(zip(NAMES, row, strict=True)) for row in values.tolist()]


FOREIGN = {
    "JSON": (lambda v: json.dumps(records(v)).encode(), "is JSON; write its columns as CSV, or give it from Python: "),
    "JSON, indented": (lambda v: json.dumps({"t": [0.0]}, indent=1).encode(), "is JSON; "),
    "lines of JSON": (
        lambda v: "\n".join(map(json.dumps, records(v))).encode(),
        "(pandas.read_json(FILE, lines=True))",
    ),
    "HTML": (lambda v: b"<!DOCTYPE html>\n<html><body><table></table></body></html>", "is a web page (HTML)"),
    "HTML with a mark": (lambda v: b"\xef\xbb\xbf\n<html>\n<head>", "is a web page (HTML)"),
    "XML": (lambda v: b'<?xml version="1.0"?>\n<Rob Type="KUKA"/>', "is XML; "),
    "gzip": (lambda v: packed(v, "gzip"), "is compressed; unpack it, and give the log inside"),
    "zip": (lambda v: packed(v, "zip"), "is a zip archive; unpack it"),
    "Excel": (lambda v: packed(v, "excel"), "is an Excel workbook; save the sheet with the log as CSV"),
    "NumPy": (lambda v: npy(v), "is an array of NumPy; give it from Python"),
    "HDF5": (lambda v: b"\x89HDF\r\n\x1a\n" + bytes(600), "is an HDF5 file, but none of MATLAB"),
    "trace of KUKA": (
        lambda v: b"DIAEXTENDED  {@:ENGLISH\n#BEGINGLOBALHEADER\n",
        "a header of DIAdem, as KUKA's trace",
    ),
    "bag of ROS 1": (lambda v: b"#ROSBAG V2.0\n" + bytes(99), "is a bag of ROS 1; convert it: rosbags-convert"),
}


def npy(values):
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


@pytest.mark.parametrize("form", FOREIGN)
@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
def test_files_of_another_kind(tmp_path, values, form, name):
    content, said = FOREIGN[form]
    (tmp_path / name).write_bytes(content(values))
    assert said in refusal(tmp_path / name)
    assert said in refusal(tmp_path / name, columns={"t": "time"})


def test_what_is_said_of_json_works(tmp_path, values):
    pandas = pytest.importorskip("pandas")
    (tmp_path / "log.json").write_text("\n".join(map(json.dumps, records(values))))
    assert_same(read_log(pandas.read_json(tmp_path / "log.json", lines=True)), values)


def changed_cell(values, row, cell):
    rows = [line.split(",") for line in lines(values)]
    rows[row][5] = cell
    return [",".join(row) for row in rows]


def dated(values):
    cells = [(START + timedelta(seconds=t)).strftime("%Y-%m-%d %H:%M:%S") for t in values[:, 0]]
    rows = [f"{cell},{line.partition(',')[2]}" for cell, line in zip(cells, lines(values)[1:], strict=True)]
    return [lines(values)[0], *rows]


REFUSED = {
    "header again": (
        lambda v: inserted(lines(v), 150, lines(v)[0]),
        "row 151: holds the header again; remove the row or",
    ),
    "no number": (lambda v: changed_cell(v, 50, "NaN"), "row 51: column dq2 holds nan; remove the row"),
    "empty cell": (lambda v: changed_cell(v, 50, ""), "row 51: column dq2 holds '', not a number; remove the row ("),
    "error": (lambda v: changed_cell(v, 50, "#DIV/0!"), "holds '#DIV/0!', not a number; remove the row (the log may"),
    "thousands": (
        lambda v: changed_cell(v, 50, '"1,234.5"'),
        "not a number; write numbers without separators of thousands",
    ),
    "row out of order": (lambda v: lines(v[::-1]), "row 3: time runs backwards, from 2.99 s to 2.98 s; sort or cut"),
    "shuffled": (lambda v: lines(np.random.default_rng(0).permutation(v) * [1e3, *[1] * 9]), "time runs backwards"),
    "unknown unit": (
        lambda v: lines(v, [*NAMES[:7], "tau1 [%]", "tau2 [%]", "tau3 [%]"]),
        "tau1 [%] is in %, which is no known unit of tau; give it in Nm, N m, N*m, N·m, N.m, mNm, mN m, or give gains",
    ),
    "whole seconds": (dated, "column t only advances every 1 s, while positions change between; record the time with"),
    "counts": (lambda v: lines(scaled(v, q=131072.0 / 6.3)), "neither rad nor degrees, are they counts of an encoder?"),
    "degrees and milliseconds": (
        lambda v: lines(scaled(v, q=57.3, dq=57.3, t=1e3)),
        'give --columns t="t[ms]" (t[s] if it is in seconds); positions reach 57.3: give --degrees too, if they are',
    ),
    "degrees/s": (
        lambda v: lines(scaled(v, dq=180.0 / np.pi)),
        "the velocity of joint 1 is 57.3 times the change of its position; if velocities are in degrees/s, name them ",
    ),
    "small angles in degrees": (
        lambda v: lines(scaled(v, q=0.1 * 180.0 / np.pi, dq=0.1)),
        "is 0.0175 times the change of its position; if positions are in degrees, name them q1[deg] and so on",
    ),
    "minutes unsaid": (
        lambda v: lines(scaled(v, t=1.0 / 60.0), cell="{:.9f}".format),
        "say the units of time, positions",
    ),
    "velocity turned": (
        lambda v: lines(scaled(v, dq=-1.0)),
        "velocity of joint 1 is -1 times the change of its position",
    ),
    "minutes unsaid, no velocity": (
        lambda v: lines(
            np.delete(scaled(v, t=1.0 / 60.0), [4, 5, 6], 1), [*NAMES[:4], *NAMES[7:]], cell="{:.9f}".format
        ),
        "most joints are faster than 60 rad/s; say the units of time and positions in the header",
    ),
    "mA for A": (lambda v: lines(scaled(v, tau=1e4)), "the effort of joint 1 reaches 3.1e+05 N m; say the unit of"),
}


@pytest.mark.parametrize("form", REFUSED)
def test_forms_that_are_refused(tmp_path, values, form):
    content, said = REFUSED[form]
    assert said in refusal(save(tmp_path / "log.csv", content(values)))


def test_a_text_of_unknown_letters(tmp_path, values):
    path = save(
        tmp_path / "log.csv",
        ["備考,ソ" + lines(values)[0], *("表,ﾏ" + line for line in lines(values)[1:])],
        "shift_jis",
    )
    assert "is text in an encoding that is not known; save it as UTF-8, as in: iconv -f SHIFT_JIS" in refusal(path)


@pytest.mark.parametrize("name", ["ur10e/a_50s", "ur10e/c_loaded", "panda/a", "tx40/a", "kr300/a", "lwr4/a"])
def test_real_logs_are_not_taken_for_wrong_units(name):
    assert len(read_log(real_log(f"{name}.csv"))) > 1000


def test_a_stranger_needs_three_commands(tmp_path, values, capfd):
    """Names, milliseconds and degrees of which nothing is said: each line holds the command that follows."""
    names = ["tick", *(f"{part}.{what}" for what in ("angle", "rate", "load") for part in ("hip", "knee", "toe"))]
    path = save(
        tmp_path / "log.csv", lines(scaled(values, t=1e3, q=57.29577951308232, dq=57.29577951308232), names, ";")
    )
    first = refusal(path)
    columns = first.partition("--columns ")[2]
    assert (
        columns
        == 't="tick",q1="hip.angle",q2="knee.angle",q3="toe.angle",tau1="hip.load",tau2="knee.load",tau3="toe.load"'
    )
    second = refusal(path, columns=columns)
    columns = second.partition("--columns ")[2].partition(" (")[0]
    assert "give --degrees too" in second
    assert_same(read_log(path, columns=columns, degrees=True), values)
    assert cli.main(["identify", str(path), "--robot", "kr5", "--columns", columns, "--degrees"]) == 2
    assert "the log has 3 joints, robot kuka_kr5_sixx_r650 has 6" in capfd.readouterr().err
