"""The documentation's site: labels of equations, links with anchors, what the reference covers, and the build."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from pkgutil import resolve_name

import browser
import pytest

import bayesid

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
THEORY = [DOCS / f"{name}.md" for name in ("method", "certified-search", "posterior", "discrepancy", "pbpr")]
CODE = [path for folder in ("bayesid", "studies") for path in sorted((ROOT / folder).rglob("*.py"))]

EQUATION = re.compile(r"^ *\$\$\n(?P<formula>[^$]+)\n *\$\$(?: \((?P<label>[\w-]+)\))?$", re.M)
CITED = re.compile(r"(?::eq:|\{eq\})`(?P<label>[^`\s]+)`")


def text_of(path: Path) -> str:
    """A page or a module."""
    return path.read_text(encoding="utf-8")


def prose_of(path: Path) -> str:
    """A page without its fenced blocks."""
    return re.sub(r"^ *```.*?^ *```$", "", text_of(path), flags=re.M | re.S)


def labels_of(path: Path) -> list[str | None]:
    """Of all equations of a page that stand by themselves; None where one has no label."""
    return [found["label"] for found in EQUATION.finditer(prose_of(path))]


def anchors_of(path: Path) -> set[str]:
    """Of a page's headings, as repository pages and the site make them."""
    headings = re.findall(r"^#+ (.+)$", prose_of(path), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def listed() -> set[str]:
    """What the reference's pages make from docstrings."""
    pages = (DOCS / "reference").glob("*.md")
    return {name for page in pages for name in re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text_of(page), re.M)}


# ---------------------------------------------------------------------------------------------------------------
# Equations
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("page", THEORY, ids=lambda page: page.name)
def test_every_equation_of_the_theory_has_a_label(page):
    labels = labels_of(page)
    assert labels
    assert None not in labels
    assert prose_of(page).count("$$") == 2 * len(labels), "a `$$` that does not stand on a line of its own"


def test_labels_are_unique():
    counts = Counter(label for page in PAGES for label in labels_of(page) if label)
    assert [label for label, count in counts.items() if count > 1] == []


def test_citations_lead_to_equations():
    labels = {label for page in PAGES for label in labels_of(page)}
    cited = {(found["label"], path.name) for path in (*PAGES, *CODE) for found in CITED.finditer(text_of(path))}
    wrong = sorted((label, name) for label, name in cited if label not in labels)
    assert wrong == []
    assert {label for label, name in cited if name.endswith(".py")} >= {"cost", "marginal-likelihood", "dual-bound"}


# ---------------------------------------------------------------------------------------------------------------
# Links and pages
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_their_anchors_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose_of(page)):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        assert place.exists(), target
        assert not anchor or anchor in anchors_of(place), target


def test_every_figure_is_shown():
    shown = {figure for page in PAGES for figure in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text_of(page))}
    assert {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.svg")} <= shown


# ---------------------------------------------------------------------------------------------------------------
# Reference
# ---------------------------------------------------------------------------------------------------------------
def test_reference_holds_all_that_bayesid_exports():
    assert {f"bayesid.{name}" for name in bayesid.__all__} <= listed()


def test_what_pages_name_exists_and_is_in_the_reference():
    named = {name for page in PAGES for name in re.findall(r"`(bayesid(?:\.\w+)+)", text_of(page))}
    missing = {name for name in named if not any(covers(one, name) for one in listed())}
    assert missing == set()
    for name in named:
        resolve_name(name)


def covers(one: str, name: str) -> bool:
    """Whether a module or name of the reference is, holds or belongs to a dotted name."""
    return f"{name}.".startswith(f"{one}.") or one.startswith(f"{name}.")


# ---------------------------------------------------------------------------------------------------------------
# The build
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site."""
    for needed in ("sphinx", "myst_nb", "furo"):
        pytest.importorskip(needed, reason="pip install 'bayesid[docs]'")
    place = tmp_path_factory.mktemp("built")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-d", place / "trees"]
    built = subprocess.run([*command, DOCS, place / "site"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return place / "site"


@pytest.mark.long
def test_notebooks_are_run_and_docstrings_cite_equations(site):
    notebook = text_of(site / "notebooks" / "identify.html")
    assert "Identification of arm from" in notebook  # run, and shown with its outputs
    assert notebook.count(".svg") >= 2
    page = text_of(site / "reference" / "posterior.html")
    assert 'href="../posterior.html#equation-marginal-likelihood">equation 3.1</a>' in page  # a docstring's citation


@pytest.mark.long
def test_no_page_asks_a_network_for_anything(site):
    """Links that people follow may lead outside, what a page loads by itself may not."""
    loads = re.compile(r"<(?!a\b)[a-z]+\b[^>]*?\b(?:src|href|srcset|data|poster)=[\"']?(?:https?:)?//[^>]*>")
    styles = re.compile(r"(?:@import|url\()\s*[\"']?(?:https?:)?//[^)]*")
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    found = {page.name: loads.findall(text_of(page)) + styles.findall(text_of(page)) for page in pages}
    found |= {sheet.name: styles.findall(text_of(sheet)) for sheet in site.rglob("*.css")}
    assert {name: what for name, what in found.items() if what} == {}


LOOKED_AT = ("index", "method", "certified-search", "posterior", "notebooks/identify", "reference/posterior")
OFFLINE = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
"""A request that leaves the disk fails, and the console says so."""
EQUATIONS = """
const seen = (svg) => svg.getBoundingClientRect().width > 1;
const drawn = [...document.querySelectorAll("mjx-container svg")].filter(seen);
return [document.querySelectorAll("span.math, div.math").length, drawn.length,
        document.querySelectorAll("[data-mjx-error], mjx-merror").length];
"""
TOUCHING = """
const touching = [];
for (const number of document.querySelectorAll("div.math > .eqno")) {
  const here = number.getBoundingClientRect();
  const there = number.parentElement.querySelector("mjx-container").getBoundingClientRect();
  if (here.left < there.right) touching.push(number.parentElement.id);
}
return touching;
"""


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_pages_opened_from_a_disk_show_their_equations(site):
    shown = {}
    with browser.chromium() as driver:
        driver.execute_cdp_cmd("Network.enable", {})
        driver.execute_cdp_cmd("Network.emulateNetworkConditions", OFFLINE)
        for width in browser.WIDTHS:
            for name in LOOKED_AT:
                browser.look(driver, site / f"{name}.html", width, "light")
                wait_for(lambda: drawn(driver), name)
                assert driver.execute_script(TOUCHING) == [], (name, width)
                wide = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
                assert driver.execute_script(wide) <= 0, (name, width)
                assert driver.get_log("browser") == [], name
                shown[name] = driver.execute_script(EQUATIONS)[1]
    assert shown["method"] > 150 > shown["posterior"] > 30


def drawn(driver):
    """Whether all equations of a page are there, none as an error."""
    there, shown, wrong = driver.execute_script(EQUATIONS)
    assert wrong == 0
    return shown >= there


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_search_finds_pages_from_a_disk(site):
    with browser.chromium() as driver:
        driver.get(f"{(site / 'search.html').as_uri()}?q=hysteresis")
        results = "return [...document.querySelectorAll('#search-results li a')].map((link) => link.pathname)"
        said = "the page among the results, which come one after the other"
        wait_for(lambda: any(path.endswith("/discrepancy.html") for path in driver.execute_script(results)), said)
        assert driver.get_log("browser") == []


def wait_for(holds, what, patience=60.0):
    """Until it holds, some seconds at most."""
    deadline = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < deadline, what
        time.sleep(0.1)
