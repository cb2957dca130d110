"""The study of draws with constraints: its errors against independent walkers, and bounds against their definitions."""

import numpy as np
import pytest
from conftest import random_motion, small_robot

from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.regression.stated import constraints_of
from bayesid.simulation.parameters import random_parameters
from bayesid.studies.constrained_draws import FORMS, agrees, moments


def walks(seed, scale=3.0):
    """(D, W, 2) of correlated walkers: an autoregressive process of mean 5 and sd `scale`, and its negative cube."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(120, 40))
    steps[1:] *= np.sqrt(1.0 - 0.9**2)
    for k in range(1, len(steps)):
        steps[k] += 0.9 * steps[k - 1]
    return np.stack([5.0 + scale * steps, -(steps**3)], axis=-1)


def test_errors_are_those_of_many_runs_of_correlated_walkers():
    """Kept: the upper part, of which mean and sd are those of half a normal distribution."""
    found = [moments(draws, draws[..., 0] > 5.0) for draws in map(walks, range(60))]
    mean, sd = (np.array([getattr(one, key)[0] for one in found]) for key in ("mean", "sd"))
    assert np.mean(mean) == pytest.approx(5.0 + 3.0 * np.sqrt(2.0 / np.pi), abs=0.05)
    assert np.mean(sd) == pytest.approx(3.0 * np.sqrt(1.0 - 2.0 / np.pi), abs=0.05)
    for values, key in ((mean, "mean_error"), (sd, "sd_error")):
        said = np.mean([getattr(one, key)[0] for one in found])
        assert said == pytest.approx(values.std(), rel=0.25)
    assert np.mean([one.mean_error[0] for one in found]) > 2.0 * 1.8 / np.sqrt(0.5 * 120 * 40), "not independent draws"


@pytest.mark.parametrize("name", FORMS)
def test_what_is_stated_holds_exactly_where_the_quantities_lie_between_the_bounds(name):
    robot = small_robot(3)
    model = Model(robot, make_terms(["rigid_body"], robot, random_motion(3, 20, 1)))
    names = [one.name for one in model.parameters]
    theta = np.array([random_parameters(model, rng=np.random.default_rng(seed)) for seed in range(200)])
    form = FORMS[name]
    quantities = form.quantities(dict(zip(names, theta.T, strict=True)))
    low, high = np.quantile(quantities, form.quantiles, axis=0)
    stated = constraints_of(lambda p: form.constraints(p, low, high), model).of(names)
    within = np.all(quantities <= high, axis=1)
    if form.quantiles[0] > 0.0:
        within &= np.all(quantities >= low, axis=1)
    assert 0.1 < within.mean() < 0.7
    assert [stated.contains(one, 1e-9) for one in theta] == within.tolist()


def test_means_and_ratios_decide_together_whether_draws_agree():
    good = {"off": [0.05, -0.09], "ratio": [0.94, 1.06]}
    assert agrees(good)
    assert not agrees({**good, "off": [0.0, -0.11]})
    assert not agrees({**good, "ratio": [0.92, 1.0]})
    assert not agrees({**good, "ratio": [1.0, 1.08]})
