"""Whether a log is of another robot, or is read wrongly: readings of it that explain it better than the one given.

A wrong robot file, joints in another order, or positions in the wrong unit leave a residual that looks like any poor
model's. What tells them apart is that something else fits: the log with two joints exchanged, with one turned round,
with other units, another mounting; the table of another robot; or even one that is drawn at random. Every such reading
is fitted as the given one is, by least squares with the standard terms on some hundred instants of the log, from the
signs that were found; signs that were unknown may follow the prediction. If r and e_j are the coefficients and relative
residuals of the given reading and r', e_j' those of another, their Bayesian information criteria differ by
:eq:`reading-gain`::

    2 sum_j n_j ln(e_j / e_j') - (r' - r) ln(sum_j n_j),

n_j the effective samples by the reading that leaves less: what a wrong one leaves is no noise. A better reading must be
decisively so among all that were tried and, as no model is right and evidence grows with the log all the same, leave
clearly less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations, product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.linalg.lapack import dpstrf, dtrtri
from scipy.spatial.transform import Rotation

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects import STANDARD
from bayesid.effects.bodies import carried_payloads
from bayesid.effects.catalogue import TERMS
from bayesid.effects.model import Model
from bayesid.identification.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.evidence import Evidence
from bayesid.regression.least_squares import Fit
from bayesid.regression.noise import autocovariance, integrated_time
from bayesid.robot import BUILT_IN, Joint, Robot, load_robot

_DECISIVE = np.log(1000.0)
"""Nats, for each reading being as likely beforehand as all others together: three times the digits of a decisive Bayes
factor (Jeffreys 1961, appendix B), for the finding is a red light."""
_BLIND = 1e-9
"""Square of what is left of a column of length 1, once others have explained it, that is rounding."""
_LEAST = 1e-6
"""Relative residual that rounding leaves of a perfect fit."""
_DEGREE = np.pi / 180.0
_QUARTERS = np.array([0.0, 0.5, 1.0, -0.5]) * np.pi
"""rad; angles of the twists and zeros of most arms."""


@dataclass(frozen=True)
class BetterReading:
    """A reading that explains a log better than the one given."""

    kind: str  #: "joint order", "direction", "units", "mounting" or "robot"
    change: str  #: what is other, to follow on "with"
    leaves: float  #: RMS of what it leaves over RMS of the effort, over all joints
    given: float  #: the same of the reading given


@dataclass(frozen=True)
class _Reading:
    """How a log might have to be read."""

    robot: Robot  # whose log it is
    order: Integers  # (n,) the recorded joint that each joint of the robot is, by its positions
    efforts: Integers  # (n,) and by its efforts
    factor: Array  # (n,) of the recorded positions
    turned: Array  # (n,) +1 or -1, of the recorded efforts where their signs are known
    units: Array  # (n,) factor of the recorded efforts
    kind: str = ""  # see `BetterReading`
    change: str = ""  # see there

    @property
    def of_one_joint(self) -> bool:
        """Whether one joint alone is read in other units."""
        others = (np.abs(self.factor) != 1.0) | (self.units != 1.0)
        return len(others) > 1 and int(others.sum()) == 1

    def columns(self, recorded: Motion) -> Array:
        """(N, n, P) of the standard terms, and of what the flange carries."""
        q, dq, ddq = (part[:, self.order] * self.factor for part in (recorded.q, recorded.dq, recorded.ddq))
        motion = replace(recorded, q=q, dq=dq, ddq=ddq)
        actuators = self.robot.actuators(motion)
        terms = tuple(TERMS[name].for_motion(actuators) for name in STANDARD)
        return Model(self.robot, (*terms, *carried_payloads(motion))).columns(motion)


class _Excerpt(NamedTuple):
    """Some instants of a log: motion, efforts (N, n) with the signs that were found, which count, which are known."""

    motion: Motion
    effort: Array
    used: Mask
    signed: Mask


def suspected_reading(evidence: Evidence, fit: Fit, probability: Array) -> BetterReading | None:
    """The reading that explains a log better than the given one, where the fit is a reason to look for one."""
    if fit.relative_residual.max() <= TUNING.suspicious or not evidence.used.any(axis=0).all():
        return None  # a joint whose efforts are all in fault cannot be compared with another
    return better_reading(evidence, np.where(probability >= 0.5, 1.0, -1.0), fit.residual.autocorrelation)


def better_reading(evidence: Evidence, signs: Array, time: Array) -> BetterReading | None:
    """The reading that explains a log best, if that is not the given one; deterministic.

    Args:
        evidence: the robot and the log.
        signs: (N, n) of the efforts, as they were found.
        time: (n,) samples that count as one.
    """
    signals, used, robot = evidence.signals, evidence.used, evidence.model.robot
    rows = np.flatnonzero(used.any(axis=1))
    rows = rows[np.linspace(0, len(rows) - 1, min(TUNING.instants, len(rows))).round().astype(int)]
    effort = np.where(signals.signed, signals.effort, signs * np.abs(signals.effort))
    excerpt = _Excerpt(signals.motion[rows], effort[rows], used[rows], signals.signed)
    order, ones = np.arange(robot.n_joints), np.ones(robot.n_joints)
    as_given = _Reading(robot, order, order, ones, ones, ones)
    readings = [
        replace(as_given, kind=kind, change=change, **other)
        for kind, readings_of in _HYPOTHESES
        for change, other in readings_of(robot)
    ]
    given, *left = _left_by([as_given, *readings], excerpt)
    count = _of_the_least(given, np.maximum(used.sum(axis=0) / time, 1.0), left)
    best, found = 2.0 * (_DECISIVE + np.log(len(readings))), None
    for reading, other in zip(readings, left, strict=True):
        gain = 2.0 * count @ np.log(given.share / other.share) - (other.size - given.size) * np.log(count.sum())
        clearly = other.rms < TUNING.clearly_better * given.rms
        if reading.of_one_joint:
            clearly |= other.rms < given.rms and bool((other.share < TUNING.one_joint_better * given.share).any())
        if gain > best and clearly:
            best, found = float(gain), BetterReading(reading.kind, reading.change, other.rms, given.rms)
    return found


@dataclass(frozen=True)
class _Left:
    """What a reading leaves of an excerpt."""

    residual: Array  # (N, n) of each recorded joint, relative to its effort
    used: Mask  # (N, n) which count
    size: int  # number of coefficients

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


def _of_the_least(given: _Left, count: Array, others: Sequence[_Left]) -> Array:
    """(n,) effective samples of each joint, by the reading that leaves least of it; of the given one in all the log."""
    least = np.argmin([one.share for one in (given, *others)], axis=0).tolist()
    return np.array([others[k - 1].count(j) if k else max(count[j], given.count(j)) for j, k in enumerate(least)])


def _left_by(readings: Sequence[_Reading], excerpt: _Excerpt) -> list[_Left]:
    """What each reading leaves; those with the same columns share them, one after another."""
    left: list[_Left] = []
    columns: dict[tuple[int, bytes, bytes], Array] = {}
    for reading in readings:
        key = id(reading.robot), reading.order.tobytes(), reading.factor.tobytes()
        if key not in columns:
            columns = {key: reading.columns(excerpt.motion)}
        left.append(_leaves(reading, excerpt, columns[key]))
    return left


def _leaves(reading: _Reading, excerpt: _Excerpt, columns: Array) -> _Left:
    """The least residual of the reading's coefficients, from several signs to begin with."""
    order = reading.efforts
    used, signed = excerpt.used[:, reading.order], excerpt.signed[order]
    effort = excerpt.effort[:, order] * np.where(signed, reading.turned, 1.0) * reading.units
    energy = np.maximum((effort**2 * used).sum(axis=0), np.finfo(float).tiny)
    weight = used / np.sqrt(energy)
    basis = _orthonormal((columns * weight[:, :, None]).reshape(effort.size, -1))
    speed = excerpt.motion.dq[:, reading.order] * reading.factor
    against_friction = np.where(signed, effort, np.sign(speed) * np.abs(effort))
    starts, odd = [effort * weight, against_friction * weight], reading.units != 1.0
    if odd.any():  # the signs that were found are those of the given units: what the other joints tell
        starts += [_settled(basis, start, signed, ~odd)[0] for start in starts]
    residuals = [np.subtract(*_settled(basis, start, signed, np.ones_like(odd))) for start in starts]
    best = min(residuals, key=np.linalg.norm)
    recorded = np.argsort(order)
    return _Left(best[:, recorded], used[:, recorded], basis.shape[1])


