"""Diagnostics of draws with known faults: equal numbers from every supported ArviZ."""

import arviz
import numpy as np
import pytest

from bayesid.posterior.sampler import diagnose


def alone(values):
    """(R-hat, bulk, tail) of draws (E, D): ensembles of one walker."""
    found = diagnose(np.asarray(values, dtype=float).T[:, :, None, None])
    return float(found.rhat[0]), float(found.bulk[0]), float(found.tail[0])


def waves(draws=200):
    """(4, D) ensembles that no generator of random numbers can change."""
    t = np.arange(draws)
    return np.array([np.sin((1.3 + 0.1 * e) * t * t) for e in range(4)])


# Of ArviZ 0.23.4; 1.3.0 gives the same.


@pytest.mark.parametrize(("sweeps", "kept"), [(4, 0.9), (6, 0.0), (12, -0.6), (25, 0.9), (60, 0.9)])
def test_the_same_as_arviz(sweeps, kept, rng):
    """Walkers of an autoregression; as they are, skewed, with many equal values, and an ensemble elsewhere."""
    draws = rng.standard_normal((sweeps, 3, 5, 4))
    for k in range(1, sweeps):
        draws[k] += kept * draws[k - 1]
    draws[..., 1] = np.exp(2.0 * draws[..., 1])
    draws[..., 2] = np.maximum(np.round(draws[..., 2]), 0.0)
    draws[:, 1, :, 3] += 2.0
    found = diagnose(draws)
    for k in range(4):
        walkers = draws[..., k].transpose(1, 2, 0).reshape(15, sweeps)
        expected = [arviz.ess(walkers, method="bulk")]
        expected.append(min(arviz.ess(walkers, method="quantile", prob=prob) for prob in (0.05, 0.95)))
        expected = np.minimum(expected, 15 * sweeps)
        assert [found.bulk[k], found.tail[k]] == pytest.approx(expected, rel=1e-12)
        if sweeps % 2 == 0:  # of an odd number ArviZ cuts the middle sweep in two
            ensembles = draws[..., k].transpose(1, 0, 2).reshape(3, -1)
            assert found.rhat[k] == pytest.approx(float(arviz.rhat(ensembles, method="rank")), rel=1e-12)


def test_a_constant_has_converged():
    assert alone(np.full((4, 50), 2.5)) == (1.0, 200.0, 200.0)


def test_draws_that_are_not_finite_do_not_converge():
    for value in (np.nan, np.inf):
        draws = waves()
        draws[2, 17] = value
        assert np.isnan(alone(draws)).all()
        assert not diagnose(draws.T[:, :, None, None]).passes(1e9, 0.0)


def test_one_ensemble_is_compared_with_itself(rng):
    draws = rng.standard_normal((40, 1, 8, 1))
    assert diagnose(draws).max_rhat < 1.05
    draws[20:] += 2.0
    assert diagnose(draws).max_rhat > 1.2
