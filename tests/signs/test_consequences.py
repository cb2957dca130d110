"""What decided signs say about further segments, against the cost of all 2^k assignments."""

import numpy as np
import pytest
from sign_problems import synthetic

from bayesid.signs.search.problem import Problem
from bayesid.signs.search.tree import consequences


class Followed:
    """What follows from the signs of some segments in the assignment of a rank, by cost, up to a limit."""

    def __init__(self, problem, decided, within, rank=0):
        m = problem.moments
        self.problem, self.limit = problem, problem.least + within
        signs = problem.assignments[np.argsort(problem.costs)[rank]]
        self.given = m.known.copy()
        self.given[decided] = signs[decided]
        self.found = consequences(Problem(m, problem.solver(), np.inf), self.given, self.limit)
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
            unknown = np.flatnonzero(problem.moments.known == 0)
            strongest = unknown[np.argsort(-problem.moments.energy[unknown])]
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
    shared = problem.but(problem.moments.compact(2))
    case = Followed(shared, [int(np.argmax(shared.moments.energy))], 24.0)
    case.check()
    assert np.all(case.found.signs[~shared.moments.individual & (shared.moments.known == 0)] == 0)