def _orthonormal(columns: Array) -> Array:
    """(R, r) an orthonormal basis of columns (R, c) of any length, by a Cholesky decomposition with pivots."""
    gram = columns.T @ columns
    lengths = np.sqrt(np.diag(gram))
    shown = np.flatnonzero(lengths > _BLIND * lengths.max())
    factor, pivots, rank, _ = dpstrf(gram[np.ix_(shown, shown)] / np.outer(lengths[shown], lengths[shown]), tol=_BLIND)
    chosen = shown[pivots[:rank] - 1]
    basis: Array = columns[:, chosen] @ (np.triu(dtrtri(factor[:rank, :rank])[0]) / lengths[chosen][:, None])
    return basis


def _settled(basis: Array, effort: Array, signed: Mask, believed: Mask) -> tuple[Array, Array]:
    """(N, n) efforts whose unknown signs follow the prediction, and the prediction, fitted to the joints believed."""
    inverse = None
    if not believed.all():
        rows = basis[np.broadcast_to(believed, effort.shape).ravel()]
        inverse = np.linalg.pinv(rows.T @ rows, rcond=_BLIND, hermitian=True)
    for _ in range(TUNING.reading_rounds):
        shares = basis.T @ (effort * believed).ravel()
        predicted = (basis @ (shares if inverse is None else inverse @ shares)).reshape(effort.shape)
        followed = np.where(signed, effort, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(effort))
        if np.array_equal(followed, effort):
            break
        effort = followed
    return effort, predicted


