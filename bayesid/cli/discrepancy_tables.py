"""What ends `bayesid discrepancy`."""

from __future__ import annotations

import numpy as np
from rich.console import RenderableType

from bayesid.cli.tables import line_of
from bayesid.cli.terminal import table
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.report.discrepancy_verdicts import discrepancy_checks, equivalents, lead, listed_sets, set_in_words


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
            ", ".join(equivalents(added, str)),
        ]
        for added in result.added
    ]
    headings = ["effect", "joints", "log10 Bayes factor", "probability", "equivalent"]
    parts += ["", table(headings, effects, left=["effect", "joints", "equivalent"])]
    sets = [[set_in_words(one), f"{one.probability:.2f}"] for one in listed_sets(result)]
    return [*parts, "", table(["set", "probability"], sets, left=["set"])] if len(sets) > 1 else parts
