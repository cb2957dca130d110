"""Feasible motions: limits of steps, efforts between samples, and collisions."""

from dataclasses import replace

import numpy as np
import pytest
from open_results import LIMITS, open_known

from bayesid.excitation.limits import check_limits
from bayesid.excitation.splines import ENDS, Feasibility, SplineBasis, at_rest, largest_efforts
from bayesid.excitation.tuning import TUNING
from bayesid.simulation.trajectories import MotionLimits

POSE = np.array([-0.2, 0.5, 0.3])
FREE = 1e3


class FakeClearance:
    """A wall that a joint must not pass; it records the checked paths."""

    source = "a wall"

    def __init__(self, joint=0, wall=0.1, margin=0.05):
        self.joint, self.wall, self.margin, self.asked = joint, wall, margin, []

    def stays_clear(self, path, t, speed):
        self.asked.append((t.copy(), speed.copy()))
        fine = path(np.linspace(t[0], t[-1], 2001))
        return bool((self.distance(fine) > self.margin).all())

    def distance(self, q):
        return self.wall - q[:, self.joint]


@pytest.fixture(scope="module")
def known():
    return open_known()


@pytest.fixture(scope="module")
def basis():
    return SplineBasis(3.1)


def within(known, clearance=None, **limits):
    """Feasibility under limits, wide by default."""
    wide = {"lower": -FREE, "upper": FREE, "velocity": FREE, "acceleration": FREE}
    return Feasibility.of(known, MotionLimits(**{**wide, **limits}), clearance)


def wave(basis, seed=0, size=0.3):
    """(K, n) steps of all three joints, without the ends."""
    rng, step = np.random.default_rng(seed), np.zeros((len(basis), 3))
    step[ENDS:-ENDS] = size * rng.normal(size=(len(basis) - 2 * ENDS, 3))
    return step


def moved(trajectory, step, share=1.0):
    return replace(trajectory, control=trajectory.control + share * step)


@pytest.mark.parametrize(
    ("limits", "order"),
    [
        ({"upper": (FREE, 0.9, 0.5)}, 0),
        ({"velocity": (0.9, 0.4, FREE)}, 1),
        ({"acceleration": (FREE, 9.0, 2.5)}, 2),
        ({"jerk": (200.0, 35.0, FREE)}, 3),
    ],
)
def test_a_shortened_step_reaches_one_limit_and_violates_none(known, basis, limits, order):
    """The share at which the first Bernstein coefficient reaches a limit, by bisection."""
    feasibility, start = within(known, **limits), moved(at_rest(basis, POSE), wave(basis, 1, 0.01))
    step = wave(basis, 2, 4.0)
    share = feasibility.feasible_share(start, step)
    assert 0.0 < share < 1.0

    def holds(size):
        least, largest = moved(start, step, size).bounds(order)
        lower = np.broadcast_to(limits.get("lower", -FREE), 3) if order == 0 else -np.array(*limits.values())
        upper = np.broadcast_to(limits.get("upper", FREE), 3) if order == 0 else np.array(*limits.values())
        return bool(np.all(least >= lower) and np.all(largest <= upper))

    low, high = 0.0, 1.0
    for _ in range(60):
        low, high = (0.5 * (low + high), high) if holds(0.5 * (low + high)) else (low, 0.5 * (low + high))
    assert share == pytest.approx(low, rel=1e-9)
    assert feasibility.within_limits(moved(start, step, share))
    assert feasibility.feasible_share(moved(start, step, share), step) == 0.0  # not by as much as rounding leaves
    assert not feasibility.within_limits(moved(start, step, 1.0001 * share))


