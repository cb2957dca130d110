"""Tables and figure of the study `complete`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.options import Completeness
from bayesid.studies.record import Row

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

MODES: tuple[Completeness, ...] = ("off", "auto")
_COLOUR = {"off": "#c0392b", "auto": "#1b7f79"}
_MARKER = {"off": "s", "auto": "o"}
_ENOUGH = 0.995
"""Share of right signs above which a blind log counts as solved. Chosen; not measured."""
_ASIDE = 0.25
"""Distance of the marks of single logs from the middle of their line."""


def report(rows: Sequence[Row]) -> str:
    """The tables."""
    parts = {
        "classes": _table_of_classes,
        "noise": _table_of_noise,
        "blind": _table_of_blind,
        "pairs": _table_of_pairs,
        "poor": _table_of_poor,
    }
    texts = [f"{len(rows)} logs"]
    for part, table in parts.items():
        chosen = of_part(rows, part)
        texts += [table(chosen)] if chosen else []
    if not of_part(rows, "pairs") and not of_part(rows, "poor"):
        texts.append("no real log was identified: set $BAYESID_DATA to their folder")
    return "\n\n".join(texts)


def of_part(rows: Sequence[Row], part: str) -> list[Row]:
    """The rows of a part of the study."""
    return [row for row in rows if row["part"] == part]


def _by_name(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by name, in the order of first appearance."""
    return {name: [row for row in rows if row["name"] == name] for name in dict.fromkeys(row["name"] for row in rows)}


# ---------------------------------------------------------------------------------------------------------------
# Figures of rows
# ---------------------------------------------------------------------------------------------------------------
def coverage(rows: Sequence[Row], mode: str) -> float:
    """Share of the coefficients inside their 95 % intervals."""
    return sum(row[f"inside_{mode}"] for row in rows) / sum(row[f"coefficients_{mode}"] for row in rows)


def mean_ratio(rows: Sequence[Row], key: str) -> float:
    """Ratio of auto to off, geometric mean over logs."""
    return geometric_mean([row[f"{key}_auto"] / row[f"{key}_off"] for row in rows])


def geometric_mean(values: Sequence[float] | Array) -> float:
    """Of positive values."""
    return float(np.exp(np.mean(np.log(values))))


def torque_ratio(row: Row) -> Array:
    """(n,) ratio of torque errors on the other log, auto to off."""
    ratio: Array = np.array(row["torque_error_auto"]) / np.array(row["torque_error_off"])
    return ratio


def found(hidden: str, entered: Sequence[str]) -> bool:
    """Whether an effect, in any of its forms, was added in its joint."""
    effect, _, joints = hidden.partition(" ")
    return any(
        other.partition(" ")[2] == joints and other.partition(" ")[0].split(".")[0] == effect for other in entered
    )


def _bare(effect: str) -> str:
    """Without joints and form."""
    return effect.partition(" ")[0].partition(".")[0]


def _counted(effects: Sequence[str]) -> str:
    """Effects without their joints, and their counts."""
    counts = Counter(map(_bare, effects))
    return ", ".join(f"{name} {count}" for name, count in counts.most_common()) or "-"


def _both(rows: Sequence[Row], key: str) -> tuple[float, float]:
    """Means of off and auto."""
    off, auto = (float(np.mean([row[f"{key}_{mode}"] for row in rows])) for mode in MODES)
    return off, auto


def _seconds(rows: Sequence[Row]) -> tuple[float, float]:
    """Medians of off and auto; NaN without measurement."""
    off, auto = (np.median([row["timings"].get(mode) or np.nan for row in rows]) for mode in MODES)
    return float(off), float(auto)


