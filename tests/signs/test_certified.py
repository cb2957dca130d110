"""The certified search against brute force over all signs, each priced by itself (`sign_problems`)."""

from dataclasses import replace

import numpy as np
import pytest
from sign_problems import ROUNDING, SignProblem, arm, moments_of, strong, synthetic

from bayesid.effects.parameters import Cone
from bayesid.errors import SolverError
from bayesid.signs.search.certified import certified
from bayesid.signs.tuning import Tuning

FRICTION = ("viscous_friction", "coulomb_friction", "rotor_inertia")
ROBOT = ("rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia")
MISSED = (1e-3, 1e-9)


def solved(problem, budget=10.0, missed=1e-3, **options):
    return certified(problem.normal_equations, problem.solver(), budget, missed, **options)


def random_problems():
    """Sign problems of every kind: cones, joints, noise, sizes, and known signs all vary."""
    for cone, most in (("free", 8), ("orthant", 8), ("half", 8), ("body", 7)):
        for seed in range(45):
            rng = np.random.default_rng(seed)
            yield synthetic(
                seed,
                segments=int(rng.integers(1, most + 1)),
                joints=int(rng.integers(1, 4)),
                cone=cone,
                size=int(rng.integers(1, 8)),
                noise=(0.05, 0.3, 1.0)[seed % 3],
                spread=(1.0, 3.0, 10.0)[seed // 3 % 3],
                known=int(rng.integers(0, 2)),
                scale=(0.5, 3.0, 30.0)[seed // 9 % 3],
                load=(1.0, 1e-3)[seed % 5 == 4],
            )
    for seed in range(5):
        yield synthetic(seed, segments=10 + seed, joints=2, cone="free", size=6, noise=0.3, spread=3.0)
        yield synthetic(seed, segments=10, joints=3, cone="orthant", size=6, noise=0.3, scale=10.0)
    for seed in range(8):
        yield arm(seed, 4 + seed % 3, 1 + seed % 3, ("rigid_body",), (0.05, 0.3, 1.0)[seed % 3], seed % 2)
        yield arm(seed, 4 + seed % 3, 1 + seed % 3, ROBOT, (0.05, 0.3, 1.0)[seed % 3], seed % 2)
        yield arm(seed, 5 + seed % 5, 1 + seed % 3, FRICTION, (0.05, 0.3, 1.0)[seed % 3], seed % 3)
    for seed in range(3):
        yield arm(seed, 5, 3, ("rigid_body", "viscous_friction"), 0.5, 0, coupled=True)


@pytest.fixture(scope="module")
def results():
    """(problem, what the search found) of a few hundred problems; a test names those that fail by their position."""
    return [(problem, solved(problem, missed=MISSED[i % 2])) for i, problem in enumerate(random_problems())]


def failing(results, wrong):
    return [i for i, (problem, found) in enumerate(results) if wrong(problem, found)]


def within_delta(problem, found):
    """All assignments that cost clearly no more than Delta above the best."""
    return problem.assignments[problem.costs <= found.cost + found.optimality_gap - problem.exact]


def honest(problem, found):
    """The signs are possible and cost what is said, and the bounds hold."""
    row = np.flatnonzero(np.all(problem.assignments == found.signs, axis=1))
    assert len(row) == 1
    assert found.cost == pytest.approx(problem.costs[row[0]], abs=problem.exact)
    assert found.cost >= problem.least - problem.exact
    assert 0.0 <= found.lower_bound <= problem.least + problem.precision
    if found.certified:
        assert found.cost <= problem.least + 2 * problem.exact
        assert found.lower_bound >= found.cost - 1e-6 * problem.energy
    if found.persistent is not None:
        signs = within_delta(problem, found)
        assert np.all(signs[:, found.persistent] == found.signs[found.persistent])


def test_nearly_all_small_problems_are_certified_and_every_claim_holds(results):
    assert len(results) > 200
    assert len(failing(results, lambda problem, found: not found.certified)) <= 2
    for i, (problem, found) in enumerate(results):
        honest(problem, found)
        assert found.missed <= 1.001 * MISSED[i % 2]
    differs = failing(results, lambda problem, found: len(set(found.signs[problem.normal_equations.known == 0])) > 1)
    assert len(differs) > 100, "noise makes other signs the best than those of the problem, which are mostly +"
    agree = [np.all(within_delta(problem, found) == found.signs, axis=0).sum() for problem, found in results]
    assert sum(found.persistent.sum() for _, found in results) >= 0.9 * sum(agree) > 360, (
        "short of the truth, but not by much"
    )


def test_every_assignment_within_delta_belongs_to_a_branch(results):
    """It has the branch's signs wherever they are decided one by one."""

    def wrong(problem, found):
        decided, branches = strong(problem.normal_equations), np.array([branch.signs for branch in found.branches])
        signs = within_delta(problem, found)
        return not np.all(np.any(np.all((signs[:, None] == branches)[:, :, decided], axis=2), axis=1))

    assert failing(results, wrong) == []


def test_an_assignment_costs_at_least_the_bound_of_its_branch_or_delta(results):
    def wrong(problem, found):
        decided, branches = strong(problem.normal_equations), np.array([branch.signs for branch in found.branches])
        same = np.all((problem.assignments[:, None] == branches)[:, :, decided], axis=2)
        bounds = np.where(same, [branch.lower_bound for branch in found.branches], np.inf)
        bounds = np.minimum(bounds.min(axis=1), found.cost + found.optimality_gap)
        return np.any(problem.costs < bounds - problem.exact)

    assert failing(results, wrong) == []


def test_branches_are_sorted_and_cost_what_they_say(results):
    def wrong(problem, found):
        costs = np.array([branch.cost for branch in found.branches])
        priced = [problem.price(branch.signs) for branch in found.branches[:8]]
        close = np.abs(costs[:8] - priced) <= problem.exact
        bounded = [branch.lower_bound <= branch.cost + ROUNDING * problem.energy for branch in found.branches]
        return not (np.all(np.diff(costs) >= 0.0) and np.all(close) and np.all(bounded))

    assert failing(results, wrong) == []


def left_out_mass(problem, found):
    """Sum of exp(-(cost - best cost) / 2) over the assignments of the decided segments that no branch has."""
    decided = strong(problem.normal_equations)
    listed = {tuple(branch.signs[decided]) for branch in found.branches}
    least: dict[tuple, float] = {}
    for signs, cost in zip(map(tuple, problem.assignments[:, decided]), problem.costs, strict=True):
        least[signs] = min(cost, least.get(signs, np.inf))
    return sum(np.exp(-0.5 * (cost - found.cost)) for signs, cost in least.items() if signs not in listed)


def test_the_mass_left_out_is_bounded(results):
    def wrong(problem, found):
        return left_out_mass(problem, found) > found.missed * np.exp(problem.exact)

    assert failing(results, wrong) == []
    assert sum(left_out_mass(problem, found) > 0.0 for problem, found in results) > 50, "something must be left out"


FEW_ROWS = (
    (1054, {"segments": 8, "joints": 2, "size": 6, "noise": 0.3}),
    (1621, {"segments": 6, "joints": 2, "cone": "body", "size": 8, "noise": 1.0, "spread": 10.0}),
    (4498, {"segments": 6, "cone": "body", "size": 7, "noise": 0.3, "spread": 10.0, "scale": 10.0}),
    (4686, {"segments": 6, "cone": "half", "size": 8, "noise": 1.0, "spread": 10.0}),
    (12164, {"segments": 6, "joints": 2, "cone": "body", "size": 8, "noise": 0.3, "spread": 10.0, "scale": 100.0}),
    (15552, {"segments": 7, "cone": "half", "size": 7, "scale": 10.0}),
)


def test_parameters_that_few_rows_leave_open():
    """Weak segments then depend on each other, and combinations of strong ones split: none may get lost."""
    for seed, options in FEW_ROWS:
        problem = synthetic(seed, longest=2, **options)
        found = solved(problem)
        honest(problem, found)
        assert found.certified or found.uncertified_because == "tikhonov", (
            "rows so few that the data may cost nothing either way"
        )


def planted(seed, effort, cone="orthant", **options):
    """A synthetic problem with one more segment, whose efforts `effort` makes from its columns and the others' fit."""
    problem = synthetic(seed, cone=cone, **options)
    rng = np.random.default_rng(seed)
    beta = np.linalg.solve(problem.normal_equations.hessian.total(), problem.normal_equations.gradient.sum(axis=0))
    columns = rng.normal(size=(8, len(beta)))
    rows = (*problem.rows, (columns, effort(columns, beta)))
    joint, known = np.append(problem.normal_equations.joint, 0), np.append(problem.normal_equations.known, 0)
    return SignProblem(problem.cone, problem.coefficients, moments_of(rows, joint, known), rows)


def orthogonal(columns, beta):
    """Efforts that no coefficients explain: the segment's gradient is zero."""
    effort = np.sin(np.arange(len(columns)))
    return effort - columns @ np.linalg.lstsq(columns, effort, rcond=None)[0]


@pytest.mark.parametrize("cone", ["free", "orthant", "body"])
def test_a_sign_of_little_cost_is_right_or_undecided(cone):
    """A segment that is (nearly) orthogonal to the fit: both signs cost (nearly) the same."""
    for share in (0.0, 1e-12, 1e-8, 1e-4, 1e-2):
        problem = planted(4, lambda y, beta, share=share: orthogonal(y, beta) + share * (y @ beta), cone, noise=0.2)
        found = solved(problem)
        assert found.certified
        honest(problem, found)
        assert share or not found.persistent[-1]


def test_twelve_joints():
    """They share no coefficient, each has two of its own, nonnegative, so brute force goes joint by joint."""
    rng, each, best, signs, rows = np.random.default_rng(2), 4, 0.0, [], []
    empty = synthetic(2, 1, size=24, cone="free").coefficients
    for j in range(12):
        own = []
        for _ in range(each):
            columns = rng.normal(size=(6, 2)) + 1.0
            effort = columns @ np.linspace(0.5, 2.0, 24)[2 * j : 2 * j + 2]
            own.append((10.0 * columns, 10.0 * np.abs(effort + 0.3 * rng.normal(size=6))))
        names = empty.names[:2]
        two = replace(empty, names=names, expressions=names, units=names, selected=np.arange(2), projection=np.eye(2))
        joint = SignProblem(Cone.orthant(2), two, moments_of(own, [0] * each, [0] * each))
        best += joint.least
        signs.extend(joint.assignments[np.argmin(joint.costs)])
        rows += [(np.pad(y, ((0, 0), (2 * j, 22 - 2 * j))), e) for y, e in own]
    coefficients = replace(empty, projection=np.eye(24))
    m = moments_of(rows, np.repeat(np.arange(12), each), np.zeros(12 * each, dtype=np.int64))
    problem = SignProblem(Cone.orthant(24), coefficients, m)
    found = solved(problem)
    assert found.certified
    assert np.all(found.persistent), "the cone decides the sign of every joint"
    np.testing.assert_allclose(
        problem.pull[1], 0.0, atol=1e-12, err_msg="the Tikhonov term adds no cost of its own to a joint"
    )
    np.testing.assert_array_equal(found.signs, signs)
    assert found.cost == pytest.approx(best, abs=1e-6 * problem.energy)


def test_moments_of_many_weak_segments_share_their_hessian():
    """The proof decides only those that have a part of their own, and stays as right."""
    for seed in range(25):
        whole = synthetic(seed, 8, joints=2, cone="orthant", noise=(0.1, 0.5)[seed % 2], spread=10.0, scale=5.0)
        problem = whole.but(whole.normal_equations.compact(2))
        assert not np.all(problem.normal_equations.individual)
        found = solved(problem)
        assert found.lower_bound <= whole.least + whole.precision
        assert found.certified
        assert found.cost <= whole.least + 2 * whole.exact
        signs = within_delta(whole, found)
        assert np.all(signs[:, found.persistent] == found.signs[found.persistent])


POOR_CANDIDATES = Tuning(
    least_cost_share=1.0,
    candidate_patterns=1,
    candidate_combinations=1,
    candidates_solved=1,
    candidates_optimised=1,
    alternations=1,
)
"""Of a search whose first guess is mostly wrong, so that it is for the proof to find the best signs."""


def poor_cases():
    for seed in range(30):
        cone = ("free", "orthant", "half", "body")[seed % 4]
        yield synthetic(seed, 7, joints=3, cone=cone, size=5, noise=1.0, longest=3, scale=2.0, spread=2.0)


def test_the_proof_improves_on_the_first_candidate():
    missed = 0
    for problem in poor_cases():
        guess, found = (solved(problem, budget, tuning=POOR_CANDIDATES) for budget in (0.0, 10.0))
        assert (guess.certified, guess.missed) == (False, np.inf), "without any budget nothing is claimed"
        honest(problem, guess)
        honest(problem, found)
        assert found.certified
        missed += guess.cost > problem.least + 1e-3 * problem.energy
    assert missed >= 5, "or the proof had nothing to find"


def test_what_an_earlier_search_found_is_a_candidate():
    """With a zero budget, the parameters of the best signs give these signs."""
    better = 0
    for problem in poor_cases():
        best = solved(problem, tuning=POOR_CANDIDATES)
        guess, again = (solved(problem, 0.0, start=start, tuning=POOR_CANDIDATES) for start in (None, best.theta))
        assert again.cost <= best.cost + 2 * problem.exact
        better += again.cost < guess.cost - 1e-3 * problem.energy
    assert better >= 5


def test_wherever_the_budget_ends_only_what_is_proven_is_claimed():
    partly = 0
    for problem in list(poor_cases())[:6]:
        complete = solved(problem, tuning=POOR_CANDIDATES)
        assert complete.certified
        for budget in np.linspace(0.0, complete.spent, 15, endpoint=False):
            found = solved(problem, budget, tuning=POOR_CANDIDATES)
            honest(problem, found)
            partly += not found.certified and found.lower_bound > 0.0
    assert partly > 20, "some should end with a part of the proof"


def test_a_solver_that_fails_is_an_error_not_a_result():
    problem = synthetic(16, 4, cone="body")
    with pytest.raises(SolverError, match="cone least squares"):
        certified(problem.normal_equations, problem.solver(tolerance=1e-30))


def test_no_single_flip_improves_a_candidate():
    """Without a proof too: a weak segment may bias the parameters towards its own sign and look persistent."""
    for seed in range(40):
        problem = synthetic(seed, 8, cone=("orthant", "free")[seed % 2], size=6, noise=0.8, longest=3, spread=5.0)
        found = certified(problem.normal_equations, problem.solver(), budget=0.0)
        single = np.sum(problem.assignments != found.signs, axis=1) == 1
        assert found.cost <= problem.costs[single].min() + problem.precision + problem.exact
