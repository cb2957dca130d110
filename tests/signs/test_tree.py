"""The proof's tree and its consequences, against the cost of all 2^k assignments."""

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp
from sign_problems import synthetic

from bayesid.signs.search.combinations import Combinations
from bayesid.signs.search.patterns import Patterns
from bayesid.signs.search.problem import SearchProblem
from bayesid.signs.search.tree import consequences, persistent, prove


class Proven:
    """The proof for a small problem in which some segments are decided beforehand, and the brute force to hold it to.

    Given are all combinations with an assignment that costs up to the limit, or all.
    """

    def __init__(self, problem, decided, within, all_given=False):
        m = problem.normal_equations
        self.problem, self.view = problem, SearchProblem(m, problem.solver(), np.inf)
        self.decided = np.setdiff1d(np.asarray(decided, dtype=np.int64), np.flatnonzero(m.known))
        self.listed = np.concatenate([np.flatnonzero(m.known), self.decided])
        self.limit = problem.least + within
        choices = np.array(list(itertools.product((1, -1), repeat=len(self.decided))), dtype=np.int64)
        choices = choices.reshape(2 ** len(self.decided), len(self.decided))
        least = np.array([self.least_with(self.decided, signs) for signs in choices])
        here = (least <= self.limit) | all_given
        gradient = m.known @ m.gradient + choices[here] @ m.gradient[self.decided]
        patterns = Patterns(self.decided, choices[here], gradient, np.zeros(here.sum()))
        log_missed = float(logsumexp(-0.5 * least[~here])) if np.any(~here) else -np.inf
        given = Combinations(patterns, np.zeros(len(patterns)), log_missed, {})
        theta = self.view.price(problem.assignments[np.argmax(problem.costs)]).theta
        self.proof = prove(self.view, given, self.limit, theta)
        self.exact, self.rounding = problem.exact, problem.precision
        self.signs = np.array([branch.signs for branch in self.proof.branches]).reshape(-1, len(m))
        pairs = zip(self.proof.branches, self.proof.decided, strict=True)
        certain = [persistent(self.view, branch, one, self.proof.limit) for branch, one in pairs]
        self.certain = np.array(certain, dtype=bool).reshape(self.signs.shape)

    def least_with(self, segments, signs):
        """The least cost of all assignments with these signs."""
        return self.problem.costs[np.all(self.problem.assignments[:, segments] == signs, axis=1)].min()

    @property
    def same(self):
        """(assignments, branches) whether they have the same signs where these are decided beforehand."""
        return np.all((self.problem.assignments[:, None] == self.signs)[:, :, self.listed], axis=2)

    def assert_sound(self):
        """All that a proof says holds."""
        problem, proof = self.problem, self.proof
        assert proof.lower_bound <= problem.least + self.exact
        bounds = np.where(self.same, [branch.lower_bound for branch in proof.branches], np.inf)
        assert np.all(problem.costs >= np.minimum(bounds.min(axis=1, initial=np.inf), proof.limit) - self.exact)
        for branch in proof.branches:
            assert branch.lower_bound <= branch.cost + self.rounding
            assert branch.cost == pytest.approx(problem.price(branch.signs), abs=self.exact)
        inside = problem.costs <= proof.limit - self.exact
        agree = (problem.assignments[:, None] == self.signs) | ~self.certain
        assert np.all(np.any(np.all(agree, axis=2), axis=1)[inside])
        # What is cut off from a combination counts as one, with the least cost in it.
        missing: dict[tuple, float] = {}
        apart = (problem.assignments[:, None] != self.signs) & proof.decided.reshape(self.signs.shape)
        out = np.all(np.any(apart, axis=2), axis=1)
        for signs, cost in zip(problem.assignments[out][:, self.listed].tolist(), problem.costs[out], strict=True):
            missing[tuple(signs)] = min(cost, missing.get(tuple(signs), np.inf))
        if missing:
            assert logsumexp(-0.5 * np.array(list(missing.values()))) <= proof.log_missed + self.exact + 1e-6
        if len(proof.branches):
            others = np.any(problem.assignments != self.signs[0], axis=1)
            assert proof.runner_up <= problem.costs[others].min(initial=np.inf) + self.exact


