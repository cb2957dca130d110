"""The sign problem of one log, shared by all stages of the certified search."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.progress import Steps, no_steps
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares, PreparedLeastSquares, Solution
from bayesid.signs.search.bounds import Flips, UnconstrainedBound
from bayesid.signs.search.patterns import Patterns, make_blocks
from bayesid.signs.search.protocol import EXACT, Assignment, Budget, predicted_signs
from bayesid.signs.tuning import TUNING, Tuning

_ROUNDING = 1e-8
"""Share of the energy by which rounding, and the ridge against it, may raise an unconstrained bound; far above double
precision."""


class OutOfTimeError(Exception):
    """The budget has ended."""


class SearchProblem:
    """Normal equations, one block for each joint, and prepared bounds; counts the work.

    The Tikhonov term (beta - b)' Q (beta - b) is at least beta' Q beta / 2 - b' Q b (:eq:`tikhonov-share`). The first
    part is divided among the joints' bounds, which keeps them well conditioned and additive: a small share
    (`undecided_tikhonov`) goes to undecided rows, the rest to decided ones. The second part is `slack`, by which the
    sum may be too high (with an allowance for rounding).

    `steps` is called as steps(percent of the budget, 100) until the budget is spent.
    """

    def __init__(
        self,
        normal_equations: NormalEquations,
        solver: ConeLeastSquares,
        budget: float,
        time_limit: float = np.inf,
        tuning: Tuning = TUNING,
        steps: Steps = no_steps,
    ) -> None:
        self.tikhonov, centre = solver.tikhonov()
        self.budget = Budget(budget, len(self.tikhonov), time_limit)  # limit of the work
        self.normal_equations, self.solver, self.tuning = normal_equations, solver, tuning
        self._hessian, self.energy = normal_equations.hessian.total(), float(normal_equations.energy.sum())
        self.unconstrained = UnconstrainedBound(self._hessian + self.tikhonov, 0.0)
        self.exact = EXACT * self.energy  # cost difference below which two assignments are equal
        self.rounding = _ROUNDING * self.energy
        # subtracted from an unconstrained bound
        self.slack = float(centre @ self.tikhonov @ centre) + self.rounding
        self.blocks = make_blocks(normal_equations, (0.5 - tuning.undecided_tikhonov) * self.tikhonov)
        self.solves = self.combined = 0  # cone problems solved, combinations of several joints' patterns priced
        self.tolerance = 0.0  # coarsest relative gap of a cone problem
        self.tails: list[float] = []  # lower bounds of the cost of each block's weak segments, once computed
        self._steps, self._reported = steps, 0
        self._prepared = solver.prepared(self._hessian)
        self._priced: dict[bytes, Assignment] = {}
        self._solved: dict[bytes, Assignment] = {}

    @property
    def nodes(self) -> int:
        """Sign choices priced by the unconstrained bound."""
        return self.combined + sum(block.nodes for block in self.blocks)

    def count(self, choices: int) -> None:
        """Counts a step with this many priced sign choices."""
        self.budget.count(steps=1, choices=choices)
        self._report()

    def _report(self) -> None:
        whole = self.budget.seconds
        percent = int(100.0 * self.budget.spent / whole) if 0.0 < whole < np.inf else 0
        if self._reported < percent < 100:
            self._reported = percent
            self._steps(percent, 100)

    def check(self, choices: int) -> None:
        """Counts a step, and raises OutOfTimeError after the end of the budget."""
        self.count(choices)
        if self.budget.over:
            raise OutOfTimeError

    def decided(self, patterns: Patterns, row: int) -> Integers:
        """(S,) known signs and those of a pattern; 0 elsewhere."""
        signs = self.normal_equations.known.copy()
        signs[patterns.segments] = patterns.signs[row]
        return signs

    def decided_moments(self, patterns: Patterns) -> tuple[Array, float]:
        """(r, r) H and energy of the known segments and those that the patterns decide."""
        rows = np.concatenate([np.flatnonzero(self.normal_equations.known), patterns.segments])
        return self.normal_equations.hessian_of(rows), float(self.normal_equations.energy[rows].sum())

    def solve(self, prepared: PreparedLeastSquares, gradient: Array) -> Solution:
        """The best parameters for g (r,) and the prepared H."""
        return self._counted(prepared.solve(gradient))

    def complete(self, decided: Integers, theta: Array) -> Assignment:
        """Undecided segments (0 in `decided`, (S,)) get the signs that theta (P,) predicts; with the best cost."""
        return self._known(self._completed(decided, theta))

    def local_optimum(self, decided: Integers, theta: Array) -> Assignment:
        """Local optimum from theta (P,), by alternating undecided segments (0 in `decided`, (S,)) and parameters.

        Neither step can raise the cost. The lower bound is for the resulting signs only.
        """
        signs = self._completed(decided, theta)
        for _ in range(self.tuning.alternations):
            assignment = self._known(signs)
            after = self._completed(decided, assignment.theta)
            if np.array_equal(after, signs):
                return assignment
            signs = after
        return self._known(signs)

    def local_optimum_from(self, signs: Integers) -> Assignment:
        """The same with all unknown segments undecided, from the best parameters for signs (S,)."""
        return self.local_optimum(self.normal_equations.known, self._known(signs).theta)

    def _known(self, signs: Integers) -> Assignment:
        key = _key(signs)
        if key not in self._solved:
            self._solved[key] = self._assignment(
                signs, self.solve(self._prepared, signs @ self.normal_equations.gradient)
            )
        return self._solved[key]

    def price(self, signs: Integers) -> Assignment:
        """The best parameters for given signs (S,), solved precisely; equal signs are solved once."""
        key = _key(signs)
        if key not in self._priced:
            solution = self._prepared.solve_precisely(signs @ self.normal_equations.gradient)
            self._priced[key] = self._solved[key] = self._assignment(signs, self._counted(solution))
        return self._priced[key]

    def tikhonov_of(self, assignment: Assignment) -> float:
        """The Tikhonov term in the cost of an assignment."""
        return self.solver.regularisation(assignment.theta)

    def data_cost(self, assignment: Assignment) -> tuple[float, float]:
        """Lower bound and value of an assignment's data cost, with a negligible Tikhonov term."""
        lighter = self.solver.lighter(self.tuning.lighter_tikhonov)
        solution = self._counted(
            lighter.prepared(self._hessian).solve_precisely(assignment.signs @ self.normal_equations.gradient)
        )
        value = self.energy + solution.cost - lighter.regularisation(solution.theta)
        return min(self.energy + solution.lower_bound, value), value

    def flips(self, assignment: Assignment, free: Integers) -> Flips:
        """Bounds of the cost of flipping free segments of an assignment."""
        self.budget.count(pairs=len(free) ** 2)
        return self._flips(assignment, free)

    def single_flips(self, assignment: Assignment, free: Integers) -> Array:
        """(free,) lower bounds of the change if one free segment is flipped."""
        return self._flips(assignment, free).alone

    def _flips(self, assignment: Assignment, free: Integers) -> Flips:
        beta, gap = self.solver.project(assignment.theta), assignment.cost - assignment.lower_bound
        return Flips(self.normal_equations, self.unconstrained, assignment.signs, beta, gap, free, self.tuning)

    def _completed(self, decided: Integers, theta: Array) -> Integers:
        return predicted_signs(self.normal_equations, self.solver.project(theta), decided)

    def _assignment(self, signs: Integers, solution: Solution) -> Assignment:
        return Assignment(signs, solution.theta, self.energy + solution.cost, self.energy + solution.lower_bound)

    def _counted(self, solution: Solution) -> Solution:
        self.solves += 1
        self.budget.count(parameters=len(solution.theta))
        self._report()
        self.tolerance = max(self.tolerance, solution.tolerance)
        return solution


def _key(signs: Integers) -> bytes:
    return signs.astype(np.int8).tobytes()
