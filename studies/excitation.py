"""How poor may the excitation be? Optimised and random motions, and random ones of less range or speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from bayesid.studies.record import Row
from bayesid.studies.sensitivity import Level, Varied, sensitivity

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure


def _motion(trajectory: str, reach: float, speed: float) -> dict[str, object]:
    return {"trajectory": trajectory, "reach": reach, "speed": speed}


LEVELS = [
    Level("optimised", 0.0, _motion("exciting", 1.0, 1.0)),
    Level("random", 1.0, _motion("random", 1.0, 1.0)),
    Level("range / 2", 2.0, _motion("random", 0.5, 1.0)),
    Level("range / 4", 3.0, _motion("random", 0.25, 1.0)),
    Level("speed / 2", 4.0, _motion("random", 1.0, 0.5)),
    Level("speed / 4", 5.0, _motion("random", 1.0, 0.25)),
    Level("speed / 10", 6.0, _motion("random", 1.0, 0.1)),
]
VARIED = Varied("excitation", LEVELS, log_x=False)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Wrong signs and errors of predicted efforts over the condition number, one point per log."""
    from bayesid.studies.figures import COLOURS, MARKERS, error_axis, wrong_axis

    panels = figure.subplots(1, 2)
    for ax in panels:
        ax.set_xscale("log")
        ax.set_xlabel("condition number of the regressor")
    for level, colour, marker in zip(LEVELS, COLOURS, MARKERS, strict=True):
        some = [row for row in level.rows(rows) if row["condition"] < float("inf")]
        x = [row["condition"] for row in some]
        panels[0].plot(x, [100.0 * (1.0 - row["right"]) for row in some], marker, color=colour, ms=4, label=level.label)
        panels[1].plot(x, [100.0 * row["torque_error"] for row in some], marker, color=colour, ms=4)
    wrong_axis(panels[0])
    error_axis(panels[1])
    panels[0].legend(fontsize=8)


STUDY = replace(sensitivity("excitation", VARIED, trials=196), draw=draw)
