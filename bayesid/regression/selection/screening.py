"""Many hypotheses at once: which effects are worth a closer look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import Array
from bayesid.regression.selection.columns import Columns, together
from bayesid.regression.selection.error_model import ErrorModel, bridged
from bayesid.regression.selection.explanation import Regression

_TINY = 1e-300
"""Guard of a root; no result depends on it."""


class Screening:
    """Prices many single effects on top of an explanation, errors as they are: what is worth a closer look.

    Args:
        regression: with the effects that are added already.
        errors: of each joint.
    """

    def __init__(self, regression: Regression, errors: Sequence[ErrorModel]) -> None:
        self._data, self._errors = regression.data, errors
        self._explanation = regression.explain(errors)
        self._joints = [regression.whitened(j, error) for j, error in enumerate(errors)]
        self._pulled: dict[int, Array] = {}

    def gains(self, effects: Sequence[Columns]) -> tuple[Array, Array]:
        """Gains in log evidence of k effects with p amplitudes each, in the same joints.

        Args:
            effects: k of them.

        Returns:
            (k,) gains, and (k,) gains to be expected of amplitudes of one prior standard deviation.
        """
        gram, slope = self.products(effects)
        p = len(effects[0].sd)
        base = slope[:, p:].sum(axis=1) - 0.5 * gram[:, p:, p:].sum(axis=(1, 2))  # of changes without amplitudes
        if not p:
            return base, np.abs(base)
        return integrated(base, gram[:, :p, :p], slope[:, :p] - gram[:, :p, p:].sum(axis=2), effects)

    def products(self, effects: Sequence[Columns]) -> tuple[Array, Array]:
        """(k, P, P) second derivatives of k effects' gains by their amplitudes at zero, and (k, P) first ones.

        All else that explains is integrated out; a change is one more amplitude, if any of the effects makes one.
        """
        root, p = self._explanation.root, len(effects[0].sd)
        k, size = len(effects), p + any(effect.shift for effect in effects)
        across = np.zeros((k, size, root.shape[1]))
        gram, slope = np.zeros((k, size, size)), np.zeros((k, size))
        for j in sorted(set().union(*(effect.joints for effect in effects))):
            self._add(effects, j, across, gram, slope)
        seen = across @ root.T
        gram -= seen @ seen.transpose(0, 2, 1)
        return gram, slope

    def _add(self, effects: Sequence[Columns], joint: int, across: Array, gram: Array, slope: Array) -> None:
        """Adds a joint's products of k effects' columns and changes: with all others, each other, and the residual."""
        white, error = self._joints[joint], self._errors[joint]
        stack, kept = together(effects, joint)
        products, of_model = self._data.whitening.group(stack, joint, error, keep=kept)
        k, size, count = stack.shape
        whitening, weight = self._data.whitening, error.scale**-2.0
        of_effects = [whitening.across(stack, effect, joint, error, keep=kept) for effect in white.acting]
        across[:, :size, white.index] += weight * np.concatenate([of_model, *of_effects], axis=2)
        gram[:, :size, :size] += weight * products
        slope[:, :size] += weight * (stack.reshape(-1, count) @ self._pulled_back(joint)).reshape(k, size)

    def _pulled_back(self, joint: int) -> Array:
        """(N,) to multiply columns with for their products with the residual."""
        if joint not in self._pulled:
            error, used = self._errors[joint], self._data.used[:, joint]
            left = error.innovations(bridged(self._explanation.residual[:, joint], used), used)
            self._pulled[joint] = self._data.whitening.pulled_back(left, joint, error)
        return self._pulled[joint]


def integrated(base: Array, gram: Array, slope: Array, effects: Sequence[Columns]) -> tuple[Array, Array]:
    """Gains with the amplitudes integrated out over their priors, and those to be expected of usual amplitudes.

    Args:
        base: (k,) gain of the effects' changes without amplitudes.
        gram: (k, p, p) second derivatives by the amplitudes, coefficients integrated out.
        slope: (k, p) first derivatives at zero.
        effects: k of them.
    """
    sd = np.stack([effect.sd for effect in effects])
    p = sd.shape[1]
    scaled = gram * sd[:, :, None] * sd[:, None, :] + np.eye(p)
    covariance, log_det = np.linalg.inv(scaled), np.linalg.slogdet(scaled)[1]
    best = (covariance @ (slope * sd)[:, :, None])[:, :, 0]
    spread = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), _TINY))
    positive = np.stack([effect.positive for effect in effects])
    sides = np.sum(np.log(2.0) + log_ndtr(best / spread), axis=1, where=positive) if positive.any() else 0.0
    gain = base + 0.5 * np.sum(best * slope * sd, axis=1) - 0.5 * log_det + sides
    return gain, 0.5 * (np.trace(scaled, axis1=1, axis2=2) - p) - 0.5 * log_det
