"""Smoothing in pieces side by side against one run of sums over all values, in double precision, sample by sample."""

import tracemalloc

import numpy as np
import pytest
from scipy.stats import t
from smoothing_oracles import noise_of, size_at_rest

from bayesid.regression.noise import Noise
from bayesid.signs.smoothing import smooth
from bayesid.signs.tuning import Tuning

RATE = 100.0
GRID, REACH, FINEST, TURNS, REST_TIME = 101, 4.0, 0.75, 0.5, 0.5
"""As docs/method.md, section 10, has them."""


def steps_of(grid, size, time):
    memory = np.exp(-1.0 / (time * RATE))
    spread = max(size * np.sqrt(1.0 - memory**2), FINEST * (grid[1] - grid[0]))
    rows = np.exp(-0.5 * ((grid[None, :] - memory * grid[:, None]) / spread) ** 2) + 1e-30
    return rows / rows.sum(axis=1, keepdims=True)


def stationary(grid, size):
    weight = np.exp(-0.5 * (grid / size) ** 2)
    return weight / weight.sum()


def plain(effort, predicted, moving, noise):
    """P(sign = +) of one joint: forward-backward with one matrix a sample."""
    white, coloured, correlation = noise.white[0], noise.coloured[0], noise.correlation[0]
    wide = size_at_rest(effort, predicted, moving, coloured)
    grid = REACH * wide * np.linspace(-1.0, 1.0, GRID)
    turning = ~(moving & np.append(True, moving[:-1]))
    chance = np.zeros(len(effort))
    for i in np.flatnonzero(turning):
        first, last = i, i
        while first and turning[first - 1]:
            first -= 1
        while last + 1 < len(turning) and turning[last + 1]:
            last += 1
        chance[i] = 1.0 - (1.0 - TURNS) ** (1.0 / (last - first + 1))
    in_motion, at_rest = steps_of(grid, coloured, correlation), steps_of(grid, wide, REST_TIME)
    afresh = np.tile(stationary(grid, wide), (GRID, 1))
    steps = [(1.0 - c) * at_rest + c * afresh if c else in_motion for c in chance]
    up, down = (t(4).pdf((sign * effort[:, None] - predicted[:, None] - grid) / white) for sign in (1.0, -1.0))
    before, after = [stationary(grid, coloured)], [np.ones(GRID)]
    for i in range(1, len(effort)):
        belief = (before[-1] * (up + down)[i - 1]) @ steps[i]
        before.append(belief / belief.sum())
    for i in range(len(effort) - 1, 0, -1):
        future = steps[i] @ (after[-1] * (up + down)[i])
        after.append(future / future.sum())
    both = np.array(before) * np.array(after[::-1])
    return (both * up).sum(axis=1) / (both * (up + down)).sum(axis=1)


def log_of(seed, samples, rests, error=0.4):
    """A prediction that crosses zero again and again, efforts about it, and standstills (start, samples)."""
    rng = np.random.default_rng(seed)
    at = np.arange(samples) / RATE
    predicted = 2.0 * np.sin(5.0 * at + seed) + 0.7 * np.sin(13.0 * at) + 0.3
    walk = np.cumsum(rng.standard_normal(samples)) * 0.05
    effort = np.abs(predicted + error * (walk - walk.mean()) + 0.15 * rng.standard_normal(samples))
    moving = np.ones(samples, dtype=bool)
    for start, length in rests:
        moving[start : start + length] = False
        predicted[start : start + length] *= 0.2
    return effort, predicted, moving


CASES = (  # samples, standstills
    (1, ()),
    (25, ()),
    (300, ((47, 1), (48 + 47, 1), (144, 1), (200, 1))),
    (700, ((90, 1), (150, 260), (500, 30))),
    (200, ((0, 80), (110, 90))),
)
NOISES = {
    "short": noise_of(0.15, 0.2, 0.01),
    "long": noise_of(0.15, 0.3, 0.5),
    "finer than the grid": noise_of(0.01, 0.2, 0.1),
}


