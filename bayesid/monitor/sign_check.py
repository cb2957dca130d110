"""Whether the signs that a stream's estimates rest on are those that a search over all of it would find."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.monitor.stream_moments import MERGED, Stretches
from bayesid.monitor.tuning import TUNING
from bayesid.signs.search.protocol import Search, SignProblem
from bayesid.signs.search.result import SearchResult

_SURELY = 2.0 * float(np.log(99.0))
"""Cost, twice the nats, from which on a sign is as good as certain: 99 to 1, `bayesid.identification.SURE`."""


@dataclass(frozen=True)
class TurnedStretch:
    """A stretch of constant sign that fits surely better with the other sign.

    Attributes:
        joint: from 1.
        start: its first sample, s.
        end: its last sample, s.
        n_samples: in it.
        cost: by how much its efforts, in units of their noise, cost more with the sign that was taken, the parameters
            as the search has them (twice the nats).
        settled: whether all assignments that come near the best one agree on its sign.
        merged: whether it holds all of the joint's stretches that are no longer kept by themselves, whose signs can
            only be turned together.
    """

    joint: int
    start: float
    end: float
    n_samples: int
    cost: float
    settled: bool
    merged: bool


@dataclass(frozen=True)
class SignCheck:
    """The signs that were taken beside those that a search over all of a stream finds.

    Attributes:
        stretches: those whose sign is another, as good as certainly (99 to 1), the dearest first; near zero effort, and
            in a sample or three, signs may differ too.
        cost_taken: least cost in the cone with the signs that were taken, efforts in units of their noise.
        cost: the same with the signs that were found.
        certified: whether no other signs of the stretches can cost less than those that were found.
        n_stretches: how many were searched.
        search: its result, +1 for the sign that was taken, -1 for the other.
    """

    stretches: tuple[TurnedStretch, ...]
    cost_taken: float
    cost: float
    certified: bool
    n_stretches: int
    search: SearchResult

    @property
    def differ(self) -> bool:
        """Whether the signs that were found differ from those that were taken."""
        return bool(self.stretches)

    def __repr__(self) -> str:
        turned = f"{len(self.stretches)} of {self.n_stretches} stretches would be turned"
        how = "proven" if self.certified else "not proven"
        lines = [f"SignCheck: {turned}, {how}; cost {self.cost:.6g}, as taken {self.cost_taken:.6g}"]
        lines += [f"joint {one.joint}, {one.start:.6g} to {one.end:.6g} s: {one.cost:.3g}" for one in self.stretches]
        return "\n  ".join(lines)


def check_signs(problem: SignProblem, stretches: Stretches, search: Search) -> SignCheck:
    """Searches the signs of a stream's stretches.

    Args:
        problem: their moments in units of the noise.
        stretches: where they are.
        search: how to search.

    Raises:
        SolverError: an optimisation failed.
    """
    result = search.find(problem)
    result = search.conclude(replace(problem, earlier=result)).with_work_of([result])
    taken = problem.solver().prepared().solve_precisely(problem.moments.gradient.sum(axis=0))
    cost_taken = problem.energy + taken.cost
    gain = 4.0 * problem.moments.gradient @ problem.coefficients.project(result.theta)
    turned = np.flatnonzero((result.signs < 0) & (-gain >= _SURELY) & (problem.moments.count > TUNING.outliers))
    order = turned[np.argsort(gain[turned], kind="stable")]
    listed = _listed(stretches, result, -gain, order) if result.cost < cost_taken else ()
    return SignCheck(listed, cost_taken, result.cost, result.certified, len(result.signs), result)


def _listed(stretches: Stretches, result: SearchResult, cost: Array, order: Integers) -> tuple[TurnedStretch, ...]:
    """Some of the stretches, with what each costs more as taken (S,)."""
    settled = np.zeros(len(result.signs), dtype=bool) if result.settled is None else result.settled
    return tuple(
        TurnedStretch(
            joint=int(stretches.moments.joint[k]) + 1,
            start=float(stretches.start[k]),
            end=float(stretches.end[k]),
            n_samples=int(stretches.moments.count[k]),
            cost=float(cost[k]),
            settled=bool(settled[k]),
            merged=bool(stretches.number[k] == MERGED),
        )
        for k in order
    )
