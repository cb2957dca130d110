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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy
from scipy.linalg import block_diag

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.effect import Effect, Scene
from bayesid.regression.evidence import Evidence, Nuisance, make_nuisance
from bayesid.regression.knowledge import KinematicTolerance, inverse_of
from bayesid.regression.least_squares import Fit
from bayesid.regression.selection.geometry import KINEMATICS, Geometry
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.selection.regression import Regression, explain
from bayesid.regression.selection.wanted import SignedLog
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class Unseen:
    """What may be there.

    Attributes:
        nuisance: what it does to coefficients; None where it does nothing.
        stood_for: effects of which the model's columns stand for a part: by how much (r,) coefficients are off where it
            is there, in its usual size. The nuisance leaves that part out: nothing tells that it is there.
        by_geometry: (r,) sd of the coefficients by the geometry's error alone; None where the geometry is exact.
    """

    nuisance: Nuisance | None = None
    stood_for: tuple[tuple[EffectKey, Array], ...] = ()
    by_geometry: Array | None = None


def find_unseen(
    evidence: Evidence, fit: Fit, probability: Array, rest: Sequence[Hypothesis], tolerance: KinematicTolerance
) -> Unseen:
    """Effects that may be there, unseen, each of the size that the log makes likeliest; and the geometry's tolerance.

    Of a completed model's fit to a log with P(sign = +) (N, n), the effects that did not enter. The tolerance's scale
    may grow, and shrink if nobody has stated it.
    """
    case = SignedLog.of(evidence, fit, probability)
    geometry = Hypothesis(Geometry(), case.modelled.geometry(tolerance), _no_other_form)
    groups = [*rest, *([geometry] if len(geometry.columns.sd) else [])]
    if not groups:
        return Unseen()
    regression = Regression(case.data, groups, explain(case.data, ()).errors)
    placed = []
    for group in groups:
        always = group is geometry
        least = float(always and tolerance.stated)
        placed.append(Group(regression.place(group), group.columns.sd, always, least))
    free = len(evidence.coefficients)
    relevance = learn_scales(regression.hessian, regression.gradient, placed, free)
    moves = inverse_of(regression.hessian[:free, :free]) @ regression.hessian[:free]
    stood_for = tuple(
        (group.key, np.linalg.norm(moves[:, at.place] @ directions, axis=1))
        for group, at, directions in zip(groups, placed, relevance.stood_for, strict=True)
        if directions.size
    )
    of_groups = list(zip(groups, relevance.scales.tolist(), relevance.turns, strict=True))
    there = [(group, turn) for group, scale, turn in of_groups if scale > 0.0]
    if not there:
        return Unseen(None, stood_for)
    by_geometry = None
    if geometry is groups[-1]:
        own = moves[:, placed[-1].place] * placed[-1].sd
        count = own.shape[1]
        variance = np.einsum("rp,pq,rq->r", own, relevance.moments[-count:, -count:], own)
        by_geometry = np.sqrt(np.maximum(variance, 0.0))  # rounding leaves less than nothing of what is not there
    nuisance = _nuisance(evidence, fit, case, there, relevance)
    return Unseen(nuisance, stood_for, by_geometry)


def _nuisance(
    evidence: Evidence, fit: Fit, case: SignedLog, there: Sequence[tuple[Hypothesis, Array]], relevance: Relevance
) -> Nuisance | None:
    motion = evidence.signals.motion
    scene = evidence.model.scene(motion, fit.theta, fit.predicted, evidence.signals.magnitude)
    counts = [turn.shape[1] for turn in relevance.turns]
    kept = np.repeat(relevance.scales > 0.0, counts)
    parts = [_on_all_rows(group, turn, case, scene) for group, turn in there]
    return make_nuisance(
        columns=lambda place: np.concatenate([part(place) for part in parts], axis=2),
        model=evidence.chunks,
        used=evidence.used,
        weight=fit.noise.sigma * np.sqrt(fit.noise.autocorrelation),
        names=tuple(" ".join([group.key[0], *(str(j) for j in group.key[1])]) for group, _ in there),
        scales=relevance.scales[relevance.scales > 0.0],
        moments=relevance.moments[np.ix_(kept, kept)],
    )


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
class Group:
    """Columns whose amplitudes share a scale.

    Attributes:
        place: (p,) indices among all columns.
        sd: (p,) usual sizes of the amplitudes.
        there: whether the effect is there in any case, also in directions that the model's columns stand for.
        least: the scale never falls below it: 1 for what was stated.
    """

    place: Integers
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
    columns = np.concatenate([group.place for group in groups])
    inner, across = hessian[np.ix_(columns, columns)], hessian[np.ix_(columns, np.arange(free))]
    reduced = turn.T @ (inner - across @ of_model @ across.T) @ turn
    slope = turn.T @ (gradient[columns] - across @ of_model @ gradient[:free])
    owner = np.repeat(np.arange(len(groups)), [own.shape[1] for own in turns])
    there, least = np.array([g.there for g in groups]), np.array([g.least for g in groups])
    scales = np.where(there, 1.0, TUNING.relevance_start)
    for _ in range(2 if there.any() else 1):
        scales = _likeliest(reduced, slope, owner, scales, ~there)
        for k in np.flatnonzero(there).tolist():
            scales[k] = max(_expected(reduced, slope, owner == k, scales[owner]), least[k])
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


def _directions(hessian: Array, of_model: Array, group: Group, free: int) -> tuple[Array, Array]:
    """(p, p') amplitudes, in their usual sizes, that the model's columns cannot stand for, and (p, p - p') others."""
    if group.there:
        return np.diag(group.sd), np.zeros((len(group.sd), 0))
    place, sd = group.place, np.diag(group.sd)
    across, inner = hessian[place, :free], hessian[np.ix_(place, place)]
    whole = sd @ inner @ sd
    own = sd @ (inner - across @ of_model @ across.T) @ sd
    values, vectors = np.linalg.eigh(own)
    kept = values > TUNING.own_share * np.einsum("ij,ik,kj->j", vectors, whole, vectors)
    return sd @ vectors[:, kept], sd @ vectors[:, ~kept]


def _amplitudes(reduced: Array, slope: Array, scale: Array) -> tuple[Array, Array]:
    """(p,) mean of the amplitudes, and (p, p) covariance in units of their scales (p,)."""
    precision: Array = np.eye(len(scale)) + reduced * np.outer(scale, scale)
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    return scale * (covariance @ (slope * scale)), covariance


@dataclass(frozen=True)
class TooNarrow:
    """Coefficients whose intervals are too narrow if one of several effects is there.

    Attributes:
        effects: any of which would look like these coefficients.
        joints: from 1; none: the whole robot.
        coefficients: those that would be off, the most first.
        times: as far as believed, if the log shows that it is there: the geometry.
    """

    effects: tuple[str, ...]
    joints: tuple[int, ...]
    coefficients: tuple[str, ...]
    times: float | None = None


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
