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
"""Fields by which own logs are grouped."""
_FILTERED = "filtered"
"""Begin of the names of classes whose efforts were filtered behind the rectifier; also pooled without them."""
_KINDS = 3
"""Number of kinds of coefficients that are listed, most frequent first."""


# ---------------------------------------------------------------------------------------------------------------
# Figures of rows
# ---------------------------------------------------------------------------------------------------------------
def calibration_error(bins: Array) -> float:
    """Expected calibration error of bins (B, 3) of count, right and sum of confidences; NaN if all are empty."""
    count = bins[:, 0].sum()
    return float(np.abs(bins[:, 1] - bins[:, 2]).sum() / count) if count else float("nan")


def summed(rows: Sequence[Row], kind: str) -> Array:
    """(B, 3) the bins of all rows together."""
    return np.sum([row[kind] for row in rows], axis=0)


def clustered(totals: Sequence[float], counts: Sequence[float]) -> tuple[float, float]:
    """A mean over all items of all logs, and its standard error; NaN without items.

    Items of one log are not independent: the error is that of a ratio of two sums over clusters (Cochran 1977,
    section 2.11).

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


def underconfidence(rows: Sequence[Row], kind: str) -> tuple[float, float]:
    """Share of right signs minus mean confidence, and its standard error."""
    bins = np.array([np.sum(row[kind], axis=0) for row in rows])
    return clustered((bins[:, 1] - bins[:, 2]).tolist(), bins[:, 0].tolist())


def quantiles(rows: Sequence[Row]) -> tuple[float, float]:
    """The 10 % and 50 % quantile over logs of the share of coefficients inside their intervals."""
    low, middle = np.quantile([row["inside"] / row["coefficients"] for row in rows if row["coefficients"]], [0.1, 0.5])
    return float(low), float(middle)


def at_least(bins: Array, confidence: float) -> tuple[int, int]:
    """Number of signs with at least a confidence (one of `EDGES`), and number of wrong ones among them."""
    count, right, _ = bins[EDGES.index(confidence) :].sum(axis=0)
    return int(count), int(count - right)


def refuted(rows: Sequence[Row]) -> list[Row]:
    """Rows that are certified although the data prefer other signs."""
    return [row for row in rows if row["certified"] and row["preference"] > CLEARLY]


# ---------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------
def report(rows: Sequence[Row]) -> str:
    """The tables."""
    own = [row for row in rows if row["part"] == "own"]
    classes = [row for row in rows if row["part"] == "classes"]
    texts = [f"{len(rows)} logs, {100 * np.mean([row['right'] for row in rows]):.2f} % of the samples' signs right"]
    texts += [_tables_of_own(own)] if own else []
    texts += [_tables_of_classes(own, classes)] if classes else []
    return "\n\n".join([*texts, _ending(rows)])


def _ending(rows: Sequence[Row]) -> str:
    count, seconds = len(rows), [row["timings"]["seconds"] for row in rows]
    return (
        f"certified {sum(row['certified'] for row in rows)} of {count}, "
        f"converged {sum(row['converged'] for row in rows)} of {count}, "
        f"more than one mode {sum(row['modes'] > 1 for row in rows)}; "
        f"seconds per log: median {np.median(seconds):.1f}, maximum {max(seconds):.1f}"
    )


def _tables_of_own(rows: Sequence[Row]) -> str:
    """By robot, noise and length."""
    lines = [f"bayesid's simulator, standard terms only: {len(rows)} logs"]
    for kind in ("samples", "segments"):
        lines += ["", f"share of right signs of {kind}, and their count, by confidence", _header()]
        for name, chosen in _groups(rows):
            bins = summed(chosen, kind)
            shares = [f"{right / count:7.2%} {int(count):>7}" if count else f"{'':15}" for count, right, _ in bins]
            lines.append(f"{name:<16} {calibration_error(bins):7.4f}  " + "  ".join(shares))
    lines += ["", "coverage of 95 % intervals: all logs, 10 % and 50 % quantile over logs"]
    for name, chosen in _groups(rows):
        low, middle = quantiles(chosen)
        lines.append(f"{name:<16} {coverage(chosen)[0]:7.1%}  {low:7.1%} {middle:7.1%}")
    return "\n".join(lines)


def _header() -> str:
    names = [f"[{low:g}, {high:g})" for low, high in zip(EDGES, (*EDGES[1:], 1.0), strict=True)]
    return f"{'':<16} {'ECE':>7}  " + "  ".join(f"{name:>15}" for name in names)


def _groups(rows: Sequence[Row]) -> list[tuple[str, Sequence[Row]]]:
    """All rows, then groups by each field in which they differ."""
    groups: list[tuple[str, Sequence[Row]]] = [("all", rows)]
    for key, form in _GROUPS:
        values = list(dict.fromkeys(row[key] for row in rows))
        ordered = values if key == "robot" else sorted(values)
        groups += [(form.format(value), [row for row in rows if row[key] == value]) for value in ordered]
    return [(name, chosen) for name, chosen in groups if name == "all" or len(chosen) < len(rows)]


def _tables_of_classes(own: Sequence[Row], classes: Sequence[Row]) -> str:
    """One line per class, own logs for comparison, and all classes pooled."""
    by_name = {
        name: [row for row in classes if row["name"] == name] for name in dict.fromkeys(r["name"] for r in classes)
    }
    lines = {"own": own, **by_name, "all classes": classes}
    unfiltered = [row for row in classes if not row["name"].startswith(_FILTERED)]
    lines["not filtered"] = unfiltered if len(unfiltered) < len(classes) else []
    shown = {name: rows for name, rows in lines.items() if rows}
    tables = (_intervals, _signs, _certificates)
    return "\n\n".join(table(shown) for table in tables)


def _intervals(groups: dict[str, Sequence[Row]]) -> str:
    lines = [
        "coverage of 95 % intervals, standard terms, +- one standard error (clustered by log); 10 % and 50 % quantile",
        "over logs; coefficients outside: kind, count, median error in standard deviations",
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
    """The kinds of coefficients most often outside their intervals: count, median error in standard deviations."""
    missed = [(kind_of(name), abs(z)) for row in rows for name, z in zip(row["missed"], row["missed_by"], strict=True)]
    counts = Counter(kind for kind, _ in missed).most_common(_KINDS)
    texts = [f"{kind} {count} ({np.median([z for k, z in missed if k == kind]):.1f} sd)" for kind, count in counts]
    return ", ".join(texts) or "-"


def kind_of(name: str) -> str:
    """A coefficient's symbol without link and axis: J of J3xy."""
    return re.split(r"\d", name, maxsplit=1)[0]


def _signs(groups: dict[str, Sequence[Row]]) -> str:
    lines = [
        "signs: expected calibration error (ECE) of samples and segments; share of right samples, and this minus mean",
        "confidence +- one standard error (clustered by log); the same at rest; confident samples, and wrong ones",
        f"{'class':<15} ECE samples segments    right   minus confidence   at rest    right   minus confidence"
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
    """The share of right signs, and this minus the mean confidence."""
    count, right, _ = summed(rows, kind).sum(axis=0)
    difference, error = underconfidence(rows, kind)
    share = right / count if count else float("nan")
    return f"{share:>8.2%} {difference:>+8.2%} +- {error:>6.2%}".replace("+nan%", "   -").replace("nan%", "  - ")


def _certificates(groups: dict[str, Sequence[Row]]) -> str:
    lines = [
        "certified; refuted: certified, but other signs cost less without the Tikhonov term, and by how much (twice",
        "the nats); logs with more than one mode, and mean weight of the heaviest; added effects",
        f"{'class':<15} certified    refuted largest  modes  weight  added",
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
    """Share of right signs over confidence, and distribution of coverage over logs."""
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
