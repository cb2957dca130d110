import time

import numpy as np
import pytest

import bayesid
from bayesid.excitation import random_trajectory
from bayesid.model import Model
from bayesid.robot import robot_from_table
from bayesid.simulation import random_parameters, simulate
from bayesid.terms import make_terms

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")


@pytest.fixture(scope="module")
def arm():
    joints = [
        {"a": 0.0, "alpha": np.pi / 2, "d": 0.4, "theta": 0.0}, {"a": 0.35, "alpha": 0.0, "d": 0.0, "theta": 0.0},
    ]  # fmt: skip
    return robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "arm")


@pytest.fixture(scope="module")
def log(arm):
    motion = random_trajectory(2, 8.0, seed=1).motion(np.arange(801) / 100.0)
    model = Model(arm, make_terms(TERMS, arm, motion))
    rng = np.random.default_rng(1)
    return simulate(model, random_parameters(model, rng), motion, rng=rng, noise=0.1)


@pytest.fixture
def hasty(monkeypatch):
    """A clock that advances by 100 s whenever it is looked at: every budget in seconds is over at once."""
    now = iter(range(0, 10**9, 100))
    return lambda: monkeypatch.setattr(time, "perf_counter", lambda: float(next(now)))


def numbers(result):
    found = {
        "cost": result.search.cost, "bound": result.search.lower_bound, "nodes": result.search.nodes,
        "solves": result.search.solves, "certified": result.search.certified, "signs": result.signs,
        "theta": result.theta, "covariance": result.covariance, "probability": result.probability,
    }  # fmt: skip
    if result.posterior is not None:
        found["draws"] = result.posterior.draws.theta
    return found


def same(one, other):
    return all(np.array_equal(one[name], other[name]) for name in one)


def test_a_repeatable_run_does_not_look_at_the_clock(arm, log, hasty):
    quiet = numbers(bayesid.identify(arm, log, TERMS, repeatable=True))
    assert quiet["certified"]
    hasty()
    assert same(quiet, numbers(bayesid.identify(arm, log, TERMS, repeatable=True)))
    cut_short = numbers(bayesid.identify(arm, log, TERMS))
    assert not cut_short["certified"]
    assert len(cut_short["draws"]) < len(quiet["draws"])


def test_its_budget_counts_work(arm, log):
    options = {"terms": TERMS, "posterior": False, "repeatable": True}
    little, again, much = (
        numbers(bayesid.identify(arm, log, search_budget=budget, **options)) for budget in (1e-3, 1e-3, 10.0)
    )
    assert same(little, again)
    assert much["certified"]
    assert not little["certified"]


def test_a_repeatable_discrepancy_does_not_look_at_the_clock(arm, log, hasty):
    poor = bayesid.identify(arm, log, ("rigid_body", "viscous_friction"), posterior=False, repeatable=True)

    def found():
        result = bayesid.find_discrepancy(poor, log, posterior=False, repeatable=True)
        return {**numbers(result.identification), "gain": [one.verdict.gain for one in result.found]}

    quiet = found()
    assert len(quiet["gain"])
    hasty()
    assert same(quiet, found())
