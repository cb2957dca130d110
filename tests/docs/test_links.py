"""README and docs/ lead somewhere: links and anchors, commands and options, names of bayesid, equations, robots."""

from __future__ import annotations

import json
import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

import bayesid
from bayesid.cli.arguments import BAYESID
from bayesid.cli.parser import make_parser
from bayesid.robot.load import BUILT_IN, built_in_table

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
THEORY = ("method", "certified-search", "posterior", "discrepancy", "pbpr")
CODE = [path for folder in ("bayesid", "studies") for path in sorted((ROOT / folder).rglob("*.py"))]
EQUATION = re.compile(r"^ *\$\$\n(?P<formula>[^$]+)\n *\$\$(?: \((?P<label>[\w-]+)\))?$", re.M)
CITED = re.compile(r"(?::eq:|\{eq\})`(?P<label>[^`\s]+)`")


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def prose_of(path: Path) -> str:
    """A page without its fenced blocks, a notebook's text."""
    if path.suffix == ".ipynb":
        cells = json.loads(text_of(path))["cells"]
        return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return re.sub(r"^ *```.*?^ *```$", "", text_of(path), flags=re.M | re.S)


def anchors_of(path: Path) -> set[str]:
    """Of a page's headings, as repository pages and the site make them."""
    headings = re.findall(r"^#+ (.+)$", prose_of(path), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_and_their_anchors_lead_somewhere():
    wrong = []
    for page in (*PAGES, *NOTEBOOKS):
        for target in re.findall(r"\]\(([^)\s]+)\)", prose_of(page)):
            name, _, anchor = target.partition("#")
            place = (page.parent / name).resolve() if name else page
            if "://" not in target and not (place.exists() and (not anchor or anchor in anchors_of(place))):
                wrong.append((page.name, target))
    assert wrong == []


def test_python_files_that_pages_name_are_there():
    files = {path.name for folder in ("bayesid", "studies", "docs", "tests") for path in (ROOT / folder).rglob("*.py")}
    named = {name for page in PAGES for name in re.findall(r"`(?:[\w/]+/)?(\w+\.py)`", prose_of(page))}
    assert named
    assert named <= files


def test_commands_and_options_that_pages_name_are_there():
    """`bayesid COMMAND --option`, in prose or in a block, is what the command line takes."""
    wrong, seen, main = [], 0, make_parser(BAYESID)
    for page in PAGES:
        text = text_of(page).replace("\\\n", " ")
        lines = re.findall(r"`(bayesid [^`]+)`", text, re.S) + re.findall(r"^ *(?:\$ )?(bayesid .*)$", text, re.M)
        for line in (" ".join(line.split("#")[0].split()) for line in lines):
            parser, words = main, re.split(r"[ |;&=]+", line)[1:]
            for word in words:
                if word not in parser.commands:
                    break
                parser = parser.commands[word]
            options = [word for word in words if re.fullmatch(r"--[a-z][a-z-]*", word)]
            seen += len(options)
            if parser is main and re.fullmatch(r"[a-z]+", words[0]):
                wrong.append((page.name, line))
            wrong += [(page.name, line, option) for option in options if option not in parser.options]
    assert wrong == []
    assert seen > 100


def test_names_that_pages_use_exist_and_are_in_the_reference():
    listed = {
        name
        for page in (DOCS / "reference").glob("*.md")
        for name in re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text_of(page), re.M)
    }
    assert {f"bayesid.{name}" for name in bayesid.__all__} <= listed
    assert {f"bayesid.types.{name}" for name in bayesid.types.__all__} <= listed
    named = {name for page in PAGES for name in re.findall(r"`(bayesid(?:\.(?!toml\b)\w+)+)", text_of(page))}
    missing = {name for name in named if not any(covers(one, name) for one in listed)}
    assert missing == set()
    for name in named:
        resolve_name(name)


def covers(one: str, name: str) -> bool:
    """Whether a module or name of the reference is, holds or belongs to a dotted name."""
    return f"{name}.".startswith(f"{one}.") or one.startswith(f"{name}.")


@pytest.mark.parametrize("page", THEORY)
def test_every_equation_of_the_theory_has_a_label(page):
    path = DOCS / f"{page}.md"
    labels = [found["label"] for found in EQUATION.finditer(prose_of(path))]
    assert labels
    assert None not in labels
    assert prose_of(path).count("$$") == 2 * len(labels), "a `$$` that does not stand on a line of its own"


def test_citations_lead_to_equations():
    labels = [found["label"] for page in PAGES for found in EQUATION.finditer(prose_of(page)) if found["label"]]
    assert len(set(labels)) == len(labels)
    cited = {(found["label"], path.name) for path in (*PAGES, *CODE) for found in CITED.finditer(text_of(path))}
    assert [one for one in sorted(cited) if one[0] not in labels] == []


def test_the_page_lists_all_built_in_robots():
    text = text_of(DOCS / "logs-and-robots.md")
    rows = re.findall(r"^\| `([\w-]+)` \| (.*?) \| (.*?) \|$", text[text.index("| built-in | robot |") :], re.M)
    tables = {name: built_in_table(name) for name in BUILT_IN}
    assert {name: tuple(said) for name, *said in rows[: len(BUILT_IN)]} == {
        name: (table["description"], table["source"]) for name, table in tables.items()
    }
