"""Shared by the tests: small robots, motions and synthetic moments."""

from __future__ import annotations

import io
import os
import shutil
import signal
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # matrices are small: BLAS threads only get into each other's way

import command_line
import numpy as np
import pytest
import source_tree  # noqa: F401

from bayesid.cli import bars
from bayesid.motion import Motion
from bayesid.robot import Robot, robot_from_table
from bayesid.simulation import logs
from bayesid.simulation.trajectories import random_trajectory

DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).parents[2] / "shared" / "data"))


for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) == signal.SIG_IGN:  # of a shell's job in the background; tests interrupt commands
        signal.signal(number, usual)


def real_log(name: str) -> Path:
    """The path of a real log; the test is skipped, and says so, where the data are not at hand."""
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"real log {path} is not here; set BAYESID_DATA to the folder that holds it")
    return path


def small_robot(n: int, seed: int = 0) -> Robot:
    """An arm of n revolute joints with asymmetric geometry."""
    rng = np.random.default_rng(seed)
    ranges = {"a": (0.1, 0.5), "alpha": (-1.5, 1.5), "d": (0.1, 0.4), "theta": (-1.0, 1.0)}
    joints = [{key: rng.uniform(*between) for key, between in ranges.items()} for _ in range(n)]
    return robot_from_table({"name": f"arm{n}", "convention": "modified", "joints": joints}, "test")


def random_motion(n: int, samples: int, seed: int = 0) -> Motion:
    """Independent random positions, velocities and accelerations."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = rng.normal(size=(3, samples, n)) * np.array([1.0, 1.5, 4.0])[:, None, None]
    return Motion(np.arange(samples) / 100.0, q, dq, ddq)


def smooth_motion(n: int, duration: float, rate: float, seed: int = 0) -> Motion:
    """Sums of sines with exact derivatives, different in every joint."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(duration * rate)) / rate
    q = np.zeros((len(t), n))
    dq, ddq = q.copy(), q.copy()
    for j in range(n):
        for k in range(1, 4):
            a, phase, w = rng.uniform(0.2, 0.5) / k, rng.uniform(0, 6), 2 * np.pi * k * rng.uniform(0.12, 0.25)
            q[:, j] += a * np.sin(w * t + phase)
            dq[:, j] += a * w * np.cos(w * t + phase)
            ddq[:, j] -= a * w**2 * np.sin(w * t + phase)
    return Motion(t, q, dq, ddq)


@pytest.fixture(scope="session", autouse=True)
def no_lines_of_progress():
    """However busy the machine, so that tests can tell what else a command says on stderr."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bars, "TUNING", replace(bars.TUNING, between_lines=1e6))
        yield


@pytest.fixture(scope="module")
def any_motion():
    """Simulated logs are of random motions: for tests to which good ones do not matter, which take a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            logs,
            "exciting_trajectory",
            lambda model, _, duration, seed: random_trajectory(model.robot.n_joints, duration, rng=seed),
        )
        yield


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def arm_shop(tmp_path_factory):
    """A robot file, logs that `simulate` made of it, and what `identify` made of one, for all tests of commands."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(command_line.ARM)
    options = ("--duration", 6, "--noise", 0.03, "--seed", 2, "--effect", "viscous_friction:1:0.3")
    arm = ("--robot", place / "arm.toml")
    assert command_line.run("simulate", *arm, "--out", place / "log.csv", *options) == 0
    options = ("--seed", 7, "--no-report")
    with redirect_stdout(io.StringIO()) as printed:
        assert command_line.run("identify", place / "log.csv", *arm, "--out", place / "result", *options) == 0
    (place / "terminal.txt").write_text(printed.getvalue())
    return place


@pytest.fixture
def arm_place(arm_shop, tmp_path, monkeypatch):
    """A folder of one's own with robot and log in it; commands run there, so what they leave is seen."""
    for name in ("arm.toml", "log.csv"):
        (tmp_path / name).write_bytes((arm_shop / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def arm_result(arm_shop, arm_place):
    """The result folder, to be changed."""
    shutil.copytree(arm_shop / "result", arm_place / "result")
    return arm_place / "result"
