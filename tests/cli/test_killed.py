"""SIGKILL at random moments of whole commands: a whole result stands every time.

Each trial is a fork of this process, which has everything imported: a command then takes a second, not five.
"""

import os
import signal
import time
from contextlib import suppress

import numpy as np
import pytest
from command_line import TWO_JOINTS

import bayesid
from bayesid.cli import main
from bayesid.report.report_data import read_report_data

pytestmark = [pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork"), pytest.mark.usefixtures("any_motion")]

IDENTIFY = "--robot arm.toml --terms rigid_body,viscous_friction --complete off --no-posterior --no-report --quiet"
PATIENCE = 120.0
"""s, after which a command that nobody kills hangs."""
TABLES = ("model.toml", "segments.csv", "coefficients.csv", "parameters.csv", "signed_log.csv")


@pytest.fixture(scope="module")
def shop(tmp_path_factory, any_motion):
    """A robot, logs, and results that nobody killed."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(TWO_JOINTS)
    before = os.getcwd()
    os.chdir(place)
    try:
        for seed, name in enumerate("ab"):
            assert main(f"simulate --robot arm.toml --duration 4 --seed {seed} --out {name}.csv --quiet".split()) == 0
        for name in "ab":
            assert main(f"identify {name}.csv {IDENTIFY} --out of-{name}".split()) == 0
    finally:
        os.chdir(before)
    return place


@pytest.fixture
def place(shop, monkeypatch):
    monkeypatch.chdir(shop)
    return shop


def started(arguments):
    """A fork of this process that runs a command, in silence."""
    child = os.fork()
    if child:
        return child
    code = 99
    with suppress(BaseException):
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        code = main(arguments.split())
    os._exit(code)


def ended(child, deadline):
    while time.monotonic() < deadline:
        if os.waitpid(child, os.WNOHANG)[0]:
            return True
        time.sleep(0.002)
    return False


def seconds(arguments):
    """What a command takes that nobody kills."""
    began = time.monotonic()
    assert ended(started(arguments), began + PATIENCE)
    return time.monotonic() - began


def kill_at_random(commands, moments, check):
    """Starts one command after the other, and kills each somewhere between its start and a little after its end."""
    rng = np.random.default_rng(moments)
    usual = seconds(commands[0])
    killed = 0
    for k in range(moments):
        child = started(commands[k % len(commands)])
        if not ended(child, time.monotonic() + rng.uniform(0.0, 1.05 * usual)):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            killed += 1
        check()
    seconds(commands[-1])
    check()
    assert killed >= moments // 3


def is_one_of(folder, wholes):
    """All tables of a folder are those of one and the same whole result, and it loads; aside if killed in between."""
    if not folder.exists():
        folder = max(folder.parent.glob(f".{folder.name}-*/old"), key=lambda path: path.stat().st_mtime)
    tables = [(folder / name).read_bytes() for name in TABLES]
    assert any(tables == [(whole / name).read_bytes() for name in TABLES] for whole in wholes)
    assert {path.name for path in folder.iterdir() if not path.name.startswith(".")} >= {"summary.json", "robot.urdf"}
    assert bayesid.load(folder).model.robot.name == "arm"
    read_report_data(folder)


@pytest.mark.parametrize("moments", [4, pytest.param(100, marks=pytest.mark.long)])
def test_identify(place, moments):
    commands = [f"identify {name}.csv {IDENTIFY} --out result" for name in "ab"]
    seconds(commands[1])
    kill_at_random(commands, moments, lambda: is_one_of(place / "result", [place / "of-a", place / "of-b"]))
