"""Shared by the tests: small robots, motions and synthetic moments."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # matrices are small: BLAS threads only get into each other's way

import numpy as np
import pytest
import source_tree  # noqa: F401

from bayesid.model.robot import Robot, robot_from_table
from bayesid.motion import Motion
from bayesid.simulation import logs
from bayesid.simulation.trajectories import random_trajectory

DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).parents[2] / "shared" / "data"))


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


@pytest.fixture(scope="module")
def any_motion():
    """Simulated logs are of random motions: for tests to which good ones do not matter, which take a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            logs,
            "exciting_trajectory",
            lambda model, _, duration, seed: random_trajectory(model.robot.n_joints, duration, seed=seed),
        )
        yield


@pytest.fixture
def rng():
    return np.random.default_rng(0)
