"""Sizes of effects that cannot be excluded; they widen the intervals.

Automatic relevance determination: the amplitudes of a group are normal about zero. Their common variance is the one of
the largest likelihood, with all amplitudes and coefficients integrated out (MacKay 1994; Tipping 2001;
:eq:`relevance`)::

    s^2  <-  |mu|^2 / (p - tr(Sigma) / s^2 + h),

with mu, Sigma the amplitudes' posterior in units of their usual size. h is the weight of a prior that most effects are
absent; the scale of an effect without evidence becomes zero. Errors of the geometry exist in any robot, so their scale
has a prior about the usual size, and its posterior mean is used (:eq:`relevance-there`)::

    s^2 = E[s^2 | log],   p(s) ~ (1 + s^2 / 2)^(-5/2) before it: Student's t, E[s^2] = 1.

Intervals are too narrow (`TooNarrow`) if an effect is confounded with coefficients, as a good counterbalance is with
gravity, or if the geometry differs so much from its table that its derivatives are inaccurate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy
from scipy.linalg import block_diag

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.effect import Effect, Scene
from bayesid.regression.knowledge import KinematicTolerance, inverse_of
from bayesid.regression.least_squares import Fit
from bayesid.regression.log_data import LogData, Nuisance, make_nuisance
from bayesid.regression.selection.detected import SignedLog
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.selection.modelled_log import KINEMATICS, Geometry
from bayesid.regression.selection.regression import Regression, explain
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class NuisanceScales:
    """Effects that cannot be excluded."""

    nuisance: Nuisance | None = None  #: their effect on the coefficients, if any
    #: effects partly confounded with the model's columns, each with the (r,) bias of the coefficients for an effect of
    #: usual size. The nuisance does not include this part, as the log cannot show it
    confounded: tuple[tuple[EffectKey, Array], ...] = ()
    by_geometry: Array | None = None  #: (r,) sd of the coefficients by the geometry alone; None if it is exact


def find_nuisance_scales(
    log_data: LogData, fit: Fit, probability: Array, others: Sequence[Hypothesis], tolerance: KinematicTolerance
) -> NuisanceScales:
    """Effects that cannot be excluded, each of the likeliest size, and the geometry's tolerance.

    They are effects outside of a model that was fitted to a log with P(sign = +) (N, n). The fitted tolerance may be
    larger than the given one, and smaller unless a user stated it.
    """
    case = SignedLog.of(log_data, fit, probability)
    geometry = Hypothesis(Geometry(), case.modelled.geometry(tolerance), _no_other_form)
    groups = [*others, *([geometry] if len(geometry.columns.sd) else [])]
    if not groups:
        return NuisanceScales()
    regression = Regression(case.data, groups, explain(case.data, ()).errors)
    always = {id(geometry): float(tolerance.stated)}
    relevance, free = learn_scales(regression, always), len(log_data.coefficients)
    moves = inverse_of(regression.hessian[:free, :free]) @ regression.hessian[:free]
    confounded = tuple(
        (group.key, np.linalg.norm(moves[:, regression.place(group)] @ directions, axis=1))
        for group, directions in zip(groups, relevance.confounded, strict=True)
        if directions.size
    )
    kept = relevance.scales > 0.0
    if not kept.any():
        return NuisanceScales(None, confounded)
    by_geometry = None
    if geometry is groups[-1]:
        moved, moments = moves[:, regression.place(geometry)], relevance.moments
        variance = np.einsum("rp,pq,rq->r", moved, moments[-moved.shape[1] :, -moved.shape[1] :], moved)
        by_geometry = np.sqrt(np.maximum(variance, 0.0))  # rounding may make a variance of zero negative
    there = [(group, turn) for group, turn, chosen in zip(groups, relevance.turns, kept, strict=True) if chosen]
    signals, amplitudes = log_data.signals, np.repeat(kept, [turn.shape[1] for turn in relevance.turns])
    scene = log_data.model.scene(signals.motion, fit.theta, fit.predicted, signals.magnitude)
    parts = [_on_all_rows(group, turn, case, scene) for group, turn in there]
    nuisance = make_nuisance(
        columns=lambda place: np.concatenate([part(place) for part in parts], axis=2),
        model=log_data.chunks,
        used=log_data.used,
        weight=fit.noise.sigma * np.sqrt(fit.noise.autocorrelation),
        names=tuple(" ".join([group.effect, *map(str, group.joints)]) for group, _ in there),
        scales=relevance.scales[kept],
        moments=relevance.moments[np.ix_(amplitudes, amplitudes)],
    )
    return NuisanceScales(nuisance, confounded, by_geometry)


def _no_other_form(source: Effect) -> Hypothesis:
    raise NotImplementedError(f"{source.name} has one form")


def _on_all_rows(group: Hypothesis, turn: Array, case: SignedLog, scene: Scene) -> Callable[[slice], Array]:
    """(N', n, p) efforts of some rows per unit of each rotated amplitude, N m.

    Those of the geometry are smooth and slow to compute, so a spline interpolates between thinned rows.
    """
    n, t = scene.robot.n_joints, scene.motion.t
    of_joint: dict[int, Callable[[slice], Array]] = {}
    if isinstance(group.source, Geometry):
        for j, rows in group.columns.rows.items():
            spline = scipy.interpolate.CubicSpline(t[case.rows], rows @ turn)
            of_joint[j] = partial(lambda place, spline: spline(t[place]), spline=spline)
    else:
        for j, rows in group.source.change_by_joint(scene)[1].items():
            of_joint[j] = (rows @ turn).__getitem__

    def columns(place: slice) -> Array:
        some = np.zeros((len(t[place]), n, turn.shape[1]))
        for j, make in of_joint.items():
            some[:, j] = make(place)
        return some

    return columns


_SCALES = np.geomspace(1e-3, 1e2, 501)
"""Grid of s for the mean, far finer than the posterior of a scale."""


@dataclass(frozen=True)
class Relevance:
    """Fitted scales of groups of columns."""

    scales: Array  #: of each group, relative to the usual size; 0 for an omitted group
    turns: tuple[Array, ...]  #: of each group, (p, p') the directions of its amplitudes that are used
    confounded: tuple[Array, ...]  #: of each group, (p, p - p') directions confounded with the model's columns
    moments: Array  #: (p', p') second moments of the amplitudes of all groups in these directions, given the log


def learn_scales(regression: Regression, always: Mapping[int, float]) -> Relevance:
    """The likeliest scales of a regression's effects, each a group of columns.

    Directions of which less than a hundredth (of the square) is outside the span of the model's columns are omitted;
    kinetic friction, for example, is confounded with Coulomb friction. Groups in `always` keep all directions and have
    a least scale (by the effect's id), which is 1 if it was stated.
    """
    hessian, gradient, groups = regression.hessian, regression.gradient, regression.effects
    free = regression.data.columns.shape[2]
    of_model = inverse_of(hessian[:free, :free])
    columns = np.concatenate([regression.place(group) for group in groups])
    across, whole = hessian[columns, :free], hessian[np.ix_(columns, columns)]
    residual_gram = whole - across @ of_model @ across.T  # orthogonal to the model's columns
    directions, end = [], 0
    for group in groups:
        at, end = slice(end, end + len(group.columns.sd)), end + len(group.columns.sd)
        sd = np.diag(group.columns.sd)
        kept, vectors = np.ones(len(sd), dtype=bool), np.eye(len(sd))
        if id(group) not in always:
            values, vectors = np.linalg.eigh(sd @ residual_gram[at, at] @ sd)
            kept = values > TUNING.own_share * np.einsum("ij,ik,kj->j", vectors, sd @ whole[at, at] @ sd, vectors)
        directions.append((sd @ vectors[:, kept], sd @ vectors[:, ~kept]))
    turns, confounded = (tuple(some) for some in zip(*directions, strict=True))
    turn = block_diag(*turns)
    reduced, slope = turn.T @ residual_gram @ turn, turn.T @ (gradient[columns] - across @ of_model @ gradient[:free])
    owner = np.repeat(np.arange(len(groups)), [residual_gram.shape[1] for residual_gram in turns])
    there = np.array([id(group) in always for group in groups])
    scales = np.where(there, 1.0, TUNING.relevance_start)
    for _ in range(2 if there.any() else 1):
        scales = _likeliest(reduced, slope, owner, scales, ~there)
        for k in np.flatnonzero(there).tolist():
            scales[k] = max(_expected(reduced, slope, owner == k, scales[owner]), always[id(groups[k])])
    mean, covariance = _amplitudes(reduced, slope, scales[owner])
    spread = covariance * np.outer(scales[owner], scales[owner])
    return Relevance(scales, turns, confounded, spread + np.outer(mean, mean))


def _likeliest(reduced: Array, slope: Array, owner: Integers, scales: Array, learned: Array) -> Array:
    """(groups,) scales after the fixed-point iteration, for the groups to fit."""
    for _ in range(TUNING.relevance_rounds):
        mean, covariance = _amplitudes(reduced, slope, scales[owner])
        decided = np.bincount(owner, 1.0 - np.diag(covariance), len(scales))
        likelier = np.sqrt(np.bincount(owner, mean**2, len(scales)) / (decided + TUNING.absent))
        scales = np.where(learned, np.where(likelier < TUNING.dropped_scale, 0.0, likelier), scales)
    return scales


def _expected(reduced: Array, slope: Array, mine: Mask, sd: Array) -> float:
    """Root mean square of one group's scale given the log and the other groups' sd (p,)."""
    others = ~mine & (sd > 0.0)
    inner = reduced[np.ix_(others, others)] + np.diag(sd[others] ** -2.0)
    across = np.linalg.solve(inner, np.column_stack([reduced[np.ix_(others, mine)], slope[others]]))
    reduced_own = reduced[np.ix_(mine, mine)] - reduced[np.ix_(mine, others)] @ across[:, :-1]
    values, vectors = np.linalg.eigh(0.5 * (reduced_own + reduced_own.T))
    projected = vectors.T @ (slope[mine] - reduced[np.ix_(mine, others)] @ across[:, -1])
    square = _SCALES[:, None] ** 2
    growth = 1.0 + square * np.maximum(values, 0.0)
    log_density = 0.5 * np.sum(square * projected**2 / growth - np.log(growth), axis=1) - 2.5 * np.log1p(
        0.5 * square[:, 0]
    )
    weight = _SCALES * np.exp(log_density - log_density.max())  # the grid is uniform in the logarithm
    return float(np.sqrt(weight @ square[:, 0] / weight.sum()))


def _amplitudes(reduced: Array, slope: Array, scale: Array) -> tuple[Array, Array]:
    """(p,) mean and (p, p) covariance of the amplitudes in units of their scales (p,)."""
    precision: Array = np.eye(len(scale)) + reduced * np.outer(scale, scale)
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    return scale * (covariance @ (slope * scale)), covariance


@dataclass(frozen=True)
class TooNarrow:
    """Coefficients whose intervals are too narrow if one of several effects is present."""

    effects: tuple[str, ...]  #: effects confounded with these coefficients
    joints: tuple[int, ...]  #: from 1; empty: the whole robot
    coefficients: tuple[str, ...]  #: biased ones, the most biased first
    times: float | None = None  #: measured over stated error of the geometry, if the log shows an error


def too_narrow(
    confounded: Sequence[tuple[EffectKey, Array]], names: Sequence[str], sd: Array, of_links: Mask
) -> tuple[TooNarrow, ...]:
    """Effects confounded mostly with the links, joint by joint; effects of friction are omitted.

    Args:
        confounded: effects and their biases of the r coefficients.
        names: (r,) of the coefficients.
        sd: (r,) their standard deviations.
        of_links: (r,) whether link parameters are part of them.
    """
    moved: dict[tuple[int, ...], tuple[list[str], Array]] = {}
    known = np.isfinite(sd) & (sd > 0.0)
    for (effect, joints), size in confounded:
        times = np.where(known, size / np.where(known, sd, 1.0), 0.0)
        if times.max(initial=0.0) <= TUNING.moved_coefficient or not of_links[times.argmax()]:
            continue
        effects, most = moved.setdefault(joints, ([], np.zeros(len(names))))
        effects.append(effect)
        np.maximum(most, times, out=most)
    return tuple(
        TooNarrow(tuple(sorted(set(effects))), joints, _named(names, most)) for joints, (effects, most) in moved.items()
    )


def geometry_far_off(scale: float, by_geometry: Array, names: Sequence[str], sd: Array) -> tuple[TooNarrow, ...]:
    """Coefficients that a geometry error makes uncertain, if it is `scale` times the stated tolerance; else empty.

    It adds the sd `by_geometry` (r,) to the coefficients, whose sd (r,) include no undetected effects.
    """
    if scale <= TUNING.far_off:
        return ()
    known = np.isfinite(sd) & (sd > 0.0)
    times = np.where(known, by_geometry / np.where(known, sd, 1.0), 0.0)
    named = _named(names, times)
    return (TooNarrow((KINEMATICS[0],), (), named, scale),) if named else ()


def _named(names: Sequence[str], times: Array) -> tuple[str, ...]:
    order = np.argsort(-times, kind="stable")
    return tuple(names[k] for k in order.tolist() if times[k] > TUNING.moved_coefficient)
