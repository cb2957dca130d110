import numpy as np
import pytest
from conftest import smooth_motion

from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.log.segments import USUAL, Segmentation, Segments, find_segments
from bayesid.log.signals import prepare
from bayesid.motion import Motion


def cut(motion: Motion, effort, signed=(), segmentation=USUAL):
    """Segments of an effort (N, n); joints in `signed` keep their signs."""
    known = np.isin(np.arange(motion.n_joints), signed)
    signals = prepare(Log(motion.t, motion.q, np.where(known, effort, np.abs(effort)), known), cutoff=8.0)
    return find_segments(signals, signals.motion, segmentation)


def pure(segments: Segments, effort, least) -> bool:
    """Whether no segment holds efforts of both signs larger than `least`."""
    inside = [effort[a:b, j] for j, a, b in zip(segments.joint, segments.start, segments.end, strict=True)]
    return all(x.max() < least or x.min() > -least for x in inside)


def test_zeros_of_the_effort_are_cut():
    motion = smooth_motion(2, 10.0, 100.0, seed=1)
    rng = np.random.default_rng(0)
    first, second = 4 * np.sin(4.4 * motion.t + 1) + 1.0, 9 * np.cos(1.9 * motion.t) - 2
    effort = np.stack([first, second], axis=1)
    effort += 0.05 * rng.standard_normal(effort.shape)
    segments = cut(motion, effort)
    assert pure(segments, effort, 0.6)
    covered = np.zeros_like(effort)
    for j, a, b in zip(segments.joint, segments.start, segments.end, strict=True):
        covered[a:b, j] += 1
    assert (covered == 1).all()
    crossings = [np.sum(np.diff(np.sign(effort[:, j])) != 0) for j in range(2)]
    assert len(segments) < 12 * sum(crossings)


def test_a_jump_at_a_velocity_reversal_is_cut_at_the_sample():
    """Dry friction: the effort jumps from 3 to -2 and has no minimum to show for it."""
    motion = smooth_motion(1, 8.0, 100.0, seed=2)
    effort = np.where(motion.dq > 0, 3.0, -2.0)
    segments = cut(motion, effort)
    moving = segments[segments.moving]
    assert pure(moving, effort, 0.5) or max(moving.end - moving.start) < len(motion)
    signs = np.sign(motion.dq[:, 0])
    for at in np.flatnonzero(signs[1:] != signs[:-1]) + 1:
        near = np.concatenate([segments.start, segments.end])
        assert np.abs(near - at).min() <= 2


def test_a_fast_crossing_between_unequal_efforts_is_cut():
    """From +0.4 to -3 within 40 ms, far from any reversal: |effort| only turns steeper."""
    t = np.arange(800) / 100.0
    motion = Motion(t, np.stack([0.5 * t], axis=1), np.full((800, 1), 0.5), np.zeros((800, 1)))
    effort = np.where(t < 4.0, 0.4, -3.0)[:, None]
    segments = cut(motion, effort)
    assert np.abs(segments.start - 400).min() <= 6


def test_a_signed_joint_is_known_and_cut_only_at_standstill():
    motion = smooth_motion(2, 10.0, 100.0, seed=5)
    effort = np.stack([np.sin(9 * motion.t), np.sin(7 * motion.t) - 0.2], axis=1)
    segments = cut(motion, effort, signed=[1])
    assert set(segments.known[segments.joint == 1]) == {1}
    assert set(segments.known[segments.joint == 0]) == {0}
    assert (segments.joint == 1).sum() < (segments.joint == 0).sum()


def test_split():
    """A cut named twice, as by two crossings that share a sample, is one cut."""
    ones = np.ones(2, dtype=np.int64)
    moving, fitted = ones.astype(bool), np.array([True, False])
    segments = Segments(np.array([0, 1]), 0 * ones, 10 * ones, 0 * ones, moving, fitted)
    parts = segments.split([(1, 4), (0, 0), (1, 7), (1, 4)])
    rows = list(zip(parts.joint.tolist(), parts.start.tolist(), parts.end.tolist(), strict=True))
    assert rows == [(0, 0, 10), (1, 0, 4), (1, 4, 7), (1, 7, 10)]
    assert parts.moving.all()
    assert parts.fitted.tolist() == [True, False, False, False]
    assert segments[np.array([1])].fitted.tolist() == [False]


