"""Can a log of |current| determine uncertain gains? Simulated logs whose stated gains are wrong by up to 30 %.

Robots have the standard friction and white noise of 3 % of each joint's RMS effort. Stated gains are 0.7 to 1.3 times
the true ones, with a stated sd of 20 %. The table gives the share of the joints whose ratio of gains the data
determine, the error of these ratios and the coverage of their 95 % intervals; the coverage where the prior determines
the ratio; and the signs beside those found with the true gains. Half of the trials add a log with a payload of known
mass, which determines the common factor of all gains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.identification.gains import BY_DATA, IdentifiedGains
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.gains import Gains
from bayesid.log.log import Log, join_logs
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot.inertia import from_pseudo_inertia
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.figures import Figure
from bayesid.studies.record import Row
from bayesid.studies.simulated import BUDGET, PERIOD, RATE, STRONG, Truth, make_truth
from bayesid.studies.simulated import Scenario as Made
from bayesid.studies.study import Study, in_turn

_RANGE = (0.7, 1.3)
"""Stated gains over true ones."""
_SD = 0.2
"""Stated relative sd: about that of a uniform logarithm over `_RANGE`."""
_NOISE = 0.03
"""Of the efforts, relative to each joint's RMS effort."""
_MASS, _MASS_SD = 3.0, 0.005
"""kg, of the payload."""
_LABEL = "weighed"
_ANOTHER = 2_000_000
"""Added to the seed for the motion with payload."""


@dataclass(frozen=True)
class Scenario:
    """A log.

    Attributes:
        robot: built-in name.
        payload: whether a second log has a weighed payload.
    """

    robot: str
    payload: bool


ROBOTS = ("kr5", "ur10e", "tx40")
SCENARIOS = [Scenario(robot, payload) for payload in (False, True) for robot in ROBOTS]


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies a log with wrong gains, and with right ones."""
    truth = make_truth(Made(robot=scenario.robot, noise=_NOISE, trajectory="random"), seed)
    robot, n = truth.model.robot, truth.log.n_joints
    logs, prior = [truth.log], ParameterPrior()
    if scenario.payload:
        logs.append(_loaded(truth, seed).carrying(_LABEL))
        prior = ParameterPrior(nominal={f"m_{_LABEL}": (_MASS, _MASS_SD)})
    ratio = np.exp(np.random.default_rng([seed, 1]).uniform(np.log(_RANGE[0]), np.log(_RANGE[1]), n))
    wrong = [replace(log.rescaled(ratio), gains=Gains(ratio, np.full(n, _SD))) for log in logs]
    found, known = (
        identify(
            robot,
            join_logs(some),
            STANDARD,
            complete="off",
            search=Certified(budget=BUDGET),
            posterior=False,
            prior=prior,
        )
        for some in (wrong, logs)
    )
    if found.gains is None:
        raise ValueError("gains were not identified")
    return {**_of_gains(found.gains), "right": _right(truth, found), "right_with_true": _right(truth, known)}


def _loaded(truth: Truth, seed: int) -> Log:
    """A log of the robot with a random payload at its last link."""
    rng = np.random.default_rng([seed, 2])
    n, last = truth.log.n_joints, truth.model.cone.bodies[-1]
    motion = random_trajectory(n, PERIOD, rng=seed + _ANOTHER).motion(np.arange(round(PERIOD * RATE) + 1) / RATE)
    centre, spread = rng.uniform(-0.15, 0.15, 3), np.diag(rng.uniform(0.02, 0.06, 3) ** 2)
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3], pseudo[3, :3], pseudo[:3, 3] = spread + np.outer(centre, centre), centre, centre
    pseudo[3, 3] = 1.0
    theta = truth.theta.copy()
    theta[last] += from_pseudo_inertia(_MASS * pseudo)
    return simulate(truth.model, theta, motion, rng=rng, noise=_NOISE)


def _of_gains(gains: IdentifiedGains) -> Row:
    """Errors of ratios and factor; the true gains are 1."""
    log, by_data = np.log(gains.value), np.array(gains.decided_by) == BY_DATA
    others = np.where(np.eye(len(log), dtype=bool), 0.0, gains.weights)
    error = np.abs(log - (others / others.sum(axis=1, keepdims=True)) @ log)
    factor = abs(float(gains.weights @ log))
    inside = error <= NORMAL_95 * gains.ratio_sd
    single = np.abs(log) <= NORMAL_95 * gains.relative_sd
    return {
        "by_data": int(by_data.sum()),
        "ratio_error": float(np.median(error[by_data])) if by_data.any() else None,
        "inside": int(inside[by_data].sum()),
        "by_prior": int((~by_data).sum()),
        "by_prior_inside": int(inside[~by_data].sum()),
        "single_inside": int(single.sum()),
        "joints": len(log),
        "sd": float(np.median(gains.ratio_sd[by_data])) if by_data.any() else None,
        "factor_error": factor,
        "factor_inside": factor <= NORMAL_95 * gains.factor_sd,
        "factor_by_data": gains.factor_decided_by == BY_DATA,
        "converged": gains.converged,
    }


def _right(truth: Truth, result: Identification) -> float:
    """Share of the first log's strong samples whose sign is right."""
    rows = slice(0, len(truth.effort))
    strong: Array = np.abs(truth.effort) >= STRONG * np.abs(truth.effort).max(axis=0)
    return float((result.sample_signs[rows] == np.sign(truth.effort))[strong].mean())


