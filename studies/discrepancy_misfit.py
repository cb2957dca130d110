"""Is what is named true where the model or the noise is wrong in all logs alike? With and without a hidden effect.

Cases of `bayesid.studies.blind`. Half of the logs hide nothing: whatever is named in them is false. Printed: how many
effects that pass by their evidence are false before the holdout is asked; what is named falsely after it was; how often
nothing is said to be missing, and how far the holdout's gap is above the true floor then.
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
"""RMS of a hidden effect over that of the noise: clear ones."""


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """The kinds of trouble in turn, every other round with an effect."""
    rng, troubles, effects = np.random.default_rng(seed), list(TROUBLES), generator().EFFECTS
    drawn = []
    for k in range(trials):
        effect = str(rng.choice(effects)) if (k // len(troubles)) % 2 else ""
        size, robot = float(rng.uniform(*_SIZES)), str(rng.choice(["kr5", "random"]))
        scenario = Scenario(effect, size if effect else 0.0, robot, "standard", troubles[k % len(troubles)])
        drawn.append((scenario, int(rng.integers(2**31))))
    return drawn


def report(rows: Sequence[Row]) -> str:
    """One line a kind of trouble, and all of them."""
    rows = decoded(rows)
    lines = [f"{len(rows)} cases", ""]
    for name in TROUBLES:
        of_kind = [row for row in rows if row["trouble"] == name]
        nothing, hiding = ([row for row in of_kind if bool(row["hidden"]) == which] for which in (False, True))
        silent = [row["after"] for row in nothing if row["status"] == "no_discrepancy"]
        lines += [
            f"{name}:",
            f"  {false_before_holdout(of_kind)}",
            f"  nothing hidden, something named: {count(nothing, lambda row: bool(row['named']))}",
            f"  nothing hidden, no_discrepancy:  {count(nothing, lambda row: row['status'] == 'no_discrepancy')}"
            + (f", holdout gap at most {max(silent):.2f} times the true floor" if silent else ""),
            f"  hidden, named (or its class):    {share(hiding, 'all')}",
        ]
    return "\n".join([*lines, "", f"all: {false_before_holdout(rows)}"])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Bayes factors of what passes before the holdout is asked, right and false, by kind of trouble."""
    from bayesid.studies.figures import COLOURS

    rows = decoded(rows)
    figure.set_size_inches(7.5, 3.0)
    axes = figure.subplots()
    for y, name in enumerate(TROUBLES):
        passed = [(gain, false) for row in rows if row["trouble"] == name for gain, false in weighed(row)]
        for which, mark, said in ((False, "o", "right"), (True, "x", "false")):
            gains = [gain for gain, false in passed if false == which]
            axes.plot(gains, np.full(len(gains), y), mark, color=COLOURS[int(which)], label=None if y else said)
    axes.set_xscale("log")
    axes.set_yticks(range(len(TROUBLES)), list(TROUBLES))
    axes.set_xlabel("log10 Bayes factor of what passes, before the holdout is asked")
    axes.legend(loc="upper right", fontsize=8)


STUDY = Study("discrepancy_misfit", 80, plan, trial, report, draw)
