"""Tables and figure of the study `next_motion`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.excitation.tuning import TUNING
from bayesid.studies.figures import COLOURS, Figure
from bayesid.studies.record import Row

ARM = "arm"
"""Name of a random arm."""
ROBOTS = ("kr5", "ur10e", "panda", ARM)
COEFFICIENTS, HYPOTHESES = "coefficients", "hypotheses"
EFFECTS = ("joint_spring", "load_dependent_friction", "gravity_spring", "viscous_friction", "torque_offset")
"""Effects that are often ambiguous in short, poor logs."""
_MOTIONS = ("designed", "random", "repeat")


def report(rows: Sequence[Row]) -> str:
    """Tables of coefficients by robot and of hypotheses by effect; limits and seconds of all designs."""
    lines = []
    for limited, text in ((True, "with limits of efforts"), (False, "without limits of efforts")):
        some = [row for row in rows if row["part"] == COEFFICIENTS and row["limited"] == limited]
        if some:
            lines += [f"open coefficients, {text}", *_table_of_coefficients(some), ""]
    if any(row["part"] == HYPOTHESES for row in rows):
        lines += [*_table_of_hypotheses(rows), ""]
    designs = [row for row in rows if row["motion_held"] is not None]
    of_efforts = [row for row in designs if row["effort_held"] is not None]
    if designs:
        seconds = [row["timings"]["design"] for row in designs]
        most = max([row["effort_share"] for row in of_efforts], default=0.0)
        lines.append(
            f"limits kept by the true robot at every ms: positions to jerks in {_count(designs, 'motion_held')}, "
            f"efforts in {_count(of_efforts, 'effort_held')} (at most {100 * most:.0f} % of a limit)"
        )
        known = [row for row in of_efforts if row["random_allowed"] is not None]
        lines.append(
            f"random motions that certainly keep limits of efforts, by the result: {_count(known, 'random_allowed')}"
        )
        lines.append(f"seconds per design: median {np.median(seconds):.0f}, maximum {max(seconds):.0f}")
    return "\n".join(lines)


def _count(rows: Sequence[Row], name: str) -> str:
    return f"{sum(row[name] for row in rows)} of {len(rows)}"


def _table_of_coefficients(rows: Sequence[Row]) -> list[str]:
    lines = [
        "robot   logs   now  predicted  designed  random  repeat",
        "robot   sd as predicted: noise (larger)  with model error (larger)  total  error: designed  random  repeat  "
        "signs: designed   random   repeat",
    ]
    groups = [(robot, [row for row in rows if robot in (row["robot"], "all")]) for robot in (*ROBOTS, "all")]
    groups = [(robot, some) for robot, some in groups if some]
    of_open = []
    for robot, some in groups:
        still = [_sum(some, f"open_{name}") / len(some) for name in ("now", "predicted", *_MOTIONS)]
        of_open.append(
            f"{robot:<8}{len(some):4d}{still[0]:6.1f}{still[1]:11.1f}{still[2]:10.1f}{still[3]:8.1f}{still[4]:8.1f}"
        )
    for robot, some in groups:
        names = ("noise_near", "noise_above", "total_between", "total_above", "total_near")
        near = [_sum(some, name) / _sum(some, "coefficients") for name in names]
        error = [np.sqrt(np.mean([row[f"error_{name}"] ** 2 for row in some])) for name in _MOTIONS]
        right = [_sum(some, f"right_{name}") / len(some) for name in _MOTIONS]
        lines.append(
            f"{robot:<8}{near[0]:23.1%}{near[1]:9.1%}{near[2]:18.1%}{near[3]:9.1%}{near[4]:7.1%}{error[0]:17.2f}{error[1]:8.2f}{error[2]:8.2f}"
            f"{right[0]:17.2%}{right[1]:9.2%}{right[2]:9.2%}"
        )
    return [lines[0], *of_open, *lines[1:]]


def _table_of_hypotheses(rows: Sequence[Row]) -> list[str]:
    lines = [
        "effects that are ambiguous in a poor log",
        "hidden                    logs  ambiguous  discriminated: designed  random  named: designed  random  "
        "log10 Bayes factor: expected  designed  random",
    ]
    for effect in (*EFFECTS, "all"):
        every = [row for row in rows if row["part"] == HYPOTHESES and effect in (row["effect"], "all")]
        some = [row for row in every if row["ambiguous"]]
        if not every:
            continue
        discriminated, named = (
            [f"{_sum(some, f'{what}_{name}'):.0f}" for name in ("designed", "random")]
            for what in ("discriminated", "named")
        )
        factors = [_middle(some, name) for name in ("expected", "factor_designed", "factor_random")]
        lines.append(
            f"{effect:<26}{len(every):4d}{len(some):11d}{discriminated[0]:>25}{discriminated[1]:>8}"
            f"{named[0]:>17}{named[1]:>8}{factors[0]:>30}{factors[1]:>10}{factors[2]:>8}"
        )
    return lines


def _sum(rows: Sequence[Row], name: str) -> float:
    return float(sum(row[name] for row in rows))


def _middle(rows: Sequence[Row], name: str) -> str:
    values = [row[name] for row in rows if row[name] is not None]
    return f"{np.median(values):.1f}" if values else "none"


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Open coefficients after a designed motion over those after a random one; Bayes factors over expected ones."""
    axes = figure.subplots(1, 2)
    coefficients = [row for row in rows if row["part"] == COEFFICIENTS]
    for place, robot in enumerate(ROBOTS):
        some = [row for row in coefficients if row["robot"] == robot]
        axes[0].plot(
            [row["open_random"] for row in some],
            [row["open_designed"] for row in some],
            "o",
            color=COLOURS[place % len(COLOURS)],
            label=robot,
        )
    most = max([row["open_now"] for row in coefficients], default=1)
    axes[0].plot([0, most], [0, most], color="#888888", lw=0.8)
    axes[0].plot([0, most], [0, 0.5 * most], color="#888888", lw=0.8, ls="--")
    axes[0].set_xlabel("open coefficients after a random motion")
    axes[0].set_ylabel("after the designed one")
    axes[0].legend(fontsize=8)
    ambiguous = [row for row in rows if row["part"] == HYPOTHESES and row["ambiguous"]]
    for place, name in enumerate(("designed", "random")):
        some = [row for row in ambiguous if row[f"factor_{name}"] is not None]
        axes[1].plot(
            [row["expected"] for row in some],
            [row[f"factor_{name}"] for row in some],
            "ox"[place],
            color=COLOURS[place],
            label=name,
        )
    axes[1].axhline(TUNING.decisive, color="#888888", lw=0.8)
    axes[1].set_xscale("symlog")
    axes[1].set_yscale("symlog")
    axes[1].set_xlabel("expected log10 Bayes factor of the designed motion")
    axes[1].set_ylabel("log10 Bayes factor")
    axes[1].legend(fontsize=8)
