"""Effects that may be there, unseen: of the size that the log makes likeliest, they widen what is uncertain.

By automatic relevance determination: the amplitudes of a group are normal about zero; their common variance is the one
under which the log is likeliest, all amplitudes and coefficients integrated out (MacKay 1994; Tipping 2001;
:eq:`relevance`)::

    s^2  <-  |mu|^2 / (p - tr(Sigma) / s^2 + h),

with mu, Sigma the amplitudes' posterior, in units of what is usual, and h the weight of a belief that most effects are
absent: what the log cannot show at all vanishes. What is there in any robot, a geometry that is not quite its table's,
is believed to be about as large as usual, and has the mean that the log leaves of this belief (:eq:`relevance-there`)::

    s^2 = E[s^2 | log],   p(s) ~ (1 + s^2 / 2)^(-5/2) before it: Student's t, E[s^2] = 1.

Intervals are too narrow (`TooNarrow`) if the robot has what the log cannot tell from coefficients: a counterbalance
that balances gravity well is gravity to a log. Of a geometry far off its table the derivatives are no longer enough.
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
    """What may be there."""

    nuisance: Nuisance | None = None  #: what it does to coefficients; None where it does nothing
    #: effects of which the model's columns stand for a part: by how much (r,) coefficients are off where it is there,
    #: in its usual size. The nuisance leaves that part out: nothing tells that it is there
    stood_for: tuple[tuple[EffectKey, Array], ...] = ()
    by_geometry: Array | None = None  #: (r,) sd of the coefficients by its error alone; None where it is exact


def find_nuisance_scales(
    log_data: LogData, fit: Fit, probability: Array, rest: Sequence[Hypothesis], tolerance: KinematicTolerance
) -> NuisanceScales:
    """Effects that may be there, unseen, each of the size that the log makes likeliest; and the geometry's tolerance.

    Of a completed model's fit to a log with P(sign = +) (N, n), the effects that did not enter. The tolerance's scale
    may grow, and shrink if nobody has stated it.
    """
    case = SignedLog.of(log_data, fit, probability)
    geometry = Hypothesis(Geometry(), case.modelled.geometry(tolerance), _no_other_form)
    groups = [*rest, *([geometry] if len(geometry.columns.sd) else [])]
    if not groups:
        return NuisanceScales()
    regression = Regression(case.data, groups, explain(case.data, ()).errors)
    always = {id(geometry): float(tolerance.stated)}
    relevance, free = learn_scales(regression, always), len(log_data.coefficients)
    moves = inverse_of(regression.hessian[:free, :free]) @ regression.hessian[:free]
    stood_for = tuple(
        (group.key, np.linalg.norm(moves[:, regression.place(group)] @ directions, axis=1))
        for group, directions in zip(groups, relevance.stood_for, strict=True)
        if directions.size
    )
    kept = relevance.scales > 0.0
    if not kept.any():
        return NuisanceScales(None, stood_for)
    by_geometry = None
    if geometry is groups[-1]:
        own, moments = moves[:, regression.place(geometry)], relevance.moments
        variance = np.einsum("rp,pq,rq->r", own, moments[-own.shape[1] :, -own.shape[1] :], own)
        by_geometry = np.sqrt(np.maximum(variance, 0.0))  # rounding leaves less than nothing of what is not there
    there = [(group, turn) for group, turn, one in zip(groups, relevance.turns, kept, strict=True) if one]
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
    return NuisanceScales(nuisance, stood_for, by_geometry)


def _no_other_form(source: Effect) -> Hypothesis:
    raise NotImplementedError(f"{source.name} has one form")


def _on_all_rows(group: Hypothesis, turn: Array, case: SignedLog, scene: Scene) -> Callable[[slice], Array]:
    """(N', n, p) efforts of some rows per unit of each turned amplitude, N m.

    The geometry's are smooth, and dear: what lies between the thinned rows is read off a spline.
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
"""Grid of s that the mean is summed over: far finer than what a log tells of a scale, and as far as it matters."""


@dataclass(frozen=True)
class Relevance:
    """What a log says of groups of columns."""

    scales: Array  #: (groups,) of each, relative to what is usual; 0 where it is left out
    turns: tuple[Array, ...]  #: of each, (p, p') the directions of its amplitudes that count
    stood_for: tuple[Array, ...]  #: of each, (p, p - p') those that the model's columns stand for
    moments: Array  #: (p', p') second moments of the amplitudes of all groups in these directions, given the log


def learn_scales(regression: Regression, always: Mapping[int, float]) -> Relevance:
    """How large the effects of a regression are likely to be, each a group of columns.

    What the model's columns stand for themselves, up to a hundredth of a column's square, is left to them: kinetic
    friction is Coulomb friction, whatever else an effect has. Not of what is there in any case, with a least scale (by
    the effect's id): 1 for what was stated.
    """
    hessian, gradient, groups = regression.hessian, regression.gradient, regression.effects
    free = regression.data.columns.shape[2]
    of_model = inverse_of(hessian[:free, :free])
    columns = np.concatenate([regression.place(group) for group in groups])
    across, whole = hessian[columns, :free], hessian[np.ix_(columns, columns)]
    own = whole - across @ of_model @ across.T  # beside the model's columns
    directions, end = [], 0
    for group in groups:
        at, end = slice(end, end + len(group.columns.sd)), end + len(group.columns.sd)
        sd = np.diag(group.columns.sd)
        kept, vectors = np.ones(len(sd), dtype=bool), np.eye(len(sd))
        if id(group) not in always:
            values, vectors = np.linalg.eigh(sd @ own[at, at] @ sd)
            kept = values > TUNING.own_share * np.einsum("ij,ik,kj->j", vectors, sd @ whole[at, at] @ sd, vectors)
        directions.append((sd @ vectors[:, kept], sd @ vectors[:, ~kept]))
    turns, stood_for = (tuple(some) for some in zip(*directions, strict=True))
    turn = block_diag(*turns)
    reduced, slope = turn.T @ own @ turn, turn.T @ (gradient[columns] - across @ of_model @ gradient[:free])
    owner = np.repeat(np.arange(len(groups)), [own.shape[1] for own in turns])
    there = np.array([id(group) in always for group in groups])
    scales = np.where(there, 1.0, TUNING.relevance_start)
    for _ in range(2 if there.any() else 1):
        scales = _likeliest(reduced, slope, owner, scales, ~there)
        for k in np.flatnonzero(there).tolist():
            scales[k] = max(_expected(reduced, slope, owner == k, scales[owner]), always[id(groups[k])])
    mean, covariance = _amplitudes(reduced, slope, scales[owner])
    spread = covariance * np.outer(scales[owner], scales[owner])
    return Relevance(scales, turns, stood_for, spread + np.outer(mean, mean))


def _likeliest(reduced: Array, slope: Array, owner: Integers, scales: Array, learned: Array) -> Array:
    """(groups,) scales after the fixed point, of those that are learned."""
    for _ in range(TUNING.relevance_rounds):
        mean, covariance = _amplitudes(reduced, slope, scales[owner])
        decided = np.bincount(owner, 1.0 - np.diag(covariance), len(scales))
        likelier = np.sqrt(np.bincount(owner, mean**2, len(scales)) / (decided + TUNING.absent))
        scales = np.where(learned, np.where(likelier < TUNING.gone, 0.0, likelier), scales)
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


def _amplitudes(reduced: Array, slope: Array, scale: Array) -> tuple[Array, Array]:
    """(p,) mean of the amplitudes, and (p, p) covariance in units of their scales (p,)."""
    precision: Array = np.eye(len(scale)) + reduced * np.outer(scale, scale)
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    return scale * (covariance @ (slope * scale)), covariance


@dataclass(frozen=True)
class TooNarrow:
    """Coefficients whose intervals are too narrow if one of several effects is there."""

    effects: tuple[str, ...]  #: any of which would look like these coefficients
    joints: tuple[int, ...]  #: from 1; none: the whole robot
    coefficients: tuple[str, ...]  #: those that would be off, the most first
    times: float | None = None  #: as far as believed, if the log shows that it is there: the geometry


def too_narrow(
    stood_for: Sequence[tuple[EffectKey, Array]], names: Sequence[str], sd: Array, of_links: Mask
) -> tuple[TooNarrow, ...]:
    """Effects that would mostly look like the links, joint by joint: those of friction only share its name.

    Args:
        stood_for: effects and by how much they move the r coefficients.
        names: (r,) of the coefficients.
        sd: (r,) their standard deviations.
        of_links: (r,) whether links have a part in them.
    """
    moved: dict[tuple[int, ...], tuple[list[str], Array]] = {}
    known = np.isfinite(sd) & (sd > 0.0)
    for (effect, joints), size in stood_for:
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
    """What a geometry off by `scale` times what was believed makes doubtful; nothing where it is as believed.

    It adds sd `by_geometry` (r,) to the coefficients, whose sd (r,) are those without anything unseen.
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