@pytest.mark.parametrize("noise", NOISES)
def test_pieces_give_what_one_run_gives(noise):
    for samples, rests in CASES:
        effort, predicted, moving = log_of(samples, samples, rests)
        found = smooth(effort[:, None], predicted[:, None], moving[:, None], NOISES[noise], RATE)[:, 0]
        np.testing.assert_allclose(found, plain(effort, predicted, moving, NOISES[noise]), atol=2e-4, err_msg=samples)


@pytest.mark.parametrize("off", [3.0, 12.0])
def test_where_model_and_effort_contradict_each_other(off):
    """For half a second the model errs by many standard deviations: beliefs leave the middle of the grid.

    From sample 120 on, in the middle of a piece or with its first sample.
    """
    effort, predicted, moving = log_of(3, 400, ((20, 30), (300, 5)))
    effort[120:170] = np.abs(effort[120:170] + off)
    effort[230] += 5.0
    for noise in NOISES.values():
        arguments, expected = (
            (effort[:, None], predicted[:, None], moving[:, None]),
            plain(effort, predicted, moving, noise),
        )
        for piece in (20, 24, 48):
            found = smooth(*arguments, noise, RATE, tuning=Tuning(piece=piece))[:, 0]
            np.testing.assert_allclose(found, expected, atol=1e-3)


def test_draws_and_joints_do_not_mix():
    """Joints of other noise and standstills, five draws, more than are smoothed at once."""
    logs = [log_of(seed, 230, rests) for seed, rests in ((1, ((50, 9),)), (2, ()), (5, ((100, 1), (180, 50))))]
    effort, predicted, moving = (np.stack(values, axis=1) for values in zip(*logs, strict=True))
    noises = list(NOISES.values())
    joined = Noise(*(np.concatenate(values) for values in zip(*(vars(n).values() for n in noises), strict=True)))
    shifts = np.array([-1.2, -0.4, 0.0, 0.4, 1.2])
    draws = predicted[:, :, None] + np.where(moving, 1.0, 0.0)[:, :, None] * shifts
    found = smooth(effort, draws, moving, joined, RATE, tuning=Tuning(side_by_side=460))
    for j, noise in enumerate(noises):
        whole = smooth(effort[:, j : j + 1], draws[:, j : j + 1], moving[:, j : j + 1], noise, RATE)
        np.testing.assert_allclose(found[:, j : j + 1], whole, atol=1e-5)
    at_rest = size_at_rest(effort[:, 1], predicted[:, 1], moving[:, 1], noises[1].coloured[0])
    assert at_rest == noises[1].coloured[0], "so that the draws of joint 2 have the same process each by itself"
    each = [plain(effort[:, 1], draws[:, 1, k], moving[:, 1], noises[1]) for k in range(5)]
    assert np.std(each, axis=0).max() > 0.05, "the draws disagree"
    np.testing.assert_allclose(found[:, 1], np.mean(each, axis=0), atol=2e-4)


def test_the_length_of_pieces_and_blocks_does_not_matter():
    effort, predicted, moving = log_of(4, 500, ((100, 40),))
    expected = plain(effort, predicted, moving, NOISES["short"])
    for tuning in (Tuning(piece=7), Tuning(piece=48), Tuning(piece=1000), Tuning(smoothed=200, overlap=90)):
        arguments = effort[:, None], predicted[:, None], moving[:, None], NOISES["short"], RATE
        found = smooth(*arguments, tuning=tuning)
        np.testing.assert_allclose(found[:, 0], expected, atol=2e-4)


def peak(samples, draws):
    effort, predicted, moving = log_of(2, samples, ((200, 40), (1500, 3)))
    many = np.repeat(predicted[:, None, None], draws, axis=2)
    arguments = effort[:, None], many, moving[:, None], NOISES["short"], RATE
    tracemalloc.start()
    smooth(*arguments, tuning=Tuning(smoothed=1500, overlap=100, side_by_side=3000))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most


def test_memory_does_not_grow_with_log_and_draws():
    """But for the few columns that a log has itself: 200 bytes a sample; beliefs of one draw would be 1600."""
    short, long = peak(3000, 2), peak(15_000, 2)
    assert long - short < 200 * 12_000
    assert peak(3000, 8) < 1.1 * short + 8 * 3000
