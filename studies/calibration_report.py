"""Tables and figure of the studies `calibration` and `misfit`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesid.arrays import Array
from bayesid.studies.preference import CLEARLY
from bayesid.studies.record import Row

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

EDGES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999)
"""Where the bins of confidence begin; the last one ends at 1."""
_PALETTE = ("#1b7f79", "#c0392b", "#2c5d9b")
_GROUPS = (
    ("colour", "AR(1) {:g}"),
    ("duration", "{:g} s"),
    ("noise", "noise {:.0%}"),
    ("robot", "{}"),
    ("level", "misfit {:.0%}"),
)
"""By which own logs are told apart."""
_FILTERED = "filtered"
"""How the classes begin whose efforts were filtered behind the rectifier: targets of their own hold for them."""
_KINDS = 3
"""Kinds of coefficients that are named, those outside of their intervals most often."""


# ---------------------------------------------------------------------------------------------------------------
# Figures of rows
# ---------------------------------------------------------------------------------------------------------------
def calibration_error(bins: Array) -> float:
    """Expected calibration error of bins (B, 3) of count, right and sum of confidences; NaN of none."""
    count = bins[:, 0].sum()
    return float(np.abs(bins[:, 1] - bins[:, 2]).sum() / count) if count else float("nan")


def summed(rows: Sequence[Row], kind: str) -> Array:
    """(B, 3) the bins of all rows together."""
    return np.sum([row[kind] for row in rows], axis=0)


def clustered(totals: Sequence[float], counts: Sequence[float]) -> tuple[float, float]:
    """A mean over all items of all logs, and its standard error; NaN where there is none.

    Items of one log share its data: logs are drawn, not items. So the error is that of a ratio of two sums over
    clusters (Cochran 1977, section 2.11).

    Args:
        totals: sum over the items of each log.
        counts: items of each log.
    """
    total, count = np.array(totals, dtype=float), np.array(counts, dtype=float)
    if not count.sum():
        return float("nan"), float("nan")
    mean = total.sum() / count.sum()
    if len(count) < 2:
        return float(mean), float("nan")
    square = np.sum((total - mean * count) ** 2) * len(count) / (len(count) - 1)
    return float(mean), float(np.sqrt(square) / count.sum())


def coverage(rows: Sequence[Row]) -> tuple[float, float]:
    """Share of all coefficients inside their intervals, and its standard error."""
    return clustered([row["inside"] for row in rows], [row["coefficients"] for row in rows])


def modesty(rows: Sequence[Row], kind: str) -> tuple[float, float]:
    """Share that is right less mean confidence, and its standard error."""
    bins = np.array([np.sum(row[kind], axis=0) for row in rows])
    return clustered((bins[:, 1] - bins[:, 2]).tolist(), bins[:, 0].tolist())


def quantiles(rows: Sequence[Row]) -> tuple[float, float]:
    """The 10 % and 50 % quantile over logs of the share of coefficients inside their intervals."""
    low, middle = np.quantile([row["inside"] / row["coefficients"] for row in rows if row["coefficients"]], [0.1, 0.5])
    return float(low), float(middle)


def at_least(bins: Array, confidence: float) -> tuple[int, int]:
    """How many have at least a confidence (one of `EDGES`), and how many of them are wrong."""
    count, right, _ = bins[EDGES.index(confidence) :].sum(axis=0)
    return int(count), int(count - right)


def refuted(rows: Sequence[Row]) -> list[Row]:
    """The certified ones of which the data prefer other signs."""
    return [row for row in rows if row["certified"] and row["preference"] > CLEARLY]


# ---------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------
def report(rows: Sequence[Row]) -> str:
    """The tables."""
    own = [row for row in rows if row["part"] == "own"]
    classes = [row for row in rows if row["part"] == "classes"]
    texts = [f"{len(rows)} logs, {np.mean([row['right'] for row in rows]):.2%} of the samples' signs right"]
    texts += [_tables_of_own(own)] if own else []
    texts += [_tables_of_classes(own, classes)] if classes else []
    return "\n\n".join([*texts, _ending(rows)])


def _ending(rows: Sequence[Row]) -> str:
    count, seconds = len(rows), [row["timings"]["seconds"] for row in rows]
    return (
        f"certified {sum(row['certified'] for row in rows)} of {count}, "
        f"converged {sum(row['converged'] for row in rows)} of {count}, "
        f"more than one mode {sum(row['modes'] > 1 for row in rows)}; "
        f"seconds a log: median {np.median(seconds):.1f}, most {max(seconds):.1f}"
    )


def _tables_of_own(rows: Sequence[Row]) -> str:
    """By robot, noise and length."""
    lines = [f"own simulator, standard terms alone: {len(rows)} logs"]
    for kind in ("samples", "segments"):
        lines += ["", f"of {kind} given a confidence in the bin, the share that is right (count)", _header()]
        for name, chosen in _groups(rows):
            bins = summed(chosen, kind)
            shares = [f"{right / count:7.2%} {int(count):>7}" if count else f"{'':15}" for count, right, _ in bins]
            lines.append(f"{name:<16} {calibration_error(bins):7.4f}  " + "  ".join(shares))
    lines += ["", "95 % intervals that hold the true coefficient; of the single logs the 10 % and 50 % quantile"]
    for name, chosen in _groups(rows):
        low, middle = quantiles(chosen)
        lines.append(f"{name:<16} {coverage(chosen)[0]:7.1%}  {low:7.1%} {middle:7.1%}")
    return "\n".join(lines)


def _header() -> str:
    names = [f"[{low:g}, {high:g})" for low, high in zip(EDGES, (*EDGES[1:], 1.0), strict=True)]
    return f"{'':<16} {'ECE':>7}  " + "  ".join(f"{name:>15}" for name in names)


def _groups(rows: Sequence[Row]) -> list[tuple[str, Sequence[Row]]]:
    """All rows, then those of each value of what they differ in."""
    groups: list[tuple[str, Sequence[Row]]] = [("all", rows)]
    for key, form in _GROUPS:
        values = list(dict.fromkeys(row[key] for row in rows))
        ordered = values if key == "robot" else sorted(values)
        groups += [(form.format(value), [row for row in rows if row[key] == value]) for value in ordered]
    return [(name, chosen) for name, chosen in groups if name == "all" or len(chosen) < len(rows)]


def _tables_of_classes(own: Sequence[Row], classes: Sequence[Row]) -> str:
    """One line a class, the own logs for comparison, and all classes pooled."""
    by_name = {
        name: [row for row in classes if row["name"] == name] for name in dict.fromkeys(r["name"] for r in classes)
    }
    lines = {"own": own, **by_name, "all classes": classes}
    unfiltered = [row for row in classes if not row["name"].startswith(_FILTERED)]
    lines["but filtered"] = unfiltered if len(unfiltered) < len(classes) else []
    shown = {name: rows for name, rows in lines.items() if rows}
    tables = (_intervals, _signs, _certificates)
    return "\n\n".join(table(shown) for table in tables)


def _intervals(groups: dict[str, Sequence[Row]]) -> str:
    lines = [
        "95 % intervals that hold the true coefficient of the standard terms, +- one standard error (by log); of the",
        "single logs the 10 % and 50 % quantile; of those outside, how many from which kind of parameter, and how many",
        "standard deviations off (median)",
        f"{'class':<15} logs    coverage          10 %   50 %  converged  seconds  outside",
    ]
    for name, rows in groups.items():
        (share, error), (low, middle) = coverage(rows), quantiles(rows)
        converged, seconds = sum(row["converged"] for row in rows), np.median([r["timings"]["seconds"] for r in rows])
        lines.append(
            f"{name:<15} {len(rows):>4} {share:>7.1%} +- {error:>5.1%} {low:>8.1%} {middle:>6.1%}"
            f" {converged:>6} of {len(rows):<3} {seconds:>5.1f}  {outside(rows)}".replace("nan%", "  - ")
        )
    return "\n".join(lines)


def outside(rows: Sequence[Row]) -> str:
    """The kinds of coefficients that intervals miss most often: count, and the median error in standard deviations."""
    missed = [(kind_of(name), abs(z)) for row in rows for name, z in zip(row["missed"], row["missed_by"], strict=True)]
    counts = Counter(kind for kind, _ in missed).most_common(_KINDS)
    said = [f"{kind} {count} ({np.median([z for k, z in missed if k == kind]):.1f} sd)" for kind, count in counts]
    return ", ".join(said) or "-"


def kind_of(name: str) -> str:
    """What a coefficient is of, without link and axis: of J3xy, J."""
    return re.split(r"\d", name, maxsplit=1)[0]


def _signs(groups: dict[str, Sequence[Row]]) -> str:
    lines = [
        "signs: the expected calibration error of samples and of segments; the share of samples that is right, and",
        "that less the mean confidence, +- one standard error (by log); the same at rest; samples given at least",
        "0.999, at least 0.99, and how many are wrong",
        f"{'class':<15} ECE samples segments    right    less confidence   at rest    right    less confidence"
        f"    >= 0.999  wrong    >= 0.99  wrong",
    ]
    for name, rows in groups.items():
        samples, segments = summed(rows, "samples"), summed(rows, "segments")
        (sure, sure_wrong), (strong, strong_wrong) = at_least(samples, 0.999), at_least(samples, 0.99)
        lines.append(
            f"{name:<15} {calibration_error(samples):>11.4f} {calibration_error(segments):>8.4f}"
            f" {_right(rows, 'samples')} {int(summed(rows, 'rest')[:, 0].sum()):>9} {_right(rows, 'rest')}"
            f" {sure:>11} {sure_wrong:>6} {strong:>10} {strong_wrong:>6}"
        )
    return "\n".join(lines)


def _right(rows: Sequence[Row], kind: str) -> str:
    """The share that is right, and that less the mean confidence."""
    count, right, _ = summed(rows, kind).sum(axis=0)
    less, error = modesty(rows, kind)
    share = right / count if count else float("nan")
    return f"{share:>8.2%} {less:>+8.2%} +- {error:>6.2%}".replace("+nan%", "   -").replace("nan%", "  - ")


def _certificates(groups: dict[str, Sequence[Row]]) -> str:
    lines = [
        "certified; of these, those of which the data prefer other signs once the pull is removed (refuted), and by",
        "how much at most (cost, twice the nats); more than one mode, and the heaviest one's mean weight there; what",
        "entered",
        f"{'class':<15} certified    refuted    most  modes  weight  entered",
    ]
    for name, rows in groups.items():
        certified, wrong = sum(row["certified"] for row in rows), refuted(rows)
        several = [row for row in rows if row["modes"] > 1]
        most = f"{max(row['preference'] for row in wrong):.1f}" if wrong else "-"
        weight = f"{np.mean([row['heaviest'] for row in several]):.2f}" if several else "-"
        entered = Counter(effect.partition(".")[0] for row in rows for effect in row["entered"])
        lines.append(
            f"{name:<15} {certified:>3} of {len(rows):<3} {len(wrong):>8} {most:>7} {len(several):>6} {weight:>7}  "
            + (", ".join(f"{effect} {count}" for effect, count in entered.most_common()) or "-")
        )
    return "\n".join(lines)


# ---------------------------------------------------------------------------------------------------------------
# Figure
# ---------------------------------------------------------------------------------------------------------------
def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Shares of right signs over what was claimed of them, and of true coefficients inside their intervals."""
    of_signs, of_intervals = figure.subplots(1, 2)
    of_signs.plot([0.5, 1.0], [0.5, 1.0], color="#999999", lw=0.8)
    for kind, colour, marker in (("samples", _PALETTE[0], "o"), ("segments", _PALETTE[1], "s")):
        bins = summed(rows, kind)
        some = bins[bins[:, 0] > 0]
        share = some[:, 1] / some[:, 0]
        bars = 1.96 * np.sqrt(np.maximum(share * (1.0 - share), 1e-12) / some[:, 0])
        of_signs.errorbar(some[:, 2] / some[:, 0], share, bars, fmt=marker, ms=4, color=colour, capsize=2, label=kind)
    of_signs.set_xlabel("confidence, mean of the bin")
    of_signs.set_ylabel("share of right signs")
    of_signs.legend(fontsize=8)
    for part, colour in (("own", _PALETTE[2]), ("classes", _PALETTE[0])):
        chosen = [row for row in rows if row["part"] == part and row["coefficients"]]
        shares = np.sort([100.0 * row["inside"] / row["coefficients"] for row in chosen])
        of_intervals.step(shares, np.arange(1, len(shares) + 1) / max(len(shares), 1), color=colour, label=part)
    of_intervals.axvline(95.0, color="#999999", lw=0.8)
    of_intervals.set_xlabel("coefficients inside their 95 % intervals, %")
    of_intervals.set_ylabel("share of logs with at most this")
    of_intervals.legend(fontsize=8)
