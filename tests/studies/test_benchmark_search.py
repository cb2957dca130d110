"""The parts of the search's benchmark against closed forms and brute force."""

import itertools

import numpy as np
import pytest

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.studies.benchmarks.nodes_through_cvxpy import plain_node
from bayesid.studies.benchmarks.problems import Recorder, Searched
from bayesid.studies.benchmarks.scip import FORMULATIONS, NoCone, scip_installed, solve_with_scip, without_cone
from tests.conftest import small_robot, smooth_motion


@pytest.fixture(scope="module")
def searched() -> Searched:
    """Two joints with friction, five seconds."""
    robot, rng = small_robot(2), np.random.default_rng(0)
    motion = smooth_motion(2, 5.0, 100.0)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    log = simulate(model, random_parameters(model, rng=rng), motion, rng=rng)
    recorder = Recorder()
    return recorder.searched("arm", identify(robot, log, search=recorder))


def brute_force(cost, free):
    """The least cost of all signs, the first one that is known left as it is."""
    known = free.normal_equations.known
    return min(
        cost(np.where(known != 0, known, signs))
        for signs in map(np.array, itertools.product((1, -1), repeat=len(known)))
    )


class TestThroughCvxpy:
    def test_a_node_costs_what_the_fast_solver_says(self, searched):
        problem, rng = searched.problem, np.random.default_rng(1)
        node, solver, normal_equations = plain_node(problem), problem.solver(), problem.normal_equations
        order = np.argsort(-normal_equations.energy)
        for count in (2, len(order) // 2, len(order)):
            decided = order[:count]
            hessian, energy = normal_equations.hessian_of(decided), float(normal_equations.energy[decided].sum())
            gradient = rng.choice([-1.0, 1.0], count) @ normal_equations.gradient[decided]
            expected = energy + solver.prepared(hessian).solve_precisely(gradient).cost
            cost = node.cost(hessian, gradient, energy)
            assert cost == pytest.approx(expected, abs=3e-5 * problem.energy)  # cvxpy may end with an inaccurate 1e-5


class TestWithoutCone:
    def test_the_cost_is_that_of_the_best_coefficients(self, searched):
        problem = without_cone(searched.problem)
        signs = np.random.default_rng(2).choice([-1.0, 1.0], len(problem.normal_equations))
        hessian = problem.normal_equations.hessian.total()
        solver = NoCone(problem.tikhonov).prepared(hessian)
        gradient = signs @ problem.normal_equations.gradient
        solution = solver.solve(gradient)
        beta = np.linalg.solve(hessian + problem.tikhonov, gradient)
        expected = problem.normal_equations.cost(beta, signs) + beta @ problem.tikhonov @ beta
        np.testing.assert_allclose(solution.theta, beta, rtol=1e-6, atol=1e-9 * np.abs(beta).max())
        assert problem.energy + solution.cost == pytest.approx(expected, abs=1e-9 * problem.energy)
        assert problem.cost(signs) == pytest.approx(expected, abs=1e-9 * problem.energy)
        assert solution.lower_bound == solution.cost == solver.solve_precisely(gradient).cost

    @pytest.mark.skipif(not scip_installed(), reason="pyscipopt is not installed")
    @pytest.mark.parametrize("name", list(FORMULATIONS))
    def test_scip_finds_the_best_of_all_signs(self, searched, name):
        problem = without_cone(searched.problem.first(6))
        found = solve_with_scip(problem, FORMULATIONS[name], limit=10.0)
        best = brute_force(problem.cost, problem)
        assert found.proven
        assert found.cost == pytest.approx(best, abs=1e-6 * problem.energy)
        assert found.lower_bound == pytest.approx(best, abs=1e-5 * problem.energy)
