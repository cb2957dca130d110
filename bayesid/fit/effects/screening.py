"""Many hypotheses at once: which effects are worth a closer look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import Array
from bayesid.fit.effects.error_model import ErrorModel
from bayesid.fit.effects.explanation import Columns, Regression

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
        explanation = regression.explain(errors)
        self._root = explanation.root
        whitened = [regression.whitened(j, error)[0][:, :-1] for j, error in enumerate(errors)]
        self._shows = [white.any(axis=0) for white in whitened]
        self._white = [white[:, shows] for white, shows in zip(whitened, self._shows, strict=True)]
        self._residual = [
            error.whiten(explanation.residual[:, j], self._data.used[:, j]) for j, error in enumerate(errors)
        ]

    def gains(self, effects: Sequence[Columns]) -> tuple[Array, Array]:
        """Gains in log evidence of k effects with p amplitudes each, in the same joints.

        Args:
            effects: k of them.

        Returns:
            (k,) gains, and (k,) gains to be expected of amplitudes of one prior standard deviation.
        """
        k, p = len(effects), len(effects[0].sd)
        m = self._root.shape[1]
        base, cross_shift = np.zeros(k), np.zeros((m, k))
        cross, gram, slope = np.zeros((m, k * p)), np.zeros((k, p, p)), np.zeros((k, p))
        shift_slope = np.zeros((k, p))
        for j in sorted(set().union(*(effect.joints for effect in effects))):
            shifts = self._white_shifts(effects, j)
            if shifts is not None:
                base += shifts.T @ self._residual[j] - 0.5 * np.sum(shifts**2, axis=0)
                cross_shift[self._shows[j]] += self._white[j].T @ shifts
            if p:
                rows = self._white_rows(effects, j)
                cross[self._shows[j]] += self._white[j].T @ rows
                blocks = rows.reshape(len(rows), k, p)
                gram += np.einsum("nkp,nkq->kpq", blocks, blocks, optimize=True)
                slope += (rows.T @ self._residual[j]).reshape(k, p)
                if shifts is not None:
                    shift_slope += np.einsum("nkp,nk->kp", blocks, shifts)
        seen_shift = self._root @ cross_shift
        base += 0.5 * np.sum(seen_shift**2, axis=0)
        if not p:
            return base, np.abs(base)
        seen = (self._root @ cross).reshape(m, k, p)
        gram -= np.einsum("rkp,rkq->kpq", seen, seen, optimize=True)
        slope -= shift_slope - np.einsum("rkp,rk->kp", seen, seen_shift)
        return _integrated(base, gram, slope, effects)

    def _white_shifts(self, effects: Sequence[Columns], joint: int) -> Array | None:
        """(N, k) whitened changes without amplitudes; None where there are none."""
        if not any(joint in effect.shift for effect in effects):
            return None
        used = self._data.used[:, joint]
        shifts = np.stack([effect.shift.get(joint, np.zeros(len(used))) for effect in effects], axis=1)
        return self._errors[joint].whiten(shifts, used)

    def _white_rows(self, effects: Sequence[Columns], joint: int) -> Array:
        """(N, k p) whitened columns."""
        blank = np.zeros((len(self._data.used), len(effects[0].sd)))
        rows = np.concatenate([effect.rows.get(joint, blank) for effect in effects], axis=1)
        return self._errors[joint].whiten(rows, self._data.used[:, joint])


def _integrated(base: Array, gram: Array, slope: Array, effects: Sequence[Columns]) -> tuple[Array, Array]:
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
    best = np.linalg.solve(scaled, (slope * sd)[:, :, None])[:, :, 0]
    log_det = np.linalg.slogdet(scaled)[1]
    spread = np.sqrt(np.maximum(np.diagonal(np.linalg.inv(scaled), axis1=1, axis2=2), _TINY))
    positive = np.stack([effect.positive for effect in effects])
    sides = np.sum(np.where(positive, np.log(2.0) + log_ndtr(best / spread), 0.0), axis=1)
    gain = base + 0.5 * np.sum(best * slope * sd, axis=1) - 0.5 * log_det + sides
    return gain, 0.5 * (np.trace(scaled, axis1=1, axis2=2) - p) - 0.5 * log_det
