"""Nonlinear numbers between those of the library, on a friction whose Stribeck speed no list holds.

A distortion's own number: Newton's steps end where brute force does.
"""

from dataclasses import replace

import numpy as np
import pytest
from completion_problems import BASE, LAG, MOTION, THETA, TOP, identified, log_with

from bayesid.effects.catalogue import make_effect
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.drive import Delay
from bayesid.log.segments import Segmentation, find_segments
from bayesid.log.signals import prepare
from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection.columns import Whitening
from bayesid.regression.selection.detected import SignedLog
from bayesid.regression.selection.fitted_effects import Observations
from bayesid.regression.selection.hypotheses import hypotheses, maker
from bayesid.regression.selection.regression import Regression, plain_errors
from bayesid.regression.selection.scores import refined
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import find_signs

SPEED = 0.13
"""Of the highest; the list holds 0.1 and 0.17."""
SIZE = 6.0
"""N m."""


@pytest.fixture(scope="module")
def case():
    """Joint 2 of a log with known signs, and all hypotheses."""
    effect = make_effect("stribeck_friction", {"joints": [2], "smoothing": [0.01 * TOP[1]], "speed": [SPEED * TOP[1]]})
    effort = BASE.extend(effect).effort(MOTION, np.append(THETA, [0.0, SIZE]))
    effort += 0.05 * np.random.default_rng(3).standard_normal(effort.shape)
    columns = BASE.columns(MOTION)
    used = np.ones(effort.shape, dtype=bool)
    scene = BASE.scene(MOTION, THETA, BASE.effort(MOTION, THETA), np.abs(effort))
    nothing = InformationMatrix(np.eye(columns.shape[2]), THETA, float(THETA @ THETA))
    limits = np.full((2, 2), 0.05)
    data = Observations(
        Whitening(columns, used), effort, nothing, np.full(2, 0.05), np.ones(2, dtype=bool), limits, 50.0
    )
    return data, list(hypotheses(maker(BASE, scene, used), scene))


def form(library, name, **shape):
    forms = [h for group in library for h in group if h.source.name == name and h.joints == (2,)]
    return next(h for h in forms if all(getattr(h.source, key) == pytest.approx(v) for key, v in shape.items()))


@pytest.mark.parametrize("start", [0.1, 0.17])
def test_a_number_between_two_of_the_list_is_found(case, start):
    """The errors that the listed one leaves weigh the first look; those of what it found the second."""
    data, library = case
    first = refined(data, [form(library, "stribeck_friction", speed=(start * TOP[1],))], library)
    assert first[0].source.speed[0] / TOP[1] == pytest.approx(SPEED, rel=0.05)
    (found,) = refined(data, first, library)
    assert found.source.speed[0] / TOP[1] == pytest.approx(SPEED, rel=0.01)
    assert found.key == ("stribeck_friction", (2,))


def test_it_stays_between_its_neighbours(case):
    """From the largest of the list the true one is two steps away."""
    data, library = case
    (found,) = refined(data, [form(library, "stribeck_friction", speed=(0.3 * TOP[1],))], library)
    assert found.source.speed[0] / TOP[1] == pytest.approx(0.17, rel=0.05)
    assert found.source.speed[0] / TOP[1] > 0.17


def left_at(lag, result):
    """Weighted sum of squares of what the best coefficients leave, if the whole robot's efforts lag by so much."""
    model = replace(result.model, distortions=(Delay(lag=(lag,)),))
    used = result.signals.inner & (np.abs(result.signals.motion.dq) > 0.05)
    columns = model.columns(result.signals.motion)[:, :, base_coefficients(model).selected]
    weight = result.fit.noise.sigma
    rows, effort = (columns / weight[:, None])[used], (result.signals.raw_effort / weight)[used]
    rows = rows / np.linalg.norm(rows, axis=0)
    return float(np.sum((effort - rows @ np.linalg.lstsq(rows, effort, rcond=None)[0]) ** 2))


def test_the_lag_is_that_of_the_least_residual():
    """Signs known; to half a standard deviation, as samples weigh a little differently there."""
    result = identified("delay", signed=True)
    (entered,) = result.model_selection.effects
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
    segments = find_segments(signals, BASE.robot.actuators(signals.motion), Segmentation())
    solution = find_signs(BASE, signals, segments, Certified(budget=2.0))
    log = SignedLog.of(solution.log_data, solution.fit, solution.probability)
    lags = log.made([Delay(lag=(0.01,)), Delay(lag=(0.03,))])
    products = Regression(log.data, lags, plain_errors(log.data))
    assert log.sharpened(products, []) == {}
    halved = replace(log, fit=replace(log.fit, predicted=2.0 * log.fit.predicted))
    assert set(halved.sharpened(products, [])) == {id(one) for one in lags}
