"""How a log might have to be read, and what the model leaves of it then: by least squares, with signs of its own.

A reading says whose log it is, which recorded joint each joint is by its positions and by its efforts, and the factors
and zeros of what was recorded. It is fitted with the standard terms to some hundred instants. Unknown signs and
coefficients are fitted in turn, first joint by joint from the efforts of robots drawn at random, whose gravity and
friction have about the right signs; then of the two sides of each joint those are taken that explain all joints
together, and signs and coefficients of all of them are fitted in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
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
"""Square of what is left of a column of length 1, once others have explained it, that is rounding."""
_LEAST = 1e-6
"""Relative residual that rounding leaves of a perfect fit."""


@dataclass(frozen=True)
class Reading:
    """How a log might have to be read.

    Attributes:
        robot: whose log it is.
        order: (n,) the recorded joint that each joint of the robot is, by its positions.
        efforts: (n,) and by its efforts.
        factor: (n,) of the positions.
        zero: (n,) added to them then, rad.
        turned: (n,) +1 or -1, of the efforts where their signs are known.
        units: (n,) factor of the efforts.
        kind: see `bayesid.identification.misread.Misreading`.
        change: see there.
    """

    robot: Robot
    order: Integers
    efforts: Integers
    factor: Array
    zero: Array
    turned: Array
    units: Array
    kind: str = ""
    change: str = ""

    @classmethod
    def as_given(cls, robot: Robot) -> Reading:
        """Nothing is changed."""
        order, ones = np.arange(robot.n_joints), np.ones(robot.n_joints)
        return cls(robot, order, order, ones, 0.0 * ones, ones, ones)

    @property
    def key(self) -> tuple[int, bytes, bytes, bytes]:
        """The same for readings with the same columns."""
        return id(self.robot), self.order.tobytes(), self.factor.tobytes(), self.zero.tobytes()

    @property
    def of_one_joint(self) -> bool:
        """Whether one joint alone is read in other units."""
        others = (np.abs(self.factor) != 1.0) | (self.units != 1.0)
        return len(others) > 1 and int(others.sum()) == 1

    @property
    def changed(self) -> Mask:
        """(n,) whether anything of a joint is read otherwise."""
        own = np.arange(len(self.order))
        moved = (self.order != own) | (self.efforts != own) | (self.zero != 0.0)
        changed: Mask = moved | (self.factor != 1.0) | (self.turned != 1.0) | (self.units != 1.0)
        return changed

    def motion(self, recorded: Motion) -> Motion:
        """Of the robot's joints."""
        q, dq, ddq = (part[:, self.order] * self.factor for part in (recorded.q, recorded.dq, recorded.ddq))
        return replace(recorded, q=q + self.zero, dq=dq, ddq=ddq)

    def model(self, motion: Motion) -> Model:
        """The standard terms, and what the flange carries."""
        actuators = self.robot.actuators(motion)
        terms = tuple(TERMS[name].for_motion(actuators) for name in STANDARD)
        return Model(self.robot, (*terms, *carried_payloads(motion)))

    def columns(self, recorded: Motion) -> Array:
        """(N, n, P) of the model."""
        motion = self.motion(recorded)
        return self.model(motion).columns(motion)

    @property
    def corrections(self) -> str:
        """Of what was recorded, as `bayesid.read_log` takes them; empty where it is right."""
        said = [
            *_corrections("q", self.order, self.factor, self.zero),
            *_corrections("tau", self.efforts, self.turned * self.units, 0.0 * self.zero),
        ]
        return ",".join(said)


def _corrections(kind: str, order: Integers, factor: Array, zero: Array) -> list[str]:
    own = np.array_equal(order, np.arange(len(order)))
    if own and not zero.any() and np.all(factor == factor[0]):
        return [] if factor[0] == 1.0 else [f"{kind}={_times(factor[0])}{kind}"]
    return [
        f"{kind}{j}={_times(by)}{kind}{other + 1}{f'{shift:+.6g}' if shift else ''}"
        for j, (other, by, shift) in enumerate(zip(order.tolist(), factor.tolist(), zero.tolist(), strict=True), 1)
        if (other + 1, by, shift) != (j, 1.0, 0.0)
    ]


def _times(factor: float) -> str:
    return {1.0: "", -1.0: "-"}.get(factor, f"{factor:.6g}*")


class Excerpt(NamedTuple):
    """Some instants of a log: motion, efforts (N, n), which of them count, and of which joints (n,) signs are known."""

    motion: Motion
    effort: Array
    used: Mask
    signed: Mask

    @classmethod
    def of(cls, motion: Motion, effort: Array, used: Mask, signed: Mask, instants: int) -> Excerpt:
        """At most so many instants, evenly spread over those that count."""
        rows = np.flatnonzero(used.any(axis=1))
        rows = rows[np.linspace(0, len(rows) - 1, min(instants, len(rows))).round().astype(int)]
        return cls(motion[rows], effort[rows], used[rows], signed)

    def read(self, reading: Reading) -> tuple[Array, Mask, Mask]:
        """(N, n) efforts and (N, n) which count, and (n,) known signs, of the robot's joints."""
        signed = self.signed[reading.efforts]
        effort = self.effort[:, reading.efforts] * np.where(signed, reading.turned, 1.0) * reading.units
        return effort, self.used[:, reading.order] & self.used[:, reading.efforts], signed


