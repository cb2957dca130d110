"""`bayesid demo --search beam --paper`: the paper's experiment to the letter."""

import csv
import json
import re

import pytest
from command_line import assert_refused, run

WORDS = "demo", "--search", "beam", "--paper", "--out", "letter"


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_experiment_is_the_papers_and_every_node_is_written(place, capfd):
    assert run(*WORDS, "--seed", 1) == 0
    said, _ = capfd.readouterr()
    segments = int(re.search(r"segments: (\d+) ", said)[1])
    assert 35 <= segments <= 45
    assert f"signs: {segments} of {segments} right" in said
    assert int(re.search(r"known to 25 %: (\d+)", said)[1]) >= 26
    assert len(re.findall(r"^ *\d+ +.* -?\d\.\d{4} +-?\d\.\d{4} +-?\d\.\d{4}", said, re.M)) == 27
    assert re.search(r"^Verdict: good", said, re.M)
    with (place / "letter" / "nodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert ",".join(rows[0]) == "depth,node,parent,signs,ols_cost,cone_cost,feasible,lmi_margin,fate"
    assert len(rows) == 32 + 10 * (segments - 5)
    assert f"nodes: {len(rows)} = " in said
    assert [len(row["signs"]) for row in rows] == [5] * 32 + [1] * (len(rows) - 32)
    assert sum(row["fate"] == "leaf" for row in rows) == 5
    assert all((row["feasible"] == "1") == (float(row["lmi_margin"]) >= 0.0) for row in rows)
    summary = json.loads((place / "letter" / "summary.json").read_text())
    assert (summary["n_segments_searched"], summary["search"]["certified"]) == (segments, False)
    for reason in summary["verdict"]["reasons"]:
        assert "--paper" not in reason["remedy"], "the paper's search alone cannot do what is advised"
    assert_refused(capfd, WORDS, ["letter", "--force"])


def test_the_papers_search_is_no_other(place, capfd):
    assert_refused(capfd, ("demo", "--paper", "--search", "certified"), ["--search beam"])
