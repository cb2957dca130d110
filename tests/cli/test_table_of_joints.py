"""The table that `bayesid identify` ends with: its figures are those of the files, of recorded samples in motion."""

import csv
import json
import re

import numpy as np
import pytest
from command_line import QUICK, identify, run

import bayesid

GAP = 2.0, 3.5
"""s, without rows."""
EDGE = 0.06
"""s next to the pause, whose accelerations are not trusted: rows there do not count as in motion."""


def rows_of(text, n_joints):
    """The last table of a text, a list of words a joint."""
    lines = [line for line in text.replace(" %", "%").splitlines() if re.match(r"\s*\d+\s+\d+\s", line)]
    return [line.split() for line in lines[-n_joints:]]


@pytest.fixture
def with_gap(arm_place):
    header, *lines = (arm_place / "log.csv").read_text().splitlines()
    kept = [line for line in lines if not GAP[0] < float(line.split(",")[0]) < GAP[1]]
    assert len(kept) < len(lines) - 100
    (arm_place / "gap.csv").write_text("\n".join([header, *kept, ""]))
    return arm_place


@pytest.mark.parametrize("log", ["log.csv", "gap.csv"])
def test_terminal_segments_and_report_count_what_was_recorded(with_gap, capfd, log):
    assert run(*identify(log), *QUICK[1:], "--complete", "off") == 0
    out = capfd.readouterr().out
    content = json.loads((with_gap / "out" / "summary.json").read_text())
    joints = rows_of(out, 3)
    with (with_gap / "out" / "segments.csv").open(newline="") as file:
        segments = list(csv.DictReader(file))
    assert [int(row[1]) for row in joints] == [sum(one["joint"] == row[0] for one in segments) for row in joints]
    assert content["n_segments"] == len(segments)
    assert [row[3] for row in joints] == [f"{share:.1%}" for share in content["signs"]["sure"]]
    signs = next(one for one in bayesid.load("out").checks() if "Signs" in one.name)
    assert sum(int(row[2]) for row in joints) == int(re.search(r"(\d+) of \d+ segments in motion", signs.message)[1])
    assert signs.value == pytest.approx(np.mean(content["signs"]["sure"]), rel=1e-12)
    if log == "gap.csv":
        assert all(float(one["end"]) <= GAP[0] or float(one["start"]) >= GAP[1] - 1e-9 for one in segments)
    signed = bayesid.read_log(with_gap / "out" / "signed_log.csv")
    assert np.diff(signed.t).max() > 1.0 or log == "log.csv"
    table = np.genfromtxt(with_gap / "out" / "signed_log.csv", delimiter=",", names=True)
    inner = np.array([log == "log.csv" or min(abs(t - edge) for edge in GAP) > EDGE for t in table["t"]])
    for j, share in enumerate(content["signs"]["sure"], start=1):
        effort, p, moving = np.abs(table[f"tau{j}"]), table[f"p{j}"], inner & (np.abs(table[f"dq{j}"]) > 0.02)
        of_rows = effort[moving & (np.maximum(p, 1.0 - p) >= 0.99)].sum() / effort[moving].sum()
        assert share == pytest.approx(of_rows, abs=0.01)


def test_known_signs_are_not_said_to_be_searched(arm_shop, arm_place, capfd):
    """Neither in a log that holds all, nor of the joints of one that holds some."""
    signed = str(arm_shop / "result" / "signed_log.csv")
    for options, searched, columns in (((), False, 3), (("--unsigned", "1,3"), True, 5)):
        assert run(*identify(signed, out=f"out{columns}"), *QUICK[1:], "--complete", "off", *options) == 0
        out = capfd.readouterr().out
        assert ("searched)" in out, "ambiguous" in out, "cone problems" in out) == (searched, searched, searched)
        joints = rows_of(out, 3)
        assert {len(row) for row in joints} == {columns}
        assert ["known" in row for row in joints] == [False, searched, False]
