"""Choice among several sets and their probabilities, for made-up sets and numbers."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t

from bayesid.discrepancy import selection
from bayesid.discrepancy.sets import weighed
from bayesid.regression.selection.cross_validation import log_density, surely_better
from bayesid.regression.selection.fitted_effects import Thresholds

ROWS, BLOCKS = 1600, 16


@dataclass
class Source:
    """A form of an effect that is not an error of the robot's table."""

    name: str
    of_table: bool = False


def made(keys, log_posterior, error, form=""):
    """A set whose residual on held-back data is common noise plus an individual error."""
    noise = np.random.default_rng(1).normal(size=(ROWS, 2))
    noise[:, 0] += error * np.sin(np.arange(ROWS))
    keys = frozenset(keys)
    return SimpleNamespace(
        keys=keys,
        forms=frozenset((name + form, joints) for name, joints in keys),
        effects=[SimpleNamespace(key=key, source=Source(key[0] + form), joints=key[1]) for key in sorted(keys)],
        log_posterior=log_posterior,
        cross_validation=noise,
        data=SimpleNamespace(floor=np.array([0.9, 0.8])),
    )


def smallest(*found):
    used = np.ones((ROWS, 2), dtype=bool)
    trial = SimpleNamespace(used=used, rms=lambda values: np.sqrt((values**2).mean(axis=0)))
    cross_validation = SimpleNamespace(
        trial=trial, by_block=lambda values: np.stack([x.sum(axis=0) for x in np.array_split(values, BLOCKS)])
    )
    case = SimpleNamespace(cross_validation=cross_validation, thresholds=Thresholds(), needed=2.0 * np.log(10.0))
    sets = SimpleNamespace(found={one.forms: one for one in found}, case=case)
    return selection.minimal_sets(sets)


DRY, SPRING, DRAG, SKEW = (("dry", (2,)), ("spring", (2,)), ("drag", (2,)), ("skew", (2,)))


def test_the_most_probable_of_the_smallest_equally_good_sets_is_chosen():
    pair, skewed = made([DRY, SPRING], 400.0, 0.0), made([SKEW, SPRING], 397.0, 0.01)
    drag = made([DRAG], 450.0, 2.0)  # more probable on the log, worse on held-back data
    three = made([DRY, SPRING, DRAG], 460.0, 0.0)
    assert smallest(made([], 0.0, 5.0), pair, skewed, drag, three) == [pair, skewed]


def test_an_effect_without_evidence_on_the_log_is_not_chosen_even_if_it_predicts_better():
    nothing, one = made([], 0.0, 5.0), made([DRY], 300.0, 1.0)
    assert smallest(nothing, one, made([DRY, DRAG], 302.0, 0.0))[0] is one
    assert smallest(nothing, one, made([DRY, DRAG], 310.0, 0.0))[0].keys == {DRY, DRAG}


def test_probabilities_are_summed_over_forms():
    pair, other = made([DRY, SPRING], 10.0, 0.0), made([DRY, SPRING], 9.0, 0.0, form=".two")
    skewed = made([SKEW, SPRING], 8.0, 0.0)
    found = weighed([pair, other, skewed], pair)
    total = 1.0 + np.exp(-1.0) + np.exp(-2.0)
    assert [set(one.effects) for one in found] == [{DRY, SPRING}, {SKEW, SPRING}]
    assert [one.probability for one in found] == pytest.approx([(1.0 + np.exp(-1.0)) / total, np.exp(-2.0) / total])


def test_log_densities_are_students():
    residual, sd = np.array([[0.3, -2.0], [7.0, 0.1]]), np.array([0.5, 1.5])
    used = np.array([[True, True], [True, False]])
    expected = (t(4, scale=sd).logpdf(residual) - t(4, scale=sd).logpdf(0.0)) * used
    np.testing.assert_allclose(log_density(residual, used, sd), expected.sum(axis=1), rtol=1e-12)


def test_better_in_a_few_blocks_and_equal_in_others_is_significant():
    few = np.where(np.arange(16) < 3, 12.0, 0.0)
    scattered = 12.0 * np.where(np.arange(16) % 2, 1.0, -0.6)
    assert surely_better(few, np.zeros(16), 30.0)
    assert not surely_better(few, np.zeros(16), 40.0)
    assert scattered.sum() > 30.0
    assert not surely_better(scattered, np.zeros(16), 30.0)
