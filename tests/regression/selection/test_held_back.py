"""Held-back errors: closed forms, and what helps or harms by shares and by standard errors over the blocks."""

import numpy as np
import pytest

from bayesid.regression.selection.forward import bears_out, harmed
from bayesid.regression.selection.products import HeldBackErrors, blocks_of
from bayesid.regression.tuning import TUNING

COUNT = 25
"""Samples a block."""


def errors(*mean_squares, counts=COUNT):
    """Of each joint, one number for all blocks or one a block, (N m)^2."""
    blocks = np.stack([np.broadcast_to(values, TUNING.blocks) for values in mean_squares], axis=1)
    counts = np.broadcast_to(counts, blocks.shape)
    return HeldBackErrors(blocks * counts, counts)


def spread(mean, sd):
    """(TUNING.blocks,) of exactly this mean and standard deviation, in no order."""
    return mean + sd * np.resize([1.0, -1.0, -1.0, 1.0], TUNING.blocks)


def test_rms_weighs_samples_not_blocks():
    found = HeldBackErrors(np.array([[8.0, 0.0], [1.0, 18.0]]), np.array([[2, 0], [7, 2]]))
    np.testing.assert_allclose(found.rms, [1.0, 3.0])
    nothing = HeldBackErrors(np.zeros((2, 1)), np.zeros((2, 1), dtype=int))
    np.testing.assert_array_equal(nothing.rms, [0.0])


def test_rise_and_its_standard_error_are_those_of_the_mean_of_blocks():
    """Sixteen independent changes: the sd of their mean is theirs over four."""
    rise, error = errors(spread(5.0, 0.8), 2.0).rise(errors(4.0, 3.0))
    np.testing.assert_allclose(rise, [1.0, -1.0])
    np.testing.assert_allclose(error, [0.8 / 4.0, 0.0], atol=1e-15)


def test_above_a_level_is_sure_by_the_scatter_of_the_blocks():
    """A mean square of 10 over a level of 3 N m: 1 against 1.5 sd / 4."""
    for sd, sure in ((2.6, True), (2.7, False)):
        np.testing.assert_array_equal(errors(spread(10.0, sd), 0.24).surely_above(np.array([3.0, 0.5])), [sure, False])


@pytest.mark.parametrize(
    ("rise", "sd", "grown"), [(0.11, 0.0, True), (0.09, 0.0, False), (0.3, 0.7, True), (0.3, 0.9, False)]
)
def test_growth_is_as_large_and_as_sure_as_the_help_of_an_effect(rise, sd, grown):
    """A tenth of the mean square, and one and a half standard errors: 0.3 against 1.5 sd / 4."""
    before = errors(1.0, 3.0)
    np.testing.assert_array_equal(errors(spread(1.0 + rise, sd), 3.0).surely_grown(before), [grown, False])
    assert not before.surely_grown(errors(1.0 + rise, 3.0)).any()


def test_harm_is_visible_from_four_per_cent_of_the_square_and_sure_from_one_standard_error_on():
    """The same in all blocks, beyond all doubt; and a rise of one, whose standard error is a quarter of the scatter."""
    before = errors(7.0, 0.3)
    for rise, visible in ((-0.5, False), (0.039, False), (0.041, True)):
        np.testing.assert_array_equal(harmed(errors(7.0 * (1.0 + rise), 0.3), before), [visible, False])
        np.testing.assert_array_equal(harmed(errors(7.0, 0.3 * (1.0 + rise)), before), [False, visible])
    for share in (0.9, 1.1):
        np.testing.assert_array_equal(harmed(errors(spread(11.0, 4.0 / share)), errors(10.0)), [share > 1.0])


def test_help_is_worth_a_term_from_a_tenth_of_the_square_on():
    before = errors(2.0, 9.0)
    for share, borne_out in ((0.095, False), (0.105, True)):
        after = errors(2.0, 9.0 * (1.0 - share))
        assert [bears_out(after, before, [j]) for j in (1, 0)] == [borne_out, False]


@pytest.mark.parametrize(
    ("first", "second", "borne_out"), [(0.06, 0.06, True), (0.06, 0.03, False), (0.2, -0.01, True)]
)
def test_shares_of_joints_add_up(first, second, borne_out):
    """However different the joints' efforts are."""
    after = errors(1e-4 * (1.0 - first), 1e4 * (1.0 - second), 1.0)
    assert bears_out(after, errors(1e-4, 1e4, 1.0), {0, 1}) is borne_out


def test_help_must_be_sure():
    """A fall of a third, by some standard errors."""
    for deviations, borne_out in ((1.3, False), (1.7, True)):
        scatter = 1.0 / deviations * np.sqrt(TUNING.blocks)
        assert bears_out(errors(spread(2.0, scatter)), errors(3.0), [0]) is borne_out


def test_help_is_weighed_against_harm_elsewhere():
    """Much help in two blocks, nothing in others or twice the square in half of them; then a loss in another joint."""
    acts = np.isin(np.arange(TUNING.blocks), (5, 6)).astype(float)
    before = errors(1.0 + 9.0 * acts)
    for elsewhere in (0.0, 1.0):
        after = errors(1.0 + 3.0 * acts + elsewhere * np.resize([1.0, 0.0], TUNING.blocks) * (1.0 - acts))
        assert bears_out(after, before, [0]) is (elsewhere == 0.0)
        assert bears_out(before, after, [0]) is False
    for rise, borne_out in ((0.75, True), (0.85, False)):  # a fall by four fifths in the first joint
        assert bears_out(errors(0.4, 5.0 * (1.0 + rise)), errors(2.0, 5.0), [0]) is borne_out


def test_joints_without_samples_say_nothing():
    before = HeldBackErrors(np.zeros((TUNING.blocks, 1)), np.zeros((TUNING.blocks, 1), dtype=int))
    assert not bears_out(before, before, [0])
    np.testing.assert_array_equal(harmed(before, before), [False])


def test_blocks_last_a_second_unless_there_are_too_few():
    assert [blocks_of(duration) for duration in (0.5, 3.9, 5.5, 15.9, 16.0, 500.0)] == [4, 4, 5, 15, 16, 16]
