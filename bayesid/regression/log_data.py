"""A log as a model is to explain it, and effects that the model may lack, summed out of what it says.

An effect Z a that a fit does not know moves its coefficients by H^-1 Y' Z a: to least squares it looks like Y times
that, its projection on the model's columns (all in units of the error). Where a has the second moments A, coefficients
are as uncertain as if the efforts spread by

    V = 1 + P A P',    P = Y H^-1 Y' Z   (:eq:`nuisance-spread`),

about the model. The residual of least squares is orthogonal to Y, so V moves no estimate; it only widens it, to the
covariance H^-1 + H^-1 Y' Z A Z' Y H^-1. All that follows is a quadratic form in V^-1 = M' M with the symmetric root

    M = 1 - U (1 - (1 + D^2)^-1/2) U',    P A^1/2 = U D Q'   (:eq:`nuisance-root`),

so moments, covariance and posterior go on as they did, with M Y and M e in place of Y and e.
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
    """A model, a log, and which of its N samples count.

    Attributes:
        model: robot and terms.
        coefficients: its r base coefficients.
        signals: the log.
        moving: (N, n) samples in motion.
        fitted: (N, n) those of them that a fit rests on.
        information: of the coefficients, from earlier logs; None without one.
        nuisance: effects that the model may lack, to be summed out; None without any.
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
        """A fit may rest on all samples in motion (N, n), and nothing is known beforehand."""
        return cls(model, base_coefficients(model), signals, moving, moving)

    @cached_property
    def used(self) -> Mask:
        """(N, n) samples that a fit rests on, but for both ends of the log."""
        return self.fitted & self.signals.inner

    def residual_noise(self, predicted: Array) -> Noise:
        """Of the residual (N, n) of a prediction, N m, unknown signs as predicted, over the samples used."""
        residual = np.where(self.used, self.signals.nearest(predicted) - predicted, 0.0)
        return residual_noise(residual, self.used, self.signals.rate)

    @property
    def columns(self) -> Array:
        """(N, n, r) of the coefficients."""
        columns = np.empty((len(self.signals.motion), self.model.robot.n_joints, len(self.coefficients)))
        for place, rows in self.chunks():
            columns[place] = rows
        return columns

    def chunks(self) -> Iterator[tuple[slice, Array]]:
        """Rows and their columns (N', n, r) of the coefficients, some samples at a time."""
        kept = self.coefficients.selected
        return ((place, rows.chosen(kept).dense) for place, rows in self.model.felt_chunks(self.signals.motion))

    def normal_equations(
        self,
        signs: Array,
        segments: Segments,
        most_individual: int | None = None,
        orientation: Array | None = None,
        *,
        summed_out: bool = True,
    ) -> NormalEquations:
        """Moments of the unfiltered efforts (a filter would blur friction's steps, not the columns') in expected signs.

        Where a nuisance is summed out, a segment's sign turns with it what the nuisance has explained there: exact at
        the expected signs, and elsewhere to the first order in the nuisance's share of the effort.

        Args:
            signs: (N, n) expected sign of every sample, -1 to +1.
            segments: where to sum.
            most_individual: segments of each joint with a Hessian of their own (`regression.normal_equations`).
            orientation: (N, n) +1 or -1, the signs of the segments, by which efforts are multiplied in the end.
            summed_out: whether a nuisance is; it changes no estimate of least squares, only its covariance.
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
"""Rows (N', n, ...) of a log and where they stand in it; all of its rows, one after the other."""


@dataclass(frozen=True, eq=False)
class Nuisance:
    """What is summed out, on the rows of one log.

    Attributes:
        names: of the effects, with their joints.
        scales: learned size of each effect, relative to what was believed of it before.
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
        """(N, n, ...) M times rows, in their own units."""
        return self.without(slice(0, len(rows)), rows, self.shared([(slice(0, len(rows)), rows)]))

    def shared(self, chunks: Chunks) -> Array:
        """(m, ...) U' times rows, which come in chunks (N', n, ...)."""
        total: Array | float = 0.0
        for place, rows in chunks:
            total = total + np.tensordot(self.directions[place], self._scaled(rows), axes=([0, 1], [0, 1]))
        return np.asarray(total)

    def without(self, place: slice, rows: Array, shared: Array) -> Array:
        """(N', n, ...) M times rows of one chunk, given what all of them share."""
        shrunk = self.shrinkage.reshape(-1, *(1,) * (shared.ndim - 1)) * shared
        part = np.tensordot(self.directions[place], shrunk, axes=([2], [0]))
        weight = self.weight.reshape(1, -1, *(1,) * (rows.ndim - 2))
        left: Array = rows - weight * part
        return left

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
    """What columns of unknown amplitudes do to coefficients; None where they do nothing.

    Args:
        columns: (N', n, p) Z of some rows, N m per unit of each amplitude.
        model: all (N, n, r) Y in chunks, N m per unit of each coefficient; asked for twice.
        used: (N, n) samples that a fit rests on.
        weight: (n,) sd of the error, N m, its autocorrelation included.
        names: of the effects.
        scales: their learned sizes, relative to what was believed before.
        moments: (p, p) A, second moments of the amplitudes.
    """
    products: Array | float = 0.0
    shared: Array | float = 0.0
    for place, rows in model():
        of_model, of_effects = (_scaled(values, used[place], weight) for values in (rows, columns(place)))
        products, shared = products + of_model.T @ of_model, shared + of_model.T @ of_effects
    projected = inverse_of(np.asarray(products)) @ shared @ _root(moments)  # coefficients that stand for the effects
    gram = projected.T @ products @ projected
    values, vectors = np.linalg.eigh(gram)
    spread = np.sqrt(np.maximum(values, 0.0))
    seen = (spread > 1e-6 * spread.max(initial=0.0)) & (spread > TUNING.faint)  # what is less is rounding
    if not seen.any():
        return None
    stretched = projected @ (vectors[:, seen] / spread[seen])
    kept_as = np.float32 if len(used) > TUNING.long_log else np.float64
    directions = np.empty((*used.shape, stretched.shape[1]), dtype=kept_as)
    for place, rows in model():
        of_model = _scaled(rows, used[place], weight)
        directions[place] = (of_model @ stretched).reshape(*used[place].shape, -1)
    shrinkage = 1.0 - 1.0 / np.sqrt(1.0 + spread[seen] ** 2)
    return Nuisance(names, scales, weight, directions, shrinkage, stretched.T @ products)


def _scaled(values: Array, used: Mask, weight: Array) -> Array:
    """(N n, k) rows in units of the error, zero where not used."""
    scaled: Array = (values / weight[:, None] * used[:, :, None]).reshape(-1, values.shape[2])
    return scaled


def _root(moments: Array) -> Array:
    """L with L L' = A."""
    values, vectors = np.linalg.eigh(0.5 * (moments + moments.T))
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
