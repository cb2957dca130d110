"""Interface of all sign searches: their input, methods and results.

A log is searched in rounds (`bayesid.signs.rounds`). Each round asks a search to `find` the signs of the segments, and
splits segments whose predicted effort crosses zero. When none is split any more, the search may `certify`.

Searches count their work in *nominal seconds* instead of wall-clock time: numbers of steps, sign choices, cone problems
and pairs of segments, each times its typical time on one core. So the same log gives the same result on a busy machine.
A wall-clock limit can end a search too (`SearchResult.timed_out`).
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
"""Share of the energy below which two costs are equal (docs/certified-search.md): the gap of the finest solutions
(tests/regression/test_solver.py)."""


@dataclass(frozen=True)
class Assignment:
    """One assignment of signs and the best parameters under it."""

    signs: Integers  #: (S,) +1 or -1 for each segment
    theta: Array  #: (P,) best feasible parameters
    #: min over the cone of f(theta, signs) + rho(theta), efforts in units of their noise (:eq:`assignment-cost`)
    cost: float
    #: proven lower bound of the cost of all assignments of the branch, which have the same signs in the segments that
    #: the proof decided one by one, and any signs in the weak ones
    lower_bound: float


@dataclass(frozen=True)
class Pruning:
    """Numbers of a beam's nodes by how they were pruned."""

    grown: int = 0  #: sign choices
    by_bound: int = 0  #: pruned by the unconstrained bound, without a cone problem
    by_cone: int = 0  #: pruned by their cost in the cone
    survived: int = 0  #: in all steps, including the last
    leaves: int = 0  #: survivors of the last step
    undecided: int = 0  #: segments undecided when the budget ended; each leaf predicts their signs

    def __add__(self, other: Pruning) -> Pruning:
        """Sums of both; leaves and undecided segments are those of the first."""
        both = {
            name: getattr(self, name) + getattr(other, name) for name in ("grown", "by_bound", "by_cone", "survived")
        }
        return replace(self, **both)


def with_flipped(normal_equations: NormalEquations, signs: Integers, joints: int | Sequence[int]) -> Integers:
    """(S,) the signs (S,) with all unknown ones of one or several joints flipped."""
    return np.where(np.isin(normal_equations.joint, joints) & (normal_equations.known == 0), -signs, signs)


def predicted_signs(normal_equations: NormalEquations, beta: Array, decided: Integers | None = None) -> Integers:
    """(S,) signs that coefficients (r,) predict; decided signs (S,) are kept, by default the known ones."""
    decided = normal_equations.known if decided is None else decided
    return np.where(decided != 0, decided, np.where(normal_equations.gradient @ beta >= 0.0, 1, -1))


