"""Active edges: shares of draws at them against truncated normal distributions."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import truncnorm

from bayesid.effects.constraints import Constraints
from bayesid.posterior.edges import active_bounds, at_edges
from bayesid.posterior.target import Bound
from bayesid.posterior.tuning import TUNING

COUNT = 40_000
ONE, NONE = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)


def half(label, row, offset):
    return Constraints(("m1", "m2"), (label,), np.array([row]), np.array([offset]), ONE, *nothing(), *no_rows())


def nothing():
    return np.empty((0, 2, 4, 4)), np.empty((0, 4, 4)), NONE


def no_rows():
    return np.empty((0, 2)), np.empty(0), NONE


def cut(at, rng):
    """Draws of N(0, 1) above an edge."""
    return truncnorm(at, np.inf).rvs(COUNT, random_state=rng)


def test_the_share_at_an_edge_is_that_of_a_cut_normal_whatever_the_unit():
    rng = np.random.default_rng(3)
    for at in (-3.0, -1.0, 0.7):
        first, other = 5.0 + 0.2 * cut(at, rng), rng.standard_normal(COUNT)
        stated = Constraints.joined([half("cut", [7.0, 0.0], -7.0 * (5.0 + 0.2 * at)), half("far", [0.0, -1.0], 9.0)])
        found = at_edges(stated, np.column_stack([first, other]))
        law = truncnorm(at, np.inf)
        exact = law.cdf(at + TUNING.at_edge * law.std())
        assert found["cut"] == pytest.approx(exact, abs=4.0 * np.sqrt(exact / COUNT))
        assert (found["cut"] > TUNING.active_constraint) == (at >= -1.0)
        assert found["far"] == 0.0


def test_the_distance_to_a_cone_is_along_its_boundary_normal():
    """|m1| <= 2 - m2 as a matrix, with m1 near zero and m2 near or far from its end."""
    rng = np.random.default_rng(4)
    basis = np.zeros((1, 2, 4, 4))
    basis[0, 0, 0, 3] = basis[0, 0, 3, 0] = 1.0
    basis[0, 1] = -np.eye(4)
    matrix = basis, 2.0 * np.eye(4)[None], ONE
    stated = Constraints(("m1", "m2"), ("cone",), *no_rows(), *matrix, *no_rows())
    small = 1e-4 * rng.standard_normal(COUNT)
    law = truncnorm(0.0, np.inf)
    active_bounds = np.column_stack([small, 2.0 - np.abs(small) - 0.3 * cut(0.0, rng)])
    exact = law.cdf(TUNING.at_edge * law.std())
    assert at_edges(stated, active_bounds)["cone"] == pytest.approx(exact, abs=4.0 * np.sqrt(exact / COUNT))
    assert at_edges(stated, active_bounds - [0.0, 2.0])["cone"] == 0.0


def test_a_window_behind_a_constraint_is_not_active():
    rng = np.random.default_rng(5)
    draws = np.column_stack([9.5 - 0.1 * cut(0.0, rng), np.zeros(COUNT)])
    window = Bound("mass of all links, from above", np.array([1.0, 0.0]), 0.0, np.zeros(2), 10.0)
    stated = half("m1 <= 9.5", [-1.0, 0.0], 9.5)
    for constraints, blamed in ((None, ["mass of all links, from above"]), (stated, [])):
        prior = SimpleNamespace(windows=(window,), stated=constraints)
        assert [name for name, _ in active_bounds(prior, draws)] == blamed
    nearer = SimpleNamespace(windows=(window,), stated=stated)
    assert active_bounds(nearer, draws + np.array([0.5, 0.0])), "its own edge presses too"
    assert at_edges(stated, draws)["m1 <= 9.5"] > TUNING.active_constraint
