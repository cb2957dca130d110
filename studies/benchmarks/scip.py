"""The sign problem without the cone, and SCIP on it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from bayesid.arrays import Array, Integers
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares, Solution
from bayesid.signs.search.certified import certified
from bayesid.signs.search.protocol import SearchResult
from bayesid.studies.benchmarks.problems import BUDGET, SAME, Check, LogProblem, Table, timed

_GAP = 1e-7
"""Relative gap at which SCIP stops."""


# ---------------------------------------------------------------------------------------------------------------
# The sign problem without the cone
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class NoCone:
    """Least squares without cone, in closed form, as a replacement of `ConeLeastSquares`; theta is beta.

    Attributes:
        weight: (r, r) Q of the Tikhonov term beta' Q beta.
    """

    weight: Array

    def tikhonov(self) -> tuple[Array, Array]:
        """Q (r, r) and the centre (r,), zero."""
        return self.weight, np.zeros(len(self.weight))

    def regularisation(self, theta: Array) -> float:
        """The Tikhonov term on theta (r,)."""
        return float(theta @ self.weight @ theta)

    def lighter(self, share: float) -> NoCone:
        """Itself: the Tikhonov term is part of the problem that both searches solve."""
        return self

    def prepared(self, hessian: Array) -> PreparedNoCone:
        """A solver for one H (r, r)."""
        return PreparedNoCone(hessian + self.weight)

    def project(self, theta: Array) -> Array:
        """(r,) coefficients, which are the parameters."""
        return theta


class PreparedNoCone:
    """The same for one H, in closed form.

    Args:
        quadratic: (r, r) H + Q.
    """

    def __init__(self, quadratic: Array) -> None:
        self._factor = cho_factor(quadratic, lower=True)

    def solve(self, gradient: Array) -> Solution:
        """The point (H + Q)^-1 g; with beta for it, the cost -g' beta is its own lower bound."""
        beta = cho_solve(self._factor, gradient)
        cost = -float(gradient @ beta)
        return Solution(beta, cost, 0.0, cost)

    def solve_precisely(self, gradient: Array) -> Solution:
        """The same."""
        return self.solve(gradient)


@dataclass(frozen=True)
class FreeProblem:
    """min over s of c - s'G'(H + Q)^-1 G s = c (1 - |W s|^2), the sign of the strongest segment fixed.

    Attributes:
        normal_equations: of S segments, the strongest one's sign known.
        tikhonov: (r, r) Q.
    """

    normal_equations: NormalEquations
    tikhonov: Array

    @property
    def energy(self) -> float:
        """The energy c."""
        return float(self.normal_equations.energy.sum())

    @property
    def white(self) -> Array:
        """(r, S) W."""
        factor = np.linalg.cholesky(self.normal_equations.hessian.total() + self.tikhonov)
        white: Array = solve_triangular(factor, self.normal_equations.gradient.T, lower=True) / np.sqrt(self.energy)
        return white

    def cost(self, signs: Array | Integers) -> float:
        """The cost of signs (S,)."""
        return self.energy * (1.0 - float(np.sum((self.white @ signs) ** 2)))

    def certified(self, budget: float = BUDGET) -> SearchResult:
        """The certified search."""
        return certified(self.normal_equations, cast(ConeLeastSquares, NoCone(self.tikhonov)), budget)


def without_cone(problem: LogProblem) -> FreeProblem:
    """The problem without its cone; the sign of the strongest segment is fixed, since all signs could be flipped."""
    known = problem.normal_equations.known.copy()
    known[np.argmax(problem.normal_equations.energy)] = 1
    return FreeProblem(replace(problem.normal_equations, known=known), problem.solver().tikhonov()[0])


# ---------------------------------------------------------------------------------------------------------------
# SCIP
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ScipResult:
    """SCIP's result.

    Attributes:
        signs: (S,) its best assignment.
        cost: of these signs.
        lower_bound: proven by SCIP.
        proven: whether it finished.
        seconds: of the optimisation, without the formulation.
    """

    signs: Array
    cost: float
    lower_bound: float
    proven: bool
    seconds: float


def convex(scip: Any, model: Any, problem: FreeProblem, signs: list[Any]) -> Any:
    """The cost as a convex quadratic function of beta and s, a sum of squares because s_k^2 = 1.

    In u = L' beta with LL' = H + Q, and with C the diagonal matrix of the c_k, it is u'u - 2 u'W s + s'C s
    = |u - W s|^2 + s'(C - W'W)s. SCIP gets a variable for each square and their sum as one constraint. Other
    factorisations are slower; without one SCIP does not finish 20 segments.
    """
    white, energy = problem.white, problem.normal_equations.energy / problem.energy
    values, vectors = np.linalg.eigh(np.diag(energy) - white.T @ white)
    free = {"lb": None}
    rows = [model.addVar(**free) - _dot(scip, row, signs) for row in white]
    rows += [
        _dot(scip, root * row, signs) for root, row in zip(np.sqrt(np.maximum(values, 0.0)), vectors.T, strict=True)
    ]
    squares = [model.addVar(**free) for _ in rows]
    for square, row in zip(squares, rows, strict=True):
        model.addCons(square == row)
    cost = model.addVar(lb=0.0)
    model.addCons(scip.quicksum(square * square for square in squares) <= cost)
    return cost


