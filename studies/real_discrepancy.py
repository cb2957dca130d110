"""Is the missing effect named in real logs? A UR10e whose model lacks a payload of 2.8 kg, or all friction.

The logs are in $BAYESID_DATA, on workers of a cluster as well. Signs are hidden, except in the refit for comparison.
Gaps are those of held-back blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesid.discrepancy.workflow import explain_log
from bayesid.effects import STANDARD
from bayesid.identification.pipeline import QUICK, identify
from bayesid.log.reading import read_log
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.signs.search.certified import Certified
from bayesid.studies.complete import named
from bayesid.studies.real import data_folder
from bayesid.studies.record import Row
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

FRICTIONLESS = ("rigid_body", "torque_offset", "rotor_inertia")


@dataclass(frozen=True)
class Scenario:
    """A model and a log that it does not explain.

    Attributes:
        data: folder of the robots' folders.
        source: log from which the model is identified.
        terms: of the model.
        log: that it is compared with.
    """

    data: str
    source: str
    terms: tuple[str, ...]
    log: str


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """The payload, then the friction, then again.

    Raises:
        InputError: the logs are missing.
    """
    data = str(data_folder() / "ur10e")
    payload = Scenario(data, "c_unloaded", STANDARD, "c_loaded")
    return in_turn([payload, Scenario(data, "a_50s", FRICTIONLESS, "a_50s")])(trials, seed)


def trial(scenario: Scenario, seed: int) -> Row:
    """Finds the missing effects; compares the gap with that of an identification with known signs."""
    source, log = (read_log(Path(scenario.data) / f"{name}.csv") for name in (scenario.source, scenario.log))
    search = Certified()
    model = identify("ur10e", source.rectified(), scenario.terms, complete="off", search=search, posterior=False)
    known = replace(model.identified, logs=frozenset())  # friction is sought in the log of the model itself
    result = explain_log(known, log.rectified(), search=QUICK, posterior=False)
    refit = identify("ur10e", log, complete="off", search=search, posterior=False)
    of_refit = result.cross_validation.gap(refit.model.effort(result.cross_validation.signals.motion, refit.theta))
    return {
        "status": result.status,
        "found": [named(added.effect, added.joints) for added in result.added],
        "log10_bayes_factor": [added.gain / LN10 for added in result.added],
        "equivalent": [list(added.equivalent) for added in result.added],
        "payload": next((list(added.parameters["mp6"][:2]) for added in result.added if added.effect == "payload"), []),
        "unexplained": [joint for joint, _ in result.unexplained],
        "before": result.before.tolist(),
        "after": result.after.tolist(),
        "floor": result.floor.rms.tolist(),
        "signed_refit": of_refit.tolist(),
        "timings": {"discrepancy": result.seconds},
    }


def report(rows: Sequence[Row]) -> str:
    """Named effects and gaps."""
    lines: list[str] = []
    for row in rows:
        lines.append(f"model of {row['source']} ({', '.join(row['terms'])}), log {row['log']}")
        lines.append(f"{row['status']}, {row['timings']['discrepancy']:.0f} s; unexplained {row['unexplained']}")
        for name in ("before", "after", "floor", "signed_refit"):
            lines.append(f"  gap, N m, {name:<13}" + "  ".join(f"{value:6.2f}" for value in row[name]))
        for effect, factor, equivalent in zip(row["found"], row["log10_bayes_factor"], row["equivalent"], strict=True):
            lines.append(f"  {effect:<28} log10 BF {factor:7.1f}  {', '.join(equivalent)}".rstrip())
        if row["payload"]:
            lines.append(f"  payload {row['payload'][0]:.2f} +- {row['payload'][1]:.2f} kg (2.8 kg on the flange)")
        ratio = np.array(row["after"]) / np.array(row["signed_refit"])
        lines += [f"  gap after, ratio to that of a signed refit: {ratio.min():.2f} to {ratio.max():.2f}", ""]
    return "\n".join(lines[:-1])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Gaps of each joint before and after, beside noise floor and signed refit."""
    from bayesid.studies.figures import COLOURS, MARKERS

    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for ax, row in zip(panels, rows, strict=True):
        joints = np.arange(1, len(row["before"]) + 1)
        for name, colour, marker in zip(("before", "after", "floor", "signed_refit"), COLOURS, MARKERS, strict=False):
            ax.semilogy(joints, row[name], marker, ms=5, color=colour, label=name.replace("_", " "))
        ax.set_title(f"model of {row['source']}, log {row['log']}", fontsize=9)
        ax.set_xlabel("joint")
    panels[0].set_ylabel("gap in held-back blocks, N m")
    panels[0].legend(fontsize=8)


STUDY = Study("real_discrepancy", 2, plan, trial, report, draw)
