"""Long logs and long runs: what does not fit is refused, stages are told, draws are no more than for short ones."""

import os
from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.identification import sampling
from bayesid.identification.options import check_memory, memory_needed
from bayesid.log.log import Log
from bayesid.posterior.sampler import Sampling


def log_of(t, n=2):
    values = np.ones((len(t), n))
    return Log(np.asarray(t, dtype=float), values, values, np.zeros(n, dtype=bool), source="log.csv")


def test_stamps_in_bursts_count_by_their_even_grid():
    """900 rows of ten in a nanosecond's distance once asked for a terabyte. More rows or joints need more."""
    short, long, wide = log_of(np.arange(1e4) / 500), log_of(np.arange(1e5) / 500), log_of(np.arange(1e5) / 500, n=6)
    assert memory_needed(short) < memory_needed(long) < memory_needed(wide) < 1.5
    rows = np.arange(900)
    assert memory_needed(log_of((rows // 10) * 0.1 + (rows % 10) * 1e-9)) > 500.0


def test_a_limit_is_kept_and_the_line_says_how_to_go_on(monkeypatch):
    """By default it is a share of the machine, where the system tells how large that is."""
    log = log_of(np.arange(1e5) / 500)
    check_memory(log, 100.0)
    with pytest.raises(InputError, match=r"100000 rows of 2 joints need about 0\.5\d GB of memory, 0\.5 are allowed"):
        check_memory(log, 0.5)
    monkeypatch.setattr(os, "sysconf", {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}.__getitem__)
    with pytest.raises(InputError, match="resample the log"):
        check_memory(log, None)
    monkeypatch.delattr(os, "sysconf")
    check_memory(log, None)


def test_identify_asks_first(monkeypatch):
    monkeypatch.setattr("bayesid.identification.pipeline.prepare", lambda *_: pytest.fail("work has begun"))
    t = np.arange(300) / 100
    log = replace(log_of(t, 6), q=np.sin(np.outer(t, np.arange(1.0, 7.0))))
    with pytest.raises(InputError, match=r"`Preprocessing\.max_memory`"):
        bayesid.identify("kr5", log, preprocessing=bayesid.Preprocessing(max_memory=0.1))
    with pytest.raises(InputError, match="a memory of 0 GB"):
        bayesid.Preprocessing(max_memory=0.0)


DRAWS = 24


@pytest.mark.parametrize("duration", [6.0, 60.0])
def test_a_long_log_is_averaged_over_as_many_draws(duration, monkeypatch):
    averaged, smooth = [], sampling.sign_probabilities

    def seen(signals, predicted, *others):
        averaged.append(predicted)
        return smooth(signals, predicted, *others)

    monkeypatch.setattr(sampling, "sign_probabilities", seen)
    log = bayesid.simulate("kr5", duration=duration, rng=3)
    terms, brief = ["rigid_body", "viscous_friction"], Sampling(budget=0.0, walkers=8)
    bayesid.identify("kr5", log, terms, posterior=brief, complete="off")
    (predicted,) = averaged
    assert predicted.shape == (len(log.t), 6, DRAWS)
    assert len(np.unique(predicted[len(log.t) // 2, 0])) == DRAWS, "each of them another"