def products(scip: Any, model: Any, problem: FreeProblem, signs: list[Any]) -> Any:
    """The binary quadratic problem, linearised by a variable for each product of two signs (McCormick 1976).

    With s = 2x - 1 and w = x_i x_j the product of two signs is 4w - 2x_i - 2x_j + 1. Only bounds of w that can be
    active at the optimum are stated.
    """
    interference, terms = problem.white.T @ problem.white, [1.0 - float(np.sum(problem.white**2))]
    for i, j in itertools.combinations(range(len(signs)), 2):
        weight = -2.0 * float(interference[i, j])
        if isinstance(signs[i], float) or isinstance(signs[j], float):
            terms.append(weight * signs[i] * signs[j])
            continue
        first, second = 0.5 * (signs[i] + 1.0), 0.5 * (signs[j] + 1.0)
        both = model.addVar(lb=0.0, ub=1.0)
        if weight > 0.0:
            model.addCons(both >= first + second - 1.0)
        else:
            model.addCons(both <= first)
            model.addCons(both <= second)
        terms.append(weight * (4.0 * both - signs[i] - signs[j] - 1.0))
    return scip.quicksum(terms)


Formulation = Callable[[Any, Any, FreeProblem, list[Any]], Any]
"""States the objective, in units of c, from pyscipopt, its model, the problem and the signs."""

_WHOLE = 100
"""Segments from which a problem counts as a whole log, not as one shortened for SCIP."""
FORMULATIONS: dict[str, Formulation] = {"convex": convex, "products": products}


def scip_installed() -> bool:
    """Whether pyscipopt can be imported."""
    return find_spec("pyscipopt") is not None


def solve_with_scip(problem: FreeProblem, formulation: Formulation, limit: float) -> ScipResult:
    """SCIP on one formulation of the problem, on one thread, for at most `limit` seconds."""
    scip = import_module("pyscipopt")
    model = scip.Model()
    model.hideOutput()
    model.setParam("limits/time", limit)
    model.setParam("limits/gap", _GAP)
    bits = [None if known else model.addVar(vtype="B") for known in problem.normal_equations.known]
    signs = [1.0 if bit is None else 2.0 * bit - 1.0 for bit in bits]
    model.setObjective(formulation(scip, model, problem, signs), "minimize")
    began = time.perf_counter()
    model.optimize()
    seconds = time.perf_counter() - began
    best = np.array([1.0 if bit is None or model.getVal(bit) > 0.5 else -1.0 for bit in bits])
    bound = problem.energy * float(model.getDualbound())
    return ScipResult(best, problem.cost(best), bound, model.getStatus() in ("optimal", "gaplimit"), seconds)


def _dot(scip: Any, weights: Array, signs: list[Any]) -> Any:
    return scip.quicksum(float(weight) * sign for weight, sign in zip(weights, signs, strict=True))


# ---------------------------------------------------------------------------------------------------------------
# The comparison
# ---------------------------------------------------------------------------------------------------------------
def against_scip(problems: Sequence[LogProblem], limit: float) -> list[Check]:
    """The certified search and SCIP, `limit` seconds each formulation, on problems without their cones."""
    print("costs and SCIP's lower bounds as shares of the energy")
    headers = [header for name in FORMULATIONS for header in (f"SCIP {name} s", "cost", "bound", "proven")]
    table = Table("problem", "segments", "certified s", "cost", "certified", *headers)
    return [check for problem in problems for check in _against_scip(table, problem, limit)]


def _against_scip(table: Table, problem: LogProblem, limit: float) -> list[Check]:
    free = without_cone(problem)
    ours, seconds = timed(free.certified)
    theirs = [solve_with_scip(free, formulation, limit) for formulation in FORMULATIONS.values()]
    cells = [(scip.seconds, scip.cost / free.energy, scip.lower_bound / free.energy, scip.proven) for scip in theirs]
    cost = ours.cost / free.energy
    values = (value for row in cells for value in row)
    table.row(problem.name, len(free.normal_equations), seconds, cost, ours.certified, *values)
    finished = [scip.seconds for scip in theirs if scip.proven]
    excess = cost - min(scip.cost for scip in theirs) / free.energy
    same = excess <= SAME and (not finished or excess >= -SAME)
    ratio = min(finished, default=limit) / seconds
    where = f"scip: {problem.name} ({len(free.normal_equations)} segments):"
    target = "SCIP's optimum" if finished else "<= SCIP's best"
    checks = [Check(f"{where} certified cost", f"{excess:+.1e} of the energy", target, same and ours.certified)]
    if len(free.normal_equations) < _WHOLE:
        print(f"  shortened so that SCIP finishes: {ratio:.1f} x the time of the certified search (no target)")
        return checks
    return [*checks, Check(f"{where} faster", f"{'' if finished else '>= '}{ratio:.1f} x", ">= 20 x", ratio >= 20.0)]
