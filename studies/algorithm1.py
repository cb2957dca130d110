"""Does the paper's Algorithm 1 alone find the signs? `bayesid demo --search beam --paper` with many seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesid.cli.paper import KNOWN, SEGMENTS, run_to_the_letter
from bayesid.simulation.paper import TABLE_II
from bayesid.studies.paper import spread
from bayesid.studies.record import Row
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure


@dataclass(frozen=True)
class Scenario:
    """The experiment; nothing is varied."""


def trial(scenario: Scenario, seed: int) -> Row:
    """One run of the experiment."""
    experiment = run_to_the_letter(seed)
    estimates, sd = experiment.table
    branch, nodes = experiment.true_branch, experiment.nodes
    return {
        "segments": len(experiment.segments),
        "nodes": len(nodes),
        "expected": experiment.expected_nodes,
        "wrong": experiment.wrong,
        "known": experiment.known,
        "depths": len({node.depth for node in nodes}),
        "lost": len(branch) < len({node.depth for node in nodes}),
        "infeasible": sum(not node.feasible for node in branch),
        "estimates": estimates.tolist(),
        "sd": sd.tolist(),
        "timings": {"search": experiment.search.seconds},
    }


def report(rows: Sequence[Row]) -> str:
    """Figures beside the paper's."""
    nominal, published = (np.array([getattr(row, key) for row in TABLE_II]) for key in ("nominal", "published"))
    theirs, ours = (np.sqrt(np.mean((values - nominal) ** 2, axis=-1)) for values in (published, estimates(rows)))
    low, high = SEGMENTS
    within = sum(low <= row["segments"] <= high for row in rows)
    touched = sum(row["infeasible"] > 0 for row in rows)
    share = np.mean([row["infeasible"] / row["depths"] for row in rows])
    figures = [
        ("runs with all signs right", f"{right(rows)} of {len(rows)}", "1 of 1"),
        ("segments", spread([row["segments"] for row in rows]), "39"),
        (f"runs with {low} to {high} segments", f"{within} of {len(rows)}", ""),
        ("nodes", spread([row["nodes"] for row in rows]), "372"),
        ("runs with 32 + 10 (segments - 5) nodes", f"{exact(rows)} of {len(rows)}", "1 of 1"),
        (f"of Table II with rsd < {100 * KNOWN:.0f} %", spread([row["known"] for row in rows]), "27"),
        ("rms error over Table II, median", f"{np.median(ours):.4f}", f"{theirs:.4f}"),
        ("runs in which least squares with the right signs is infeasible", f"{touched} of {len(rows)}", ""),
        ("share of all depths where it is infeasible", f"{share:.1%}", ""),
    ]
    lines = [f"{'':<64}{'ours: median (5 % to 95 %)':>28}   paper"]
    lines += [f"{name:<64}{value:>28}   {paper}".rstrip() for name, value, paper in figures]
    failed = [f"{row['seed']} ({row['wrong']} wrong)" for row in rows if row["wrong"]]
    lines += [f"seeds with a wrong sign: {', '.join(failed)}"] if failed else []
    return "\n".join([*lines, "", f"all signs right in {right(rows)} of {len(rows)} runs"])


def right(rows: Sequence[Row]) -> int:
    """Runs with all signs right."""
    return sum(row["wrong"] == 0 for row in rows)


def exact(rows: Sequence[Row]) -> int:
    """Runs with the number of nodes that Algorithm 1 states."""
    return sum(row["nodes"] == row["expected"] for row in rows)


def estimates(rows: Sequence[Row]) -> np.ndarray:
    """(runs, 27) of Table II."""
    return np.array([row["estimates"] for row in rows])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Relative standard deviations of Table II's coefficients."""
    from bayesid.studies.figures import COLOURS

    values = np.array([row["sd"] for row in rows]) / np.abs(estimates(rows))
    at = np.arange(1, len(TABLE_II) + 1)
    low, middle, high = np.percentile(values, [5, 50, 95], axis=0)
    ax = figure.subplots()
    label = f"median and 5 to 95 % of {len(rows)} runs"
    ax.errorbar(at, middle, [middle - low, high - middle], fmt="o", ms=4, color=COLOURS[0], capsize=2, label=label)
    ax.axhline(KNOWN, color="#999999", lw=0.8)
    ax.set_yscale("log")
    ax.set_xlabel("coefficient of Table II")
    ax.set_ylabel("relative standard deviation")
    ax.legend(fontsize=8)


STUDY = Study("algorithm1", 100, in_turn([Scenario()]), trial, report, draw)
