"""What a search returns, and the bound that searches share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg.lapack import dtrtri

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.moments import Moments

EXACT = 1e-8
"""Share of the energy below which two costs count as equal (docs/certified-search.md): that of the finest solutions'
gaps (tests/fit/test_solver.py)."""
ALIKE = 0.1
"""Cost, twice the nats, within which the data do not prefer one of two assignments: odds of 1.05. What counts as equal
in the tree may be several nats where a log is precise; of the few that are priced one by one it need not."""
NEAR = 40.0
"""Cost beyond the best one's up to which an assignment is listed where nothing is proven: 20 nats."""
_STRONG = 0.1
"""Share of the energy of a joint's strongest segment from which on such a branch decides a segment: as in a proof
(`Limits.shares`)."""
_RIDGE = 1e-13
"""Curvature added to columns of unit length: a hundredth of the solver's least pull to typical links
(`bayesid.regression.solver.pull_weight`), so that the bound stays below the cost."""
_LEAST_RIDGE = 1e-15
"""The first ridge that is tried where rounding spoils a factor: a few units in the last place."""
_RIDGE_GROWTH = 10.0
"""From one ridge that is tried to the next."""
_MOST_RIDGE = 1e-11
"""What rounding may ask for where H holds a share of the pull already: ten thousand units in the last place."""
_LEAST_SQUARE = 1e-300
"""In the place of a column's squared length where it is zero."""


@dataclass(frozen=True)
class Branch:
    """One assignment of signs and the best parameters under it.

    Attributes:
        signs: (S,) +1 or -1 for each segment of the moments.
        theta: (P,) best feasible parameters.
        cost: min over the cone of f(theta, signs) + rho(theta), efforts in units of their noise
            (:eq:`assignment-cost`).
        lower_bound: proven bound on the cost of every assignment that the branch stands for: those with the same signs
            in the segments that the proof decided one by one, whatever the signs of the weak ones.
    """

    signs: Integers
    theta: Array
    cost: float
    lower_bound: float


