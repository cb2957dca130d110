"""What a search returns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.moments import Moments
from bayesid.signs.tuning import TUNING

EXACT = 1e-8
"""Share of the energy below which two costs count as equal (docs/certified-search.md): that of the finest solutions'
gaps (tests/regression/test_solver.py)."""


@dataclass(frozen=True)
class Branch:
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


def turned_round(moments: Moments, signs: Integers, joints: int | Sequence[int]) -> Integers:
    """(S,) the signs (S,) with all unknown ones of some joints, or of one, turned round."""
    return np.where(np.isin(moments.joint, joints) & (moments.known == 0), -signs, signs)


def predicted_signs(moments: Moments, beta: Array, decided: Integers | None = None) -> Integers:
    """(S,) the signs that coefficients (r,) predict where none is decided (S,), by default known beforehand."""
    decided = moments.known if decided is None else decided
    return np.where(decided != 0, decided, np.where(moments.gradient @ beta >= 0.0, 1, -1))


def listed_without_proof(moments: Moments, best: Branch, others: Iterable[Branch]) -> tuple[tuple[Branch, ...], Mask]:
    """The best assignment and those that come near, cheapest first, and (B, S) segments that each decides.

    A branch decides the strong segments and those in which branches differ; it stands for all signs of the others.
    """
    distinct = {branch.signs.tobytes(): branch for branch in [*others, best]}.values()
    near = (branch for branch in distinct if branch.cost <= best.cost + TUNING.near)
    branches = tuple(sorted(near, key=lambda branch: branch.cost))
    differ = np.any([branch.signs != best.signs for branch in branches], axis=0)
    strongest = np.zeros(int(moments.joint.max(initial=-1)) + 1)
    np.maximum.at(strongest, moments.joint, moments.energy)
    strong = moments.energy >= TUNING.strong * strongest[moments.joint]
    decided = (moments.known == 0) & ((strong & moments.individual) | differ)
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
    #: whether no other assignment can cost less (by more than 1e-8 of the efforts' energy), with the pull and without
    #: it, by the noise weights of the search and by those of its result
    certified: bool = False
    lower_bound: float | None = None  #: proven bound on the cost of every assignment, or None
    nodes: int = 0  #: priced by the unconstrained bound
    solves: int = 0  #: cone problems solved
    tolerance: float = 0.0  #: coarsest relative gap among them
    seconds: float = 0.0  #: of wall time
    #: the best assignment and all others that may cost at most `within` more, cheapest first; of a beam, the leaves
    #: that survived its last step; empty if neither was had
    branches: tuple[Branch, ...] = ()
    within: float = 0.0  #: Delta, in units of the cost
    #: bound on the sum of exp(-(cost - best cost) / 2) over all assignments of the segments decided one by one that
    #: `branches` leaves out (:eq:`missed-mass`); inf if nothing is proven
    missed: float = np.inf
    #: (S,) whether all assignments within Delta give the segment the same sign; None if nothing is proven
    settled: Mask | None = None
    #: (B, S) segments that each branch decides one by one; it stands for all signs of the others
    decided: Mask | None = None
    #: why a proof is no certificate: "pull" where another assignment may cost the data less, "noise" where the best
    #: assignment depends on the noise weights; empty otherwise
    withheld: str = ""
    pull: float | None = None  #: what rho adds to the cost; None if the nodes' price is the user's
    pruning: Pruning | None = None  #: what became of a beam's nodes; None without one
    spent: float = 0.0  #: nominal seconds of work; 0 where the search had no budget
    #: whether the time limit on the clock has ended it: a faster machine may give another result
    timed_out: bool = False
    ways: tuple[Way, ...] = ()  #: what each way of searching has found, in the order in which they were tried
    #: probability that an assignment which nobody has looked at is the right one; 0 where a proof excludes it
    unseen: float = 0.5

    def with_best(self, branch: Branch, **changes: Any) -> SearchResult:
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
