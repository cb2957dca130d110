"""A simulated arm meets an obstacle, and the contact is found from |effort| alone.

MuJoCo moves the arm: bodies, dry friction, rotors and contact forces are its own, and its controller is a PD with
feed-forward. bayesid sees positions with the noise of encoders, and absolute values of noisy efforts. A first run is
identified; in a second one a soft ball is held in the way of the flange.

    python contact.py --out contact
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import bayesid
from bayesid.report.plot.style import dress, legend, new_figure

RATE, STEPS = 200.0, 5  # samples a second; steps of the simulation a sample
ENCODER, SENSOR = 2e-5, 0.01  # sd of positions, rad, and of efforts as a share of the joint's largest
STIFFNESS = 30.0  # rad/s of the controller's closed loop
TERMS = ["rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia"]
TIP, BALL = 0.06, 0.08  # m, radii at the flange and of the obstacle
AWAY = np.array([0.0, 0.0, 50.0])


@dataclass(frozen=True)
class Arm:
    """A robot in MuJoCo, with the model that it was made from."""

    model: bayesid.Model
    theta: np.ndarray
    simulated: mujoco.MjModel

    def largest(self, trajectory: bayesid.FourierTrajectory) -> np.ndarray:
        """(n,) largest efforts of a motion, N m."""
        return np.abs(self.model.effort(trajectory.motion(np.arange(0.0, 20.0, 0.01)), self.theta)).max(axis=0)


@dataclass(frozen=True)
class Recording:
    """What the arm did: t (N,), q, |effort| and, known to the simulation alone, external torques (N, n)."""

    t: np.ndarray
    q: np.ndarray
    effort: np.ndarray
    external: np.ndarray


Disturbance = Callable[[float, mujoco.MjData], None]


def make_arm(seed: int = 2) -> Arm:
    """A KR5 with random bodies, friction and rotors, a ball at its flange and one that can be put in its way."""
    robot = bayesid.load_robot("kr5")
    motion = bayesid.random_trajectory(robot.n_joints, 20.0, seed=1).motion(np.arange(0.0, 20.0, 0.01))
    model = bayesid.Model(robot, bayesid.make_terms(TERMS, robot, motion))
    theta = bayesid.random_parameters(model, np.random.default_rng(seed))
    spec = mujoco.MjSpec.from_string(bayesid.mjcf(model, theta))
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    spec.body(f"link{robot.n_joints}").add_geom(name="tip", type=sphere, size=[TIP, 0, 0], mass=0.0)
    obstacle = spec.worldbody.add_body(name="obstacle", mocap=True, pos=AWAY)
    obstacle.add_geom(name="ball", type=sphere, size=[BALL, 0, 0], solref=[0.08, 1.0], solimp=[0.1, 0.9, 0.05, 0.5, 2])
    return Arm(model, theta, spec.compile())


def record(
    arm: Arm, trajectory: bayesid.FourierTrajectory, seconds: float, seed: int, disturb: Disturbance | None = None
) -> Recording:
    """The arm along a trajectory, sampled; `disturb` may put obstacles in its way or push it at every step."""
    simulated, data, rng = arm.simulated, mujoco.MjData(arm.simulated), np.random.default_rng(seed)
    wanted = trajectory.motion(np.arange(round(seconds * RATE) * STEPS) / (RATE * STEPS))
    forward = arm.model.effort(wanted, arm.theta)
    data.qpos[:], data.qvel[:] = wanted.q[0], wanted.dq[0]
    mujoco.mj_forward(simulated, data)
    inertia = np.array([moment_of(simulated, data, j) for j in range(simulated.nv)])
    stiffness, damping = STIFFNESS**2 * inertia, 2.0 * STIFFNESS * inertia
    rows = []
    for k, effort in enumerate(forward):
        effort = effort + stiffness * (wanted.q[k] - data.qpos) + damping * (wanted.dq[k] - data.qvel)
        data.ctrl[:] = effort
        if disturb is not None:
            disturb(wanted.t[k], data)
        q = data.qpos.copy()
        mujoco.mj_step(simulated, data)  # forces afterwards are those at q
        if k % STEPS == 0:
            rows.append((q, effort, data.qfrc_applied + contact_torque(simulated, data)))
    q, effort, external = (np.array(part) for part in zip(*rows, strict=True))
    noise = SENSOR * np.abs(forward).max(axis=0) * rng.normal(size=effort.shape)
    return Recording(wanted.t[::STEPS], q + ENCODER * rng.normal(size=q.shape), np.abs(effort + noise), external)


def moment_of(simulated: mujoco.MjModel, data: mujoco.MjData, j: int) -> float:
    """Inertia about joint j (from 0) in this pose, kg m^2."""
    along = np.zeros(simulated.nv)
    mujoco.mj_mulM(simulated, data, along, np.eye(simulated.nv)[j])
    return float(along[j])


def contact_torque(simulated: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(n,) J' f of all contacts of the flange, N m."""
    torque, wrench, jacobian = np.zeros(simulated.nv), np.zeros(6), np.zeros((3, simulated.nv))
    for i, contact in enumerate(data.contact):
        mujoco.mj_contactForce(simulated, data, i, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # from the first geom upon the second
        second = simulated.geom_bodyid[contact.geom[1]]
        body = simulated.geom("tip").bodyid[0]
        mujoco.mj_jac(simulated, data, jacobian, None, contact.pos, body)
        torque += jacobian.T @ (force if second == body else -force)
    return torque
