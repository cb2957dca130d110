"""The information of an earlier log, as a part of what is sampled."""

from dataclasses import replace

import numpy as np
import pytest
from posterior_logs import make_log
from posterior_problems import information_of

from bayesid.effects.parameters import Cone
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.target import make_prior
from bayesid.regression.knowledge import LinkPrior

PROJECTION = [[1.0, 0.0, 0.6, 0.0], [0.0, 1.0, -2.0, 0.0], [0.0, 0.0, 0.0, 1.5]]
THETA = (0.8, 0.3, -0.4, 0.9)


def two_logs():
    """Of the same four parameters, three coefficients and two joints; the earlier one's signs are all known."""
    common = {
        "joint": (0, 1, 0, 1, 0),
        "sigma": (0.7, 1.9),
        "time": (2.0, 1.3),
        "projection": PROJECTION,
        "cone": Cone.orthant(1) + Cone.free(3),
        "mean": (0.2, 0.0, 0.1, -0.3),
        "sd": (1.5, 1.0, 0.7, 2.0),
    }
    new = make_log(THETA, rows=(6, 9, 5, 7, 8), known=(1, 0, 0, 1, 0), seed=3, **common)
    earlier = make_log(
        THETA, rows=(12, 4, 9, 6, 15), known=(1,) * 5, sees=((1.0, 0.2, 0.0), (0.3, 1.0, 2.0)), seed=4, **common
    )
    return new, earlier


def information(log):
    """The information of a log of known signs, row by row, in units of its noise."""
    weights = [1.0 / (log.sigma[j] * np.sqrt(log.time[j])) for j in log.joint]
    columns = np.concatenate([w * y for w, (y, _) in zip(weights, log.rows, strict=True)])
    effort = np.concatenate([w * s * e for w, s, (_, e) in zip(weights, log.known, log.rows, strict=True)])
    return information_of(columns, effort)


def test_the_density_has_the_rows_of_both_logs_and_the_earlier_ones_keep_their_noise():
    new, earlier = two_logs()
    rng = np.random.default_rng(8)
    theta = rng.standard_normal((40, 4)) * 2.0
    theta[:, 0] = np.abs(theta[:, 0])
    log_scale = 0.6 * rng.standard_normal((40, 2))
    of_earlier = earlier.segment_logs(theta, np.zeros((40, 2)))[(1 - earlier.known) // 2, np.arange(5)].sum(axis=0)
    exact = new.log_density(theta, log_scale) + of_earlier
    target = replace(new.target, information=information(earlier))
    values = target.log_density(np.hstack([theta, log_scale]))
    assert np.allclose(np.diff(values), np.diff(exact), rtol=1e-10, atol=1e-9)
    assert np.abs(np.diff(of_earlier)).max() > 10.0
    outside = np.concatenate([theta[0] * np.array([-1.0, 1.0, 1.0, 1.0]), log_scale[0]])
    assert target.log_density(outside)[0] == -np.inf


def test_prior_sizes_of_hidden_parameters_come_from_the_earlier_log():
    new = make_log((1.0, 40.0, 0.3, 0.1), rows=(20, 20), known=(1, 1), sees=((1.0, 0.0, 0.0, 0.0),), sigma=(0.5,))
    likelihood = make_likelihood(new.normal_equations, new.coefficients, new.sigma, new.time, np.zeros(2, dtype=int))
    columns = np.zeros((4, 4))
    columns[:, :3] = [[0.0, 2.0, 0.0], [1e-3, -1.0, 0.0], [0.0, 0.0, 900.0], [0.0, 0.0, 100.0]]
    known = information_of(columns, columns @ np.array([0.0, 40.0, 0.3, 0.0]))

    def sd(information):
        return make_prior(new.cone, likelihood, LinkPrior(), information=information).sd

    without, both = sd(None), sd(known)
    assert np.array_equal(without[1:], np.ones(3))
    assert both[0] == without[0]  # the log shows it
    assert both[1] == pytest.approx(np.sqrt((5.0 * 40.0**2 + 820_000.0 * 0.3**2) / 5.0))  # explains all of the earlier
    assert both[1] > 40.0
    assert both[2] == 1.0  # 0.31 would explain it; never narrower than without
    assert both[3] == 1.0  # none has shown it
