"""The sign problem of one set of moments: what every stage of the certified search shares."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.progress import Steps, no_steps
from bayesid.regression.moments import Moments
from bayesid.regression.solver import ConeLeastSquares, PreparedLeastSquares, Solution
from bayesid.signs.search.bounds import Flips, UnconstrainedBound
from bayesid.signs.search.patterns import Patterns, make_blocks
from bayesid.signs.search.protocol import EXACT, Branch, Budget, predicted_signs
from bayesid.signs.tuning import TUNING, Tuning

_ROUNDING = 1e-8
"""Share of the energy by which rounding, and the ridge against it, may raise an unconstrained bound: a round number far
above double precision."""


class OutOfTimeError(Exception):
    """The budget has ended."""


class Problem:
    """The moments, one block for each joint, and what is prepared once; counts what was done.

    The pull (beta - b)' Q (beta - b) is at least beta' Q beta / 2 - b' Q b (:eq:`pull-share`). The first part is shared
    among the joints' own bounds, which keeps them well conditioned and lets them add up: a small share of it
    (`undecided_pull`) among the rows that are not decided, the rest among those that are. The second part is `slack`,
    by which the sum may be too high (with an allowance for rounding).

    `steps` is called as steps(percent of the budget that is spent, 100), while there is any left.
    """

    def __init__(
        self,
        moments: Moments,
        solver: ConeLeastSquares,
        budget: float,
        time_limit: float = np.inf,
        tuning: Tuning = TUNING,
        steps: Steps = no_steps,
    ) -> None:
        self.pull, centre = solver.pull()
        self.budget = Budget(budget, len(self.pull), time_limit)  # the work that may be done
        self.moments, self.solver, self.tuning = moments, solver, tuning
        self._hessian, self.energy = moments.hessian.total(), float(moments.energy.sum())
        self.unconstrained = UnconstrainedBound(self._hessian + self.pull, 0.0)
        self.exact = EXACT * self.energy  # cost below which two assignments count as equal
        self.rounding = _ROUNDING * self.energy
        # to be taken from an unconstrained bound
        self.slack = float(centre @ self.pull @ centre) + self.rounding
        self.blocks = make_blocks(moments, (0.5 - tuning.undecided_pull) * self.pull)
        self.solves = self.combined = 0  # cone problems solved, combinations of several joints' patterns priced
        self.tolerance = 0.0  # coarsest relative gap of a cone problem
        self.tails: list[float] = []  # lower bounds of what the weak segments of each block cost, once known
        self._tell, self._told = steps, 0
        self._prepared = solver.prepared(self._hessian)
        self._priced: dict[bytes, Branch] = {}
        self._solved: dict[bytes, Branch] = {}

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
        signs = self.moments.known.copy()
        signs[patterns.segments] = patterns.signs[row]
        return signs

    def decided_moments(self, patterns: Patterns) -> tuple[Array, float]:
        """(r, r) H and energy of the segments known beforehand and those that the patterns decide."""
        rows = np.concatenate([np.flatnonzero(self.moments.known), patterns.segments])
        return self.moments.hessian_of(rows), float(self.moments.energy[rows].sum())

    def solve(self, prepared: PreparedLeastSquares, gradient: Array) -> Solution:
        """The best parameters for g (r,) and the prepared H."""
        return self._counted(prepared.solve(gradient))

    def complete(self, decided: Integers, theta: Array) -> Branch:
        """The undecided segments (0 in `decided`, (S,)) with the signs that theta (P,) predicts, and the best cost."""
        return self._known(self._completed(decided, theta))

    def settle(self, decided: Integers, theta: Array) -> Branch:
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

    def settle_from(self, signs: Integers) -> Branch:
        """The same with all segments undecided but those known beforehand, from the best parameters for signs (S,)."""
        return self.settle(self.moments.known, self._known(signs).theta)

    def _known(self, signs: Integers) -> Branch:
        key = _key(signs)
        if key not in self._solved:
            self._solved[key] = self._branch(signs, self.solve(self._prepared, signs @ self.moments.gradient))
        return self._solved[key]

    def price(self, signs: Integers) -> Branch:
        """The best parameters for given signs (S,), as precisely as the solver can; the same signs are solved once."""
        key = _key(signs)
        if key not in self._priced:
            solution = self._prepared.solve_precisely(signs @ self.moments.gradient)
            self._priced[key] = self._solved[key] = self._branch(signs, self._counted(solution))
        return self._priced[key]

    def pull_of(self, branch: Branch) -> float:
        """What the pull adds to the cost of a branch."""
        return self.solver.regularisation(branch.theta)

    def data_cost(self, branch: Branch) -> tuple[float, float]:
        """Lower bound and value of what a branch costs the data, with next to nothing of the pull."""
        lighter = self.solver.lighter(self.tuning.lighter_pull)
        solution = self._counted(lighter.prepared(self._hessian).solve_precisely(branch.signs @ self.moments.gradient))
        value = self.energy + solution.cost - lighter.regularisation(solution.theta)
        return min(self.energy + solution.lower_bound, value), value

    def flips(self, branch: Branch, free: Integers) -> Flips:
        """What turning some of the free segments of a branch costs."""
        self.budget.count(pairs=len(free) ** 2)
        return self._flips(branch, free)

    def single_flips(self, branch: Branch, free: Integers) -> Array:
        """(free,) lower bounds of what turning one of the free segments by itself costs."""
        return self._flips(branch, free).alone

    def _flips(self, branch: Branch, free: Integers) -> Flips:
        beta, gap = self.solver.project(branch.theta), branch.cost - branch.lower_bound
        return Flips(self.moments, self.unconstrained, branch.signs, beta, gap, free, self.tuning)

    def _completed(self, decided: Integers, theta: Array) -> Integers:
        return predicted_signs(self.moments, self.solver.project(theta), decided)

    def _branch(self, signs: Integers, solution: Solution) -> Branch:
        return Branch(signs, solution.theta, self.energy + solution.cost, self.energy + solution.lower_bound)

    def _counted(self, solution: Solution) -> Solution:
        self.solves += 1
        self.budget.count(parameters=len(solution.theta))
        self._report()
        self.tolerance = max(self.tolerance, solution.tolerance)
        return solution


def _key(signs: Integers) -> bytes:
    return signs.astype(np.int8).tobytes()
