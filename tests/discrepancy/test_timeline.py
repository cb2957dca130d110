import numpy as np
import pytest

from bayesid.discrepancy.timeline import holm, without_payload
from bayesid.discrepancy.tuning import TUNING


def test_holm_rejects_step_by_step():
    """As in textbooks: the smallest of m against level / m, the next against level / (m - 1), until one is accepted."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        p = rng.uniform(size=7) ** 4
        rejected, left = set(), list(np.argsort(p))
        while left and p[left[0]] < TUNING.level / len(left):
            rejected.add(int(left.pop(0)))
        assert set(np.flatnonzero(holm(p) < TUNING.level).tolist()) == rejected
    np.testing.assert_allclose(holm(np.array([0.03, 0.001, 0.4])), [0.06, 0.003, 0.4])


def problem(rng, m=14):
    """Columns of a body, and a covariance."""
    columns = np.zeros((m, 10))
    columns[:12] = rng.normal(size=(12, 10))
    root = rng.normal(size=(m, m)) * np.geomspace(0.1, 3.0, m)[:, None]
    return columns, root @ root.T / m


def test_a_payload_is_fitted_by_generalised_least_squares():
    rng = np.random.default_rng(1)
    columns, covariance = problem(rng)
    body = rng.normal(size=10)
    difference = columns @ body + np.linalg.cholesky(covariance) @ rng.normal(size=14)
    fit = without_payload(difference, covariance, columns)
    inverse = np.linalg.inv(covariance[:12, :12])
    information = columns[:12].T @ inverse @ columns[:12]
    best = np.linalg.solve(information, columns[:12].T @ inverse @ difference[:12])
    np.testing.assert_allclose(fit.of_payload, columns @ best, atol=1e-8)
    np.testing.assert_allclose(fit.change + fit.of_payload, difference)
    assert fit.mass == pytest.approx((best[9], np.sqrt(np.linalg.inv(information)[9, 9])))
