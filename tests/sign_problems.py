"""Small sign problems, and what all their assignments cost, worked out apart from the searches.

The rows of a problem are kept, so that a bound can be checked against the least squares that it stands for. A cost in
the cone is that of the quadratic program in the parameters theta themselves, the Tikhonov term included: in closed form
without a cone, by active sets (`scipy.optimize.nnls`) where parameters are only nonnegative, and by the solver, as
precisely as it can, where there are bodies.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from conftest import random_motion, small_robot
from oracles import random_table
from scipy.optimize import nnls

from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.effects.parameters import Cone
from bayesid.log.segments import Segments
from bayesid.regression.normal_equations import Hessians, NormalEquations, normal_equations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.robot import robot_from_table
from bayesid.robot.inertia import from_pseudo_inertia
from bayesid.simulation.parameters import random_parameters

EXACT = 1e-8  # share of the energy below which two costs count as equal in a search
ROUNDING = 1e-9  # share of the energy that they allow for rounding
STRONG = 0.1  # of a joint's strongest segment: what a proof decides one by one has at least this energy


@dataclass(frozen=True)
class SignProblem:
    cone: Cone
    coefficients: BaseCoefficients
    normal_equations: NormalEquations
    rows: tuple[tuple[np.ndarray, np.ndarray], ...] = ()

    @property
    def energy(self):
        return float(self.normal_equations.energy.sum())

    def solver(self, tolerance=1e-6):
        hessian = self.normal_equations.hessian.total()
        return ConeLeastSquares(self.cone, self.coefficients, hessian, self.energy, tolerance=tolerance)

    @property
    def exact(self):
        """What counts as equal in a search, and what the brute force itself may be off."""
        return EXACT * self.energy + self._priced[1]

    @property
    def precision(self):
        """Of the brute force: the solver leaves bodies a little outside of the cone."""
        return (EXACT if len(self.cone.bodies) else ROUNDING) * self.energy + self._priced[1]

    def but(self, changed):
        return SignProblem(self.cone, self.coefficients, changed)

    @cached_property
    def assignments(self):
        """(2^unknown, S) all signs that are possible."""
        known = self.normal_equations.known
        unknown = np.flatnonzero(known == 0)
        signs = np.tile(known, (2 ** len(unknown), 1))
        choices = list(itertools.product((1, -1), repeat=len(unknown)))
        signs[:, unknown] = np.array(choices, dtype=np.int64).reshape(len(signs), len(unknown))
        return signs

    @property
    def costs(self):
        """(2^unknown,) the cost of each of the assignments: brute force."""
        return self._priced[0]

    @property
    def least(self):
        return float(self.costs.min())

    def price(self, signs):
        """min over the cone of f(theta, signs) + rho(theta)."""
        return self._price(signs)[0]

    @cached_property
    def _priced(self):
        """The costs of all assignments, and how far the worst of them may be off."""
        costs, doubts = np.array([self._price(signs) for signs in self.assignments]).T
        return costs, float(doubts.max())

    def _price(self, signs):
        if len(self.cone.bodies):
            solution = self._precise.solve_precisely(signs @ self.normal_equations.gradient)
            return self.energy + solution.cost, solution.cost - solution.lower_bound
        root, free = self._root, np.setdiff1d(np.arange(self.cone.size), self.cone.nonnegative)
        target = np.linalg.solve(root.T, self._slope(signs))
        weight, centre = self.pull
        unconstrained = self.energy + float(weight @ centre**2 - target @ target)
        if len(free) == self.cone.size:
            return unconstrained, 0.0
        columns = np.hstack([root, -root[:, free]])  # a free parameter is the difference of two nonnegative ones
        columns /= np.linalg.norm(columns, axis=0)  # or nnls may stop early, and its own residual is not to be trusted
        left = columns @ nnls(columns, target)[0] - target
        assert np.min(columns.T @ left) >= -1e-9 * np.linalg.norm(target), "nnls has not found the optimum"
        return unconstrained + float(left @ left), 0.0

    @cached_property
    def pull(self):
        """(P,) weight w and (P,) centre t with rho(theta) = sum w_k (theta_k - t_k)^2, from differences of rho."""
        rho, steps = self.solver().regularisation, np.eye(self.cone.size)
        at_zero = rho(np.zeros(self.cone.size))
        ahead, behind = (np.array([rho(sign * step) for step in steps]) for sign in (1.0, -1.0))
        weight = 0.5 * (ahead + behind) - at_zero
        return weight, 0.25 * (behind - ahead) / weight

    def _slope(self, signs):
        weight, centre = self.pull
        return (signs @ self.normal_equations.gradient) @ self.coefficients.projection + weight * centre

    @cached_property
    def _root(self):
        projection = self.coefficients.projection
        quadratic = projection.T @ self.normal_equations.hessian.total() @ projection + np.diag(self.pull[0])
        return np.linalg.cholesky(quadratic).T

    @cached_property
    def _precise(self):
        return self.solver().prepared()


def synthetic(
    seed, segments=6, joints=1, cone="orthant", size=4, noise=0.5, spread=1.0, longest=6, known=0, scale=1.0, load=1.0
):
    """Random rows, each segment with a sign of its own and some noise: dense, and of no robot in particular.

    The cone is "free", "orthant", "half" (of the parameters nonnegative) or "body" (one, and nonnegative ones); `noise`
    is relative to each segment's effort, energies differ by the square of `spread`, segments are shared out among the
    joints at random, and a small `load` makes parameters far below a typical link's, to which the Tikhonov term then is
    strong.
    """
    rng = np.random.default_rng(seed)
    cones = {
        "free": Cone.free(size + 1),
        "orthant": Cone.orthant(size + 1),
        "half": Cone.orthant(size // 2 + 1) + Cone.free(size - size // 2),
        "body": Cone.rigid_bodies(1) + Cone.orthant(size),
    }
    n = cones[cone].size
    names = tuple(f"b{k}" for k in range(size))
    projection = np.hstack([np.eye(size), rng.normal(size=(size, n - size))])
    coefficients = BaseCoefficients(names, names, names, np.arange(size), projection)
    theta = load * np.abs(rng.normal(size=n))
    if cone == "body":
        root = rng.normal(size=(4, 4))
        theta[:10] = load * from_pseudo_inertia(root @ root.T)
    rows = []
    for _ in range(segments):
        columns = rng.normal(size=(rng.integers(1, longest + 1), size)) * spread ** -rng.uniform()
        effort = columns @ coefficients.project(theta)
        error = noise * np.sqrt(np.mean(effort**2)) * rng.normal(size=len(effort))
        rows.append((scale * columns, scale * (np.sign(effort.sum()) * effort + error)))
    signs = np.zeros(segments, dtype=np.int64)
    signs[rng.choice(segments, known, replace=False)] = rng.choice([-1, 1], known)
    joint = rng.integers(0, joints, segments)
    return SignProblem(cones[cone], coefficients, moments_of(rows, joint, signs), tuple(rows))


def moments_of(rows, joint, known):
    """Moments of segments of which the rows (Y, e) are given, by their definition."""
    hessian = Hessians.make(np.asarray(joint), np.array([y.T @ y for y, _ in rows]))
    gradient, energy = np.array([y.T @ e for y, e in rows]), np.array([e @ e for _, e in rows])
    return NormalEquations(
        np.asarray(joint), np.asarray(known), hessian, gradient, energy, np.array([len(e) for _, e in rows])
    )


def arm(seed, segments=6, joints=2, terms=("rigid_body", "viscous_friction"), noise=0.5, known=0, coupled=False):
    """|effort| of a physical robot with noise, cut at random: the truth need not be the best."""
    rng = np.random.default_rng(seed)
    robot = small_robot(joints, seed)
    if coupled:
        robot = robot_from_table(random_table("modified", joints, seed, coupled=True), "test")
    samples = 8 * segments
    motion = random_motion(joints, samples, seed)
    model = Model(robot, make_terms(terms, robot, motion))
    coefficients = base_coefficients(model)
    effort = model.effort(motion, random_parameters(model, rng=rng))
    effort = np.abs(effort + noise * np.sqrt(np.mean(effort**2, axis=0)) * rng.normal(size=effort.shape))
    cuts = np.sort(rng.choice(np.arange(2, samples - 2), segments - 1, replace=False))
    start, end = np.concatenate([[0], cuts]), np.concatenate([cuts, [samples]])
    signs = np.zeros(segments, dtype=np.int64)
    signs[rng.choice(segments, known, replace=False)] = rng.choice([-1, 1], known)
    joint = rng.integers(0, joints, segments)
    cut = Segments(joint, start, end, signs, np.ones(segments, dtype=bool))
    sigma = np.maximum(noise, 0.05) * np.sqrt(np.mean(effort**2, axis=0))
    return SignProblem(
        model.cone, coefficients, normal_equations(model, coefficients, motion, effort, cut).scaled(sigma)
    )


def strong(m):
    """(S,) segments whose signs are known, or that a proof on moments `m` decides one by one."""
    chosen = m.known != 0
    for joint in np.unique(m.joint):
        here = (m.joint == joint) & (m.known == 0) & m.individual
        chosen |= here & (m.energy >= STRONG * m.energy[here].max(initial=0.0))
    return chosen
