import itertools
from dataclasses import replace

import numpy as np
import pytest
from conftest import random_motion, small_robot
from sign_problems import synthetic

from bayesid.fit.moments import moments
from bayesid.fit.solver import ConeLeastSquares, Solution
from bayesid.log.segments import Segments
from bayesid.model.catalogue import make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.signs.search.beam import Beam, beam, keep_incumbent, turn_joints
from bayesid.signs.search.protocol import SignProblem
from bayesid.signs.search.result import UnconstrainedBound
from bayesid.simulation.parameters import random_parameters


def case(n_joints, n_segments, seed, known=()):
    """|effort| of a physical arm with 60 % noise, cut at random: the truth need not be the best."""
    rng = np.random.default_rng(seed)
    robot = small_robot(n_joints, seed)
    samples = 12 * n_segments
    motion = random_motion(n_joints, samples, seed)
    model = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
    coefficients = base_coefficients(model)
    effort = model.effort(motion, random_parameters(model, rng))
    effort = np.abs(effort + 0.6 * np.sqrt(np.mean(effort**2, axis=0)) * rng.normal(size=effort.shape))
    start = np.sort(rng.choice(np.arange(3, samples - 3), n_segments - 1, replace=False))
    start, end = np.concatenate([[0], start]), np.concatenate([start, [samples]])
    signs = np.zeros(n_segments, dtype=np.int64)
    signs[list(known)] = [1, -1][: len(known)]
    segments = Segments(rng.integers(0, n_joints, n_segments), start, end, signs, np.ones(n_segments, dtype=bool))
    return model, coefficients, moments(model, coefficients, motion, effort, segments).scaled(np.ones(n_joints))


def cone(model, coefficients, m, tolerance=1e-6):
    return ConeLeastSquares(model.cone, coefficients, m.hessian.total(), float(m.energy.sum()), 0.0, tolerance)


@pytest.mark.parametrize(("n_joints", "n_segments", "seed"), [(1, 6, 0), (2, 7, 1), (2, 8, 2), (3, 8, 3)])
def test_unlimited_beam_equals_brute_force(n_joints, n_segments, seed):
    model, coefficients, m = case(n_joints, n_segments, seed)
    prepared = cone(model, coefficients, m).prepared()
    costs = {
        signs: prepared.solve(np.array(signs) @ m.gradient).cost + m.energy.sum()
        for signs in itertools.product((1, -1), repeat=n_segments)
    }
    best = min(costs, key=costs.__getitem__)
    found = beam(m, cone(model, coefficients, m), width=None, initial=3)
    assert found.cost == pytest.approx(costs[best], rel=1e-4)
    assert costs[tuple(found.signs)] <= costs[best] + 2e-5 * m.energy.sum()
    assert found.nodes >= 2**n_segments


def test_unlimited_beam_equals_brute_force_on_twelve_segments():
    """4096 assignments, priced without the cone so that brute force stays cheap; -s costs the same as s."""
    model, coefficients, m = case(2, 12, seed=7)

    class Unconstrained:
        def __init__(self, hessian=None):
            self.hessian = hessian

        def prepared(self, hessian):
            return Unconstrained(hessian)

        def solve(self, gradient):
            return Solution(np.empty(0), float(UnconstrainedBound(self.hessian)(gradient[None])[0]), 0.0)

    signs = np.array(list(itertools.product((1, -1), repeat=12)))
    total = m.hessian.total()
    gradients = signs @ m.gradient
    costs = m.energy.sum() - np.einsum("ar,ar->a", gradients, np.linalg.solve(total, gradients.T).T)
    found = beam(m, Unconstrained(), width=None)
    assert found.cost == pytest.approx(costs.min(), rel=1e-6)
    best = signs[np.argmin(costs)]
    assert np.array_equal(found.signs, best) or np.array_equal(found.signs, -best)


