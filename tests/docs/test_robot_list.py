"""The table of built-in robots in docs/logs-and-robots.md is that of the folder."""

import re
from pathlib import Path

from bayesid.model.robot.built_in import BUILT_IN, built_in_table

PAGE = Path(__file__).parents[2] / "docs" / "logs-and-robots.md"


def test_the_page_lists_all_built_in_robots():
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \|$", text[text.index("| built-in | robot |") :], re.M)
    tables = {name: built_in_table(name) for name in BUILT_IN}
    assert {name: tuple(said) for name, *said in rows[: len(BUILT_IN)]} == {
        name: (table["description"], table["source"]) for name, table in tables.items()
    }
