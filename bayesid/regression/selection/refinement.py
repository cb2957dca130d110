"""Effects with their own numbers where they fit best: sought between those that the library holds."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import scipy

from bayesid.regression.selection.explanation import Observations
from bayesid.regression.selection.hypotheses import Hypothesis, Library
from bayesid.regression.selection.regression import Regression, explain
from bayesid.regression.tuning import TUNING


def refined(
    data: Observations, effects: Sequence[Hypothesis], library: Library, joints: Collection[int] | None = None
) -> list[Hypothesis]:
    """Effects with their nonlinear numbers where they fit best, each given all others.

    A number stays between its neighbours in the library. Effects that act in none of some (0-based) joints stay as they
    are; by default all are looked at.
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
    regression = Regression(data, others, explain(data, [*others, effect]).errors)

    def cost(value: float) -> float:
        return -float(regression.screened([effect.remade(number, value).columns])[0][0])

    now = effect.source.shape[number][0]
    bounds = max((v for v in values if v < now), default=now), min((v for v in values if v > now), default=now)
    best = scipy.optimize.minimize_scalar(
        cost, bounds=bounds, method="bounded", options={"maxiter": TUNING.number_evaluations}
    )
    return effect.remade(number, float(best.x)) if best.fun < cost(now) - TUNING.noticed else effect


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
