"""Do confidences and standard deviations mean what they say? Simulated logs, where the truth is known.

Robots, noise of 2 to 15 % of each joint's RMS effort, white and coloured (AR(1), 0.9 from sample to sample at 100 Hz),
logs of 3 s and of 15 s, new parameters, motion and noise for each. Of all signs given a confidence in a bin, the table
gives the share that is right, for samples (the sign of the noisy effort as a signed sensor would have logged it) and
for segments (the sign of the sum of these); of all coefficients, how many 95 % intervals hold the true value.

The logs of `misfit` hold an effect that the model does not, a spring, torque ripple or an offset that changes with
position, of 0.2 to 1 times each joint's RMS effort: no coefficient is right then, and confidences must say that the
signs may not be either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.model import terms as catalogue
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import RigidBody, make_terms
from bayesid.posterior.sampler import Sampling
from bayesid.signs.search.certified import Certified
from bayesid.simulation.exciting import exciting_trajectory
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.study.record import Row
from bayesid.study.study import Plan, Study

if TYPE_CHECKING:
    from bayesid.report.plot.trials import Figure

ROBOTS = ("kr5", "ur10e", "panda", "tx40")
NOISES = (0.02, 0.05, 0.10, 0.15)
COLOURS = (0.0, 0.9)
DURATIONS = (3.0, 15.0)
EDGES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
"""Where the bins of confidence begin; the last one ends at 1."""
_RATE = 100.0
_PALETTE = ("#1b7f79", "#c0392b", "#2c5d9b")
MISFITS: dict[str, Callable[[Array], Array]] = {
    "spring": lambda q: q,
    "ripple": lambda q: np.sin(20.0 * q + 1.0),
    "steps": lambda q: np.sign(np.sin(3.0 * q)),
}
LEVELS = (0.2, 0.35, 0.5, 0.75, 1.0)
"""Of a misfit, relative to the joint's RMS effort."""


@dataclass(frozen=True)
class Scenario:
    """One simulated log.

    Attributes:
        robot: built-in name.
        noise: relative to each joint's RMS effort.
        colour: its correlation from sample to sample.
        duration: s.
        misfit: an effect outside of the model; empty for none.
        level: its size relative to each joint's RMS effort.
    """

    robot: str
    noise: float
    colour: float
    duration: float
    misfit: str = ""
    level: float = 0.0


ORDINARY = [
    Scenario(robot, noise, colour, duration)
    for noise in NOISES
    for duration in DURATIONS
    for robot in ROBOTS
    for colour in COLOURS
]
MISFITTING = [Scenario(r, 0.03, 0.0, 12.0, name, level) for name in MISFITS for level in LEVELS for r in ROBOTS]


def shuffled(kinds: Sequence[Scenario]) -> Plan:
    """Each kind about equally often in however many trials, every trial with a seed of its own."""

    def plan(trials: int, seed: int) -> list[tuple[Scenario, int]]:
        order = np.random.default_rng(seed).permutation(len(kinds))
        return [(kinds[order[k % len(kinds)]], seed + k) for k in range(trials)]

    return plan


def trial(scenario: Scenario, seed: int) -> Row:
    """Simulates a log, identifies the robot without its signs and scores what is claimed."""
    _, theta, signed = _log(scenario, seed)
    search, sampling = Certified(repeatable=True), Sampling(seed=seed, repeatable=True)
    result = identify(scenario.robot, signed.rectified(), complete="off", search=search, posterior=sampling)
    assert result.posterior is not None
    truth = result.coefficients.project(theta)
    low, high = result.posterior.interval(0.95)
    confidence = np.maximum(result.probability, 1.0 - result.probability)
    right = result.sample_signs == np.sign(signed.effort)
    of_segments = _segment_truth(result, signed.effort) == result.signs
    return {
        "samples": _bins(confidence, right),
        "segments": _bins(result.confidence, of_segments),
        "inside": int(np.sum((low <= truth) & (truth <= high))),
        "coefficients": len(truth),
        "certified": bool(result.search.certified),
        "modes": len(result.posterior.modes),
        "converged": bool(result.posterior.converged),
        "right": float(right.mean()),
        "timings": result.timings,
    }


def _log(scenario: Scenario, seed: int) -> tuple[Model, Array, Log]:
    """The model, its true parameters and the log with its signs; its grid is that of the pipeline."""
    rng = np.random.default_rng(seed)
    robot = load_robot(scenario.robot)
    bodies = Model(robot, (RigidBody(),))
    trajectory = exciting_trajectory(bodies, base_coefficients(bodies), scenario.duration, seed=seed)
    motion = trajectory.motion(np.arange(int(scenario.duration * _RATE) + 1) / _RATE)
    model = Model(robot, make_terms(catalogue.STANDARD, robot, motion))
    theta = random_parameters(model, rng)
    log = simulate(model, theta, motion, rng=rng, noise=scenario.noise, colour=scenario.colour, signed=True)
    if scenario.misfit:
        effect = MISFITS[scenario.misfit](motion.q)
        size = scenario.level * np.sqrt(np.mean(log.effort**2, axis=0) / np.mean(effect**2, axis=0))
        log = replace(log, effort=log.effort + size * effect)
    return model, theta, log


