"""Budgets of searches: the work that a search may do, and one budget for all searches of an identification.

A budget in seconds of the clock would end wherever the machine has got to by then. Searches count their work instead,
in *nominal seconds*: numbers of steps, sign choices, cone problems and pairs of segments, each times about what it
takes on one core. The same log gives the same result on a busy machine. A time limit on the clock ends a search too,
which its result then says.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

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
    """The work that may be done, and what of it is done.

    Args:
        seconds: nominal seconds of work.
        coefficients: r, by which the price of a sign choice goes.
        time_limit: seconds of the clock from now on.

    Attributes:
        timed_out: whether the time limit has ended it before the work was done.
    """

    def __init__(self, seconds: float, coefficients: int, time_limit: float = np.inf) -> None:
        self.seconds, self.timed_out = seconds, False
        self._ends, self._coefficients = time.perf_counter() + time_limit, coefficients
        self._steps = self._choices = self._solved = self._pairs = 0

    def count(self, steps: int = 0, choices: int = 0, parameters: int = 0, pairs: int = 0) -> None:
        """Takes down work: steps, sign choices that were priced, a cone problem of P parameters, pairs of segments."""
        self._steps += steps
        self._choices += choices
        self._solved += parameters**2
        self._pairs += pairs

    @contextmanager
    def at_most(self, seconds: float) -> Iterator[None]:
        """Ends at so many nominal seconds, for a while."""
        whole, self.seconds = self.seconds, min(self.seconds, seconds)
        try:
            yield
        finally:
            self.seconds = whole

    @property
    def spent(self) -> float:
        """Nominal seconds of the work done."""
        price = NominalSeconds()
        counted = price.step * self._steps + price.choice * self._coefficients * self._choices
        return counted + price.solve * self._solved + price.pair * self._pairs

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        if self.spent > self.seconds:
            return True
        self.timed_out = self.timed_out or time.perf_counter() > self._ends
        return self.timed_out


class OneBudget(Search):
    """A search whose runs share one budget, for all rounds and models of an identification.

    What follows once it is spent shares a fifth of it: the sum stays within what was asked for and that.

    Args:
        search: whose budget it is; one without a budget goes on as it is.
    """

    def __init__(self, search: Search) -> None:
        self._search, self._spent, self._began = search, 0.0, time.perf_counter()

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
        on_the_clock = max(self._search.time_limit - (time.perf_counter() - self._began), 0.0)
        return self._search.limited(left if left > 0.0 else max(left + AFTERWARDS * whole, 0.0), on_the_clock)

    def _counted(self, result: SearchResult) -> SearchResult:
        self._spent += result.spent
        return result