def report(rows: Sequence[Row]) -> str:
    """A table by robot and, with a payload, one of the factor."""
    lines = [
        "robot   logs  by data  ratio error  in 95 %  by prior: in 95 %  single gain in 95 %  signs right"
        "  with true gains"
    ]
    for robot, some in _groups(rows, payload=False):
        by_data, by_prior = _total(some, "by_data"), _total(some, "by_prior")
        errors = [row["ratio_error"] for row in some if row["ratio_error"] is not None]
        lines.append(
            f"{robot:<8}{len(some):4d}{by_data / _total(some, 'joints'):9.0%}{_median(errors):>13}"
            f"{_share(_total(some, 'inside'), by_data):>9}{_share(_total(some, 'by_prior_inside'), by_prior):>19}"
            f"{_share(_total(some, 'single_inside'), _total(some, 'joints')):>21}"
            f"{_total(some, 'right') / len(some):13.3%}{_total(some, 'right_with_true') / len(some):17.3%}"
        )
    lines += [
        "",
        "with a payload of known mass",
        "robot   logs  factor by data  factor error  in 95 %  ratio error  in 95 %",
    ]
    for robot, some in _groups(rows, payload=True):
        errors = [row["ratio_error"] for row in some if row["ratio_error"] is not None]
        lines.append(
            f"{robot:<8}{len(some):4d}{_total(some, 'factor_by_data') / len(some):16.0%}"
            f"{_median([row['factor_error'] for row in some]):>14}{_total(some, 'factor_inside') / len(some):9.1%}"
            f"{_median(errors):>13}{_share(_total(some, 'inside'), _total(some, 'by_data')):>9}"
        )
    moving = sum(not row["converged"] for row in rows)
    return "\n".join([*lines, "", f"signs and gains did not converge in {moving} of {len(rows)} logs"])


def _groups(rows: Sequence[Row], *, payload: bool) -> Iterator[tuple[str, list[Row]]]:
    """Rows by robot, then all rows; groups without rows are left out."""
    chosen = [row for row in rows if row["payload"] == payload]
    for robot in (*ROBOTS, "all"):
        some = [row for row in chosen if robot in (row["robot"], "all")]
        if some:
            yield robot, some


def _total(rows: Sequence[Row], name: str) -> float:
    return float(sum(row[name] for row in rows))


def _median(errors: Sequence[float]) -> str:
    return f"{np.median(errors):.2%}" if errors else "none"


def _share(part: float, of: float) -> str:
    return f"{part / of:.1%}" if of else "none"


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Errors of ratios and, with a payload, of the factor, by robot."""
    axes = figure.add_subplot()
    for place, robot in enumerate(ROBOTS):
        for payload, name, text in ((False, "ratio_error", "ratios"), (True, "factor_error", "factor, by a payload")):
            some = [row for row in rows if row["robot"] == robot and row["payload"] == payload]
            errors = [100.0 * row[name] for row in some if row[name] is not None]
            places, label = np.full(len(errors), place + 0.2 * payload - 0.1), None if place else text
            axes.plot(places, errors, "os"[payload], color=f"C{int(payload)}", alpha=0.5, label=label)
    axes.set_xticks(range(len(ROBOTS)), ROBOTS)
    axes.set_ylabel("error, %")
    axes.legend()


STUDY = Study("gains", 204, in_turn(SCENARIOS), trial, report, draw)
