"""Alternatives against draws without them, and where the log does not discriminate."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.studies.alternatives import TERMS, either, simulated, weigh

FEW = Sampling(budget=0.0)


@pytest.fixture(scope="module")
def arm():
    """The identification of a log without signs, the place of each parameter, and the truth."""
    model, theta, log = simulated()
    places = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    return identify(model.robot, log, TERMS, complete="off", posterior=FEW), places, theta


def test_the_true_one_of_two_that_the_log_can_tell_has_all_the_weight(arm):
    result, places, theta = arm
    bound = 0.7 * theta[places["Fc2"]]
    right, wrong = weigh(result, either("Fc2", bound), FEW)
    assert right.weight > 0.999
    assert right.weight + wrong.weight == pytest.approx(1.0)
    assert right.cost == pytest.approx(0.0, abs=1e-3)
    place = places["Fc2"]
    sd = result.fit.sd[result.coefficients.names.index("Fc2")]
    assert wrong.cost == pytest.approx(((result.fit.theta[place] - bound) / sd) ** 2, rel=0.25)
    assert right.marginal_likelihood.log_value == 0.0
    assert wrong.marginal_likelihood.log_value < -5.0
    assert wrong.draws.theta[..., place].max() <= bound <= right.draws.theta[..., place].min()


def test_what_the_log_cannot_tell_has_the_weight_that_the_prior_and_the_draws_give_it(arm):
    result, places, theta = arm
    bound = 0.8 * theta[places["m1"]]
    both = weigh(result, either("m1", bound), FEW)
    inside = np.mean(result.posterior.draws.theta[..., places["m1"]] >= bound)
    assert both[0].weight + both[1].weight == pytest.approx(1.0)
    assert 0.0 < both[0].weight_sd < 0.15
    assert both[0].weight == pytest.approx(inside, abs=4.0 * both[0].weight_sd + 0.06)
    assert both[0].weight == pytest.approx(both[0].prior_share, abs=0.25)
    for one in both:
        assert one.cost < 0.2
        assert one.shared == 0.0
        assert one.marginal_likelihood.log_value == pytest.approx(0.0, abs=1.0)


def test_draws_that_satisfy_both_count_as_shared(arm):
    result, places, theta = arm
    mass = theta[places["m1"]]
    overlapping = {"light": lambda p: p["m1"] <= mass, "heavy": lambda p: p["m1"] >= 0.5 * mass}
    assert all(0.05 < one.shared < 1.0 for one in weigh(result, overlapping, FEW))


def test_what_cannot_be_weighed_is_refused(arm):
    result, places, theta = arm
    pair = either("m1", theta[places["m1"]])
    with pytest.raises(InputError, match="fewer than two"):
        weigh(result, dict(list(pair.items())[:1]))
    with pytest.raises(InputError, match="no posterior"):
        weigh(replace(result, posterior=None), pair)
    widened = replace(result.posterior, shift=np.zeros(result.posterior.draws.theta.shape))
    with pytest.raises(InputError, match="widened"):
        weigh(replace(result, posterior=widened), pair)
    with pytest.raises(InputError, match="alternative 'huge': the prior excludes it"):
        weigh(result, {**pair, "huge": lambda p: p.total_mass >= 1e5}, FEW)
    with pytest.raises(InputError, match="alternative 'same': it is an equality"):
        weigh(result, {**pair, "same": lambda p: p["m1"] == p["m2"]}, FEW)
    with pytest.raises(InputError, match="no constraint"):
        weigh(result, {"nothing": lambda _: [], **pair}, FEW)
