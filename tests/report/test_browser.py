"""Reports as people see them: wide and narrow, light and dark, zoomed, printed, and without scripts."""

import re
from dataclasses import replace

import browser
import pytest
from conftest import small_robot
from made_discrepancy import make

from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.report.findings import find_findings
from bayesid.report.pages.discrepancy_page import discrepancy_page
from bayesid.report.pages.identification_page import identification_page
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate_log

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
LEGIBLE = 8.0
"""px of a figure's smallest letters."""
A4 = 794
"""px"""

STATE = """
const figure = document.querySelector(arguments[0]);
const shown = [...figure.querySelectorAll("svg")].find((svg) => svg.getBoundingClientRect().width > 0);
return {
  told: figure.querySelector("output").textContent,
  marks: [...shown.querySelectorAll(".marks text")].map((one) => one.textContent),
  still: [...shown.querySelectorAll('[id*="-glyph-"]')].filter((one) => one.getBoundingClientRect().width).length,
  curve: shown.querySelector('[id*="-x-model"] path, [id*="-x-predicted"] path').getBoundingClientRect().toJSON(),
  area: shown.querySelector('[id$="-area"] path').getBoundingClientRect().toJSON(),
  ends: [figure.dataset.left, figure.dataset.right].map(Number),
};
"""


