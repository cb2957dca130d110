"""A log with its model, and marginalised effects that the model may lack.

An effect Z a outside the model biases a fit's coefficients by H^-1 Y' Z a: least squares sees its projection on the
columns Y (all in units of the error). If a has the second moments A, the coefficients are as uncertain as if the
efforts had the covariance

    V = 1 + P A P',    P = Y H^-1 Y' Z   (:eq:`nuisance-spread`).

The residual of least squares is orthogonal to Y, so V changes no estimate. It only increases the covariance, to
H^-1 + H^-1 Y' Z A Z' Y H^-1. All results are quadratic forms in V^-1 = M' M with the symmetric root

    M = 1 - U (1 - (1 + D^2)^-1/2) U',    P A^1/2 = U D Q'   (:eq:`nuisance-root`),

so the same formulas hold with M Y and M e in place of Y and e.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals, signed_effort
from bayesid.regression.knowledge import InformationMatrix, inverse_of
from bayesid.regression.noise import Noise, residual_noise
from bayesid.regression.normal_equations import NormalEquations, normal_equations
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class LogData:
    """A model, a log, and the used ones of its N samples.

    Attributes:
        model: robot and terms.
        coefficients: its r base coefficients.
        signals: the log.
        moving: (N, n) samples in motion.
        fitted: (N, n) samples in motion that a fit uses.
        information: on the coefficients, from earlier logs; None without one.
        nuisance: effects that the model may lack, which are marginalised; None without any.
    """

    model: Model
    coefficients: BaseCoefficients
    signals: Signals
    moving: Mask
    fitted: Mask
    information: InformationMatrix | None = None
    nuisance: Nuisance | None = None

    @classmethod
    def of(cls, model: Model, signals: Signals, moving: Mask) -> LogData:
        """All samples in motion (N, n), without prior information."""
        return cls(model, base_coefficients(model), signals, moving, moving)

    @cached_property
    def used(self) -> Mask:
        """(N, n) samples that a fit uses, without both ends of the log."""
        return self.fitted & self.signals.inner

    def residual_noise(self, predicted: Array) -> Noise:
        """Noise of the residual (N, n) of a prediction, N m, over the used samples; unknown signs as predicted."""
        residual = np.where(self.used, self.signals.nearest(predicted) - predicted, 0.0)
        return residual_noise(residual, self.used, self.signals.rate)

    @property
    def columns(self) -> Array:
        """(N, n, r) regressor of the coefficients."""
        columns = np.empty((len(self.signals.motion), self.model.robot.n_joints, len(self.coefficients)))
        for place, rows in self.chunks():
            columns[place] = rows
        return columns

    def chunks(self) -> Iterator[tuple[slice, Array]]:
        """Rows and their columns (N', n, r) of the coefficients, chunk by chunk."""
        kept = self.coefficients.selected
        return ((place, rows.chosen(kept).dense) for place, rows in self.model.sparse_chunks(self.signals.motion))

    def normal_equations(
        self,
        signs: Array,
        segments: Segments,
        most_individual: int | None = None,
        orientation: Array | None = None,
        *,
        summed_out: bool = True,
    ) -> NormalEquations:
        """Normal equations of the unfiltered efforts in expected signs.

        Efforts stay unfiltered, as a filter would smooth the steps of friction but not the columns. With a nuisance,
        the sign of a segment also flips what the nuisance explains there: exact at the expected signs, elsewhere of
        first order in the nuisance's share of the effort.

        Args:
            signs: (N, n) expected sign of every sample, -1 to +1.
            segments: where to sum.
            most_individual: segments of each joint with their own Hessian (`regression.normal_equations`).
            orientation: (N, n) +1 or -1, signs of the segments; multiplies the efforts.
            summed_out: whether to marginalise the nuisance; it changes the covariance only.
        """
        effort, square = signed_effort(self.signals, signs, filtered=False), self.signals.raw_effort**2
        correct = None
        if summed_out and self.nuisance is not None:
            whitened = self.nuisance.whiten(effort)
            correct = partial(self.nuisance.without, shared=self.nuisance.of_model)
            square, effort = square - effort**2 + whitened**2, whitened
        if orientation is not None:
            effort = effort * np.where(self.signals.signed, 1.0, orientation)
        return normal_equations(
            self.model,
            self.coefficients,
            self.signals.motion,
            effort,
            segments,
            most_individual,
            square=square,
            correct=correct,
        )


Chunks = Iterable[tuple[slice, Array]]
"""Slices of a log and their rows (N', n, ...), in order, covering the whole log."""


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Marginalised effects on the rows of one log.

    Attributes:
        names: of the effects, with their joints.
        scales: fitted size of each effect over its prior size.
        weight: (n,) sd of the error, N m, its autocorrelation included.
        directions: (N, n, m) U, zero where a sample is not used.
        shrinkage: (m,) 1 - (1 + D^2)^-1/2.
        of_model: (m, r) U' times the model's columns.
    """

    names: tuple[str, ...]
    scales: Array
    weight: Array
    directions: Array
    shrinkage: Array
    of_model: Array

    def whiten(self, rows: Array) -> Array:
        """(N, n, ...) M times rows, in the units of the rows."""
        return self.without(slice(0, len(rows)), rows, self.shared([(slice(0, len(rows)), rows)]))

    def shared(self, chunks: Chunks) -> Array:
        """(m, ...) U' times rows, given in chunks (N', n, ...)."""
        total: Array | float = 0.0
        for place, rows in chunks:
            total = total + np.tensordot(self.directions[place], self._scaled(rows), axes=([0, 1], [0, 1]))
        return np.asarray(total)

    def without(self, place: slice, rows: Array, shared: Array) -> Array:
        """(N', n, ...) M times the rows of one chunk, given U' times all rows."""
        shrunk = self.shrinkage.reshape(-1, *(1,) * (shared.ndim - 1)) * shared
        part = np.tensordot(self.directions[place], shrunk, axes=([2], [0]))
        weight = self.weight.reshape(1, -1, *(1,) * (rows.ndim - 2))
        corrected: Array = rows - weight * part
        return corrected

    def _scaled(self, rows: Array) -> Array:
        return rows / self.weight.reshape(1, -1, *(1,) * (rows.ndim - 2))


def make_nuisance(
    columns: Callable[[slice], Array],
    model: Callable[[], Chunks],
    used: Mask,
    weight: Array,
    names: tuple[str, ...],
    scales: Array,
    moments: Array,
) -> Nuisance | None:
    """The nuisance of columns with unknown amplitudes; None if their effect is negligible.

    Args:
        columns: (N', n, p) Z of some rows, N m per unit of each amplitude.
        model: all (N, n, r) Y in chunks, N m per unit of each coefficient; called twice.
        used: (N, n) samples that a fit uses.
        weight: (n,) sd of the error, N m, its autocorrelation included.
        names: of the effects.
        scales: their fitted sizes over the prior sizes.
        moments: (p, p) A, second moments of the amplitudes.
    """
    products: Array | float = 0.0
    shared: Array | float = 0.0
    for place, rows in model():
        of_model, of_effects = (_scaled(values, used[place], weight) for values in (rows, columns(place)))
        products, shared = products + of_model.T @ of_model, shared + of_model.T @ of_effects
    projected = inverse_of(np.asarray(products)) @ shared @ _root(moments)  # bias of the coefficients
    gram = projected.T @ products @ projected
    values, vectors = np.linalg.eigh(gram)
    spread = np.sqrt(np.maximum(values, 0.0))
    seen = (spread > 1e-6 * spread.max(initial=0.0)) & (spread > TUNING.negligible_spread)  # 1e-6: rounding
    if not seen.any():
        return None
    stretched = projected @ (vectors[:, seen] / spread[seen])
    dtype = np.float32 if len(used) > TUNING.long_log else np.float64
    directions = np.empty((*used.shape, stretched.shape[1]), dtype=dtype)
    for place, rows in model():
        of_model = _scaled(rows, used[place], weight)
        directions[place] = (of_model @ stretched).reshape(*used[place].shape, -1)
    shrinkage = 1.0 - 1.0 / np.sqrt(1.0 + spread[seen] ** 2)
    return Nuisance(names, scales, weight, directions, shrinkage, stretched.T @ products)


def _scaled(values: Array, used: Mask, weight: Array) -> Array:
    scaled: Array = (values / weight[:, None] * used[:, :, None]).reshape(-1, values.shape[2])
    return scaled


def _root(moments: Array) -> Array:
    values, vectors = np.linalg.eigh(0.5 * (moments + moments.T))
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
