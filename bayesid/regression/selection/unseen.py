"""Effects that may be there, unseen: of the size that the log makes likeliest, they widen what is uncertain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.effects.effect import Scene
from bayesid.regression.evidence import Evidence
from bayesid.regression.least_squares import Fit
from bayesid.regression.nuisance import Nuisance, make_nuisance
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.forward import Products
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.selection.kinematics import KINEMATICS, KinematicTolerance, kinematic_columns
from bayesid.regression.selection.relevance import Group, Relevance, inverse_of, learn_scales
from bayesid.regression.selection.scores import explain_with
from bayesid.regression.selection.signed_log import SignedLog


@dataclass(frozen=True)
class _Geometry:
    """How efforts change with the robot's geometry, as one group of columns."""

    columns: Columns
    key: EffectKey = KINEMATICS


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

    Args:
        evidence: the completed model, the log, and which samples count.
        fit: of the model to the log.
        probability: (N, n) P(sign = +) of every sample.
        rest: effects that did not enter.
        tolerance: of the geometry; its scale may grow, and shrink if nobody has stated it.
    """
    case = SignedLog.of(evidence, fit, probability)
    _, alone = explain_with(case.data, ())
    geometry = _geometry(case, tolerance)
    groups: list[Hypothesis | _Geometry] = [*rest, *([geometry] if len(geometry.columns.sd) else [])]
    if not groups:
        return Unseen()
    products = Products(case.data, groups, list(alone.errors))
    placed = []
    for candidate in products.candidates:
        always = candidate.hypothesis is geometry
        least = float(always and tolerance.stated)
        placed.append(Group(candidate.place, candidate.hypothesis.columns.sd, always, least))
    free = case.data.columns.shape[2]
    relevance = learn_scales(products.hessian, products.gradient, placed, free)
    moves = inverse_of(products.hessian[:free, :free]) @ products.hessian[:free]
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
    evidence: Evidence,
    fit: Fit,
    case: SignedLog,
    there: Sequence[tuple[Hypothesis | _Geometry, Array]],
    relevance: Relevance,
) -> Nuisance | None:
    """Groups that are there, with their directions, on all rows."""
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


def _geometry(case: SignedLog, tolerance: KinematicTolerance) -> _Geometry:
    motion, model = case.evidence.signals.motion[case.rows], case.evidence.model
    columns = kinematic_columns(model.robot, motion, model.links(case.fit.theta).ravel(), tolerance)
    rows = {j: columns[:, j] for j in range(columns.shape[1])}
    count = columns.shape[2]
    return _Geometry(Columns(rows, {}, np.ones(count), np.zeros(count, dtype=bool)))


def _on_all_rows(group: Hypothesis | _Geometry, turn: Array, case: SignedLog, scene: Scene) -> Callable[[slice], Array]:
    """(N', n, p) efforts of some rows per unit of each turned amplitude, N m; in the joints alone where there are any.

    The geometry's are smooth, and dear: what lies between the thinned rows is read off a spline.
    """
    n, t = scene.robot.n_joints, scene.motion.t
    of_joint: dict[int, Callable[[slice], Array]] = {}
    if isinstance(group, _Geometry):
        for j, rows in group.columns.rows.items():
            spline = scipy.interpolate.CubicSpline(t[case.rows], rows @ turn)
            of_joint[j] = partial(_at, spline, t)
    else:
        for j, rows in group.source.change_by_joint(scene)[1].items():
            of_joint[j] = (rows @ turn).__getitem__

    def columns(place: slice) -> Array:
        some = np.zeros((len(t[place]), n, turn.shape[1]))
        for j, make in of_joint.items():
            some[:, j] = make(place)
        return some

    return columns


def _at(spline: Callable[[Array], Array], t: Array, place: slice) -> Array:
    return spline(t[place])
