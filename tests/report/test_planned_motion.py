"""The picture of a planned motion: limits, bands, poses and distances are drawn where they are."""

import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import LineCollection

import bayesid
from bayesid.motion import Motion
from bayesid.report.plot.figure import MAGENTA
from bayesid.report.plot.motions import MotionPicture, Poses, extreme_poses, planned_motion, skeleton_line
from bayesid.robot.kinematics import pose
from bayesid.simulation.trajectories import MotionLimits

T = np.linspace(0.0, 4.0, 801)
SWING, CENTRE = np.array([0.7, -0.4, 1.1]), np.array([0.2, -0.5, 0.9])
W = 2.0 * np.pi * np.array([1.0, 2.0, 3.0]) / 4.0
MOTION = Motion(
    T,
    CENTRE + SWING * np.sin(np.outer(T, W)),
    SWING * W * np.cos(np.outer(T, W)),
    -SWING * W**2 * np.sin(np.outer(T, W)),
)
LIMITS = MotionLimits(
    lower=(-1.0, -np.inf, -0.5),
    upper=(1.5, 2.0, 1.9),
    velocity=(2.0, 3.0, 4.0),
    acceleration=np.inf,
    effort=(50.0, 8.0, 3.0),
)
ONE_POSE = Poses(np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]]), ("start",), np.array([[0.0, 0.0, 1.0]]))
EFFORT = np.array([20.0, 5.0, -2.0]) * np.sin(T)[:, None]
BAND = EFFORT - np.array([1.0, 2.0, 0.5]), EFFORT + np.array([1.5, 2.5, 0.25])
DISTANCE = 0.2 + 0.15 * np.cos(T) * np.sin(2.0 * T)
NAMES = ("left", "elbow", "wrist")
EXTREMES = ("start", "lowest tip", "highest tip", "farthest out", "least distance (1.23 s)")


def picture(**what):
    given = {"effort": EFFORT, "effort_band": BAND, "poses": ONE_POSE, "distance": DISTANCE, "margin": 0.03, **what}
    return MotionPicture("arm", NAMES, MOTION, LIMITS, **given)


def drawn(what):
    """Axes of curves (n, columns), and those below."""
    before = plt.get_fignums()
    figure = planned_motion(what)
    assert plt.get_fignums() == before
    above, below = figure.subfigs
    n = what.motion.n_joints
    return np.array(above.axes, dtype=object).reshape(n, -1), below.axes


def lines(ax, gid):
    """(N, 2) points of curves, straight lines and dots."""
    found = [line.get_xydata() for line in ax.lines if line.get_gid() == gid]
    for one in (one for one in ax.collections if one.get_gid() == gid):
        found += one.get_segments() if isinstance(one, LineCollection) else [np.asarray(one.get_offsets())]
    return found


def test_limits_are_lines_where_they_are_and_in_sight():
    axes, _ = drawn(picture())
    velocity, effort = ([{-limit, limit} for limit in some] for some in ((2.0, 3.0, 4.0), (50.0, 8.0, 3.0)))
    ends = [[{-1.0, 1.5}, {2.0}, {-0.5, 1.9}], velocity, [set(), set(), set()], effort]
    for column, rows in enumerate(ends):
        for ax, expected in zip(axes[:, column], rows, strict=True):
            assert {line[0, 1] for line in lines(ax, "limit")} == expected
            low, high = ax.get_ylim()
            assert all(low < end < high for end in expected)


def test_curves_are_the_motion_with_its_extremes():
    axes, _ = drawn(picture())
    for column, values in enumerate((MOTION.q, MOTION.dq, MOTION.ddq, EFFORT)):
        for j, ax in enumerate(axes[:, column]):
            (curve,) = lines(ax, "curve")
            np.testing.assert_array_equal(curve[:, 1], values[np.searchsorted(T, curve[:, 0]), j])
            assert (curve[:, 1].min(), curve[:, 1].max()) == (values[:, j].min(), values[:, j].max())
            low, high = ax.get_ylim()
            assert low < values[:, j].min() < values[:, j].max() < high
    for j, ax in enumerate(axes[:, 3]):
        (band,) = [one for one in ax.collections if one.get_gid() == "band"]
        y = band.get_paths()[0].vertices[:, 1]
        assert y.min() == pytest.approx(BAND[0][:, j].min(), abs=1e-3)
        assert y.max() == pytest.approx(BAND[1][:, j].max(), abs=1e-3)


def test_margins_are_told_and_what_goes_beyond_stands_out():
    """Positions by what is left, the rest by what is used, efforts with their band."""
    axes, _ = drawn(picture())

    def told(ax):
        """Number and whether it stands out."""
        (text,) = [one for one in ax.texts if "limit" in one.get_text()]
        return float(re.findall(r"[\d.]+", text.get_text())[0]), text.get_color() == MAGENTA

    assert [told(ax) for ax in axes[:, 0]] == [(0.5, False), (2.1, False), (0.1, True)]
    efforts = np.maximum(-BAND[0].min(axis=0), BAND[1].max(axis=0))
    for column, used in ((1, np.abs(SWING * W) / np.array(LIMITS.velocity)), (3, efforts / np.array(LIMITS.effort))):
        for ax, share in zip(axes[:, column], used, strict=True):
            assert told(ax) == (float(f"{100.0 * share:.0f}"), share > 1.0)
    assert not axes[1, 2].texts, "no limit, nothing said"


def test_extreme_poses_of_a_robot():
    robot, t = bayesid.load_robot("ur10e"), np.linspace(0.0, 3.0, 301)
    q = np.array([0.3, -1.2, 1.0, -0.4, 0.6, 0.2]) + np.outer(np.sin(t), [0.8, 0.5, -0.9, 0.3, 0.2, 0.1])
    tip = np.stack([pose(robot, row).flange[:3, 3] for row in q])
    poses = extreme_poses(robot, Motion(t, q, 0.0 * q, 0.0 * q), np.abs(t - 1.234) + 0.1)
    ends = {label: line[~np.isnan(line[:, 0])][-1] for label, line in zip(poses.labels, poses.points, strict=True)}
    said = {name: next(end for label, end in ends.items() if name in label) for name in EXTREMES}
    np.testing.assert_allclose(said["start"], tip[0], atol=1e-12)
    assert said["lowest tip"][2] == pytest.approx(tip[:, 2].min(), abs=1e-12)
    assert said["highest tip"][2] == pytest.approx(tip[:, 2].max(), abs=1e-12)
    assert np.hypot(*said["farthest out"][:2]) == pytest.approx(np.hypot(*tip[:, :2].T).max(), abs=1e-12)
    np.testing.assert_allclose(said["least distance (1.23 s)"], tip[123], atol=1e-12)
    np.testing.assert_array_equal(poses.points[0], skeleton_line(robot, q[0]))
    _, (side, _, distance) = drawn(picture(poses=poses))
    np.testing.assert_array_equal(lines(side, poses.labels[0])[0], poses.points[0][:, [0, 2]])
    assert lines(distance, "least")[0][0, 1] == DISTANCE.min()
