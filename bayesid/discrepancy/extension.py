"""A model, what is known of it, and the effects that were found, as one model again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.coefficients import BaseCoefficients
from bayesid.discrepancy.evidence import Explanation
from bayesid.discrepancy.hypotheses import Hypothesis
from bayesid.distortions.base import Distortion
from bayesid.knowledge import Knowledge
from bayesid.model import Model
from bayesid.motion import Array


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
    knowledge: Knowledge, coefficients: BaseCoefficients, found: Sequence[Hypothesis], explanation: Explanation
) -> Extension:
    """The model of an explanation.

    Args:
        knowledge: of the model without the effects.
        coefficients: its base coefficients.
        found: the effects that explain.
        explanation: by these, in this order.
    """
    model, names = knowledge.model, [parameter.name for parameter in knowledge.model.parameters]
    theta = coefficients.lift(explanation.beta)
    theta = theta + _without_trace(coefficients, knowledge.theta)
    added: list[Array] = []
    for one, amplitude in zip(found, explanation.amplitudes, strict=True):
        if isinstance(one.source, Distortion):
            model = model.distort(one.source.moved(amplitude))
        elif one.changes:
            theta[[names.index(name) for name in one.changes]] += amplitude
            knowledge = knowledge.widened(one.changes, one.columns.sd)
        else:
            model = model.extend(one.source)
            added.append(amplitude)
    return Extension(model, knowledge, np.concatenate([theta, *added]))


def moved(found: Sequence[Hypothesis], explanation: Explanation) -> list[Hypothesis]:
    """The same effects, distortions with their free numbers where the explanation puts them."""
    return [
        replace(one, source=one.source.moved(amplitude)) if isinstance(one.source, Distortion) else one
        for one, amplitude in zip(found, explanation.amplitudes, strict=True)
    ]


def _without_trace(coefficients: BaseCoefficients, theta: Array) -> Array:
    """(P,) the part of parameters that leaves no trace in the efforts."""
    return theta - coefficients.lift(coefficients.project(theta))
