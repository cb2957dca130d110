"""Reports as people see them: wide and narrow, light and dark, zoomed, printed, and without scripts."""

import re
from dataclasses import replace

import browser
import pytest
from conftest import small_robot
from made_discrepancy import make

from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.report.pages.discrepancy_page import discrepancy_page
from bayesid.report.pages.identification_page import identification_page
from bayesid.report.report_data import report_data
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate_log

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
A4 = 794
"""px"""

STATE = """
const figure = document.querySelector(arguments[0]);
return {
  told: figure.closest(".linked").querySelector("output").textContent,
  drawn: figure.querySelector("canvas").toDataURL(),
  area: figure.querySelector(".u-over").getBoundingClientRect().toJSON(),
  ends: JSON.parse(figure.querySelector(".plot").dataset.figure).panels[0][0].x.ends,
};
"""
POINT = """
const over = document.querySelector(arguments[0] + " .u-over");
const box = over.getBoundingClientRect();
const place = (share) => ({ clientX: box.x + share * box.width, clientY: box.y + 0.5 * box.height, bubbles: true });
const [first, last] = arguments[1];
over.dispatchEvent(new MouseEvent("mouseenter", place(first)));
over.dispatchEvent(new MouseEvent("mousemove", place(first)));
if (first !== last) {
  over.dispatchEvent(new MouseEvent("mousedown", { ...place(first), button: 0 }));
  over.dispatchEvent(new MouseEvent("mousemove", { ...place(last), movementX: 1, buttons: 1 }));
  over.dispatchEvent(new MouseEvent("mouseup", place(last)));
}
const done = arguments[2];
requestAnimationFrame(() => setTimeout(() =>
  done([...document.querySelectorAll(".readout")].map((one) => one.textContent).filter((text) => text)), 50));
"""
"""Moves the pointer to a share of a figure's width, or drags it to another; what all figures say of it."""


@pytest.fixture(scope="module")
def driver():
    with browser.chromium() as driver:
        yield driver


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Of a real identification, with a validation, all signs hidden."""
    robot = small_robot(2)
    log, again = (simulate_log(robot, 5.0, 100.0, 0.1, [], seed)[0] for seed in (2, 3))
    result = identify(robot, log, ["rigid_body", "viscous_friction"], search=Certified(), posterior=Sampling(rng=1))
    files = {"/home/someone/recordings/with_a_name_that_is_long/of_a_monday_in_march.csv": "ab12" * 16}
    result = replace(result, provenance=replace(result.provenance, files=files))
    path = tmp_path_factory.mktemp("browser") / "report.html"
    path.write_text(identification_page(report_data(result).with_validation(result.validate(again))), encoding="utf-8")
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


def button(driver, group, name):
    click(driver, f'.controls[data-group="{group}"] button[aria-label="{name}"]')


@pytest.mark.parametrize("scheme", browser.SCHEMES)
@pytest.mark.parametrize("width", browser.WIDTHS)
@pytest.mark.parametrize("page", ["report", "discrepancy"])
def test_a_page_is_whole_legible_and_open_to_all(request, driver, page, width, scheme):
    browser.look(driver, request.getfixturevalue(page), width, scheme)
    assert browser.complaints(driver) == []
    assert too_long(driver) == []
    assert set(browser.scales(driver)) == {0.5}
    assert browser.faults(driver, ["color-contrast"] if scheme == "dark" else None) == []  # what else is the same
    assert visible(driver, "main figure canvas") >= (7 if page == "report" else 4)


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
def test_buttons_zoom_all_joints_and_bring_all_back(driver, report, width):
    browser.look(driver, report, width, "light")
    first, other = state(driver), state(driver, "#torque2")
    left, right = first["ends"]
    assert first["told"] == ""
    button(driver, "torque", "Zoom in")
    zoomed = state(driver)
    quarter = (right - left) / 4.0
    assert span(zoomed) == pytest.approx([left + quarter, right - quarter], abs=0.006)
    assert zoomed["drawn"] != first["drawn"]
    assert zoomed["area"] == first["area"]
    assert state(driver, "#torque2")["drawn"] != other["drawn"]
    assert state(driver, "#validation1")["told"] == ""
    assert browser.complaints(driver) == []
    button(driver, "torque", "Later")
    assert span(state(driver)) == pytest.approx([left + 2 * quarter, right], abs=0.006)
    button(driver, "torque", "Later")
    assert span(state(driver)) == pytest.approx([left + 2 * quarter, right], abs=0.006)  # there is no more
    button(driver, "torque", "Show all")
    assert (state(driver), state(driver, "#torque2")) == (first, other)


def test_values_stand_beside_the_pointer_and_dragging_zooms(driver, report):
    """In all joints at once; of the curves and of the segment's sign."""
    browser.look(driver, report, 1400, "light")
    first = state(driver)
    left, right = first["ends"]
    told = driver.execute_async_script(POINT, "#torque1", [0.5, 0.5])
    assert len(told) == 2
    for one in told:
        values = dict(re.findall(r"^([a-z, ]+) ([\u2212\d.]+)", one, re.MULTILINE))
        assert float(values["time"]) == pytest.approx((left + right) / 2.0, abs=0.02)
        assert {"model", "with signs", "recorded, without sign"} <= set(values)
        assert re.search(r"sign [+\u2212]\??  ?[\d.]+", one)
    driver.execute_async_script(POINT, "#torque1", [0.25, 0.75])
    quarter = (right - left) / 4.0
    assert span(state(driver)) == pytest.approx([left + quarter, right - quarter], abs=0.05)


def span(seen):
    """The range told beside the buttons."""
    return [float(one) for one in re.fullmatch(r"([-\d.]+) to ([-\d.]+) s", seen["told"]).groups()]


def test_a_segments_link_leads_to_it(driver, report):
    """Twice its length on either side, at least 0.2 s."""
    browser.look(driver, report, 1400, "light")
    first = "const a = document.querySelector('a[data-from]'); return [a.hash, +a.dataset.from, +a.dataset.to]"
    figure, start, end = driver.execute_script(first)
    click(driver, "a[data-from]")
    seen, margin = state(driver, figure), max(2.0 * (end - start), 0.2)
    left, right = seen["ends"]
    length = end - start + 2.0 * margin
    low = min(max(start - margin, left), right - length)
    assert span(seen) == pytest.approx([low, low + length], abs=0.011)
    top = driver.execute_script("return document.querySelector(arguments[0]).getBoundingClientRect().top", figure)
    assert -1.0 <= top < 900.0


@pytest.mark.parametrize("page", ["report", "discrepancy"])
def test_nothing_is_cut_off_on_paper(request, driver, page):
    """Which is white, whatever the screen is."""
    browser.look(driver, request.getfixturevalue(page), A4, "dark")
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": dark})
    driver.execute_async_script("requestAnimationFrame(() => setTimeout(arguments[0], 50))")  # figures are drawn anew
    try:
        assert browser.complaints(driver) == []
        assert visible(driver, ".controls") == 0
        assert browser.faults(driver, ["color-contrast"]) == []
        paper = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert paper == "rgb(255, 255, 255)"
        assert set(browser.scales(driver)) == {0.5}
        assert too_long(driver) == []
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
