"""PBPR: parameters of all links within bounds and under arbitrary constraints, by penalties and simulated annealing.

After Gaz, Flacco and De Luca, "Extracting feasible robot parameters from dynamic coefficients using nonlinear
optimization methods" (ICRA 2016), :eq:`pbpr`::

    minimise  phi(theta) + gamma(theta)   over  lower <= theta <= upper,

with phi1 = |beta(theta) - beta_hat|^2 (`coefficient_error`) or phi2 = |Y beta(theta) - tau|^2 (`effort_error`), and
gamma the weighted penalties of the violated constraints. Constraints are Python functions: they may be nonlinear, not
convex or conditional, unlike those of the cone of `regression.solver`. This takes longer, and proves nothing.

As in the paper, annealing runs several times, each run from the end of the one before and with a larger penalty. Before
the first run phi without penalty, a convex quadratic in a box, is minimised exactly by bounded least squares; if that
minimum satisfies every constraint, it is the result. Two differences from the paper: the penalty is the squared
violation (in the authors' code for the Panda, 2019, it is proportional), so that the local search has a gradient at the
boundary; and that gradient is analytic in phi.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy

from bayesid.arrays import Array, frozen
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.constraints import Constraints
from bayesid.effects.model import Model
from bayesid.effects.parameters import Cone
from bayesid.errors import InputError, SolverError
from bayesid.regression.solver import Solution
from bayesid.robot.inertia import inertia_matrix

TOLERANCE = 1e-6
"""Violation up to which a constraint counts as satisfied, in the constraint's unit: the solver's tolerance."""
_FIRST_WEIGHT = 1e-3
"""Penalty of a unit of squared violation in the first run, in units of phi(0); later runs raise it."""
_TEMPERATURE = 1.0
"""At the start of each run, in units of phi(0): the first jumps span the box, those after 30 steps 1e-4 of it."""
_TOWARDS_START = 1e-7
"""Weight of a penalty on the distance from the start, relative to phi(0): it moves only parameters that phi ignores."""
_STEP = 1e-9
"""Of the constraints' difference quotients, as a share of the box: far below the tolerance, far above rounding."""
_LOCAL_ITERATIONS = 1000
"""Limit of iterations and of evaluations of a local search, which usually ends by its tolerances."""
_LOCAL_DECREASE = 1e-15
"""Relative decrease of the cost at which a local search ends: the limit of rounding."""
_LOCAL_SLOPE = 1e-12
"""Slope of the cost, in units of phi(0), at which a local search ends: the limit of rounding."""


# ---------------------------------------------------------------------------------------------------------------
# The box
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Bounds:
    """A box for P parameters.

    Attributes:
        lower: (P,) smallest values.
        upper: (P,) largest values.
    """

    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        lower = frozen(self.lower, (None,), "lower")
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", frozen(self.upper, lower.shape, "upper"))
        if np.any(self.lower >= self.upper):
            raise ValueError(f"empty bounds {np.flatnonzero(self.lower >= self.upper)}: lower >= upper")


def make_bounds(
    model: Model,
    overrides: Mapping[str, tuple[float, float]] | None = None,
    mass: float = 30.0,
    reach: float = 0.5,
    other: float = 100.0,
) -> Bounds:
    """A box for a model's parameters, wide by default.

    A link whose mass is within `reach` of its frame's origin along each axis has |mc| <= m reach,
    0 <= Jxx <= 2 m reach^2 and |Jxy| <= m reach^2.

    Args:
        model: the model.
        overrides: (lower, upper) of single parameters, by their names in `model.parameters`, in their units.
        mass: largest mass of a link, kg; the smallest is a thousandth of it.
        reach: of a link's mass from its frame's origin, m.
        other: largest size of every other parameter, in its unit; nonnegative ones start at 0.

    Raises:
        InputError: an override names no parameter of the model, or is not a finite (lower, upper) with lower < upper.
    """
    cone = model.cone
    lower, upper = np.full(cone.size, -other), np.full(cone.size, other)
    lower[cone.nonnegative] = 0.0
    moment, second = mass * reach, mass * reach**2
    lower[cone.bodies] = [0, -second, -second, 0, -second, 0, -moment, -moment, -moment, 1e-3 * mass]
    upper[cone.bodies] = [2 * second, second, second, 2 * second, second, 2 * second, moment, moment, moment, mass]
    position = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    for name, (low, high) in (overrides or {}).items():
        if name not in position:
            raise InputError(f"unknown parameter {name!r}", "bounds", f"choose from {', '.join(position)}")
        if not -np.inf < low < high < np.inf:
            raise InputError(f"{name} cannot lie in [{low}, {high}]", "bounds", "give finite numbers, lower < upper")
        lower[position[name]], upper[position[name]] = low, high
    return Bounds(lower, upper)


