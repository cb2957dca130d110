"""The search for a motion: what it may try, what it keeps, and that its windows add up."""

from dataclasses import replace

import numpy as np
import pytest
from open_results import LIMITS, open_known

from bayesid.excitation.feasible import Feasibility
from bayesid.excitation.goals import goal_of, log_spread
from bayesid.excitation.known import information_of
from bayesid.excitation.limits import check_limits
from bayesid.excitation.search import INSTANTS, Design, MotionSearch
from bayesid.excitation.splines import ENDS, SplineBasis, SplineTrajectory
from bayesid.model.terms.hysteresis import Hysteresis
from bayesid.motion import Motion
from bayesid.simulation.trajectories import MotionLimits

POSE = np.array([-0.2, 0.5, 0.3])
DURATION = 3.0


class Watched(MotionSearch):
    """Remembers every motion that was the best, and what was tried of it."""

    def _changed(self, best, step):
        after = super()._changed(best, step)
        self.__dict__.setdefault("steps", []).append((best, after))
        self.__dict__.setdefault("tried", []).append(step)
        return after


class Wall:
    """The first joint must stay above -0.5 rad."""

    def stays_clear(self, path, t, speed):
        return bool(path(np.linspace(t[0], t[-1], 101))[:, 0].min() > -0.5)

    def distance(self, q):
        return q[:, 0] + 0.5


def search_of(known, kind=MotionSearch, whole=None, limits=LIMITS, clearance=None):
    goal = goal_of(known)
    n = known.model.robot.n_joints
    design = Design(
        known.columns,
        known.weights,
        lambda information: log_spread(goal, known.covariance(information)),
        whole=known.memory if whole is None else whole,
    )
    each = check_limits(limits, known.model.robot)
    return kind(design, Feasibility.of(known, each, clearance), SplineBasis(DURATION), POSE[:n])


@pytest.fixture(scope="module")
def known():
    return open_known()


@pytest.fixture(scope="module")
def searched(known):
    """Under limits of efforts that some motions within the others break."""
    efforts = largest_of(known)
    search = search_of(known, Watched, limits=replace(LIMITS, effort=efforts), clearance=Wall())
    trajectory = search.run(400, 4, lambda k: None)
    return search, trajectory


def largest_of(known):
    """Half as much again as standing still takes, with its band."""
    still = np.tile(POSE, (3, 1))
    motion = Motion(np.arange(3.0), still, 0.0 * still, 0.0 * still)
    columns = known.columns(motion)[0]
    mean, sd = columns @ known.mean, np.sqrt(np.einsum("jr,rs,js->j", columns, known.now, columns))
    return tuple((1.5 * (np.abs(mean) + 4.0 * sd) + 0.5).tolist())


def no_progress(k):
    pass


def kept(search):
    """Motions on the way, each once."""
    found = [search.steps[0][0], *(after for _, after in search.steps)]
    return list({id(one): one for one in found}.values())


# ---------------------------------------------------------------------------------------------------------------
# What is kept
# ---------------------------------------------------------------------------------------------------------------
def test_every_motion_on_the_way_is_possible(searched):
    """By a grid of 1 ms: positions, velocities, accelerations, efforts with their band, and the wall."""
    search, _ = searched
    limits, t = search.feasibility, np.linspace(0.0, DURATION, 3001)
    assert len(kept(search)) >= 20
    for tried in kept(search)[::3]:
        motion = tried.trajectory.motion(t)
        mean, sd = limits.effort_band(motion)
        assert np.all(motion.q >= limits.lower - 1e-9)
        assert np.all(motion.q <= limits.upper + 1e-9)
        assert np.all(np.abs(motion.dq) <= limits.rates[0] * (1.0 + 1e-9))
        assert np.all(np.abs(motion.ddq) <= limits.rates[1] * (1.0 + 1e-9))
        assert np.all(np.abs(mean) + 4.0 * sd <= limits.effort)
        assert motion.q[:, 0].min() > -0.5 - 1e-3
        np.testing.assert_allclose(motion.q[[0, -1]], [POSE, POSE], atol=1e-12)


def test_limits_of_efforts_and_the_wall_are_felt_by_the_search(known, searched):
    """Without them the same search finds motions that break both: they were no idle tests."""
    search, _ = searched
    free = search_of(known).run(400, 4, no_progress).motion(np.linspace(0.0, DURATION, 3001))
    mean, sd = search.feasibility.effort_band(free)
    assert np.any(np.abs(mean) + 4.0 * sd > search.feasibility.effort)
    assert free.q[:, 0].min() < -0.55


def test_the_worth_never_falls_and_rises(searched):
    search, trajectory = searched
    costs = np.array([after.cost for _, after in search.steps])
    assert np.all(np.diff(costs) <= 0.0)
    assert costs[-1] < costs[0] - 1.0
    assert search.steps[-1][1].trajectory is trajectory
    for before, after in search.steps:
        assert after is before or after.cost < before.cost
    assert search.cost(trajectory) == pytest.approx(costs[-1], rel=1e-9)