def test_the_effort_band_includes_the_model_error(basis):
    known = open_known(model_error_covariance=0.7)
    motion = moved(at_rest(basis, POSE), wave(basis)).motion(np.linspace(0.5, 2.5, 23))
    mean, sd = within(known).effort_band(motion)
    np.testing.assert_allclose(mean, known.model.effort(motion, known.theta), atol=1e-9)
    columns = known.columns(motion)
    covariance = np.linalg.inv(known.precision) + known.model_error_covariance
    want = np.sqrt(np.einsum("njr,rs,njs->nj", columns, covariance, columns))
    np.testing.assert_allclose(sd, want, rtol=1e-6)


def test_effort_limits_apply_to_the_band(known, basis):
    """A limit between the largest mean and the band's is violated in its joint; one above the band is not."""
    trajectory = moved(at_rest(basis, POSE), wave(basis))
    feasibility = within(known)
    mean, sd = feasibility.effort_band(trajectory.motion(np.linspace(0.0, 3.1, 3101)))
    alone, banded = np.abs(mean).max(axis=0), (np.abs(mean) + TUNING.effort_sds * sd).max(axis=0)
    assert np.all(banded > 1.05 * alone)
    for joint in range(3):
        for limit, holds in ((1.002 * alone, False), (0.995 * banded, False), (1.02 * banded, True)):
            effort = np.full(3, np.inf)
            effort[joint] = limit[joint]
            assert replace(feasibility, effort=effort).keeps_effort_limits(trajectory, 0.0, 3.1) == holds
    assert not within(known, effort=tuple(0.995 * banded)).is_feasible(trajectory)
    assert within(known, effort=tuple(1.02 * banded)).is_feasible(trajectory)


def test_an_effort_beyond_its_limit_between_samples_is_refused():
    """A parabola with its vertex half way between two samples: only the second difference shows it."""
    t = np.arange(7.0)
    mean = np.stack([5.0 - 0.8 * (t - 2.5) ** 2, 0.0 * t + 1.0, -5.0 + 0.8 * (t - 2.5) ** 2], axis=1)
    sd = np.tile([0.0, 0.25, 0.0], (7, 1))
    assert np.abs(mean[:6]).max() == pytest.approx(4.8)
    found = largest_efforts(mean[1:5], sd[1:5])
    assert found == pytest.approx([5.0, 1.0 + TUNING.effort_sds * 0.25, 5.0])


def test_largest_efforts_bound_those_between_samples(known):
    """At ten times the sampling rate no effort of random motions exceeds the bound; coarse samples miss some."""
    basis, missed = SplineBasis(5.0), 0
    feasibility = Feasibility.of(known, check_limits(LIMITS, known.model.robot), None)
    still = at_rest(basis, POSE)
    for seed in range(6):
        trajectory = moved(still, wave(basis, seed, 4.0), feasibility.feasible_share(still, wave(basis, seed, 4.0)))
        mean, sd = feasibility.effort_band(trajectory.motion(np.linspace(0.0, 5.0, 10_001)))
        finest = (np.abs(mean) + TUNING.effort_sds * sd).max(axis=0)
        coarse = feasibility.effort_band(trajectory.motion(np.linspace(0.0, 5.0, 1001)))
        bound = feasibility.largest_efforts(trajectory)
        assert np.all(bound >= finest)
        assert np.all(bound <= 1.05 * finest)
        missed += int(((np.abs(coarse[0]) + TUNING.effort_sds * coarse[1]).max(axis=0) < finest).sum())
    assert missed > 6


def test_steps_into_a_collision_are_refused(known, basis):
    wall = FakeClearance(joint=0, wall=0.1)
    feasibility, still = within(known, clearance=wall), at_rest(basis, POSE)
    up, other = np.zeros((len(basis), 3)), np.zeros((len(basis), 3))
    up[6:9, 0], other[6:9, 2] = 0.3, 3.0  # of its 0.25 rad up to the margin, three control points leave 0.28
    assert not feasibility.is_feasible(moved(still, up))
    assert feasibility.is_feasible(moved(still, up, 0.8))
    assert feasibility.is_feasible(moved(still, -up))
    assert feasibility.is_feasible(moved(still, other))
    assert within(known).is_feasible(moved(still, up))
