"""Which signs the data prefer, with next to nothing of the solver's pull in what they cost.

A certificate speaks of one set of moments, and of a cost in which the Tikhonov term to typical links has a say
(`regression.solver`). `Witnessed` keeps these moments; `preference` prices other signs against the certified ones by
the least residual in the cone alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.log.segments import Segments
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.signs.search.protocol import Search, SearchResult, SignProblem

CLEARLY = 0.1
"""Units of the cost, twice the nats, by which other signs must be cheaper: far above what the solver and the rest of
the Tikhonov term leave open (tests/studies/test_preference.py)."""
_DATA_OVER_PULL = 1e4
"""By which the data's say in the cost is raised above rho's. A round number: rounding allows a little more."""
_ROUNDS = 20
"""In which signs and parameters are made to agree; none of them can raise the cost."""


class Witnessed(Search):
    """A search that keeps the problems it has concluded.

    Args:
        search: that does the work.
    """

    def __init__(self, search: Search) -> None:
        self._search = search
        self._concluded: list[tuple[SignProblem, SearchResult]] = []

    def __repr__(self) -> str:
        return repr(self._search)

    @property
    def any_model(self) -> bool:
        """As the search's."""
        return self._search.any_model

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """As the search's."""
        return self._search.find(problem, steps)

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """As the search's."""
        result = self._search.certify(problem, progress)
        self._concluded.append((problem, result))
        return result

    def problem_of(self, result: SearchResult) -> SignProblem:
        """The problem that a result concludes.

        Raises:
            LookupError: it is none of this search's.
        """
        for problem, concluded in self._concluded:
            if concluded.signs is result.signs:
                return problem
        raise LookupError("a result of another search")


def true_signs(segments: Segments, effort: Array) -> Integers:
    """(S,) sign of the sum of the signed efforts (N, n) over each segment."""
    ranges = zip(segments.joint, segments.start, segments.end, strict=True)
    return np.array([1 if effort[a:b, j].sum() >= 0.0 else -1 for j, a, b in ranges])


def preference(problem: SignProblem, certified: Integers, truth: Integers) -> float:
    """By how much the cheapest of some other signs is cheaper than the certified ones; negative if none is.

    The others are the true signs, and both of these with each joint turned round, as they are and settled: signs and
    parameters made to agree. The certified signs settled count as others where that changes them.

    Args:
        problem: its moments in units of the noise.
        certified: (S,)
        truth: (S,)

    Raises:
        SolverError: a cone problem could not be solved.
    """
    prices = _Prices(problem)
    own = prices.of(certified)
    others = {s.tobytes(): s for start in _starts(problem, certified, truth) for s in (start, prices.settle(start))}
    others.pop(certified.tobytes(), None)
    return own - min(map(prices.of, others.values()), default=np.inf)


def _starts(problem: SignProblem, certified: Integers, truth: Integers) -> Iterator[Integers]:
    normal_equations = problem.normal_equations
    for signs in (certified, truth):
        yield signs
        for joint in np.unique(normal_equations.joint[normal_equations.known == 0]):
            yield np.where((normal_equations.joint == joint) & (normal_equations.known == 0), -signs, signs)


class _Prices:
    """What signs cost without the Tikhonov term: min over the cone of f(theta, signs)."""

    def __init__(self, problem: SignProblem) -> None:
        self._normal_equations = problem.normal_equations
        self._prepared = problem.solver().prepared(_DATA_OVER_PULL * problem.hessian)

    def of(self, signs: Integers) -> float:
        """The least cost of signs (S,)."""
        return self._normal_equations.cost(self._beta(signs), signs.astype(np.float64))

    def settle(self, signs: Integers) -> Integers:
        """(S,) signs that their best parameters predict, after a few rounds of adapting one to the other."""
        known = self._normal_equations.known
        for _ in range(_ROUNDS):
            predicted = np.where(self._normal_equations.gradient @ self._beta(signs) >= 0.0, 1, -1)
            sign_solution = np.where(known != 0, known, predicted)
            if np.array_equal(sign_solution, signs):
                break
            signs = sign_solution
        return signs

    def _beta(self, signs: Integers) -> Array:
        """(r,) the best coefficients, as the cone and next to no pull have them."""
        gradient = _DATA_OVER_PULL * (signs @ self._normal_equations.gradient)
        return self._prepared.project(self._prepared.solve_precisely(gradient).theta)
