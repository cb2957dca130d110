"""Budgets of searches: seconds of the clock or, where a run is to be repeatable, of the work done; and one for a run.

A budget in seconds of the clock ends wherever the machine has got to by then. Where a search must give the same result
in every run it counts its work instead, in *nominal seconds*: numbers of steps, sign choices, cone problems and pairs
of segments, each times about what it takes on one core.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.signs.search.protocol import Budgeted, Search, SignProblem
from bayesid.signs.search.result import SearchResult

AFTERWARDS = 0.2
"""Share of a budget that all searches have together which follow once it is spent: under another model, say."""


@dataclass(frozen=True)
class NominalSeconds:
    """What work counts as, in nominal seconds.

    Round numbers from timed searches of the UR10e's, Panda's and TX40's logs and of simulated ones, on one core; other
    machines differ, which changes how long a budget takes and never what it gives.

    Attributes:
        step: of a loop.
        choice: pricing a sign choice, by the number r of coefficients.
        solve: a cone problem, by the square of the number P of parameters.
        pair: of segments that may turn.
    """

    step: float = 4.5e-4
    choice: float = 5e-9
    solve: float = 1e-6
    pair: float = 3e-8


class Budget:
    """Seconds from now on, and what of them is spent.

    Args:
        seconds: of the budget.
        repeatable: whether these are nominal seconds, so that the budget ends at the same point of every run.
        coefficients: r, by which the price of a sign choice goes.
    """

    def __init__(self, seconds: float, repeatable: bool, coefficients: int) -> None:
        self.seconds = seconds
        self._began, self.repeatable, self._coefficients = time.perf_counter(), repeatable, coefficients
        self._steps = self._choices = self._solved = self._pairs = 0

    def count(self, steps: int = 0, choices: int = 0, parameters: int = 0, pairs: int = 0) -> None:
        """Takes down work: steps, sign choices that were priced, a cone problem of P parameters, pairs of segments."""
        self._steps += steps
        self._choices += choices
        self._solved += parameters**2
        self._pairs += pairs

    @property
    def spent(self) -> float:
        """Seconds since the start: by the clock or, where a run is to be repeatable, by the work done."""
        if not self.repeatable:
            return time.perf_counter() - self._began
        price = NominalSeconds()
        counted = price.step * self._steps + price.choice * self._coefficients * self._choices
        return counted + price.solve * self._solved + price.pair * self._pairs

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self.spent > self.seconds


class OneBudget(Search):
    """A search whose runs share one budget, for all rounds and models of an identification.

    What follows once it is spent shares a fifth of it: the sum stays within what was asked for and that.

    Args:
        search: whose budget it is; one without a budget goes on as it is.
    """

    def __init__(self, search: Search) -> None:
        self._search, self._spent = search, 0.0

    @property
    def any_model(self) -> bool:
        """As of the search itself."""
        return self._search.any_model

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """Signs by which segments are split."""
        return self._counted(self._left.find(problem, steps))

    def conclude(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """The last word."""
        return self._counted(self._left.conclude(problem, progress))

    @property
    def _left(self) -> Search:
        if not isinstance(self._search, Budgeted):
            return self._search
        whole = self._search.budget
        left = whole - self._spent
        return self._search.limited(left if left > 0.0 else max(left + AFTERWARDS * whole, 0.0))

    def _counted(self, result: SearchResult) -> SearchResult:
        self._spent += result.spent
        return result
