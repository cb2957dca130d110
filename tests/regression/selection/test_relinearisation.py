"""A distortion's own number: Newton's steps end where brute force does."""

from dataclasses import replace

import numpy as np
import pytest
from completion_problems import BASE, LAG, identified, log_with

from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.delay import Delay
from bayesid.log.segments import Cutting, find_segments
from bayesid.log.signals import prepare
from bayesid.regression.selection.products import Products
from bayesid.regression.selection.scores import plain_errors
from bayesid.regression.selection.wanted import SignedLog
from bayesid.signs.search.certified import Certified
from bayesid.signs.settling import settle_signs


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


def test_distortions_are_linearised_anew_where_what_was_found_changes_the_effort():
    """Not where nothing was found; all of them where the efforts that they distort are half as large by now."""
    signals = prepare(log_with(signed=True))
    segments = find_segments(signals, BASE.robot.actuators(signals.motion), Cutting())
    settled = settle_signs(BASE, signals, segments, Certified(budget=2.0))
    log = SignedLog.of(settled.evidence, settled.fit, settled.probability)
    lags = log.made([Delay(lag=(0.01,)), Delay(lag=(0.03,))])
    products = Products(log.data, lags, plain_errors(log.data))
    assert log.sharpened(products, []) == {}
    halved = replace(log, fit=replace(log.fit, predicted=2.0 * log.fit.predicted))
    assert set(halved.sharpened(products, [])) == {id(one) for one in lags}
