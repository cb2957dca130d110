"""Effects with their own numbers where they fit best, and the model with these effects added.

Nonlinear numbers of terms are sought between those that the library holds. Distortions are linear in their numbers near
them alone, so that they are linearised about those that were found, again and again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.effect import Scene
from bayesid.effects.model import Model
from bayesid.regression.knowledge import Knowledge
from bayesid.regression.selection.explanation import Explanation, Observations
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


def sharpened(
    data: Observations, effects: Sequence[Hypothesis], columns: Array, scene_of: Callable[[Array], Scene]
) -> Explanation:
    """By the effects, linearised about the numbers that were found.

    Args:
        data: what is to be explained.
        effects: some of them distortions, or none.
        columns: (N, n, r) of the model, at samples that are not used too.
        scene_of: what effects may look at, given the efforts (N, n) of model and terms, N m.
    """
    explanation = explain(data, effects)
    for _ in range(TUNING.relinearisations):
        if not _moves(explanation):
            break
        scene = scene_of(effort_of(columns, explanation.beta, explanation.parts, distorted=False))
        explanation = explain(data, about(moved(explanation), scene), explanation)
    return explanation


def _moves(explanation: Explanation) -> bool:
    """Whether a distortion is still on its way, by more than nobody would see, or what it does may be."""
    distortions = [(effect, amplitude) for effect, amplitude in explanation.parts if not effect.source.linear]
    if any(effect.source.of_effort for effect, _ in distortions):
        return True
    return any(np.any(np.abs(amplitude) > TUNING.still * effect.columns.sd) for effect, amplitude in distortions)


def about(effects: Sequence[Hypothesis], scene: Scene) -> list[Hypothesis]:
    """The effects linearised where a scene is, about their own numbers."""
    return [_relinearised(effect, scene) for effect in effects]


def effort_of(columns: Array, beta: Array, parts: Iterable[tuple[Hypothesis, Array]], *, distorted: bool) -> Array:
    """(N, n) efforts, N m, of a model's columns (N, n, r), and of effects or the terms among them."""
    effort: Array = columns @ beta
    for effect, amplitude in parts:
        if distorted or effect.source.linear:
            for j, rows in effect.columns.rows.items():
                effort[:, j] += rows @ amplitude
            for j, shift in effect.columns.shift.items():
                effort[:, j] += shift
    return effort


def _relinearised(effect: Hypothesis, scene: Scene) -> Hypothesis:
    if effect.source.linear:
        return effect
    shift, columns = effect.source.change(scene)
    acting = sorted(effect.columns.joints)
    rows = {j: columns[:, j] for j in acting} if columns.shape[2] else {}
    return replace(effect, columns=replace(effect.columns, rows=rows, shift={j: shift[:, j] for j in acting}))


@dataclass(frozen=True)
class Extension:
    """A model with effects added.

    The knowledge of its parameters, from the earlier log, is wider where an effect is a change of what was there. The
    parameters theta (P,) of the explanation are not feasible in general, but have its efforts.
    """

    model: Model
    knowledge: Knowledge
    theta: Array


def extend(knowledge: Knowledge, coefficients: BaseCoefficients, explanation: Explanation) -> Extension:
    """The model of an explanation by some effects, from what is known of it without them and its base coefficients."""
    model, names = knowledge.model, [parameter.name for parameter in knowledge.model.parameters]
    without_trace = knowledge.theta - coefficients.lift(coefficients.project(knowledge.theta))
    theta = coefficients.lift(explanation.beta) + without_trace
    added: list[Array] = []
    for hypothesis, amplitude in explanation.parts:
        if hypothesis.changes:
            theta[[names.index(name) for name in hypothesis.changes]] += amplitude
            knowledge = knowledge.widened(hypothesis.changes, hypothesis.columns.sd, coefficients)
        else:
            model = model.extend(hypothesis.source.moved(amplitude))
            added.append(amplitude[: len(hypothesis.source.parameters(model.robot))])
    return Extension(model, knowledge, np.concatenate([theta, *added]))


def moved(explanation: Explanation) -> list[Hypothesis]:
    """Its effects, their own numbers where the explanation puts them."""
    return [h if h.source.linear else replace(h, source=h.source.moved(a)) for h, a in explanation.parts]
