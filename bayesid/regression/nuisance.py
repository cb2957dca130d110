"""Effects that a model may lack, summed out: what they would have the coefficients be, as uncertainty of these.

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

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.regression.selection.relevance import inverse_of

_SEEN = 1e-6
"""Of the largest D, below which a direction is rounding."""
_FAINT = 1e-3
"""D below which a direction changes nothing: the spread grows by D^2 / 2."""
_LONG = 20_000
"""Samples from which on directions are kept in single precision, as memory grows with them. A round number."""
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
        scales: of each effect, relative to what was believed of it before.
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
    seen = (spread > _SEEN * spread.max(initial=0.0)) & (spread > _FAINT)
    if not seen.any():
        return None
    stretched = projected @ (vectors[:, seen] / spread[seen])
    kept_as = np.float32 if len(used) > _LONG else np.float64
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
