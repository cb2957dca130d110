"""Logs of people who have not read the documentation: read right at once, or refused by one line that leads on."""

import csv
import gzip
import io
import json
import zipfile
from datetime import datetime, timedelta

import numpy as np
import pytest
from log_files import RECORDED, assert_same, flat, refusal, save, scaled, strange, text, without

from bayesid.errors import InputError
from bayesid.log.reading import read_log

ROWS = len(RECORDED["t"])
DEGREES = 180.0 / np.pi
NO_DQ = without(RECORDED, "dq")
IN_MS = scaled(RECORDED, t=1e3)
LINES = text(flat(RECORDED)).splitlines()


def joined(lines):
    return "\n".join(lines) + "\n"


def units_beneath(end="\n"):
    lines = text(flat(IN_MS) | {"note": ["x"] * ROWS}, ";", ",").splitlines()
    units = ";".join(["ms", *["[rad]"] * 3, *["rad/s"] * 3, *["Nm"] * 3, ""])
    return end.join([lines[0], units, *lines[1:]])


def aligned():
    """Columns beneath each other, spaces between them."""
    return "\n".join("  " + " ".join(cell.rjust(24) for cell in line.split(",")) for line in LINES)


def clocked(form, separator=";", hour=10):
    """A clock's readings in place of seconds, over a change of the minute, and of the hour where there are hours."""
    start = datetime(2026, 2, 3, hour, 59 if "%H" in form or "%I" in form else 13, 58, 500_000)
    cells = [(start + timedelta(seconds=t)).strftime(form) for t in RECORDED["t"]]
    return text(flat(RECORDED) | {"t": cells}, separator)


def changed(row, column, cell):
    """The table with one other cell, in the row of the file."""
    table = [line.split(",") for line in LINES]
    table[row - 1][table[0].index(column)] = cell
    return joined(",".join(row) for row in table)


FORMS = {
    "semicolons, decimal commas": text(flat(RECORDED), ";", ","),
    "tabs, decimal commas": text(flat(RECORDED), "\t", ","),
    "pipes": text(flat(RECORDED), "|").replace("|", " | "),
    "tabs and spaces": text(flat(RECORDED)).replace(",", "\t "),
    "aligned": aligned(),
    "quoted": text(flat(RECORDED), quote=csv.QUOTE_ALL),
    "quoted decimal commas": text(flat(RECORDED), ",", ","),
    "every line in quotes": joined(f'"{line}"' for line in LINES),
    "every line in quotes, with quotes": joined('"' + line.replace("t,", '""t"",', 1) + '"' for line in LINES),
    "signs of minus": joined([LINES[0], *(line.replace("-", "\u2212") for line in LINES[1:])]),
    "milliseconds": text(flat(IN_MS, t="Zeit [ms]")),
    "minutes": text(flat(scaled(RECORDED, t=1.0 / 60.0), t="t [min]")),
    "degrees": text(flat(scaled(RECORDED, q=DEGREES, dq=DEGREES), q="q{} [Grad]", dq="dq{} [°/s]")),
    "revolutions": text(flat(scaled(RECORDED, q=0.5 / np.pi), q="q{} [rev]")),
    "N mm": text(flat(scaled(RECORDED, tau=1e3), tau="tau{} [Nmm]")),
    "another order": text(dict(reversed(flat(RECORDED).items()))),
    "words between": text({"note": ["Störung; ein, Wort"] * ROWS, **flat(RECORDED), "": [""] * ROWS}, ";", ","),
    "commands beside": text(flat(RECORDED) | flat({"q": RECORDED["q"] + 1.0}, q="q{}_cmd")),
    "Chinese words beside": joined(f"{line},{'正常' if k else '备注'}" for k, line in enumerate(LINES)),
    "index": joined(f"{k - 1 if k else ''},{line}" for k, line in enumerate(LINES)),
    "units beneath": units_beneath(),
    "units beneath, every other line blank": units_beneath("\r\r\n"),
    "line ends of Windows": text(flat(RECORDED), ";", ",", "\r\n"),
    "lines that end in CR": text(flat(RECORDED), end="\r"),
    "a note of the separator": "sep=;\r\n" + text(flat(RECORDED), ";", ",", "\r\n"),
    "settings above": f"Recorder 1.2\r\nDate;3.2.2026\r\n\r\n{text(flat(RECORDED), ';', ',')}",
    "notes above, header behind a #": "# Recorder 1.2, of 2026, by hand\n# 125 Hz\n# " + text(flat(RECORDED)),
    "remarks between and at the end": joined([*LINES[:100], "# second motion", "% third", *LINES[100:], "", "# end"]),
    "separators behind all but the header": joined([LINES[0], *(line + "," for line in LINES[1:])]),
    "separators behind all": joined(line + "," for line in LINES),
    "empty rows of a spreadsheet": joined([*LINES, *["," * LINES[0].count(",")] * 2]),
}
ENCODINGS = ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252")


