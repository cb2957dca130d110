"""Input diagnosis: is the log or the robot file misread? Tested before the search and again after the fit.

Each hypothesis (joints exchanged, a direction reversed, wrong units, no gravity, another mounting, another robot)
yields readings of the log (`bayesid.identification.readings`). Each reading is fitted by least squares with the
standard terms on some hundred samples. If r and e_j are the number of coefficients and the relative residuals of the
given reading and r', e_j' those of another, their Bayesian information criteria differ by :eq:`reading-gain`::

    2 sum_j n_j ln(e_j / e_j') - (r' - r) ln(sum_j n_j),

n_j the effective samples by the reading with the smaller residual. A better reading must have decisive odds and a
clearly smaller residual: no model is exact, so odds alone grow with the length of the log. Before the search residuals
are those of feasible parameters. Least squares alone does not detect reversed efforts, as negative friction and mass
fit them equally well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.arrays import Array
from bayesid.identification.early_fits import EarlyFit, in_units, rms_of
from bayesid.identification.readings import (
    Excerpt,
    Fitted,
    Reading,
    ReadingResidual,
    bic_gain,
    counts_of_least,
    drawn_bodies,
)
from bayesid.identification.tuning import TUNING
from bayesid.log.gains import Gains
from bayesid.number_text import percent
from bayesid.regression.gains import likely_gains
from bayesid.regression.least_squares import Fit
from bayesid.regression.log_data import LogData
from bayesid.robot import BUILT_IN, Joint, Robot, load_robot
from bayesid.robot.load import CONTROLLERS

_DECISIVE = np.log(1000.0)
"""Nats: odds of 1000. A Bayes factor above 100 is decisive (Jeffreys 1961, appendix B); a check with the verdict `bad`
needs more."""
_BY_FEASIBILITY = "direction", "mounting"
"""Kinds that differ from the given reading by the feasibility of the parameters alone."""
_DEGREE = np.pi / 180.0
_QUARTERS = np.array([0.0, 0.5, 1.0, -0.5]) * np.pi
"""rad; angles of the twists and zeros of most arms."""


@dataclass(frozen=True)
class Misreading:
    """A reading that explains a log better than the given one."""

    kind: str  #: "joint order", "direction", "no gravity", "units", "zeros", "mounting", "robot", "motion" or "scale"
    change: str  #: the change, to follow "with"; for "motion" and "scale" a sentence
    leaves: float  #: its relative residual over all joints
    given: float  #: that of the given reading
    log10_odds: float = 0.0  #: against the given reading, which has prior probability 1/2
    remedy: str = ""  #: what to do
    sure: bool = False  #: whether the evidence suffices to refuse the log before the search

    @property
    def message(self) -> str:
        """What was seen, as a sentence."""
        if self.kind in ("motion", "scale"):
            return self.change
        leaves, given = percent(self.leaves, 1), percent(self.given, 1)
        return f"with {self.change} the relative residual is {leaves} of the RMS effort instead of {given}"

    @property
    def message_with_odds(self) -> str:
        """`message`, and the odds against the given reading."""
        if not self.log10_odds:  # results of earlier versions have none
            return self.message
        odds = "more than 1e6" if self.log10_odds > 6.0 else f"{10.0**self.log10_odds:.0e}".replace("e+0", "e")
        return f"{self.message}; this reading is {odds} times as likely as the given one"


def _misreading(reading: Reading, leaves: float, given: float, nats: float, sure: bool = False) -> Misreading:
    odds = float(nats / np.log(10.0))
    return Misreading(reading.kind, reading.change, leaves, given, odds, _remedy(reading), sure)


_TRIED_BY = {
    "joint order": "move one joint alone and see which columns change",
    "direction": "move that joint alone towards plus and see whether its position rises",
    "zeros": "compare a pose on the controller's display with the log",
    "mounting": "check how the base is mounted",
    "no gravity": "check whether efforts are near zero while the arm is stretched out at rest",
    "robot": "compare the type plate with the given robot",
}
"""How to check each kind of reading on the robot."""


def _remedy(reading: Reading) -> str:
    given = {"no gravity": "`gravity`=0,0,0"}.get(reading.kind, "")
    if reading.corrections:
        given = f"`correct` {reading.corrections}"
    elif reading.kind == "mounting":
        given = f"`gravity`={','.join(f'{g + 0.0:.6g}' for g in reading.robot.gravity)}"
    elif reading.kind == "robot" and reading.robot.origin is not None:
        given = f"`robot` {reading.robot.origin.source}"
    if given:
        how = _TRIED_BY.get(reading.kind, "compare positions and efforts with the controller's display")
        both = " (a joint that flips also flips its torque)" if reading.kind == "direction" and "q" in given else ""
        return f"{how}; if so, give {given}{both}"
    remedies = {
        "units": "check the units of the robot file",
        "motion": "check that efforts are those of the drives, and from the same recording as the positions",
    }
    return remedies.get(reading.kind, "check the robot file, and the order and directions of its joints")


# ---------------------------------------------------------------------------------------------------------------
# Before the search
# ---------------------------------------------------------------------------------------------------------------
def misread_before(log_data: LogData) -> Misreading | None:
    """The best reading before the sign search; None if it is the given one."""
    return _misread_before(log_data) or _of_another_size(log_data)


class _Comparison:
    """Fits of readings to an excerpt of a log, with that of the given reading."""

    def __init__(self, log_data: LogData, instants: int) -> None:
        signals = log_data.signals
        self.excerpt = Excerpt.of(signals.motion, signals.effort, log_data.used, signals.signed, instants)
        as_given = Reading.as_given(log_data.model.robot)
        self.drawn = drawn_bodies(as_given, self.excerpt.motion, TUNING.drawn_robots)
        self._found: dict[tuple[object, ...], Array] = {}
        (given,) = self.fits([as_given])
        self.given = given.with_signs_restarted() if given.residual.share.max() > TUNING.early_suspicious else given

    @property
    def barely_feasible(self) -> bool:
        """Whether feasible parameters fit the given reading clearly worse than least squares."""
        return self.given.feasible_residual.rms >= TUNING.barely_feasible * self.given.residual.rms

    def fits(self, readings: Sequence[Reading]) -> list[EarlyFit]:
        return [EarlyFit.of(fitted, self.drawn, self._found) for fitted in _fitted(readings, self.excerpt)]


def _misread_before(log_data: LogData) -> Misreading | None:
    if not log_data.used.any(axis=0).all():
        return None
    early = _Comparison(log_data, TUNING.early_instants)
    given = early.given
    if given.residual.share.max() <= TUNING.early_suspicious and not early.barely_feasible:
        return None
    readings = list(_distinct(_all_readings(given.fitted.reading, EARLY), early.excerpt))
    tried = early.fits(readings)
    first = min(tried, key=lambda fit: fit.score).fitted.reading
    if first.kind == "zeros":  # tables may differ by two zeros: all links upright in one, horizontal in the other
        pairs = list(_distinct(_all_readings(first, (_ZEROS,)), early.excerpt))
        both = early.fits(pairs)
        readings += pairs
        tried += [fit for fit in both if fit.score < min(tried, key=lambda fit: fit.score).score - TUNING.early_fall]
    best = min(tried, key=lambda fit: fit.score)
    tried = [fit.with_starts_of(best) for fit in tried]
    finalists = [fit.final_fit() for fit in _least(tried, TUNING.finalists)]
    if early.barely_feasible:  # readings with the same least-squares residual may be feasible
        least = TUNING.barely_feasible * given.residual.rms
        alike = [fit for fit in tried if fit.fitted.reading.kind in _BY_FEASIBILITY and fit.residual.rms < least]
        finalists += [fit for fit in alike if all(fit.fitted.reading is not of.fitted.reading for of in finalists)]
    found = _best(given, finalists, len(readings))
    if found is None:
        return _unrelated(given, early.drawn)
    later = _Comparison(log_data, TUNING.instants)  # few samples may leave the given reading at wrong signs
    again = [fit.final_fit() for fit in later.fits([found[0]])]
    confirmed = _best(later.given, again, len(readings))
    return None if confirmed is None else confirmed[1]


def _least(tried: Sequence[EarlyFit], count: int) -> list[EarlyFit]:
    """The `count` fits with the smallest score, in the order of the hypotheses."""
    chosen = sorted(range(len(tried)), key=lambda k: tried[k].score)[:count]
    return [tried[k] for k in sorted(chosen)]


def _best(given: EarlyFit, finalists: Sequence[EarlyFit], tried: int) -> tuple[Reading, Misreading] | None:
    for other in finalists:  # their signs may fit the given reading better than its own
        given = given.with_starts_of(other)
    known, residuals = given.feasible_residual, [other.feasible_residual for other in finalists]
    count = counts_of_least([known, *residuals])
    nats = [0.5 * bic_gain(known, residual, count) - float(np.log(tried)) for residual in residuals]
    first = next(k for k in range(len(nats)) if nats[k] >= max(nats) - _DECISIVE)
    best, residual = finalists[first], residuals[first]
    falls = [np.log(known.share / residual.share), np.log(given.residual.share / best.residual.share)]
    if residual.rms < TUNING.feasibly_better * known.rms and best.fitted.reading.kind in _BY_FEASIBILITY:
        falls = falls[:1]
    fall, rise = min(float(each.sum()) for each in falls), -min(float(each.min()) for each in falls)
    if nats[first] <= _DECISIVE or fall < TUNING.early_fall or rise > TUNING.early_rise:
        return None
    sure = nats[first] > TUNING.sure_nats and fall > TUNING.sure_fall
    reading = best.fitted.reading
    return reading, _misreading(reading, residual.rms, known.rms, nats[first], sure)


def _unrelated(given: EarlyFit, drawn: Array) -> Misreading | None:
    """Whether the motion explains the efforts no better than efforts shifted in time."""
    excerpt, residuals = given.fitted.excerpt, []
    if given.residual.rms < TUNING.weakly_related:
        return None
    for k in (1, 2, 3):
        shifted = excerpt._replace(effort=np.roll(excerpt.effort, k * len(excerpt.effort) // 4, axis=0))
        residuals.append(EarlyFit.of(Fitted(given.fitted.reading, shifted, given.fitted.columns), drawn, {}).residual)
    null = min(residuals, key=rms_of)
    if (
        given.residual.rms < TUNING.related * null.rms
        or (given.residual.share < TUNING.joint_related * null.share).any()
    ):
        return None
    as_given, if_shifted = percent(given.residual.rms, 0), percent(null.rms, 0)
    seen = f"the relative residual is {as_given}, and {if_shifted} if they are shifted in time"
    reading = replace(given.fitted.reading, kind="motion", change=f"efforts do not depend on the motion: {seen}")
    return _misreading(reading, null.rms, given.residual.rms, _DECISIVE, sure=True)


def _of_another_size(log_data: LogData) -> Misreading | None:
    """Efforts of implausible size for an arm of this reach, or in one joint compared with the others."""
    n = log_data.model.robot.n_joints
    gains = Gains(np.ones(n), np.full(n, np.inf), of_torques=True)
    factors = np.log(likely_gains(log_data, gains))
    common = float(np.median(factors))
    joint = int(np.argmax(np.abs(factors - common)))
    factor, whose, name = common, "efforts", "tau"
    if abs(common) < TUNING.another_size:
        factor, whose, name = float(factors[joint] - common), f"efforts of joint {joint + 1}", f"tau{joint + 1}"
        if n < TUNING.joints_compared or abs(factor) < TUNING.another_size_of_one:
            return None
    power = round(-factor / np.log(10.0))
    seen = f"{whose} are about {10.0**power:g} times as large as expected for an arm of this reach"
    remedy = f"state their unit in the header, as in {name if name != 'tau' else 'tau1'}[N mm], or give their `gains`"
    if abs(power) == 3:
        remedy += f", or `correct` {name}={10.0**-power:g}*{name}"
    odds = 0.5 * (abs(factor) / TUNING.size_sd) ** 2 / np.log(10.0)
    sure = name != "tau" and abs(factor) > TUNING.surely_another_size
    return Misreading("scale", seen, 0.0, 0.0, float(odds), remedy, sure)


def _distinct(readings: Iterable[Reading], excerpt: Excerpt) -> Iterator[Reading]:
    """Readings with plausible positions; those that differ in unknown signs alone count once."""
    seen, farthest = set(), np.abs(excerpt.motion.q).max(axis=0)
    for reading in readings:
        flipped = np.where(excerpt.signed[reading.efforts], reading.effort_sign, 1.0)
        key = (*reading.key, reading.efforts.tobytes(), reading.units.tobytes(), flipped.tobytes())
        read, size = farthest[reading.order], np.abs(reading.factor)
        too_large = (size > 1.0) & (read * size > 4.0 * np.pi)  # more than two turns
        too_small = (size < 1.0) & (read < 1.0)  # less than a degree
        if key not in seen and not (too_large | too_small).any():
            seen.add(key)
            yield reading


# ---------------------------------------------------------------------------------------------------------------
# After the fit
# ---------------------------------------------------------------------------------------------------------------
def misread_after(log_data: LogData, fit: Fit, probability: Array) -> Misreading | None:
    """A better reading than the given one, if the residual of the fit is large."""
    if fit.relative_residual.max() <= TUNING.suspicious or not log_data.used.any(axis=0).all():
        return None  # joints without a usable effort cannot be compared
    return better_reading(log_data, np.where(probability >= 0.5, 1.0, -1.0), fit.residual.autocorrelation)


def better_reading(log_data: LogData, signs: Array, time: Array) -> Misreading | None:
    """The best reading of a log; None if it is the given one. Deterministic.

    Args:
        log_data: robot and log.
        signs: (N, n) signs of the efforts.
        time: (n,) residual correlation time, samples.
    """
    signals, used, robot = log_data.signals, log_data.used, log_data.model.robot
    effort = np.where(signals.signed, signals.effort, signs * np.abs(signals.effort))
    excerpt = Excerpt.of(signals.motion, effort, used, signals.signed, TUNING.instants)
    readings = list(_all_readings(Reading.as_given(robot), HYPOTHESES))
    given, *others = (_residual_of(fitted) for fitted in _fitted([Reading.as_given(robot), *readings], excerpt))
    count = counts_of_least([given, *others], np.maximum(used.sum(axis=0) / time, 1.0))
    best, found = _DECISIVE + np.log(len(readings)), None
    for reading, other in zip(readings, others, strict=True):
        nats = 0.5 * bic_gain(given, other, count)
        clearly = other.rms < TUNING.clearly_better * given.rms
        if reading.of_one_joint:
            clearly |= other.rms < given.rms and bool((other.share < TUNING.better_in_one_joint * given.share).any())
        if nats > best and clearly:
            best, found = nats, _misreading(reading, other.rms, given.rms, nats - float(np.log(len(readings))))
    if found is None or found.kind != "robot":
        return found
    most = found.leaves / TUNING.clearly_better
    pairs = zip(readings, others, strict=True)
    alike = [reading.change for reading, other in pairs if reading.kind == "robot" and other.rms < most]
    also = ", ".join(change.removeprefix(_TABLE_OF) for change in alike if change not in (found.change, _RANDOM))
    return replace(found, change=f"{found.change} (about as well: {also})") if also else found


def _residual_of(fitted: Fitted) -> ReadingResidual:
    """Residual with signs that start from the identified ones and from those of the velocities."""
    starts, odd = [fitted.effort, fitted.against_friction], fitted.reading.units != 1.0
    if odd.any():  # the identified signs belong to the given units: start from the fit to the other joints too
        starts += [fitted.signs_from(start, ~odd) for start in starts]
    return fitted.residual(starts)


def _fitted(readings: Sequence[Reading], excerpt: Excerpt) -> Iterator[Fitted]:
    """Each reading with its columns; consecutive readings with equal columns share them."""
    columns: dict[tuple[int, bytes, bytes, bytes], Array] = {}
    for reading in readings:
        if reading.key not in columns:
            columns = {reading.key: reading.columns(excerpt.motion)}
        yield Fitted(reading, excerpt, columns[reading.key])


# ---------------------------------------------------------------------------------------------------------------
# Hypotheses
# ---------------------------------------------------------------------------------------------------------------
_Changes: TypeAlias = Iterator[tuple[str, dict[str, Any]]]
"""Words for the change, to follow "with", and the changed fields of the reading."""


class ReadingHypothesis(NamedTuple):
    """A kind of misreading and the changes that correct it."""

    kind: str
    changes: Callable[[Robot], _Changes]


def _all_readings(of: Reading, hypotheses: Sequence[ReadingHypothesis]) -> Iterator[Reading]:
    """Readings that differ from one by a single change; a second zero adds to the first."""
    for kind, changes in hypotheses:
        for change, other in changes(of.robot):
            if of.kind:
                change, other = f"{of.change} and {change}", {"zero": of.zero + other["zero"]}
            yield replace(of, kind=kind, change=change, **other)


def _orders(robot: Robot) -> _Changes:
    n = robot.n_joints
    exchanged = {}
    for a, b in combinations(range(n), 2):
        exchanged[f"joints {a + 1} and {b + 1} exchanged"] = order = np.arange(n)
        order[[a, b]] = b, a
    if n > 3:  # else that is an exchange of two
        exchanged["the joints in reversed order"] = np.arange(n)[::-1]
    for change, order in exchanged.items():  # of equal columns: one after the other
        yield change, {"order": order, "efforts": order}
        yield f"the positions of {change}, not their efforts", {"order": order}
    for change, order in exchanged.items():
        yield f"the efforts of {change}, not their positions", {"efforts": order}


def _directions(robot: Robot) -> _Changes:
    n = robot.n_joints
    each = [(f"joint {j + 1}", np.where(np.arange(n) == j, -1.0, 1.0)) for j in range(n)]
    for which, factor in (*each, ("all joints", np.full(n, -1.0))):
        yield f"{which} reversed", {"factor": factor, "effort_sign": factor}
        yield f"the positions of {which} reversed, not the efforts", {"factor": factor}
        yield f"the efforts of {which} reversed, not the positions", {"effort_sign": factor}


def _no_gravity(robot: Robot) -> _Changes:
    if robot.gravity.any():
        yield "efforts without gravity", {"robot": replace(robot, gravity=np.zeros(3))}


def _units(robot: Robot) -> _Changes:
    turning = np.array([not joint.prismatic for joint in robot.joints])
    for factor, change in ((_DEGREE, "in degrees, not rad"), (1.0 / _DEGREE, "in rad, not degrees")):
        yield f"positions {change}", {"factor": np.where(turning, factor, 1.0)}
    reach = float(np.linalg.norm(robot.link_ends[:, 1] - robot.link_ends[:, 0], axis=1).sum())
    for factor, change in ((1e-3, "in mm, not m"), (1e3, "in m, not mm")):
        if TUNING.reach[0] < reach < TUNING.reach[1]:
            break  # without lengths the joints are almost uncoupled, and the model fits almost any log
        joints = tuple(
            replace(j, placement=_longer(j.placement, factor), link_frame=_longer(j.link_frame, factor))
            for j in robot.joints
        )
        yield f"the robot's lengths {change}", {"robot": replace(robot, joints=joints)}


def _units_of_one(robot: Robot) -> _Changes:
    for j in [j for j, joint in enumerate(robot.joints) if not joint.prismatic and robot.n_joints > 1]:
        at_joint = np.arange(robot.n_joints) == j
        for factor in (1e-3, 1e3, 1e-2, 1e2):
            yield in_units(j, factor), {"units": np.where(at_joint, factor, 1.0)}
        for factor, change in ((_DEGREE, "degrees, not rad"), (1.0 / _DEGREE, "rad, not degrees")):
            yield f"the positions of joint {j + 1} alone in {change}", {"factor": np.where(at_joint, factor, 1.0)}


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


def _zeros(robot: Robot) -> _Changes:
    """One joint's zero is wrong by a quarter or half a turn; that of the last joint acts on no effort."""
    revolute = [j for j, joint in enumerate(robot.joints[:-1]) if not joint.prismatic]
    for j, quarters in product(revolute, (1.0, -1.0, 2.0)):
        zero = np.where(np.arange(robot.n_joints) == j, 0.5 * np.pi * quarters, 0.0)
        yield f"the zero of joint {j + 1} at {90.0 * quarters:.0f} degrees", {"zero": zero}


