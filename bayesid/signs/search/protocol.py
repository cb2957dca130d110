"""What every search for signs answers to, and what it is given.

A log is searched in rounds (`bayesid.signs.rounds`): each round asks a search to `find` the signs of the segments, and
splits those segments whose predicted effort crosses zero. Once none is split any more, the search may `conclude`.

A budget in seconds of the clock would end wherever the machine has got to by then. Searches count their work instead,
in *nominal seconds*: numbers of steps, sign choices, cone problems and pairs of segments, each times about what it
takes on one core. The same log gives the same result on a busy machine. A time limit on the clock ends a search too,
which its result then says.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.errors import InputError
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.moments import Moments
from bayesid.regression.solver import ConeLeastSquares, Solution
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.search.result import SearchResult
from bayesid.signs.tuning import TUNING


@dataclass(frozen=True)
class SignProblem:
    """The sign problem of one log and one model."""

    moments: Moments  #: of S segments, rows in units of the noise
    cone: Cone  #: the cone of the model's P parameters
    coefficients: BaseCoefficients  #: the model's r base coefficients
    #: the result of the search before, on this log but perhaps on longer segments and with other noise; None in the
    #: first round
    earlier: SearchResult | None = None
    starts: tuple[Integers, ...] = ()  #: (S,) each, signs that are likely beforehand, say those under another model
    unseen: float = 0.5  #: `SearchResult.unseen` of the search that these are from.

    @cached_property
    def hessian(self) -> Array:
        """(r, r) H of all segments."""
        return self.moments.hessian.total()

    @property
    def energy(self) -> float:
        """The energy c of all segments."""
        return float(self.moments.energy.sum())

    def solver(self) -> ConeLeastSquares:
        """A new solver for least squares in the cone, prepared for all segments."""
        return ConeLeastSquares(self.cone, self.coefficients, self.hessian, self.energy)

    def is_poor(self, result: SearchResult) -> bool:
        """Whether a joint's residual exceeds `poor_fit` of its effort: the search may have gone wrong."""
        n_joints = int(self.moments.joint.max(initial=-1)) + 1
        residual = self.moments.residual_sd(self.coefficients.project(result.theta), result.signs, n_joints)
        return bool(np.any(residual >= REGRESSION.poor_fit * self.moments.rms_effort(n_joints)))


class Search(ABC):
    """A method of finding signs; best a frozen dataclass, whose `repr` then says in a result how it was searched.

    A search of your own derives from this class and defines `find`.

    Example:
        >>> class Guess(bayesid.Search):
        ...     def find(self, problem, steps=None):
        ...         return bayesid.Beam(width=1, initial_segments=1).find(problem)
        >>> result = bayesid.identify(robot, log, terms, search=Guess(), posterior=False)
        >>> result.search.certified
        False
    """

    @property
    def any_model(self) -> bool:
        """Whether it can search under another model than the one asked for, as a second opinion or completed."""
        return True

    @property
    def budget(self) -> float:
        """Nominal seconds of work that all its runs in an identification share; without an end by default."""
        return np.inf

    @property
    def time_limit(self) -> float:
        """Seconds on the clock that they may take."""
        return np.inf

    def limited(self, budget: float, time_limit: float) -> Search:
        """The same search with another budget, nominal seconds, and time limit, seconds; by default as it is."""
        return self

    @abstractmethod
    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """Signs by which segments are split.

        Args:
            problem: the sign problem of this round.
            steps: called as steps(done, total).

        Raises:
            SolverError: an optimisation failed.

        Example:
            >>> result = bayesid.Beam().find(problem)
            >>> len(result.signs), result.certified
            (56, False)
        """

    def conclude(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """The last word, once no segment is split any more: by default the last round's result.

        Args:
            problem: the sign problem of the last round; its `earlier` is that round's result, its noise has been
                estimated with it.
            progress: called as progress(stage, done, total).

        Returns:
            The result; its `nodes` and `solves` count the work of this step only.

        Raises:
            SolverError: an optimisation failed.

        Example:
            >>> from dataclasses import replace
            >>> search = bayesid.Beam()
            >>> last = search.find(problem)
            >>> bool((search.conclude(replace(problem, earlier=last)).signs == last.signs).all())
            True
        """
        assert problem.earlier is not None
        return problem.earlier.without_work()


def check_limits(options: object, budget: float, time_limit: float, *, endless: bool = False) -> None:
    """Refuses a budget or a time limit, among some options, that is no number of seconds.

    Raises:
        InputError: says so.
    """
    of, remedy = type(options).__name__, "give 0 or more seconds"
    if not (budget >= 0.0 and (endless or budget < np.inf)):
        raise InputError(f"a budget of {budget:g} s", field=f"{of}.budget", remedy=remedy)
    if not time_limit >= 0.0:
        raise InputError(f"a time limit of {time_limit:g} s", field=f"{of}.time_limit", remedy=remedy)


class Budget:
    """The work that may be done, and what of it is done.

    Args:
        seconds: nominal seconds of work.
        coefficients: r, by which the price of a sign choice goes.
        time_limit: seconds of the clock from now on.

    Attributes:
        timed_out: whether the time limit has ended it before the work was done.
    """

    def __init__(self, seconds: float = np.inf, coefficients: int = 0, time_limit: float = np.inf) -> None:
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
        counted = TUNING.seconds_a_step * self._steps + TUNING.seconds_a_choice * self._coefficients * self._choices
        return counted + TUNING.seconds_a_solve * self._solved + TUNING.seconds_a_pair * self._pairs

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
        left = self._search.budget - self._spent
        if left <= 0.0:
            left = max(left + TUNING.budget_afterwards * self._search.budget, 0.0)
        return self._search.limited(left, max(self._search.time_limit - (time.perf_counter() - self._began), 0.0))

    def _counted(self, result: SearchResult) -> SearchResult:
        self._spent += result.spent
        return result


class PreparedNode(Protocol):
    """What prices the nodes of one depth."""

    def solve(self, gradient: Array) -> Solution:
        """The best parameters for g (r,)."""


class NodeCost(Protocol):
    """What prices the nodes of a beam."""

    def prepared(self, hessian: Array) -> PreparedNode:
        """Prepares for the H (r, r) of one depth; never changes what has been prepared before."""


NodeCostFactory = Callable[[Cone, BaseCoefficients, Array, float], NodeCost]
"""Makes the price of a node from the model's cone and coefficients and the moments H (r, r) and c of all data."""