# Hypotheses
_Changes: TypeAlias = Iterator[tuple[str, dict[str, Any]]]
"""What is other, to follow on "with", and the fields of the reading that it changes."""


def _orders(robot: Robot) -> _Changes:
    n = robot.n_joints
    exchanged = {}
    for a, b in combinations(range(n), 2):
        exchanged[f"joints {a + 1} and {b + 1} exchanged"] = order = np.arange(n)
        order[[a, b]] = b, a
    if n > 3:  # else that is an exchange of two
        exchanged["the joints in reversed order"] = np.arange(n)[::-1]
    for change, order in exchanged.items():
        yield change, {"order": order, "efforts": order}
    for change, order in exchanged.items():
        yield f"the efforts of {change}, and not their positions", {"efforts": order}


def _directions(robot: Robot) -> _Changes:
    n = robot.n_joints
    for which, turned in (*((f"joint {j + 1}", [j]) for j in range(n)), ("all joints", list(range(n)))):
        factor = np.ones(n)
        factor[turned] = -1.0
        yield f"{which} counted the other way", {"factor": factor, "turned": factor}
        yield f"the positions of {which} counted the other way, and not its efforts", {"factor": factor}


def _units(robot: Robot) -> _Changes:
    turning = np.array([not joint.prismatic for joint in robot.joints])
    for factor, change in ((_DEGREE, "in degrees, not rad"), (1.0 / _DEGREE, "in rad, not degrees")):
        yield f"positions {change}", {"factor": np.where(turning, factor, 1.0)}
    for factor, change in ((1e-3, "in mm, not m"), (1e3, "in m, not mm")):
        joints = tuple(
            replace(j, placement=_longer(j.placement, factor), link_frame=_longer(j.link_frame, factor))
            for j in robot.joints
        )
        yield f"the robot's lengths {change}", {"robot": replace(robot, joints=joints)}


def _units_of_one(robot: Robot) -> _Changes:
    """One joint in other units than the rest."""
    for j in [j for j, joint in enumerate(robot.joints) if not joint.prismatic and robot.n_joints > 1]:
        one = np.arange(robot.n_joints) == j
        for factor, change in ((1e-3, "N mm, not N m"), (1e3, "kN m, not N m")):
            yield f"the efforts of joint {j + 1} alone in {change}", {"units": np.where(one, factor, 1.0)}
        for factor, change in ((_DEGREE, "degrees, not rad"), (1.0 / _DEGREE, "rad, not degrees")):
            yield f"the positions of joint {j + 1} alone in {change}", {"factor": np.where(one, factor, 1.0)}


def _longer(frame: Array, factor: float) -> Array:
    frame = np.array(frame)
    frame[:3, 3] *= factor
    return frame


def _mountings(robot: Robot) -> _Changes:
    size = float(np.linalg.norm(robot.gravity)) or 9.81
    for axis, sign in product(range(3), (1.0, -1.0)):
        gravity = sign * size * np.eye(3)[axis]
        if not np.allclose(gravity, robot.gravity):
            along = f"{'+' if sign > 0.0 else '-'}{'xyz'[axis]}"
            yield f"gravity along {along} of the base", {"robot": replace(robot, gravity=gravity)}


def _other_robots(robot: Robot) -> _Changes:
    for name, other in _built_in().items():
        if other.n_joints == robot.n_joints and not robot.same_kinematics(other):
            yield f"the built-in table of {name}", {"robot": other}
    rng = np.random.default_rng(0)
    for _ in range(TUNING.random_tables if robot.n_joints > 1 else 0):
        yield "a table drawn at random", {"robot": _random_table(robot, rng)}


@cache
def _built_in() -> dict[str, Robot]:
    """By name."""
    return {name: load_robot(name) for name in BUILT_IN}


def _random_table(robot: Robot, rng: np.random.Generator) -> Robot:
    """A robot of the same class: its first joint, as many joints, its lengths in another order, other twists."""
    lengths = np.linalg.norm(robot.link_ends[:, 1] - robot.link_ends[:, 0], axis=1)
    joints = [replace(robot.joints[0], link_frame=np.eye(4))]
    for joint, length in zip(robot.joints[1:], rng.permutation(lengths)[1:], strict=True):
        placement = np.eye(4)
        twist, zero = rng.choice(_QUARTERS), rng.choice(_QUARTERS)
        placement[:3, :3] = Rotation.from_euler("XZ", [twist, zero]).as_matrix()
        placement[rng.integers(3), 3] = rng.choice([1.0, -1.0]) * length
        joints.append(Joint(placement, np.array([0.0, 0.0, 1.0]), joint.prismatic, joint.parent))
    return replace(robot, joints=tuple(joints), lengths={})


_HYPOTHESES: tuple[tuple[str, Callable[[Robot], _Changes]], ...] = (
    ("joint order", _orders),
    ("direction", _directions),
    ("units", _units),
    ("units", _units_of_one),
    ("mounting", _mountings),
    ("robot", _other_robots),
)
"""Kinds of wrong readings, and how a log would have to be read; first those that are easily put right: of equal ones
the first counts."""