_TABLE_OF, _RANDOM = "the built-in table of ", "a table drawn at random"


def _other_robots(robot: Robot) -> _Changes:
    for name, other in _built_in().items():
        if other.n_joints == robot.n_joints and not robot.same_kinematics(other):
            yield f"{_TABLE_OF}{name}", {"robot": other}
    rng = np.random.default_rng(0)
    for _ in range(TUNING.random_tables if robot.n_joints > 1 else 0):
        yield _RANDOM, {"robot": _random_table(robot, rng)}


def _controllers_table(robot: Robot) -> _Changes:
    """The built-in table of the same arm with the zeros and directions of its controller, or without them."""
    for plain, of_controller in CONTROLLERS.items():
        for given, other in ((plain, of_controller), (of_controller, plain)):
            if robot.same_kinematics(_built_in()[given]):
                yield f"{_TABLE_OF}{other}", {"robot": _built_in()[other]}


@cache
def _built_in() -> dict[str, Robot]:
    return {name: load_robot(name) for name in BUILT_IN}


def _random_table(robot: Robot, rng: np.random.Generator) -> Robot:
    """A robot with the same first joint, number of joints and lengths (in another order), but other twists."""
    lengths = np.linalg.norm(robot.link_ends[:, 1] - robot.link_ends[:, 0], axis=1)
    joints = [replace(robot.joints[0], link_frame=np.eye(4))]
    for joint, length in zip(robot.joints[1:], rng.permutation(lengths)[1:], strict=True):
        placement = np.eye(4)
        twist, zero = rng.choice(_QUARTERS), rng.choice(_QUARTERS)
        placement[:3, :3] = Rotation.from_euler("XZ", [twist, zero]).as_matrix()
        placement[rng.integers(3), 3] = rng.choice([1.0, -1.0]) * length
        joints.append(Joint(placement, np.array([0.0, 0.0, 1.0]), joint.prismatic, joint.parent))
    return replace(robot, joints=tuple(joints), lengths={})


_ZEROS = ReadingHypothesis("zeros", _zeros)
EARLY = (
    ReadingHypothesis("joint order", _orders),
    ReadingHypothesis("direction", _directions),
    ReadingHypothesis("no gravity", _no_gravity),
    ReadingHypothesis("units", _units),
    ReadingHypothesis("units", _units_of_one),
    ReadingHypothesis("mounting", _mountings),
    _ZEROS,
    ReadingHypothesis("robot", _controllers_table),
)
"""Hypotheses before the search, the easiest to correct first: among equal ones the first counts."""
HYPOTHESES = (*EARLY, ReadingHypothesis("robot", _other_robots))
"""Hypotheses after the fit; other robots take seconds."""
