import numpy as np
import pytest

from bayesid.signs.search.bounds import UnconstrainedBound


def test_the_bound_is_what_least_squares_leaves_unexplained():
    """Of rows that show all coefficients, and of too few rows beside a pull, which needs no ridge."""
    for samples, pull, options in ((12, 0.0, {}), (2, 1e-3, {"ridge": 0.0})):
        rng = np.random.default_rng(samples)
        y, efforts = rng.normal(size=(samples, 4)), rng.normal(size=(5, samples))
        explained = UnconstrainedBound(y.T @ y + pull**2 * np.eye(4), **options)(efforts @ y)
        stacked = np.vstack([y, pull * np.eye(4)])
        for effort, minimum in zip(efforts, explained, strict=True):
            target = np.append(effort, np.zeros(4))
            left = np.sum((stacked @ np.linalg.lstsq(stacked, target, rcond=None)[0] - target) ** 2)
            assert effort @ effort + minimum == pytest.approx(left, rel=1e-6, abs=1e-9)


def test_columns_that_no_row_shows_explain_nothing():
    """Fewer rows than coefficients, one column zero, two alike: the ridge stands in for what H lacks."""
    rng = np.random.default_rng(3)
    y, effort = rng.normal(size=(3, 6)) * np.array([1.0, 0.0, 1e-3, 2.0, 2.0, 5.0]), rng.normal(size=3)
    y[:, 4] = y[:, 3]
    left = effort @ effort + UnconstrainedBound(y.T @ y)((effort @ y)[None])[0]
    exactly = np.sum((y @ np.linalg.lstsq(y, effort, rcond=None)[0] - effort) ** 2)
    assert exactly - 1e-9 * effort @ effort <= left <= exactly + 1e-2 * effort @ effort
