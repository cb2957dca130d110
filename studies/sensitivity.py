"""Sensitivity studies: one property of log or method is varied, on several robots; tables, figure, conclusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.studies.record import Row
from bayesid.studies.simulated import ROBOTS, Scenario, trial
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

USUAL = Scenario()
GOOD = 0.99
"""Share of right signs that counts as good. Chosen; not measured."""
CLOSE = 0.02
"""Error of predicted efforts over their RMS that counts as small. Chosen; not measured."""


@dataclass(frozen=True)
class Level:
    """One setting of the varied property.

    Attributes:
        label: in tables.
        x: in figures.
        changes: fields of the scenario and their values.
    """

    label: str
    x: float
    changes: Mapping[str, Any]

    def rows(self, rows: Sequence[Row], robot: str = "") -> list[Row]:
        """Rows of this level, and of one robot if it is named."""
        fields = {**self.changes, **({"robot": robot} if robot else {})}
        return [row for row in rows if all(row[key] == value for key, value in fields.items())]


@dataclass(frozen=True)
class Varied:
    """A varied property, and how it is shown.

    Attributes:
        label: of the axis.
        levels: in their order.
        robots: built-in names.
        log_x: whether the axis is logarithmic.
        base: the scenario whose other fields are kept.
        extra: more columns of the table, pooled over robots: heading to a cell from rows.
    """

    label: str
    levels: Sequence[Level]
    robots: Sequence[str] = ROBOTS
    log_x: bool = True
    base: Scenario = USUAL
    extra: Mapping[str, Callable[[Sequence[Row]], str]] = field(default_factory=dict)

    @property
    def scenarios(self) -> list[Scenario]:
        """All levels on all robots."""
        return [replace(self.base, robot=robot, **level.changes) for level in self.levels for robot in self.robots]


def of_field(name: str, values: Sequence[Any], form: str = "{:g}") -> list[Level]:
    """Levels that change one field of the scenario."""
    return [Level(form.format(value), float(value), {name: value}) for value in values]


def sensitivity(name: str, varied: Varied, trials: int) -> Study:
    """The study of a varied property."""
    return Study(
        name,
        trials,
        in_turn(varied.scenarios),
        trial,
        lambda rows: report(varied, rows),
        lambda rows, figure: draw(varied, rows, figure),
    )


# ---------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------
def report(varied: Varied, rows: Sequence[Row]) -> str:
    """Signs and torques by level and robot, figures of all robots, conclusion."""
    parts = [
        f"{len(rows)} logs; {varied.label}",
        _by_robot(varied, rows, "strong samples with the right sign: median (minimum) of the logs", _signs),
        _by_robot(varied, rows, "error of efforts predicted for a new motion: median joint (worst joint)", _torques),
        _pooled(varied, rows),
        conclusion(varied, rows),
    ]
    return "\n\n".join(parts)


def _signs(rows: Sequence[Row]) -> str:
    right = [row["right"] for row in rows]
    return f"{np.median(right):.2%} ({min(right):.1%})"


def _torques(rows: Sequence[Row]) -> str:
    middle, worst = (np.median([row[key] for row in rows]) for key in ("torque_error", "torque_error_worst"))
    return f"{middle:.2%} ({worst:.1%})"


def _by_robot(varied: Varied, rows: Sequence[Row], heading: str, cell: Callable[[Sequence[Row]], str]) -> str:
    width = max(len(level.label) for level in varied.levels)
    lines = [heading, f"{'':<{width}}  " + "  ".join(f"{robot:>18}" for robot in varied.robots)]
    for level in varied.levels:
        chosen = [level.rows(rows, robot) for robot in varied.robots]
        cells = [f"{cell(some) if some else '-':>18}" for some in chosen]
        lines.append(f"{level.label:<{width}}  " + "  ".join(cells))
    return "\n".join(lines)


def _pooled(varied: Varied, rows: Sequence[Row]) -> str:
    columns: dict[str, Callable[[Sequence[Row]], str]] = {
        "logs": lambda some: f"{len(some)}",
        "segments": lambda some: f"{np.median([row['segments'] for row in some]):.0f}",
        "condition": lambda some: f"{np.median([row['condition'] for row in some]):.0f}",
        "certified": lambda some: _share(some, "certified"),
        "a joint flipped": lambda some: _share(some, "joints_flipped"),
        "known to 10 %": lambda some: _part(some, "known", "coefficients"),
        "in 95 % interval": lambda some: _part(some, "inside", "coefficients"),
        **varied.extra,
    }
    width = max(len(level.label) for level in varied.levels)
    lines = ["all robots", f"{'':<{width}}  " + "  ".join(f"{name:>16}" for name in columns)]
    for level in varied.levels:
        if some := level.rows(rows):
            lines.append(f"{level.label:<{width}}  " + "  ".join(f"{cell(some):>16}" for cell in columns.values()))
    return "\n".join(lines)


def _share(rows: Sequence[Row], key: str) -> str:
    return f"{np.mean([bool(row[key]) for row in rows]):.0%}"


def _part(rows: Sequence[Row], key: str, of: str) -> str:
    return f"{sum(row[key] for row in rows) / sum(row[of] for row in rows):.1%}"


def conclusion(varied: Varied, rows: Sequence[Row]) -> str:
    """Levels at which nine logs of ten have good signs, and good predictions, robot by robot."""
    signs = _levels(varied, rows, lambda some: np.quantile([row["right"] for row in some], 0.1) >= GOOD)
    efforts = _levels(varied, rows, lambda some: np.quantile([row["torque_error"] for row in some], 0.9) <= CLOSE)
    heads = (
        f"at least {100 * GOOD:.0f} % of strong samples right, in nine of ten logs:",
        f"efforts of a new motion within {100 * CLOSE:.0f} % (median joint), in nine of ten logs:",
    )
    return "\n".join([heads[0], *signs, heads[1], *efforts])


def _levels(varied: Varied, rows: Sequence[Row], good: Callable[[Sequence[Row]], object]) -> list[str]:
    """For each robot the levels at which its rows are good."""
    lines = []
    for robot in varied.robots:
        tried = [(level.label, some) for level in varied.levels if (some := level.rows(rows, robot))]
        passed = [label for label, some in tried if good(some)]
        missing = len(varied.levels) - len(tried)
        labels = "all" if len(passed) == len(varied.levels) else ", ".join(passed) or "none"
        labels = f"{labels} ({missing} not run)" if missing else labels
        lines.append(f"  {robot}: {labels if tried else 'not run'}")
    return lines


def _median_of(read: Callable[[Row], float], form: str) -> Callable[[Sequence[Row]], str]:
    return lambda rows: form.format(np.median([read(row) for row in rows]))


searched = {
    "cone problems": _median_of(lambda row: row["solves"], "{:.0f}"),
    "search, s": _median_of(lambda row: row["timings"]["search"], "{:.2f}"),
}
"""Columns on the work of a search."""
posterior_columns = {
    "parameters in 95 %": lambda rows: f"{np.mean([row['parameters_inside'] for row in rows]):.1%}",
    "converged": lambda rows: _share(rows, "converged"),
}
"""Columns on a posterior."""


# ---------------------------------------------------------------------------------------------------------------
# Figure
# ---------------------------------------------------------------------------------------------------------------
def draw(varied: Varied, rows: Sequence[Row], figure: Figure) -> None:
    """Wrong signs, and errors of predicted efforts, over the varied property; one line per robot."""
    from bayesid.studies.figures import error_axis, name_ticks, spreads, wrong_axis

    panels = figure.subplots(1, 2)
    for ax, key in zip(panels, ("wrong", "torque_error"), strict=True):
        if varied.log_x:
            ax.set_xscale("log")
        spreads(ax, {robot: _points(varied, rows, robot, key) for robot in varied.robots})
        name_ticks(ax, {level.label: level.x for level in varied.levels})
    figure.supxlabel(varied.label, fontsize="medium")
    wrong_axis(panels[0])
    error_axis(panels[1])
    panels[0].legend(fontsize=8)


def _points(varied: Varied, rows: Sequence[Row], robot: str, key: str) -> list[tuple[float, list[float]]]:
    points = [(level.x, level.rows(rows, robot)) for level in varied.levels]
    return [(x, [100.0 * _value(row, key) for row in some]) for x, some in points if some]


def _value(row: Row, key: str) -> float:
    return float(1.0 - row["right"] if key == "wrong" else row[key])
