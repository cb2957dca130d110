"""What the parts of the search's benchmark share: sign problems to search, the clock, and targets."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock

import numpy as np

from bayesid import signs
from bayesid.coefficients import BaseCoefficients
from bayesid.demo import Experiment, run_experiment
from bayesid.excitation import FourierTrajectory, random_trajectory
from bayesid.identification import Identification, identify
from bayesid.log import Log, read_log
from bayesid.model import Model
from bayesid.moments import Moments
from bayesid.motion import Array, Integers, Motion
from bayesid.robot import load_robot, robot_from_table
from bayesid.search.certified import certified
from bayesid.search.result import SearchResult
from bayesid.simulation import random_parameters, simulate
from bayesid.solver import ConeLeastSquares
from bayesid.terms import DEFAULT, RigidBody, make_terms

NOISE = 0.05
BUDGET = 60.0
"""Seconds that a certificate may take here; more than by default, so that the time of a late one is seen."""
SAME = 1e-6
"""Share of the energy below which costs of different solvers are not told apart."""
_REPEATED, _REPEATS = 2.0, 3
"""What takes fewer seconds is timed that often."""
_LOWEST, _HIGHEST = 0.1, 0.5
"""Hz; the band of a simulated motion, that of a robot's usual exciting trajectories."""
_SPEED, _RANGE, _GRID = 3.0, 2.0, 0.02

Value = TypeVar("Value")


# ---------------------------------------------------------------------------------------------------------------
# Clock and targets
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Check:
    """A figure beside its target.

    Attributes:
        what: the figure's name.
        value: the figure as printed.
        target: what it should be.
        met: whether it is.
    """

    what: str
    value: str
    target: str
    met: bool

    def __str__(self) -> str:
        return f"{self.what:<70} {self.value:>22}   target {self.target:<22} {'met' if self.met else 'MISSED'}"


class Table:
    """Prints its header at once, then each row as it comes.

    Args:
        first: header of the first column, which is wide.
        others: headers of the others; the columns are as wide as these.
    """

    def __init__(self, first: str, *others: str) -> None:
        self._widths = [max(len(header), 9) for header in others]
        self.row(first, *others)

    def row(self, first: str, *values: object) -> None:
        """Prints one row, floats with four digits."""
        texts = [f"{value:.4g}" if isinstance(value, float) else str(value) for value in values]
        cells = "  ".join(f"{text:>{width}}" for text, width in zip(texts, self._widths, strict=True))
        print(f"{first:<26}  {cells}", flush=True)


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What the work returns, and its seconds: the median of three where they are few."""
    spent: list[float] = []
    while len(spent) < _REPEATS:
        began = time.perf_counter()
        value = work()
        spent.append(time.perf_counter() - began)
        if spent[0] >= _REPEATED:
            break
    return value, float(np.median(spent))


# ---------------------------------------------------------------------------------------------------------------
# Problems
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SignProblem:
    """A sign problem: the moments of one log, rows in units of the noise.

    Attributes:
        name: of the log.
        model: robot and terms.
        coefficients: the model's base coefficients.
        moments: scaled moments of S segments.
        begins: (S,) each segment's first sample.
    """

    name: str
    model: Model
    coefficients: BaseCoefficients
    moments: Moments
    begins: Integers

    @property
    def energy(self) -> float:
        """The energy c of all segments' efforts."""
        return float(self.moments.energy.sum())

    @cached_property
    def unknown(self) -> int:
        """Segments whose sign is searched."""
        return int(np.sum(self.moments.known == 0))

    def solver(self) -> ConeLeastSquares:
        """A new solver, as the pipeline makes one for every search."""
        hessian = self.moments.hessian.sum(axis=0)
        return ConeLeastSquares(self.model.cone, self.coefficients, hessian, self.energy)

    def best(self) -> SearchResult:
        """The best assignment without a proof, from scratch."""
        return certified(self.moments, self.solver(), budget=0.0)

    def proof(self) -> SearchResult:
        """The best assignment with its proof, from scratch."""
        return certified(self.moments, self.solver(), budget=BUDGET)

    def first(self, count: int) -> SignProblem:
        """The problem of the segments that begin first."""
        chosen = np.sort(np.argsort(self.begins, kind="stable")[:count])
        return replace(
            self,
            name=f"{self.name}, first {count}",
            moments=chosen_segments(self.moments, chosen),
            begins=self.begins[chosen],
        )


def chosen_segments(moments: Moments, chosen: Integers) -> Moments:
    """Moments of some segments, each with a Hessian of its own."""
    if not np.all(moments.alone[chosen]):
        raise ValueError("segments that share a Hessian cannot be told apart")
    names = ("joint", "known", "gradient", "energy", "count")
    return Moments(
        **{name: getattr(moments, name)[chosen] for name in names}, hessian=moments.hessian[moments.part[chosen]]
    )


