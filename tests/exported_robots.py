"""Six robots that differ, for what other programs read: both conventions, coupled, sliding, branched, URDF."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
from oracles import random_table, urdf_text

from bayesid.robot import Joint, Robot, load_robot, robot_from_table, robot_from_urdf


def branched(parents, seed=0):
    """Joints about all three axes, every third one slides, in skewed frames."""
    rng, n = np.random.default_rng(seed), len(parents)
    frames = np.tile(np.eye(4), (n, 1, 1))
    frames[:, :3, 3] = rng.normal(size=(n, 3))
    frames[:, :3, :3] = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    frames[:, :3, 0] *= np.linalg.det(frames[:, :3, :3])[:, None]
    joints = tuple(Joint(f, np.eye(3)[i % 3], i % 3 == 1, parents[i]) for i, f in enumerate(frames))
    return Robot("tree", joints, np.array([1.0, -2.0, -9.0]))


ROBOTS = {
    "ur10e": load_robot("ur10e"),
    "standard": robot_from_table(random_table("standard", 6, seed=1), "test"),
    "modified": robot_from_table(random_table("modified", 7, seed=2), "test"),
    "tx40": load_robot("tx40"),
    "tree": branched([-1, 0, 1, 0, 3, -1]),
    "urdf": replace(robot_from_urdf(urdf_text(), "test"), gravity=np.array([1.0, -2.0, -9.0])),
}
"""Joints that slide are in `standard`, `modified`, `tree` and `urdf`; motor 6 of the TX40 moves joints 5 and 6."""
COUPLED = replace(robot_from_table(random_table("modified", 4, seed=3, coupled=True), "test"), name="coupled")
"""Each motor moves several joints."""


def in_mujoco(loaded, motion):
    """(N, n) joint torques that MuJoCo finds; it counts joints depth first, which need not be joint 1, 2, ..."""
    data, order, found = mujoco.MjData(loaded), dofs(loaded), []
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        data.qpos[order], data.qvel[order], data.qacc[order] = q, dq, ddq
        mujoco.mj_inverse(loaded, data)
        found.append(data.qfrc_inverse[order])
    return np.array(found)


def dofs(loaded):
    """Which of MuJoCo's joints is joint 1, 2, ..."""
    names = sorted((loaded.joint(i).name for i in range(loaded.njnt)), key=lambda name: int(name.strip("joint")))
    return [loaded.joint(name).dofadr[0] for name in names]


def in_pinocchio(loaded, gravity, motion):
    """(N, n) joint torques of the rigid bodies; Pinocchio reads no gravity."""
    loaded.gravity.linear = gravity
    data = loaded.createData()
    rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
    return np.array([pin.rnea(loaded, data, *row) for row in rows])
