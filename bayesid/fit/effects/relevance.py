"""Automatic relevance determination: how large the effects that did not enter may be, group by group.

The amplitudes of a group are normal about zero; their common variance is the one under which the log is likeliest, all
amplitudes and coefficients integrated out (MacKay 1994; Tipping 2001; :eq:`relevance`)::

    s^2  <-  |mu|^2 / (p - tr(Sigma) / s^2 + h),

with mu, Sigma the amplitudes' posterior, in units of what was believed of them before, and h the weight of a belief
that most effects are absent: what the log cannot show at all vanishes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from bayesid.arrays import Array

_ROUNDS = 60
"""Of the fixed point; it has settled to a few per cent by then. Not studied."""
_START = 0.3
"""Of s, in units of what was believed before: the fixed point only ever leaves large values slowly."""
_ABSENT = 0.5
"""h: half an observation of nothing, as of Jeffreys's prior of a variance."""
_OWN = 1e-2
"""Share of a direction's square that the model's columns must not explain. A round number; not studied."""
_GONE = 1e-3
"""Of s, below which a group is left out."""
_RIDGE = 1e-10
"""Of a scaled matrix, against rounding."""


@dataclass(frozen=True)
class Group:
    """Columns whose amplitudes share a scale.

    Attributes:
        place: indices among all columns.
        sd: (p,) what was believed of the amplitudes.
        least: the scale never falls below it: 1 for what was stated.
    """

    place: slice
    sd: Array
    least: float = 0.0


@dataclass(frozen=True)
class Relevance:
    """What a log says of groups of columns.

    Attributes:
        scales: (groups,) of each, relative to what was believed of it; 0 where it is left out.
        turns: of each, (p, p') the directions of its amplitudes that count.
        moments: (p', p') second moments of the amplitudes of all groups in these directions, given the log.
    """

    scales: Array
    turns: tuple[Array, ...]
    moments: Array


def learn_scales(hessian: Array, gradient: Array, groups: Sequence[Group], free: int) -> Relevance:
    """How large groups of columns are likely to be.

    What the model's columns stand for themselves, up to a hundredth of a column's square, is left to them: kinetic
    friction is Coulomb friction, whatever else an effect has.

    Args:
        hessian: (m, m) products of whitened columns.
        gradient: (m,) products with the whitened efforts.
        groups: of the columns that are not the model's.
        free: number of the model's columns, which come first and have no prior.
    """
    of_model = inverse_of(hessian[:free, :free])
    turns = tuple(_own_directions(hessian, of_model, group, free) for group in groups)
    turn = block_diag(*turns)
    columns = np.concatenate([np.arange(g.place.start, g.place.stop) for g in groups]).astype(int)
    inner, across = hessian[np.ix_(columns, columns)], hessian[np.ix_(columns, np.arange(free))]
    reduced = turn.T @ (inner - across @ of_model @ across.T) @ turn
    slope = turn.T @ (gradient[columns] - across @ of_model @ gradient[:free])
    owner = np.repeat(np.arange(len(groups)), [own.shape[1] for own in turns])
    least = np.array([g.least for g in groups])
    scales = np.maximum(_START, least)
    for _ in range(_ROUNDS):
        mean, covariance = _amplitudes(reduced, slope, scales[owner])
        decided = np.bincount(owner, 1.0 - np.diag(covariance), len(groups))
        scales = np.sqrt(np.bincount(owner, mean**2, len(groups)) / (decided + _ABSENT))
        scales = np.maximum(np.where(scales < _GONE, 0.0, scales), least)
    mean, covariance = _amplitudes(reduced, slope, scales[owner])
    spread = covariance * np.outer(scales[owner], scales[owner])
    return Relevance(scales, turns, spread + np.outer(mean, mean))


def _own_directions(hessian: Array, of_model: Array, group: Group, free: int) -> Array:
    """(p, p') amplitudes, in units of what was believed of them, that the model's columns cannot stand for."""
    if group.least > 0.0:
        return np.diag(group.sd)
    place, sd = group.place, np.diag(group.sd)
    across = hessian[place, :free]
    whole = sd @ hessian[place, place] @ sd
    own = sd @ (hessian[place, place] - across @ of_model @ across.T) @ sd
    values, vectors = np.linalg.eigh(own)
    sizes = np.einsum("ij,ik,kj->j", vectors, whole, vectors)
    kept: Array = sd @ vectors[:, values > _OWN * sizes]
    return kept


def _amplitudes(reduced: Array, slope: Array, scale: Array) -> tuple[Array, Array]:
    """(p,) mean of the amplitudes, and (p, p) covariance in units of their scales (p,)."""
    precision: Array = np.eye(len(scale)) + reduced * np.outer(scale, scale)
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    return scale * (covariance @ (slope * scale)), covariance


def inverse_of(matrix: Array) -> Array:
    """Of a positive matrix in mixed units; zero where its diagonal is."""
    diagonal = np.diag(matrix)
    seen = diagonal > np.finfo(float).tiny
    scale = np.where(seen, 1.0 / np.sqrt(np.where(seen, diagonal, 1.0)), 0.0)
    scaled = matrix * np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    inverse: Array = np.linalg.pinv(scaled, hermitian=True) * np.outer(scale, scale)
    return inverse