@pytest.mark.parametrize("form", FORMS)
def test_forms_that_are_read_right_at_once(tmp_path, form):
    """In UTF-8 and another encoding each, with and without its mark."""
    encoding = ENCODINGS[list(FORMS).index(form) % 5]
    if any(ord(letter) > 255 for letter in FORMS[form]):
        encoding = "utf-16"
    for one in ("utf-8", encoding):
        assert_same(read_log(save(tmp_path / "log.csv", FORMS[form], one)), RECORDED)


def test_clocks(tmp_path):
    for form in (
        "%d.%m.%Y %H:%M:%S.%f",
        "%m/%d/%Y %I:%M:%S.%f %p",
        "%Y/%m/%d %H:%M:%S,%f",
        "%M:%S.%f",
        "%H:%M:%S:%f",
        "%Y-%m-%dT%H:%M:%S.%f+01:00",
    ):
        for hour in (10, 23) if "%S:%f" not in form else (10,):
            log = read_log(save(tmp_path / "log.csv", clocked(form, hour=hour)))
            np.testing.assert_allclose(log.t - log.t[0], RECORDED["t"], atol=1e-6)
            assert_same(log, RECORDED | {"t": log.t})
    late = clocked(form).splitlines()
    late[8] = "late;" + late[8].partition(";")[2]
    assert "row 9: column t holds 'late', not a time" in refusal(save(tmp_path / "log.csv", joined(late)))


USUAL = [
    (0, {}),
    (0, {"t": "timestamp", "q": "actual_q_{}", "dq": "actual_qd_{}", "tau": "actual_current_{}"}),
    (0, {"t": "time", "q": "q[{}]", "dq": "dq[{}]", "tau": "tau_J[{}]"}),
    (1, {"t": "Time", "q": "joint_{}", "dq": "velocity_{}", "tau": "effort_{}"}),
    (1, {"t": "Timestamp", "q": "position_{}", "dq": "joint_{}_velocity", "tau": "current_{}"}),
    (1, {"t": "time_s", "q": "joint_{}_position", "dq": "Joint{}Velocity", "tau": "joint{}.torque"}),
    (0, {"t": "/s/header/stamp", "q": "/s/position[{}]", "dq": "/s/velocity[{}]", "tau": "/s/tau[{}]"}),
    (1, {"t": "__time", "q": "/a/joint_{}/position", "dq": "/a/joint_{}/velocity", "tau": "/a/joint_{}/effort"}),
    (1, {"t": "Zeit", "q": "Achse{} [rad]", "dq": "Geschwindigkeit{} (rad/s)", "tau": "Strom{} [%]"}),
]


def test_names_that_are_usual_elsewhere_are_known(tmp_path):
    """But bayesid's own come before others: what stands beside a whole log is ignored, whatever it holds."""
    for start, names in USUAL:
        columns = flat(RECORDED, start=start, **names) | flat({"q": RECORDED["q"] + 9.0}, q="target_q_{}", start=start)
        gains = [1.0] * 3 if any(word in names.get("tau", "") for word in ("urrent", "Strom")) else None
        path = save(tmp_path / "log.csv", dict(reversed((columns | {"robot_mode": np.full(ROWS, 7)}).items())))
        assert_same(read_log(path, gains), RECORDED)
    more = ("time", "position_1", "velocity_1", "torque_1", "q_1", "Q1", "cmd/q1", "q1 [rad]")
    path = save(tmp_path / "log.csv", flat(RECORDED) | dict.fromkeys(more, np.full(ROWS, np.nan)))
    assert_same(read_log(path), RECORDED)
    path = save(tmp_path / "log.csv", flat(without(IN_MS, "dq")))
    assert_same(read_log(path, columns={"t": "t[ms]"}), NO_DQ)


def archive(name):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as folder:
        folder.writestr(name, joined(LINES))
    return file.getvalue()


