"""Signs that the data prefer, by a cost almost without the solver's Tikhonov term.

A certificate holds for one set of normal equations and a cost with a Tikhonov term towards typical links
(`regression.solver`). `Witnessed` keeps these normal equations; `preference` compares the certified signs with others
by the least residual in the cone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.log.segments import Segments
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.signs.search.protocol import Search, SearchResult, SignProblem

CLEARLY = 0.1
"""Units of the cost, twice the nats, by which other signs must be cheaper: far above the errors of solver and remaining
Tikhonov term (tests/studies/test_preference.py)."""
_DATA_OVER_TIKHONOV = 1e4
"""Factor on the data term relative to the Tikhonov term rho; larger ones are limited by rounding. Not measured."""
_ROUNDS = 20
"""Largest number of alternations between signs and parameters; none raises the cost. Chosen; not measured."""


class Witnessed(Search):
    """A search that keeps the problems it certified.

    Args:
        search: the search to run.
    """

    def __init__(self, search: Search) -> None:
        self._search = search
        self._concluded: list[tuple[SignProblem, SearchResult]] = []

    def __repr__(self) -> str:
        return repr(self._search)

    @property
    def any_model(self) -> bool:
        """That of the search."""
        return self._search.any_model

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """That of the search."""
        return self._search.find(problem, steps)

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """That of the search; keeps the problem."""
        result = self._search.certify(problem, progress)
        self._concluded.append((problem, result))
        return result

    def problem_of(self, result: SearchResult) -> SignProblem:
        """The problem of a result.

        Raises:
            LookupError: the result is not from this search.
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
    """Cost of the certified signs minus that of the cheapest other signs; negative if none is cheaper.

    Other signs: the true ones, and both with each joint flipped, as they are and refined by alternating between signs
    and parameters. The refined certified signs are included if they differ.

    Args:
        problem: its normal equations are in units of the noise.
        certified: (S,)
        truth: (S,)

    Raises:
        SolverError: a cone problem could not be solved.
    """
    costs = _Costs(problem)
    others = {s.tobytes(): s for start in _starts(problem, certified, truth) for s in (start, costs.refined(start))}
    others.pop(certified.tobytes(), None)
    return costs.of(certified) - min(map(costs.of, others.values()), default=np.inf)


def _starts(problem: SignProblem, certified: Integers, truth: Integers) -> Iterator[Integers]:
    normal_equations = problem.normal_equations
    for signs in (certified, truth):
        yield signs
        for joint in np.unique(normal_equations.joint[normal_equations.known == 0]):
            yield np.where((normal_equations.joint == joint) & (normal_equations.known == 0), -signs, signs)


class _Costs:
    """Costs of signs almost without the Tikhonov term: min over the cone of f(theta, signs)."""

    def __init__(self, problem: SignProblem) -> None:
        self._normal_equations = problem.normal_equations
        self._prepared = problem.solver().prepared(_DATA_OVER_TIKHONOV * problem.hessian)

    def of(self, signs: Integers) -> float:
        """The least cost of signs (S,)."""
        return self._normal_equations.cost(self._beta(signs), signs.astype(np.float64))

    def refined(self, signs: Integers) -> Integers:
        """(S,) signs that agree with their best parameters, by alternating between both."""
        known = self._normal_equations.known
        for _ in range(_ROUNDS):
            predicted = np.where(self._normal_equations.gradient @ self._beta(signs) >= 0.0, 1, -1)
            improved = np.where(known != 0, known, predicted)
            if np.array_equal(improved, signs):
                break
            signs = improved
        return signs

    def _beta(self, signs: Integers) -> Array:
        """(r,) the best coefficients in the cone."""
        gradient = _DATA_OVER_TIKHONOV * (signs @ self._normal_equations.gradient)
        return self._prepared.project(self._prepared.solve_precisely(gradient).theta)
