"""Threads of one process: what they share stays as it was, and each computes what it would alone."""

import re
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor

import matplotlib as mpl
import numpy as np
import pytest
import scipy.sparse  # noqa: F401, it changes the warnings where it is imported first
from conftest import small_robot
from threadpoolctl import threadpool_info

import bayesid
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.parallel import one_blas_thread, quiet
from bayesid.posterior.sampler import Sampling
from bayesid.report.pages.identification_page import identification_page
from bayesid.report.report_data import report_data
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TERMS = ["rigid_body", "viscous_friction"]
ROBOT = small_robot(2, 3)
MOTION = random_trajectory(2, 6.0, rng=4).motion(np.arange(301) / 50.0)
MODEL = Model(ROBOT, make_terms(TERMS, ROBOT, MOTION))
THETA = random_parameters(MODEL, rng=np.random.default_rng(4))


def blas_threads():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def shared():
    return blas_threads(), list(warnings.filters), dict(mpl.rcParams)


@pytest.mark.parametrize("change", [lambda: one_blas_thread, lambda: quiet(UserWarning)])
def test_overlapping_changes_are_taken_back(change):
    """One thread enters, the other enters if it can, the first leaves, the other leaves."""
    before, first_in, second_in, gone = shared(), *(threading.Event() for _ in range(3))

    def early():
        with change():
            first_in.set()
            second_in.wait(0.5)
        gone.set()

    def late():
        first_in.wait()
        with change():
            second_in.set()
            gone.wait()

    with ThreadPoolExecutor(2) as pool:
        for ended in [pool.submit(early), pool.submit(late)]:
            ended.result()
    assert shared() == before


def compute(seed):
    """Numbers and figures of an identification."""
    log = simulate(MODEL, THETA, MOTION, rng=np.random.default_rng(seed), noise=0.03)
    sampling = Sampling(walkers=16, max_sweeps=32, rng=seed)  # what is compared need not converge
    search = bayesid.Certified()
    result = bayesid.identify(ROBOT, log, TERMS, search=search, posterior=sampling)
    figures = re.findall(r"<svg.*?</svg>", identification_page(report_data(result)), re.DOTALL)
    return result.identified.theta, result.probability, result.posterior.plus, figures


def test_threads_give_what_one_gives():
    before, seeds = shared(), (1, 2, 1)
    alone = {seed: compute(seed) for seed in set(seeds)}
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(compute, seeds))
    for seed, found in zip(seeds, together, strict=True):
        for one, other in zip(found[:-1], alone[seed][:-1], strict=True):
            np.testing.assert_array_equal(one, other)
        assert len(found[-1]) > 3
        assert found[-1] == alone[seed][-1]
    assert shared() == before
