"""Under which model the signs are settled: the one asked for, or that one with the standard effects it leaves out.

A model without friction explains |effort| of a friction-dominated joint best with wrong signs: friction that only
changes its sign looks like a constant once rectified. No noise level shows that; another model does. So where a model
without some standard effect (`bayesid.effects.STANDARD`) leaves a residual that lasts from sample to sample, the
signs are searched with these effects too, and both models speak, each with its weight (Bayesian model averaging).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from bayesid.arrays import Array
from bayesid.effects import STANDARD, catalogue
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.progress import SILENT, Progress
from bayesid.regression.least_squares import Fit, fit_signed
from bayesid.signs.search.protocol import Search
from bayesid.signs.settling import Settled, settle_signs

_LASTING = 0.5
"""Coloured over white noise of a residual from which on it is worth another model's opinion. A round number; not
studied."""
_LARGEST_WEIGHT = 0.95
"""The model that was asked for keeps a say: neither is the truth, whatever their odds. A round number; not studied."""


@dataclass(frozen=True)
class AveragedSigns:
    """Signs by the model asked for and, where that is worth asking, by a richer one.

    Attributes:
        asked: signs under the model asked for.
        settled: signs under the weightier model, by which segments are cut and signed.
        fit: of the model asked for.
        probability: (N, n) P(sign = +) of every sample, averaged over both models.
        weight: of the weightier model.
    """

    asked: Settled
    settled: Settled
    fit: Fit
    probability: Array
    weight: float

    @classmethod
    def alone(cls, asked: Settled) -> AveragedSigns:
        """No other model has a say."""
        return cls(asked, asked, asked.fit, asked.probability, 1.0)

    @classmethod
    def of(cls, asked: Settled, rival: Settled) -> AveragedSigns:
        """Two models have a say, each with its weight.

        Raises:
            SolverError: an optimisation failed.
        """
        weight = weight_against(rival, asked)
        probability = weight * rival.probability + (1.0 - weight) * asked.probability
        if weight < 0.5:
            return cls(asked, asked, asked.fit, probability, 1.0 - weight)
        signs = 2.0 * rival.probability - 1.0  # a doubt about the model is none about single signs: it biases the fit
        fit = fit_signed(replace(asked.evidence, fitted=rival.evidence.fitted), signs)
        return cls(asked, rival, fit, probability, weight)

    @property
    def mixed(self) -> Array:
        """(N, n) P(sign = +) of every sample, over all assignments that nothing excludes too (:eq:`mixed-signs`)."""
        return self.settled.mixed_with(self.probability)

    @property
    def by_asked(self) -> bool:
        """Whether the model asked for is the weightier one."""
        return self.settled is self.asked


def average_over_models(
    asked: Settled, segments: Segments, search: Search, progress: Progress = SILENT
) -> AveragedSigns:
    """Averages with the signs under all standard effects, where the model lacks some and its residual lasts.

    Args:
        asked: signs under the model asked for.
        segments: as they were before any search.
        search: how to search.
        progress: of the searches.

    Raises:
        SolverError: an optimisation failed.
    """
    model = richer_model(asked) if search.any_model else None
    if model is None:
        return AveragedSigns.alone(asked)
    signals = asked.evidence.signals
    rival = settle_signs(model, signals, segments, search, progress.under("standard effects"))
    return AveragedSigns.of(asked, rival)


def richer_model(settled: Settled) -> Model | None:
    """The model with all standard effects, if it lacks some and its residual lasts; else None."""
    residual, signals = settled.fit.residual, settled.evidence.signals
    if signals.signed.all() or np.all(residual.coloured < _LASTING * residual.white):
        return None
    return with_standard_terms(settled.model, signals)


def with_standard_terms(model: Model, signals: Signals) -> Model | None:
    """The model with the standard effects that it lacks; None if it lacks none."""
    names = {term.name for term in model.terms}
    missing = [name for name in STANDARD if name not in names]
    if not missing:
        return None
    for term in catalogue.make_terms(missing, model.robot, signals.motion):
        model = model.extend(term)
    return model


def weight_against(rival: Settled, asked: Settled) -> float:
    """Weight of a richer model against the one it extends, by the Bayesian information criterion on effective samples.

    Each joint's samples are divided by the longer autocorrelation time of the two residuals (:eq:`model-weight`).
    """
    return min(_LARGEST_WEIGHT, float(expit(0.5 * evidence_gain(rival, asked))))


def evidence_gain(rival: Settled, asked: Settled) -> float:
    """Fall of the Bayesian information criterion: twice the log of how much likelier a richer model is.

    Samples that a distortion of a sensor takes for unreadable speak for neither.
    """
    time = np.maximum(rival.fit.residual.autocorrelation, asked.fit.residual.autocorrelation)
    count = np.minimum(asked.evidence.fitted.sum(axis=0), rival.evidence.fitted.sum(axis=0)) / time
    gain = float(count @ (2.0 * np.log(asked.fit.residual.sigma / rival.fit.residual.sigma)))
    more = len(rival.evidence.coefficients) - len(asked.evidence.coefficients)
    return gain - more * float(np.log(count.sum()))
