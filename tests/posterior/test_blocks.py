"""Blocks of segments: likelihoods that multiply to the log's, small enough for leave-one-out."""

import warnings

import arviz as az
import numpy as np
import pytest
from sign_problems import moments_of

import bayesid
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.log.segments import Segments
from bayesid.posterior.likelihood import SegmentBlocks, agreed_signs, by_blocks, divide, make_likelihood, pointwise
from bayesid.simulation.logs import simulate_log

SIGMA = np.array([0.5, 2.0])
LENGTH = 6.0
"""Autocorrelation time, samples: blocks last 48 samples at least."""
BETA = np.array([1.0, -0.6, 0.8])
SIGNS = np.array([1, -1, 1, -1, 1])
WEAK = 2
"""The segment whose sign is open."""


class Log:
    """Rows of five segments in two joints, the last one's sign known, and blocks of them."""

    def __init__(self):
        rng = np.random.default_rng(3)
        joint, start, end = (
            np.array([0, 0, 0, 1, 1]),
            np.array([0, 40, 250, 0, 130]),
            np.array([40, 250, 400, 130, 400]),
        )
        self.segments = Segments(joint, start, end, np.array([0, 0, 0, 0, 1]), np.ones(5, dtype=bool))
        self.columns = rng.standard_normal((400, 2, 3))
        self.columns[250:, 0] *= 0.02
        self.columns[:, 1] *= 4.0
        turned = self.segments.per_sample(SIGNS, 400, 2)
        self.effort = turned * (self.columns @ BETA + SIGMA * rng.standard_normal((400, 2)))
        pieces, segment = divide(self.segments, np.full(2, LENGTH))
        normal_equations = self.normal_equations(pieces, self.segments.known[segment])
        self.blocks = SegmentBlocks(normal_equations, segment, pieces.start, pieces.end)
        self.whole = self.normal_equations(self.segments, self.segments.known)
        coefficients = BaseCoefficients(("a", "b", "c"), ("a", "b", "c"), ("", "", ""), np.arange(3), np.eye(3))
        unknown = np.zeros(5, dtype=int)
        self.likelihood = make_likelihood(self.whole, coefficients, SIGMA, np.full(2, LENGTH), unknown)
        self.draws = BETA + 0.05 * rng.standard_normal((600, 3)), 0.1 * rng.standard_normal((600, 2))

    def normal_equations(self, segments, known):
        ranges = zip(segments.joint, segments.start, segments.end, strict=True)
        return moments_of([(self.columns[a:b, j], self.effort[a:b, j]) for j, a, b in ranges], segments.joint, known)


def test_blocks_cover_their_segments_and_none_is_short():
    log = Log()
    for k in range(5):
        mine = np.flatnonzero(log.blocks.segment == k)
        assert log.blocks.start[mine[0]] == log.segments.start[k]
        assert log.blocks.end[mine[-1]] == log.segments.end[k]
        assert np.array_equal(log.blocks.start[mine[1:]], log.blocks.end[mine[:-1]])
    size = log.blocks.end - log.blocks.start
    assert size[0] == 40  # the segment itself is shorter
    assert size[1:].min() >= 8 * LENGTH
    assert size.max() < 16 * LENGTH


def test_a_long_log_has_no_more_blocks():
    """Of a joint: 64, and one more at most for each segment."""
    count = []
    for samples in (20_000, 200_000):
        segments = Segments(
            np.zeros(2, int), np.array([0, 777]), np.array([777, samples]), np.zeros(2, int), np.ones(2, bool)
        )
        count.append(len(divide(segments, np.array([2.0]))[1]))
    assert max(count) <= 66
    assert min(count) > 60


def test_blocks_joined_are_the_segments():
    log = Log()
    joined = log.blocks.of_segments
    for name in ("joint", "known", "gradient", "energy", "count"):
        assert np.allclose(getattr(joined, name), getattr(log.whole, name), rtol=1e-12), name
    assert np.allclose(joined.hessian[joined.part], log.whole.hessian[:], rtol=1e-12)


def test_draws_agree_about_strong_segments():
    log = Log()
    assert agreed_signs(log.likelihood, *log.draws).tolist() == [1, -1, 0, -1, 1]
    theta, log_scale = log.draws
    theta = np.concatenate([theta, -theta[:1]])  # one draw of another opinion
    other = agreed_signs(log.likelihood, theta, np.concatenate([log_scale, log_scale[:1]]))
    assert other.tolist() == [0, 0, 0, 0, 1]


def test_segments_without_agreement_stay_whole():
    log = Log()
    blocks, likelihood = by_blocks(log.blocks, log.likelihood, *log.draws)
    fixed = likelihood.fixed
    assert np.sum(blocks.segment == WEAK) == 1
    assert np.sum(log.blocks.segment == WEAK) > 1
    assert fixed[blocks.segment == WEAK].tolist() == [0]
    assert fixed[blocks.segment == 0].tolist() == [0]  # whole anyway
    several = np.bincount(blocks.segment)[blocks.segment] > 1
    assert np.array_equal(fixed[several], SIGNS[blocks.segment[several]])


def test_likelihoods_of_blocks_multiply_to_the_segments():
    """In every draw, up to what the other signs of segments would add, and log 2 for each sign that is given now."""
    log = Log()
    blocks, likelihood = by_blocks(log.blocks, log.likelihood, *log.draws)
    whole = pointwise(log.likelihood, log.whole, *log.draws)
    apart = pointwise(likelihood, blocks.normal_equations, *log.draws)
    assert len(blocks) > len(log.whole)
    given = np.array([1, 3])  # agreed on, cut, and not known before
    whole[:, given] += np.log(2.0)
    for k in range(5):
        assert np.allclose(
            apart[:, blocks.normal_equations.part[blocks.segment == k]].sum(axis=1), whole[:, k], atol=1e-3
        )


@pytest.mark.long
def test_too_few_blocks_leave_out_whole_segments():
    """Whole segments are: of this log's one in fourteen had a Pareto k above 0.7."""
    log, _ = simulate_log(bayesid.load_robot("kr5"), duration=6.0, rate=60.0, noise=0.05, effects=[], seed=2)
    result = bayesid.identify("kr5", log, ["rigid_body", "coulomb_friction"], complete="off")
    data = result.to_inference_data()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        k = az.loo(data, var_name="effort", pointwise=True).pareto_k
    assert float((k > 0.7).mean()) < 0.03
