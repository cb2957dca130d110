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
  if (element.closest("svg") && element.tagName !== "svg") continue;
  const box = element.getBoundingClientRect();
  if (!box.width || !box.height || inScroller(element)) continue;
  if (box.left < -1 || box.right > document.documentElement.clientWidth + 1)
    cut.push(`${element.tagName} ${element.getAttribute("class")} ${element.textContent.slice(0, 40)}`);
}
return [wide, cut];
"""
_SCALES = """
return [...document.querySelectorAll("figure canvas")].map((canvas) =>
  [canvas.getBoundingClientRect().width / canvas.width, canvas.getBoundingClientRect().height / canvas.height]).flat();
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
    """What the console says, and what is cut off."""
    said = [entry["message"] for entry in driver.get_log("browser") if entry["level"] != "INFO"]
    wide, cut = driver.execute_script(_CUT_OFF)
    return said + cut + ([f"the page is {wide} px wider than the window"] if wide > 0 else [])


def scales(driver):
    """Of all canvases, px on the screen over px drawn, in width and height: one half, so that letters have 12 px."""
    return driver.execute_script(_SCALES)


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
