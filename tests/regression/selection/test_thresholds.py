"""Thresholds are what is passed, not what a module holds."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.discrepancy.case import NoiseFloor
from bayesid.effects.joint_spring import JointSpring
from bayesid.regression.selection.columns import NO_COLUMNS
from bayesid.regression.selection.explanation import LN10, Thresholds
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.scores import Score

USUAL = Thresholds()


def test_a_joint_is_explained_by_the_threshold_of_its_floor():
    sharp, ones = np.array([True, False]), np.ones(2)
    floor = NoiseFloor(np.array([1.0, 2.0]), ("", ""), np.ones((2, 2)), sharp, ones, np.zeros(2, dtype=bool))
    gap = np.array([1.3, 3.1])
    assert floor.exceeded(gap, USUAL).tolist() == [True, False]
    assert floor.exceeded(gap, replace(USUAL, above_floor=1.4, above_blunt_floor=1.5)).tolist() == [False, True]


@pytest.mark.parametrize(
    ("gain", "improvement", "qualifies"), [(2.1, 0.06, True), (1.9, 0.06, False), (2.1, 0.04, False)]
)
def test_a_score_qualifies_by_certainty_and_size(gain, improvement, qualifies):
    score = Score(Hypothesis(JointSpring(joints=(2,)), NO_COLUMNS, None), gain * LN10, 9.0, improvement)
    assert score.qualifies(USUAL) == qualifies
    assert score.qualifies(Thresholds(log10_bayes_factor=1.8, improvement=0.03))
    assert not score.qualifies(Thresholds(log10_bayes_factor=2.2))