# ---------------------------------------------------------------------------------------------------------------
# phi
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SquaredError:
    """phi(theta) = |factor theta - target|^2 + constant, the objective of PBPR (:eq:`pbpr-error`).

    Attributes:
        factor: (k, P).
        target: (k,).
        constant: the part that no parameters explain.
    """

    factor: Array
    target: Array
    constant: float

    def __call__(self, theta: Array) -> float:
        """The value of phi at theta (P,)."""
        error = self.factor @ theta - self.target
        return float(error @ error + self.constant)

    @property
    def size(self) -> float:
        """phi(0), the unit of the penalties; 1 where phi(0) is zero."""
        return float(self.target @ self.target + self.constant) or 1.0


def coefficient_error(coefficients: BaseCoefficients, beta: Array, weight: Array | None = None) -> SquaredError:
    """phi1 = (B theta - beta)' W (B theta - beta), the distance to given coefficients.

    Args:
        coefficients: the r base coefficients, for B.
        beta: (r,) the coefficients to match.
        weight: (r, r) W, positive semidefinite, e.g. their inverse covariance; the identity if None.
    """
    if weight is None:
        return SquaredError(coefficients.projection, beta, 0.0)
    return effort_error(coefficients, weight, weight @ beta, float(beta @ weight @ beta))


def effort_error(coefficients: BaseCoefficients, hessian: Array, gradient: Array, energy: float) -> SquaredError:
    """phi2 = |Y B theta - tau|^2 = theta' B' H B theta - 2 g' B theta + c, from normal equations.

    Args:
        coefficients: the r base coefficients, for B.
        hessian: (r, r) H = Y'Y.
        gradient: (r,) g = Y'tau.
        energy: c = tau'tau.
    """
    lengths = np.sqrt(np.diag(hessian))
    lengths[lengths == 0.0] = 1.0
    eigenvalues, vectors = np.linalg.eigh(hessian / np.outer(lengths, lengths))
    shows = eigenvalues > len(hessian) * np.finfo(float).eps * eigenvalues[-1]
    roots, vectors = np.sqrt(eigenvalues[shows]), vectors[:, shows]
    factor = roots[:, None] * (vectors.T * lengths) @ coefficients.projection
    target = vectors.T @ (gradient / lengths) / roots
    return SquaredError(factor, target, energy - float(target @ target))


# ---------------------------------------------------------------------------------------------------------------
# Constraints
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Bodies:
    """Parameters of n bodies (links and payloads), each in its own frame, for constraints.

    Attributes:
        theta: (P,) all parameters of the model.
        cone: defines the places of the bodies in theta.
    """

    theta: Array
    cone: Cone

    @cached_property
    def _bodies(self) -> Array:
        return self.theta[self.cone.bodies]

    @property
    def mass(self) -> Array:
        """(n,) kg."""
        return self._bodies[:, 9]

    @property
    def center_of_mass(self) -> Array:
        """(n, 3) m."""
        return self._bodies[:, 6:9] / self._bodies[:, 9:]

    @property
    def inertia(self) -> Array:
        """(n, 3, 3) about the frame's origin, kg m^2."""
        return inertia_matrix(self._bodies)

    @property
    def inertia_at_center(self) -> Array:
        """(n, 3, 3) about the centre of mass, kg m^2 (Steiner)."""
        center = self.center_of_mass
        squares = np.sum(center**2, axis=1)[:, None, None] * np.eye(3)
        steiner: Array = self.mass[:, None, None] * (squares - center[:, :, None] * center[:, None, :])
        return self.inertia - steiner

    @property
    def pseudo_inertia(self) -> Array:
        """(n, 4, 4) as in `bayesid.robot.inertia`."""
        return self.cone.pseudo_inertias(self.theta)