# ---------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------
def _table_of_classes(rows: Sequence[Row]) -> str:
    lines = [
        "simulated, off -> auto: coverage of 95 % intervals; mean sd and RMS error, ratio of auto to off; right signs;"
        " median seconds",
        f"{'class':<15} logs       coverage  sd ratio  error ratio  error, off             signs  certified"
        f"       seconds  added: hidden effects, others",
    ]
    for name, chosen in _by_name(rows).items():
        off, auto = (coverage(chosen, mode) for mode in MODES)
        before, after = _both(chosen, "right")
        certified = [sum(row[f"certified_{mode}"] for row in chosen) for mode in MODES]
        error = geometric_mean([row["error_off"] for row in chosen])
        first, second = _seconds(chosen)
        lines.append(
            f"{name:<15} {len(chosen):>4} {off:>6.1%} -> {auto:>5.1%} {mean_ratio(chosen, 'sd'):>9.2f}"
            f" {mean_ratio(chosen, 'error'):>12.2f} {error:>11.2%} {before:>7.2%} -> {after:>7.2%}"
            f" {certified[0]:>3} -> {certified[1]:>2} {first:>5.1f} -> {second:>5.1f}  {_entered(chosen)}"
        )
    return "\n".join(lines)


def _entered(rows: Sequence[Row]) -> str:
    """How many hidden effects were added, and which others."""
    pairs = [(effect, row["entered_auto"]) for row in rows for effect in row["hidden"]]
    right = f"{sum(found(*pair) for pair in pairs)} of {len(pairs)}" if pairs else "-"
    others = [
        effect for row in rows for effect in row["entered_auto"] if not any(found(h, [effect]) for h in row["hidden"])
    ]
    return f"{right}, {_counted(others)}"


def _table_of_noise(rows: Sequence[Row]) -> str:
    lines = [f"no hidden effect, {len(rows)} logs: logs with an added effect, and effects", f"{'noise':<12} logs  any"]
    for name, chosen in _by_name(rows).items():
        effects = [effect for row in chosen for effect in row["entered_auto"]]
        lines.append(f"{name:<12} {len(chosen):>4} {_any(chosen):>4}  {_counted(effects)}")
    lines.append(f"{'all':<12} {len(rows):>4} {_any(rows):>4}  {_any(rows) / len(rows):.1%}")
    return "\n".join(lines)


def _any(rows: Sequence[Row]) -> int:
    return sum(bool(row["entered_auto"]) for row in rows)


def _table_of_blind(rows: Sequence[Row]) -> str:
    lines = [
        f"one or two hidden effects, {len(rows)} logs, off -> auto; an effect counts in each log that has it",
        f"{'hidden':<24} logs    added               signs",
    ]
    for effect in sorted({_bare(hidden) for row in rows for hidden in row["hidden"]}):
        chosen = [row for row in rows if any(_bare(hidden) == effect for hidden in row["hidden"])]
        pairs = [(h, row["entered_auto"]) for row in chosen for h in row["hidden"] if _bare(h) == effect]
        before, after = _both(chosen, "right")
        entered = sum(found(*pair) for pair in pairs)
        lines.append(f"{effect:<24} {len(chosen):>4} {entered:>8} {before:>11.2%} -> {after:>7.2%}")
    for mode in MODES:
        right = [row[f"right_{mode}"] for row in rows]
        certified = sum(row[f"certified_{mode}"] for row in rows)
        lines.append(
            f"{mode:<5} signs right: mean {np.mean(right):.2%}, minimum {min(right):.2%}, at least {_ENOUGH:.1%} in"
            f" {sum(share >= _ENOUGH for share in right)} of {len(rows)}; certified {certified}"
        )
    return "\n".join([*lines, f"added: hidden effects {_entered(rows)}"])


