"""Automatic relevance determination: how large the effects that did not enter may be, group by group.

The amplitudes of a group are normal about zero; their common variance is the one under which the log is likeliest, all
amplitudes and coefficients integrated out (MacKay 1994; Tipping 2001; :eq:`relevance`)::

    s^2  <-  |mu|^2 / (p - tr(Sigma) / s^2 + h),

with mu, Sigma the amplitudes' posterior, in units of what is usual, and h the weight of a belief that most effects are
absent: what the log cannot show at all vanishes. What is there in any robot, a geometry that is not quite its table's,
is believed to be about as large as usual, and has the mean that the log leaves of this belief (:eq:`relevance-there`)::

    s^2 = E[s^2 | log],   p(s) ~ (1 + s^2 / 2)^(-5/2) before it: Student's t, E[s^2] = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dpotrf, dpotri

from bayesid.arrays import Array, Integers, Mask

_ROUNDS = 60
"""Of the fixed point; it has settled to a few per cent by then. Not studied."""
_START = 0.3
"""Of s, in units of what was believed before: the fixed point only ever leaves large values slowly."""
_ABSENT = 0.5
"""h: half an observation of nothing, as of Jeffreys's prior of a variance."""
_SCALES = np.geomspace(1e-3, 1e2, 501)
"""Grid of s that the mean is summed over: far finer than what a log tells of a scale, and as far as it matters."""
_OWN = 1e-2
"""Share of a direction's square that the model's columns must not explain. A round number; not studied."""
_GONE = 1e-3
"""Of s, below which a group is left out."""
RIDGE = 1e-10
"""Of a scaled matrix, against rounding."""


@dataclass(frozen=True)
class Group:
    """Columns whose amplitudes share a scale.

    Attributes:
        place: indices among all columns.
        sd: (p,) usual sizes of the amplitudes.
        there: whether the effect is there in any case, also in directions that the model's columns stand for.
        least: the scale never falls below it: 1 for what was stated.
    """

    place: slice
    sd: Array
    there: bool = False
    least: float = 0.0


@dataclass(frozen=True)
class Relevance:
    """What a log says of groups of columns.

    Attributes:
        scales: (groups,) of each, relative to what is usual; 0 where it is left out.
        turns: of each, (p, p') the directions of its amplitudes that count.
        stood_for: of each, (p, p - p') those that the model's columns stand for.
        moments: (p', p') second moments of the amplitudes of all groups in these directions, given the log.
    """

    scales: Array
    turns: tuple[Array, ...]
    stood_for: tuple[Array, ...]
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
    directions = [_directions(hessian, of_model, group, free) for group in groups]
    turns, stood_for = tuple(own for own, _ in directions), tuple(others for _, others in directions)
    turn = block_diag(*turns)
    columns = np.concatenate([np.arange(g.place.start, g.place.stop) for g in groups]).astype(int)
    inner, across = hessian[np.ix_(columns, columns)], hessian[np.ix_(columns, np.arange(free))]
    reduced = turn.T @ (inner - across @ of_model @ across.T) @ turn
    slope = turn.T @ (gradient[columns] - across @ of_model @ gradient[:free])
    owner = np.repeat(np.arange(len(groups)), [own.shape[1] for own in turns])
    there, least = np.array([g.there for g in groups]), np.array([g.least for g in groups])
    scales = np.where(there, 1.0, _START)
    for _ in range(2 if there.any() else 1):
        scales = _likeliest(reduced, slope, owner, scales, ~there)
        for k in np.flatnonzero(there).tolist():
            scales[k] = max(_expected(reduced, slope, owner == k, scales[owner]), least[k])
    mean, covariance = _amplitudes(reduced, slope, scales[owner])
    spread = covariance * np.outer(scales[owner], scales[owner])
    return Relevance(scales, turns, stood_for, spread + np.outer(mean, mean))


def _likeliest(reduced: Array, slope: Array, owner: Integers, scales: Array, learned: Array) -> Array:
    """(groups,) scales after the fixed point, of those that are learned."""
    for _ in range(_ROUNDS):
        mean, covariance = _amplitudes(reduced, slope, scales[owner])
        decided = np.bincount(owner, 1.0 - np.diag(covariance), len(scales))
        likelier = np.sqrt(np.bincount(owner, mean**2, len(scales)) / (decided + _ABSENT))
        scales = np.where(learned, np.where(likelier < _GONE, 0.0, likelier), scales)
    return scales


def _expected(reduced: Array, slope: Array, own: Mask, sd: Array) -> float:
    """Root mean square of one group's scale given the log, the others' sd (p,) being known."""
    others = ~own & (sd > 0.0)
    inner = reduced[np.ix_(others, others)] + np.diag(sd[others] ** -2.0)
    across = np.linalg.solve(inner, np.column_stack([reduced[np.ix_(others, own)], slope[others]]))
    left = reduced[np.ix_(own, own)] - reduced[np.ix_(own, others)] @ across[:, :-1]
    values, vectors = np.linalg.eigh(0.5 * (left + left.T))
    pull = vectors.T @ (slope[own] - reduced[np.ix_(own, others)] @ across[:, -1])
    square = _SCALES[:, None] ** 2
    growth = 1.0 + square * np.maximum(values, 0.0)
    log_density = 0.5 * np.sum(square * pull**2 / growth - np.log(growth), axis=1) - 2.5 * np.log1p(0.5 * square[:, 0])
    weight = _SCALES * np.exp(log_density - log_density.max())  # the grid is even in the logarithm
    return float(np.sqrt(weight @ square[:, 0] / weight.sum()))


def _directions(hessian: Array, of_model: Array, group: Group, free: int) -> tuple[Array, Array]:
    """(p, p') amplitudes, in their usual sizes, that the model's columns cannot stand for, and (p, p - p') others."""
    if group.there:
        return np.diag(group.sd), np.zeros((len(group.sd), 0))
    place, sd = group.place, np.diag(group.sd)
    across = hessian[place, :free]
    whole = sd @ hessian[place, place] @ sd
    own = sd @ (hessian[place, place] - across @ of_model @ across.T) @ sd
    values, vectors = np.linalg.eigh(own)
    kept = values > _OWN * np.einsum("ij,ik,kj->j", vectors, whole, vectors)
    return sd @ vectors[:, kept], sd @ vectors[:, ~kept]


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
    scaled = matrix * np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    factor, failed = dpotrf(scaled, lower=True)
    if failed:  # by rounding
        return np.asarray(np.linalg.pinv(scaled, hermitian=True) * np.outer(scale, scale))
    lower = np.tril(dpotri(factor, lower=True)[0])
    inverse: Array = (lower + np.tril(lower, -1).T) * np.outer(scale, scale)
    return inverse