def test_known_signs_are_kept():
    model, coefficients, m = case(2, 8, seed=5, known=(2, 6))
    found = beam(m, cone(model, coefficients, m), width=None)
    assert (found.signs[2], found.signs[6]) == (1, -1)
    for signs in itertools.product((1, -1), repeat=6):
        full = np.insert(np.array(signs), [2, 5], [1, -1])
        cost = cone(model, coefficients, m).prepared().solve(full @ m.gradient).cost + m.energy.sum()
        assert cost >= found.cost - 2e-5 * m.energy.sum()


def test_all_signs_known_is_one_solve():
    model, coefficients, m = case(2, 2, seed=6, known=(0, 1))
    found = beam(m, cone(model, coefficients, m))
    assert found.solves == 1
    assert found.signs.tolist() == [1, -1]


def test_bound_never_exceeds_the_cost_in_the_cone():
    model, coefficients, m = case(3, 10, seed=8)
    total, prepared = m.hessian.total(), cone(model, coefficients, m).prepared()
    for signs in np.random.default_rng(0).choice([1, -1], size=(40, 10)):
        gradient = signs @ m.gradient
        bound = UnconstrainedBound(total)(gradient[None])[0]
        assert bound <= prepared.solve(gradient).cost + 1e-6 * m.energy.sum()


@pytest.mark.long
def test_a_joint_that_is_turned_round_is_turned_back():
    model, coefficients, m = case(3, 12, seed=4)
    pricing = cone(model, coefficients, m)
    best = beam(m, pricing, width=None, initial=3)
    turned = np.where(m.joint == 1, -best.signs, best.signs)
    start = pricing.prepared(m.hessian.total()).solve(turned @ m.gradient)
    wrong = replace(best, signs=turned, theta=start.theta, cost=start.cost + m.energy.sum())
    assert wrong.cost > best.cost * 1.01
    found = turn_joints(m, pricing, wrong)
    assert np.array_equal(found.signs, best.signs)
    assert found.cost == pytest.approx(best.cost, rel=1e-4)


def test_what_an_earlier_search_found_is_not_lost():
    model, coefficients, m = case(2, 10, seed=9, known=(3,))
    pricing = cone(model, coefficients, m)
    best = beam(m, pricing, width=None, initial=3)
    wrong = replace(best, signs=np.where(m.known != 0, m.known, -best.signs), cost=best.cost * 2.0)
    kept = keep_incumbent(m, pricing, wrong, coefficients.project(best.theta))
    assert kept.cost <= best.cost * (1 + 1e-4)
    assert kept.signs[3] == 1
    same = keep_incumbent(m, pricing, best, -coefficients.project(best.theta))
    assert np.array_equal(same.signs, best.signs)


def test_pruned_nodes_change_nothing():
    """A beam that solves every node finds the same signs as one that skips those whose bound is too high."""
    model, coefficients, m = case(2, 10, seed=9)
    lazy = beam(m, cone(model, coefficients, m), width=4)
    solver = cone(model, coefficients, m)
    order = np.argsort(-m.energy, kind="stable")
    level = [((), 0.0)]
    for depth in range(5, 11):
        used = order[:depth]
        prepared = solver.prepared(m.hessian[used].sum(axis=0))
        choices = [c for c, _ in level]
        tails = itertools.product((1, -1), repeat=5 if depth == 5 else 1)
        children = [c + tail for tail in tails for c in choices]
        priced = [(c, prepared.solve(np.array(c) @ m.gradient[used]).cost) for c in children]
        level = sorted(priced, key=lambda node: node[1])[:4]
    eager = np.zeros(10, dtype=int)
    eager[order] = level[0][0]
    assert np.array_equal(lazy.signs, eager)
    assert lazy.solves < 32 + 8 * 5