@dataclass(frozen=True)
class Constraint:
    """A condition on the parameters, as a function of them.

    The violation is a number in any unit (up to 1e-6 counts as satisfied): zero or less where the constraint is
    satisfied, and growing, preferably continuously, with the distance from there. It may be nonlinear and conditional.
    "A forearm (the third link) heavier than 4 kg has its motors at the elbow, so its centre of mass is within 0.1 m of
    it" reads

        def motors_at_elbow(bodies):
            return min(bodies.mass[2] - 4.0, np.linalg.norm(bodies.center_of_mass[2]) - 0.1)

        Constraint("motors at the elbow", motors_at_elbow)

    Attributes:
        name: unique among the constraints of a problem.
        violation: the function.
    """

    name: str
    violation: Callable[[Bodies], float]


def feasible_inertia(margin: float = 2 * TOLERANCE) -> Constraint:
    """Every pseudo-inertia is positive definite, as for a body of positive density (Wensing, Kim, Slotine 2018).

    The violation is the distance of the pseudo-inertias from those with all eigenvalues >= margin.

    Args:
        margin: smallest eigenvalue (kg m^2 to kg); above the tolerance, so that satisfied means strictly feasible.
    """

    def violation(bodies: Bodies) -> float:
        eigenvalues = np.linalg.eigvalsh(bodies.pseudo_inertia).astype(np.float64)
        return _excess(margin - eigenvalues)

    return Constraint("feasible inertia", violation)


def stated(constraints: Constraints) -> Constraint:
    """All constraints of an identification (`constraints=`), from `result.model.cone.stated`."""

    def violation(bodies: Bodies) -> float:
        eigenvalues = np.linalg.eigvalsh(constraints.matrices(bodies.theta)).ravel()
        apart = np.abs(constraints.gap(bodies.theta))
        return _excess(np.concatenate([-constraints.slack(bodies.theta), -eigenvalues, apart]).astype(np.float64))

    return Constraint("stated", violation)


def total_mass(lowest: float, highest: float) -> Constraint:
    """The total mass of all links is within a range, kg."""

    def violation(bodies: Bodies) -> float:
        total = float(bodies.mass.sum())
        return max(lowest - total, total - highest)

    return Constraint("total mass", violation)


def center_of_mass_inside(lowest: Array, highest: Array) -> Constraint:
    """Every link's centre of mass is inside a box.

    Args:
        lowest: (n, 3) corner of each box in the link's frame, m.
        highest: (n, 3) the opposite corner.
    """

    def violation(bodies: Bodies) -> float:
        center = bodies.center_of_mass
        return _excess(np.maximum(lowest - center, center - highest))

    return Constraint("centre of mass", violation)


def _excess(distances: Array) -> float:
    """Norm of the positive part; its square is smooth where a constraint becomes active."""
    return float(np.linalg.norm(np.maximum(distances, 0.0)))


# ---------------------------------------------------------------------------------------------------------------
# Annealing
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Annealing:
    """Length of the search.

    Attributes:
        runs: largest number; the first run that satisfies all constraints is the last.
        evaluations: of phi + gamma in a run before the final local search.
        growth: factor on the penalty's weight from run to run.
        seed: of the random jumps.
    """

    runs: int = 12
    evaluations: int = 5000
    growth: float = 10.0
    seed: int = 0


@dataclass(frozen=True)
class AnnealedParameters:
    """The result of PBPR.

    Attributes:
        theta: (P,) parameters, inside their bounds.
        phi: the error at theta, without penalties.
        violations: of each constraint, by name; 0 if satisfied.
        penalty_weight: of the last run, phi(0) per squared unit of violation; 0 without annealing.
        runs: of the annealing.
        evaluations: of phi + gamma, including those for difference quotients.
    """

    theta: Array
    phi: float
    violations: Mapping[str, float]
    penalty_weight: float
    runs: int
    evaluations: int

    @property
    def satisfied(self) -> bool:
        """Whether theta satisfies all constraints, to `TOLERANCE`."""
        return all(violation <= TOLERANCE for violation in self.violations.values())


