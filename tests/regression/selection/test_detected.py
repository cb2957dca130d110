"""Effects that remain after the final fit: one number three standard deviations from zero is enough."""

import numpy as np
import pytest
from completion_problems import BASE

from bayesid.effects.catalogue import make_effect
from bayesid.regression.selection.detected import EnteredEffect, consistent_with_nothing

RIPPLE = make_effect("torque_ripple", {"joints": [2], "harmonic": [7.0]})
DELAY = make_effect("delay", {"lag": [0.02]})


def entered(source, **options):
    return EnteredEffect(source, 30.0, (), **options)


@pytest.mark.parametrize(
    ("values", "sds", "nothing"),
    [
        ((1.0, 2.9), (1.0, 1.0), True),
        ((-1.0, -3.1), (1.0, 1.0), False),
        ((4.0, 0.1), (2.0, 0.05), True),
        ((-6.2, 0.1), (2.0, 0.05), False),
        ((1.0, 50.0), (1.0, np.nan), True),
        ((1.0, 2.0), (np.nan, np.nan), False),
    ],
)
def test_an_effect_is_insignificant_if_no_number_is_three_sd_from_zero(values, sds, nothing):
    """A number without a standard deviation is skipped; an effect without any is not tested."""
    model = BASE.extend(RIPPLE)
    theta, sd = np.full(len(model.parameters), 100.0), np.full(len(model.parameters), 1.0)
    theta[-2:], sd[-2:] = values, sds
    assert consistent_with_nothing(entered(RIPPLE), model, theta, np.diag(sd**2)) == nothing


@pytest.mark.parametrize(("correlation", "nothing"), [(0.0, True), (0.9, True), (-0.9, False)])
def test_numbers_that_are_known_only_in_their_sum_count_together(correlation, nothing):
    """2 sd and 2.5 sd from zero: (z1^2 + z2^2 - 2 r z1 z2) / (1 - r^2) is 101.3 at r = -0.9; 11.83 is one in 370."""
    model = BASE.extend(RIPPLE)
    theta, covariance = np.ones(len(model.parameters)), np.eye(len(model.parameters))
    theta[-2:], covariance[-2:, -2:] = (2.0, 2.5), [[1.0, correlation], [correlation, 1.0]]
    assert consistent_with_nothing(entered(RIPPLE), model, theta, covariance) == nothing


def test_a_distortion_is_judged_by_its_own_numbers():
    model = BASE.extend(DELAY)
    theta, sd = np.ones(len(model.parameters)), 1e-6 * np.eye(len(model.parameters))
    assert consistent_with_nothing(entered(DELAY, number_sd=(0.007,)), model, theta, sd)
    assert not consistent_with_nothing(entered(DELAY, number_sd=(0.006,)), model, theta, sd)
