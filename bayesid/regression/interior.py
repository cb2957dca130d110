"""Points deep inside the cone and the stated constraints; a test whether there is an interior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
import scipy
from scipy.linalg import null_space

from bayesid.arrays import TINY, Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.errors import SolverError
from bayesid.regression.conic import (
    TYPICAL_BODY,
    cones_of,
    into_cone,
    label_of_row,
    linear_count,
    offsets_of,
    rows_of,
    settings_of,
    solved,
    stacked,
    typical_parameters,
    typical_sizes,
    units_of,
)
from bayesid.regression.tuning import TUNING
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS


def interior_point(cone: Cone, coefficients: BaseCoefficients, theta: Array) -> Array:
    """(P,) parameters with the same coefficients as theta (P,), and every body as far inside the cone as possible.

    Only combinations without effect on the efforts move: theta + N z with B N = 0. The largest t is found with
    P(theta + N z) >= t Q for each body, Q a typical link's pseudo-inertia. Stated constraints still hold.

    Raises:
        SolverError: Clarabel did not reach its tolerances.
    """
    sizes = typical_sizes(cone)
    along_plane = cone.plane(sizes).basis
    free = sizes[:, None] * (along_plane @ null_space(coefficients.projection * sizes @ along_plane))
    if free.shape[1] == 0 or len(cone.bodies) == 0:
        return theta
    rows = np.column_stack([-rows_of(cone, free), _outwards(cone)])  # of (z, t)
    along, away = free / sizes[:, None], (theta - typical_parameters(cone)) / sizes
    quadratic, linear = np.zeros((rows.shape[1], rows.shape[1])), np.full(rows.shape[1], -1.0)
    quadratic[:-1, :-1] = 2.0 * TUNING.interior_nearness * along.T @ along  # bounds masses without effect
    linear[:-1] = 2.0 * TUNING.interior_nearness * along.T @ away
    offsets = rows_of(cone, theta)
    if cone.stated is not None:  # the solver may leave theta slightly outside
        offsets = offsets + offsets_of(cone)
        offsets = np.where(label_of_row(cone) >= 0, into_cone(offsets, linear_count(cone)), offsets)
    stated = scipy.sparse.csc_matrix(np.triu(quadratic)), linear, scipy.sparse.csc_matrix(rows), offsets, cones_of(cone)
    outcome = solved(clarabel.DefaultSolver(*stated, settings_of(TUNING.interior_tolerance)))
    if outcome.failure:
        raise SolverError("moving parameters inside the cone", outcome.failure)
    return theta + free @ outcome.point[:-1]


@dataclass(frozen=True)
class Depth:
    """The deepest point found.

    Attributes:
        theta: (P,) parameters.
        depth: least distance to a constraint, in sizes, at most 1; not positive without an interior.
        labels: of the active constraints, and of further half spaces.
    """

    theta: Array
    depth: float
    labels: tuple[str, ...]

    @property
    def inside(self) -> bool:
        """Whether the depth exceeds the solver's tolerance."""
        return self.depth > TUNING.least_depth


def deepest_point(
    cone: Cone,
    near: Array,
    sizes: Array,
    rows: Array | None = None,
    offset: Array | None = None,
    names: Sequence[str] = (),
) -> Depth:
    """A point deep inside the cone and the constraints, and close to `near`; depths are in sizes of the parameters.

    The largest t <= 1 such that every half space holds by t of its size, every body has P >= t Q for a link Q of its
    size, and every stated matrix is >= t of its size. If t < 0, the multipliers are Farkas' proof of a contradiction.

    Args:
        cone: the cone with the stated constraints.
        near: (P,) point; the distance to it has a small weight.
        sizes: (P,) of the parameters.
        rows: (m, P) of further half spaces, rows theta + offset >= 0.
        offset: (m,) of these half spaces.
        names: (m,) of these half spaces.

    Raises:
        SolverError: Clarabel did not reach its tolerances.
    """
    more = np.empty((0, cone.size)) if rows is None else rows * sizes
    size, constant = np.maximum(np.linalg.norm(more, axis=1), TINY), np.empty(0) if offset is None else offset
    cone_rows = rows_of(cone, np.diag(sizes))
    units = units_of(cone, cone_rows)
    away = np.concatenate([_depths(cone, sizes), np.ones(len(more)), [1.0]])
    equal, value = _equalities(cone, sizes)
    away = np.append(away, np.zeros(len(equal)))
    scaled = np.vstack([cone_rows / units[:, None], more / size[:, None], np.zeros((1, cone.size)), equal])
    offsets = np.concatenate([offsets_of(cone) / units, constant / size, [1.0], -value])
    stated = scipy.sparse.csc_matrix(np.column_stack([-scaled, away]))
    weight = TUNING.depth_nearness
    quadratic = scipy.sparse.csc_matrix(np.diag(np.append(np.full(cone.size, 2.0 * weight), 0.0)))
    linear = np.append(-2.0 * weight * near / sizes, -1.0)
    cones = [*cones_of(cone), clarabel.NonnegativeConeT(len(more) + 1)]
    cones += [clarabel.ZeroConeT(len(equal))] * (len(equal) > 0)
    outcome = solved(clarabel.DefaultSolver(quadratic, linear, stated, offsets, cones, settings_of(1e-9)))
    if outcome.failure:
        raise SolverError("a point inside the constraints", outcome.failure)
    push = np.abs(np.where(away > 0.0, away, 1.0) * outcome.dual)  # an equality has no depth
    of_row = label_of_row(cone)
    shares: dict[str, float] = {}
    if cone.stated is not None:
        by_label = np.concatenate([of_row, np.full(len(more) + 1, -1), cone.stated.of_equal])
        shares = {label: float(push[by_label == k].sum()) for k, label in enumerate(cone.stated.labels)}
    shares |= dict(zip(names, push[len(of_row) : len(of_row) + len(more)].tolist(), strict=True))
    active = tuple(label for label, share in shares.items() if share > TUNING.contradicting_share)
    return Depth(cone.plane().nearest(sizes * outcome.point[:-1]), float(outcome.point[-1]), active)


def _equalities(cone: Cone, sizes: Array) -> tuple[Array, Array]:
    """(k, P) rows of unit length over theta / sizes, and (k,) their values."""
    if cone.stated is None:
        return np.empty((0, cone.size)), np.empty(0)
    rows = cone.stated.equal * sizes
    length = np.maximum(np.linalg.norm(rows, axis=1), TINY)
    return rows / length[:, None], cone.stated.value / length


def _outwards(cone: Cone) -> Array:
    """(m,) rows of K of typical links; zero elsewhere."""
    link = stacked(np.einsum("k,kij->ij", TYPICAL_BODY, PSEUDO_INERTIA_BASIS))
    outwards = np.zeros(len(offsets_of(cone)))
    first = linear_count(cone)
    outwards[first : first + 10 * len(cone.bodies)] = np.tile(link, len(cone.bodies))
    return outwards


def _depths(cone: Cone, sizes: Array) -> Array:
    """(m,) change of each row of K at a depth of one size; stated rows are divided by their units."""
    bodies = [stacked(np.diag([*(0.5 * sizes[body[[0, 3, 5]]].mean(),) * 3, sizes[body[9]]])) for body in cone.bodies]
    depths = np.concatenate([sizes[cone.nonnegative], *bodies])
    if cone.stated is None:
        return depths
    count = len(cone.nonnegative)
    identity = np.tile(stacked(np.eye(4)), len(cone.stated.basis))
    return np.concatenate([depths[:count], np.ones(len(cone.stated.rows)), depths[count:], identity])