@dataclass(frozen=True)
class Searched:
    """An identification and the sign problem that its last certified search has solved.

    Attributes:
        problem: that problem.
        result: the identification.
        start: (P,) what that search started from, None if from nothing.
    """

    problem: SignProblem
    result: Identification
    start: Array | None

    def repeated(self) -> SearchResult:
        """The pipeline's own search once more."""
        return certified(self.problem.moments, self.problem.solver(), start=self.start)


def watched(name: str, run: Callable[[], tuple[Value, Identification]]) -> tuple[Value, Searched]:
    """Runs the pipeline and takes down the last problem that it gives to the certified search.

    The noise that scales the rows is that of the search before the last, which a result does not hold; so the moments
    are taken where the pipeline hands them over.
    """
    seen: list[tuple[Moments, Array | None]] = []

    def noted(
        moments: Moments, solver: ConeLeastSquares, budget: float, missed: float, start: Array | None, *rest: Any
    ) -> SearchResult:
        seen.append((moments, start))
        return certified(moments, solver, budget, missed, start, *rest)

    with mock.patch.object(signs, "certified", noted):
        value, result = run()
    moments, start = seen[-1]
    problem = SignProblem(name, result.model, result.coefficients, moments, result.searched.start)
    return value, Searched(problem, result, start)


def real_problem(data: Path, name: str) -> Searched:
    """The problem of a real log, rectified."""
    path = data / f"{name}.csv"
    robot, log = load_robot(path.parent / "robot.toml"), read_log(path)

    def run() -> tuple[None, Identification]:
        return None, identify(robot, log.rectified())

    return watched(name, run)[1]


def kr5_problem(seed: int = 0) -> tuple[Experiment, Searched]:
    """The paper's experiment, simulated, and its problem."""

    def run() -> tuple[Experiment, Identification]:
        experiment = run_experiment(seed)
        return experiment, experiment.result

    return watched(f"kr5, seed {seed}", run)


def simulated_problem(log: Log) -> Searched:
    """The problem of a simulated log of the UR10e."""

    def run() -> tuple[None, Identification]:
        return None, identify("ur10e", log)

    return watched("ur10e simulated", run)[1]


def arm_problem() -> SignProblem:
    """The problem of an arm of two joints, simulated: that of docs/pbpr.md."""
    joints = [
        {"a": 0.0, "alpha": np.pi / 2, "d": 0.4, "theta": 0.0},
        {"a": 0.35, "alpha": 0.0, "d": 0.0, "theta": 0.0},
    ]
    robot = robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "arm")
    model, rng = Model(robot, (RigidBody(),)), np.random.default_rng(1)
    motion = random_trajectory(2, 4.0, seed=4, harmonics=3).motion(np.arange(201) / 50.0)
    log = simulate(model, random_parameters(model, rng), motion, rng=rng, noise=NOISE)
    return watched("arm", lambda: (None, identify(robot, log, terms=["rigid_body"])))[1].problem


# ---------------------------------------------------------------------------------------------------------------
# Simulated motion
# ---------------------------------------------------------------------------------------------------------------
def long_motion(n_joints: int, duration: float, rate: float, seed: int = 0) -> Motion:
    """A random motion that never repeats itself, as fast all the time as a usual exciting trajectory.

    Each joint's spectrum of speeds is flat between 0.1 and 0.5 Hz.
    """
    rng = np.random.default_rng(seed)
    frequency = np.arange(1, round(_HIGHEST * duration) + 1) / duration
    waves = rng.standard_normal((2, n_joints, len(frequency))) / frequency * (frequency >= _LOWEST)
    centre = np.zeros(n_joints)
    motion = FourierTrajectory(1.0 / duration, waves[0], waves[1], centre).motion(np.arange(0.0, duration, _GRID))
    largest = np.maximum(np.abs(motion.q).max(axis=0) / _RANGE, np.abs(motion.dq).max(axis=0) / _SPEED)
    sine, cosine = waves / largest[:, None]
    return FourierTrajectory(1.0 / duration, sine, cosine, centre).motion(np.arange(int(duration * rate)) / rate)


def long_log(duration: float, rate: float = 100.0, seed: int = 0) -> Log:
    """|effort| of a UR10e with random feasible parameters and all default terms, 5 % noise."""
    robot = load_robot("ur10e")
    motion = long_motion(robot.n_joints, duration, rate, seed)
    model = Model(robot, make_terms(DEFAULT, robot, motion))
    rng = np.random.default_rng(seed)
    return simulate(model, random_parameters(model, rng), motion, rng=rng, noise=NOISE)


def cut(log: Log, rows: int) -> Log:
    """The log's first rows."""
    return Log(log.t[:rows], log.q[:rows], log.effort[:rows], log.signed, source=log.source)