@dataclass(frozen=True)
class Left:
    """What a reading leaves of an excerpt."""

    residual: Array  #: (N, n) of each recorded joint, relative to its effort
    used: Mask  #: (N, n) which count
    size: int  #: number of coefficients
    effort: Array = field(repr=False)  #: (N, n) of the recorded joints, with the signs that suit the reading

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


def gain_of(given: Left, other: Left, count: Array) -> float:
    """Twice the nats by which another reading is likelier than the given one (:eq:`reading-gain`)."""
    return float(
        2.0 * count @ np.log(given.share / other.share) - (other.size - given.size) * np.log(max(count.sum(), 1.0))
    )


def counts_of_least(lefts: Sequence[Left], least: Array | float = 1.0) -> Array:
    """(n,) effective samples of each joint, by the reading that leaves least of it; at least so many of the first."""
    best = np.argmin([one.share for one in lefts], axis=0).tolist()
    floor = np.broadcast_to(least, (len(best),))
    return np.array([max(lefts[k].count(j), 1.0 if k else floor[j]) for j, k in enumerate(best)])


# ---------------------------------------------------------------------------------------------------------------
# Fits
# ---------------------------------------------------------------------------------------------------------------
class Fitted:
    """A reading's columns, weighted so that each joint counts alike.

    Args:
        reading: the reading.
        excerpt: the log's.
        columns: (N, n, P) of the reading.
    """

    def __init__(self, reading: Reading, excerpt: Excerpt, columns: Array) -> None:
        self.reading, self.excerpt, self.columns = reading, excerpt, columns
        self.effort, self.used, self.signed = excerpt.read(reading)
        energy = np.maximum((self.effort**2 * self.used).sum(axis=0), np.finfo(float).tiny)
        self.weight = self.used / np.sqrt(energy)

    @cached_property
    def basis(self) -> Array:
        """(N n, r) orthonormal, of the weighted columns."""
        return orthonormal((self.columns * self.weight[:, :, None]).reshape(self.effort.size, -1))

    @property
    def against_friction(self) -> Array:
        """(N, n) efforts whose unknown signs are those of the velocities."""
        speed = self.excerpt.motion.dq[:, self.reading.order] * self.reading.factor
        return np.where(self.signed, self.effort, np.sign(speed) * np.abs(self.effort))

    def with_signs_of(self, recorded: Array) -> Array:
        """(N, n) efforts whose unknown signs are those of efforts (N, n) of the recorded joints."""
        signs = np.where(recorded[:, self.reading.efforts] >= 0.0, 1.0, -1.0)
        return np.where(self.signed, self.effort, signs * np.abs(self.effort))

    def by_joint(self, drawn: Array, found: dict[tuple[object, ...], Array]) -> Array:
        """(N, n) efforts with the signs that suit each joint's own coefficients.

        Starts are the efforts of drawn parameters (P, K), with some friction or none, and friction alone; `found` keeps
        the signs of joints that other readings have in common with this one.
        """
        effort = self.against_friction.copy()
        for j in np.flatnonzero(~self.signed).tolist():
            used, key = self.used[:, j], (self.reading.key, j, int(self.reading.efforts[j]))
            if key not in found:
                found[key] = _signs_of(self.columns[used, j], effort[used, j], drawn)
            effort[used, j] = found[key] * np.abs(effort[used, j])
        return effort

    def sides(self, effort: Array) -> list[Array]:
        """(N, n) efforts with each hidden joint on the side that explains all joints together, best first.

        All of them turned round at once explain as much: both are there.
        """
        n = effort.shape[1]
        parts = np.einsum("njr,nj->rj", self.basis.reshape(*effort.shape, -1), effort * self.weight)
        hidden = np.flatnonzero(~self.signed)
        free = hidden[1:] if len(hidden) == n else hidden  # all of them turned at once explain as much
        if len(free) <= TUNING.most_sides:
            flips = np.ones((2 ** len(free), n))
            flips[:, free] = np.array(list(product([1.0, -1.0], repeat=len(free)))).reshape(len(flips), -1)
        else:
            flips = np.ones((1, n))
            for j in [*free, *free]:
                turned = np.where(np.arange(n) == j, -flips[0], flips[0])
                if np.sum((parts @ turned) ** 2) > np.sum((parts @ flips[0]) ** 2):
                    flips = turned[None]
        explained = ((parts @ flips.T) ** 2).sum(axis=0)
        order = np.argsort(-explained)[: TUNING.kept_sides]
        turns = (1.0, -1.0) if len(hidden) == n else (1.0,)
        return [turn * effort * flips[k] for k in order for turn in turns]

    def working(self, effort: Array) -> Array:
        """(N, n) efforts with each hidden joint on the side on which it does work against friction."""
        driven = (effort * np.sign(self.against_friction)).sum(axis=0) < 0.0
        return np.where(driven & ~self.signed, -effort, effort)

    def left(self, starts: Sequence[Array], believed: Mask | None = None) -> Left:
        """What the coefficients leave at least, from some efforts (N, n) with signs to begin with.

        Coefficients are fitted to the joints believed (n,), by default to all of them.
        """
        believed = np.ones(self.effort.shape[1], dtype=bool) if believed is None else believed
        fitted = [self._settled(start * self.weight, believed) for start in starts]
        effort, predicted = min(fitted, key=lambda one: float(np.linalg.norm(one[0] - one[1])))
        return self._left(effort, effort - predicted, self.basis.shape[1])

    def in_turn(self, start: Array, believed: Mask) -> Array:
        """(N, n) efforts whose unknown signs follow the coefficients that suit the joints believed."""
        safe = np.where(self.weight > 0.0, self.weight, 1.0)
        return np.where(self.used, self._settled(start * self.weight, believed)[0] / safe, start)

    def _settled(self, effort: Array, believed: Mask) -> tuple[Array, Array]:
        """(N, n) weighted efforts whose unknown signs follow the prediction, and the prediction."""
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

    def polished(self, left: Left) -> Left:
        """With the signs of one joint after the other begun anew, from what the other joints tell."""
        order = np.argsort(-left.share[self.reading.efforts])
        for j in [j for j in order.tolist() if not self.signed[j]]:
            others = np.arange(len(order)) != j
            start = self.in_turn(self.with_signs_of(left.effort), others)
            left = min([left, self.left([start])], key=lambda one: one.rms)
        return left

    def feasible(self, efforts: Sequence[Array], enough: float = 0.0) -> Left:
        """What feasible parameters leave at least: positive masses and friction; of efforts (N, n) with their signs.

        Of several the ones count that leave least by least squares. While feasible parameters leave more than enough,
        each joint does work against friction, or hidden joints are turned round one by one.
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

        distinct = {one.tobytes(): one for one in (each * self.weight for each in efforts)}
        starts = sorted(distinct.values(), key=lambda one: -float(np.sum((self.basis.T @ one.ravel()) ** 2)))
        best = min((solved(effort) for effort in starts[: 2 * TUNING.kept_sides]), key=lambda one: one[0])
        if best[0] > enough and not self.signed.all():
            best = min([best, *(solved(self.working(start)) for start in starts[:2])], key=lambda one: one[0])
        for j in np.flatnonzero(~self.signed).tolist():
            if best[0] > enough:
                turned = np.where(np.arange(len(self.signed)) == j, -best[3], best[3])
                best = min([best, solved(turned)], key=lambda one: one[0])
        return self._left(best[1], best[1] - best[2], len(coefficients))

    def _left(self, effort: Array, residual: Array, size: int) -> Left:
        recorded = np.argsort(self.reading.efforts)
        safe = np.where(self.weight > 0.0, self.weight, 1.0)
        back = effort / safe / (np.where(self.signed, self.reading.turned, 1.0) * self.reading.units)
        return Left(residual[:, recorded], self.used[:, recorded], size, back[:, recorded])


def _signs_of(rows: Array, effort: Array, drawn: Array) -> Array:
    """(M,) signs that suit a joint's columns (M, P) best, from efforts (M,) against friction."""
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
    left = np.linalg.norm(np.abs(predicted) - magnitude, axis=0)
    best: Array = nearest[:, int(np.argmin(left))]
    return best


def drawn_bodies(reading: Reading, motion: Motion, count: int) -> Array:
    """(P, K) of bodies that suit the reading's kinematics, drawn at random, without all else; deterministic."""
    model, rng = reading.model(reading.motion(motion)), np.random.default_rng(0)
    drawn = np.zeros((len(model.parameters), count))
    for k in range(count):
        drawn[model.cone.bodies, k] = random_parameters(model, rng=rng)[model.cone.bodies]
    return drawn


def orthonormal(columns: Array) -> Array:
    """(R, r) an orthonormal basis of columns (R, c) of any length, by a Cholesky decomposition with pivots."""
    gram = columns.T @ columns
    lengths = np.sqrt(np.diag(gram))
    shown = np.flatnonzero(lengths > BLIND * lengths.max(initial=0.0))
    if not len(shown):
        return np.zeros((len(columns), 0))
    factor, pivots, rank, _ = dpstrf(gram[np.ix_(shown, shown)] / np.outer(lengths[shown], lengths[shown]), tol=BLIND)
    chosen = shown[pivots[:rank] - 1]
    basis: Array = columns[:, chosen] @ (np.triu(dtrtri(factor[:rank, :rank])[0]) / lengths[chosen][:, None])
    return basis
