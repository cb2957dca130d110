"""One hour of a UR10e at 1 kHz, simulated minute by minute and never stored: normal equations in bounded memory, signs.

Every minute is a new random motion. Segments are runs of the true signs, cut at velocity reversals and at the ends of a
minute, without standstill.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.motion import Motion
from bayesid.regression.normal_equations import NormalEquations, join_moments, normal_equations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.robot import load_robot
from bayesid.signs.search.certified import certified
from bayesid.simulation.parameters import random_parameters
from bayesid.studies.benchmarks.problems import BUDGET, NOISE, long_motion
from bayesid.studies.record import Row

_RATE = 1000.0
"""Hz."""
_MINUTE = 60.0
"""s."""
_MOST_INDIVIDUAL = 5_000
"""Segments of each joint with a separate Hessian, as in the pipeline."""


def hour_in_new_process(duration: float) -> Row:
    """`hour` in a new process, to measure its memory alone."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(hour, duration).result()


@threadpool_limits.wrap(limits=1, user_api="blas")
def hour(duration: float) -> Row:
    """Normal equations and signs of `duration` seconds, with their speed and the peak of this process's memory."""
    source = _Source.random()
    spent: list[float] = []
    raw = join_moments(source.pieces(round(duration / _MINUTE), spent), _MOST_INDIVIDUAL)
    scaled = raw.scaled(NOISE * source.rms)
    solver = ConeLeastSquares(
        source.model.cone, base_coefficients(source.model), scaled.hessian.total(), float(scaled.energy.sum())
    )
    began = time.perf_counter()
    certified(scaled, solver, budget=0.0)
    best_seconds = time.perf_counter() - began
    result = certified(scaled, solver, BUDGET)
    return {
        "samples": round(duration * _RATE),
        "segments": len(scaled),
        "separate": int(scaled.individual.sum()),
        "normal_equations_seconds": sum(spent),
        "best_seconds": best_seconds,
        "seconds": result.seconds,
        "certified": result.certified,
        "gap": 1.0 - (result.lower_bound or 0.0) / result.cost,
        "missed": result.missed,
        "right": float(np.average(result.signs == source.true_signs(), weights=scaled.count)),
        "peak": peak_memory(),
    }


@dataclass
class _Source:
    """A robot whose log is simulated while it is read.

    Attributes:
        model: robot and terms.
        theta: (P,) its parameters.
        rms: (n,) of its efforts in the first minute, N m; noise is relative to it.
        signs: true signs of the segments of all minutes so far.
    """

    model: Model
    theta: Array
    rms: Array
    signs: list[Array]

    @classmethod
    def random(cls) -> _Source:
        robot = load_robot("ur10e")
        first = _motion(0)
        model = Model(robot, make_terms(STANDARD, robot, first))
        theta = random_parameters(model, rng=np.random.default_rng(0))
        return cls(model, theta, np.sqrt(np.mean(model.effort(first, theta) ** 2, axis=0)), [])

    def pieces(self, minutes: int, spent: list[float]) -> Iterator[NormalEquations]:
        """Normal equations of every minute; their seconds are appended to `spent`."""
        coefficients, rng = base_coefficients(self.model), np.random.default_rng(1)
        for minute in range(minutes):
            motion = _motion(minute)
            true = self.model.effort(motion, self.theta)
            segments, signs = _true_segments(true, motion)
            self.signs.append(signs)
            effort = np.abs(true + NOISE * self.rms * rng.standard_normal(true.shape))
            began = time.perf_counter()
            piece = normal_equations(self.model, coefficients, motion, effort, segments, _MOST_INDIVIDUAL)
            spent.append(time.perf_counter() - began)
            yield piece

    def true_signs(self) -> Array:
        """(S,) of all segments, in the order of the normal equations."""
        return np.concatenate(self.signs)


def _motion(minute: int) -> Motion:
    return long_motion(6, _MINUTE, _RATE, seed=minute)


def _true_segments(true: Array, motion: Motion) -> tuple[Segments, Array]:
    """Segments in motion of constant effort and velocity sign, and the signs of their efforts."""
    rows, signs = [], []
    moving = np.abs(motion.dq) > motion.standstill_speed
    for j in range(motion.n_joints):
        state = np.where(moving[:, j], 2.0 * np.sign(true[:, j]) + np.sign(motion.dq[:, j]), 0.0)
        for a, b in pairwise([0, *(np.flatnonzero(np.diff(state)) + 1), len(motion)]):
            if moving[a, j]:
                rows.append((j, a, b))
                signs.append(float(np.sign(true[a, j])))
    joint, start, end = np.array(rows, dtype=np.int64).T
    unknown, all_moving = np.zeros(len(rows), dtype=np.int64), np.ones(len(rows), dtype=bool)
    return Segments(joint, start, end, unknown, all_moving), np.array(signs)


def peak_memory() -> float:
    """Largest resident size of this process so far, bytes.

    On Linux the peak of getrusage includes the parent's; /proc counts from the start of the process.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmHWM:"))
        return 1024.0 * float(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)
