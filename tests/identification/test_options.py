"""What a user may choose, as plain values, and searches of a user's own."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import pytest
from conftest import small_robot

import bayesid
from bayesid.fit.knowledge import Beliefs, Links
from bayesid.identification.options import Preparation, call_of, call_of_log, plain_options
from bayesid.log.log import read_log, write_log
from bayesid.log.segments import Cutting
from bayesid.model.catalogue import make_terms
from bayesid.model.model import Model
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, no_steps
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.result import SearchResult
from bayesid.simulation.logs import simulate, simulate_log
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TERMS = ("rigid_body", "viscous_friction")


# ---------------------------------------------------------------------------------------------------------------
# Plain values
# ---------------------------------------------------------------------------------------------------------------
def test_fields_of_an_option_stand_under_its_name():
    options = plain_options({"terms": ["rigid_body"], "search": Beam(width=3, initial_segments=2), "posterior": None})
    assert options == {
        "terms": ["rigid_body"],
        "search": "beam",
        "search.width": 3,
        "search.initial_segments": 2,
        "search.node_cost": None,
        "search.budget": 10.0,
        "search.repeatable": False,
        "posterior": None,
    }


def test_a_run_is_told_as_a_python_call(tmp_path):
    """What is usual is left out; a log that was read is read again with the same joints unsigned."""
    usual = {"search": Certified(), "posterior": True}
    assert call_of("identify", "'kr5'", "log", search=(Certified(), usual["search"])) == "bayesid.identify('kr5', log)"
    chosen = {"search": Certified(budget=2.5, fallback=Beam(width=7)), "posterior": Sampling(seed=3)}
    told = call_of("identify", "'kr5'", "log", **{name: (chosen[name], usual[name]) for name in usual})
    assert told == (
        "bayesid.identify('kr5', log, search=bayesid.Certified(budget=2.5, fallback=bayesid.Beam(width=7)), "
        "posterior=bayesid.Sampling(seed=3))"
    )
    repeated = eval(told.partition("search=")[2].partition(", posterior")[0])
    assert repeated == chosen["search"]
    log, _ = simulate_log(small_robot(2), 3.0, 50.0, 0.1, [], 1)
    assert call_of_log(log) == "log"
    path = tmp_path / "a log.csv"
    write_log(path, log)
    again = eval(call_of_log(replace(read_log(path), signed=np.array([False, True]))))
    np.testing.assert_array_equal(again.signed, [False, True])
    np.testing.assert_array_equal(again.q, read_log(path).q)


def test_options_within_options_stand_under_both_names():
    search = Certified(budget=2.5, fallback=Beam(width=7))
    options = plain_options({"search": search, "preparation": Preparation(cutting=Cutting(threshold=0.2))})
    assert options["search"] == "certified"
    assert options["search.budget"] == 2.5
    assert options["search.fallback"] == "beam"
    assert options["search.fallback.width"] == 7
    assert options["preparation.cutoff"] is None
    assert options["preparation.cutting.threshold"] == 0.2


def test_what_was_stated_beforehand_is_plain():
    options = plain_options({"beliefs": Beliefs(nominal={"m1": (2.0, 0.1)})})
    assert options["beliefs.nominal"] == {"m1": (2.0, 0.1)}
    assert options["beliefs.links"] is None
    assert plain_options({"beliefs": Beliefs(links=Links(mass=8.0))})["beliefs.links.mass"] == 8.0


@dataclass(frozen=True)
class Odd:
    price: Callable[[float], float] = abs
    weights: dict[str, object] = field(default_factory=lambda: {"a": np.ones(2)})


def test_what_json_cannot_hold_is_written_out():
    options = plain_options({"search": Odd(), "seed": Sampling(seed=4)})
    assert "abs" in options["search.price"]
    assert "array" in options["search.weights"]
    assert json.loads(json.dumps(options)) == options


# ---------------------------------------------------------------------------------------------------------------
# A search of a user's own
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Descent:
    """From random signs down to those that their coefficients predict, each joint turned too; the best, unproven."""

    seed: int = 3
    starts: int = 15
    any_model = False

    def find(self, problem, steps=no_steps):
        rng, prepared = np.random.default_rng(self.seed), problem.solver().prepared()
        settled = [self._settled(problem, rng.choice([-1, 1], len(problem.moments.known))) for _ in range(self.starts)]
        turns = np.array(list(product((1, -1), repeat=2)))
        signs = [each * turn[problem.moments.joint] for each in settled for turn in turns]
        solutions = [prepared.solve(each @ problem.moments.gradient) for each in signs]
        k = int(np.argmin([solution.cost for solution in solutions]))
        steps(self.starts, self.starts)
        return SearchResult(
            signs=signs[k],
            theta=solutions[k].theta,
            cost=problem.energy + solutions[k].cost,
            method="descent",
            width=None,
            certified=False,
            lower_bound=None,
            nodes=self.starts,
            solves=self.starts,
            tolerance=0.0,
            seconds=0.0,
        )

    def _settled(self, problem, signs):
        moments, inverse = problem.moments, np.linalg.pinv(problem.hessian)
        for _ in range(20):
            predicted = np.where(moments.gradient @ (inverse @ (signs @ moments.gradient)) >= 0.0, 1, -1)
            signs = np.where(moments.known != 0, moments.known, predicted)
        return signs

    def conclude(self, problem, progress=SILENT):
        return problem.earlier


@pytest.fixture(scope="module")
def robot():
    return small_robot(2, 1)


@pytest.fixture(scope="module")
def log(robot):
    motion = random_trajectory(2, 6.0, seed=3).motion(np.arange(301) / 50.0)
    model = Model(robot, make_terms(TERMS, robot, motion))
    theta = random_parameters(model, np.random.default_rng(2))
    return simulate(model, theta, motion, rng=np.random.default_rng(3), noise=0.02, signed=True)


def test_a_search_of_a_users_own_finds_the_signs_and_is_named(robot, log):
    result = bayesid.identify(robot, log.rectified(), TERMS, search=Descent(seed=5), posterior=False)
    options = result.provenance.options
    assert options["search"] == "descent"
    assert options["search.seed"] == 5
    assert options["search.starts"] == 15
    assert options["posterior"] is None
    assert result.search.method == "descent"
    assert not result.search.certified
    strong = np.abs(log.effort) >= 0.05 * np.abs(log.effort).max(axis=0)
    assert np.mean((result.sample_signs == np.sign(log.effort))[strong]) >= 0.99


def test_a_search_that_knows_one_model_only_gives_no_second_opinion(robot, log):
    result = bayesid.identify(robot, log.rectified(), ["rigid_body"], search=Descent(), posterior=False)
    assert result.sign_terms == ("rigid_body",)
    assert result.sign_weight == 1.0
    assert result.completion.effects == ()  # nor is the model completed
