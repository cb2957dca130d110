"""Whether a log is misread: hypotheses of what is wrong with it, before the search and once more after the fit.

A wrong robot file, joints in another order, efforts that hold no weight, or positions in the wrong unit leave a
residual that looks like any poor model's. What tells them apart is that something else fits: the log with two joints
exchanged, with one turned round, without gravity, with other units, another mounting; the table of another robot; or
even one that is drawn at random. Each hypothesis yields readings of the log (`bayesid.identification.readings`), which
are fitted as the given one is, by least squares with the standard terms on some hundred instants. If r and e_j are the
coefficients and relative residuals of the given reading and r', e_j' those of another, their Bayesian information
criteria differ by :eq:`reading-gain`::

    2 sum_j n_j ln(e_j / e_j') - (r' - r) ln(sum_j n_j),

n_j the effective samples by the reading that leaves less: what a wrong one leaves is no noise. A better reading must be
decisively so among all that were tried and, as no model is right and evidence grows with the log all the same, leave
clearly less. Before the search residuals are those of feasible parameters: efforts that count the other way explain as
much, but with friction that drives and weights that lift.
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
from bayesid.identification.readings import Excerpt, Fitted, Left, Reading, counts_of_least, drawn_bodies, gain_of
from bayesid.identification.tuning import TUNING
from bayesid.log.gains import Gains
from bayesid.regression.gains import likely_gains
from bayesid.regression.least_squares import Fit
from bayesid.regression.log_data import LogData
from bayesid.robot import BUILT_IN, Joint, Robot, load_robot
from bayesid.robot.load import CONTROLLERS

_DECISIVE = np.log(1000.0)
"""Nats, for each reading being as likely beforehand as all others together: three times the digits of a decisive Bayes
factor (Jeffreys 1961, appendix B), for the finding is a red light."""
_BY_FEASIBILITY = "direction", "mounting"
"""Kinds of which least squares leave as much as of the given reading, but for what is feasible."""
_DEGREE = np.pi / 180.0
_QUARTERS = np.array([0.0, 0.5, 1.0, -0.5]) * np.pi
"""rad; angles of the twists and zeros of most arms."""


@dataclass(frozen=True)
class Misreading:
    """A reading that explains a log better than the one given."""

    kind: str  #: "joint order", "direction", "weight", "units", "zeros", "mounting", "robot", "motion" or "scale"
    change: str  #: what is other, to follow on "with"; of the last two kinds, what was seen
    leaves: float  #: RMS of what it leaves over RMS of the effort, over all joints
    given: float  #: the same of the reading given
    log10_odds: float = 0.0  #: against the given reading, all that were tried being as likely together
    remedy: str = ""  #: what mends it
    sure: bool = False  #: whether the given reading is beyond doubt a wrong one, which no search need be made for

    @property
    def said(self) -> str:
        """What was seen, as a sentence."""
        if self.kind in ("motion", "scale"):
            return self.change
        left = f"leaves {self.leaves:.1%} of the RMS effort, all joints together, instead of {self.given:.1%}"
        return f"with {self.change} the model {left}"

    @property
    def told(self) -> str:
        """The same with how much likelier it is than the log as given."""
        if not self.log10_odds:  # earlier results have none
            return self.said
        odds = "more than 1e6" if self.log10_odds > 6.0 else f"{10.0**self.log10_odds:.0e}".replace("e+0", "e")
        return f"{self.said}; this reading is {odds} times as likely as the log as given"


def _misreading(reading: Reading, leaves: float, given: float, nats: float, sure: bool = False) -> Misreading:
    odds = float(nats / np.log(10.0))
    return Misreading(reading.kind, reading.change, leaves, given, odds, _remedy(reading), sure)


_TRIED_BY = {
    "joint order": "move one joint alone and see which columns change",
    "direction": "move that joint alone towards plus and see whether its position rises",
    "zeros": "compare a pose on the controller's display with the log",
    "mounting": "look which way the base is mounted",
    "weight": "see whether efforts are near zero where the arm is held out at rest",
    "robot": "compare the type plate with the robot given",
}
"""How to see on the robot whether a kind of reading is right."""


def _remedy(reading: Reading) -> str:
    given = {"weight": "`gravity`=0,0,0"}.get(reading.kind, "")
    if reading.corrections:
        given = f"`correct` {reading.corrections}"
    elif reading.kind == "mounting":
        given = f"`gravity`={','.join(f'{g + 0.0:.6g}' for g in reading.robot.gravity)}"
    elif reading.kind == "robot" and reading.robot.origin is not None:
        given = f"`robot` {reading.robot.origin.source}"
    if given:
        how = _TRIED_BY.get(reading.kind, "compare positions and efforts with the controller's display")
        return f"{how}; if so, give {given}"
    remedies = {
        "units": "check the robot file for its units",
        "motion": "check that efforts are those of the drives, of the same time and robot as the positions",
    }
    return remedies.get(reading.kind, "check the robot file, and the order and directions of its joints")


# ---------------------------------------------------------------------------------------------------------------
# Before the search
# ---------------------------------------------------------------------------------------------------------------
def misread_before(log_data: LogData) -> Misreading | None:
    """The hypothesis that explains a log best before its signs are searched, if that is not the given reading."""
    return _misread_before(log_data) or _of_another_size(log_data)


class _Comparison:
    """Readings of some instants of a log, and the given one among them."""

    def __init__(self, log_data: LogData, instants: int) -> None:
        signals = log_data.signals
        self.excerpt = Excerpt.of(signals.motion, signals.effort, log_data.used, signals.signed, instants)
        as_given = Reading.as_given(log_data.model.robot)
        self.drawn = drawn_bodies(as_given, self.excerpt.motion, TUNING.drawn_robots)
        self._found: dict[tuple[object, ...], Array] = {}
        (given,) = self.fits([as_given])
        self.given = given.polished() if given.left.share.max() > TUNING.early_suspicious else given

    @property
    def hardly_feasible(self) -> bool:
        """Whether feasible parameters leave clearly more of the given reading than least squares."""
        return self.given.feasible.rms >= TUNING.hardly_feasible * self.given.left.rms

    def fits(self, readings: Sequence[Reading]) -> list[EarlyFit]:
        return [EarlyFit.of(fitted, self.drawn, self._found) for fitted in _fitted(readings, self.excerpt)]


def _misread_before(log_data: LogData) -> Misreading | None:
    if not log_data.used.any(axis=0).all():
        return None
    early = _Comparison(log_data, TUNING.early_instants)
    given = early.given
    if given.left.share.max() <= TUNING.early_suspicious and not early.hardly_feasible:
        return None
    readings = list(_told_apart(_all_readings(given.fitted.reading, EARLY), early.excerpt))
    tried = early.fits(readings)
    first = min(tried, key=lambda one: one.score).fitted.reading
    if first.kind == "zeros":  # links that stretch out upright in one table and level in the other: two zeros
        pairs = list(_told_apart(_all_readings(first, (_ZEROS,)), early.excerpt))
        both = early.fits(pairs)
        readings += pairs
        tried += [one for one in both if one.score < min(tried, key=lambda one: one.score).score - TUNING.early_fall]
    best = min(tried, key=lambda one: one.score)
    tried = [one.begun(best) for one in tried]
    finalists = [one.refined() for one in _least(tried, TUNING.finalists)]
    if early.hardly_feasible:  # some leave as much by least squares, and are feasible
        least = TUNING.hardly_feasible * given.left.rms
        alike = [one for one in tried if one.fitted.reading.kind in _BY_FEASIBILITY and one.left.rms < least]
        finalists += [one for one in alike if all(one.fitted.reading is not of.fitted.reading for of in finalists)]
    found = _best(given, finalists, len(readings))
    if found is None:
        return _unrelated(given, early.drawn)
    later = _Comparison(log_data, TUNING.instants)  # with few instants the given reading may be stuck at wrong signs
    again = [one.refined() for one in later.fits([found[0]])]
    confirmed = _best(later.given, again, len(readings))
    return None if confirmed is None else confirmed[1]


def _least(tried: Sequence[EarlyFit], count: int) -> list[EarlyFit]:
    """Those that leave least, as many as asked for, in the order of the hypotheses."""
    chosen = sorted(range(len(tried)), key=lambda k: tried[k].score)[:count]
    return [tried[k] for k in sorted(chosen)]


def _best(given: EarlyFit, finalists: Sequence[EarlyFit], tried: int) -> tuple[Reading, Misreading] | None:
    for one in finalists:  # signs that suit another reading may be what the given one was not found with
        given = given.begun(one)
    known, lefts = given.feasible, [one.feasible for one in finalists]
    count = counts_of_least([known, *lefts])
    nats = [0.5 * gain_of(known, left, count) - float(np.log(tried)) for left in lefts]
    first = next(k for k in range(len(nats)) if nats[k] >= max(nats) - _DECISIVE)
    one, left = finalists[first], lefts[first]
    falls = [np.log(known.share / left.share), np.log(given.left.share / one.left.share)]
    if left.rms < TUNING.feasibly_better * known.rms and one.fitted.reading.kind in _BY_FEASIBILITY:
        falls = falls[:1]
    fall, rise = min(float(each.sum()) for each in falls), -min(float(each.min()) for each in falls)
    if nats[first] <= _DECISIVE or fall < TUNING.early_fall or rise > TUNING.early_rise:
        return None
    sure = nats[first] > TUNING.sure_nats and fall > TUNING.sure_fall
    reading = one.fitted.reading
    return reading, _misreading(reading, left.rms, known.rms, nats[first], sure)


def _unrelated(given: EarlyFit, drawn: Array) -> Misreading | None:
    """Efforts that the motion explains no better than it explains those of another time."""
    excerpt, lefts = given.fitted.excerpt, []
    if given.left.rms < TUNING.hardly_related:
        return None
    for k in (1, 2, 3):
        shifted = excerpt._replace(effort=np.roll(excerpt.effort, k * len(excerpt.effort) // 4, axis=0))
        lefts.append(EarlyFit.of(Fitted(given.fitted.reading, shifted, given.fitted.columns), drawn, {}).left)
    null = min(lefts, key=rms_of)
    if given.left.rms < TUNING.related * null.rms or (given.left.share < TUNING.joint_related * null.share).any():
        return None
    said = (
        f"efforts do not follow from the motion: the model leaves {given.left.rms:.0%}, at another time {null.rms:.0%}"
    )
    reading = replace(given.fitted.reading, kind="motion", change=said)
    return _misreading(reading, null.rms, given.left.rms, _DECISIVE, sure=True)


def _of_another_size(log_data: LogData) -> Misreading | None:
    """Efforts that are far from those of an arm of its reach, or of the other joints: in another unit, or of motors."""
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
    said = f"{whose} are some {10.0**power:g} times as large as those of an arm of its reach"
    remedy = f"say their unit in the header, as in {name if name != 'tau' else 'tau1'}[N mm], or give their `gains`"
    if abs(power) == 3:
        remedy += f", or `correct` {name}={10.0**-power:g}*{name}"
    odds = 0.5 * (abs(factor) / TUNING.size_sd) ** 2 / np.log(10.0)
    sure = name != "tau" and abs(factor) > TUNING.surely_another_size
    return Misreading("scale", said, 0.0, 0.0, float(odds), remedy, sure)


def _told_apart(readings: Iterable[Reading], excerpt: Excerpt) -> Iterator[Reading]:
    """Readings whose positions a robot may have, no two the same but for unknown signs."""
    seen, farthest = set(), np.abs(excerpt.motion.q).max(axis=0)
    for reading in readings:
        turned = np.where(excerpt.signed[reading.efforts], reading.turned, 1.0)
        key = (*reading.key, reading.efforts.tobytes(), reading.units.tobytes(), turned.tobytes())
        read, size = farthest[reading.order], np.abs(reading.factor)
        many, few = (size > 1.0) & (read * size > 4.0 * np.pi), (size < 1.0) & (read < 1.0)  # turns; a degree
        if key not in seen and not (many | few).any():
            seen.add(key)
            yield reading


# ---------------------------------------------------------------------------------------------------------------
# After the fit
# ---------------------------------------------------------------------------------------------------------------
def misread_after(log_data: LogData, fit: Fit, probability: Array) -> Misreading | None:
    """The reading that explains a log better than the given one, where the fit is a reason to look for one."""
    if fit.relative_residual.max() <= TUNING.suspicious or not log_data.used.any(axis=0).all():
        return None  # a joint whose efforts are all in fault cannot be compared with another
    return better_reading(log_data, np.where(probability >= 0.5, 1.0, -1.0), fit.residual.autocorrelation)


def better_reading(log_data: LogData, signs: Array, time: Array) -> Misreading | None:
    """The reading that explains a log best, if that is not the given one; deterministic.

    Args:
        log_data: the robot and the log.
        signs: (N, n) of the efforts, as they were found.
        time: (n,) samples that count as one.
    """
    signals, used, robot = log_data.signals, log_data.used, log_data.model.robot
    effort = np.where(signals.signed, signals.effort, signs * np.abs(signals.effort))
    excerpt = Excerpt.of(signals.motion, effort, used, signals.signed, TUNING.instants)
    readings = list(_all_readings(Reading.as_given(robot), HYPOTHESES))
    given, *left = (_settled(fitted) for fitted in _fitted([Reading.as_given(robot), *readings], excerpt))
    count = counts_of_least([given, *left], np.maximum(used.sum(axis=0) / time, 1.0))
    best, found = _DECISIVE + np.log(len(readings)), None
    for reading, other in zip(readings, left, strict=True):
        nats = 0.5 * gain_of(given, other, count)
        clearly = other.rms < TUNING.clearly_better * given.rms
        if reading.of_one_joint:
            clearly |= other.rms < given.rms and bool((other.share < TUNING.one_joint_better * given.share).any())
        if nats > best and clearly:
            best, found = nats, _misreading(reading, other.rms, given.rms, nats - float(np.log(len(readings))))
    if found is None or found.kind != "robot":
        return found
    most = found.leaves / TUNING.clearly_better
    alike = [one.change for one, other in zip(readings, left, strict=True) if one.kind == "robot" and other.rms < most]
    also = ", ".join(change.removeprefix(_TABLE_OF) for change in alike if change not in (found.change, _RANDOM))
    return replace(found, change=f"{found.change} (about as well: {also})") if also else found


def _settled(fitted: Fitted) -> Left:
    """From the signs that were found, and from those that friction would have."""
    starts, odd = [fitted.effort, fitted.against_friction], fitted.reading.units != 1.0
    if odd.any():  # the signs that were found are those of the given units: what the other joints tell
        starts += [fitted.in_turn(start, ~odd) for start in starts]
    return fitted.left(starts)


def _fitted(readings: Sequence[Reading], excerpt: Excerpt) -> Iterator[Fitted]:
    """Each reading with its columns; those with the same share them, one after another."""
    columns: dict[tuple[int, bytes, bytes, bytes], Array] = {}
    for reading in readings:
        if reading.key not in columns:
            columns = {reading.key: reading.columns(excerpt.motion)}
        yield Fitted(reading, excerpt, columns[reading.key])


# ---------------------------------------------------------------------------------------------------------------
# Hypotheses
# ---------------------------------------------------------------------------------------------------------------
_Changes: TypeAlias = Iterator[tuple[str, dict[str, Any]]]
"""What is other, to follow on "with", and the fields of the reading that it changes."""


class Hypothesis(NamedTuple):
    """What may be wrong with a log."""

    kind: str
    looks: Callable[[Robot], _Changes]  # how the log would have to be read


def _all_readings(of: Reading, hypotheses: Sequence[Hypothesis]) -> Iterator[Reading]:
    """Those that differ from a reading by one hypothesis; a second zero adds to the first."""
    for kind, looks in hypotheses:
        for change, other in looks(of.robot):
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
    for change, order in exchanged.items():
        yield change, {"order": order, "efforts": order}
    for change, order in exchanged.items():
        yield f"the efforts of {change}, and not their positions", {"efforts": order}


def _directions(robot: Robot) -> _Changes:
    n = robot.n_joints
    each = [(f"joint {j + 1}", np.where(np.arange(n) == j, -1.0, 1.0)) for j in range(n)]
    for which, factor in (*each, ("all joints", np.full(n, -1.0))):
        yield f"{which} counted the other way", {"factor": factor, "turned": factor}
        yield f"the positions of {which} counted the other way, and not its efforts", {"factor": factor}
        yield f"the efforts of {which} counted the other way, and not its positions", {"turned": factor}


def _no_weight(robot: Robot) -> _Changes:
    if robot.gravity.any():
        yield "efforts that hold no weight", {"robot": replace(robot, gravity=np.zeros(3))}


def _units(robot: Robot) -> _Changes:
    turning = np.array([not joint.prismatic for joint in robot.joints])
    for factor, change in ((_DEGREE, "in degrees, not rad"), (1.0 / _DEGREE, "in rad, not degrees")):
        yield f"positions {change}", {"factor": np.where(turning, factor, 1.0)}
    reach = float(np.linalg.norm(robot.link_ends[:, 1] - robot.link_ends[:, 0], axis=1).sum())
    for factor, change in ((1e-3, "in mm, not m"), (1e3, "in m, not mm")):
        if TUNING.reach[0] < reach < TUNING.reach[1]:
            break  # joints of a robot without lengths have little to do with each other, and explain nearly anything
        joints = tuple(
            replace(j, placement=_longer(j.placement, factor), link_frame=_longer(j.link_frame, factor))
            for j in robot.joints
        )
        yield f"the robot's lengths {change}", {"robot": replace(robot, joints=joints)}


def _units_of_one(robot: Robot) -> _Changes:
    """One joint in other units than the rest."""
    for j in [j for j, joint in enumerate(robot.joints) if not joint.prismatic and robot.n_joints > 1]:
        one = np.arange(robot.n_joints) == j
        for factor in (1e-3, 1e3, 1e-2, 1e2):
            yield in_units(j, factor), {"units": np.where(one, factor, 1.0)}
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


def _zeros(robot: Robot) -> _Changes:
    """Joints whose zero is a quarter or half a turn off."""
    turning = [
        j for j, joint in enumerate(robot.joints[:-1]) if not joint.prismatic
    ]  # the last one's shows in no effort
    for j, quarters in product(turning, (1.0, -1.0, 2.0)):
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
    """The same arm with its controller's zeros and directions, for a table with others, and the other way round."""
    for own, of_controller in CONTROLLERS.items():
        for given, other in ((own, of_controller), (of_controller, own)):
            if robot.same_kinematics(_built_in()[given]):
                yield f"{_TABLE_OF}{other}", {"robot": _built_in()[other]}


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


_ZEROS = Hypothesis("zeros", _zeros)
EARLY = (
    Hypothesis("joint order", _orders),
    Hypothesis("direction", _directions),
    Hypothesis("weight", _no_weight),
    Hypothesis("units", _units),
    Hypothesis("units", _units_of_one),
    Hypothesis("mounting", _mountings),
    _ZEROS,
    Hypothesis("robot", _controllers_table),
)
"""Kinds of wrong readings, and how a log would have to be read; first those that are easily put right: of equal ones
the first counts."""
HYPOTHESES = (*EARLY, Hypothesis("robot", _other_robots))
"""The same after the fit: what takes seconds, and no option mends."""
