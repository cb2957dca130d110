"""Is the missing effect named on real logs? A UR10e whose model lacks a payload of 2.8 kg, or all friction.

The logs stand in $BAYESID_DATA, on workers of a cluster as well. Signs are hidden but for the refit to compare with;
stretches of the log are held back.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesid.cli import main
from bayesid.discrepancy.evidence import LN10
from bayesid.discrepancy.workflow import find_discrepancy
from bayesid.errors import InputError
from bayesid.identification import identify
from bayesid.log import read_log
from bayesid.terms import DEFAULT
from studies.real import DATA
from studies.record import Row
from studies.study import Study, in_turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        InputError: the logs are not there.
    """
    if not DATA.is_dir():
        raise InputError("is not there", str(DATA), "set BAYESID_DATA to the folder of the logs")
    data = str(DATA / "ur10e")
    payload = Scenario(data, "c_unloaded", DEFAULT, "c_loaded")
    return in_turn([payload, Scenario(data, "a_50s", FRICTIONLESS, "a_50s")])(trials, seed)


def trial(scenario: Scenario, seed: int) -> Row:
    """Finds what the model lacks; beside its gap that of an ordinary identification with known signs."""
    source, log = (read_log(Path(scenario.data) / f"{name}.csv") for name in (scenario.source, scenario.log))
    model = identify("ur10e", source.rectified(), scenario.terms, posterior=False, seed=seed, repeatable=True)
    found = find_discrepancy(model, log.rectified(), posterior=False, seed=seed, repeatable=True)
    refit = identify("ur10e", log, posterior=False, seed=seed, repeatable=True)
    own = found.unseen.gap(refit.model.effort(found.unseen.signals.motion, refit.theta))
    return {
        "status": found.status,
        "found": [_told(one.effect, one.joints) for one in found.found],
        "log10_bayes_factor": [one.verdict.gain / LN10 for one in found.found],
        "equivalent": [list(one.verdict.equivalent) for one in found.found],
        "payload": next((list(one.parameters["mp6"][:2]) for one in found.found if one.effect == "payload"), []),
        "unexplained": [joint for joint, _ in found.unexplained],
        "before": found.before.tolist(),
        "after": found.after.tolist(),
        "floor": found.floor.rms.tolist(),
        "signed_refit": own.tolist(),
        "timings": {"discrepancy": found.seconds},
    }


def _told(effect: str, joints: tuple[int, ...]) -> str:
    return f"{effect} {','.join(map(str, joints)) or 'all'}"


def report(rows: Sequence[Row]) -> str:
    """What was found, and the gaps."""
    lines: list[str] = []
    for row in rows:
        lines.append(f"model of {row['source']} ({', '.join(row['terms'])}), log {row['log']}")
        lines.append(f"{row['status']}, {row['timings']['discrepancy']:.0f} s; unexplained {row['unexplained']}")
        for name in ("before", "after", "floor", "signed_refit"):
            lines.append(f"  gap, N m, {name:<13}" + "  ".join(f"{value:6.2f}" for value in row[name]))
        for told, factor, others in zip(row["found"], row["log10_bayes_factor"], row["equivalent"], strict=True):
            lines.append(f"  {told:<28} log10 BF {factor:7.1f}  {', '.join(others)}".rstrip())
        if row["payload"]:
            lines.append(f"  payload {row['payload'][0]:.2f} +- {row['payload'][1]:.2f} kg (2.8 kg on the flange)")
        ratio = np.array(row["after"]) / np.array(row["signed_refit"])
        lines += [f"  gap after over that of a signed refit: {ratio.min():.2f} to {ratio.max():.2f}", ""]
    return "\n".join(lines[:-1])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Gaps of every joint before and after, beside the floor and a signed refit."""
    from studies.figures import COLOURS, MARKERS

    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for ax, row in zip(panels, rows, strict=True):
        joints = np.arange(1, len(row["before"]) + 1)
        for name, colour, marker in zip(("before", "after", "floor", "signed_refit"), COLOURS, MARKERS, strict=False):
            ax.semilogy(joints, row[name], marker, ms=5, color=colour, label=name.replace("_", " "))
        ax.set_title(f"model of {row['source']}, log {row['log']}", fontsize=9)
        ax.set_xlabel("joint")
    panels[0].set_ylabel("gap on held-back stretches, N m")
    panels[0].legend(fontsize=8)


STUDY = Study("real_discrepancy", 2, plan, trial, report, draw)

if __name__ == "__main__":
    sys.exit(main(["study", "real_discrepancy", *sys.argv[1:]]))
