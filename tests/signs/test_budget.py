"""Every budget bounds every search, and one budget all searches of an identification."""

import time

import numpy as np
import pytest
from sign_problems import synthetic

from bayesid.signs.search.beam import Beam
from bayesid.signs.search.protocol import OneBudget, Search, SearchResult, SignProblem
from bayesid.signs.tuning import TUNING


def given(segments=40):
    small = synthetic(3, segments, joints=2, cone="orthant", noise=0.3, known=1)
    return small.normal_equations, SignProblem(small.normal_equations, small.cone, small.coefficients)


class Spends(Search):
    """Takes what it is given, and notes what that was."""

    budget, time_limit = 10.0, np.inf

    def __init__(self, noted, budget=10.0, takes=4.0, time_limit=np.inf):
        self.noted, self.budget, self.takes, self.time_limit = noted, budget, takes, time_limit

    def limited(self, budget, time_limit):
        return Spends(self.noted, budget, self.takes)

    def find(self, problem, steps=None):
        self.noted.append(self.budget)
        return SearchResult(np.ones(1), np.zeros(1), 1.0, "spends", spent=min(self.takes, self.budget))


def test_all_searches_share_one_budget():
    noted = []
    shared = OneBudget(Spends(noted), time.perf_counter())
    for _ in range(6):
        shared.find(None)
    assert noted == pytest.approx([10.0, 6.0, 2.0, 2.0, 0.0, 0.0])
    assert sum(min(4.0, given) for given in noted) == (1.0 + TUNING.budget_afterwards) * 10.0


def test_the_time_limit_counts_from_the_first_search_whatever_the_budget():
    limits = []

    class Notes(Spends):
        def limited(self, budget, time_limit):
            limits.append(round(time_limit))
            return self

    for ago in (0.0, 500.0, 700.0):
        OneBudget(Notes([], time_limit=600.0), time.perf_counter() - ago).find(None)
    assert limits == [600, 100, 0]


def test_a_beam_ends_with_its_budget_and_says_so():
    """With none at all it enumerates once; every segment has a sign all the same, and nothing known is turned."""
    normal_equations, problem = given()
    whole = Beam(width=3, budget=np.inf).find(problem)
    assert whole.pruning.undecided == 0
    for ends, timed_out in (({"budget": 0.0}, False), ({"time_limit": 0.0, "budget": np.inf}, True)):
        cut = Beam(width=3, **ends).find(problem)
        assert cut.timed_out == timed_out
        assert cut.pruning.undecided == int((normal_equations.known == 0).sum()) - 5
        assert cut.solves < whole.solves
        assert set(np.unique(cut.signs)) <= {-1, 1}
        assert np.all(cut.signs[normal_equations.known != 0] == normal_equations.known[normal_equations.known != 0])
        assert whole.cost - 1e-6 <= cut.cost < problem.energy
        assert not cut.certified
