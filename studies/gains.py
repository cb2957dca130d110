"""What do logs of |currents| tell of gains? Simulated logs whose gains are off by up to 30 %, and stated so.

Robots with the standard friction and white noise of 3 % of each joint's RMS effort; every reading is made an effort by
a gain that is 0.7 to 1.3 times the true one, and stated as uncertain by 20 %. The table gives, of the joints whose
ratio the data decide, the error of that ratio and how many 95 % intervals hold it; how many joints are decided; the
same for the factor common to all gains, which the prior decides; and signs beside those of the same log with true
gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.gains import BY_DATA, IdentifiedGains
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.gains import Gains
from bayesid.model.terms import STANDARD
from bayesid.report.plot.trials import Figure
from bayesid.signs.search.certified import Certified
from bayesid.studies.simulated import STRONG, Truth, make_truth
from bayesid.studies.simulated import Scenario as Made
from bayesid.study.record import Row
from bayesid.study.study import Study, in_turn

_FARTHEST = (0.7, 1.3)
"""Stated gains over true ones."""
_SD = 0.2
"""Relative sd that is stated of them: about that of a uniform logarithm between these."""
_BUDGET = 3.0
"""Nominal seconds of a search's proof, as in `bayesid.studies.simulated`."""


@dataclass(frozen=True)
class Scenario:
    """A log.

    Attributes:
        robot: built-in name.
    """

    robot: str


SCENARIOS = [Scenario(robot) for robot in ("kr5", "ur10e", "tx40")]


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies a log with wrong gains, and with right ones."""
    truth = make_truth(Made(robot=scenario.robot, noise=0.03, trajectory="random"), seed)
    n = truth.log.n_joints
    off = np.exp(np.random.default_rng([seed, 1]).uniform(np.log(_FARTHEST[0]), np.log(_FARTHEST[1]), n))
    wrong = replace(truth.log.rescaled(off), gains=Gains(off, np.full(n, _SD)))
    found, known = (
        identify(
            truth.model.robot,
            log,
            STANDARD,
            complete="off",
            search=Certified(budget=_BUDGET, repeatable=True),
            posterior=False,
        )
        for log in (wrong, truth.log)
    )
    if found.gains is None:
        raise ValueError("gains were no unknowns")
    return {**_of_gains(found.gains), "right": _right(truth, found), "right_with_true": _right(truth, known)}


def _of_gains(gains: IdentifiedGains) -> Row:
    """Errors of ratios and factor; the true gains are 1."""
    log, told = np.log(gains.value), np.array(gains.decided_by) == BY_DATA
    others = np.where(np.eye(len(log), dtype=bool), 0.0, gains.weights)
    error = np.abs(log - (others / others.sum(axis=1, keepdims=True)) @ log)
    factor = abs(float(gains.weights @ log))
    inside = error <= NORMAL_95 * gains.ratio_sd
    single = np.abs(log) <= NORMAL_95 * gains.relative_sd
    return {
        "told": int(told.sum()),
        "ratio_error": float(np.median(error[told])) if told.any() else None,
        "ratio_error_worst": float(error[told].max()) if told.any() else None,
        "inside": int(inside[told].sum()),
        "untold": int((~told).sum()),
        "untold_inside": int(inside[~told].sum()),
        "single_inside": int(single.sum()),
        "joints": len(log),
        "sd": float(np.median(gains.ratio_sd[told])) if told.any() else None,
        "factor_error": factor,
        "factor_inside": factor <= NORMAL_95 * gains.factor_sd,
        "factor_by_data": gains.factor_decided_by == BY_DATA,
        "settled": gains.settled,
    }


def _right(truth: Truth, result: Identification) -> float:
    """Share of the samples with a strong effort whose sign is right."""
    strong: Array = np.abs(truth.effort) >= STRONG * np.abs(truth.effort).max(axis=0)
    return float((result.sample_signs == np.sign(truth.effort))[strong].mean())


def report(rows: Sequence[Row]) -> str:
    """A table by robot."""
    head = (
        "robot   logs  told by data   ratio error  median  in 95 %   not told: in 95 %   single gain in 95 %   factor"
    )
    lines = [head + "   in 95 %   signs right   with true gains   not settled"]
    for robot in (*(scenario.robot for scenario in SCENARIOS), "all"):
        some = [row for row in rows if robot in (row["robot"], "all")]
        if not some:
            continue

        def total(name: str, some: Sequence[Row] = some) -> float:
            return float(sum(row[name] for row in some))

        told, untold = total("told"), total("untold")
        errors = [row["ratio_error"] for row in some if row["ratio_error"] is not None]
        middle = f"{np.median(errors):.2%}" if errors else "none"
        lines.append(
            f"{robot:<8}{len(some):4d}{told / total('joints'):13.1%}{'':10}{middle:>12}"
            f"{total('inside') / max(told, 1.0):12.1%}{total('untold_inside') / max(untold, 1.0):17.1%}"
            f"{total('single_inside') / total('joints'):19.1%}{total('factor_error') / len(some):14.1%}"
            f"{total('factor_inside') / len(some):10.1%}{total('right') / len(some):13.3%}"
            f"{total('right_with_true') / len(some):16.3%}{sum(not row['settled'] for row in some):10d}"
        )
    return "\n".join(lines)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Ratio errors by robot."""
    axes = figure.add_subplot()
    for place, scenario in enumerate(SCENARIOS):
        errors = [
            100.0 * row["ratio_error"]
            for row in rows
            if row["robot"] == scenario.robot and row["ratio_error"] is not None
        ]
        axes.plot(np.full(len(errors), place), errors, "o", alpha=0.5)
    axes.set_xticks(range(len(SCENARIOS)), [scenario.robot for scenario in SCENARIOS])
    axes.set_ylabel("error of the ratios that data decide, %")


STUDY = Study("gains", 102, in_turn(SCENARIOS), trial, report, draw)
