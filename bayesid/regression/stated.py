"""Constraints on parameters, stated with expressions of cvxpy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.effects.constraints import Constraints
from bayesid.effects.model import Model
from bayesid.errors import InputError, near_names
from bayesid.regression.canonical import canonical, label_of
from bayesid.regression.conic import typical_parameters, typical_sizes
from bayesid.regression.interior import deepest_point
from bayesid.regression.tuning import TUNING
from bayesid.robot.inertia import NAMES, PSEUDO_INERTIA_BASIS, inertia_matrix
from bayesid.robot.shapes import mesh_points


class Stated(list[Any]):
    """Constraints of cvxpy with a common label."""

    def __init__(self, label: str, constraints: Iterable[Any]) -> None:
        super().__init__(constraints)
        self.label = label


class StatedParameters:
    """Parameters of a model as expressions of cvxpy: the argument of `constraints=lambda p: [...]`.

    Links count from 1; their parameters are in their own frames, as in parameters.csv, in kg, kg m and kg m^2.

    Example:
        >>> def known(p):
        ...     return [p.total_mass <= 31, p["m3"] <= p["m2"], p.com_in_box(2, [-0.1, -0.1, 0], [0.1, 0.1, 0.4])]
        >>> result = bayesid.identify(robot, log, terms, constraints=known, posterior=False)
        >>> result.model.constraints.labels[:2]
        ('total_mass <= 31', 'm3 <= m2')
    """

    def __init__(self, names: Sequence[str], n_links: int) -> None:
        self._names, self._n_links = tuple(names), n_links
        self.variables: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            remedy = near_names(str(name), self._names) or "give a name as in parameters.csv"
            raise InputError(f"the model has no parameter {name!r}", field="constraints", remedy=remedy)
        if name not in self.variables:
            import cvxpy as cp  # as in `canonical`

            self.variables[name] = cp.Variable(name=name)
        return self.variables[name]

    def _ten(self, link: int) -> list[Any]:
        if isinstance(link, bool) or not isinstance(link, int | np.integer) or not 1 <= link <= self._n_links:
            remedy = f"give a link from 1 to {self._n_links}"
            raise InputError(f"there is no link {link!r}", field="constraints", remedy=remedy)
        stems = ((name.rstrip("xyz"), name) for name in NAMES)
        return [self[f"{stem}{link}{name[len(stem) :]}"] for stem, name in stems]

    def mass(self, link: int) -> Any:
        """Mass of a link, kg."""
        return self._ten(link)[9]

    def first_moment(self, link: int) -> Any:
        """(3,) mass times centre of mass of a link, kg m."""
        import cvxpy as cp

        return cp.hstack(self._ten(link)[6:9])

    def inertia(self, link: int) -> Any:
        """(3, 3) inertia of a link about its frame's origin, kg m^2."""
        return self._sum(link, inertia_matrix(np.eye(10)))

    def pseudo_inertia(self, link: int) -> Any:
        """(4, 4) pseudo-inertia of a link (:eq:`pseudo-inertia`)."""
        return self._sum(link, PSEUDO_INERTIA_BASIS)

    def _sum(self, link: int, basis: Array) -> Any:
        parts = zip(basis, self._ten(link), strict=True)
        return sum(matrix * variable for matrix, variable in parts if np.any(matrix))

    @property
    def total_mass(self) -> Any:
        """Mass of all links, kg, without payloads."""
        return sum((self.mass(k) for k in range(2, self._n_links + 1)), self.mass(1))

    def com_in_box(self, link: int, low: Sequence[float], high: Sequence[float]) -> Stated:
        """The centre of mass of a link lies in a box, m in the link's frame: corners x, y, z."""
        label = f"com_in_box({link}, {_shown(low)}, {_shown(high)})"
        least, most = (_three(corner, label) for corner in (low, high))
        if not np.all(least < most):
            raise _bad(label, "the lower corner must be below the upper one in x, y and z")
        moment, mass = self._ten(link)[6:9], self.mass(link)
        pairs = zip(moment, least.tolist(), most.tolist(), strict=True)
        return Stated(label, (side for h, a, b in pairs for side in (a * mass <= h, h <= b * mass)))

    def com_in_hull(self, link: int, hull: Sequence[Sequence[float]] | Array | str | Path) -> Stated:
        """The centre of mass of a link lies in the convex hull of points (N, 3), m in the link's frame, or of a mesh.

        A mesh is an STL, OBJ or DAE file in the link's frame.
        """
        shown = repr(str(hull)) if isinstance(hull, str | Path) else f"{len(hull)} points"
        return Stated(f"com_in_hull({link}, {shown})", self._facets(link, hull, shown))

    def _facets(self, link: int, hull: Any, shown: str) -> Iterator[Any]:
        label = f"com_in_hull({link}, {shown})"
        if isinstance(hull, str | Path):
            points = mesh_points(Path(hull), np.ones(3), label)
        else:
            points = np.array(hull, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
            raise _bad(label, "four or more points x, y, z are needed")
        try:
            equations = scipy.spatial.ConvexHull(points).equations
        except scipy.spatial.QhullError:
            raise _bad(label, "the hull has no volume") from None
        facets = np.unique(equations.round(6), axis=0, return_index=True)[1]
        if len(facets) > TUNING.most_half_spaces:
            message = f"the hull has {len(facets)} faces, the limit is {TUNING.most_half_spaces}"
            raise _bad(label, message, "give a coarser mesh, or a box")
        moment, mass = self.first_moment(link), self.mass(link)
        return (normal[:3] @ moment + normal[3] * mass <= 0 for normal in equations[facets])

    def density_in_ellipsoid(self, link: int, centre: Sequence[float], semi_axes: Sequence[float]) -> Stated:
        """All mass of a link lies in an ellipsoid along its frame's axes, m: tr(P Q) >= 0 for the pseudo-inertia P.

        It bounds the inertia by the mass (Wensing, Kim, Slotine 2018).
        """
        label = f"density_in_ellipsoid({link}, {_shown(centre)}, {_shown(semi_axes)})"
        middle, axes = (_three(values, label) for values in (centre, semi_axes))
        if not np.all(axes > 0.0):
            raise _bad(label, "semi-axes must be positive")
        weight = axes**-2.0
        matrix = np.zeros((4, 4))
        matrix[:3, :3], matrix[3, 3] = -np.diag(weight), 1.0 - weight @ middle**2
        matrix[:3, 3] = matrix[3, :3] = weight * middle
        coefficients = np.einsum("kij,ij->k", PSEUDO_INERTIA_BASIS, matrix).tolist()
        pairs = zip(coefficients, self._ten(link), strict=True)
        return Stated(label, [sum(value * variable for value, variable in pairs if value) >= 0])


def _shown(values: object) -> str:
    try:
        return f"[{', '.join(f'{float(value):g}' for value in values)}]"  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        return repr(values)[:60]


def _three(values: object, label: str) -> Array:
    try:
        three = np.array(values, dtype=float)
    except (TypeError, ValueError):
        three = np.empty(0)
    if three.shape != (3,) or not np.isfinite(three).all():
        raise _bad(label, "three numbers x, y, z are needed")
    return three


def _bad(label: str, why: str, remedy: str = "give lengths in m, in the frame of the link") -> InputError:
    return InputError(f"{label}: {why}", field="constraints", remedy=remedy)


ConstraintFunction = Callable[[StatedParameters], Any]
"""A function of the parameters that returns a constraint of cvxpy, or nested lists of constraints."""


def constraints_of(function: ConstraintFunction, model: Model) -> Constraints | None:
    """The constraints that a function states on a model's parameters; None without any.

    Raises:
        InputError: they cannot be read, are not convex, or contradict each other.
    """
    names = [parameter.name for parameter in model.parameters]
    parameters = StatedParameters(names, model.robot.n_joints)
    try:
        items = _flat(function(parameters))
    except InputError:
        raise
    except Exception as error:
        if isinstance(error, ValueError | NotImplementedError) or type(error) is Exception:  # of cvxpy
            remedy = "write each comparison by itself with <= or >=, as in [27 <= p.total_mass, p.total_mass <= 31]"
            raise InputError(f"cannot be stated ({error})", field="constraints", remedy=remedy) from None
        raise
    masses = " + ".join(f"m{k}" for k in range(1, model.robot.n_joints + 1))
    parts = []
    for number, item in enumerate(items, start=1):
        together = item if isinstance(item, Stated) else [item]
        label = item.label if isinstance(item, Stated) else label_of(item, number, masses)
        parts.append(canonical(together, label, parameters.variables, names))
    if not parts:
        return None
    stated = Constraints.joined(parts)
    _check_consistent(stated, model)
    return stated


def _flat(nested: Any) -> list[Any]:
    """A flat list of constraints; a `Stated` counts as one."""
    if isinstance(nested, Stated) or not isinstance(nested, list | tuple | set | Iterator):
        return [nested]
    return [item for part in nested for item in _flat(part)]


def _check_consistent(stated: Constraints, model: Model) -> None:
    """Checks that constraints can hold together, with positive masses and friction.

    Raises:
        InputError: they contradict each other; names the labels.
    """
    if labels := stated.contradicting:
        raise contradiction_of(labels)
    cone = replace(model, constraints=stated).cone
    if not cone.plane().basis.shape[1]:
        raise InputError(
            "all parameters are fixed by equalities", field="constraints", remedy="leave out some equalities"
        )
    found = deepest_point(cone, typical_parameters(cone), typical_sizes(cone))
    if not found.inside:
        raise contradiction_of(found.labels)


def contradiction_of(labels: Sequence[str]) -> InputError:
    """The error for contradicting constraints."""
    if len(labels) == 1:
        message = f"{labels[0]} contradicts positive masses, inertias and friction"
    else:
        together = f"{', '.join(labels[:-1])} and {labels[-1]}" if labels else "they"
        message = f"{together} contradict each other"
    return InputError(message, field="constraints", remedy="state intervals that overlap, with some width")
