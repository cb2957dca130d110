"""docs/make_tables.py: the tables of the pages are those that it makes, from rows like those of the studies."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from bayesid.study import STUDIES

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS))
from make_tables import OF_CODE, PAGES, STUDY_PAGES, TABLES, study_page, with_peers  # noqa: E402

MARKED = re.compile(r"<!-- table: (?P<name>.*?) -->\n(?P<table>.*?)<!-- end of table -->", re.S)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")
REPORTS = {path.stem: path.read_text("utf-8") for path in sorted(STUDY_PAGES.glob("*.md")) if path.stem in STUDIES}
PEERS = {"peers by robot", "peers by log", "peers where the truth is known", "peers without signs"}


def marked():
    """All tables that stand between markers: name and text."""
    return [(found["name"], found["table"]) for page in PAGES for found in MARKED.finditer(page.read_text("utf-8"))]


def answers():
    """Of docs/studies.md: the sections of studies, by name."""
    sections = re.split(r"^### ", (DOCS / "studies.md").read_text("utf-8"), flags=re.M)[1:]
    return {name: text for name, _, text in (section.partition("\n") for section in sections)}


def is_in(number, text):
    """Whether a text has a number, to the digits shown."""
    digits = len(number.partition(".")[2])
    return any(abs(abs(float(number)) - abs(float(other))) <= 0.51 * 10.0**-digits for other in NUMBER.findall(text))


def test_every_table_stands_in_a_page_and_every_marker_has_a_table():
    made = {*TABLES, *OF_CODE, *PEERS, *(f"report of {study}" for study in REPORTS)}
    assert {name for name, _ in marked()} == made
    assert {study for study, _ in TABLES.values()} <= set(STUDIES)


@pytest.mark.parametrize("name", list(OF_CODE))
def test_tables_of_the_code_are_up_to_date(name):
    assert dict(marked())[name] == OF_CODE[name](), "run `python docs/make_tables.py .`"


def test_every_study_has_its_answer_and_every_report_its_page():
    assert set(answers()) == set(STUDIES)
    for study, page in REPORTS.items():
        trials = re.search(r"Report of (\d+) trials", page)[1]
        report = re.search(r"^```text\n(.*?)^```$", page, re.M | re.S)[1]
        assert page == study_page(study, int(trials), report)
        assert f"(studies/{study}.md)" in answers()[study]


@pytest.mark.parametrize("study", REPORTS)
def test_numbers_of_an_answer_are_those_of_the_report(study):
    """What an answer says in bold."""
    bold = " ".join(re.findall(r"\*\*(.*?)\*\*", answers()[study], re.S))
    assert bold
    assert [number for number in NUMBER.findall(bold) if not is_in(number, REPORTS[study])] == []


def test_tables_of_peers_are_taken_from_what_the_benchmark_prints():
    page = "<!-- table: peers by log -->\n{}<!-- end of table -->\nafter\n"
    table = "| log -> predicted | s |\n| --- | --- |\n| a | 1 |\n"
    printed = f"bayesid 0\n| simulated | s |\n| --- | --- |\n\n{table}\n| x |\n"
    assert with_peers(page.format("| old |\n"), printed) == page.format(table)


def test_numbers_of_real_logs_in_the_text_are_those_of_the_report():
    report, results = REPORTS["real"], (DOCS / "results.md").read_text("utf-8")
    pooled = re.search(r"^pooled +\d+ +([\d.]+)% +([\d.]+)$", report, re.M).groups()
    least = re.search(r"at least ([\d.]+)% of the strong", report)[1]
    assert re.search(
        r"least ([\d.]+) %.*?rest: ([\d.]+) %.*?confidence ([\d.]+\d)", answers()["real"], re.S
    ).groups() == (least, *pooled)
    coverage = [100.0 * float(share) for share in re.search(r"^ +coverage(.*)$", report, re.M)[1].split()]
    low, high = re.search(r"hold ([\d.]+) to ([\d.]+) %\s+of the\s+efforts", results).groups()
    assert (float(low), float(high)) == pytest.approx((min(coverage), max(coverage)))


@pytest.mark.parametrize("name", ["signs", "confidences"])
def test_numbers_of_real_logs_are_those_of_the_report(name):
    """One run made both: every percentage of the table is in the report, to the digits shown."""
    given = " ".join(re.findall(r"([\d.]+) ?%", REPORTS["real"]))
    assert [share for share in re.findall(r"([\d.]+) ?%", dict(marked())[name]) if not is_in(share, given)] == []