def listed_without_proof(
    normal_equations: NormalEquations, best: Assignment, others: Iterable[Assignment]
) -> tuple[tuple[Assignment, ...], Mask]:
    """The best assignment and those of similar cost, cheapest first, and (B, S) segments that each decides.

    A branch decides the strong segments and those in which branches differ. It includes all signs of the others.
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
    """Result of one stage of a search."""

    #: "candidates", "earlier signs" (of another model), "branch and bound", "local search", "beam", or "final noise
    #: weights" (another assignment is cheaper by these weights; its cost cannot be compared with the others)
    name: str
    cost: float  #: of its best assignment
    spent: float = 0.0  #: nominal seconds of work
    starts: int = 0  #: number of starts; 0 if it does not apply


@dataclass(frozen=True)
class SearchResult:
    """The best assignment of a search, and what is proven about all others."""

    signs: Integers  #: (S,) +1 or -1 for each segment
    theta: Array  #: (P,) best feasible parameters under these signs
    #: min over the cone of f(theta, signs) + rho(theta), efforts in units of their noise (:eq:`assignment-cost`)
    cost: float
    method: str  #: of the search
    width: int | None = None  #: of the beam; None if unlimited or without a beam
    #: whether no other assignment can cost less (by more than 1e-8 of the efforts' energy), with and without the
    #: Tikhonov term, by the noise weights of the search and of its result
    certified: bool = False
    lower_bound: float | None = None  #: proven bound on the cost of every assignment, or None
    nodes: int = 0  #: priced by the unconstrained bound
    solves: int = 0  #: cone problems solved
    tolerance: float = 0.0  #: coarsest relative gap of these
    seconds: float = 0.0  #: wall-clock time
    #: the best assignment and all others that may cost at most `optimality_gap` more, cheapest first; for a beam, the
    #: leaves; empty if neither exists
    branches: tuple[Assignment, ...] = ()
    optimality_gap: float = 0.0  #: Delta, in units of the cost
    #: bound on the sum of exp(-(cost - best cost) / 2) over all assignments of the segments decided one by one that
    #: `branches` leaves out (:eq:`missed-mass`); inf if nothing is proven
    missed: float = np.inf
    #: (S,) whether all assignments within Delta give the segment the same sign; None if nothing is proven
    persistent: Mask | None = None
    #: (B, S) segments that each branch decides one by one; a branch includes all signs of the others
    decided: Mask | None = None
    #: why a proof is not a certificate: "tikhonov" if another assignment may have a lower data cost, "noise" if the
    #: best assignment depends on the noise weights; empty otherwise
    uncertified_because: str = ""
    tikhonov: float | None = None  #: Tikhonov term in the cost; None with a user's node solver
    pruning: Pruning | None = None  #: of a beam's nodes; None without a beam
    spent: float = 0.0  #: nominal seconds of work; 0 without a budget
    #: whether the wall-clock limit ended it; a faster machine may give another result
    timed_out: bool = False
    ways: tuple[Way, ...] = ()  #: result of each stage, in the order of the stages
    #: probability that an unlisted assignment is the right one; 0 if a proof excludes it
    unlisted_probability: float = 0.5

    def with_best(self, branch: Assignment, **changes: Any) -> SearchResult:
        """The result with another best assignment, and other changes."""
        return replace(self, signs=branch.signs, theta=branch.theta, cost=branch.cost, **changes)

    def with_work_of(self, others: Iterable[SearchResult]) -> SearchResult:
        """The result with the work of other searches added."""
        results = [self, *others]
        counted = [result.pruning for result in results[1:] if result.pruning is not None]
        return replace(
            self,
            nodes=sum(result.nodes for result in results),
            solves=sum(result.solves for result in results),
            spent=sum(result.spent for result in results),
            timed_out=any(result.timed_out for result in results),
            pruning=None if self.pruning is None else sum(counted, self.pruning),
        )

    def without_work(self) -> SearchResult:
        """The result with zero work."""
        pruning = self.pruning and Pruning(leaves=self.pruning.leaves, undecided=self.pruning.undecided)
        return replace(self, nodes=0, solves=0, spent=0.0, pruning=pruning)


@dataclass(frozen=True)
class SignProblem:
    """The sign problem of one log and one model."""

    normal_equations: NormalEquations  #: of S segments, rows in units of the noise
    cone: Cone  #: the cone of the model's P parameters
    coefficients: BaseCoefficients  #: the model's r base coefficients
    #: the result of the search before, on this log but maybe on longer segments and with other noise; None in the first
    #: round
    earlier: SearchResult | None = None
    starts: tuple[Integers, ...] = ()  #: (S,) each, likely signs, such as those under another model
    unlisted_probability: float = 0.5  #: `SearchResult.unlisted_probability` of the search that gave them

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
        """Whether a joint's relative residual exceeds `poor_fit`; the signs may then be wrong."""
        n_joints = int(self.normal_equations.joint.max(initial=-1)) + 1
        residual = self.normal_equations.residual_sd(self.coefficients.project(result.theta), result.signs, n_joints)
        return bool(np.any(residual >= REGRESSION.poor_fit * self.normal_equations.rms_effort(n_joints)))


