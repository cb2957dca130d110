"""Combinations of the joints' patterns, against the costs of all assignments."""

import numpy as np
import pytest
from scipy.special import logsumexp
from sign_problems import arm, moments_of, strong, synthetic

from bayesid.signs.search.combinations import TooManyError, combinations, least_costs
from bayesid.signs.search.problem import SearchProblem
from bayesid.signs.tuning import Tuning


class Combined:
    """The combinations of a small problem up to a limit, and the brute force to hold them to."""

    def __init__(self, problem, within, solver=None, **limits):
        self.problem = problem
        self.view = SearchProblem(problem.normal_equations, solver or problem.solver(), np.inf, tuning=Tuning(**limits))
        self.limit = problem.least + within
        self.found = combinations(self.view, self.limit, least_costs(self.view))
        self.decided = np.concatenate([np.flatnonzero(problem.normal_equations.known), self.found.patterns.segments])
        signs = problem.assignments[:, self.decided]
        self.least: dict[tuple, float] = {}
        for choice, cost in zip(map(tuple, signs.tolist()), problem.costs, strict=True):
            self.least[choice] = min(cost, self.least.get(choice, np.inf))
        known = problem.normal_equations.known[problem.normal_equations.known != 0]
        self.listed = [(*known.tolist(), *choice) for choice in self.found.patterns.signs.tolist()]

    def assert_sound(self):
        """All that can cost up to the limit is there; the bounds hold; what is missing is bounded."""
        exact = self.problem.exact
        assert len(set(self.listed)) == len(self.listed)
        inside = {choice for choice, cost in self.least.items() if cost <= self.limit - exact}
        assert inside <= set(self.listed)
        for choice, bound in zip(self.listed, self.found.lower, strict=True):
            assert bound <= self.least[choice] + exact
            assert bound <= self.limit
        missing = [cost for choice, cost in self.least.items() if choice not in set(self.listed)]
        if missing:
            assert logsumexp(-0.5 * np.array(missing)) <= self.found.log_missed + exact + 1e-6


def random_problems():
    for cone in ("free", "orthant", "half", "body"):
        for seed in range(12):
            rng = np.random.default_rng(seed)
            yield synthetic(
                seed,
                segments=int(rng.integers(3, 7 if cone == "body" else 9)),
                joints=int(rng.integers(1, 4)),
                cone=cone,
                size=int(rng.integers(2, 8)),
                noise=(0.1, 0.5, 1.0)[seed % 3],
                longest=(2, 6)[seed % 2],
                spread=(1.0, 2.0, 10.0)[seed // 4],
                known=int(rng.integers(0, 3)),
                scale=(1.0, 10.0)[seed % 2],
                load=(1.0, 1e-3)[seed % 4 == 3],
            )
    for seed in range(3):
        yield arm(seed, 5, 2, ("rigid_body", "viscous_friction"), 0.5)


@pytest.fixture(scope="module")
def problems():
    return list(random_problems())


@pytest.mark.parametrize(
    "options", [{}, {"few_combinations": 0}, {"listed": 2, "least_group": 2}], ids=["", "coarse to fine", "short lists"]
)
def test_nothing_that_may_cost_up_to_the_limit_is_left_out(problems, options):
    for k, problem in enumerate(problems):
        combined = Combined(problem, (1.0, 30.0, 1000.0)[k % (2 if options else 3)], **options)
        combined.assert_sound()
        assert options or set(np.flatnonzero(strong(problem.normal_equations))) == set(combined.decided)


def decided_by_the_cone(joint, costs=None):
    """The cone decides one segment, whose other sign costs so much; four others, half as strong, have no gradient."""
    rng = np.random.default_rng(6)
    columns = rng.normal(size=(5, 8, 3))
    target, effort = np.cos(np.arange(8)), columns[0] @ np.array([1.0, 2.0, 0.5])
    rows = [(columns[0], effort if costs is None else np.sqrt(costs) / np.linalg.norm(effort) * effort)]
    for y in columns[1:]:
        away = target - y @ np.linalg.lstsq(y, target, rcond=None)[0]
        rows.append((1e-4 * y, np.sqrt(0.5) * np.linalg.norm(rows[0][1]) / np.linalg.norm(away) * away))
    return Combined(synthetic(6, 2, size=3).but(moments_of(rows, joint, [0] * 5)), 1.0, few_combinations=0)


@pytest.mark.parametrize(("more", "coarse"), [(-0.2, 2), (0.2, 1)])
def test_a_coarse_level_excludes_what_all_completions_together_cost_more_than_the_limit(more, coarse):
    """Two joints; a coarse level leaves two segments open: four completions, so 2 log 4 above the limit of 1.

    Pairs priced: 8 by 4 of the whole lists, 2 by 4 of the coarse ones, 16 for each that is left; then 16 twice.
    """
    combined = decided_by_the_cone([0, 0, 0, 1, 1], 1.0 + 2.0 * np.log(4.0) + more)
    combined.assert_sound()
    assert combined.view.combined == 32 + 8 + 16 * coarse + 2 * 16


def test_what_a_coarse_level_excludes_counts_with_all_its_completions():
    """The 16 choices of the others' signs cost the same."""
    combined = decided_by_the_cone([0] * 5)
    assert len(combined.decided) == 5
    assert [choice[0] for choice in combined.listed] == [1] * 16
    combined.assert_sound()
    missing = np.array([cost for choice, cost in combined.least.items() if choice[0] == -1])
    assert combined.found.log_missed == pytest.approx(logsumexp(-0.5 * missing), abs=0.1), "and no more often"


def test_where_there_are_too_many_fewer_segments_are_decided():
    problem = synthetic(1, 9, joints=2, cone="orthant", noise=1.0, scale=0.5)
    whole = Combined(problem, 30.0)
    fewer = []
    for held in (200, 100, 50, 20):
        found = Combined(problem, 30.0, few_combinations=0, most_combinations=held)
        found.assert_sound()
        fewer.append(len(found.decided))
    assert fewer == sorted(fewer, reverse=True)
    assert 0 < fewer[-1] < len(whole.decided)
    with pytest.raises(TooManyError):
        Combined(problem, 30.0, few_combinations=0, most_combinations=0)
    short = Combined(problem, 30.0, longest_list=4)
    short.assert_sound()
    assert 0 < len(short.decided) < len(whole.decided)
