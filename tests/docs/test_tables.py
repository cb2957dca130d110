"""docs/make_tables.py: the tables of the pages are those that it makes, from rows like those of the studies."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from bayesid.study import STUDIES

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS))
from make_tables import PAGES, TABLES  # noqa: E402

MARKED = re.compile(r"<!-- table: (?P<name>.*?) -->\n(?P<table>.*?)<!-- end of table -->", re.S)
REPORT = re.compile(r"^### (?P<study>\w+)\n.*?^```text\n(?P<text>.*?)^```$", re.S | re.M)


def marked():
    """All tables that stand between markers: name and text."""
    return [(found["name"], found["table"]) for page in PAGES for found in MARKED.finditer(page.read_text("utf-8"))]


def test_every_table_stands_in_a_page_and_every_marker_has_a_table():
    assert {name for name, _ in marked()} == set(TABLES)
    assert {study for study, _ in TABLES.values()} <= set(STUDIES)


@pytest.mark.parametrize("name", ["signs", "confidences"])
def test_numbers_of_real_logs_are_those_of_the_report(name):
    """One run made both: every percentage of the table is in the report, to the digits shown."""
    reports = REPORT.finditer((DOCS / "studies.md").read_text("utf-8"))
    report = next(found["text"] for found in reports if found["study"] == "real")
    given = {float(share) for share in re.findall(r"([\d.]+)%", report)}
    for share in re.findall(r"([\d.]+)%", dict(marked())[name]):
        digits = len(share.partition(".")[2])
        assert any(abs(float(share) - other) <= 0.51 * 10.0**-digits for other in given), share
