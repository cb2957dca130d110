"""Does input diagnosis detect misread logs, and nothing in right ones? Simulated logs of built-in robots.

Links, friction and noise are random. Each right log is paired with a misread one: joints or efforts
exchanged, directions reversed, base upside down, gravity compensated, wrong zeros or units, external torques. Signs are
hidden in three of four logs. Misreadings that do not show in the log count like any other.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.identification.misread import Misreading, misread_before
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.motion import Motion
from bayesid.regression.log_data import LogData
from bayesid.robot import Robot, load_robot
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.calibration import on_grid
from bayesid.studies.record import Row
from bayesid.studies.study import Study
from bayesid.studies.sure import SURE

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

TARGETS = {"named": 0.90, "wrong": 0, "false": 0.01}
ROBOTS = "kr5", "ur10e", "panda", "tx60", "ur5e", "lrmate200id", "kr6r900_2", "vs060"
RIGHT = "right"
_NOISE = 0.05
_RATE = 100.0
_KNOWN = 4
"""One of so many logs keeps its signs."""


@dataclass(frozen=True)
class Scenario:
    """A misreading, a robot, and whether the signs are known."""

    how: str
    robot: str
    known: bool
    duration: float = 20.0


@dataclass(frozen=True)
class Case:
    """The stated robot, the log as it is read, and the kind of misreading that is to be named."""

    robot: Robot
    log: Log
    kind: str


def _exchanged(log: Log, rng: np.random.Generator, *columns: str) -> Log:
    """Columns "q" (positions and velocities) or "effort" of two random joints exchanged."""
    pairs = list(combinations(range(log.n_joints), 2))
    a, b = pairs[rng.integers(len(pairs))]
    order = np.arange(log.n_joints)
    order[[a, b]] = b, a
    if "effort" in columns:
        log = replace(log, effort=log.effort[:, order])
    if "q" in columns:
        log = replace(log, q=log.q[:, order], dq=None if log.dq is None else log.dq[:, order])
    return log


def _times(log: Log, q: Array | float, effort: Array | float) -> Log:
    return replace(log, q=log.q * q, dq=None if log.dq is None else log.dq * q, effort=log.effort * effort)


def _of_one(log: Log, joint: int, factor: float) -> Array:
    return np.where(np.arange(log.n_joints) == joint, factor, 1.0)


def _reversed(log: Log, rng: np.random.Generator) -> Log:
    factor = _of_one(log, int(rng.integers(1, log.n_joints - 1)), -1.0)
    return _times(log, factor, factor)


def _shift(log: Log, joint: int, rng: np.random.Generator) -> Array:
    return np.where(np.arange(log.n_joints) == joint, rng.choice([-0.5, 0.5]) * np.pi, 0.0)


def _unrelated(log: Log, rng: np.random.Generator) -> Log:
    """External torques: six bumps and noise."""
    effort = rng.standard_normal(log.effort.shape)
    for _ in range(6):
        centre, width = rng.uniform(log.t[0], log.t[-1]), rng.uniform(0.1, 0.6)
        effort += rng.normal(0.0, 10.0, log.n_joints) * np.exp(-(((log.t - centre) / width) ** 2))[:, None]
    return replace(log, effort=effort)


_LOGS: dict[str, tuple[str, Callable[[Log, np.random.Generator], Log], bool]] = {
    "joints exchanged": ("joint order", lambda log, rng: _exchanged(log, rng, "q", "effort"), True),
    "efforts exchanged": ("joint order", lambda log, rng: _exchanged(log, rng, "effort"), True),
    "positions exchanged": ("joint order", lambda log, rng: _exchanged(log, rng, "q"), True),
    "joint reversed": ("direction", _reversed, True),
    "position reversed": (
        "direction",
        lambda log, rng: _times(log, _of_one(log, int(rng.integers(1, log.n_joints - 1)), -1.0), 1.0),
        True,
    ),
    "torques negated": ("direction", lambda log, rng: _times(log, 1.0, -1.0), False),
    "one torque negated": (
        "direction",
        lambda log, rng: _times(log, 1.0, _of_one(log, int(rng.integers(log.n_joints)), -1.0)),
        False,
    ),
    "wrong zero": (
        "zeros",
        lambda log, rng: replace(log, q=log.q + _shift(log, int(rng.integers(1, log.n_joints - 1)), rng)),
        True,
    ),
    "one torque in N mm": (
        "units",
        lambda log, rng: _times(log, 1.0, _of_one(log, int(rng.integers(1, log.n_joints - 1)), 1e3)),
        True,
    ),
    "one torque of the motor side": (
        "units",
        lambda log, rng: _times(
            log, 1.0, _of_one(log, int(rng.integers(1, log.n_joints - 1)), 1.0 / rng.uniform(50.0, 160.0))
        ),
        True,
    ),
    "all torques in N mm": ("scale", lambda log, rng: _times(log, 1.0, 1e3), True),
    "external torques": ("motion", _unrelated, True),
}
"""Misreadings of a log: the kind to be named, the change, and whether it shows without signs."""
_ROBOTS: dict[str, tuple[str, Callable[[Robot], Robot]]] = {
    "upside down": ("mounting", lambda robot: replace(robot, gravity=-robot.gravity)),
    "no weight": ("weight", lambda robot: replace(robot, gravity=np.zeros(3))),
}
"""Differences of the true robot from the stated one: the kind to be named, and the change."""
HOW = (*_LOGS, *_ROBOTS)


def make_case(scenario: Scenario, seed: int) -> Case:
    """The case of a seed; right and misread logs of a seed have the same links and motion."""
    stated, rng = load_robot(scenario.robot), np.random.default_rng(seed)
    t = np.arange(int(_RATE * scenario.duration) + 1) / _RATE
    motion: Motion = random_trajectory(stated.n_joints, scenario.duration, rng=seed).motion(t)
    terms = make_terms(STANDARD, stated, motion)
    theta = random_parameters(Model(stated, terms), rng=rng)
    kind, true_robot = _ROBOTS.get(scenario.how, ("", lambda robot: robot))
    log = simulate(Model(true_robot(stated), terms), theta, motion, rng=rng, noise=_NOISE, signed=True)
    if scenario.how in _LOGS:
        kind, change, _ = _LOGS[scenario.how]
        log = change(log, rng)
    return Case(stated, log if scenario.known else log.rectified(), kind)


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """Each misreading followed by its right log, robots in turn."""
    made: list[tuple[Scenario, int]] = []
    for k in range(-(-trials // 2)):
        how = HOW[k % len(HOW)]
        known = k % _KNOWN == 0 or (how in _LOGS and not _LOGS[how][2])
        robot = ROBOTS[(k + k // len(ROBOTS)) % len(ROBOTS)]
        made += [(Scenario(reading, robot, known), seed + k) for reading in (how, RIGHT)]
    return made[:trials]


def before(case: Case) -> tuple[Misreading | None, float]:
    """The finding before the search, and the seconds that it takes."""
    signals = prepare(case.log)
    segments = find_segments(signals, case.robot.actuators(signals.motion))
    model = Model(case.robot, make_terms(STANDARD, case.robot, signals.motion))
    log_data = LogData.of(model, signals, segments.per_sample(segments.moving, *signals.effort.shape) > 0)
    began = time.perf_counter()
    found = misread_before(log_data)
    return found, time.perf_counter() - began


def trial(scenario: Scenario, seed: int) -> Row:
    """The finding before or after the search, and how many confident signs are wrong."""
    case = make_case(scenario, seed)
    found, seconds = before(case)
    stopped, sure, wrong = found is not None and found.sure, 0, 0
    if not stopped:
        result = identify(case.robot, case.log, complete="off", posterior=False)
        found = result.better_reading
        sure, wrong = _sure(result, make_case(replace(scenario, known=True), seed).log)
    return {
        "expected": case.kind,
        "found": "" if found is None else found.kind,
        "message": "" if found is None else found.message,
        "stopped": stopped,
        "sure": sure,
        "sure_wrong": wrong,
        "timings": {"before": seconds},
    }


def _sure(result: Identification, log: Log) -> tuple[int, int]:
    """Number of samples with hidden signs and high confidence, and of wrong ones among them."""
    effort = on_grid(result, log)
    sure = (np.maximum(result.probability, 1.0 - result.probability) >= SURE) & (effort != 0.0)
    sure &= ~result.signals.signed
    return int(sure.sum()), int((sure & (result.sample_signs != np.sign(effort))).sum())


def figures(rows: Sequence[Row]) -> dict[str, float]:
    """Shares "named" (misread logs) and "false" (right logs), count "wrong" (confident samples), "seconds"."""
    misread, right = ([row for row in rows if (row["how"] == RIGHT) == of] for of in (False, True))
    return {
        "named": float(np.mean([row["found"] == row["expected"] for row in misread] or [True])),
        "wrong": float(sum(row["sure_wrong"] for row in misread)),
        "false": float(np.mean([bool(row["found"]) for row in right] or [False])),
        "seconds": float(np.median([row["timings"].get("before") or float("nan") for row in rows])),
    }


def report(rows: Sequence[Row]) -> str:
    """One line per misreading and for all, the targets, and the finding of each failed case."""
    ways = {how: [row for row in rows if row["how"] == how] for how in dict.fromkeys(row["how"] for row in rows)}
    lines = [f"{'':<29} logs  right finding  before the search  confident, wrong  seconds: median   max"]
    for name, chosen in {**ways, "all": rows}.items():
        f, took = figures(chosen), [row["timings"].get("before") or float("nan") for row in chosen]
        named = f"{np.mean([row['found'] == row['expected'] for row in chosen]):.0%}"
        stopped = f"{np.mean([row['stopped'] for row in chosen]):.0%}"
        wrong = sum(row["sure_wrong"] for row in chosen)
        lines.append(
            f"{name:<29} {len(chosen):>4} {named:>14} {stopped:>18} {wrong:>17} {f['seconds']:>16.2f} {max(took):>5.2f}"
        )
    t, f = TARGETS, figures(rows)
    lines += [
        f"misread logs with the right finding: {100 * f['named']:.1f} % (target {100 * t['named']:.0f} %); "
        f"wrong samples of confidence >= {SURE:g} in misread logs: {f['wrong']:.0f} (target {t['wrong']:.0f})",
        f"right logs with a finding: {100 * f['false']:.1f} % (target {100 * t['false']:.0f} %)",
        *(
            f"trial {row['trial']}, seed {row['seed']}, {row['how']}, {row['robot']}: {row['message'] or 'no finding'}"
            for row in rows
            if row["found"] != row["expected"]
        ),
    ]
    return "\n".join(lines)


def _short(rows: Sequence[Row]) -> list[str]:
    f, t = figures(rows), TARGETS
    texts = [f"{name}: {f[name]:.3g}, allowed {t[name]:g}" for name in ("wrong", "false") if f[name] > t[name]]
    if f["named"] < t["named"]:
        texts.append(f"named: {100 * f['named']:.0f} %, required {100 * t['named']:.0f} %")
    return texts


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Share of logs with the right finding, by misreading."""
    axes = figure.subplots()
    ways = list(dict.fromkeys(row["how"] for row in rows))
    shares = [np.mean([row["found"] == row["expected"] for row in rows if row["how"] == how]) for how in ways]
    axes.barh(ways, shares)
    axes.axvline(TARGETS["named"], color="black", linewidth=1)
    axes.set_xlabel("share with the right finding (right logs: none)")


STUDY = Study("misread", 400, plan, trial, report, draw, short=_short)
