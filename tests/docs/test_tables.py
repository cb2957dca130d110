"""docs/make_tables.py: the tables of the pages are those that it makes, from rows like those of the studies."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from bayesid.model.terms import STANDARD
from bayesid.study.names import STUDIES

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS))
from make_tables import NAMES, PAGES, TABLES, with_reports, with_tables  # noqa: E402

MARKED = re.compile(r"<!-- table: (?P<name>.*?) -->\n(?P<table>.*?)<!-- end of table -->", re.S)
REPORT = re.compile(r"^### (?P<study>\w+)\n.*?^```text\n(?P<text>.*?)^```$", re.S | re.M)


def marked():
    """All tables that stand between markers: name and text."""
    return [(found["name"], found["table"]) for page in PAGES for found in MARKED.finditer(page.read_text("utf-8"))]


def real_row(log="ur10e/a_50s", terms=STANDARD, predicts=""):
    """A row of the study `real` with numbers that are all different."""
    return {
        "log": log,
        "terms": list(terms),
        "predicts": predicts,
        "segments": 123,
        "all": 0.91234,
        "motion": 0.92345,
        "smooth": 0.93456,
        "velocity": 0.5678,
        "certified": True,
        "settled": 0.9765,
        "every_sure": 0.8765,
        "every_sure_wrong": 0.00123,
        "auc": 0.8412,
        "auc_moving": 0.9521,
    }


def test_every_table_stands_in_a_page_and_every_marker_has_a_table():
    assert {name for name, _ in marked()} == set(TABLES)
    assert {study for study, _ in TABLES.values()} <= set(STUDIES)


def test_tables_of_real_logs_have_the_head_and_form_of_the_page():
    poor = real_row(terms=("rigid_body",))
    for name in (name for name, (study, _) in TABLES.items() if study == "real"):
        made = TABLES[name][1]([real_row(), poor, real_row(predicts="panda/a")]).splitlines()
        there = dict(marked())[name].splitlines()
        assert made[:2] == there[:2]
        assert len(made) == 3
        assert form(made[2]) == form(there[2])


def form(line):
    """A line of a table with every number replaced."""
    return re.sub(r"\d+", "#", line.partition(",")[2])


@pytest.mark.parametrize("name", ["signs", "confidences"])
def test_numbers_of_real_logs_are_those_of_the_report(name):
    """One run made both: every percentage of the table is in the report, to the digits shown."""
    reports = REPORT.finditer((DOCS / "studies.md").read_text("utf-8"))
    report = next(found["text"] for found in reports if found["study"] == "real")
    given = {float(share) for share in re.findall(r"([\d.]+)%", report)}
    for share in re.findall(r"([\d.]+)%", dict(marked())[name]):
        digits = len(share.partition(".")[2])
        assert any(abs(float(share) - other) <= 0.51 * 10.0**-digits for other in given), share


def test_a_page_is_renewed_where_rows_are_given_and_nowhere_else():
    page = (
        "# Page\n<!-- table: signs -->\nold\n<!-- end of table -->\nkept\n<!-- table: paper -->\nolder\n"
        "<!-- end of table -->\n"
    )
    made = with_tables(page, {"real": [real_row()]})
    assert "old\n" not in made.replace("older\n", "")
    assert "older\n" in made
    assert f"| {NAMES['ur10e/a_50s']} | 123 | 91.23% |" in made
    assert with_tables(made, {"real": [real_row()]}) == made


def test_a_report_is_renewed_in_its_section():
    page = "### noise\n\nText.\n\n```text\nold\n```\n\n### bare\n\nnone\n\n### duration\n\n```text\nkept\n```\n"
    assert with_reports(page, {"noise": "a \\1\n", "bare": "b\n", "sbc": "c\n"}) == page.replace("old", "a \\1")