def _table_of_pairs(rows: Sequence[Row]) -> str:
    lines = [
        "torque error on another log, ratio of auto to off, by joint; geometric mean, worst joint, added effects",
        f"{'identified from -> predicted':<32} {'joints':<47}   mean  worst  effects",
    ]
    for row in rows:
        ratio = torque_ratio(row)
        joints = "  ".join(f"{value:5.2f}" for value in ratio)
        effects = ", ".join(row["entered_auto"]) or "-"
        lines.append(f"{row['name']:<32} {joints:<47} {geometric_mean(ratio):>6.3f} {ratio.max():>6.2f}  {effects}")
    every = np.concatenate([torque_ratio(row) for row in rows])
    lines.append(f"{'all':<32} {'':<47} {geometric_mean(every):>6.3f} {every.max():>6.2f}")
    lines += ["", "torque error, off, N m"]
    return "\n".join(
        lines + [f"{r['name']:<32} " + "  ".join(f"{e:5.2f}" for e in r["torque_error_off"]) for r in rows]
    )


def _table_of_poor(rows: Sequence[Row]) -> str:
    lines = ["signs right where the standard model is poor: all joints, each joint"]
    for row in rows:
        for mode in MODES:
            joints = "  ".join(f"{share:7.2%}" for share in row[f"joints_{mode}"])
            proven = "certified" if row[f"certified_{mode}"] else ""
            lines.append(f"{row['name']:<10} {mode:<5} {row[f'right_{mode}']:>7.2%}   {joints}  {proven}".rstrip())
        lines.append(f"{'':<10} added: {', '.join(row['entered_auto']) or '-'}")
    return "\n".join(lines)


# ---------------------------------------------------------------------------------------------------------------
# Figure
# ---------------------------------------------------------------------------------------------------------------
def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Coverage of each class in both modes, and ratios of torque errors on another log by joint."""
    figure.set_size_inches(9.0, 4.2)
    left, right = figure.subplots(1, 2)
    _draw_coverage(of_part(rows, "classes"), left)
    _draw_torque_errors(of_part(rows, "pairs"), right)


def _draw_coverage(rows: Sequence[Row], ax: Any) -> None:
    classes = _by_name(rows)
    for y, chosen in enumerate(classes.values()):
        off, auto = (100.0 * coverage(chosen, mode) for mode in MODES)
        ax.plot([off, auto], [y, y], color="#bbbbbb", lw=1.0, zorder=1)
        for mode, share, shift in zip(MODES, (off, auto), (-_ASIDE, _ASIDE), strict=True):
            single = [100.0 * row[f"inside_{mode}"] / row[f"coefficients_{mode}"] for row in chosen]
            ax.plot(single, np.full(len(single), y + shift), "|", color=_COLOUR[mode], ms=4, alpha=0.5)
            ax.plot(share, y, _MARKER[mode], color=_COLOUR[mode], ms=6, label=_first(mode, y))
    ax.axvline(95.0, color="#999999", lw=0.8)
    ax.set_yticks(range(len(classes)), list(classes), fontsize=8)
    ax.invert_yaxis()
    ax.set_xlabel("coefficients inside their 95 % intervals, %\n(small: single logs)")
    if classes:
        ax.legend(fontsize=8)


def _draw_torque_errors(rows: Sequence[Row], ax: Any) -> None:
    pairs = {name: chosen[0] for name, chosen in _by_name(rows).items()}
    for y, row in enumerate(pairs.values()):
        ratio = torque_ratio(row)
        ax.plot(ratio, np.full(len(ratio), y), "o", color=_COLOUR["auto"], ms=4, alpha=0.6, label=_first("joint", y))
        mean = geometric_mean(ratio)
        ax.plot([mean, mean], [y - 0.35, y + 0.35], color="#444444", lw=2, label=_first("geometric mean", y))
    ax.axvline(1.0, color="#999999", lw=0.8)
    ax.set_yticks(range(len(pairs)), list(pairs), fontsize=7)
    ax.invert_yaxis()
    ax.set_xlabel("torque error on the other log, auto over off")
    if pairs:
        ax.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)


def _first(label: str, place: int) -> str | None:
    """The label for the first place only, for the legend."""
    return label if place == 0 else None
