"""Lists of patterns against all 2^d of them, each bound against the least squares of the rows themselves."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from sign_problems import ROUNDING, synthetic

from bayesid.signs.search.patterns import join, log_sum
from bayesid.signs.search.problem import SearchProblem

ALL = 10**9


def never(_):
    """No budget ends."""


def prepared(seed, **options):
    """A sign problem and the search's view of it."""
    problem = synthetic(seed, **options)
    return problem, SearchProblem(problem.normal_equations, problem.solver(), np.inf)


def everything(bound):
    return np.arange(len(bound))


def least_squares(problem, segments, signs, share):
    """min over beta of the rows' squares under these signs and beta' share beta."""
    columns = [problem.rows[k][0] for k in segments] + [np.linalg.cholesky(share).T]
    efforts = [s * problem.rows[k][1] for k, s in zip(segments, signs, strict=True)] + [np.zeros(len(share))]
    y, e = np.vstack(columns), np.concatenate(efforts)
    return float(np.sum((y @ np.linalg.lstsq(y, e, rcond=None)[0] - e) ** 2))


def brute_force(problem, block, depth):
    """(2^depth, depth) patterns and their bounds."""
    m = problem.normal_equations
    known = np.flatnonzero((m.joint == m.joint[block.segments[0]]) & (m.known != 0))
    share = block.hessian(0) - m.hessian_of(known)
    patterns = np.array(list(itertools.product((1, -1), repeat=depth)))
    segments = np.concatenate([known, block.segments[:depth]])
    bounds = [least_squares(problem, segments, [*m.known[known], *pattern], share) for pattern in patterns]
    return patterns, np.array(bounds)


def as_dict(patterns):
    return {tuple(signs): bound for signs, bound in zip(patterns.signs.tolist(), patterns.bound, strict=True)}


