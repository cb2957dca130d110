"""A headless Chromium for pages that people look at, and what can be measured of a page in it."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from importlib.resources import files

import pytest

WIDTHS = (1400, 400)
SCHEMES = ("light", "dark")
_SERIOUS = ("serious", "critical")
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
)
_CUT_OFF = """
const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
const inScroller = (element) => {
  for (let up = element.parentElement; up; up = up.parentElement)
    if (["auto", "scroll"].includes(getComputedStyle(up).overflowX)) return true;
  return false;
};
const cut = [];
for (const element of document.querySelectorAll("main *")) {
  if (element.closest("svg") && element.tagName !== "svg" && element.tagName !== "text") continue;
  const box = element.getBoundingClientRect();
  if (!box.width || !box.height || inScroller(element)) continue;
  if (box.left < -1 || box.right > document.documentElement.clientWidth + 1)
    cut.push(`${element.tagName} ${element.getAttribute("class")} ${element.textContent.slice(0, 40)}`);
}
for (const svg of document.querySelectorAll("figure svg")) {
  const frame = svg.getBoundingClientRect();
  for (const text of svg.querySelectorAll("text")) {
    const box = text.getBoundingClientRect();
    if (box.width && (box.left < frame.left - 2 || box.right > frame.right + 2 || box.top < frame.top - 2
        || box.bottom > frame.bottom + 2)) cut.push(`text outside of its figure: ${text.textContent}`);
  }
}
return [wide, cut];
"""
_SMALLEST = """
const sizes = [...document.querySelectorAll("figure svg text")].map((text) => {
  const scale = text.getScreenCTM();
  return parseFloat(getComputedStyle(text).fontSize) * Math.hypot(scale.a, scale.b);
}).filter((size) => size > 0);
return sizes.length ? Math.min(...sizes) : null;
"""


@contextmanager
def chromium():
    """A driver, or a skip that says what is missing."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed (extra `browser`)")
    pytest.importorskip("axe_core_python", reason="axe-core-python is not installed (extra `browser`)")
    programs = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if not all(programs):
        pytest.skip("chromium or chromedriver is not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for flag in _FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(programs[1]))
    driver.set_script_timeout(120)
    try:
        yield driver
    finally:
        driver.quit()


def look(driver, path, width, scheme, scripts=True):
    """Opens a page as wide as this, light or dark."""
    driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": not scripts})
    media = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": media})
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    driver.get(path.resolve().as_uri())


def complaints(driver):
    """What the console says, and what is cut off or stands outside of its figure."""
    said = [entry["message"] for entry in driver.get_log("browser") if entry["level"] != "INFO"]
    wide, cut = driver.execute_script(_CUT_OFF)
    return said + cut + ([f"the page is {wide} px wider than the window"] if wide > 0 else [])


def smallest_letters(driver):
    """px, of all figures."""
    return driver.execute_script(_SMALLEST)


def faults(driver, rules=None):
    """Serious faults of accessibility, by axe-core; by all of its rules, or by some."""
    driver.execute_script(files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8"))
    options = {"resultTypes": ["violations"], **({} if rules is None else {"runOnly": rules})}
    found = driver.execute_async_script("axe.run(document, arguments[0]).then(arguments[1])", options)
    return [
        f"{one['id']}: {one['help']}: {one['nodes'][0]['html'][:200]}"
        for one in found["violations"]
        if one["impact"] in _SERIOUS
    ]
