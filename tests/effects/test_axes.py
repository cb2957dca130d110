"""Functions of one variable: against an exact kernel, at the ends of the range, and their sums of variances."""

import numpy as np
import pytest

from bayesid.effects.axes import Axis, Family, Quantity

POSITION, VELOCITY = Quantity.POSITION, Quantity.VELOCITY


@pytest.mark.parametrize(("length", "count"), [(0.1, 14), (0.2, 8)])
def test_smooth_functions_regress_as_the_exact_kernel_does(length, count):
    """Posterior mean and sd from 25 noisy values, in the range: that of a squared exponential kernel.

    Of one that is longer than the margin at the ends of the range, the cosines end too flat.
    """
    low, high, noise = -0.7, 1.9, 0.1
    axis = Axis(POSITION, 4, Family.SMOOTH, low, high, 0.0, count)
    rng = np.random.default_rng(3)
    x, asked = np.sort(rng.uniform(low, high, 25)), np.linspace(low, high, 40)
    y = np.sin(3.0 * x) + 0.3 * x + noise * rng.standard_normal(25)

    def kernel(a, b):
        return np.exp(-0.5 * (np.subtract.outer(a, b) / (length * (high - low))) ** 2)

    inner = np.linalg.inv(kernel(x, x) + noise**2 * np.eye(25))
    mean = kernel(asked, x) @ inner @ y
    sd = np.sqrt(np.diag(kernel(asked, asked) - kernel(asked, x) @ inner @ kernel(x, asked)))
    basis, at = axis.columns(x), axis.columns(asked)
    covariance = np.linalg.inv(basis.T @ basis / noise**2 + np.diag(1.0 / axis.density(length)))
    found = at @ covariance @ basis.T @ y / noise**2
    np.testing.assert_allclose(found, mean, atol=0.04)
    np.testing.assert_allclose(np.sqrt(np.sum((at @ covariance) * at, axis=1)), sd, atol=0.04)


@pytest.mark.parametrize(
    "axis",
    [
        Axis(POSITION, 2, Family.SMOOTH, -0.4, 1.1, 0.0, 6),
        Axis(VELOCITY, 2, Family.POWER, -0.4, 1.1, 1.0, 3),
        Axis(VELOCITY, 2, Family.POWER, -0.4, 1.1, 0.0, 2),
        Axis(VELOCITY, 2, Family.ODD, -0.4, 1.1, 2.0, 1),
        Axis(VELOCITY, 2, Family.EVEN, -0.4, 1.1, 1.0, 1),
    ],
)
def test_nothing_explodes_beyond_the_range_seen(axis):
    reach = 0.0 if axis.count > 2 else 0.75  # half of the range
    ends = axis.columns(np.array([-0.4 - reach, 1.1 + reach]))
    np.testing.assert_allclose(axis.columns(np.array([-50.0, 1e6])), ends, rtol=1e-14)
    inner = axis.columns(np.array([-0.2, 0.3]))
    assert not np.allclose(inner, ends)


def test_variances_add_up_to_one():
    for axis in (
        Axis(POSITION, 1, Family.SMOOTH, 0.0, 2.0, 0.0, 9),
        Axis(POSITION, 1, Family.PERIODIC, 0.0, 2.0, 2.0, 7),
        Axis(POSITION, 1, Family.POWER, 0.0, 2.0, 0.0, 3),
    ):
        assert axis.density(0.3).sum() == pytest.approx(1.0)
    slow, fast = (Axis(POSITION, 1, Family.SMOOTH, 0.0, 2.0, 0.0, 9).density(length)[5:].sum() for length in (0.8, 0.1))
    assert slow < 1e-4 < 0.1 < fast
