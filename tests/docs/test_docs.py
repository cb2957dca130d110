"""Every example of README.md and docs/ runs, and prints what the page says.

Each page has a temporary directory and one namespace. Its blocks run in the order of the page:

    ```python     as it stands; a ```text block right after it is what it prints, numbers to about the digits shown
    ```console    lines that begin with `bayesid`, through the command line's own entry; ```sh alike
    <!-- file: NAME -->   before a block: it is written to NAME
    <!-- not run -->      before a block: it is left alone

A how-to page makes its own logs. For other pages the directory holds the logs that a user would have, simulated.
"""

from __future__ import annotations

import io
import re
import runpy
import shlex
import sys
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

import bayesid
from bayesid.cli import demo, main
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.report.summarise import summarise
from bayesid.report.summary import as_json
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
from make_images import GALLERY  # noqa: E402

FOLDERS = (ROOT / "docs", ROOT / "docs" / "how-to")
PAGES = [ROOT / "README.md", *(page for folder in FOLDERS for page in sorted(folder.glob("*.md")))]
SHOWN = ROOT / "docs" / "logs-and-robots.md"
"""Its files, such as robot.toml, are for the examples of every page but the how-to pages."""
ROBOTS = {"use.md": "ur10e"}
"""Whose logs a page's commands read; robot.toml of docs/logs-and-robots.md if not here."""
PAYLOAD = np.array([0.017, -0.004, -0.01, 0.022, -0.002, 0.025, 0.2, 0.04, 0.1, 2.0])
"""Of a body of 2 kg, as in `bayesid.robot.inertia`: on the flange in the log of a page about gains."""
SAMPLED = (
    "posterior.md",
    "python.md",
    "extending.md",
    "find-what-is-missing.md",
    "what-to-record-next.md",
    "what-you-know-of-the-robot.md",
)
"""Pages whose examples need draws that have converged; elsewhere as few as there can be do."""
QUICK = ("excitation.md",)
"""Pages that take two seconds and whose command no other test runs; all others are long."""
GAINS = np.array([14.9, 13.3, 11.1])
"""N m/A, as on docs/logs-and-robots.md."""
HURRY = {
    "identify": ["--no-posterior", "--no-report"],
    "discrepancy": ["--no-posterior"],
    "study": ["--trials", "2"],
    "excite": ["--harmonics", "2"],
    "excite --for": ["--changes", "50"],
}
"""Options by which commands take less time; by its first option too where a command takes others after it."""
FEW = bayesid.Sampling(budget=0.0)
"""As few draws as there can be."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?!\w)")


@dataclass(frozen=True)
class Block:
    """A fenced block: what stands in the comment before it, its language, its text, and the line it begins on."""

    remark: str
    language: str
    text: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    """All fenced blocks of a page."""
    fenced = r"(?:^<!-- *(?P<remark>[^\n]*?) *-->\n)?^```(?P<language>\w+)\n(?P<text>.*?)^```$"
    pattern = re.compile(fenced, re.M | re.S)
    text = page.read_text(encoding="utf-8")
    return [
        Block(found["remark"] or "", found["language"], found["text"], text[: found.start("text")].count("\n"))
        for found in pattern.finditer(text)
    ]


def write_files(folder: Path, *pages: Path) -> None:
    """The files that pages show."""
    for block in (block for page in pages for block in blocks_of(page)):
        if block.remark.startswith("file:"):
            (folder / block.remark.removeprefix("file:").strip()).write_text(block.text)


def simulated(robot: str | Path, duration: float, rate: float, seed: int, load: np.ndarray | float = 0.0) -> Log:
    """A signed log of a robot; the same robot, whatever the seed. The load (10,) is added to its last link."""
    arm = bayesid.load_robot(robot)
    motion = random_trajectory(arm.n_joints, duration, rng=seed).motion(np.arange(int(duration * rate) + 1) / rate)
    model = Model(arm, make_terms(["rigid_body", "viscous_friction", "coulomb_friction"], arm, motion))
    theta = random_parameters(model, rng=np.random.default_rng(0))
    theta[model.cone.bodies[-1]] += load
    return simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=0.03, signed=True)


def write_logs(folder: Path, page: str) -> None:
    """What the user of a page has recorded."""
    robot = ROBOTS.get(page, "robot.toml")
    log, other = (simulated(robot, 6.0, 50.0, seed) for seed in (1, 2))
    log.rectified().save(folder / "log.csv")
    other.rectified().save(folder / "another_log.csv")
    log.save(folder / "signed.csv")
    replace(log.rectified(), t=log.t + 1.0, effort=1.01 * np.abs(log.effort)).save(folder / "repeated_log.csv")
    (folder / "week").mkdir()
    for day, recorded in (("monday", log), ("tuesday", other)):
        recorded.rectified().save(folder / "week" / f"{day}.csv")
    if page not in ROBOTS:
        write_currents(folder / "currents.csv", log)
        write_currents(folder / "loaded.csv", simulated(robot, 6.0, 50.0, seed=3, load=PAYLOAD))


def write_currents(path: Path, log: Log) -> None:
    """A log of |current|."""
    replace(log.rectified(), effort=np.abs(log.effort) / GAINS).save(path)
    path.write_text(path.read_text().replace("tau", "i", len(GAINS)))


def assert_alike(printed: str, promised: str) -> None:
    """The same words; numbers within two of the last digit shown, or 10 %; whole numbers exactly."""
    here, there = " ".join(printed.split()), " ".join(promised.split())
    assert NUMBER.sub("#", here) == NUMBER.sub("#", there), f"prints\n{printed}\ninstead of\n{promised}"
    for ours, theirs in zip(NUMBER.findall(here), NUMBER.findall(there), strict=True):
        mantissa, _, exponent = theirs.partition("e")
        last = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
        exact = "." not in theirs and not exponent
        tolerance = 0.0 if exact else max(2.01 * last, 0.1 * abs(float(theirs)))
        assert abs(float(ours) - float(theirs)) <= tolerance, f"prints\n{printed}\ninstead of\n{promised}"


def run_commands(block: Block, hurry: dict[str, list[str]]) -> None:
    """The `bayesid` lines of a block, with options by command."""
    for line in block.text.replace("\\\n", " ").splitlines():
        if line.startswith("bayesid "):
            arguments = shlex.split(line, comments=True)[1:]
            faster = hurry.get(" ".join(arguments[:2]), hurry.get(arguments[0], []))
            assert main([*arguments, *faster]) == 0, line


def identify_few(identify, *arguments, posterior, **options):
    """An identification with few draws, where it samples at all."""
    return identify(*arguments, posterior=posterior and FEW, **options)


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=() if page.name in QUICK else pytest.mark.long) for page in PAGES],
    ids=lambda page: page.name,
)
def test_examples_run_and_print_what_the_page_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if page.name not in SAMPLED:
        monkeypatch.setattr(bayesid, "identify", partial(bayesid.identify, posterior=FEW))
        monkeypatch.setattr(demo, "identify", partial(identify_few, demo.identify))
    blocks = [block for block in blocks_of(page) if block.remark != "not run"]
    own_logs = page.parent.name == "how-to"
    write_files(tmp_path, *([] if own_logs else [SHOWN]), page)
    if not own_logs and any(block.language in ("console", "sh") for block in blocks):
        write_logs(tmp_path, page.name)
    namespace: dict[str, object] = {"__name__": "__main__"}
    for block, following in zip_longest(blocks, blocks[1:]):
        printed = io.StringIO()
        with redirect_stdout(printed):
            if block.language == "python":
                code = "\n" * block.line + block.text
                exec(compile(code, str(page), "exec", dont_inherit=True), namespace)
            elif block.language in ("console", "sh"):
                run_commands(block, {} if page.name in SAMPLED else HURRY)
        if block.language == "python" and following is not None and following.language == "text":
            assert_alike(printed.getvalue(), following.text)


@pytest.mark.long
@pytest.mark.parametrize("name", ["own_search", "own_study"])
def test_scripts_that_pages_name_run(name, capsys):
    runpy.run_path(str(ROOT / "docs" / "examples" / f"{name}.py"), run_name="__main__")
    assert re.search(r"in turn: certified False, (100|[6-9]\d)\.|worst joint leaves [1-9]%", capsys.readouterr().out)


@pytest.mark.long
@pytest.mark.parametrize("name", GALLERY)
def test_scripts_of_the_gallery_are_short_and_draw_their_pictures(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    script = ROOT / "docs" / "examples" / f"{name}.py"
    with mpl.rc_context({"backend": "agg"}):
        runpy.run_path(str(script))
    assert len(script.read_text().splitlines()) <= 25
    assert (tmp_path / f"{name}.png").stat().st_size > 1000
    assert (ROOT / "docs" / "gallery" / f"{name}.png").stat().st_size < 60_000
    assert f"({name}.png)" in (ROOT / "docs" / "gallery" / "index.md").read_text()


def test_result_folder_names_every_file_column_and_key(tmp_path):
    """docs/result-folder.md is complete."""
    text = (ROOT / "docs" / "result-folder.md").read_text(encoding="utf-8")
    spans = re.findall(r"`([^`]+)`", text)
    named = {*spans, *(word for span in spans for word in re.split(r"[., ]+", span))}
    write_files(tmp_path, SHOWN)
    log = simulated(tmp_path / "robot.toml", 6.0, 50.0, seed=1)
    result = bayesid.identify(tmp_path / "robot.toml", log, ["rigid_body", "viscous_friction"], posterior=FEW)
    bayesid.save(result, tmp_path / "result")
    bayesid.save(result.validate(log), tmp_path / "validation")
    for path in [*(tmp_path / "result").iterdir(), *(tmp_path / "validation").iterdir()]:
        assert f"`{path.name}`" in text, path.name
        if path.suffix == ".csv":
            header = path.read_text().splitlines()[0].split(",")
            unnumbered = {re.sub(r"^(tau|p|q|dq|predicted|lower|upper)\d+$", r"\g<1>1", name) for name in header}
            missing = {name for name in unnumbered if f"`{name}`" not in text} - named
            assert not missing, f"{path.name}: {missing}"
    summary = as_json(summarise(result))
    parts = ("search", "signs", "posterior", "noise", "fit", "timings")
    keys = {*summary, *(key for part in parts for key in summary[part])}
    missing = keys - named - {"assumed", "standard_deviations"}
    assert not missing, f"summary.json: {missing}"
