"""Readings of a log and their residuals, with signs fitted to each reading.

A reading consists of the robot, the recorded joint of each joint, and factors and zeros of the recorded values. It is
fitted with the standard terms to some hundred samples, signs and coefficients in turn. First each joint is fitted
alone, starting from efforts of random robots, whose gravity and friction have about the right signs. Then whole joints
are flipped so that they fit best together, and all joints are fitted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpstrf, dtrtri

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects import STANDARD
from bayesid.effects.bodies import carried_payloads
from bayesid.effects.catalogue import TERMS
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.identification.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.noise import autocovariance, integrated_time
from bayesid.regression.solver import ConeLeastSquares
from bayesid.robot import Robot
from bayesid.simulation.parameters import random_parameters

BLIND = 1e-9
"""Squared residual of a unit column, after projecting out other columns, below which it is rounding error."""
_LEAST = 1e-6
"""Smallest relative residual that is not rounding error."""


@dataclass(frozen=True)
class Reading:
    """A way to read a log.

    Attributes:
        robot: the robot.
        order: (n,) index of the recorded positions of each joint.
        efforts: (n,) index of the recorded efforts of each joint.
        factor: (n,) factor of the positions.
        zero: (n,) added to the scaled positions, rad.
        effort_sign: (n,) factor +1 or -1 of efforts with known signs.
        units: (n,) factor of the efforts.
        kind: as in `bayesid.identification.misread.Misreading`.
        change: as there.
    """

    robot: Robot
    order: Integers
    efforts: Integers
    factor: Array
    zero: Array
    effort_sign: Array
    units: Array
    kind: str = ""
    change: str = ""

    @classmethod
    def as_given(cls, robot: Robot) -> Reading:
        """The log as given."""
        order, ones = np.arange(robot.n_joints), np.ones(robot.n_joints)
        return cls(robot, order, order, ones, 0.0 * ones, ones, ones)

    @property
    def key(self) -> tuple[int, bytes, bytes, bytes]:
        """Equal for readings with equal columns."""
        return id(self.robot), self.order.tobytes(), self.factor.tobytes(), self.zero.tobytes()

    @property
    def of_one_joint(self) -> bool:
        """Whether the units of exactly one joint differ."""
        others = (np.abs(self.factor) != 1.0) | (self.units != 1.0)
        return len(others) > 1 and int(others.sum()) == 1

    @property
    def changed(self) -> Mask:
        """(n,) whether the reading of a joint differs from the given one."""
        same = np.arange(len(self.order))
        moved = (self.order != same) | (self.efforts != same) | (self.zero != 0.0)
        changed: Mask = moved | (self.factor != 1.0) | (self.effort_sign != 1.0) | (self.units != 1.0)
        return changed

    def motion(self, recorded: Motion) -> Motion:
        """Motion of the robot's joints."""
        q, dq, ddq = (part[:, self.order] * self.factor for part in (recorded.q, recorded.dq, recorded.ddq))
        return replace(recorded, q=q + self.zero, dq=dq, ddq=ddq)

    def model(self, motion: Motion) -> Model:
        """Standard terms and payloads."""
        actuators = self.robot.actuators(motion)
        terms = tuple(TERMS[name].for_motion(actuators) for name in STANDARD)
        return Model(self.robot, (*terms, *carried_payloads(motion)))

    def columns(self, recorded: Motion) -> Array:
        """(N, n, P) columns of the model."""
        motion = self.motion(recorded)
        return self.model(motion).columns(motion)

    @property
    def corrections(self) -> str:
        """Corrections for `bayesid.read_log`; empty if none are needed."""
        parts = [
            *_corrections("q", self.order, self.factor, self.zero),
            *_corrections("tau", self.efforts, self.effort_sign * self.units, 0.0 * self.zero),
        ]
        return ",".join(parts)


def _corrections(kind: str, order: Integers, factor: Array, zero: Array) -> list[str]:
    in_order = np.array_equal(order, np.arange(len(order)))
    if in_order and not zero.any() and np.all(factor == factor[0]):
        return [] if factor[0] == 1.0 else [f"{kind}={_times(factor[0])}{kind}"]
    return [
        f"{kind}{j}={_times(by)}{kind}{other + 1}{f'{shift:+.6g}' if shift else ''}"
        for j, (other, by, shift) in enumerate(zip(order.tolist(), factor.tolist(), zero.tolist(), strict=True), 1)
        if (other + 1, by, shift) != (j, 1.0, 0.0)
    ]