def test_a_minimum_far_from_zero_is_not_cut():
    motion = smooth_motion(1, 10.0, 100.0, seed=6)
    rng = np.random.default_rng(1)
    effort = (5.0 + np.sin(3 * motion.t) + 0.05 * rng.standard_normal(len(motion)))[:, None]
    segments = cut(motion, effort)
    reversals = np.sum(np.diff(np.sign(motion.dq[:, 0])) != 0)
    assert (segments.moving).sum() <= reversals + 2, "only reversals (and the filter at the ends) may cut"


def test_a_jump_of_the_acceleration_is_cut():
    """Trapezoidal speed: where the acceleration ends, inertia lets the effort jump from 2 to -3 without a minimum."""
    t = np.arange(600) / 100.0
    acceleration = np.where(t < 1.5, 1.0, 0.0)
    speed = np.cumsum(acceleration) / 100.0 + 0.1
    motion = Motion(t, np.cumsum(speed)[:, None] / 100.0, speed[:, None], acceleration[:, None])
    effort = np.where(t < 1.5, 3.5, -3.0)[:, None]
    segments = cut(motion, effort)
    assert np.abs(segments.start - 150).min() <= 6


def test_a_pause_of_the_log_belongs_to_no_motion():
    motion = smooth_motion(1, 10.0, 100.0, seed=2)
    keep = (motion.t < 4.0) | (motion.t > 5.5)
    effort = np.abs(np.sin(2.0 * motion.t))[keep, None]
    signals = prepare(Log(motion.t[keep], motion.q[keep], effort, np.zeros(1, bool)), cutoff=5.0)
    segments = find_segments(signals, signals.motion)
    inside = (signals.motion.t > 4.05) & (signals.motion.t < 5.45)
    assert not segments.per_sample(segments.moving, len(inside), 1)[inside].any()


def steady(duration=20.0):
    """One joint at constant speed: nothing but its effort is cut."""
    t = np.arange(int(100 * duration)) / 100.0
    return Motion(t, 0.5 * t[:, None], np.full((len(t), 1), 0.5), np.zeros((len(t), 1)))


def test_the_prominence_decides_which_minima_are_cut():
    """Dips of 5 and 15 % of the top, on a plateau of 25 %."""
    motion = steady()
    t = motion.t
    dips = 0.5 * np.exp(-0.5 * ((t - 12.0) / 0.1) ** 2) + 1.5 * np.exp(-0.5 * ((t - 17.0) / 0.1) ** 2)
    effort = (np.where(t < 8.0, 10.0, 2.5) - dips)[:, None]
    for prominence, wanted in ((0.02, [1200, 1700]), (0.1, [1700]), (0.2, [])):
        starts = cut(motion, effort, segmentation=Segmentation(prominence=prominence)).start
        found = [int(at) for at in starts if 1000 < at < 1900]
        assert len(found) == len(wanted)
        assert all(abs(at - place) <= 3 for at, place in zip(found, wanted, strict=True))


@pytest.mark.parametrize("threshold", [0.05, 0.5])
def test_samples_under_the_threshold_are_set_apart(threshold):
    """|10 sin| is under a share s of its top for the asin(s) of every quarter turn."""
    motion = steady()
    phase = 2.0 * np.pi * 0.2 * motion.t + 0.3
    segments = cut(motion, 10.0 * np.sin(phase)[:, None], segmentation=Segmentation(threshold=threshold))
    fitted = segments.per_sample(segments.fitted, len(motion), 1)[:, 0] > 0
    expected = np.abs(np.sin(phase)) >= threshold
    assert np.mean(fitted != expected) < 0.01
    assert 1.0 - fitted.mean() == pytest.approx(np.arcsin(threshold) / (0.5 * np.pi), abs=0.015)
    assert segments.moving.all()
    changes = np.flatnonzero(np.diff(fitted)) + 1
    assert set(changes) <= set(segments.start.tolist())
    assert pure(segments[segments.fitted], 10.0 * np.sin(phase)[:, None], 0.1)
    assert pure(segments, 10.0 * np.sin(phase)[:, None], 0.3), "zeros under the threshold are cut all the same"


def test_shares_that_cannot_be_are_refused():
    for name, share in (("prominence", 0.0), ("prominence", 1.0), ("threshold", -0.1), ("threshold", np.nan)):
        with pytest.raises(InputError, match=f"`{name}`: {share:g} is out of range"):
            Segmentation(**{name: share})
