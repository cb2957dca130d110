"""Errors of the table in the earlier log too, and thresholds."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.discrepancy.case import NoiseFloor
from bayesid.effects.catalogue import make_effect
from bayesid.effects.springs import JointSpring
from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection.added_effect import preexisting, was_there
from bayesid.regression.selection.columns import NO_COLUMNS, Columns, Whitening
from bayesid.regression.selection.fitted_effects import LN10, Observations, Thresholds
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.regression import explain
from bayesid.regression.selection.scores import Score

N, SD = 400, np.array([0.2, 3.0])


def data(residual):
    used = np.ones(residual.shape, dtype=bool)
    limits = np.stack([1.1 * SD, 0.3 * SD], axis=1)
    columns = np.zeros((N, 2, 1))
    columns[:, :, 0] = 1e-6
    return Observations(Whitening(columns, used), residual, InformationMatrix.none(1), SD, used[0], limits, 100.0)


def hypothesis(name, shape, rows):
    return Hypothesis(make_effect(name, shape), Columns(rows, {}, np.ones(1), np.zeros(1, dtype=bool)), lambda _: None)


def of_library():
    """An error of the table that acts most in joint 1 beside its noise, though less in N m; and a spring."""
    wave = np.sin(np.arange(N) / 7.0)[:, None]
    error = hypothesis("joint_zero", {"joints": [2], "error": [0.0]}, {0: wave, 1: 5.0 * wave})
    return [[error], [hypothesis("gain_error", {"joints": [1], "gain": [1.0]}, {0: wave})]]


@pytest.mark.parametrize(("above", "old"), [([1.0, 1.0], True), ([1.0, 2.0], True), ([2.0, 1.0], False)])
def test_error_of_the_table_is_new_where_it_shows_above_the_floor(above, old):
    residual = np.random.default_rng(1).standard_normal((N, 2)) * SD * above
    log = data(residual)
    without = explain(log, ())
    assert preexisting(without, of_library()) == ({("joint_zero", (2,))} if old else set())


def test_an_unreliable_floor_must_be_exceeded_by_more():
    residual = np.random.default_rng(2).standard_normal((N, 2)) * SD * [1.45, 1.0]
    for reliable, old in ((True, False), (False, True)):
        log = replace(data(residual), reliable=np.full(2, reliable))
        without = explain(log, ())
        assert bool(preexisting(without, of_library())) == old


@pytest.mark.parametrize(("moved", "there"), [(2.9, False), (3.2, True)])
def test_an_error_that_moves_the_earlier_coefficients_is_old(moved, there):
    """Three standard deviations are a likelihood ratio of 100 = exp(9.2 / 2), as an effect needs."""
    log = data(np.random.default_rng(4).standard_normal((N, 2)) * SD)
    log = replace(
        log, information=InformationMatrix(np.array([[4.0]]), np.array([8.0]), 16.0)
    )  # 2 with an sd of a half
    without = explain(log, ())
    at = replace(without, beta=np.array([2.0]))
    assert was_there(replace(without, beta=np.array([2.0 - 0.5 * moved])), at) == there
    assert not was_there(at, replace(without, beta=np.array([0.0])))


USUAL = Thresholds()


def test_a_joint_is_explained_by_the_threshold_of_its_floor():
    reliable, ones = np.array([True, False]), np.ones(2)
    floor = NoiseFloor(np.array([1.0, 2.0]), ("", ""), np.ones((2, 2)), reliable, ones, np.zeros(2, dtype=bool))
    assert floor.exceeded(np.array([1.3, 3.1])).tolist() == [True, False]
    assert floor.exceeded(np.array([1.2, 3.3])).tolist() == [False, True]


@pytest.mark.parametrize(
    ("gain", "improvement", "qualifies"), [(2.1, 0.06, True), (1.9, 0.06, False), (2.1, 0.04, False)]
)
def test_a_score_qualifies_by_certainty_and_size(gain, improvement, qualifies):
    score = Score(Hypothesis(JointSpring(joints=(2,)), NO_COLUMNS, None), gain * LN10, 9.0, improvement=improvement)
    assert score.qualifies(USUAL) == qualifies
    assert score.qualifies(Thresholds(log10_bayes_factor=1.8, improvement=0.03))
    assert not score.qualifies(Thresholds(log10_bayes_factor=2.2))