@pytest.fixture(scope="module")
def driver():
    with browser.chromium() as driver:
        yield driver


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Of a real identification, with a validation, all signs hidden."""
    robot = small_robot(2)
    log, again = (simulate_log(robot, 5.0, 100.0, 0.1, [], seed)[0] for seed in (2, 3))
    result = identify(robot, log, ["rigid_body", "viscous_friction"], search=Certified(), posterior=Sampling(seed=1))
    files = {"/home/someone/recordings/with_a_name_that_is_long/of_a_monday_in_march.csv": "ab12" * 16}
    result = replace(result, provenance=replace(result.provenance, files=files))
    path = tmp_path_factory.mktemp("browser") / "report.html"
    path.write_text(
        identification_page(find_findings(result).with_validation(result.validate(again))), encoding="utf-8"
    )
    return path


@pytest.fixture(scope="module")
def discrepancy(tmp_path_factory):
    path = tmp_path_factory.mktemp("browser") / "discrepancy.html"
    path.write_text(discrepancy_page(make()), encoding="utf-8")
    return path


def state(driver, figure="#torque1"):
    return driver.execute_script(STATE, figure)


def click(driver, selector):
    driver.execute_script("document.querySelector(arguments[0]).click()", selector)


def button(driver, figure, name):
    click(driver, f'{figure} button[aria-label^="{name}"]')


@pytest.mark.parametrize("scheme", browser.SCHEMES)
@pytest.mark.parametrize("width", browser.WIDTHS)
@pytest.mark.parametrize("page", ["report", "discrepancy"])
def test_a_page_is_whole_legible_and_open_to_all(request, driver, page, width, scheme):
    browser.look(driver, request.getfixturevalue(page), width, scheme)
    assert browser.complaints(driver) == []
    assert too_long(driver) == []
    assert browser.smallest_letters(driver) >= LEGIBLE
    assert browser.faults(driver, ["color-contrast"] if scheme == "dark" else None) == []  # what else is the same
    assert visible(driver, "main figure svg") >= (7 if page == "report" else 4)


def too_long(driver):
    """What reaches over its own edge: a word beyond its cell, a table beyond its box."""
    told = """
      return [...document.querySelectorAll("main *:not(svg *)")].filter((one) => one.clientWidth
        && one.scrollWidth > one.clientWidth + 1 && ["block", "table-cell"].includes(getComputedStyle(one).display)
        && getComputedStyle(one).overflowX !== "auto").map((one) => one.outerHTML.slice(0, 80))
    """
    return driver.execute_script(told)


def visible(driver, selector):
    boxes = "[...document.querySelectorAll(arguments[0])].map((one) => one.getBoundingClientRect())"
    return driver.execute_script(f"return {boxes}.filter((box) => box.width).length", selector)


@pytest.mark.parametrize("width", browser.WIDTHS)
def test_buttons_zoom_and_bring_all_back(driver, report, width):
    browser.look(driver, report, width, "light")
    first, untouched = state(driver), inside(driver)
    left, right = first["ends"]
    assert first["told"] == ""
    assert first["marks"] == []
    assert first["still"] > 0
    button(driver, "#torque1", "Zoom in")
    zoomed = state(driver)
    quarter = (right - left) / 4.0
    assert span(zoomed) == pytest.approx([left + quarter, right - quarter], abs=0.006)
    assert "time, s" in zoomed["marks"]
    assert zoomed["still"] == 0
    assert zoomed["curve"]["width"] == pytest.approx(2.0 * first["curve"]["width"], rel=0.03)
    start = first["area"]["x"] - 0.5 * first["area"]["width"]
    assert zoomed["curve"]["x"] == pytest.approx(start, abs=0.01 * first["area"]["width"])
    assert zoomed["area"] == first["area"]
    times = [float(one) for one in zoomed["marks"] if re.fullmatch(r"\d+\.?\d*", one)]
    assert len(times) >= 3
    assert all(left + quarter - 1e-6 <= one <= right - quarter + 1e-6 for one in times)
    assert browser.complaints(driver) == []
    assert browser.smallest_letters(driver) >= LEGIBLE
    button(driver, "#torque1", "Later")
    assert span(state(driver)) == pytest.approx([left + 2 * quarter, right], abs=0.006)
    button(driver, "#torque1", "Later")
    assert span(state(driver)) == pytest.approx([left + 2 * quarter, right], abs=0.006)  # there is no more
    button(driver, "#torque1", "Show all")
    assert state(driver) == first
    assert inside(driver) == untouched
    assert state(driver, "#torque2")["told"] == ""


def inside(driver):
    """Of a figure: where all that is seen stands."""
    told = """
      return [...document.querySelectorAll("#torque1 svg *")].map((one) => one.getBoundingClientRect())
        .filter((box) => box.width).map((box) => `${box.x} ${box.y} ${box.width} ${box.height}`).join("\\n")
    """
    return driver.execute_script(told)


def span(seen):
    """The range told beside the buttons."""
    return [float(one) for one in re.fullmatch(r"([-\d.]+) to ([-\d.]+) s", seen["told"]).groups()]


def test_a_segments_link_leads_to_it(driver, report):
    """Twice its length on either side, at least 0.2 s; its sign and confidence stand above it."""
    browser.look(driver, report, 1400, "light")
    first = "const a = document.querySelector('a[data-from]'); return [a.hash, +a.dataset.from, +a.dataset.to]"
    figure, start, end = driver.execute_script(first)
    click(driver, "a[data-from]")
    seen, margin = state(driver, figure), max(2.0 * (end - start), 0.2)
    left, right = seen["ends"]
    length = end - start + 2.0 * margin
    low = min(max(start - margin, left), right - length)
    assert span(seen) == pytest.approx([low, low + length], abs=0.011)
    assert any("?" in one for one in seen["marks"])
    top = driver.execute_script("return document.querySelector(arguments[0]).getBoundingClientRect().top", figure)
    assert -1.0 <= top < 900.0


@pytest.mark.parametrize("page", ["report", "discrepancy"])
def test_nothing_is_cut_off_on_paper(request, driver, page):
    """Which is white, whatever the screen is."""
    browser.look(driver, request.getfixturevalue(page), A4, "dark")
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": dark})
    try:
        assert browser.complaints(driver) == []
        assert visible(driver, ".controls") == 0
        assert visible(driver, ".slim") == 0
        assert browser.faults(driver, ["color-contrast"]) == []
        paper = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert paper == "rgb(255, 255, 255)"
        assert browser.smallest_letters(driver) >= LEGIBLE
        assert too_long(driver) == []
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
