"""Algorithm 1 of the paper: its tree, node by node."""

import numpy as np
import pytest
from sign_problems import synthetic

from bayesid.signs.search.algorithm1 import algorithm1
from bayesid.signs.search.beam import beam
from bayesid.signs.search.protocol import SignProblem


def problem(seed=5, segments=9, **changes):
    made = synthetic(seed, segments, joints=2, cone="body", noise=0.5, longest=12, **changes)
    return SignProblem(made.normal_equations, made.cone, made.coefficients)


@pytest.fixture(scope="module")
def searched():
    return problem(), *algorithm1(problem(), width=3, initial=4)


def test_it_has_as_many_nodes_as_the_paper_says(searched):
    asked, result, nodes = searched
    assert len(nodes) == 2**4 + 2 * 3 * (len(asked.normal_equations) - 4) == result.nodes == result.solves
    assert [node.number for node in nodes] == list(range(1, len(nodes) + 1))
    assert [sum(node.depth == depth for node in nodes) for depth in (4, 5, 9)] == [16, 6, 6]


def test_children_follow_from_kept_parents_and_only_the_last_are_leaves(searched):
    asked, result, nodes = searched
    of = {node.number: node for node in nodes}
    for node in nodes:
        if node.parent:
            parent = of[node.parent]
            assert (parent.fate, parent.depth) == ("kept", node.depth - 1)
            assert node.ols_cost >= parent.ols_cost - 1e-6
        assert (node.fate == "leaf") <= (node.depth == len(asked.normal_equations))
        same_depth = [one for one in nodes if one.depth == node.depth]
        kept = [one for one in same_depth if one.fate in ("kept", "leaf")]
        assert len(kept) == 3
        if node not in kept:
            assert node.cone_cost >= max(one.cone_cost for one in kept)
            told = not node.feasible and node.ols_cost < max(one.cone_cost for one in kept)
            assert node.fate == ("pruned as infeasible" if told else "pruned by width")
    path, signs = min((one for one in nodes if one.fate == "leaf"), key=lambda one: one.cone_cost), {}
    while path:
        signs |= dict(zip(path.segments, path.signs, strict=True))
        path = of.get(path.parent)
    assert [signs[k] for k in range(len(signs))] == result.signs.tolist()


def test_feasible_estimates_cost_what_least_squares_does_and_infeasible_ones_more(searched):
    asked, _, nodes = searched
    assert {node.feasible for node in nodes} == {True, False}
    for node in nodes:
        price = (node.cone_cost - node.ols_cost) / asked.energy
        assert price > -1e-8
        if abs(node.min_eigenvalue) > 1e-2:
            assert (price < 1e-5) == node.feasible, node


def test_the_beam_ends_at_the_same_leaves_with_fewer_cone_problems(searched):
    asked, result, _ = searched
    same = beam(asked.normal_equations, asked.solver(), width=3, initial=4)
    assert np.array_equal(same.signs, result.signs)
    assert same.cost == pytest.approx(result.cost, rel=1e-5)
    assert (same.nodes, same.solves < result.solves) == (result.nodes, True)


def test_known_signs_are_the_root_and_all_may_be_enumerated():
    asked = problem(segments=5, known=2)
    known = asked.normal_equations.known
    unknown = int((known == 0).sum())
    result, nodes = algorithm1(asked, initial=9)
    assert len(nodes) == 2**unknown
    assert np.array_equal(result.signs[known != 0], known[known != 0])


def test_refused_nodes_are_pruned_and_the_cheapest_survives_if_all_are():
    asked = problem()
    _, nodes = algorithm1(asked, width=3, initial=4, refuse=lambda one: np.ones(len(one.margins), dtype=bool))
    assert len(nodes) == 2**4 + 2 * (len(asked.normal_equations) - 4)
    assert {node.fate for node in nodes} == {"kept", "leaf", "pruned as infeasible"}
    _, nodes = algorithm1(asked, width=3, initial=4, refuse=lambda one: one.margins < 0.0)
    for depth in {node.depth for node in nodes}:
        level = [node for node in nodes if node.depth == depth]
        if any(node.feasible for node in level):
            assert all(node.feasible for node in level if not node.fate.startswith("pruned"))