@pytest.mark.parametrize("own", [1, 3])
def test_a_beam_on_shared_parts_signs_every_segment(own):
    problem = synthetic(3, 9, joints=2, cone="body", noise=0.1, longest=12, known=2, scale=3.0)
    solver = problem.solver()
    found = beam(problem.moments.compact(own), solver, width=None)
    known = problem.moments.known
    assert set(found.signs) <= {-1, 1}
    assert np.all(found.signs[known != 0] == known[known != 0])
    assert found.cost == pytest.approx(problem.price(found.signs), abs=1e-5 * problem.energy)
    assert found.cost == pytest.approx(problem.least, abs=1e-4 * problem.energy), "with so little noise it is right"


@pytest.mark.parametrize("cone", ["free", "orthant", "body"])
def test_an_unlimited_beam_finds_the_least_cost_in_every_cone(cone):
    for seed in range(5):
        problem = synthetic(seed, 7, joints=2, cone=cone, noise=0.5, longest=8, known=seed % 2)
        found = beam(problem.moments, problem.solver(), width=None)
        assert found.cost == pytest.approx(problem.least, abs=1e-5 * problem.energy)
        assert problem.price(found.signs) <= problem.least + 1e-5 * problem.energy


# ---------------------------------------------------------------------------------------------------------------
# What survives
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_the_leaves_of_an_unlimited_beam_are_all_assignments_that_matter(seed):
    problem = synthetic(seed, 7, joints=2, cone="body", noise=0.8, longest=8, known=1)
    problem = problem.but(problem.moments.scaled(np.full(2, 16.0)))
    found = beam(problem.moments, problem.solver(), width=None)
    near = problem.costs <= problem.least + 2.0 * np.log(1e3)
    doubt = np.abs(problem.costs - problem.least - 2.0 * np.log(1e3)) < 1e-4 * problem.energy
    listed = {tuple(branch.signs.tolist()): branch.cost for branch in found.branches}
    expected = {tuple(signs.tolist()) for signs in problem.assignments[near & ~doubt]}
    assert expected <= set(listed) <= {tuple(signs.tolist()) for signs in problem.assignments[near | doubt]}
    assert len(expected) > 1, "or the case shows nothing"
    for signs, cost in zip(problem.assignments, problem.costs, strict=True):
        if tuple(signs.tolist()) in listed:
            assert listed[tuple(signs.tolist())] == pytest.approx(cost, abs=1e-5 * problem.energy)
    assert [branch.cost for branch in found.branches] == sorted(listed.values())
    np.testing.assert_array_equal(found.branches[0].signs, found.signs)
    signs = np.array(sorted(listed))
    assert np.all(found.decided[:, np.ptp(signs, axis=0) > 0]), "what tells leaves apart is decided"
    assert found.settled is None
    assert not found.certified
    assert found.missed == np.inf


def test_every_node_was_pruned_one_way_or_survived():
    problem = synthetic(11, 10, joints=2, cone="body", noise=0.6, longest=8)
    found = beam(problem.moments, problem.solver(), width=3, initial=4)
    pruning = found.pruning
    assert pruning.grown == found.nodes == 2**4 + 6 * (2 * 3)
    assert pruning.grown == pruning.by_bound + pruning.by_cone + pruning.survived
    assert pruning.survived == 3 * 7
    assert pruning.by_cone == found.solves - pruning.survived
    assert pruning.leaves == 3 >= len(found.branches)
    twice = found.with_work_of([found])
    assert twice.nodes == twice.pruning.grown == 2 * found.nodes
    assert twice.pruning.leaves == 3


def test_a_leaf_that_was_beaten_by_turning_a_joint_stays_a_branch():
    """The incumbent is none of the leaves then: it is listed with them."""
    model, coefficients, m = case(3, 12, seed=4)
    found = Beam(width=4).find(SignProblem(m.scaled(np.full(3, 8.0)), model.cone, coefficients))
    signs = [branch.signs.tolist() for branch in found.branches]
    assert found.signs.tolist() == signs[0]
    assert len({tuple(row) for row in signs}) == len(signs)
    assert all(branch.cost >= found.cost - 1e-9 for branch in found.branches)