RECORDS = [dict(zip(LINES[0].split(","), map(float, line.split(",")), strict=True)) for line in LINES[1:]]
JAPANESE = joined(["備考,ソ" + LINES[0], *("表,ﾏ" + line for line in LINES[1:])]).encode("shift_jis")
OTHER_KINDS = {
    "JSON": (json.dumps(RECORDS).encode(), ["JSON", "CSV", "Python"]),
    "HTML": (b"\xef\xbb\xbf\n<!DOCTYPE html>\n<html><body><table></table></body></html>", ["HTML"]),
    "gzip": (gzip.compress(joined(LINES).encode()), ["compressed", "unpack"]),
    "zip": (archive("log.csv"), ["zip", "unpack"]),
    "Excel": (archive("xl/workbook.xml"), ["Excel", "CSV"]),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(600), ["HDF5"]),
    "bag of ROS 1": (b"#ROSBAG V2.0\n" + bytes(99), ["ROS 1", "rosbags-convert"]),
    "unknown letters": (JAPANESE, ["encoding", "UTF-8", "iconv"]),
    "no text": (b"a" * 200_000, ["is not text"]),
    "nothing": (b"\n\n", ["header"]),
}


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_files_of_another_kind_are_named(tmp_path, kind):
    content, says = OTHER_KINDS[kind]
    for options in ({}, {"columns": {"t": "time"}}):
        said = refusal(save(tmp_path / "log.csv", content), **options)
        assert all(word in said for word in says), said


WHOLE_SECONDS = clocked("%Y-%m-%d %H:%M:%S", ",")
REFUSED = {
    "header again": (joined([*LINES[:150], LINES[0], *LINES[150:]]), ["row 151", "header again"]),
    "thousands": (changed(51, "dq2", '"1,234.5"'), ["row 51", "thousands separators"]),
    "backwards": (joined([LINES[0], *LINES[:0:-1]]), ["row 3", "time runs backwards"]),
    "no header": (joined(LINES[1:]), ["row 1", "holds numbers instead of column names"]),
    "ms": (text(flat(IN_MS)), ["milliseconds?", "t[ms]", "--columns"]),
    "ns": (text(flat(scaled(RECORDED, t=1e9))), ["nanoseconds?", "t[ns]"]),
    "whole seconds": (WHOLE_SECONDS, ["column t has 4 instants in 300 rows", "t[10ms]"]),
    "degrees": (text(flat(scaled(NO_DQ, q=30.0 * DEGREES))), ["may be degrees", "--degrees"]),
    "degrees and ms": (text(flat(scaled(RECORDED, q=DEGREES, dq=DEGREES, t=1e3))), ['t="t[ms]"', "--degrees too"]),
    "counts": (text(flat(scaled(RECORDED, q=2e4))), ["too large for rad or degrees", "encoder counts"]),
    "degrees/s": (text(flat(scaled(RECORDED, dq=DEGREES))), ["velocity of joint 1 is 57.3 times", "degrees/s"]),
    "small angles in degrees": (
        text(flat(scaled(RECORDED, q=0.1 * DEGREES, dq=0.1))),
        ["0.0175 times the derivative of its position", "q1[deg]"],
    ),
    "minutes": (text(flat(scaled(RECORDED, t=1.0 / 60.0))), ["write the units of time, positions"]),
    "velocity turned": (text(flat(scaled(RECORDED, dq=-1.0))), ["velocity of joint 1 is -1 times"]),
    "frantic": (text(flat(scaled(NO_DQ, t=1e-3))), ["most joints are faster than 60 rad/s", "units of time"]),
    "glacial": (text(flat(scaled(RECORDED, t=1e14))), ["too slow for a joint log in s"]),
    "percent": (text(flat(RECORDED, tau="tau{} [%]")), ["tau1 [%]", "Nm", "gains"]),
    "mA for A": (text(flat(scaled(RECORDED, tau=1e4))), ["effort of joint 1 reaches", "unit"]),
    "decimal commas unquoted": (text(flat(RECORDED), ",", ",").replace('"', ""), ["decimal commas"]),
    "currents": (text(flat(RECORDED, tau="i{}")), ["--gains K1,..,Kn", "N m/A"]),
    "positions unnamed": (text(flat(RECORDED, q="X{}")), ["X{} (not used)", "--columns"]),
    "counted from 0 and 1": (text(flat(NO_DQ) | {"q0": RECORDED["t"]}), ["q0..q3 count from 0, tau1..tau3 from 1"]),
    "two times": (
        text(without(flat(RECORDED), "t") | {"time": RECORDED["t"], "timestamp": RECORDED["t"]}),
        ["time and timestamp could both be the time", "--columns t="],
    ),
    "measured ones beside plain names": (
        text(flat(RECORDED) | {f"actual_q_{j}": RECORDED["q"][:, j] for j in range(RECORDED["q"].shape[1])}),
        ["q1 and actual_q_", "could both be q", '--columns q="actual_q_{}"'],
    ),
    "one joint missing": (text(without(flat(NO_DQ), "q2")), ["column q2 is missing", "the file has q1..q3"]),
    "no time": (text(without(flat(RECORDED), "t")), ["q{} (q), dq{} (dq), tau{} (tau)", '--columns t="NAME"']),
    "a wild clock": (
        text(without(flat(RECORDED), "t") | {"clock": RECORDED["t"]}),
        ['--columns t="clock",q="q{}",tau="tau{}"'],
    ),
}


