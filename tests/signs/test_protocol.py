"""Search methods: refused options and results."""

from dataclasses import replace

import numpy as np
import pytest
from sign_problems import synthetic

from bayesid.errors import InputError
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search, SearchResult, SignProblem


def given(seed=3, **options):
    small = synthetic(seed, 6, joints=2, cone="orthant", noise=0.3, known=1, **options)
    return small, SignProblem(small.normal_equations, small.cone, small.coefficients)


class Wrong(Search):
    """All unknown signs are +."""

    def find(self, problem, steps=lambda done, total: None):
        signs = np.where(problem.normal_equations.known != 0, problem.normal_equations.known, 1)
        solution = problem.solver().prepared().solve(signs @ problem.normal_equations.gradient)
        return SearchResult(signs, solution.theta, problem.energy + solution.cost, "wrong", nodes=7, solves=1)


def test_invalid_search_options_are_refused():
    for make, field in (
        (lambda: Beam(width=0), "Beam.width"),
        (lambda: Beam(budget=np.nan), "Beam.budget"),
        (lambda: Beam(initial_segments=0), "Beam.initial_segments"),
        (lambda: Beam(initial_segments=13), "Beam.initial_segments"),
        (lambda: Certified(budget=-1.0), "Certified.budget"),
        (lambda: Certified(budget=np.nan), "Certified.budget"),
        (lambda: Certified(budget=np.inf), "Certified.budget"),
        (lambda: Certified(missed_mass=0.0), "missed_mass"),
        (lambda: Certified(missed_mass=1.0), "missed_mass"),
        (lambda: Certified(fallback=Beam(node_solver=lambda *_: None)), "node_cost"),
    ):
        with pytest.raises(InputError) as refusal:
            make()
        assert (refusal.value.field or refusal.value.where) == field


def test_certifying_never_raises_the_cost():
    small, problem = given()
    for search in (Certified(), Certified(fallback=Wrong(), budget=1e-9), Beam(), Beam(width=64)):
        result = search.find(problem)
        concluded = search.certify(replace(problem, earlier=result))
        assert concluded.cost <= result.cost + small.exact
        assert concluded.cost >= small.least - small.exact
        assert np.all(
            concluded.signs[small.normal_equations.known != 0]
            == small.normal_equations.known[small.normal_equations.known != 0]
        )


def test_a_complete_proof_needs_no_fallback():
    _, problem = given()
    search = Certified(fallback=Wrong())
    concluded = search.certify(replace(problem, earlier=search.find(problem)))
    assert concluded.certified
    assert [way.name for way in concluded.ways] == ["candidates", "branch and bound"]
    assert concluded.unlisted_probability == 0.0


def test_without_a_proof_the_cheaper_signs_are_taken():
    """A user's fallback is named; the proven bound is kept."""
    _, problem = given()
    search = Certified(fallback=Wrong(), budget=1e-9)
    concluded = search.certify(replace(problem, earlier=search.find(problem)))
    assert [way.name for way in concluded.ways][-3:] == ["local search", "wrong", "local search"]
    assert concluded.ways[-2].cost == Wrong().find(problem).cost > concluded.cost
    assert 0.0 < concluded.unlisted_probability < 0.01
    assert concluded.lower_bound is not None
    assert concluded.nodes > 7


def test_a_time_limit_ends_the_local_search_too_and_is_named():
    _, problem = given()
    search = Certified(fallback=Wrong(), budget=1e-9, time_limit=0.0)
    concluded = search.certify(replace(problem, earlier=search.find(problem)))
    assert [way.starts for way in concluded.ways if way.name == "local search"] == [0, 0]
    assert concluded.timed_out
    assert concluded.unlisted_probability == 0.5
