"""The samples' probabilities are averaged over as many draws of the posterior, however long the log is."""

import numpy as np
import pytest

import bayesid
from bayesid.identification import pipeline
from bayesid.posterior.sampler import Sampling

DRAWS = 24


@pytest.mark.parametrize("duration", [6.0, 60.0])
def test_a_long_log_is_averaged_over_as_many_draws(duration, monkeypatch):
    averaged, smooth = [], pipeline.sign_probabilities

    def seen(signals, predicted, *others):
        averaged.append(predicted)
        return smooth(signals, predicted, *others)

    monkeypatch.setattr(pipeline, "sign_probabilities", seen)
    log = bayesid.simulate_log(bayesid.load_robot("kr5"), duration, 100.0, 0.05, (), seed=3)[1].rectified()
    terms, sampling = ["rigid_body", "viscous_friction"], Sampling(budget=0.0, walkers=8)
    bayesid.identify("kr5", log, terms, posterior=sampling, complete="off")
    (predicted,) = averaged
    assert predicted.shape == (len(log.t), 6, DRAWS)
    assert len(np.unique(predicted[len(log.t) // 2, 0])) == DRAWS, "each of them another"
