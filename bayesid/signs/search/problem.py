"""The sign problem of one set of moments: what every stage of the certified search shares."""

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
"""Share of the energy by which rounding, and the ridge against it, may raise an unconstrained bound: a round number far
above double precision."""


class OutOfTimeError(Exception):
    """The budget has ended."""


class Problem:
    """The normal equations, one block for each joint, and what is prepared once; counts what was done.

    The Tikhonov term (beta - b)' Q (beta - b) is at least beta' Q beta / 2 - b' Q b (:eq:`tikhonov-share`). The first
    part is shared among the joints' own bounds, which keeps them well conditioned and lets them add up: a small share
    of it (`undecided_tikhonov`) among the rows that are not decided, the rest among those that are. The second part is
    `slack`, by which the sum may be too high (with an allowance for rounding).

    `steps` is called as steps(percent of the budget that is spent, 100), while there is any left.
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
        self.budget = Budget(budget, len(self.tikhonov), time_limit)  # the work that may be done
        self.normal_equations, self.solver, self.tuning = normal_equations, solver, tuning
        self._hessian, self.energy = normal_equations.hessian.total(), float(normal_equations.energy.sum())
        self.unconstrained = UnconstrainedBound(self._hessian + self.tikhonov, 0.0)
        self.exact = EXACT * self.energy  # cost below which two assignments count as equal
        self.rounding = _ROUNDING * self.energy
        # to be taken from an unconstrained bound
        self.slack = float(centre @ self.tikhonov @ centre) + self.rounding
        self.blocks = make_blocks(normal_equations, (0.5 - tuning.undecided_tikhonov) * self.tikhonov)
        self.solves = self.combined = 0  # cone problems solved, combinations of several joints' patterns priced
        self.tolerance = 0.0  # coarsest relative gap of a cone problem
        self.tails: list[float] = []  # lower bounds of what the weak segments of each block cost, once known
        self._tell, self._told = steps, 0
        self._prepared = solver.prepared(self._hessian)
        self._priced: dict[bytes, Assignment] = {}
        self._solved: dict[bytes, Assignment] = {}

    @property
    def nodes(self) -> int:
        """Sign choices priced by the unconstrained bound."""
        return self.combined + sum(block.nodes for block in self.blocks)

    def count(self, choices: int) -> None:
        """Takes down a step of the work, in which so many sign choices were priced."""
        self.budget.count(steps=1, choices=choices)
        self._report()

    def _report(self) -> None:
        whole = self.budget.seconds
        percent = int(100.0 * self.budget.spent / whole) if 0.0 < whole < np.inf else 0
        if self._told < percent < 100:
            self._told = percent
            self._tell(percent, 100)

    def check(self, choices: int) -> None:
        """Takes down a step, and raises OutOfTimeError when the budget has ended."""
        self.count(choices)
        if self.budget.over:
            raise OutOfTimeError

    def decided(self, patterns: Patterns, row: int) -> Integers:
        """(S,) the signs known beforehand and those of a pattern; 0 elsewhere."""
        signs = self.normal_equations.known.copy()
        signs[patterns.segments] = patterns.signs[row]
        return signs

    def decided_moments(self, patterns: Patterns) -> tuple[Array, float]:
        """(r, r) H and energy of the segments known beforehand and those that the patterns decide."""
        rows = np.concatenate([np.flatnonzero(self.normal_equations.known), patterns.segments])
        return self.normal_equations.hessian_of(rows), float(self.normal_equations.energy[rows].sum())

    def solve(self, prepared: PreparedLeastSquares, gradient: Array) -> Solution:
        """The best parameters for g (r,) and the prepared H."""
        return self._counted(prepared.solve(gradient))

    def complete(self, decided: Integers, theta: Array) -> Assignment:
        """The undecided segments (0 in `decided`, (S,)) with the signs that theta (P,) predicts, and the best cost."""
        return self._known(self._completed(decided, theta))

    def settle(self, decided: Integers, theta: Array) -> Assignment:
        """The undecided segments (0 in `decided`, (S,)) and the parameters settled in turn, starting from theta (P,).

        Neither step can raise the cost. The lower bound is that of the resulting signs alone.
        """
        signs = self._completed(decided, theta)
        for _ in range(self.tuning.settling_rounds):
            branch = self._known(signs)
            after = self._completed(decided, branch.theta)
            if np.array_equal(after, signs):
                return branch
            signs = after
        return self._known(signs)

    def settle_from(self, signs: Integers) -> Assignment:
        """The same with all segments undecided but those known beforehand, from the best parameters for signs (S,)."""
        return self.settle(self.normal_equations.known, self._known(signs).theta)

    def _known(self, signs: Integers) -> Assignment:
        key = _key(signs)
        if key not in self._solved:
            self._solved[key] = self._branch(signs, self.solve(self._prepared, signs @ self.normal_equations.gradient))
        return self._solved[key]

    def price(self, signs: Integers) -> Assignment:
        """The best parameters for given signs (S,), as precisely as the solver can; the same signs are solved once."""
        key = _key(signs)
        if key not in self._priced:
            solution = self._prepared.solve_precisely(signs @ self.normal_equations.gradient)
            self._priced[key] = self._solved[key] = self._branch(signs, self._counted(solution))
        return self._priced[key]

    def tikhonov_of(self, branch: Assignment) -> float:
        """What the Tikhonov term adds to the cost of a branch."""
        return self.solver.regularisation(branch.theta)

    def data_cost(self, branch: Assignment) -> tuple[float, float]:
        """Lower bound and value of what a branch costs the data, with next to nothing of the Tikhonov term."""
        lighter = self.solver.lighter(self.tuning.lighter_tikhonov)
        solution = self._counted(
            lighter.prepared(self._hessian).solve_precisely(branch.signs @ self.normal_equations.gradient)
        )
        value = self.energy + solution.cost - lighter.regularisation(solution.theta)
        return min(self.energy + solution.lower_bound, value), value

    def flips(self, branch: Assignment, free: Integers) -> Flips:
        """What turning some of the free segments of a branch costs."""
        self.budget.count(pairs=len(free) ** 2)
        return self._flips(branch, free)

    def single_flips(self, branch: Assignment, free: Integers) -> Array:
        """(free,) lower bounds of what turning one of the free segments by itself costs."""
        return self._flips(branch, free).alone

    def _flips(self, branch: Assignment, free: Integers) -> Flips:
        beta, gap = self.solver.project(branch.theta), branch.cost - branch.lower_bound
        return Flips(self.normal_equations, self.unconstrained, branch.signs, beta, gap, free, self.tuning)

    def _completed(self, decided: Integers, theta: Array) -> Integers:
        return predicted_signs(self.normal_equations, self.solver.project(theta), decided)

    def _branch(self, signs: Integers, solution: Solution) -> Assignment:
        return Assignment(signs, solution.theta, self.energy + solution.cost, self.energy + solution.lower_bound)

    def _counted(self, solution: Solution) -> Solution:
        self.solves += 1
        self.budget.count(parameters=len(solution.theta))
        self._report()
        self.tolerance = max(self.tolerance, solution.tolerance)
        return solution


def _key(signs: Integers) -> bytes:
    return signs.astype(np.int8).tobytes()
