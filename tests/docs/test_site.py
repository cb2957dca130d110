"""The documentation's site: it is built, and opens from a disk."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import browser
import pytest

pytestmark = [pytest.mark.long, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


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


def test_notebooks_are_run_and_docstrings_cite_equations(site):
    notebook = text_of(site / "notebooks" / "identify.html")
    assert "Identification of arm from" in notebook  # run, and shown with its outputs
    assert notebook.count(".svg") >= 2
    page = text_of(site / "reference" / "posterior.html")
    assert 'href="../posterior.html#equation-marginal-likelihood">equation 3.1</a>' in page  # a docstring's citation


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


def test_pages_opened_from_a_disk_show_their_equations(site):
    shown = {}
    with browser.chromium() as driver:
        driver.execute_cdp_cmd("Network.enable", {})
        driver.execute_cdp_cmd("Network.emulateNetworkConditions", OFFLINE)
        for width in browser.WIDTHS:
            for name in LOOKED_AT:
                browser.look(driver, site / f"{name}.html", width, "light")
                wait_for(lambda: drawn(driver), name)
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


def wait_for(holds, what, patience=60.0):
    """Until it holds, some seconds at most."""
    deadline = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < deadline, what
        time.sleep(0.1)
