"""Which pushes and changes of a running robot does a tracker detect? Simulated streams.

A robot with the standard friction and white noise of 3 % of each joint's RMS effort is identified from 20 s without
signs. Then another random motion of one minute is tracked, sample by sample, from |effort|. Scenarios: no event; pushes
of single joints by 15 to 40 % of their effort range for 0.2 s; a payload, more friction or another gain after 10 s. The
report gives right signs with and without a lag of 50 ms, false alarms, detected pushes with joint and delay, changes
named correctly, and the time of an update, in microseconds and in additions of two arrays of seven numbers. A push of
twice the effort only changes its sign: pushes that change |effort| by less than the threshold are counted as unseen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.pipeline import identify
from bayesid.monitor.changes import CONTACT, FRICTION, GAIN, PAYLOAD, Alarm
from bayesid.monitor.tracker import SignTracker, TrackedSample
from bayesid.motion import Motion
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.figures import Figure
from bayesid.studies.record import Row
from bayesid.studies.simulated import BUDGET, STRONG, make_robot
from bayesid.studies.study import Study, in_turn

_RATE, _SECONDS, _LEARNED = 100.0, 60.0, 20.0
"""Hz; s of the stream; s of the log from which the robot is identified."""
_PERIOD = 20.0
"""s, of the motions."""
_NOISE = 0.03
"""Of the efforts, relative to each joint's RMS effort."""
_PUSH, _LENGTH = (0.15, 0.4), 0.2
"""Sizes of pushes, as shares of the joint's largest effort; their length, s."""
_APART = (1.5, 2.5)
"""s from push to push."""
_CHANGED = 10.0
"""s, time of a change."""
_LAG = 0.05
"""s, delay of the smoothed signs."""
_ANOTHER = 3_000_000
"""Added to the seed for the motion of the stream."""
_WINDOW = 0.25
"""s from the begin of a push in which an alarm belongs to it."""
QUIET, PUSHES = "nothing", "pushes"
KINDS = (PAYLOAD, FRICTION, GAIN)


@dataclass(frozen=True)
class Scenario:
    """A stream.

    Attributes:
        robot: built-in name.
        happens: the event: "nothing", "pushes", or a kind of change.
    """

    robot: str
    happens: str


ROBOTS = ("panda", "ur10e", "kr5")
SCENARIOS = [Scenario(robot, happens) for happens in (QUIET, PUSHES, *KINDS) for robot in ROBOTS]


