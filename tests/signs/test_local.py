"""The local search against brute force over all signs, each priced by itself (`sign_problems`)."""

import numpy as np
import pytest
from sign_problems import ROUNDING, arm, synthetic

from bayesid.signs.search.local import local_search
from bayesid.signs.search.problem import SearchProblem

ROBOT = ("rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia")


def search(problem, signs, failures=60):
    inner = SearchProblem(problem.normal_equations, problem.solver(), np.inf)
    return inner, local_search(inner, [inner.local_optimum_from(signs)], failures)


def cases():
    for seed in range(4):
        yield arm(seed, 9, 3, ROBOT, 0.1, seed % 2)
        yield synthetic(seed, 10, joints=3, cone=("body", "orthant")[seed % 2], noise=0.2, longest=6)


def test_from_the_worst_signs_of_all_the_best_ones_are_found():
    """What is met costs what it says, and is no dearer than the start; known signs stay."""
    began_elsewhere = 0
    for problem in cases():
        worst = problem.assignments[int(np.argmax(problem.costs))]
        inner, found = search(problem, worst)
        began_elsewhere += inner.local_optimum_from(worst).cost > problem.least + 10 * problem.exact
        assert found.met[0].cost == pytest.approx(problem.least, abs=2 * problem.exact + ROUNDING * problem.energy)
        known = problem.normal_equations.known
        for branch in found.met:
            assert branch.cost == pytest.approx(problem.price(branch.signs), abs=1e-5 * problem.energy)
            assert np.all(branch.signs[known != 0] == known[known != 0])
        assert [branch.cost for branch in found.met] == sorted(branch.cost for branch in found.met)
    assert began_elsewhere > 3, "or the cases show nothing"


def test_it_ends_after_as_many_failures_as_were_asked_for_and_repeats_to_the_digit():
    problem = arm(3, 9, 3, ROBOT, 0.1)
    best = problem.assignments[int(np.argmin(problem.costs))]
    _, found = search(problem, best, failures=17)
    assert found.failed == found.starts == 17
    _, again = search(problem, best, failures=17)
    assert [branch.cost for branch in found.met] == [branch.cost for branch in again.met]