def _times(factor: float) -> str:
    return {1.0: "", -1.0: "-"}.get(factor, f"{factor:.6g}*")


class Excerpt(NamedTuple):
    """Some samples of a log: motion, efforts (N, n), whether they are used (N, n), and joints with known signs (n,)."""

    motion: Motion
    effort: Array
    used: Mask
    signed: Mask

    @classmethod
    def of(cls, motion: Motion, effort: Array, used: Mask, signed: Mask, instants: int) -> Excerpt:
        """At most this many samples, evenly spread over those that are used."""
        rows = np.flatnonzero(used.any(axis=1))
        rows = rows[np.linspace(0, len(rows) - 1, min(instants, len(rows))).round().astype(int)]
        return cls(motion[rows], effort[rows], used[rows], signed)

    def read(self, reading: Reading) -> tuple[Array, Mask, Mask]:
        """(N, n) efforts, (N, n) whether they are used, and (n,) whether signs are known, of the robot's joints."""
        signed = self.signed[reading.efforts]
        effort = self.effort[:, reading.efforts] * np.where(signed, reading.effort_sign, 1.0) * reading.units
        return effort, self.used[:, reading.order] & self.used[:, reading.efforts], signed


@dataclass(frozen=True)
class ReadingResidual:
    """Residual of a reading on an excerpt."""

    residual: Array  #: (N, n) of each recorded joint, relative to its effort
    used: Mask  #: (N, n) samples that are used
    size: int  #: number of coefficients
    effort: Array = field(repr=False)  #: (N, n) of the recorded joints, with the reading's signs

    @cached_property
    def share(self) -> Array:
        """(n,) relative residual of each recorded joint."""
        return np.maximum(np.linalg.norm(self.residual, axis=0), _LEAST)

    @property
    def rms(self) -> float:
        """Relative residual over all joints."""
        return float(np.sqrt(np.mean(self.share**2)))

    def count(self, j: int) -> float:
        """Effective samples of a recorded joint."""
        residual, used = self.residual[:, j], self.used[:, j]
        return used.sum() / integrated_time(autocovariance(residual, used, len(residual) // TUNING.longest_lag_share))


def bic_gain(given: ReadingResidual, other: ReadingResidual, count: Array) -> float:
    """Difference of the Bayesian information criteria of two readings, in twice nats (:eq:`reading-gain`)."""
    return float(
        2.0 * count @ np.log(given.share / other.share) - (other.size - given.size) * np.log(max(count.sum(), 1.0))
    )


def counts_of_least(residuals: Sequence[ReadingResidual], least: Array | float = 1.0) -> Array:
    """(n,) effective samples of each joint, by the smallest residual; at least `least` for the first one."""
    best = np.argmin([residual.share for residual in residuals], axis=0).tolist()
    floor = np.broadcast_to(least, (len(best),))
    return np.array([max(residuals[k].count(j), 1.0 if k else floor[j]) for j, k in enumerate(best)])


# ---------------------------------------------------------------------------------------------------------------
# Fits
# ---------------------------------------------------------------------------------------------------------------
class Fitted:
    """A reading with its columns (N, n, P) for an excerpt, weighted by each joint's RMS effort."""

    def __init__(self, reading: Reading, excerpt: Excerpt, columns: Array) -> None:
        self.reading, self.excerpt, self.columns = reading, excerpt, columns
        self.effort, self.used, self.signed = excerpt.read(reading)
        energy = np.maximum((self.effort**2 * self.used).sum(axis=0), np.finfo(float).tiny)
        self.weight = self.used / np.sqrt(energy)

    @cached_property
    def basis(self) -> Array:
        """(N n, r) orthonormal basis of the weighted columns."""
        return orthonormal((self.columns * self.weight[:, :, None]).reshape(self.effort.size, -1))

    @property
    def against_friction(self) -> Array:
        """(N, n) efforts whose unknown signs are those of the velocities."""
        speed = self.excerpt.motion.dq[:, self.reading.order] * self.reading.factor
        return np.where(self.signed, self.effort, np.sign(speed) * np.abs(self.effort))

    def with_signs_of(self, recorded: Array) -> Array:
        """(N, n) efforts with their unknown signs taken from efforts (N, n) of the recorded joints."""
        signs = np.where(recorded[:, self.reading.efforts] >= 0.0, 1.0, -1.0)
        return np.where(self.signed, self.effort, signs * np.abs(self.effort))

    def by_joint(self, drawn: Array, cache: dict[tuple[object, ...], Array]) -> Array:
        """(N, n) efforts with the signs of the best fit to each joint alone.

        Fits start from the efforts of drawn parameters (P, K) with various friction, and from friction alone. `cache`
        keeps the signs of joints that several readings have in common.
        """
        effort = self.against_friction.copy()
        for j in np.flatnonzero(~self.signed).tolist():
            used, key = self.used[:, j], (self.reading.key, j, int(self.reading.efforts[j]))
            if key not in cache:
                cache[key] = _signs_of(self.columns[used, j], effort[used, j], drawn)
            effort[used, j] = cache[key] * np.abs(effort[used, j])
        return effort

    def best_flips(self, effort: Array) -> list[Array]:
        """(N, n) efforts with all signs of some hidden joints flipped: the best fits to all joints together.

        If no joint has known signs, flipping all joints fits equally well, so both are returned.
        """
        n = effort.shape[1]
        parts = np.einsum("njr,nj->rj", self.basis.reshape(*effort.shape, -1), effort * self.weight)
        hidden = np.flatnonzero(~self.signed)
        free = hidden[1:] if len(hidden) == n else hidden
        if len(free) <= TUNING.most_flipped:
            flips = np.ones((2 ** len(free), n))
            flips[:, free] = np.array(list(product([1.0, -1.0], repeat=len(free)))).reshape(len(flips), -1)
        else:
            flips = np.ones((1, n))
            for j in [*free, *free]:
                flipped = np.where(np.arange(n) == j, -flips[0], flips[0])
                if np.sum((parts @ flipped) ** 2) > np.sum((parts @ flips[0]) ** 2):
                    flips = flipped[None]
        explained = ((parts @ flips.T) ** 2).sum(axis=0)
        order = np.argsort(-explained)[: TUNING.kept_flips]
        turns = (1.0, -1.0) if len(hidden) == n else (1.0,)
        return [turn * effort * flips[k] for k in order for turn in turns]

    def doing_work(self, effort: Array) -> Array:
        """(N, n) efforts with hidden joints flipped so that their total work is positive."""
        driven = (effort * np.sign(self.against_friction)).sum(axis=0) < 0.0
        return np.where(driven & ~self.signed, -effort, effort)

    def residual(self, starts: Sequence[Array], believed: Mask | None = None) -> ReadingResidual:
        """Smallest residual of fits that start from efforts (N, n) with initial signs.

        Coefficients are fitted to the joints `believed` (n,), by default to all.
        """
        believed = np.ones(self.effort.shape[1], dtype=bool) if believed is None else believed
        fitted = [self._alternated(start * self.weight, believed) for start in starts]
        effort, predicted = min(fitted, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))
        return self._residual_of(effort, effort - predicted, self.basis.shape[1])

    def signs_from(self, start: Array, believed: Mask) -> Array:
        """(N, n) efforts with unknown signs from a fit to the joints `believed` (n,)."""
        safe = np.where(self.weight > 0.0, self.weight, 1.0)
        return np.where(self.used, self._alternated(start * self.weight, believed)[0] / safe, start)

    def _alternated(self, effort: Array, believed: Mask) -> tuple[Array, Array]:
        """(N, n) weighted efforts and prediction after alternating fits of signs and coefficients."""
        inverse = None
        if not believed.all():
            rows = self.basis[np.broadcast_to(believed, effort.shape).ravel()]
            inverse = np.linalg.pinv(rows.T @ rows, rcond=BLIND, hermitian=True)
        for _ in range(TUNING.reading_rounds):
            shares = self.basis.T @ (effort * believed).ravel()
            predicted = (self.basis @ (shares if inverse is None else inverse @ shares)).reshape(effort.shape)
            followed = np.where(self.signed, effort, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(effort))
            if np.array_equal(followed, effort):
                break
            effort = followed
        return effort, predicted

    def with_signs_restarted(self, best: ReadingResidual) -> ReadingResidual:
        """The best residual after restarting each joint's signs, one after the other, from a fit to the others."""
        order = np.argsort(-best.share[self.reading.efforts])
        for j in [j for j in order.tolist() if not self.signed[j]]:
            others = np.arange(len(order)) != j
            start = self.signs_from(self.with_signs_of(best.effort), others)
            best = min([best, self.residual([start])], key=lambda residual: residual.rms)
        return best

    def feasible_residual(self, efforts: Sequence[Array], enough: float = 0.0) -> ReadingResidual:
        """Smallest residual of feasible parameters (positive masses and friction), for efforts (N, n) with signs.

        The efforts with the smallest least-squares residuals are tried. While the residual exceeds `enough`, hidden
        joints are flipped: to positive work, then one by one.
        """
        model = self.reading.model(self.reading.motion(self.excerpt.motion))
        coefficients = base_coefficients(model)
        rows = (self.columns[:, :, coefficients.selected] * self.weight[:, :, None]).reshape(self.effort.size, -1)
        problem = ConeLeastSquares(model.cone, coefficients, rows.T @ rows, float(self.effort.shape[1])).prepared()

        def solved(effort: Array) -> tuple[float, Array, Array, Array]:
            solution = problem.solve(rows.T @ effort.ravel())
            predicted = (rows @ coefficients.project(solution.theta)).reshape(effort.shape)
            followed = np.where(self.signed, effort, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(effort))
            return float(np.sqrt(np.mean(np.sum((followed - predicted) ** 2, axis=0)))), followed, predicted, effort

        distinct = {effort.tobytes(): effort for effort in (each * self.weight for each in efforts)}
        starts = sorted(distinct.values(), key=lambda effort: -float(np.sum((self.basis.T @ effort.ravel()) ** 2)))
        best = min((solved(effort) for effort in starts[: 2 * TUNING.kept_flips]), key=itemgetter(0))
        if best[0] > enough and not self.signed.all():
            best = min([best, *(solved(self.doing_work(start)) for start in starts[:2])], key=itemgetter(0))
        for j in np.flatnonzero(~self.signed).tolist():
            if best[0] > enough:
                flipped = np.where(np.arange(len(self.signed)) == j, -best[3], best[3])
                best = min([best, solved(flipped)], key=itemgetter(0))
        return self._residual_of(best[1], best[1] - best[2], len(coefficients))

    def _residual_of(self, effort: Array, residual: Array, size: int) -> ReadingResidual:
        recorded = np.argsort(self.reading.efforts)
        safe = np.where(self.weight > 0.0, self.weight, 1.0)
        back = effort / safe / (np.where(self.signed, self.reading.effort_sign, 1.0) * self.reading.units)
        return ReadingResidual(residual[:, recorded], self.used[:, recorded], size, back[:, recorded])


def _signs_of(rows: Array, effort: Array, drawn: Array) -> Array:
    """(M,) signs of the best fit of a joint's columns (M, P) to efforts (M,) with the velocities' signs."""
    magnitude, basis = np.abs(effort)[:, None], orthonormal(rows)
    moved = rows @ drawn
    moved /= np.maximum(np.sqrt(np.mean(moved**2, axis=0)), np.finfo(float).tiny)
    friction = np.sign(effort)[:, None]
    starts = np.hstack([*(moved + share * friction for share in TUNING.shares_of_friction), friction])
    signs = np.where(starts >= 0.0, 1.0, -1.0)
    for _ in range(TUNING.reading_rounds):
        predicted = basis @ (basis.T @ (signs * magnitude))
        nearest = np.where(predicted >= 0.0, 1.0, -1.0)
        if np.array_equal(nearest, signs):
            break
        signs = nearest
    residual = np.linalg.norm(np.abs(predicted) - magnitude, axis=0)
    best: Array = nearest[:, int(np.argmin(residual))]
    return best


def drawn_bodies(reading: Reading, motion: Motion, count: int) -> Array:
    """(P, K) parameters of random bodies for this kinematics, other parameters zero; deterministic."""
    model, rng = reading.model(reading.motion(motion)), np.random.default_rng(0)
    drawn = np.zeros((len(model.parameters), count))
    for k in range(count):
        drawn[model.cone.bodies, k] = random_parameters(model, rng=rng)[model.cone.bodies]
    return drawn


def orthonormal(columns: Array) -> Array:
    """(R, r) an orthonormal basis of columns (R, c), by a pivoted Cholesky decomposition."""
    gram = columns.T @ columns
    lengths = np.sqrt(np.diag(gram))
    shown = np.flatnonzero(lengths > BLIND * lengths.max(initial=0.0))
    if not len(shown):
        return np.zeros((len(columns), 0))
    factor, pivots, rank, _ = dpstrf(gram[np.ix_(shown, shown)] / np.outer(lengths[shown], lengths[shown]), tol=BLIND)
    chosen = shown[pivots[:rank] - 1]
    basis: Array = columns[:, chosen] @ (np.triu(dtrtri(factor[:rank, :rank])[0]) / lengths[chosen][:, None])
    return basis
