"""Draws and integrals in the plane that equalities leave, against closed forms, quadrature and narrow intervals."""

from dataclasses import replace

import numpy as np
import pytest
from posterior_problems import disc, simulate, target_in, whole_space
from scipy import stats
from scipy.special import logsumexp

from bayesid.effects.constraints import Constraints
from bayesid.effects.parameters import Cone
from bayesid.effects.plane import Plane
from bayesid.posterior.feasible_set import FeasibleSet, barrier_minimum
from bayesid.posterior.modes import Normal, integrate, truncate
from bayesid.posterior.moves import Conditional
from bayesid.posterior.sampler import Sampling, sample
from bayesid.robot.inertia import from_pseudo_inertia

MANY = {"groups": 10, "walkers": 400}
EQUAL = np.array([[1.0, 0.0, -2.0, 0.0, 0.0], [0.0, 3.0, 1.0, 0.0, -1.0]])
VALUE = np.array([0.7, -0.4])


def correlated(rng, size):
    root = rng.standard_normal((size, size))
    precision = root @ root.T + 0.3 * np.eye(size)
    return Normal(precision, precision @ rng.standard_normal(size))


def test_draws_are_those_of_the_conditional_normal_distribution(rng):
    normal, plane = correlated(rng, 5), Plane.of(EQUAL, VALUE)
    region, covariance = replace(whole_space(5), within=plane), np.linalg.inv(normal.precision)
    mean = covariance @ normal.linear
    of_equal = EQUAL @ covariance @ EQUAL.T
    gain = covariance @ EQUAL.T @ np.linalg.inv(of_equal)
    mean, conditional = mean + gain @ (VALUE - EQUAL @ mean), covariance - gain @ EQUAL @ covariance
    centre = barrier_minimum(region, normal.precision, normal.linear, plane.origin)
    np.testing.assert_allclose(centre.theta, mean, atol=1e-9)
    start = np.tile(plane.origin, (20_000, 1))
    theta = normal.move(region, start, Conditional.of(region, centre.covariance), 2, np.random.RandomState(1))
    np.testing.assert_allclose(theta @ EQUAL.T, np.tile(VALUE, (len(theta), 1)), atol=1e-13)
    sd = np.sqrt(np.diag(conditional))
    assert np.all(np.abs(theta.mean(axis=0) - mean) < 4.0 * sd / np.sqrt(len(theta)))
    np.testing.assert_allclose(np.cov(theta.T), conditional, atol=0.03 * np.outer(sd, sd).max())


def test_mass_beside_an_edge_has_a_closed_form(rng):
    normal, plane, row = correlated(rng, 5), Plane.of(EQUAL, VALUE), np.array([0.2, 0.0, -1.0, 0.5, 0.3])
    covariance = np.linalg.inv(normal.precision)
    mean, of_equal = covariance @ normal.linear, EQUAL @ covariance @ EQUAL.T
    gain = covariance @ EQUAL.T @ np.linalg.inv(of_equal)
    middle = row @ (mean + gain @ (VALUE - EQUAL @ mean))
    sd = np.sqrt(row @ (covariance - gain @ EQUAL @ covariance) @ row)
    exact = normal.log_integral + stats.multivariate_normal.logpdf(VALUE, EQUAL @ mean, of_equal)
    exact += 0.5 * np.linalg.slogdet(EQUAL @ EQUAL.T)[1] + stats.norm.logcdf(-1.5)
    region = replace(whole_space(5), rows=row[None], offset=np.array([-middle - 1.5 * sd]), within=plane)
    inner = plane.nearest(plane.origin + 100.0 * plane.basis @ plane.basis.T @ row)
    theta, log_mass = truncate(region, normal, inner, np.random.RandomState(0), **MANY)
    assert abs(log_mass.mean() - exact) < max(4.0 * log_mass.std(ddof=1) / np.sqrt(10), 0.03)
    np.testing.assert_allclose(theta.reshape(-1, 5) @ EQUAL.T, np.tile(VALUE, (4000, 1)), atol=1e-12)


@pytest.mark.parametrize("row", [[1.0, 0.0], [1.0, 2.0]])
def test_posterior_on_a_line_through_a_disc_matches_quadrature(rng, row):
    plane, truth = Plane.of(np.array([row]), np.array([0.35])), np.array([0.3, 0.5])
    region = replace(disc(), within=plane)
    target = simulate(target_in(region, plane.origin), truth, np.zeros(1), rng, rows=20, segments=5)
    y, u = np.meshgrid(np.linspace(-1.5, 1.5, 3001), np.linspace(-1.2, 1.2, 61), indexing="ij")
    points = np.column_stack([plane.point(y.reshape(-1, 1)), u.ravel()])
    logs = target.log_density(points)
    exact = logsumexp(logs) + np.log(3.0 / 3000 * 2.4 / 60)
    weight = np.exp(logs - logsumexp(logs))
    mean, spread = weight @ points[:, 1], np.sqrt(weight @ (points[:, 1] - weight @ points[:, 1]) ** 2)
    draws = sample(target, truth, Sampling(walkers=32))
    assert draws.converged
    theta = draws.theta.reshape(-1, 2)
    assert np.abs(theta @ row - 0.35).max() < 1e-12
    assert abs(theta[:, 1].mean() - mean) < 0.12 * spread
    assert abs(theta[:, 1].std() - spread) < 0.1 * spread
    mass = integrate(target, draws, **MANY)
    assert abs(mass.log_value - exact) < max(4.0 * mass.standard_error, 0.06)


def test_an_equality_is_the_limit_of_an_interval_in_the_cone_of_a_body():
    names = tuple(f"p{k}" for k in range(10))
    row, none = np.zeros((1, 10)), np.zeros(0, dtype=np.int64)
    row[0, [9, 6]] = 1.0, -4.0  # a mass of 4 times the first moment, and some
    value, body, half = np.array([0.5]), from_pseudo_inertia(np.diag([0.3, 0.5, 0.8, 1.0])), 2e-4
    body[6] = 0.125
    no_rows, no_matrices = (np.empty((0, 10)), np.empty(0), none), (np.empty((0, 10, 4, 4)), np.empty((0, 4, 4)), none)
    zero = np.zeros(1, dtype=np.int64)
    equality = Constraints(names, ("e",), *no_rows, *no_matrices, row, value, zero)
    sides = np.concatenate([row, -row]), np.concatenate([half - value, half + value]), np.zeros(2, dtype=np.int64)
    interval = Constraints(names, ("i",), *sides, *no_matrices, *no_rows)
    normal, found = Normal(2.0 * np.eye(10), 2.0 * (body - 0.3)), []
    for stated in (equality, interval):
        region = FeasibleSet.of(replace(Cone.rigid_bodies(1), stated=stated))
        theta, log_mass = truncate(region, normal, body, np.random.RandomState(3), **MANY)
        found.append((theta.reshape(-1, 10), log_mass.mean(), log_mass.std(ddof=1) / np.sqrt(10)))
    (on, mass, error), (near, other, other_error) = found
    width = np.log(2.0 * half / np.linalg.norm(row))
    assert abs(mass - (other - width)) < max(4.0 * np.hypot(error, other_error), 0.05)
    sd = near.std(axis=0)
    np.testing.assert_allclose(on.mean(axis=0) / sd, near.mean(axis=0) / sd, atol=0.12)
    np.testing.assert_allclose(on.std(axis=0) / sd, 1.0, atol=0.1)