def retrieve_by_annealing(
    error: SquaredError,
    cone: Cone,
    bounds: Bounds,
    constraints: Sequence[Constraint] | None = None,
    annealing: Annealing | None = None,
    start: Array | None = None,
) -> AnnealedParameters:
    """PBPR: minimises `error` within bounds and constraints.

    Args:
        error: phi1 or phi2 of the P parameters.
        cone: defines the places of bodies; it is not a constraint by itself.
        bounds: the box; parameters that `error` ignores stay at `start` unless a constraint moves them.
        constraints: `feasible_inertia()` if None.
        annealing: length of the search.
        start: (P,) initial parameters, for example identified ones; by default the middle of the box.

    Raises:
        InputError: a constraint's violation is not a finite number, or two constraints share a name.
        SolverError: phi could not be minimised in the box.
    """
    annealing = Annealing() if annealing is None else annealing
    problem = _Problem(error, cone, bounds, (feasible_inertia(),) if constraints is None else tuple(constraints))
    rng = np.random.default_rng(annealing.seed)
    x, weight, run = problem.least_squares(start), 0.0, 0
    while np.any(problem.violations(x) > TOLERANCE) and run < annealing.runs:
        weight = _FIRST_WEIGHT * annealing.growth**run
        x = problem.anneal(x, weight, annealing.evaluations, rng)
        run += 1
    violations = {c.name: float(v) for c, v in zip(problem.constraints, problem.violations(x), strict=True)}
    theta = problem.theta(x)
    return AnnealedParameters(theta, error(theta), violations, weight, run, problem.evaluations)


class _Problem:
    """phi + weight * sum of squared violations in units of phi(0), over the unit box; counts evaluations."""

    def __init__(self, error: SquaredError, cone: Cone, bounds: Bounds, constraints: tuple[Constraint, ...]) -> None:
        names = [constraint.name for constraint in constraints]
        if len(set(names)) < len(names):
            raise InputError(f"the names {names} repeat", "constraints", "give each constraint another name")
        self.constraints = constraints
        self.evaluations = 0
        self._cone, self._bounds, self._width = cone, bounds, bounds.upper - bounds.lower
        root = np.sqrt(error.size)
        self._factor = error.factor * self._width / root
        self._target = (error.target - error.factor @ bounds.lower) / root

    def theta(self, x: Array) -> Array:
        """(P,) parameters at a point (P,) of the unit box, clipped to the bounds."""
        return np.clip(self._bounds.lower + self._width * x, self._bounds.lower, self._bounds.upper)

    def violations(self, x: Array) -> Array:
        """(number of constraints,) zero where satisfied."""
        self.evaluations += 1
        bodies = Bodies(self.theta(x), self._cone)
        values = np.array([float(constraint.violation(bodies)) for constraint in self.constraints])
        for constraint, value in zip(self.constraints, values, strict=True):
            if not np.isfinite(value):
                remedy = "return a finite number for every theta within the bounds"
                raise InputError(f"the violation is {value}", f"constraint {constraint.name!r}", remedy)
        violations: Array = np.maximum(values, 0.0)
        return violations

    def cost(self, x: Array, weight: float) -> float:
        """Value of phi + gamma, without phi's constant part."""
        error, violations = self._factor @ x - self._target, self.violations(x)
        return float(error @ error + weight * (violations @ violations))

    def gradient(self, x: Array, weight: float) -> Array:
        """(P,) of the cost: analytic in phi, by differences where a constraint is violated."""
        gradient: Array = 2.0 * self._factor.T @ (self._factor @ x - self._target)
        violations = self.violations(x)
        if np.any(violations > 0.0):
            gradient += 2.0 * weight * violations @ self._slopes(x, violations)
        return gradient

    def _slopes(self, x: Array, violations: Array) -> Array:
        """(number of constraints, P) slopes of the violations; each difference is taken towards the middle."""
        slopes = np.empty((len(violations), len(x)))
        for k in range(len(x)):
            beside = x.copy()
            beside[k] += _STEP if x[k] < 0.5 else -_STEP
            slopes[:, k] = (self.violations(beside) - violations) / (beside[k] - x[k])
        return slopes

    def least_squares(self, start: Array | None = None) -> Array:
        """(P,) the exact minimum of phi in the box, by active sets (Stark and Parker 1995).

        Raises:
            SolverError: the active set did not converge.
        """
        size = self._factor.shape[1]
        rows = np.vstack([self._factor, _TOWARDS_START * np.eye(size)])
        towards = np.full(size, 0.5) if start is None else _clipped((start - self._bounds.lower) / self._width)
        target = np.concatenate([self._target, _TOWARDS_START * towards])
        result = scipy.optimize.lsq_linear(rows, target, (0.0, 1.0), method="bvls", max_iter=100 * size)
        if not result.success:
            raise SolverError("least squares within bounds", result.message)
        return _clipped(result.x)

    def anneal(self, x: Array, weight: float, evaluations: int, rng: np.random.Generator) -> Array:
        """(P,) the best point of one run that starts from x."""

        def cost(at: Array) -> float:
            return self.cost(at, weight)

        # As many corrections as parameters: phi is ill-conditioned, and an iteration costs less than a gradient.
        local = {
            "method": "L-BFGS-B",
            "jac": lambda at: self.gradient(at, weight),
            "bounds": [(0.0, 1.0)] * len(x),
            "options": {
                "maxcor": len(x),
                "maxiter": _LOCAL_ITERATIONS,
                "maxfun": _LOCAL_ITERATIONS,
                "ftol": _LOCAL_DECREASE,
                "gtol": _LOCAL_SLOPE,
            },
        }
        annealed = scipy.optimize.dual_annealing(
            cost, local["bounds"], x0=x, maxfun=evaluations, seed=rng, initial_temp=_TEMPERATURE, minimizer_kwargs=local
        )
        # The last jump may not have had its local search.
        polished = scipy.optimize.minimize(cost, annealed.x, **local)
        return _clipped(polished.x if polished.fun < annealed.fun else annealed.x)