def test_what_was_no_better_is_tried_the_other_way_once(searched):
    search, _ = searched
    fresh, turned = True, 0
    for (before, after), step, following in zip(search.steps, search.tried, search.tried[1:], strict=False):
        failed = after is before
        if fresh and failed and step.any():
            np.testing.assert_array_equal(following, -step)
            turned += 1
        elif step.any():
            assert not np.array_equal(following, -step)
        fresh = not (fresh and failed)
    assert turned > 50


def test_it_starts_from_a_motion_that_uses_the_limits(known):
    """As good as a random motion of a robot is, but from rest to rest at the pose."""
    search = search_of(known)
    start = search.run(1, 0, no_progress)
    motion = start.motion(np.linspace(0.0, DURATION, 3001))
    limits = search.feasibility
    used = [
        np.abs(part).max(axis=0) / most for part, most in ((motion.dq, limits.rates[0]), (motion.ddq, limits.rates[1]))
    ]
    room = [(motion.q - limits.lower).min(axis=0), (limits.upper - motion.q).min(axis=0)] / (
        limits.upper - limits.lower
    )
    assert np.all((np.maximum(*used) > 0.6) | (room.min(axis=0) < 0.1))
    np.testing.assert_allclose(motion.q[[0, -1]], [POSE, POSE], atol=1e-12)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-9)


def test_a_change_that_is_not_possible_is_never_kept(known):
    """Nothing but the start, which is standing still, where nothing else is possible."""

    asked = []

    class Stubborn(Feasibility):
        def possible(self, trajectory, start=0.0, end=None):
            asked.append(trajectory)
            return False

    search = search_of(known)
    stubborn = replace(search, feasibility=Stubborn(**vars(search.feasibility)))
    found = stubborn.run(50, 1, no_progress)
    np.testing.assert_array_equal(found.control, np.tile(POSE, (len(search.basis), 1)))
    assert len(asked) > 20


def test_a_search_repeats_by_its_seed(known):
    search = search_of(known)
    first, again, other = (search.run(60, seed, no_progress).control for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.05


def test_all_changes_are_told(known):
    told = []
    search_of(known).run(25, 2, told.append)
    assert told == list(range(25))


# ---------------------------------------------------------------------------------------------------------------
# Windows
# ---------------------------------------------------------------------------------------------------------------
def test_what_windows_add_up_to_is_the_information_of_the_whole_motion(searched):
    """After hundreds of windows taken out and put in: rounding of 1e-9 of the largest entries is left."""
    search, trajectory = searched
    found = search.steps[-1][1]
    t = np.linspace(0.0, DURATION, round(DURATION * INSTANTS) + 1)
    known = search.feasibility.known
    whole = known.information(trajectory.motion(t), 1.0 / INSTANTS)
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
    assert np.abs((found.information - whole) / scale).max() < 1e-9
    np.testing.assert_allclose(found.columns, known.columns(trajectory.motion(t)), atol=1e-9)
    np.testing.assert_allclose(information_of(found.columns, found.weights), whole, atol=1e-9 * whole.max())


def test_a_change_moves_the_motion_in_its_window_alone(known):
    """Outside of the knots of the control points that moved, columns are those of before."""
    search, rng = search_of(known), np.random.default_rng(1)
    motion = SplineTrajectory(search.basis, np.tile(POSE, (len(search.basis), 1)))
    kinds = set()
    for _ in range(200):
        step = search._step(motion, rng)
        rows = np.flatnonzero(step.any(axis=1))
        assert step.shape == motion.control.shape
        if not len(rows):
            continue
        assert rows[0] >= ENDS
        assert rows[-1] < len(search.basis) - ENDS
        kinds.add(len(np.flatnonzero(step.any(axis=0))))
        start, end = search.basis.knots[rows[0]], search.basis.knots[rows[-1] + 6]
        outside = np.setdiff1d(np.arange(61), np.flatnonzero((search.instants > start) & (search.instants < end)))
        moved = replace(motion, control=motion.control + step).motion(search.instants)
        np.testing.assert_allclose(moved.q[outside], motion.motion(search.instants).q[outside], atol=1e-12)
    assert kinds == {1, 2, 3}


# ---------------------------------------------------------------------------------------------------------------
# Memory
# ---------------------------------------------------------------------------------------------------------------
def test_a_term_with_memory_is_judged_on_the_whole_motion():
    """Presliding depends on where a joint came from: a window alone would be wrong, and the whole is made afresh."""
    known = open_known(n=2, terms=("rigid_body", Hysteresis(width=(0.3, 0.5))))
    search = search_of(known, Watched, limits=MotionLimits(lower=-0.9, upper=1.1, velocity=1.5, acceleration=6.0))
    assert search.design.whole
    trajectory = search.run(60, 4, no_progress)
    found = search.steps[-1][1]
    motion = trajectory.motion(search.instants)
    np.testing.assert_allclose(found.information, known.information(motion, 1.0 / INSTANTS), rtol=1e-9, atol=1e-9)
    windowed = search_of(known, Watched, whole=False, limits=MotionLimits(lower=-0.9, upper=1.1, velocity=1.5))
    wrong = windowed.run(60, 4, no_progress)
    ends = windowed.steps[-1][1].information
    true = known.information(wrong.motion(windowed.instants), 1.0 / INSTANTS)
    assert np.abs(ends - true).max() > 1e-3 * np.abs(true).max()
