"""Information of an earlier log: as if its segments were there."""

from dataclasses import replace

import numpy as np
import pytest
from posterior_logs import Enumerated, cells, infer_from, make_log, near_symmetric
from posterior_problems import information_of

from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import InformationMatrix

SHORT = Sampling(walkers=4, budget=0.0)


def test_an_earlier_log_weighs_two_modes_as_quadrature_weighs_them():
    log = near_symmetric(0.4)
    rows = np.array([[0.7, 0.2], [-0.3, 0.9]])
    log = replace(log, earlier=information_of(rows, np.array([-0.8, 1.0])))
    axes = (cells(-3.2, 3.2, 100), cells(0.0, 1.6, 40), cells(-0.9, 1.2, 16), cells(-1.2, 1.9, 16))
    exact, alone = Enumerated(log, *axes), Enumerated(replace(log, earlier=None), *axes)
    share, other = (case.weight[case.theta[:, 0] > 0.0].sum() for case in (exact, alone))
    assert 0.05 < share < 0.4
    assert other > 0.5  # the earlier log has turned the odds
    posterior = infer_from(log)
    assert posterior.converged
    assert len(posterior.modes) == 2
    of_plus = next(sampled.weight for sampled in posterior.modes if sampled.mode.theta[0] > 0.0)
    model_error_probability = np.hypot(*(sampled.marginal_likelihood.standard_error for sampled in posterior.modes))
    assert abs(np.log(of_plus / (1.0 - of_plus)) - np.log(share / (1.0 - share))) < 4.5 * model_error_probability
    assert model_error_probability < 0.15
    assert np.allclose(posterior.plus, exact.plus, atol=0.03 + 4.5 * model_error_probability * share * (1.0 - share))


@pytest.mark.parametrize(("ratio", "decided"), [(8.0, False), (10.5, True)])
def test_parameters_shown_by_an_earlier_log_only_are_decided_by_data(ratio, decided):
    log = make_log(
        (0.9, 0.5, -0.8),
        rows=(30, 40, 20),
        known=(1, 0, 0),
        sigma=(0.3,),
        sees=((1.0, 0.0, 0.4),),
        mean=(0.5, 0.2, 0.0),
        sd=(1.0, 0.4, 1.5),
    )
    without = infer_from(log, options=SHORT)
    assert np.array_equal(without.decided_by_data, [True, False, True])
    precision = ratio / 0.4**2
    known = InformationMatrix(np.diag([0.0, precision, 0.0]), np.array([0.0, 3.0 * precision, 0.0]), 9.0 * precision)
    posterior = infer_from(replace(log, earlier=known), options=replace(SHORT, walkers=64))
    assert np.array_equal(posterior.decided_by_data, [True, decided, True])
    assert posterior.theta[1] == pytest.approx((3.0 * ratio + 0.2) / (ratio + 1.0), abs=0.05)
    assert posterior.parameter_sd[1] == pytest.approx(0.4 / np.sqrt(ratio + 1.0), rel=0.15)
