"""Random search for a motion that minimises an objective under constraints.

It starts from the best of some random Fourier series within the limits. Each step changes some control points of one
joint or several: a bump, a stretch of constant speed, or a repetition of another stretch. The change is shortened to
the limits (`Feasibility.feasible_share`). It is accepted if the objective falls and the motion is feasible; otherwise
its opposite is tried. So every accepted motion is feasible.

Information is a sum over samples. A change of control points moves a short window, and only there columns are computed
again. Weights are computed everywhere, as standstill depends on the joint's highest speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array
from bayesid.excitation.resolvability import information_of
from bayesid.excitation.splines import DEGREE, ENDS, Feasibility, SplineBasis, SplineTrajectory, at_rest
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.parallel import in_parallel
from bayesid.progress import Progress
from bayesid.simulation.trajectories import MotionLimits, random_trajectory


@dataclass(frozen=True)
class _Candidate:
    trajectory: SplineTrajectory
    columns: Array  # (N, n, R) at the samples of the search
    weights: Array  # (N, n)
    information: Array  # (R, R)
    cost: float  # value of the objective


@dataclass(frozen=True)
class MotionSearch:
    """Objective, constraints and spline basis of a search."""

    columns: Callable[[Motion], Array]  # (N, n, R) of a motion of N samples
    weights: Callable[[Motion], Array]  # (N, n) of its samples
    objective: Callable[[Array], float]  # of information (R, R); minimised
    whole_motion: bool  # whether columns depend on the whole motion
    feasibility: Feasibility  # constraints
    basis: SplineBasis
    pose: Array  # (n,) at both ends, rad
    payload: str = ""  # label of the payload

    @cached_property
    def times(self) -> Array:
        """(N,) sample times, s, at which information is summed."""
        rate = min(TUNING.search_rate, TUNING.per_knot / self.basis.spacing)
        return np.linspace(0.0, self.basis.duration, round(self.basis.duration * rate) + 1)

    @cached_property
    def _values(self) -> tuple[Array, ...]:
        """(N, K) matrices from control points to positions, velocities and accelerations."""
        return tuple(self.basis.values(self.times, order) for order in range(3))

    def _motion(self, trajectory: SplineTrajectory) -> Motion:
        q, dq, ddq = (values @ trajectory.control for values in self._values)
        return Motion(self.times, q, dq, ddq, 0.0, np.array(trajectory.payload))

    def run(self, changes: int, seed: int) -> tuple[SplineTrajectory, SplineTrajectory]:
        """The best of some random motions, and the motion after a number of changes."""
        rng = np.random.default_rng(seed)
        starts = [self._evaluated(self._start(rng)) for _ in range(TUNING.starts)]
        first = best = min(starts, key=lambda tried: tried.cost)
        opposite: Array | None = None
        for _ in range(changes):
            step = self._step(best.trajectory, rng) if opposite is None else opposite
            tried = self._better_of(best, step)
            opposite = -step if tried is best and opposite is None else None
            best = tried
        return first.trajectory, best.trajectory

    def cost(self, trajectory: SplineTrajectory) -> float:
        """Objective of a motion."""
        return self._evaluated(trajectory).cost

    def _start(self, rng: np.random.Generator) -> SplineTrajectory:
        """A random motion within the limits, halved until it is feasible; the robot stands still if it never is."""
        still = at_rest(self.basis, self.pose, self.payload)
        step = self._random(rng) - self.pose
        step[:ENDS] = step[-ENDS:] = 0.0
        for joint in range(len(self.pose)):
            alone = np.where(np.arange(len(self.pose)) == joint, step, 0.0)
            step[:, joint] *= self.feasibility.feasible_share(still, alone)
        for _ in range(TUNING.halvings):
            moved = replace(still, control=still.control + step)
            if self.feasibility.is_feasible(moved):
                return moved
            step = 0.5 * step
        return still

    def _random(self, rng: np.random.Generator) -> Array:
        """(K, n) control points of a random motion that begins and ends in the pose."""
        can, places, n = self.feasibility, self.basis.places, len(self.pose)
        limits = MotionLimits(*(tuple(each.tolist()) for each in (can.lower, can.upper, can.rates[0], can.rates[1])))
        wave = random_trajectory(n, self.basis.duration, rng=int(rng.integers(2**31)), limits=limits)
        away = np.minimum(places, self.basis.duration - places) / min(TUNING.ramp, 0.5 * self.basis.duration)
        share = np.sin(0.5 * np.pi * np.clip(away, 0.0, 1.0)) ** 2
        return np.asarray(self.pose + share[:, None] * (wave.motion(places).q - self.pose))

    def _evaluated(
        self, trajectory: SplineTrajectory, other: _Candidate | None = None, start: float = 0.0, end: float = 0.0
    ) -> _Candidate:
        """Evaluates a motion; if another motion is given, only where they differ, from `start` to `end`, s."""
        motion = self._motion(trajectory)
        weights = self.weights(motion)
        if other is None or self.whole_motion:
            columns = self.columns(motion)
            information = information_of(columns, weights)
        else:
            window = slice(*np.searchsorted(self.times, [start - 1e-9, end + 1e-9]).tolist())
            changed, columns = (weights != other.weights).any(axis=1), other.columns.copy()
            changed[window], columns[window] = True, self.columns(motion[window])
            before = information_of(other.columns[changed], other.weights[changed])
            information = other.information - before + information_of(columns[changed], weights[changed])
        return _Candidate(trajectory, columns, weights, information, self.objective(information))

    def _better_of(self, best: _Candidate, step: Array) -> _Candidate:
        """The motion with a change (K, n) of its control points, if that is better and feasible."""
        share, rows = self.feasibility.feasible_share(best.trajectory, step), np.flatnonzero(step.any(axis=1))
        if not share > 0.0:
            return best
        moved = replace(best.trajectory, control=best.trajectory.control + share * step)
        start, end = float(self.basis.knots[rows[0]]), float(self.basis.knots[rows[-1] + DEGREE + 1])
        tried = self._evaluated(moved, best, start, end)
        better = tried.cost < best.cost and self.feasibility.is_feasible(moved, start, end)
        return tried if better else best

    # ---- Changes ----
    def _step(self, trajectory: SplineTrajectory, rng: np.random.Generator) -> Array:
        n = len(self.pose)
        kinds = (self._bump, self._constant_speed, self._repetition)
        count = 1 + rng.binomial(n - 1, 0.5) if rng.random() < TUNING.several_joints else 1
        step = np.zeros_like(trajectory.control)
        kind = kinds[rng.choice(len(kinds), p=TUNING.change_probabilities)]
        span = self._span(rng)
        for joint in rng.choice(n, count, replace=False).tolist():
            step[span, joint] = kind(trajectory.control[:, joint], joint, span, rng)
        return step

    def _span(self, rng: np.random.Generator) -> slice:
        free = len(self.basis) - 2 * ENDS
        width = int(np.clip(np.exp(rng.uniform(0.0, np.log(max(TUNING.widest_change * free, 2.0)))), 1, free))
        first = ENDS + int(rng.integers(0, free - width + 1))
        return slice(first, first + width)

    def _bump(self, control: Array, joint: int, span: slice, rng: np.random.Generator) -> Array:
        full, width = self.feasibility.upper[joint] - self.feasibility.lower[joint], span.stop - span.start
        size = full * np.exp(rng.uniform(np.log(TUNING.smallest_bump), 0.0))
        phase = (np.arange(width) + 1.0) / (width + 1.0)
        return np.asarray(rng.choice([-1.0, 1.0]) * size * np.sin(np.pi * phase) ** 2)

    def _constant_speed(self, control: Array, joint: int, span: slice, rng: np.random.Generator) -> Array:
        speed = self.feasibility.rates[0, joint] * np.exp(rng.uniform(np.log(TUNING.slowest_speed), 0.0))
        steps = np.arange(span.stop - span.start) * self.basis.duration / (len(self.basis) - DEGREE)
        return np.asarray(control[span.start - 1] + rng.choice([-1.0, 1.0]) * speed * steps - control[span])

    def _repetition(self, control: Array, joint: int, span: slice, rng: np.random.Generator) -> Array:
        width = span.stop - span.start
        other = int(rng.integers(0, len(self.basis) - width + 1))
        return np.asarray(control[other : other + width] - control[span])


def best_motion(
    search: MotionSearch, changes: int, progress: Progress, seed: int = 0
) -> tuple[SplineTrajectory, SplineTrajectory]:
    """Start and result of the best of some searches with different random starts."""
    seeds = range(TUNING.searches * seed, TUNING.searches * (seed + 1))
    with progress.stage("design") as steps:
        found = in_parallel([partial(search.run, changes, seed) for seed in seeds], steps)
    return min(found, key=lambda pair: search.cost(pair[1]))
