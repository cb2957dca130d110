import numpy as np
import pytest
from posterior_problems import disc
from scipy import stats

from bayesid.effects.parameters import Cone
from bayesid.posterior.feasible_set import Brackets, FeasibleSet, draw_on_line
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS, from_pseudo_inertia


def bodies(rng, count, shift):
    factor = rng.standard_normal((count, 4, 4))
    return from_pseudo_inertia(factor @ factor.swapaxes(1, 2) + shift * np.eye(4))


def test_region_contains_what_the_cone_contains(rng):
    cone = Cone.rigid_bodies(2) + Cone.orthant(2) + Cone.free(1)
    region = FeasibleSet.of(cone)
    actuators = rng.standard_normal((400, 3)) + np.array([1.0, 1.0, 0.0])
    theta = np.concatenate([bodies(rng, 400, -0.1), bodies(rng, 400, 0.5), actuators], axis=1)
    expected = [cone.contains(row) for row in theta]
    assert np.array_equal(region.contains(theta.T), expected)
    assert 10 < sum(expected) < 390


def test_excess_is_what_relaxing_needs(rng):
    region, inner = disc(), np.array([0.1, 0.2])
    theta = 3.0 * rng.standard_normal((2, 500))
    excess = region.excess(theta, inner)
    assert np.array_equal(excess < 0.0, region.contains(theta))
    for k in np.flatnonzero(excess > 0.0)[:20]:
        assert region.relaxed(excess[k] * 1.001, inner).contains(theta[:, [k]])[0]
        assert not region.relaxed(excess[k] * 0.999, inner).contains(theta[:, [k]])[0]


def between(low, high, at, many=20_000):
    """Brackets of a normal distribution of mean 0.3 and sd 1.2, seen from a place between two bounds."""
    ones = np.ones(many)
    return Brackets.of((low - at) * ones, (high - at) * ones, (0.3 - at) / 1.44 * ones, ones / 1.44)


@pytest.mark.parametrize(
    ("low", "high", "share"),
    [(-1.0, 0.5, 0.6), (3.0, np.inf, 0.01), (-np.inf, -8.0, 0.6), (20.0, 21.0, 0.01), (-0.1, 30.0, 0.6)],
)
def test_a_normal_distribution_between_two_bounds(low, high, share):
    at = max(low, -9.0) + share * (min(high, 22.0) - max(low, -9.0))
    draws = at + between(low, high, at).draw(np.random.RandomState(0))[0]
    a, b = (low - 0.3) / 1.2, (high - 0.3) / 1.2
    assert stats.kstest(draws, stats.truncnorm(a, b, 0.3, 1.2).cdf).pvalue > 1e-3


def test_walkers_that_stay_leave_the_distribution(rng):
    """Uniform in an asymmetric corner of a two-dimensional cone before a step along a slanted line, and after it."""
    region = FeasibleSet.of(Cone.rigid_bodies(1))
    fixed, direction = bodies(rng, 1, 0.3).ravel(), rng.standard_normal(10)
    many, idle = 40_000, 0.5

    def at(t):
        return fixed[:, None] + direction[:, None] * t

    def step(t, slope, share, seed):
        line = region.slack(at(t)), region.matrices(at(t)), region.rows @ direction, region.entries @ direction
        return draw_on_line(*line, slope - 3.0 * t, np.full(many, 3.0), np.random.RandomState(seed), share)

    start = step(np.zeros(many), 2.0, 0.0, 1)
    moved = step(start, 2.0, idle, 2)
    assert 0.0 < np.mean(moved == 0.0) <= idle
    assert stats.ks_2samp(start, start + moved).pvalue > 1e-3
    assert np.std(start) > 0.0 < abs(stats.skew(start))


@pytest.mark.parametrize("slope", [4.0, -60.0])
def test_line_inside_the_cone_is_drawn_exactly(slope, rng):
    region = FeasibleSet.of(Cone.rigid_bodies(2))
    theta, direction = bodies(rng, 2, 0.01).ravel(), rng.standard_normal(20)
    many = 20_000
    start = np.repeat(theta[:, None], many, axis=1)
    t = draw_on_line(
        region.slack(start),
        region.matrices(start),
        region.rows @ direction,
        region.entries @ direction,
        np.full(many, slope),
        np.full(many, 0.5),
        np.random.RandomState(1),
    )
    # the chord by generalised eigenvalues
    low, high = -np.inf, np.inf
    for body in (slice(0, 10), slice(10, 20)):
        p, d = (np.einsum("k,kij->ij", v[body], PSEUDO_INERTIA_BASIS) for v in (theta, direction))
        root = np.linalg.inv(np.linalg.cholesky(p))
        values = np.linalg.eigvalsh(root @ d @ root.T)
        low, high = max(low, -1.0 / values[-1]), min(high, -1.0 / values[0])
    mean, sd = slope / 0.5, 1.0 / np.sqrt(0.5)
    exact = stats.truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)
    assert stats.kstest(t, exact.cdf).pvalue > 1e-3


@pytest.mark.parametrize("at", [-5.0, 60.0])
def test_a_bracket_cut_off_at_a_try_is_that_interval(at):
    brackets = between(-np.inf, np.inf, at)
    tries, log_share = brackets.draw(np.random.RandomState(0))
    chosen = np.flatnonzero(tries * (at - 1.0) < 0.0)[1::2][:200]  # on one side; others are left out
    low, high = np.where(tries < 0.0, tries, -np.inf)[chosen], np.where(tries > 0.0, tries, np.inf)[chosen]
    expected = Brackets.of(low, high, (0.3 - at) / 1.44 * np.ones(len(low)), np.ones(len(low)) / 1.44)
    assert np.allclose(brackets.shortened(chosen, tries, log_share).values, expected.values, rtol=1e-9, atol=1e-300)
