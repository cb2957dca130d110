"""The bound of many segments by groups, against brute force over all signs (`sign_problems`)."""

from dataclasses import replace

import numpy as np
import pytest
from sign_problems import arm, synthetic

from bayesid.signs.search.certified import certified
from bayesid.signs.search.divided import divided_bound, groups
from bayesid.signs.search.limits import Limits
from bayesid.signs.search.problem import Problem

FEW = Limits(together=3)


def problems():
    for seed in range(12):
        cone = ("free", "orthant", "half", "body")[seed % 4]
        yield synthetic(seed, segments=8, joints=2, cone=cone, size=5, noise=0.3, spread=3.0, known=seed % 3)
    for seed in range(4):
        yield arm(seed, 6, 2, ("rigid_body", "viscous_friction"), 0.3)


def bound(problem, limits=FEW, budget=10.0):
    whole = Problem(problem.moments, problem.solver(), budget, limits=limits)
    return divided_bound(whole, certified(problem.moments, problem.solver()).theta)


def test_no_assignment_costs_less():
    found = [(bound(problem), problem) for problem in problems()]
    assert all(low <= problem.least + problem.exact for low, problem in found)
    assert sum(low > 0.2 * problem.least for low, problem in found) >= 10, "a bound that says nothing is none"


def test_of_one_group_it_is_what_the_best_signs_cost():
    for problem in problems():
        low = bound(problem, replace(FEW, together=100))
        assert problem.least - low <= 2.0 * problem.exact + 1e-6 * problem.least
        assert low <= problem.least + problem.exact


def test_every_segment_is_in_one_group_and_what_cannot_be_parted_in_the_first():
    moments = synthetic(3, segments=14, joints=2, cone="free", size=5, known=3).moments.compact(4)
    parted = list(groups(moments, 3))
    assert len(parted) == 2
    assert np.array_equal(np.sort(np.concatenate(parted)), np.arange(14))
    stuck = np.flatnonzero((moments.known != 0) | ~moments.individual)
    assert len(stuck) > 3
    assert np.isin(stuck, parted[0]).all()
    for group in parted:
        chosen = moments.chosen(group)
        np.testing.assert_allclose(chosen.hessian.total(), moments.hessian_of(group), rtol=1e-12, atol=1e-12)


def test_segments_that_share_a_hessian_cannot_be_parted():
    moments = synthetic(3, segments=14, joints=2, cone="free", size=5, known=3).moments.compact(4)
    shared = np.flatnonzero(~moments.individual)
    with pytest.raises(ValueError, match="cannot be parted"):
        moments.chosen(shared[1:])


def test_a_search_of_more_segments_than_are_proven_together_states_that_bound():
    """Not certified, but near: the freedom of each group costs little beside many samples."""
    problem = arm(2, 30, 3, ("viscous_friction",), 0.3)
    found = certified(problem.moments, problem.solver(), limits=replace(FEW, together=10))
    whole = certified(problem.moments, problem.solver())
    assert whole.certified
    assert not found.certified
    assert np.array_equal(found.signs, whole.signs)
    assert 0.8 * whole.cost < found.lower_bound <= whole.cost
    without = certified(problem.moments, problem.solver(), budget=0.0, limits=replace(FEW, together=10))
    assert without.lower_bound == 0.0
