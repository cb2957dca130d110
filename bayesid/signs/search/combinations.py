"""Combinations of the joints' patterns that no bound excludes: by joint, by all rows together, in the cone.

The search goes from coarse to fine. A few strong segments of each joint give short lists and few combinations. On these
the cone excludes flips of whole joints. Finer lists are then joined within each remaining combination.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.signs.search.bounds import UnconstrainedBound
from bayesid.signs.search.patterns import LOG2, Block, Keep, Patterns, Remainder, join, log_sum, stack
from bayesid.signs.search.problem import SearchProblem


class TooManyError(Exception):
    """There are more combinations than `most_combinations`."""


@dataclass(frozen=True)
class Combinations:
    """m sign choices of the same segments of all joints."""

    patterns: Patterns  # their signs and gradients
    lower: Array  # (m,) lower bounds of the cost, weaker segments included
    log_missed: float  # log of the sum of exp(-b / 2) over all other choices, b their bounds
    thetas: dict[int, Array]  # parameters (P,) of the solved rows

    def __len__(self) -> int:
        return len(self.lower)


def least_costs(problem: SearchProblem) -> Array:
    """(blocks,) lower bounds of the joints' own costs, from as many segments as a list can decide.

    Raises:
        OutOfTimeError: the budget has ended.
    """
    ends = _ends(problem, problem.tuning.shares[-1])
    pairs = zip(problem.blocks, ends, _tails(problem, ends), strict=True)
    return np.array([_least_cost(problem, block.first(end)) + tail for block, end, tail in pairs])


def _ends(problem: SearchProblem, share: float) -> list[int]:
    """Number of segments of each block in its least cost; in a long log the others are a separate block."""
    most = problem.tuning.least_group
    lengths = [len(block.segments) for block in problem.blocks]
    strong = [block.strong(share, problem.tuning.listed) for block in problem.blocks]
    return [length if length <= most else end for length, end in zip(lengths, strong, strict=True)]


def _tails(problem: SearchProblem, ends: list[int]) -> list[float]:
    """Lower bounds of the cost of the remaining segments, with half of rho of the undecided rows."""
    if not problem.tails:
        tikhonov = 0.5 * problem.tuning.undecided_tikhonov / max(1, len(problem.blocks)) * problem.tikhonov
        tails = [block.after(end, tikhonov) for block, end in zip(problem.blocks, ends, strict=True)]
        problem.tails = [_least_cost(problem, tail) if len(tail.segments) else 0.0 for tail in tails]
    return problem.tails


def _least_cost(problem: SearchProblem, block: Block) -> float:
    problem.check(0)
    tuning = problem.tuning
    work = tuning.least_width, tuning.least_list, problem.check, problem.rounding
    return sum(group.least(*work) for group in block.groups(tuning.least_group))


def combinations(problem: SearchProblem, limit: float, least: Array) -> Combinations:
    """All combinations that may cost up to `limit`, of as many segments as possible (:eq:`joint-bound`).

    Raises:
        OutOfTimeError: the budget has ended.
        TooManyError: even one segment of each joint gives too many.
    """
    shares = problem.tuning.shares
    finest = _Level.make(problem, limit, least, shares[-1])
    joined = finest.joined(None)
    if joined is not None and len(joined) <= problem.tuning.few_combinations:
        return finest.in_the_cone(joined)
    survivors: Combinations | None = None
    for share in shares:
        level = finest if share == shares[-1] else _Level.make(problem, limit, least, share, finest.depth)
        joined = level.joined(survivors)
        if joined is None:
            break
        survivors = level.in_the_cone(joined)
    if survivors is None:
        raise TooManyError
    return survivors


@dataclass(frozen=True)
class _Level:
    """The segments of all joints above a share of their strongest segment's energy."""

    problem: SearchProblem  # the problem
    limit: float  # of the cost
    lists: list[Patterns]  # each block's patterns
    least: Array  # (blocks,) lower bounds of the joints' own costs
    later: Array  # (blocks,) lower bounds of the cost of the segments that the lists do not decide

    @property
    def depth(self) -> int:
        """Number of segments that the lists decide."""
        return sum(len(patterns.segments) for patterns in self.lists)

    @classmethod
    def make(cls, problem: SearchProblem, limit: float, least: Array, share: float, finest: int = 0) -> _Level:
        """The lists of one level.

        A choice excluded here counts once for each completion among the `finest` segments, so the limit is higher.
        """
        depths = [block.strong(share, problem.tuning.listed) for block in problem.blocks]
        limit += 2.0 * LOG2 * max(0, finest - sum(depths))
        ends = _ends(problem, problem.tuning.shares[-1])
        tikhonov = 0.5 * problem.tuning.undecided_tikhonov / len(problem.blocks) * problem.tikhonov
        ranges = zip(problem.blocks, depths, ends, strict=True)
        rests = [block.after(depth, tikhonov, end) for block, depth, end in ranges]
        later = np.array([_least_cost(problem, block) for block in rests]) + _tails(problem, ends)
        lists = []
        for i, block in enumerate(problem.blocks):
            within = limit + problem.slack - float(np.delete(least, i).sum() + later[i])
            remainder = Remainder(float(later[i]), float(least[i]))
            lists.append(block.within(within, depths[i], problem.tuning.longest_list, problem.check, remainder))
        return cls(problem, limit, lists, least, later)

    def joined(self, coarser: Combinations | None) -> Combinations | None:
        """All combinations of the lists by unconstrained bounds, within those of a coarser level if given.

        None if there are too many, of all joints or of some of them.
        """
        try:
            return self._joined(coarser)
        except TooManyError:
            return None

    def _joined(self, coarser: Combinations | None) -> Combinations:
        slack, held = self.problem.slack, dict.fromkeys(range(len(self.lists)), 0)
        order = _shortest_first(self.lists)

        def within(to_come: list[int]) -> tuple[Keep, float]:
            highest = self.limit + slack - float(self.least[to_come].sum() + np.delete(self.later, to_come).sum())

            def keep(bound: Array) -> Integers:
                self.problem.check(len(bound))
                kept = np.flatnonzero(bound <= highest)
                held[len(to_come)] += len(kept)
                if held[len(to_come)] > self.problem.tuning.most_combinations:
                    raise TooManyError
                return kept

            return keep, highest

        if coarser is None:
            joined = combine(self.problem, self.lists, within)
            lower = joined.bound + self.later.sum() - slack
            return Combinations(joined, lower, joined.log_missed + 0.5 * slack, {})
        groups, lowers = [], []
        for row, bound in enumerate(coarser.lower):
            self.problem.check(sum(len(patterns) for patterns in self.lists))
            decided = self.problem.decided(coarser.patterns, row)
            lists = [patterns.beginning_with(decided) for patterns in self.lists]
            groups.append(combine(self.problem, lists, within, order))
            lowers.append(np.maximum(groups[-1].bound + self.later.sum() - slack, bound))
        joined = stack(groups)
        finer = len(joined.segments) - len(coarser.patterns.segments)
        log_missed = np.logaddexp(joined.log_missed + 0.5 * slack, coarser.log_missed + finer * LOG2)
        return Combinations(joined, np.concatenate(lowers), float(log_missed), {})

    def in_the_cone(self, joined: Combinations) -> Combinations:
        """The combinations whose lower bound in the cone is up to the limit.

        A solved problem bounds the others too, so few are solved. With other signs its cost changes by -2 step' beta,
        and it is strongly convex around its optimum; the least over all d of d'(H + Q / 2) d - 2 step'(beta + d)
        remains (:eq:`convexity-bound`). The other half of Q covers the share u of the Tikhonov term in the bounds of
        undecided rows, u (beta + d)' Q (beta + d) <= 2 u beta' Q beta + d' Q d / 2.
        """
        problem, patterns, lower = self.problem, joined.patterns, joined.lower.copy()
        hessian, energy = problem.decided_moments(patterns)
        prepared = problem.solver.prepared(hessian)
        unconstrained = UnconstrainedBound(hessian + 0.5 * problem.tikhonov, 0.0)
        later = float(self.later.sum())
        solved: dict[int, Array] = {}
        remaining = np.flatnonzero(lower <= self.limit)
        waiting = remaining
        while waiting.size and not problem.budget.over:
            row = int(waiting[np.argmin(lower[waiting])])
            solution = problem.solve(prepared, patterns.gradient[row])
            solved[row], beta = solution.theta, problem.solver.project(solution.theta)
            problem.count(len(remaining))
            bound = (
                energy
                + solution.lower_bound
                + later
                - 2.0 * problem.tuning.undecided_tikhonov * float(beta @ problem.tikhonov @ beta)
            )
            steps = patterns.gradient[remaining] - patterns.gradient[row]
            reach = -unconstrained(steps)
            model_error_probability = 2.0 * np.sqrt((solution.cost - solution.lower_bound) * reach)
            lower[remaining] = np.maximum(
                lower[remaining], bound - 2.0 * steps @ beta - reach - model_error_probability
            )
            remaining = remaining[lower[remaining] <= self.limit]
            waiting = remaining[~np.isin(remaining, list(solved))]
        log_missed = float(np.logaddexp(joined.log_missed, log_sum(np.delete(lower, remaining))))
        thetas = {new: solved[old] for new, old in enumerate(remaining.tolist()) if old in solved}
        return Combinations(patterns[remaining], lower[remaining], log_missed, thetas)


def _shortest_first(lists: list[Patterns]) -> list[int]:
    return [int(i) for i in np.argsort([len(patterns) for patterns in lists], kind="stable")]


def combine(
    problem: SearchProblem,
    lists: list[Patterns],
    choose: Callable[[list[int]], tuple[Keep, float]],
    order: list[int] | None = None,
) -> Patterns:
    """The joints' lists joined one after the other, the shortest first by default, which is the least work.

    `choose` maps the remaining blocks to a function that selects among the combinations so far, and to a limit of the
    sum of their separate bounds.
    """
    order = _shortest_first(lists) if order is None else order
    joined, hessian, energy = lists[order[0]], np.zeros_like(problem.tikhonov), 0.0
    for position, i in enumerate(order):
        depth = len(lists[i].segments)
        hessian = hessian + problem.blocks[i].hessian(depth)
        energy += problem.blocks[i].energy(depth)
        if position > 0:
            problem.combined += len(joined) * len(lists[i])
            keep, limit = choose(order[position + 1 :])
            joined = join(joined, lists[i], hessian, energy, keep, limit, problem.tuning.pairs_at_once)
    return joined