@dataclass(frozen=True)
class _Stream:
    """A motion, its efforts with and without the event, N m, and the pushes (time, joint, size)."""

    motion: Motion
    effort: Array
    usual: Array
    pushes: tuple[tuple[float, int, float], ...] = ()


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies a robot, and tracks it."""
    robot = make_robot(scenario.robot)
    n, rng = robot.n_joints, np.random.default_rng([seed, 7])
    learned = random_trajectory(n, _PERIOD, rng=seed).motion(np.arange(round(_LEARNED * _RATE)) / _RATE)
    model = Model(robot, make_terms(STANDARD, robot, learned))
    theta = random_parameters(model, rng=np.random.default_rng(seed))
    log = simulate(model, theta, learned, rng=rng, noise=_NOISE)
    search = Certified(budget=BUDGET)
    known = identify(robot, log, STANDARD, complete="off", search=search, posterior=False).identified
    time = np.arange(round(_SECONDS * _RATE)) / _RATE
    motion = random_trajectory(n, _PERIOD, rng=seed + _ANOTHER).motion(time)
    stream = _with(scenario.happens, model, theta, motion, rng)
    tracker, records, costs = _tracked(known, stream)
    late = _tracked(known, stream, _LAG)[1] if scenario.happens == QUIET else []
    return {
        "seconds": _SECONDS,
        "right": _right(records, stream),
        "right_late": _right(late, stream) if late else None,
        "other_alarms": _others(tracker.alarms, stream, scenario.happens),
        **_pushes(tracker.alarms, records, stream),
        **_change(tracker.alarms, scenario.happens),
        **costs,
    }


def _with(happens: str, model: Model, theta: Array, motion: Motion, rng: np.random.Generator) -> _Stream:
    """A stream with an event."""
    usual = model.effort(motion, theta)
    noise = _NOISE * np.sqrt((usual**2).mean(axis=0)) * rng.standard_normal(usual.shape)
    after = (motion.t >= _CHANGED)[:, None]
    if happens == PUSHES:
        return _pushed(motion, usual + noise, rng)
    changed, joint = theta.copy(), int(rng.integers(model.robot.n_joints))
    names = [parameter.name for parameter in model.parameters]
    if happens == PAYLOAD:
        last = model.cone.bodies[-1]
        changed[last] += rng.uniform(1.0, 3.0) * np.array([0.02, 0.0, 0.0, 0.02, 0.0, 0.01, 0.03, -0.02, 0.08, 1.0])
    elif happens == FRICTION:
        for symbol in ("Fc", "Fv"):
            changed[names.index(f"{symbol}{joint + 1}")] *= 2.0
    effort = np.where(after, model.effort(motion, changed), usual)
    if happens == GAIN:
        effort[:, joint] *= np.where(after[:, 0], rng.choice([0.6, 1.6]), 1.0)
    return _Stream(motion, effort + noise, usual)


def _pushed(motion: Motion, usual: Array, rng: np.random.Generator) -> _Stream:
    effort, pushes, start = usual.copy(), [], 2.0
    while start < motion.t[-1] - 2.0:
        joint = int(rng.integers(motion.n_joints))
        size = rng.uniform(*_PUSH) * rng.choice([-1.0, 1.0]) * np.abs(usual[:, joint]).max()
        during = (motion.t >= start) & (motion.t < start + _LENGTH)
        effort[during, joint] -= size
        pushes.append((start, joint, size))
        start += rng.uniform(*_APART)
    return _Stream(motion, effort, usual, tuple(pushes))


def _tracked(known: IdentifiedModel, stream: _Stream, lag: float = 0.0) -> tuple[SignTracker, list[TrackedSample], Row]:
    """The tracker, its records, and the times of updates."""
    tracker, records, seconds = SignTracker(known, _RATE, lag), [], []
    for t, q, effort in zip(stream.motion.t, stream.motion.q, np.abs(stream.effort), strict=True):
        began = perf_counter()
        records.append(tracker.update(t, q, effort))
        seconds.append(perf_counter() - began)
    array, began = np.ones(7), perf_counter()
    for _ in range(20_000):
        array + array  # a unit of time that depends on the machine as updates do
    addition = (perf_counter() - began) / 20_000
    median, slow = np.percentile(seconds, [50.0, 99.9])
    costs = {"median_us": 1e6 * median, "slow_us": 1e6 * slow, "additions": median / addition}
    return tracker, records, costs


def _right(records: Sequence[TrackedSample], stream: _Stream) -> float:
    """Share of the strong samples in motion whose sign is right."""
    at = np.searchsorted(stream.motion.t, [record.t - 1e-6 for record in records])
    strong: Mask = np.abs(stream.effort) >= STRONG * np.abs(stream.effort).max(axis=0)
    strong &= np.abs(stream.motion.dq) > stream.motion.standstill_speed
    used = strong[at]
    used[: round(0.25 * _RATE)] = False  # until the window of the motion is full
    plus = np.array([record.probability for record in records]) > 0.5
    return float((plus == (stream.effort[at] > 0.0))[used].mean())


def _of_push(alarms: Sequence[Alarm], start: float) -> Alarm | None:
    return next((a for a in alarms if a.kind == CONTACT and start <= a.time <= start + _WINDOW), None)


def _others(alarms: Sequence[Alarm], stream: _Stream, happens: str) -> int:
    """False alarms: before a change, or without a push."""
    of_pushes = [_of_push(alarms, start) for start, *_ in stream.pushes]
    return sum(a not in of_pushes and not (happens in KINDS and a.raised >= _CHANGED) for a in alarms)


def _pushes(alarms: Sequence[Alarm], records: Sequence[TrackedSample], stream: _Stream) -> Row:
    found, right, delays, unseen = 0, 0, [], 0
    for start, joint, _ in stream.pushes:
        alarm = _of_push(alarms, start)
        during = slice(round(start * _RATE), round((start + _LENGTH) * _RATE))
        seen = np.abs(np.abs(stream.effort[during, joint]) - np.abs(stream.usual[during, joint]))
        if alarm is None:
            unseen += bool(np.median(seen) < np.median([record.threshold[joint] for record in records[during]]))
        else:
            found, right = found + 1, right + (alarm.joint == joint + 1)
            delays.append(alarm.time - start)
    return {"pushes": len(stream.pushes), "found": found, "joint_right": right, "delays": delays, "unseen": unseen}


def _change(alarms: Sequence[Alarm], happens: str) -> Row:
    """Whether the first alarm after a change names it, and its delay, s."""
    if happens not in KINDS:
        return {"named": None, "delay": None}
    changes = [alarm for alarm in alarms if alarm.kind != CONTACT and alarm.raised >= _CHANGED]
    if not changes:
        return {"named": False, "delay": None}
    return {"named": changes[0].kind == happens, "delay": changes[0].raised - _CHANGED}


def report(rows: Sequence[Row]) -> str:
    """Signs, alarms, pushes, changes and the time of an update."""
    quiet = [row for row in rows if row["happens"] == QUIET]
    pushed = [row for row in rows if row["happens"] == PUSHES]
    lines = ["no event"]
    if quiet:
        late = np.mean([row["right_late"] for row in quiet])
        lines.append(
            f"  signs right {100 * np.mean([row['right'] for row in quiet]):.2f} %, "
            f"with a lag of 50 ms {100 * late:.2f} %; "
            f"{sum(row['other_alarms'] for row in quiet)} alarms in {sum(row['seconds'] for row in quiet) / 60:.0f} min"
        )
    if pushed:
        total, found = (sum(row[name] for row in pushed) for name in ("pushes", "found"))
        right, unseen = (sum(row[name] for row in pushed) for name in ("joint_right", "unseen"))
        delays = [delay for row in pushed for delay in row["delays"]]
        lines += [
            "pushes of 15 to 40 % of the range for 0.2 s",
            f"  {found} of {total} found ({100 * found / total:.1f} %), {unseen} of the others do not change |effort|; "
            f"joint right: {100 * right / max(found, 1):.1f} %",
            f"  median delay {1e3 * np.median(delays) if delays else np.nan:.0f} ms; "
            f"{sum(row['other_alarms'] for row in pushed)} other alarms",
        ]
    lines.append("change      streams  named       delay  alarms before")
    for kind in KINDS:
        some = [row for row in rows if row["happens"] == kind]
        after = [row["delay"] for row in some if row["delay"] is not None]
        if some:
            lines.append(
                f"{kind:<12}{len(some):7d}{np.mean([row['named'] for row in some]):7.0%}"
                f"{np.median(after) if after else np.nan:10.1f} s{sum(row['other_alarms'] for row in some):15d}"
            )
    costs = [np.median([row[name] for row in rows]) for name in ("median_us", "slow_us", "additions")]
    return "\n".join(
        [*lines, "an update: median {:.0f} us, 99.9th percentile {:.0f} us, {:.0f} additions".format(*costs)]
    )


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Delays of detected pushes and changes."""
    axes = figure.subplots(1, 2)
    delays = [1e3 * delay for row in rows for delay in row["delays"]]
    axes[0].hist(delays, bins=np.arange(0.0, 210.0, 10.0))
    axes[0].set_xlabel("delay of a push, ms")
    axes[0].set_ylabel("pushes")
    for place, kind in enumerate(KINDS):
        some = [row for row in rows if row["happens"] == kind and row["delay"] is not None]
        for named, mark in ((True, "o"), (False, "x")):
            after = [row["delay"] for row in some if row["named"] == named]
            axes[1].plot(np.full(len(after), place), after, mark, color=f"C{place}", alpha=0.6)
    axes[1].set_xticks(range(len(KINDS)), KINDS)
    axes[1].set_ylabel("delay, s; crosses: wrong kind")


STUDY = Study("tracking", 150, in_turn(SCENARIOS), trial, report, draw)
