"""What every search for signs answers to, what it is given, and what it returns.

A log is searched in rounds (`bayesid.signs.rounds`): each round asks a search to `find` the signs of the segments, and
splits those segments whose predicted effort crosses zero. Once none is split any more, the search may `certify`.

A budget in seconds of the clock would end wherever the machine has got to by then. Searches count their work instead,
in *nominal seconds*: numbers of steps, sign choices, cone problems and pairs of segments, each times about what it
takes on one core. The same log gives the same result on a busy machine. A time limit on the clock ends a search too,
which its result then says.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.errors import InputError
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares, Solution
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.tuning import TUNING

EXACT = 1e-8
"""Share of the energy below which two costs count as equal (docs/certified-search.md): that of the finest solutions'
gaps (tests/regression/test_solver.py)."""


@dataclass(frozen=True)
class Assignment:
    """One assignment of signs and the best parameters under it."""

    signs: Integers  #: (S,) +1 or -1 for each segment of the moments
    theta: Array  #: (P,) best feasible parameters
    #: min over the cone of f(theta, signs) + rho(theta), efforts in units of their noise (:eq:`assignment-cost`)
    cost: float
    #: proven bound on the cost of every assignment that the branch stands for: those with the same signs in the
    #: segments that the proof decided one by one, whatever the signs of the weak ones
    lower_bound: float


@dataclass(frozen=True)
class Pruning:
    """What became of the nodes of a beam: those that were grown were pruned either way, or survived their step."""

    grown: int = 0  #: sign choices
    by_bound: int = 0  #: pruned by the unconstrained bound, without a cone problem
    by_cone: int = 0  #: pruned by their cost in the cone
    survived: int = 0  #: a step, the last one too
    leaves: int = 0  #: that survived the last step
    undecided: int = 0  #: segments that no step had decided when time was up: each leaf predicts their signs

    def __add__(self, other: Pruning) -> Pruning:
        """The work of both, and what the last step of the first has left, which is no work."""
        both = {
            name: getattr(self, name) + getattr(other, name) for name in ("grown", "by_bound", "by_cone", "survived")
        }
        return replace(self, **both)


def with_flipped(normal_equations: NormalEquations, signs: Integers, joints: int | Sequence[int]) -> Integers:
    """(S,) the signs (S,) with all unknown ones of some joints, or of one, turned round."""
    return np.where(np.isin(normal_equations.joint, joints) & (normal_equations.known == 0), -signs, signs)


def predicted_signs(normal_equations: NormalEquations, beta: Array, decided: Integers | None = None) -> Integers:
    """(S,) the signs that coefficients (r,) predict where none is decided (S,), by default known beforehand."""
    decided = normal_equations.known if decided is None else decided
    return np.where(decided != 0, decided, np.where(normal_equations.gradient @ beta >= 0.0, 1, -1))


def listed_without_proof(
    normal_equations: NormalEquations, best: Assignment, others: Iterable[Assignment]
) -> tuple[tuple[Assignment, ...], Mask]:
    """The best assignment and those that come near, cheapest first, and (B, S) segments that each decides.

    A branch decides the strong segments and those in which branches differ; it stands for all signs of the others.
    """
    distinct = {branch.signs.tobytes(): branch for branch in [*others, best]}.values()
    near = (branch for branch in distinct if branch.cost <= best.cost + TUNING.near)
    branches = tuple(sorted(near, key=lambda branch: branch.cost))
    differ = np.any([branch.signs != best.signs for branch in branches], axis=0)
    strongest = np.zeros(int(normal_equations.joint.max(initial=-1)) + 1)
    np.maximum.at(strongest, normal_equations.joint, normal_equations.energy)
    strong = normal_equations.energy >= TUNING.strong * strongest[normal_equations.joint]
    decided = (normal_equations.known == 0) & ((strong & normal_equations.individual) | differ)
    return branches, np.tile(decided, (len(branches), 1))


@dataclass(frozen=True)
class Way:
    """What one way of searching has found."""

    #: "candidates", "earlier signs" (found under another model), "branch and bound", "local search", "beam", or "final
    #: noise weights" (another assignment is cheaper by these; its cost does not compare with the others')
    name: str
    cost: float  #: of its best assignment
    spent: float = 0.0  #: nominal seconds of work
    starts: int = 0  #: how often it began from other signs; 0 where that means nothing


@dataclass(frozen=True)
class SearchResult:
    """The best assignment of a search, and what is proven about all others."""

    signs: Integers  #: (S,) +1 or -1 for each segment of the moments
    theta: Array  #: (P,) best feasible parameters under these signs
    #: min over the cone of f(theta, signs) + rho(theta), efforts in units of their noise (:eq:`assignment-cost`)
    cost: float
    method: str  #: of the search
    width: int | None = None  #: of the beam; None if it was unlimited or there was none
    #: whether no other assignment can cost less (by more than 1e-8 of the efforts' energy), with the Tikhonov term and
    #: without it, by the noise weights of the search and by those of its result
    certified: bool = False
    lower_bound: float | None = None  #: proven bound on the cost of every assignment, or None
    nodes: int = 0  #: priced by the unconstrained bound
    solves: int = 0  #: cone problems solved
    tolerance: float = 0.0  #: coarsest relative gap among them
    seconds: float = 0.0  #: of wall time
    #: the best assignment and all others that may cost at most `optimality_gap` more, cheapest first; of a beam, the
    #: leaves that survived its last step; empty if neither was had
    branches: tuple[Assignment, ...] = ()
    optimality_gap: float = 0.0  #: Delta, in units of the cost
    #: bound on the sum of exp(-(cost - best cost) / 2) over all assignments of the segments decided one by one that
    #: `branches` leaves out (:eq:`missed-mass`); inf if nothing is proven
    missed: float = np.inf
    #: (S,) whether all assignments within Delta give the segment the same sign; None if nothing is proven
    persistent: Mask | None = None
    #: (B, S) segments that each branch decides one by one; it stands for all signs of the others
    decided: Mask | None = None
    #: why a proof is no certificate: "tikhonov" where another assignment may cost the data less, "noise" where the best
    #: assignment depends on the noise weights; empty otherwise
    uncertified_because: str = ""
    tikhonov: float | None = None  #: what rho adds to the cost; None if the nodes' price is the user's
    pruning: Pruning | None = None  #: what became of a beam's nodes; None without one
    spent: float = 0.0  #: nominal seconds of work; 0 where the search had no budget
    #: whether the time limit on the clock has ended it: a faster machine may give another result
    timed_out: bool = False
    ways: tuple[Way, ...] = ()  #: what each way of searching has found, in the order in which they were tried
    #: probability that an assignment which nobody has looked at is the right one; 0 where a proof excludes it
    unlisted_probability: float = 0.5

    def with_best(self, branch: Assignment, **changes: Any) -> SearchResult:
        """The result with other signs, and other changes."""
        return replace(self, signs=branch.signs, theta=branch.theta, cost=branch.cost, **changes)

    def with_work_of(self, others: Iterable[SearchResult]) -> SearchResult:
        """The result with nodes, solves and pruning of other searches counted too."""
        every = [self, *others]
        counted = [result.pruning for result in every[1:] if result.pruning is not None]
        return replace(
            self,
            nodes=sum(result.nodes for result in every),
            solves=sum(result.solves for result in every),
            spent=sum(result.spent for result in every),
            timed_out=any(result.timed_out for result in every),
            pruning=None if self.pruning is None else sum(counted, self.pruning),
        )

    def without_work(self) -> SearchResult:
        """The result as one that took none."""
        left = self.pruning and Pruning(leaves=self.pruning.leaves, undecided=self.pruning.undecided)
        return replace(self, nodes=0, solves=0, spent=0.0, pruning=left)


@dataclass(frozen=True)
class SignProblem:
    """The sign problem of one log and one model."""

    normal_equations: NormalEquations  #: of S segments, rows in units of the noise
    cone: Cone  #: the cone of the model's P parameters
    coefficients: BaseCoefficients  #: the model's r base coefficients
    #: the result of the search before, on this log but perhaps on longer segments and with other noise; None in the
    #: first round
    earlier: SearchResult | None = None
    starts: tuple[Integers, ...] = ()  #: (S,) each, signs that are likely beforehand, say those under another model
    unlisted_probability: float = 0.5  #: `SearchResult.unlisted_probability` of the search that these are from.

    @cached_property
    def hessian(self) -> Array:
        """(r, r) H of all segments."""
        return self.normal_equations.hessian.total()

    @property
    def energy(self) -> float:
        """The energy c of all segments."""
        return float(self.normal_equations.energy.sum())

    def solver(self) -> ConeLeastSquares:
        """A new solver for least squares in the cone, prepared for all segments."""
        return ConeLeastSquares(self.cone, self.coefficients, self.hessian, self.energy)

    def is_poor(self, result: SearchResult) -> bool:
        """Whether a joint's residual exceeds `poor_fit` of its effort: the search may have gone wrong."""
        n_joints = int(self.normal_equations.joint.max(initial=-1)) + 1
        residual = self.normal_equations.residual_sd(self.coefficients.project(result.theta), result.signs, n_joints)
        return bool(np.any(residual >= REGRESSION.poor_fit * self.normal_equations.rms_effort(n_joints)))


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

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """The last word, once no segment is split any more: by default the last round's result.

        Args:
            problem: the sign problem of the last round; its `earlier` is that round's result, its noise has been
                estimated with it.
            progress: of its stages.

        Returns:
            The result; its `nodes` and `solves` count the work of this step only.

        Raises:
            SolverError: an optimisation failed.

        Example:
            >>> from dataclasses import replace
            >>> search = bayesid.Beam()
            >>> last = search.find(problem)
            >>> bool((search.certify(replace(problem, earlier=last)).signs == last.signs).all())
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

    What follows once it is spent shares a fifth of it: the sum stays within what was asked for and that. The time limit
    counts from `began`, on the clock of `time.perf_counter`.
    """

    def __init__(self, search: Search, began: float) -> None:
        self._search, self._spent, self._began = search, 0.0, began

    @property
    def any_model(self) -> bool:
        """As of the search itself."""
        return self._search.any_model

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """Signs by which segments are split."""
        return self._counted(self._left.find(problem, steps))

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """The last word."""
        return self._counted(self._left.certify(problem, progress))

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


class NodeSolver(Protocol):
    """What prices the nodes of a beam."""

    def prepared(self, hessian: Array) -> PreparedNode:
        """Prepares for the H (r, r) of one depth; never changes what has been prepared before."""


NodeCostFactory = Callable[[Cone, BaseCoefficients, Array, float], NodeSolver]
"""Makes the price of a node from the model's cone and coefficients and the moments H (r, r) and c of all data."""
