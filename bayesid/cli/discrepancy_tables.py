"""What ends `bayesid discrepancy`."""

from __future__ import annotations

import numpy as np
from rich.console import RenderableType

from bayesid.cli.tables import line_of
from bayesid.cli.terminal import table
from bayesid.discrepancy.comparison import ALL_ALONG, CHANGED, LogComparison
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.report.discrepancy_verdicts import discrepancy_checks, equivalents, lead, listed_sets, set_in_words
from bayesid.report.timeline_text import SECTIONS, columns, log_names, moved_parameters, timeline_rule
from bayesid.report.words import in_percent, rounded, unit_of


def discrepancy_parts(result: Discrepancy) -> list[RenderableType]:
    """Verdicts, gaps and effects."""
    gaps = zip(result.before, result.after, result.floor.rms, result.floor.white, strict=True)
    rows = [[str(j), *(f"{gap:.4g}" for gap in joint)] for j, joint in enumerate(gaps, start=1)]
    parts: list[RenderableType] = [lead(result), *map(line_of, discrepancy_checks(result)), ""]
    parts.append(f"gap on {result.holdout}, RMS in N m:")
    parts.append(table(["joint", "before", "after", "floor", "of it white"], rows))
    if not result.added:
        return parts
    effects = [
        [
            f"{added.effect} of {', '.join(added.variables)}" if added.variables else added.effect,
            ",".join(map(str, added.joints)) or "all",
            f"{added.gain / np.log(10.0):.1f}",
            f"{added.probability:.3f}",
            _ignored(result, added),
            ", ".join(equivalents(added, str)),
        ]
        for added in result.added
    ]
    headings = ["effect", "joints", "log10 Bayes factor", "probability", "ignored -> with it", "equivalent"]
    parts += ["", table(headings, effects, left=["effect", "joints", "ignored -> with it", "equivalent"])]
    sets = [[set_in_words(one), f"{one.probability:.2f}"] for one in listed_sets(result)]
    return [*parts, "", table(["set", "probability"], sets, left=["set"])] if len(sets) > 1 else parts


def comparison_parts(result: LogComparison) -> list[RenderableType]:
    """What changed, what was missing all along, and the parameters that moved."""
    parts: list[RenderableType] = []
    for which, lines in columns(result).items():
        if lines or which in (CHANGED, ALL_ALONG):
            parts += [f"{SECTIONS[which]}:", *(f"  {line}" for line in lines or ["nothing that these logs show"]), ""]
    rows = [
        [row.name, *map(rounded, row.value), row.unit, row.change, f"{[z for z in row.z if np.isfinite(z)][-1]:.1f}"]
        for row in moved_parameters(result)
    ]
    if rows:
        headings = ["moved", *log_names(result), "unit", "change", "change / its sd"]
        parts += [table(headings, rows, left=["moved", "unit"])]
    return [*parts, timeline_rule(result)]


def _ignored(result: Discrepancy, added: AddedEffect) -> str:
    """16.5 -> 7.16 N m (10 -> 4.5 %) in joint 2: the error on held-back data without an effect, and with it."""
    if added.cost is None:
        return ""
    cost, (before, after) = added.cost, map(in_percent, (added.cost.share_before, added.cost.share_after))
    errors = f"{rounded(cost.before)} -> {rounded(cost.after)} {unit_of(result, cost.joint)}"
    return f"{errors} ({before.removesuffix(' %')} -> {after}) in joint {cost.joint}"
