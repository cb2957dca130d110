"""How long do a larger robot and a longer log take? 2 to 7 joints of the Panda, and 6 to 96 s of KR5 and UR10e.

Counts of cone problems and nodes are reproducible; seconds depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesid.studies.record import Row
from bayesid.studies.simulated import Scenario, trial
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

JOINTS = (2, 3, 4, 5, 6, 7)
DURATIONS = (6.0, 12.0, 24.0, 48.0, 96.0)
LONG = ("kr5", "ur10e")
SCENARIOS = [Scenario(robot=f"panda/{k}") for k in JOINTS]
SCENARIOS += [Scenario(robot=robot, duration=duration) for duration in DURATIONS for robot in LONG]
_STAGES = ("prepare", "search", "second opinion")


def report(rows: Sequence[Row]) -> str:
    """Segments, work and seconds by robot and length, and exponents of growth."""
    columns: dict[str, Callable[[Sequence[Row]], str]] = {
        "logs": lambda some: f"{len(some)}",
        "coefficients": lambda some: f"{some[0]['coefficients']}",
        "segments": lambda some: f"{_median(some, 'segments'):.0f}",
        "cone problems": lambda some: f"{_median(some, 'solves'):.0f}",
        "nodes": lambda some: f"{_median(some, 'nodes'):.0f}",
        "certified": lambda some: f"{np.mean([row['certified'] for row in some]):.0%}",
        "signs right": lambda some: f"{_median(some, 'right'):.2%}",
        "search, s": lambda some: f"{np.median([row['timings']['search'] for row in some]):.2f}",
        "total, s": lambda some: f"{np.median([_seconds(row) for row in some]):.2f}",
        "longest, s": lambda some: f"{max(_seconds(row) for row in some):.1f}",
    }
    lines = [f"{len(rows)} logs; without the posterior", f"{'':<16}" + "".join(f"{name:>15}" for name in columns)]
    for scenario in SCENARIOS:
        if some := _of(rows, scenario):
            name = f"{scenario.robot}, {scenario.duration:g} s"
            lines.append(f"{name:<16}" + "".join(f"{cell(some):>15}" for cell in columns.values()))
    return "\n".join([*lines, "", *_growth(rows)])


def _growth(rows: Sequence[Row]) -> list[str]:
    """Exponents of seconds over segments, over the lengths of a log."""
    lines = []
    for robot in LONG:
        some = [row for row in rows if row["robot"] == robot]
        if len({row["duration"] for row in some}) > 1:
            segments, seconds = np.log([row["segments"] for row in some]), np.log([_seconds(row) for row in some])
            power = np.polyfit(segments, seconds, 1)[0]
            lines.append(f"{robot}: seconds grow as the number of segments to the power {power:.2f}")
    return lines


def _of(rows: Sequence[Row], scenario: Scenario) -> list[Row]:
    return [row for row in rows if row["robot"] == scenario.robot and row["duration"] == scenario.duration]


def _median(rows: Sequence[Row], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def _seconds(row: Row) -> float:
    return float(sum(row["timings"][stage] for stage in _STAGES))


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Seconds over the number of segments, one point per log."""
    from bayesid.studies.figures import COLOURS, MARKERS

    groups = {robot: [row for row in rows if row["robot"] == robot] for robot in LONG}
    groups["panda, 2 to 7 joints"] = [row for row in rows if row["robot"].startswith("panda/")]
    ax = figure.subplots()
    for (name, some), colour, marker in zip(groups.items(), COLOURS, MARKERS, strict=False):
        seconds = [_seconds(row) for row in some]
        ax.loglog([row["segments"] for row in some], seconds, marker, color=colour, ms=5, label=name)
    ax.set_xlabel("segments")
    ax.set_ylabel("seconds, without the posterior")
    ax.legend(fontsize=8)


STUDY = Study("scaling", 64, in_turn(SCENARIOS), trial, report, draw)
