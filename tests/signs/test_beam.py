from dataclasses import replace

import numpy as np
import pytest
from sign_problems import synthetic

from bayesid.signs.search.beam import beam, flip_joints, keep_incumbent
from bayesid.signs.tuning import TUNING


def test_a_flipped_joint_is_flipped_back():
    problem = synthetic(4, 9, joints=3, cone="body", noise=0.3, longest=8)
    m = problem.normal_equations
    best = beam(m, problem.solver(), width=None, initial=3)
    turned = np.where(m.joint == 1, -best.signs, best.signs)
    wrong = replace(best, signs=turned, theta=problem.solver().prepared().solve(turned @ m.gradient).theta)
    wrong = replace(wrong, cost=problem.price(turned))
    assert wrong.cost > best.cost * 1.01
    found = flip_joints(m, problem.solver(), wrong)
    assert np.array_equal(found.signs, best.signs)
    assert found.cost == pytest.approx(best.cost, rel=1e-4)


def test_the_result_of_an_earlier_search_is_kept():
    problem = synthetic(9, 8, joints=2, cone="body", noise=0.3, longest=8, known=1)
    m, coefficients = problem.normal_equations, problem.coefficients
    best = beam(m, problem.solver(), width=None, initial=3)
    wrong = replace(best, signs=np.where(m.known != 0, m.known, -best.signs), cost=best.cost * 2.0)
    kept = keep_incumbent(m, problem.solver(), wrong, coefficients.project(best.theta))
    assert kept.cost <= best.cost * (1 + 1e-4)
    assert np.all(kept.signs[m.known != 0] == m.known[m.known != 0])
    same = keep_incumbent(m, problem.solver(), best, -coefficients.project(best.theta))
    assert np.array_equal(same.signs, best.signs)


def test_a_beam_on_shared_parts_signs_every_segment():
    problem = synthetic(3, 9, joints=2, cone="body", noise=0.1, longest=12, known=2, scale=3.0)
    known = problem.normal_equations.known
    for own in (1, 3):
        found = beam(problem.normal_equations.compact(own), problem.solver(), width=None)
        assert set(found.signs) <= {-1, 1}
        assert np.all(found.signs[known != 0] == known[known != 0])
        assert found.cost == pytest.approx(problem.price(found.signs), abs=1e-5 * problem.energy)
        assert found.cost == pytest.approx(problem.least, abs=1e-4 * problem.energy), "with so little noise it is right"


def test_an_unlimited_beam_finds_the_least_cost_in_every_cone():
    """Known signs are kept, or no assignment would have its cost."""
    for seed in range(12):
        cone = ("free", "orthant", "body")[seed % 3]
        problem = synthetic(seed, 7, joints=2, cone=cone, noise=0.5, longest=8, known=seed % 2)
        found = beam(problem.normal_equations, problem.solver(), width=None)
        assert found.cost == pytest.approx(problem.least, abs=1e-5 * problem.energy)
        assert problem.price(found.signs) <= problem.least + 1e-5 * problem.energy
        assert np.all(
            found.signs[problem.normal_equations.known != 0]
            == problem.normal_equations.known[problem.normal_equations.known != 0]
        )


@pytest.mark.parametrize("seed", [0, 1])
def test_the_leaves_of_an_unlimited_beam_are_all_assignments_that_matter(seed):
    problem = synthetic(seed, 7, joints=2, cone="body", noise=0.8, longest=8, known=1)
    problem = problem.but(problem.normal_equations.scaled(np.full(2, 16.0)))
    found = beam(problem.normal_equations, problem.solver(), width=None)
    near = problem.costs <= problem.least + TUNING.near
    model_error_probability = np.abs(problem.costs - problem.least - TUNING.near) < 1e-4 * problem.energy
    listed = {tuple(branch.signs.tolist()): branch.cost for branch in found.branches}
    expected = {tuple(signs.tolist()) for signs in problem.assignments[near & ~model_error_probability]}
    assert (
        expected
        <= set(listed)
        <= {tuple(signs.tolist()) for signs in problem.assignments[near | model_error_probability]}
    )
    assert len(expected) > 1, "or the case shows nothing"
    for signs, cost in zip(problem.assignments, problem.costs, strict=True):
        if tuple(signs.tolist()) in listed:
            assert listed[tuple(signs.tolist())] == pytest.approx(cost, abs=1e-5 * problem.energy)
    assert [branch.cost for branch in found.branches] == sorted(listed.values())
    np.testing.assert_array_equal(found.branches[0].signs, found.signs)
    signs = np.array(sorted(listed))
    assert np.all(found.decided[:, np.ptp(signs, axis=0) > 0]), "what tells leaves apart is decided"
    assert found.persistent is None
    assert not found.certified
    assert found.missed == np.inf


def test_every_node_was_pruned_one_way_or_survived():
    problem = synthetic(11, 10, joints=2, cone="body", noise=0.6, longest=8)
    found = beam(problem.normal_equations, problem.solver(), width=3, initial=4)
    pruning = found.pruning
    assert pruning.grown == found.nodes == 2**4 + 6 * (2 * 3)
    assert pruning.grown == pruning.by_bound + pruning.by_cone + pruning.survived
    assert pruning.survived == 3 * 7
    assert pruning.by_cone == found.solves - pruning.survived
    assert pruning.leaves == 3 >= len(found.branches)
    twice = found.with_work_of([found])
    assert twice.nodes == twice.pruning.grown == 2 * found.nodes
    assert twice.pruning.leaves == 3