def random_proofs():
    """Few or no segments decided beforehand, and parameters that few rows leave open: much is left to the tree."""
    for cone in ("free", "orthant", "half", "body"):
        for seed in range(24):
            rng = np.random.default_rng(seed)
            problem = synthetic(
                seed,
                segments=int(rng.integers(4, 7 if cone == "body" else 9)),
                joints=int(rng.integers(1, 3)),
                cone=cone,
                size=int(rng.integers(2, 9)),
                noise=(0.3, 0.5, 1.0)[seed % 3],
                longest=(2, 3, 6)[seed // 3 % 3],
                spread=(1.0, 3.0, 10.0)[seed // 9],
                known=int(rng.integers(0, 2)),
                scale=(1.0, 10.0)[seed % 2],
                load=(1.0, 1e-3)[seed % 5 == 4],
            )
            first = np.flatnonzero(problem.normal_equations.known == 0)[: 1 + seed % 3]
            yield Proven(problem, first, (1.0, 20.0, 200.0)[seed % 3], all_given=seed % 2 == 1)


@pytest.fixture(scope="module")
def proofs():
    return list(random_proofs())


def test_all_that_is_proven_holds_and_the_best_assignment_is_proven(proofs):
    """Without a deadline the limit stands, and costs are proven up to the solver's precision."""
    for proven in proofs:
        proven.assert_sound()
        proof, least = proven.proof, proven.problem.least
        assert proof.branches[0].cost == pytest.approx(least, abs=2 * proven.exact)
        assert proof.limit == proven.limit
        assert min(proof.lower_bound, proof.runner_up) >= least - 1e-6 * proven.problem.energy
        assert np.all(proof.decided[:, proven.listed])


def test_most_of_what_is_certain_is_found(proofs):
    """Within the limit, all that a branch stands for may agree on a segment: by brute force, and by the proof."""
    possible = found = 0
    for proven in proofs:
        inside = proven.problem.assignments[proven.problem.costs <= proven.proof.limit]
        for signs, decided, certain in zip(proven.signs, proven.proof.decided, proven.certain, strict=True):
            group = inside[np.all((inside == signs)[:, decided], axis=1)]
            possible += np.sum(np.all(group == signs, axis=0) & ~decided)
            found += np.sum(certain & ~decided)
    assert possible > 50
    assert 0.9 * possible <= found <= possible
    split = sum(len({tuple(s) for s in one.signs[:, one.listed]}) < len(one.signs) for one in proofs)
    assert split >= 10, "much is left to the tree"


class Followed:
    """What follows from the signs of some segments in the assignment of a rank, by cost, up to a limit."""

    def __init__(self, problem, decided, within, rank=0):
        m = problem.normal_equations
        self.problem, self.limit = problem, problem.least + within
        signs = problem.assignments[np.argsort(problem.costs)[rank]]
        self.given = m.known.copy()
        self.given[decided] = signs[decided]
        self.found = consequences(SearchProblem(m, problem.solver(), np.inf), self.given, self.limit)
        self.rounding = problem.precision
        agrees = np.all((problem.assignments == self.given) | (self.given == 0), axis=1)
        self.completions, self.costs = problem.assignments[agrees], problem.costs[agrees]
        self.assumed = (self.found.signs != 0) & (self.found.decided == 0)

    @property
    def excluded(self):
        return self.found.bound > self.limit

    @property
    def decides(self):
        return int(np.sum((self.found.decided != 0) & (self.given == 0)))

    def check(self):
        found, matter = self.found, self.costs <= self.limit - self.rounding
        assert min(found.bound, self.limit) <= self.costs.min() + self.rounding
        if self.excluded:
            return
        np.testing.assert_array_equal(found.signs[self.given != 0], self.given[self.given != 0])
        assert np.all((self.completions[matter] == found.decided) | (found.decided == 0))
        assert np.all(found.excluded > self.limit)
        assert len(found.excluded) == self.decides
        assert np.array_equal(np.isfinite(found.gain) & (found.decided == 0), self.assumed)
        untouched = np.all(self.completions[:, self.assumed] == found.signs[self.assumed], axis=1)
        for k in np.flatnonzero(self.assumed):
            turned = matter & (self.completions[:, k] != found.signs[k])
            if np.any(turned):
                least = self.costs[untouched].min(initial=np.inf)
                assert self.costs[turned].min() >= least + found.gain[k] - self.rounding


def cases():
    for cone in ("free", "orthant", "half", "body"):
        for seed in range(10):
            problem = synthetic(
                seed,
                7,
                cone=cone,
                size=2 + seed % 4,
                noise=(0.05, 0.3, 1.0)[seed % 3],
                longest=(3, 8)[seed % 2],
                spread=(1.0, 10.0)[seed // 5],
                known=seed % 3,
                scale=(3.0, 30.0)[seed % 2],
            )
            unknown = np.flatnonzero(problem.normal_equations.known == 0)
            strongest = unknown[np.argsort(-problem.normal_equations.energy[unknown])]
            for depth in (1, 2, 3):
                for within in (2.0, 24.0, 300.0):
                    for rank in (0, 1, len(problem.costs) // 2):
                        yield Followed(problem, strongest[:depth], within, rank)


@pytest.fixture(scope="module")
def followed():
    return list(cases())


def test_nothing_up_to_the_limit_is_lost(followed):
    for case in followed:
        case.check()


def test_much_follows_from_few_signs(followed):
    best = [case for case in followed if not case.excluded]
    assert sum(case.decides > 0 for case in best) > 0.5 * len(best)
    assert sum(bool(np.any(case.assumed)) for case in best) > 20, "or assumptions are not shown to hold"
    assert sum(case.excluded for case in followed) > 20


def test_segments_that_share_a_part_of_the_hessian_are_left_alone():
    problem = synthetic(1, 7, cone="free", size=3, noise=0.05, longest=8, scale=30.0)
    shared = problem.but(problem.normal_equations.compact(2))
    case = Followed(shared, [int(np.argmax(shared.normal_equations.energy))], 24.0)
    case.check()
    assert np.all(case.found.signs[~shared.normal_equations.individual & (shared.normal_equations.known == 0)] == 0)
