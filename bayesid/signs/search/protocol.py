"""What every search for signs answers to, and what it is given.

A log is searched in rounds (`bayesid.signs.rounds`): each round asks a search to `find` the signs of the segments, and
splits those segments whose predicted effort crosses zero. Once none is split any more, the search may `conclude`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.least_squares import POOR_FIT
from bayesid.regression.moments import Moments
from bayesid.regression.solver import ConeLeastSquares, Solution
from bayesid.signs.search.result import SearchResult


@dataclass(frozen=True)
class SignProblem:
    """The sign problem of one log and one model.

    Attributes:
        moments: of S segments, rows in units of the noise.
        cone: the cone of the model's P parameters.
        coefficients: the model's r base coefficients.
        earlier: the result of the search before, on this log but perhaps on longer segments and with other noise; None
            in the first round.
        starts: (S,) each, signs that are likely beforehand, say those under another model.
        unseen: `SearchResult.unseen` of the search that these are from.
    """

    moments: Moments
    cone: Cone
    coefficients: BaseCoefficients
    earlier: SearchResult | None = None
    starts: tuple[Integers, ...] = ()
    unseen: float = 0.5

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
        """Whether a joint's residual exceeds `POOR_FIT` of its effort: the search may have gone wrong."""
        n_joints = int(self.moments.joint.max(initial=-1)) + 1
        residual = self.moments.residual_sd(self.coefficients.project(result.theta), result.signs, n_joints)
        return bool(np.any(residual >= POOR_FIT * self.moments.rms_effort(n_joints)))


class Search(Protocol):
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
        """Whether it can search under another model than the one asked for, as a second opinion or completed.

        Example:
            >>> bayesid.Certified().any_model
            True
        """
        return True

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


@runtime_checkable
class Budgeted(Protocol):
    """A search that ends when its budget is spent."""

    @property
    def budget(self) -> float:
        """Nominal seconds of work that all its runs in an identification share."""

    @property
    def time_limit(self) -> float:
        """Seconds on the clock that they may take."""

    def limited(self, budget: float, time_limit: float) -> Search:
        """The same search with another budget, nominal seconds, and time limit, seconds."""


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