@dataclass(frozen=True)
class Pruning:
    """What became of the nodes of a beam: all that were grown were pruned one way or the other, or survived their step.

    Attributes:
        grown: sign choices.
        by_bound: pruned by the unconstrained bound, without a cone problem.
        by_cone: pruned by their cost in the cone.
        survived: a step, the last one too.
        leaves: that survived the last step.
        undecided: segments that no step had decided when time was up: each leaf predicts their signs.
    """

    grown: int = 0
    by_bound: int = 0
    by_cone: int = 0
    survived: int = 0
    leaves: int = 0
    undecided: int = 0

    def __add__(self, other: Pruning) -> Pruning:
        return Pruning(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


def listed_without_proof(moments: Moments, best: Branch, others: Iterable[Branch]) -> tuple[tuple[Branch, ...], Mask]:
    """The best assignment and those that come near, cheapest first, and (B, S) segments that each decides.

    A branch decides the strong segments and those in which branches differ; it stands for all signs of the others.
    Nothing is proven about what the search has not met.
    """
    distinct = {branch.signs.tobytes(): branch for branch in [*others, best]}.values()
    near = (branch for branch in distinct if branch.cost <= best.cost + NEAR)
    branches = tuple(sorted(near, key=lambda branch: branch.cost))
    differ = np.any([branch.signs != best.signs for branch in branches], axis=0)
    strongest = np.zeros(int(moments.joint.max(initial=-1)) + 1)
    np.maximum.at(strongest, moments.joint, moments.energy)
    strong = moments.energy >= _STRONG * strongest[moments.joint]
    decided = (moments.known == 0) & ((strong & moments.individual) | differ)
    return branches, np.tile(decided, (len(branches), 1))


@dataclass(frozen=True)
class Way:
    """What one way of searching has found.

    Attributes:
        name: "candidates", "earlier signs" (found under another model), "branch and bound", "local search", "beam", or
            "final noise weights" (another assignment is cheaper by these; its cost does not compare with the others').
        cost: of its best assignment.
        spent: nominal seconds of work.
        starts: how often it began from other signs; 0 where that means nothing.
    """

    name: str
    cost: float
    spent: float = 0.0
    starts: int = 0


@dataclass(frozen=True)
class SearchResult:
    """The best assignment of a search, and what is proven about all others.

    Attributes:
        signs: (S,) +1 or -1 for each segment of the moments.
        theta: (P,) best feasible parameters under these signs.
        cost: min over the cone of f(theta, signs) + rho(theta), efforts in units of their noise
            (:eq:`assignment-cost`).
        method: of the search.
        width: of the beam; None if it was unlimited or there was none.
        certified: whether no other assignment can cost less (by more than 1e-8 of the efforts' energy), with the pull
            and without it, by the noise weights of the search and by those of its result.
        lower_bound: proven bound on the cost of every assignment, or None.
        nodes: priced by the unconstrained bound.
        solves: cone problems solved.
        tolerance: coarsest relative gap among them.
        seconds: of wall time.
        branches: the best assignment and all others that may cost at most `within` more, cheapest first; of a beam, the
            leaves that survived its last step; empty if neither was had.
        within: Delta, in units of the cost.
        missed: bound on the sum of exp(-(cost - best cost) / 2) over all assignments of the segments decided one by
            one that `branches` leaves out (:eq:`missed-mass`); inf if nothing is proven.
        settled: (S,) whether all assignments within Delta give the segment the same sign; None if nothing is proven.
        decided: (B, S) segments that each branch decides one by one; it stands for all signs of the others.
        withheld: why a proof is no certificate: "pull" where another assignment may cost the data less, "noise" where
            the best assignment depends on the noise weights; empty otherwise.
        pull: what rho adds to the cost; None if the nodes' price is the user's.
        pruning: what became of a beam's nodes; None without one.
        spent: nominal seconds of work; 0 where the search had no budget.
        timed_out: whether the time limit on the clock has ended it: a faster machine may give another result.
        ways: what each way of searching has found, in the order in which they were tried.
        unseen: probability that an assignment which nobody has looked at is the right one; 0 where a proof excludes it.
    """

    signs: Integers
    theta: Array
    cost: float
    method: str
    width: int | None = None
    certified: bool = False
    lower_bound: float | None = None
    nodes: int = 0
    solves: int = 0
    tolerance: float = 0.0
    seconds: float = 0.0
    branches: tuple[Branch, ...] = ()
    within: float = 0.0
    missed: float = np.inf
    settled: Mask | None = None
    decided: Mask | None = None
    withheld: str = ""
    pull: float | None = None
    pruning: Pruning | None = None
    spent: float = 0.0
    timed_out: bool = False
    ways: tuple[Way, ...] = ()
    unseen: float = 0.5

    def with_work_of(self, others: Iterable[SearchResult]) -> SearchResult:
        """The result with nodes, solves and pruning of other searches counted too."""
        every = [self, *others]
        counted = [result.pruning for result in every if result.pruning is not None]
        return replace(
            self,
            nodes=sum(result.nodes for result in every),
            solves=sum(result.solves for result in every),
            spent=sum(result.spent for result in every),
            timed_out=any(result.timed_out for result in every),
            pruning=None
            if self.pruning is None
            else replace(sum(counted, Pruning()), **self._at_the_end(self.pruning)),
        )

    def without_work(self) -> SearchResult:
        """The result as one that took none."""
        pruning = None if self.pruning is None else Pruning(**self._at_the_end(self.pruning))
        return replace(self, nodes=0, solves=0, spent=0.0, pruning=pruning)

    @staticmethod
    def _at_the_end(pruning: Pruning) -> dict[str, int]:
        """What a beam's last step has left, which is no work."""
        return {"leaves": pruning.leaves, "undecided": pruning.undecided}


class UnconstrainedBound:
    """min over all coefficients of beta' H beta - 2 g' beta, for many g: a lower bound of the cost in the cone.

    The least over beta of :eq:`binary-quadratic`, and the bound of :eq:`unconstrained-bound`, without the energy c.

    Args:
        hessian: (r, r) H.
        ridge: curvature added to columns of unit length; 0 where H holds a share of the pull.
    """

    def __init__(self, hessian: Array, ridge: float = _RIDGE) -> None:
        lengths = np.sqrt(np.maximum(np.diag(hessian), _LEAST_SQUARE + ridge * np.diag(hessian).max()))
        scaled = hessian / np.outer(lengths, lengths) + ridge * np.eye(len(hessian))
        self._factor = dtrtri(_cholesky(scaled), lower=1)[0] / lengths

    def __call__(self, gradient: Array) -> Array:
        """(m,) minima -g' H^-1 g for the rows of gradient (m, r)."""
        return -np.sum(self.whiten(gradient) ** 2, axis=1)

    def whiten(self, gradient: Array) -> Array:
        """(m, r) rows W g with |W g|^2 = g' H^-1 g."""
        white: Array = gradient @ self._factor.T
        return white

    def draw(self, rng: np.random.Generator) -> Array:
        """(r,) normal, of mean zero and covariance H^-1."""
        drawn: Array = rng.standard_normal(len(self._factor)) @ self._factor
        return drawn


def _cholesky(matrix: Array) -> Array:
    """L with L L' = matrix, plus the smallest ridge that rounding asks for.

    Raises:
        LinAlgError: the matrix is not positive definite but for rounding.
    """
    ridge = 0.0
    while True:
        try:
            return np.linalg.cholesky(matrix + ridge * np.eye(len(matrix))).astype(np.float64)
        except np.linalg.LinAlgError:
            if ridge >= _MOST_RIDGE:
                raise
        ridge = max(_LEAST_RIDGE, _RIDGE_GROWTH * ridge)
