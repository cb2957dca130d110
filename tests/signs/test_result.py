import numpy as np
import pytest

from bayesid.signs.search.result import UnconstrainedBound


def rows(seed, samples, size, lengths=1.0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(samples, size)) * lengths, rng.normal(size=(5, samples))


def test_the_bound_is_what_least_squares_leaves_unexplained():
    y, efforts = rows(0, samples=12, size=4)
    explained = UnconstrainedBound(y.T @ y)(efforts @ y)
    for effort, minimum in zip(efforts, explained, strict=True):
        beta = np.linalg.lstsq(y, effort, rcond=None)[0]
        assert effort @ effort + minimum == pytest.approx(np.sum((y @ beta - effort) ** 2), rel=1e-6)


def test_columns_that_no_row_shows_explain_nothing():
    """Fewer rows than coefficients, one column zero, two alike: the ridge stands in for what H lacks."""
    y, efforts = rows(3, samples=3, size=6, lengths=np.array([1.0, 0.0, 1e-3, 2.0, 2.0, 5.0]))
    y[:, 4] = y[:, 3]
    explained = UnconstrainedBound(y.T @ y)(efforts[:, :3] @ y)
    for effort, minimum in zip(efforts[:, :3], explained, strict=True):
        beta = np.linalg.lstsq(y, effort, rcond=None)[0]
        left = np.sum((y @ beta - effort) ** 2)
        assert left - 1e-9 * effort @ effort <= effort @ effort + minimum <= left + 1e-2 * effort @ effort


def test_a_curvature_of_its_own_needs_no_ridge():
    """A pull beside rows that show too little: the bound is the least of both together."""
    y, efforts = rows(4, samples=2, size=5)
    pull = 1e-6 * np.eye(5)
    explained = UnconstrainedBound(y.T @ y + pull, ridge=0.0)(efforts[:, :2] @ y)
    stacked = np.vstack([y, 1e-3 * np.eye(5)])
    for effort, minimum in zip(efforts[:, :2], explained, strict=True):
        target = np.concatenate([effort, np.zeros(5)])
        beta = np.linalg.lstsq(stacked, target, rcond=None)[0]
        assert effort @ effort + minimum == pytest.approx(np.sum((stacked @ beta - target) ** 2), abs=1e-9)
