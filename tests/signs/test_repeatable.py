import time

import numpy as np
import pytest
from sign_problems import synthetic

import bayesid
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.posterior.sampler import Sampling
from bayesid.robot import robot_from_table
from bayesid.signs.search.certified import Certified, certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
NO_LIMIT = {"search": Certified(time_limit=np.inf), "posterior": Sampling(time_limit=np.inf)}


@pytest.fixture(scope="module")
def arm():
    joints = [{"a": 0.0, "alpha": np.pi / 2, "d": 0.4, "theta": 0.0}, {"a": 0.35, "alpha": 0.0, "d": 0.0, "theta": 0.0}]
    return robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "arm")


@pytest.fixture(scope="module")
def log(arm):
    return log_of(arm, 1)


def log_of(arm, seed):
    """Another motion and noise for each seed, of the same arm."""
    motion = random_trajectory(2, 8.0, rng=seed).motion(np.arange(801) / 100.0)
    model = Model(arm, make_terms(TERMS, arm, motion))
    theta = random_parameters(model, rng=np.random.default_rng(1))
    return simulate(model, theta, motion, rng=np.random.default_rng(seed + 10), noise=0.1)


@pytest.fixture
def hasty(monkeypatch):
    """A clock that advances by 100 s at each reading: every time limit is exceeded at once."""
    now = iter(range(0, 10**9, 100))
    return lambda: monkeypatch.setattr(time, "perf_counter", lambda: float(next(now)))


def numbers(result):
    found = {
        "cost": result.search.cost,
        "bound": result.search.lower_bound,
        "nodes": result.search.nodes,
        "solves": result.search.solves,
        "certified": result.search.certified,
        "signs": result.signs,
        "theta": result.theta,
        "covariance": result.covariance,
        "probability": result.probability,
    }
    if result.posterior is not None:
        found["draws"] = result.posterior.draws.theta
    return found


def same(first, second):
    return all(np.array_equal(first[name], second[name]) for name in first)


def test_a_result_does_not_depend_on_the_clock_before_its_time_limit(arm, log, hasty):
    quiet = bayesid.identify(arm, log, TERMS)
    assert quiet.search.certified
    assert not quiet.search.timed_out
    assert not quiet.posterior.timed_out
    hasty()
    assert same(numbers(quiet), numbers(bayesid.identify(arm, log, TERMS, **NO_LIMIT)))
    ended = bayesid.identify(arm, log, TERMS)
    assert not ended.search.certified
    assert ended.search.timed_out
    assert any("--time-limit" in warning for warning in ended.warnings)


def test_a_discrepancy_does_not_depend_on_the_clock(arm, log, hasty):
    terms = ("rigid_body", "viscous_friction")
    poor = bayesid.identify(arm, log, terms, complete="off", posterior=False)
    another = log_of(arm, 2)

    def found():
        result = bayesid.find_discrepancy(
            poor, another, search=Certified(budget=3.0, time_limit=np.inf), posterior=False
        )
        return {**numbers(result.identification), "gain": [effect.gain for effect in result.added]}

    quiet = found()
    assert len(quiet["gain"])
    hasty()
    assert same(quiet, found())


@pytest.fixture(scope="module")
def hard():
    """A sign problem that no proof closes so soon: 60 segments in the noise."""
    return synthetic(3, 60, joints=3, cone="orthant", size=6, noise=3.0)


def searched(problem, budget):
    found = certified(problem.normal_equations, problem.solver(), budget)
    return found, (found.cost, found.lower_bound, found.nodes, found.solves, found.signs.tolist(), found.theta.tolist())


def test_a_budget_that_is_larger_is_worth_more_work(hard):
    (_, nothing), (some, once), (_, twice), (more, _) = (searched(hard, b) for b in (0.0, 0.05, 0.05, 0.5))
    assert once == twice
    assert nothing[2] < some.nodes < more.nodes
    assert not some.certified
    assert more.lower_bound >= some.lower_bound
    assert more.cost <= some.cost + 1e-8 * hard.energy


@pytest.mark.parametrize("budget", [1e-9, 0.3])
def test_a_search_with_too_many_nodes_ends(hard, budget):
    """In CPU time, which a busy machine hardly changes; a slow one may take several times as long."""
    began = time.process_time()
    found, _ = searched(hard, budget)
    assert not found.certified
    assert time.process_time() - began < 10.0 * budget + 2.0