def _clipped(x: Array) -> Array:
    """(P,) the point of the unit box nearest to x; solvers may violate bounds by rounding."""
    clipped: Array = np.clip(x, 0.0, 1.0)
    return clipped


@dataclass(frozen=True)
class AnnealedLeastSquares:
    """PBPR as the solver of a node (`bayesid.signs.search.protocol.NodeSolver`), as in T-PBPR.

    Slower than `ConeLeastSquares`. If a node violates constraints after the last run, its cost includes the penalty and
    its solution's tolerance is the largest violation: a solution is feasible if that is at most `TOLERANCE`.

    Attributes:
        cone: the cone of the P parameters.
        coefficients: the r base coefficients, for B.
        bounds: the box.
        energy: c of all data, the unit of the penalties.
        constraints: `feasible_inertia()` by default.
        annealing: length of the search in each node.
    """

    cone: Cone
    coefficients: BaseCoefficients
    bounds: Bounds
    energy: float
    constraints: Sequence[Constraint] = field(default_factory=lambda: (feasible_inertia(),))
    annealing: Annealing = field(default_factory=Annealing)

    def prepared(self, hessian: Array) -> AnnealedNode:
        """The solver of nodes with one H (r, r)."""
        return AnnealedNode(self, hessian)


@dataclass(frozen=True)
class AnnealedNode:
    """PBPR for one H.

    Attributes:
        solver: bounds, constraints and annealing.
        hessian: (r, r) H.
    """

    solver: AnnealedLeastSquares
    hessian: Array

    def solve(self, gradient: Array) -> Solution:
        """The best point for g (r,).

        Raises:
            InputError: a constraint's violation is not a finite number.
            SolverError: phi could not be minimised in the box.
        """
        solver = self.solver
        error = effort_error(solver.coefficients, self.hessian, gradient, solver.energy)
        best = retrieve_by_annealing(error, solver.cone, solver.bounds, solver.constraints, solver.annealing)
        violations = np.array(list(best.violations.values()))
        penalty = error.size * best.penalty_weight * float(violations @ violations)
        return Solution(best.theta, best.phi + penalty - solver.energy, float(violations.max(initial=0.0)))
