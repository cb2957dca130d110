"""Nonlinear numbers of terms, between those that the library holds."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import scipy

from bayesid.regression.selection.explanation import Observations, Regression
from bayesid.regression.selection.hypotheses import Hypothesis, Library
from bayesid.regression.selection.scores import explain_with
from bayesid.regression.selection.screening import Screening

_EVALUATIONS = 12
"""In the search for a nonlinear number: golden sections narrow its bracket to a hundredth or better."""
_NOTICED = 0.01
"""Nats by which another number must be likelier to take the place of what it is: less is the search's resolution."""


def refined(
    data: Observations, effects: Sequence[Hypothesis], library: Library, joints: Collection[int] | None = None
) -> list[Hypothesis]:
    """Effects with their nonlinear numbers where they fit best, each given all others.

    Args:
        data: what is to be explained.
        effects: that explain it.
        library: all hypotheses; a number stays between its neighbours there.
        joints: (0-based) effects that act in none of these stay as they are; by default all are looked at.
    """
    effects = list(effects)
    for k, effect in enumerate(effects):
        if joints is not None and effect.columns.joints.isdisjoint(joints):
            continue
        grid = _grid(effect, library)
        if grid is not None:
            effects[k] = _fitted(data, effect, effects[:k] + effects[k + 1 :], *grid)
    return effects


def _fitted(
    data: Observations, effect: Hypothesis, others: Sequence[Hypothesis], number: str, values: Sequence[float]
) -> Hypothesis:
    """One effect with its number between the neighbours of what it is."""
    _, explanation = explain_with(data, [*others, effect])
    screening = Screening(Regression(data, [other.columns for other in others]), explanation.errors)

    def cost(value: float) -> float:
        return -float(screening.gains([effect.remade(number, value).columns])[0][0])

    now = effect.source.shape[number][0]
    bounds = max((v for v in values if v < now), default=now), min((v for v in values if v > now), default=now)
    best = scipy.optimize.minimize_scalar(cost, bounds=bounds, method="bounded", options={"maxiter": _EVALUATIONS})
    return effect.remade(number, float(best.x)) if best.fun < cost(now) - _NOTICED else effect


def _grid(effect: Hypothesis, library: Library) -> tuple[str, Sequence[float]] | None:
    """The nonlinear number that the library varies for this form, the sides of others left out; and its values."""
    alike = (
        h.source for group in library for h in group if h.key == effect.key and h.source.name == effect.source.name
    )
    forms = list(alike)
    for key in effect.source.sought:
        tried = {tuple(form.shape[key]) for form in forms}
        if len(effect.source.shape[key]) == 1 and len(tried) > 2:
            return key, sorted(value for (value,) in tried)
    return None
