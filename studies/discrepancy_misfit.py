"""Are false effects named where model or noise is wrong in all logs? With and without a hidden effect.

Logs of `bayesid.studies.blind`. Half of the cases have no hidden effect: every named effect is false. The report gives
false effects before and after the holdout, the share of `no_discrepancy`, and the holdout's gap over the noise floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesid.studies.discrepancy import (
    TROUBLES,
    Scenario,
    count,
    decoded,
    false_before_holdout,
    generator,
    share,
    trial,
    weighed,
)
from bayesid.studies.record import Row
from bayesid.studies.study import Study

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

_SIZES = (2.0, 5.0)
"""RMS of a hidden effect over that of the noise."""


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """The kinds of error in turn, every other round with a hidden effect."""
    rng, troubles, effects = np.random.default_rng(seed), list(TROUBLES), generator().EFFECTS
    drawn = []
    for k in range(trials):
        effect = str(rng.choice(effects)) if (k // len(troubles)) % 2 else ""
        size, robot = float(rng.uniform(*_SIZES)), str(rng.choice(["kr5", "random"]))
        scenario = Scenario(effect, size if effect else 0.0, robot, "standard", troubles[k % len(troubles)])
        drawn.append((scenario, int(rng.integers(2**31))))
    return drawn


def report(rows: Sequence[Row]) -> str:
    """A paragraph per kind of error, and all of them."""
    rows = decoded(rows)
    lines = [f"{len(rows)} cases", ""]
    for name in TROUBLES:
        of_kind = [row for row in rows if row["trouble"] == name]
        nothing, hiding = ([row for row in of_kind if bool(row["hidden"]) == which] for which in (False, True))
        silent = [row["after"] for row in nothing if row["status"] == "no_discrepancy"]
        lines += [
            f"{name}:",
            f"  {false_before_holdout(of_kind)}",
            f"  no hidden effect, one named:      {count(nothing, lambda row: bool(row['named']))}",
            f"  no hidden effect, no_discrepancy: {count(nothing, lambda row: row['status'] == 'no_discrepancy')}"
            + (f", holdout gap at most {max(silent):.2f} times the noise floor" if silent else ""),
            f"  hidden effect, named (or class):  {share(hiding, 'all')}",
        ]
    return "\n".join([*lines, "", f"all: {false_before_holdout(rows)}"])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Bayes factors of right and false effects before the holdout, by kind of error."""
    from bayesid.studies.figures import COLOURS

    rows = decoded(rows)
    figure.set_size_inches(7.5, 3.0)
    axes = figure.subplots()
    for y, name in enumerate(TROUBLES):
        passed = [(gain, false) for row in rows if row["trouble"] == name for gain, false in weighed(row)]
        for which, mark, text in ((False, "o", "right"), (True, "x", "false")):
            gains = [gain for gain, false in passed if false == which]
            axes.plot(gains, np.full(len(gains), y), mark, color=COLOURS[int(which)], label=None if y else text)
    axes.set_xscale("log")
    axes.set_yticks(range(len(TROUBLES)), list(TROUBLES))
    axes.set_xlabel("log10 Bayes factor of effects with decisive evidence, before the holdout")
    axes.legend(loc="upper right", fontsize=8)


STUDY = Study("discrepancy_misfit", 80, plan, trial, report, draw)