@pytest.fixture(scope="module")
def priced():
    """(problem, a block, its patterns, their bounds): known segments or none, parameters that few rows leave open."""
    found = []
    for seed in range(12):
        problem, view = prepared(
            seed,
            segments=7,
            joints=1 + seed % 2,
            cone=("orthant", "body")[seed % 2],
            size=3 + seed % 4,
            longest=(2, 6)[seed % 2],
            known=seed % 3,
            noise=0.4,
            spread=(1.0, 5.0)[seed // 6],
        )
        block = max(view.blocks, key=lambda b: len(b.segments))
        found.append((problem, block, *brute_force(problem, block, len(block.segments))))
    return found


def test_a_list_without_limit_holds_all_patterns_and_their_bounds(priced):
    for problem, block, patterns, bounds in priced:
        found = block.within(np.inf, len(block.segments), ALL, never)
        listed = as_dict(found)
        assert len(found) == len(listed) == len(patterns)
        expected = [listed[tuple(pattern)] for pattern in patterns.tolist()]
        np.testing.assert_allclose(expected, bounds, rtol=0, atol=ROUNDING * problem.energy)
        assert found.log_missed == -np.inf
        assert found.segments.tolist() == block.segments.tolist()
        assert found.log_mass == pytest.approx(logsumexp(-0.5 * bounds), abs=1e-6)


def test_a_list_holds_the_patterns_up_to_its_limit_and_bounds_the_mass_of_the_others(priced):
    """At least the mass of the patterns that are missing; at most as if each of them were at the limit."""
    for problem, block, patterns, bounds in priced:
        ordered = np.sort(bounds)
        apart = np.flatnonzero(np.diff(ordered) > 1e-9 * problem.energy)  # a pattern and its opposite cost the same
        for share in (0.1, 0.5, 0.9):
            place = apart[int(share * (len(apart) - 1))]
            limit = 0.5 * (ordered[place] + ordered[place + 1])
            found = block.within(limit, len(block.segments), ALL, never)
            assert set(as_dict(found)) == {tuple(p) for p in patterns[bounds <= limit].tolist()}
            out = bounds[bounds > limit]
            assert logsumexp(-0.5 * out) - 1e-6 <= found.log_missed <= np.log(len(out)) - 0.5 * limit + 1e-6
            assert found.log_mass == pytest.approx(np.logaddexp(log_sum(found.bound), found.log_missed))


def test_groups_share_the_tikhonov_term_and_cost_no_more_than_the_whole():
    for seed in range(8):
        problem, view = prepared(seed, segments=9, joints=1, known=seed % 3, noise=0.5)
        (block,) = view.blocks
        assert block.groups(9) == [block]
        groups = block.groups(4)
        assert len(groups) > 1
        assert max(len(group.segments) for group in groups) <= 4
        np.testing.assert_array_equal(np.sort(np.concatenate([g.segments for g in groups])), np.sort(block.segments))
        assert all(group.segments[0] == block.segments[k] for k, group in enumerate(groups)), "strong ones in each"
        np.testing.assert_allclose(sum(g.hessian(len(g.segments)) for g in groups), block.hessian(len(block.segments)))
        whole = block.least(64, 10_000, lambda _: None, view.rounding)
        parts = [group.least(64, 10_000, lambda _: None, view.rounding) for group in groups]
        assert 0.0 < sum(parts) <= whole + view.rounding


def test_shares_of_the_tikhonov_term_add_up_to_less_than_half_of_it():
    """Half is what is left of rho once it is drawn to zero instead of to typical links; the rest is the slack."""
    for seed in range(6):
        problem, view = prepared(seed, segments=8, joints=3, cone="body", known=1, load=(1.0, 1e-3)[seed % 2])
        m = problem.normal_equations
        shares = sum(block.hessian(0) for block in view.blocks) - m.hessian_of(np.flatnonzero(m.known))
        pull, centre = problem.solver().tikhonov()
        left = np.linalg.eigvalsh(0.5 * pull - shares)
        assert left.min() >= -1e-12 * np.linalg.eigvalsh(pull).max()
        rng = np.random.default_rng(seed)
        betas = 10.0 ** rng.uniform(-2, 2, (50, 1)) * rng.normal(size=(50, len(centre)))
        for beta in [*betas, *(factor * centre for factor in (0.5, 1.0, 2.0, 3.0))]:
            drawn = (beta - centre) @ pull @ (beta - centre)
            assert beta @ shares @ beta - view.slack <= drawn * (1 + 1e-9)


def two_joints(seed, depth=3, **options):
    options = {"segments": 10, "size": 4, "noise": 0.5, "longest": 3, **options}
    problem = synthetic(seed, **options)
    joint = np.arange(len(problem.normal_equations)) % 2
    problem = replace(problem, normal_equations=replace(problem.normal_equations, joint=joint))
    view = SearchProblem(problem.normal_equations, problem.solver(), np.inf)
    left, right = view.blocks
    hessian = left.hessian(depth) + right.hessian(depth)
    energy = left.energy(depth) + right.energy(depth)
    return problem, view, hessian, energy


def pair_bounds(problem, view, depth):
    """Bounds of all pairs of patterns, by the signs of the left's segments and then of the right's."""
    m = problem.normal_equations
    known = np.flatnonzero(m.known)
    used = np.concatenate([known, *(block.segments[:depth] for block in view.blocks)])
    share = sum(block.hessian(0) for block in view.blocks) - m.hessian_of(known)
    choices = list(itertools.product((1, -1), repeat=2 * depth))
    return {signs: least_squares(problem, used, [*m.known[known], *signs], share) for signs in choices}


def test_a_join_prices_all_pairs():
    for seed, known in ((0, 0), (1, 2), (2, 0), (3, 1)):
        problem, view, hessian, energy = two_joints(seed, known=known)
        lists = [block.within(np.inf, 3, ALL, never) for block in view.blocks]
        joined = join(*lists, hessian, energy, everything)
        expected = pair_bounds(problem, view, 3)
        found = as_dict(joined)
        assert set(found) == set(expected)
        for signs, bound in expected.items():
            assert found[signs] == pytest.approx(bound, abs=ROUNDING * problem.energy)
        np.testing.assert_array_equal(joined.segments, np.concatenate([one.segments for one in lists]))
        assert joined.log_missed == -np.inf
        m = problem.normal_equations
        by_hand = m.known @ m.gradient + joined.signs @ m.gradient[joined.segments]
        np.testing.assert_allclose(joined.gradient, by_hand, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_join_keeps_the_pairs_up_to_a_limit_and_bounds_the_mass_of_the_others(seed):
    """Those left out by one of the lists, by the sum of two bounds, or by the bound of all rows together."""
    problem, view, hessian, energy = two_joints(seed)
    expected = pair_bounds(problem, view, 3)
    limit = float(np.quantile(list(expected.values()), 0.3))
    lists = []
    for block in view.blocks:
        _, bounds = brute_force(problem, block, 3)
        lists.append(block.within(float(np.quantile(bounds, 0.6)), 3, ALL, never))
    assert any(len(one) < 8 for one in lists)
    joined = join(*lists, hessian, energy, lambda bound: np.flatnonzero(bound <= limit), limit, pairs_at_once=11)
    kept = as_dict(joined)
    listed = {a + b for a in as_dict(lists[0]) for b in as_dict(lists[1])}
    assert set(kept) == {signs for signs in listed if expected[signs] <= limit}
    out = np.array([bound for signs, bound in expected.items() if signs not in kept])
    assert logsumexp(-0.5 * out) - 1e-6 <= joined.log_missed
    least = min(min(one.bound) for one in lists)
    assert joined.log_missed <= np.log(4 * len(out)) - 0.5 * least, "not absurdly above"


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    cone=st.sampled_from(["free", "orthant", "half", "body"]),
    size=st.integers(1, 7),
    joints=st.integers(1, 3),
    longest=st.sampled_from([1, 3, 8]),
    known=st.integers(0, 2),
    load=st.sampled_from([1.0, 1e-3]),
    data=st.data(),
)
def test_a_bound_never_exceeds_the_cost_of_any_completion(seed, cone, size, joints, longest, known, load, data):
    """In the cone, with all rows and rho: for each joint's patterns, their sums, and all joints together."""
    segments = 5 if cone == "body" else 6
    problem, view = prepared(
        seed, segments=segments, joints=joints, cone=cone, size=size, longest=longest, known=known, noise=0.5, load=load
    )
    depths = [data.draw(st.integers(0, len(block.segments))) for block in view.blocks]
    lists = [b.within(np.inf, depth, ALL, never) for b, depth in zip(view.blocks, depths, strict=True)]
    allowed = problem.costs + view.slack
    apart = np.zeros(len(problem.costs))
    for patterns in lists:
        bounds = as_dict(patterns)
        own = np.array([bounds[tuple(signs)] for signs in problem.assignments[:, patterns.segments].tolist()])
        assert np.all(own <= allowed)
        apart += own
    assert np.all(apart <= allowed)
    joined, hessian, energy = lists[0], view.blocks[0].hessian(depths[0]), view.blocks[0].energy(depths[0])
    for block, depth, patterns in zip(view.blocks[1:], depths[1:], lists[1:], strict=True):
        hessian, energy = hessian + block.hessian(depth), energy + block.energy(depth)
        joined = join(joined, patterns, hessian, energy, everything)
    together = as_dict(joined)
    bounds = np.array([together[tuple(signs)] for signs in problem.assignments[:, joined.segments].tolist()])
    assert np.all(bounds <= allowed)
    assert np.all(bounds >= apart - ROUNDING * problem.energy)
