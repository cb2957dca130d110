"""A distortion's own number: Newton's steps end where brute force does."""

from dataclasses import replace

import numpy as np
import pytest
from completion_problems import LAG, identified

from bayesid.model.coefficients import base_coefficients
from bayesid.model.distortions.delay import Delay


def left_at(lag, result):
    """Weighted sum of squares of what the best coefficients leave, if the whole robot's efforts lag by so much."""
    model = replace(result.model, distortions=(Delay(lag=(lag,)),))
    used = result.signals.inner & (np.abs(result.signals.motion.dq) > 0.05)
    columns = model.columns(result.signals.motion)[:, :, base_coefficients(model).kept]
    weight = result.fit.noise.sigma
    rows, effort = (columns / weight[:, None])[used], (result.signals.raw_effort / weight)[used]
    rows = rows / np.linalg.norm(rows, axis=0)
    return float(np.sum((effort - rows @ np.linalg.lstsq(rows, effort, rcond=None)[0]) ** 2))


def test_the_lag_is_that_of_the_least_residual():
    """Signs known; to half a standard deviation, as samples weigh a little differently there."""
    result = identified("delay", signed=True)
    (entered,) = result.completion.effects
    (sd,) = entered.number_sd
    lags = LAG + np.linspace(-0.004, 0.004, 33)
    squares = np.array([left_at(lag, result) for lag in lags])
    curve = np.polynomial.Polynomial.fit(lags, squares, 4)
    at = np.linspace(lags[0], lags[-1], 4001)
    best = at[np.argmin(curve(at))]
    assert entered.source.lag[0] == pytest.approx(best, abs=0.5 * sd)
    curvature = curve.deriv(2)(best)
    assert sd == pytest.approx(np.sqrt(2.0 / curvature), rel=0.3)