def _segment_truth(result: Identification, effort: Array) -> Array:
    segments = result.segments
    ranges = zip(segments.joint, segments.start, segments.end, strict=True)
    return np.array([1 if effort[a:b, j].sum() >= 0.0 else -1 for j, a, b in ranges])


def _bins(confidence: Array, right: Mask) -> list[list[float]]:
    """For each bin: how many, how many of them right, sum of their confidences."""
    place = np.clip(np.searchsorted(EDGES, confidence.ravel(), side="right") - 1, 0, len(EDGES) - 1)
    columns = (np.ones(right.size), right.ravel(), confidence.ravel())
    return np.stack([np.bincount(place, weights=column, minlength=len(EDGES)) for column in columns], axis=1).tolist()


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
def calibration_error(bins: Array) -> float:
    """Expected calibration error of bins (B, 3) of count, right and sum of confidences."""
    return float(np.abs(bins[:, 1] - bins[:, 2]).sum() / bins[:, 0].sum())


def report(rows: Sequence[Row]) -> str:
    """The tables."""
    lines = [f"{len(rows)} logs, {np.mean([row['right'] for row in rows]):.2%} of the samples' signs right"]
    for kind in ("samples", "segments"):
        lines += ["", f"of {kind} given a confidence in the bin, the share that is right (count)", _header()]
        for name, chosen in _groups(rows):
            bins = np.sum([row[kind] for row in chosen], axis=0)
            shares = [f"{right / count:7.2%} {int(count):>7}" if count else f"{'':15}" for count, right, _ in bins]
            lines.append(f"{name:<16} {calibration_error(bins):7.4f}  " + "  ".join(shares))
    lines += ["", "95 % intervals that hold the true coefficient; of the single logs the 10 % and 50 % quantile"]
    for name, chosen in _groups(rows):
        share = sum(row["inside"] for row in chosen) / sum(row["coefficients"] for row in chosen)
        low, middle = np.quantile([row["inside"] / row["coefficients"] for row in chosen], [0.1, 0.5])
        lines.append(f"{name:<16} {share:7.1%}  {low:7.1%} {middle:7.1%}")
    count = len(rows)
    lines += [
        "",
        f"certified {sum(row['certified'] for row in rows)} of {count}, "
        f"converged {sum(row['converged'] for row in rows)} of {count}, "
        f"more than one mode {sum(row['modes'] > 1 for row in rows)}; "
        f"seconds a log: median {np.median([row['timings']['seconds'] for row in rows]):.1f}, "
        f"most {max(row['timings']['seconds'] for row in rows):.1f}",
    ]
    return "\n".join(lines)


def _header() -> str:
    names = [f"[{low:g}, {high:g})" for low, high in zip(EDGES, (*EDGES[1:], 1.0), strict=True)]
    return f"{'':<16} {'ECE':>7}  " + "  ".join(f"{name:>15}" for name in names)


def _groups(rows: Sequence[Row]) -> list[tuple[str, Sequence[Row]]]:
    groups: list[tuple[str, Sequence[Row]]] = [("all", rows)]
    for key, values, form in (
        ("colour", COLOURS, "AR(1) {:g}"),
        ("duration", DURATIONS, "{:g} s"),
        ("noise", NOISES, "noise {:.0%}"),
        ("robot", ROBOTS, "{}"),
        ("level", LEVELS, "misfit {:.0%}"),
    ):
        groups += [(form.format(value), [row for row in rows if row[key] == value]) for value in values]
    return [(name, chosen) for name, chosen in groups if chosen]


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Shares of right signs over what was claimed of them, and of true coefficients inside their intervals."""
    of_signs, of_intervals = figure.subplots(1, 2)
    of_signs.plot([0.5, 1.0], [0.5, 1.0], color="#999999", lw=0.8)
    for kind, colour, marker in (("samples", _PALETTE[0], "o"), ("segments", _PALETTE[1], "s")):
        bins = np.sum([row[kind] for row in rows], axis=0)
        some = bins[bins[:, 0] > 0]
        share = some[:, 1] / some[:, 0]
        bars = 1.96 * np.sqrt(np.maximum(share * (1.0 - share), 1e-12) / some[:, 0])
        of_signs.errorbar(some[:, 2] / some[:, 0], share, bars, fmt=marker, ms=4, color=colour, capsize=2, label=kind)
    of_signs.set_xlabel("confidence, mean of the bin")
    of_signs.set_ylabel("share of right signs")
    of_signs.legend(fontsize=8)
    shares = np.sort([100.0 * row["inside"] / row["coefficients"] for row in rows])
    of_intervals.step(shares, np.arange(1, len(shares) + 1) / len(shares), color=_PALETTE[2])
    of_intervals.axvline(95.0, color="#999999", lw=0.8)
    of_intervals.set_xlabel("coefficients inside their 95 % intervals, %")
    of_intervals.set_ylabel("share of logs with at most this")


STUDY = Study("calibration", 256, shuffled(ORDINARY), trial, report, draw)
