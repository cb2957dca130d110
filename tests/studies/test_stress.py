"""Robots and motions under stress: derivatives by differences, efforts by closed forms."""

import numpy as np
import pytest

from bayesid.studies import blind
from bayesid.studies.stress import MOTIONS, bare_robot, held, point_to_point


def test_speeds_and_accelerations_are_derivatives():
    t, step = np.linspace(-1.0, 23.0, 5001), 1e-5
    for name, make in MOTIONS.items():
        motion = make(np.random.default_rng(0), 3)
        ahead, here, behind = (motion(t + k * step) for k in (1, 0, -1))
        for order in (0, 1):
            error = np.abs((ahead[order] - behind[order]) / (2.0 * step) - here[order + 1])
            least = 0.001 if name == "point to point" else 0.0  # a trapezoid's acceleration jumps
            assert np.mean(error > 1e-4 * (1.0 + np.abs(here[order + 1]))) <= least, name


def test_a_joint_at_rest_is_held_by_any_share_of_its_dry_friction():
    rng = np.random.default_rng(1)
    arm = bare_robot(rng, "random")
    arm = blind.with_joints(rng, arm, blind.Play(arm, blind.random_series(rng, arm.n, False)))
    motion, t = point_to_point(rng, arm.n), blind.times()
    torque, resting = held(arm, motion, t, rng), motion.resting(blind.times())
    assert np.all(torque[~resting] == 0.0)
    share = torque[resting] / arm.coulomb
    assert np.abs(share).max() <= 1.0
    assert share.min() < -0.3
    assert share.max() > 0.3
    rests = np.flatnonzero(np.diff(resting.astype(int)) == 1) + 1
    assert all(np.ptp(torque[a : a + 10], axis=0).max() == 0.0 for a in rests)  # constant in each


@pytest.mark.parametrize(("kind", "length", "draw"), [("pendulum", 0.0, 0), ("lever", 0.5, 3)])
def test_a_pendulum_by_its_closed_form(kind, length, draw):
    """tau = (J + m r^2) ddq + g m x, x the level distance of its centre from the axis; gravity along -y."""
    pendulum = bare_robot(np.random.default_rng(draw), kind)
    q, dq, ddq = (x[:, None] for x in np.random.default_rng(9).normal(size=(3, 20)))
    (body,), (joint,) = pendulum.links, pendulum.table["joints"]
    assert joint["a"] == length
    along, across = body.centre[0] + joint["a"], body.centre[1]
    inertia = body.inertia[2, 2] + body.mass * (along**2 + across**2)
    angle = q + joint["theta"]
    expected = inertia * ddq + 9.81 * body.mass * (along * np.cos(angle) - across * np.sin(angle))
    np.testing.assert_allclose(pendulum.rigid_efforts(q, dq, ddq), expected, rtol=1e-9, atol=1e-9)
