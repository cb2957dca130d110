"""Motions of splines: their derivatives, their ends, and bounds that hold at every instant."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from bayesid.excitation.splines import DEGREE, ENDS, SplineBasis, SplineTrajectory

WIDE = (0.04, 0.09, 0.15, 0.14)
"""Largest excess of the bounds of positions, velocities, accelerations and jerks, over the range: as
`TUNING.pieces_per_interval` of `bayesid.excitation.tuning` states."""


def random_spline(duration, n, seed, scale=1.0):
    """Control points that are rough, smooth, or zero except one, each in a third of n joints."""
    rng, basis = np.random.default_rng(seed), SplineBasis(duration)
    rough = rng.normal(size=(len(basis), n // 3))
    smooth = np.cumsum(rng.normal(size=(len(basis), n // 3)), axis=0)
    single = np.zeros((len(basis), n // 3))
    single[rng.integers(ENDS, len(basis) - ENDS, n // 3), np.arange(n // 3)] = 1.0
    control = scale * np.hstack([rough, smooth, single])
    control[:ENDS], control[-ENDS:] = control[0], control[-1]
    return SplineTrajectory(basis, control)


@pytest.mark.parametrize("duration", [0.7, 3.1])
def test_derivatives_are_those_of_another_implementation_of_splines(duration):
    trajectory = random_spline(duration, 6, seed=1)
    basis, t = trajectory.basis, np.linspace(0.0, duration, 1237)[:-1]
    other = BSpline(basis.knots, trajectory.control, DEGREE)
    for order in range(4):
        want = (other.derivative(order) if order else other)(t)
        found = basis.values(t, order) @ trajectory.control
        np.testing.assert_allclose(found, want, atol=1e-11 * np.abs(want).max())
    motion = trajectory.motion(t)
    np.testing.assert_allclose(motion.dq, other.derivative(1)(t), atol=1e-11 * np.abs(motion.dq).max())
    np.testing.assert_allclose(motion.ddq, other.derivative(2)(t), atol=1e-11 * np.abs(motion.ddq).max())


@pytest.mark.parametrize("duration", [1.0, 9.0])
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_bounds_hold_at_every_instant_and_are_tight(duration, order):
    trajectory = random_spline(duration, 90, seed=3)
    values = trajectory.basis.values(np.linspace(0.0, duration, 20_001), order) @ trajectory.control
    least, largest = trajectory.bounds(order)
    span = np.ptp(values, axis=0)
    assert np.all(least <= values.min(axis=0) + 1e-12 * span)
    assert np.all(largest >= values.max(axis=0) - 1e-12 * span)
    beyond = np.maximum(values.min(axis=0) - least, largest - values.max(axis=0)) / span
    assert beyond.max() <= WIDE[order]
    assert beyond.max() >= 0.02 * WIDE[order]  # rough curves do turn round between two knots


def test_a_basis_function_is_the_uniform_spline_of_degree_five():
    """B(k) = 1, 26, 66, 26, 1 over 120 at the knots, and its derivatives by differences of lower degrees."""
    basis = SplineBasis(4.0)
    assert np.diff(np.unique(basis.knots)) == pytest.approx(0.25)
    control = np.zeros((len(basis), 1))
    control[8] = 1.0  # its knots are 0.75, 1.0 .. 2.25 s
    t = 1.0 + 0.25 * np.arange(5)
    want = (
        np.array([1, 26, 66, 26, 1]) / 120,
        np.array([1, 10, 0, -10, -1]) / 24 / 0.25,
        np.array([1, 2, -6, 2, 1]) / 6 / 0.25**2,
        np.array([1, -2, 0, 2, -1]) / 2 / 0.25**3,
    )
    for order, values in enumerate(want):
        np.testing.assert_allclose(basis.values(t, order) @ control[:, 0], values, atol=1e-10)
        assert not (basis.values(np.array([0.0, 0.74, 2.26, 4.0]), order) @ control).any()
