"""Shared by the benchmarks of the search: sign problems, clock, and targets."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from bayesid.arrays import Integers
from bayesid.cli.demo import Experiment, run_experiment
from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.motion import Motion
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.robot import load_robot
from bayesid.signs.search.certified import Certified, certified
from bayesid.signs.search.protocol import Search, SearchResult, SignProblem
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import FourierTrajectory, random_trajectory
from bayesid.studies.simulated import two_joint_arm

NOISE = 0.05
"""Relative to each joint's RMS effort, as in the paper's experiment."""
BUDGET = 60.0
"""Seconds allowed for a certificate; more than by default, to measure the time of late ones."""
SAME = 1e-6
"""Share of the energy below which costs of different solvers count as equal."""
_QUICK = 2.0
"""Seconds; shorter work is timed `_REPEATS` times."""
_REPEATS = 3
_LOWEST, _HIGHEST = 0.1, 0.5
"""Hz; the band of a simulated motion, as of usual exciting trajectories."""
_SPEED = 3.0
"""rad/s; largest speed of a simulated motion, about that of the UR10e's joints."""
_RANGE = 2.0
"""rad; largest angle of a simulated motion."""
_GRID = 0.02
"""s; grid for finding largest speed and angle: a hundredth of the shortest period."""

Value = TypeVar("Value")


# ---------------------------------------------------------------------------------------------------------------
# Clock and targets
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Check:
    """A figure beside its target.

    Attributes:
        what: name of the figure.
        value: the figure as printed.
        target: its required value.
        met: whether the target is met.
    """

    what: str
    value: str
    target: str
    met: bool

    def __str__(self) -> str:
        return f"{self.what:<70} {self.value:>22}   target {self.target:<22} {'met' if self.met else 'MISSED'}"


class Table:
    """Prints its header, then each row immediately.

    Args:
        first: header of the first, wide column.
        others: headers of the others, which determine their widths.
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
    """The result of the work, and its seconds: the median of three for short work."""
    spent: list[float] = []
    while len(spent) < _REPEATS:
        began = time.perf_counter()
        value = work()
        spent.append(time.perf_counter() - began)
        if spent[0] >= _QUICK:
            break
    return value, float(np.median(spent))


# ---------------------------------------------------------------------------------------------------------------
# Problems
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class LogProblem:
    """The sign problem of a log.

    Attributes:
        name: of the log.
        model: robot and terms.
        signs: the sign problem, of S segments.
        begins: (S,) each segment's first sample.
    """

    name: str
    model: Model
    signs: SignProblem
    begins: Integers

    @property
    def normal_equations(self) -> NormalEquations:
        """Scaled normal equations of the S segments."""
        return self.signs.normal_equations

    @property
    def coefficients(self) -> BaseCoefficients:
        """The model's base coefficients."""
        return self.signs.coefficients

    @property
    def energy(self) -> float:
        """The energy c of all segments' efforts."""
        return self.signs.energy

    @cached_property
    def unknown(self) -> int:
        """Number of segments with unknown sign."""
        return int(np.sum(self.normal_equations.known == 0))

    def solver(self) -> ConeLeastSquares:
        """A new solver, as in the pipeline's searches."""
        return self.signs.solver()

    def best(self) -> SearchResult:
        """The best assignment without a proof, from scratch."""
        return certified(self.normal_equations, self.solver(), budget=0.0)

    def proof(self) -> SearchResult:
        """The best assignment with its proof, from scratch."""
        return certified(self.normal_equations, self.solver(), budget=BUDGET)

    def first(self, count: int) -> LogProblem:
        """The problem of the first segments."""
        chosen = np.sort(np.argsort(self.begins, kind="stable")[:count])
        signs = SignProblem(self.normal_equations.chosen(chosen), self.signs.cone, self.coefficients)
        return LogProblem(f"{self.name}, first {count}", self.model, signs, self.begins[chosen])


@dataclass(frozen=True)
class Searched:
    """An identification, and the sign problem of its last certified search.

    Attributes:
        problem: the sign problem.
        result: the identification.
    """

    problem: LogProblem
    result: Identification

    def repeated(self) -> SearchResult:
        """The pipeline's search, repeated."""
        earlier = self.problem.signs.earlier
        start = None if earlier is None else earlier.theta
        return certified(self.problem.normal_equations, self.problem.solver(), start=start)


@dataclass(frozen=True)
class Recorder(Search):
    """The certified search, which keeps its problems.

    Rows are scaled by the noise of an earlier search, which a result does not hold.

    Attributes:
        search: the certified search.
        concluded: the problems that it certified.
    """

    search: Certified = Certified()
    concluded: list[SignProblem] = field(default_factory=list)

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """See `bayesid.signs.search.protocol.Search`."""
        return self.search.find(problem, steps)

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """See `bayesid.signs.search.protocol.Search`; keeps the problem."""
        self.concluded.append(problem)
        return self.search.certify(problem, progress)

    def searched(self, name: str, result: Identification) -> Searched:
        """The identification made with this search, and its last problem."""
        return Searched(LogProblem(name, result.model, self.concluded[-1], result.searched.start), result)


def real_problem(data: Path, name: str) -> Searched:
    """The problem of a real log, rectified."""
    path, recorder = data / f"{name}.csv", Recorder()
    log = read_log(path).rectified()
    return recorder.searched(
        name, identify(load_robot(path.parent / "robot.toml"), log, complete="off", search=recorder)
    )


def kr5_problem(seed: int = 0) -> tuple[Experiment, Searched]:
    """The paper's experiment, simulated, and its problem."""
    recorder = Recorder()
    experiment = run_experiment(seed, search=recorder)
    return experiment, recorder.searched(f"kr5, seed {seed}", experiment.result)


def simulated_problem(log: Log) -> Searched:
    """The problem of a simulated log of the UR10e."""
    recorder = Recorder()
    return recorder.searched("ur10e simulated", identify("ur10e", log, complete="off", search=recorder))


def arm_problem() -> LogProblem:
    """The problem of a simulated arm of two joints, as in docs/pbpr.md."""
    robot = two_joint_arm()
    model, rng = Model(robot, (RigidBody(),)), np.random.default_rng(1)
    motion = random_trajectory(2, 4.0, rng=4, harmonics=3).motion(np.arange(201) / 50.0)
    log = simulate(model, random_parameters(model, rng=rng), motion, rng=rng, noise=NOISE)
    recorder = Recorder()
    return recorder.searched("arm", identify(robot, log, terms=["rigid_body"], complete="off", search=recorder)).problem


# ---------------------------------------------------------------------------------------------------------------
# Simulated motion
# ---------------------------------------------------------------------------------------------------------------
def long_motion(n_joints: int, duration: float, rate: float, seed: int = 0) -> Motion:
    """A random motion without repetition, as fast as a usual exciting trajectory.

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
    model = Model(robot, make_terms(STANDARD, robot, motion))
    rng = np.random.default_rng(seed)
    return simulate(model, random_parameters(model, rng=rng), motion, rng=rng, noise=NOISE)


def cut(log: Log, rows: int) -> Log:
    """The log's first rows."""
    return Log(log.t[:rows], log.q[:rows], log.effort[:rows], log.signed, source=log.source)