class Search(ABC):
    """A method of finding signs; a frozen dataclass gives a `repr` that documents the search in a result.

    Your own search derives from this class and defines `find`.

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
        """Whether it may search under models other than the requested one."""
        return True

    @property
    def budget(self) -> float:
        """Nominal seconds of work for all its runs in an identification; unlimited by default."""
        return np.inf

    @property
    def time_limit(self) -> float:
        """Wall-clock seconds for them."""
        return np.inf

    def limited(self, budget: float, time_limit: float) -> Search:
        """The same search with another budget, nominal seconds, and time limit, seconds; unchanged by default."""
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
        """Final result once no segment is split any more; by default the last round's.

        Args:
            problem: the sign problem of the last round; `earlier` is that round's result, which gave the noise.
            progress: of its stages.
            progress: of its stages.

        Returns:
            The result; `nodes` and `solves` count the work of this step only.

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
    """Checks that budget and time limit, among some options, are valid numbers of seconds.

    Raises:
        InputError: they are not.
    """
    of, remedy = type(options).__name__, "give 0 or more seconds"
    if not (budget >= 0.0 and (endless or budget < np.inf)):
        raise InputError(f"a budget of {budget:g} s", field=f"{of}.budget", remedy=remedy)
    if not time_limit >= 0.0:
        raise InputError(f"a time limit of {time_limit:g} s", field=f"{of}.time_limit", remedy=remedy)


class Budget:
    """A limit of work, and the work done.

    Args:
        seconds: nominal seconds of work.
        coefficients: r, which scales the work of a sign choice.
        time_limit: wall-clock seconds from now.

    Attributes:
        timed_out: whether the time limit ended it before the nominal seconds.
    """

    def __init__(self, seconds: float = np.inf, coefficients: int = 0, time_limit: float = np.inf) -> None:
        self.seconds, self.timed_out = seconds, False
        self._ends, self._coefficients = time.perf_counter() + time_limit, coefficients
        self._steps = self._choices = self._solved = self._pairs = 0

    def count(self, steps: int = 0, choices: int = 0, parameters: int = 0, pairs: int = 0) -> None:
        """Counts work: steps, priced sign choices, a cone problem of P parameters, pairs of segments."""
        self._steps += steps
        self._choices += choices
        self._solved += parameters**2
        self._pairs += pairs

    @contextmanager
    def at_most(self, seconds: float) -> Iterator[None]:
        """Limits the budget to these nominal seconds, as a context manager."""
        whole, self.seconds = self.seconds, min(self.seconds, seconds)
        try:
            yield
        finally:
            self.seconds = whole

    @property
    def spent(self) -> float:
        """Nominal seconds of the work done."""
        counted = TUNING.seconds_per_step * self._steps + TUNING.seconds_per_choice * self._coefficients * self._choices
        return counted + TUNING.seconds_per_solve * self._solved + TUNING.seconds_per_pair * self._pairs

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        if self.spent > self.seconds:
            return True
        self.timed_out = self.timed_out or time.perf_counter() > self._ends
        return self.timed_out


class OneBudget(Search):
    """A search whose runs share one budget, for all rounds and models of an identification.

    Runs after its end share a fifth more. The time limit counts from `began`, on the clock of `time.perf_counter`.
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
        """Final result."""
        return self._counted(self._left.certify(problem, progress))

    @property
    def _left(self) -> Search:
        seconds = self._search.budget - self._spent
        if seconds <= 0.0:
            seconds = max(seconds + TUNING.budget_afterwards * self._search.budget, 0.0)
        return self._search.limited(seconds, max(self._search.time_limit - (time.perf_counter() - self._began), 0.0))

    def _counted(self, result: SearchResult) -> SearchResult:
        self._spent += result.spent
        return result


class PreparedNode(Protocol):
    """Prices the nodes of one depth."""

    def solve(self, gradient: Array) -> Solution:
        """The best parameters for g (r,)."""


class NodeSolver(Protocol):
    """Prices the nodes of a beam."""

    def prepared(self, hessian: Array) -> PreparedNode:
        """Prepares for H (r, r) of one depth; must not change earlier prepared nodes."""


NodeCostFactory = Callable[[Cone, BaseCoefficients, Array, float], NodeSolver]
"""Makes a node solver from the model's cone and coefficients, and H (r, r) and c of all data."""
