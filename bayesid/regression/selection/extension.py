"""A model, what is known of it, and the effects that explain a log, as one model again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.regression.knowledge import Knowledge
from bayesid.regression.selection.explanation import Explanation
from bayesid.regression.selection.hypotheses import Hypothesis


@dataclass(frozen=True)
class Extension:
    """A model with effects added.

    Attributes:
        model: robot, terms and distortions.
        knowledge: of its parameters, from the earlier log; wider where an effect is a change of what was there.
        theta: (P,) parameters of the explanation; not feasible in general, but with its efforts.
    """

    model: Model
    knowledge: Knowledge
    theta: Array


def extend(
    knowledge: Knowledge, coefficients: BaseCoefficients, chosen: Sequence[Hypothesis], explanation: Explanation
) -> Extension:
    """The model of an explanation.

    Args:
        knowledge: of the model without the effects.
        coefficients: its base coefficients.
        chosen: the effects that explain.
        explanation: by these, in this order.
    """
    model, names = knowledge.model, [parameter.name for parameter in knowledge.model.parameters]
    theta = coefficients.lift(explanation.beta)
    theta = theta + _without_trace(coefficients, knowledge.theta)
    added: list[Array] = []
    for hypothesis, amplitude in zip(chosen, explanation.amplitudes, strict=True):
        if hypothesis.changes:
            theta[[names.index(name) for name in hypothesis.changes]] += amplitude
            knowledge = knowledge.widened(hypothesis.changes, hypothesis.columns.sd, coefficients)
        else:
            model = model.extend(hypothesis.source.moved(amplitude))
            added.append(amplitude[: len(hypothesis.source.parameters(model.robot))])
    return Extension(model, knowledge, np.concatenate([theta, *added]))


def moved(chosen: Sequence[Hypothesis], explanation: Explanation) -> list[Hypothesis]:
    """The same effects, their own numbers where the explanation puts them."""
    pairs = zip(chosen, explanation.amplitudes, strict=True)
    return [h if h.source.linear else replace(h, source=h.source.moved(amplitude)) for h, amplitude in pairs]


def _without_trace(coefficients: BaseCoefficients, theta: Array) -> Array:
    """(P,) the part of parameters that leaves no trace in the efforts."""
    return theta - coefficients.lift(coefficients.project(theta))
