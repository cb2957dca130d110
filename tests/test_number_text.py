"""Numbers in text."""

import math

import pytest

from bayesid.number_text import percent, quantity


@pytest.mark.parametrize(
    ("number", "text"),
    [
        ((1.94, 0.12, "N m"), "1.94 +- 0.12 N m"),
        ((-0.04, 0.4, "m"), "0.0 +- 0.4 m"),  # no sign of a rounded zero
        ((-0.06, 0.4, "m"), "-0.1 +- 0.4 m"),
        ((3.1497, 0.00354, "kg m"), "3.1497 +- 0.0035 kg m"),  # PDG: 354 and 355, 949 and 950
        ((3.1497, 0.00355, "kg m"), "3.150 +- 0.004 kg m"),
        ((2.34, 0.949, ""), "2.3 +- 0.9"),
        ((2.34, 0.951, ""), "2.3 +- 1.0"),
        ((234.0, 97.0, ""), "234 +- 97"),
        ((0.069, 0.004, "1"), "0.069 +- 0.004"),  # a dimensionless number has no unit
        ((0.069, math.nan, "1"), "0.0690"),
        ((2e7, 3e5, "1/rad"), "(2.000 +- 0.030)e7 1/rad"),
    ],
)
def test_a_deviation_sets_the_digits_and_one_is_no_unit(number, text):
    assert quantity(*number) == text


def test_a_share_has_the_decimals_asked_for_or_two_digits():
    assert [percent(0.9996, 2), percent(0.9996, 1), percent(0.05, 0)] == ["99.96 %", "100.0 %", "5 %"]
    assert [percent(0.0052), percent(0.434)] == ["0.52 %", "43 %"]
