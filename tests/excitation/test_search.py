from dataclasses import replace

import numpy as np
import pytest
from open_results import LIMITS, open_known

from bayesid.effects.hysteresis import Hysteresis
from bayesid.excitation.goal import goal_of
from bayesid.excitation.limits import check_limits
from bayesid.excitation.search import MotionSearch
from bayesid.excitation.splines import Feasibility, SplineBasis, at_rest
from bayesid.simulation.trajectories import MotionLimits

POSE = np.array([-0.2, 0.5, 0.3])
DURATION = 3.0
FINE = np.linspace(0.0, DURATION, 3001)


class Wall:
    """The first joint must stay above -0.5 rad."""

    def stays_clear(self, path, t, speed):
        return bool(path(np.linspace(t[0], t[-1], 101))[:, 0].min() > -0.5)

    def distance(self, q):
        return q[:, 0] + 0.5


class Watched(Feasibility):
    """Records every feasible change with its window; only better ones are checked."""

    def is_feasible(self, trajectory, start=0.0, end=None):
        found = super().is_feasible(trajectory, start, end)
        if found and end is not None:
            self.__dict__.setdefault("kept", []).append((trajectory, start, end))
        return found


def search_of(known, whole=None, limits=LIMITS, clearance=None):
    """A search, and the list of all information at which its objective was evaluated."""
    goal, asked = goal_of(known), []

    def worth(information):
        asked.append(information)
        return goal.log_det(known.covariance(information))

    whole = known.memory if whole is None else whole
    feasibility = Feasibility.of(known, check_limits(limits, known.model.robot), clearance)
    pose = POSE[: known.model.robot.n_joints]
    watched = Watched(**vars(feasibility))
    return MotionSearch(known.columns, known.weights, worth, whole, watched, SplineBasis(DURATION), pose), asked


@pytest.fixture(scope="module")
def known():
    return open_known()


@pytest.fixture(scope="module")
def searched(known):
    """With effort limits that some motions within the other limits violate."""
    search, _ = search_of(known, limits=replace(LIMITS, effort=largest_of(known)), clearance=Wall())
    _, trajectory = search.run(400, 4)
    return search, search.feasibility.kept, trajectory


def largest_of(known):
    """1.5 times the efforts at standstill, with their band."""
    still = at_rest(SplineBasis(DURATION), POSE).motion(np.arange(3.0))
    mean, sd = Feasibility.of(known, check_limits(LIMITS, known.model.robot), None).effort_band(still)
    return tuple((1.5 * (np.abs(mean) + 4.0 * sd) + 0.5)[0].tolist())


def test_every_accepted_motion_is_feasible(searched):
    """By a grid of 1 ms: positions, velocities, accelerations, efforts with their band, and the wall."""
    search, kept, _ = searched
    limits = search.feasibility
    assert len(kept) >= 20
    for trajectory, *_ in kept[::3]:
        motion = trajectory.motion(FINE)
        mean, sd = limits.effort_band(motion)
        assert np.all((motion.q >= limits.lower - 1e-9) & (motion.q <= limits.upper + 1e-9))
        assert np.all(np.abs(motion.dq) <= limits.rates[0] * (1.0 + 1e-9))
        assert np.all(np.abs(motion.ddq) <= limits.rates[1] * (1.0 + 1e-9))
        assert np.all(np.abs(mean) + 4.0 * sd <= limits.effort)
        assert motion.q[:, 0].min() > -0.5 - 1e-3
        np.testing.assert_allclose(motion.q[[0, -1]], [POSE, POSE], atol=1e-12)


def test_the_objective_falls_with_every_accepted_change(searched):
    search, kept, trajectory = searched
    costs = np.array([search.cost(one) for one, *_ in kept])
    assert np.all(np.diff(costs) < 0.0)
    assert costs[-1] < costs[0] - 1.0
    assert kept[-1][0] is trajectory


def off(known, whole, **options):
    """Relative error of the information that is summed over windows."""
    search, asked = search_of(known, whole=whole, **options)
    _, trajectory = search.run(120, 4)
    true = known.information(trajectory.motion(search.times))
    scale = np.sqrt(np.outer(np.diag(true), np.diag(true))) + 1e-9 * true.max()
    return min(np.abs((one - true) / scale).max() for one in asked)


def test_information_of_windows_adds_up_to_that_of_the_motion(known):
    """Presliding depends on earlier samples: a window alone would be wrong, so the whole motion is evaluated."""
    assert off(known, None) < 1e-9
    slipping = open_known(n=2, terms=("rigid_body", Hysteresis(width=(0.3, 0.5))))
    limits = MotionLimits(lower=-0.9, upper=1.1, velocity=1.5, acceleration=6.0)
    assert off(slipping, None, limits=limits) < 1e-9
    assert off(slipping, False, limits=limits) > 1e-3