@pytest.mark.parametrize("form", REFUSED)
def test_what_a_log_leaves_open_is_one_line(tmp_path, form):
    content, says = REFUSED[form]
    said = refusal(save(tmp_path / "log.csv", content))
    assert all(word in said for word in says), said


def test_rows_are_counted_from_the_first_line_of_the_file(tmp_path):
    lines = ["Recorder 1.2", "", *text(flat(RECORDED), ";").splitlines()]
    for cell, said in (("inf", "holds inf"), ("x", "holds 'x', not a number")):
        bad = [*lines[:9], ";".join([lines[9].partition(";")[0], cell, *lines[9].split(";")[2:]]), *lines[10:]]
        assert f"row 10: column q1 {said}" in refusal(save(tmp_path / "log.csv", joined(bad)))


@pytest.mark.parametrize(
    "columns",
    [
        strange(),
        flat(RECORDED) | {"q0": RECORDED["t"], "dq0": RECORDED["t"]},
        flat(NO_DQ, t="clock", q="x{}", start=0) | {"x3": np.zeros(ROWS)},
    ],
    ids=["strange", "a rail before the arm", "an axis too many"],
)
def test_the_columns_that_a_refusal_suggests_read_the_log(tmp_path, columns):
    path = save(tmp_path / "log.csv", text(columns, ";"))
    stated = {"q": "x{0-2}"} if "x3" in columns else None
    gains = [1.0] * 3 if "Nr" in columns else None
    said = refusal(path, columns=stated)
    suggested = said.partition("as in " if "as in " in said else "--columns ")[2]
    log = read_log(path, gains, columns=suggested)
    np.testing.assert_allclose(log.q, RECORDED["q"], atol=1e-12)
    np.testing.assert_allclose(log.effort, RECORDED["tau"], rtol=1e-12)


def test_what_efforts_and_times_are_meant(tmp_path):
    """Torques that are currents, velocities that are no efforts, and `t="sample[10ms]"`: each row is 10 ms."""
    path, gains = save(tmp_path / "log.csv", flat(RECORDED, tau="effort_{}")), [2.0, 3.0, 1.0]
    assert_same(read_log(path), RECORDED)
    assert 'drop --gains, or give --columns i="effort_{}"' in refusal(path, gains=gains)
    log = read_log(path, gains, columns={"i": "effort_{}"})
    assert_same(log, RECORDED | {"tau": RECORDED["tau"] * gains})
    names = {"t": "Time stamp /s", "q": "Axis {} act. pos", "dq": "Axis {} act. vel", "tau": "|M{}| Nm"}
    path = save(tmp_path / "log.csv", flat(RECORDED | {"tau": np.abs(RECORDED["tau"])}, **names))
    wrong = without(names, "dq") | {"tau": names["dq"]}
    assert "the efforts equal the joints' velocities" in refusal(path, columns=wrong)
    path = save(tmp_path / "log.csv", flat(RECORDED | {"t": np.arange(ROWS)}, t="sample"))
    assert 't="sample"' in refusal(path)
    assert "rows?" in refusal(path, columns={"t": "sample"})
    assert_same(read_log(path, columns={"t": "sample[10ms]"}), RECORDED)


@pytest.mark.parametrize(
    ("word", "gains", "expected", "absent"),
    [
        ("電流", None, 'give `gains`, and name the columns with `columns` t="x",q="Lage{}",i="電流{}"', "tau="),
        ("Wert", [4.0, 3.0], 'i="Wert{}"', "give `gains`"),
        ("Wert", None, 'tau="Wert{}"; if these efforts are currents', "\n"),
        ("トルク", None, 'tau="トルク{}"', "currents"),
    ],
)
def test_a_suggested_kind_of_efforts_follows_their_name_and_the_gains(tmp_path, word, gains, expected, absent):
    path = tmp_path / "log.csv"
    rows = [f"x,Lage1,Lage2,{word}1,{word}2", *(f"{i},{i},{2 * i},{3 * i},{4 * i}" for i in range(1, 9))]
    path.write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_log(path, gains)
    assert expected in str(refused.value)
    assert absent not in str(refused.value)
