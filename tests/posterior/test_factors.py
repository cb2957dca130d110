import numpy as np
import pytest

from bayesid.posterior.feasible_set import factor


def test_a_factor_in_mixed_units():
    """Twelve orders of magnitude, and nearly singular: a plain factorisation fails on what rounding leaves of some."""
    units, failed = np.geomspace(1e-9, 1e3, 8), 0
    for seed in range(40):
        rows = np.random.default_rng(seed).normal(size=(8, 8))
        rows[7] = rows[6] + 1e-8 * rows[7]
        rows /= np.linalg.norm(rows, axis=1)[:, None]
        scaled = rows @ rows.T
        matrix = scaled * np.outer(units, units)
        try:
            np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            failed += 1
        lower = factor(matrix)
        np.testing.assert_array_equal(lower, np.tril(lower))
        np.testing.assert_allclose(lower @ lower.T / np.outer(units, units), scaled, rtol=0, atol=1e-14)
    assert failed, "which seeds it fails on depends on the processor"


def test_a_singular_matrix_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        factor(np.array([[4.0, 3.0], [3.0, 2.0]]))
