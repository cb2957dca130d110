"""Errors of the robot's table that were there all along: the earlier log shows them too, and has bent the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.regression.selection.explanation import LN10, Explanation, Observations
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis


def all_along(
    data: Observations, without: Explanation, library: Sequence[Sequence[Hypothesis]]
) -> frozenset[EffectKey]:
    """Errors of the table that cannot have come since the earlier log: they do not show above the noise floor.

    The floor holds what the earlier model left of its own log. An error that was there already is a part of it, however
    well it explains what this log leaves; one that is new adds to it, most of all in the joint where it is largest.

    Args:
        data: what is to be explained.
        without: the explanation by the model alone.
        library: all hypotheses.
    """
    limits = data.thresholds
    most = np.where(data.sharp, limits.above_floor, limits.above_blunt_floor)
    above = data.mean_square(without.residual) > most**2
    return frozenset(h.key for group in library for h in group if h.source.of_table and not above[_strongest(data, h)])


def was_there(data: Observations, with_it: Explanation, without: Explanation) -> bool:
    """Whether the earlier log speaks against an error of the table, as surely as an effect must be found.

    A model that was bent by the error fits it badly: its coefficients have to move far from what that log showed.
    Those of a model that was right then stay, and without the error they would have to move.

    Args:
        data: what is explained.
        with_it: the explanation with the error.
        without: the same without it.
    """
    against = 0.5 * (data.information.misfit(with_it.beta) - data.information.misfit(without.beta))
    return against > data.thresholds.log10_bayes_factor * LN10


def _strongest(data: Observations, hypothesis: Hypothesis) -> int:
    """The (0-based) joint in which an effect is largest beside the noise."""
    rows, used = hypothesis.columns.rows, data.used
    size = {j: float(np.mean(x[used[:, j]] ** 2)) / data.floor[j] ** 2 for j, x in rows.items() if used[:, j].any()}
    return max(size, key=lambda j: size[j]) if size else 0
