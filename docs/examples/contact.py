"""A simulated arm touches an obstacle, and the contact is detected from |effort| alone.

MuJoCo simulates the arm, its friction and the contact, under PD control with feed-forward. bayesid gets positions with
encoder noise, and absolute values of noisy efforts. The model is identified from a first run. In a second run a soft
ball is in the path of the flange. MuJoCo is in the extra `studies`.

    python contact.py
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

import bayesid

RATE, STEPS = 200.0, 5  # sampling rate, Hz; simulation steps per sample
ENCODER, SENSOR = 5e-6, 0.01  # sd of positions, rad (encoders at motors), and of efforts, share of the largest
STIFFNESS = 30.0  # natural frequency of the controller, rad/s
TERMS = ["rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia"]
TIP, BALL = 0.06, 0.08  # m, radii at the flange and of the obstacle
SOFT = {"solref": [0.4, 1.0], "solimp": [0.02, 0.02, 0.001, 0.5, 2.0]}  # some 10 N at the flange's speed
AWAY = np.array([0.0, 0.0, 50.0])  # m, place of the ball without contact
BEGIN = 5.0  # s, start of the contact
Disturbance = Callable[[float, mujoco.MjData], None]


@dataclass(frozen=True)
class Arm:
    """A robot in MuJoCo, and the model behind it."""

    model: bayesid.Model
    theta: np.ndarray
    simulated: mujoco.MjModel


@dataclass(frozen=True)
class Recording:
    """A run: t (N,); q, measured efforts and true external torques (N, n)."""

    t: np.ndarray
    q: np.ndarray
    effort: np.ndarray
    external: np.ndarray


def make_arm(seed: int = 2) -> Arm:
    """A KR5 with random bodies, friction and rotors, a ball at its flange, and a ball as obstacle."""
    robot = bayesid.load_robot("kr5-paper")
    motion = bayesid.random_trajectory(robot.n_joints, 20.0, rng=1).motion(np.arange(0.0, 20.0, 0.01))
    model = bayesid.Model.of(robot, TERMS, motion)
    theta = bayesid.random_parameters(model, rng=np.random.default_rng(seed))
    spec = mujoco.MjSpec.from_string(model.to_mjcf(theta))
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    spec.body(f"link{robot.n_joints}").add_geom(name="tip", type=sphere, size=[TIP, 0, 0], mass=0.0)
    obstacle = spec.worldbody.add_body(name="obstacle", mocap=True, pos=AWAY)
    obstacle.add_geom(name="ball", type=sphere, size=[BALL, 0, 0], priority=1, **SOFT)
    return Arm(model, theta, spec.compile())


def record(
    arm: Arm, trajectory: bayesid.FourierTrajectory, seconds: float, seed: int, disturb: Disturbance | None = None
) -> Recording:
    """Samples of the arm on a trajectory; `disturb` may move obstacles or push the arm at every step."""
    simulated, data, rng = arm.simulated, mujoco.MjData(arm.simulated), np.random.default_rng(seed)
    desired = trajectory.motion(np.arange(round(seconds * RATE) * STEPS) / (RATE * STEPS))
    forward = arm.model.effort(desired, arm.theta)
    data.qpos[:], data.qvel[:] = desired.q[0], desired.dq[0]
    stiffness, damping = STIFFNESS**2 * simulated.dof_M0, 2.0 * STIFFNESS * simulated.dof_M0
    rows = []
    for k, effort in enumerate(forward):
        effort = effort + stiffness * (desired.q[k] - data.qpos) + damping * (desired.dq[k] - data.qvel)
        data.ctrl[:] = effort
        if disturb is not None:
            disturb(desired.t[k], data)
        q = data.qpos.copy()
        mujoco.mj_step(simulated, data)  # forces afterwards are those at q
        if k % STEPS == 0:
            rows.append((q, effort, data.qfrc_applied + contact_torque(simulated, data)))
    q, effort, external = (np.array(part) for part in zip(*rows, strict=True))
    noise = SENSOR * np.abs(forward).max(axis=0) * rng.normal(size=effort.shape)
    return Recording(desired.t[::STEPS], q + ENCODER * rng.normal(size=q.shape), effort + noise, external)


def contact_torque(simulated: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(n,) J' f of all contacts, N m."""
    torque, first = np.zeros(simulated.nv), int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
    mujoco.mj_mulJacTVec(simulated, data, torque, np.where(data.efc_type >= first, data.efc_force, 0.0))
    return torque


def obstacle_on(arm: Arm, trajectory: bayesid.FourierTrajectory, begin: float, seconds: float) -> Disturbance:
    """Puts the ball where the flange touches it at a time, s, and removes it some seconds later."""
    data, places = mujoco.MjData(arm.simulated), []
    for q in trajectory.motion(np.array([begin, begin + 0.01])).q:
        data.qpos[:] = q
        mujoco.mj_kinematics(arm.simulated, data)
        places.append(data.geom("tip").xpos.copy())
    ahead = (places[1] - places[0]) / np.linalg.norm(places[1] - places[0])

    def disturb(t: float, data: mujoco.MjData) -> None:
        data.mocap_pos[0] = places[0] + (TIP + BALL) * ahead if begin - 0.2 <= t < begin + seconds else AWAY

    return disturb


def identify(arm: Arm) -> bayesid.Identification:
    """The model identified from a run without contact and without signs."""
    n = arm.model.robot.n_joints
    free = record(arm, bayesid.random_trajectory(n, 20.0, rng=3), 20.0, seed=1)
    log = bayesid.Log(free.t, free.q, np.abs(free.effort), np.zeros(n, dtype=bool))
    return bayesid.identify(arm.model.robot, log, TERMS, complete="off", posterior=False)


def track(tracker: bayesid.SignTracker, run: Recording) -> list[bayesid.types.TrackedSample]:
    """Tracks a run sample by sample."""
    return [tracker.update(*sample) for sample in zip(run.t, run.q, np.abs(run.effort), strict=True)]


def summary(run: Recording, tracked: list[bayesid.types.TrackedSample]) -> str:
    """Time of the contact and of its detection, and external torques by the observer with their true values."""
    touching = run.external.any(axis=1)
    began, ended = run.t[touching][[0, -1]]
    joints = sorted({joint for now, touches in zip(tracked, touching, strict=True) if touches for joint in now.contact})
    lines = [f"The flange touches the ball from {began:.3f} s to {ended:.3f} s; contact in joints {joints}"]
    for alarm in (alarm for now in tracked for alarm in now.alarms):
        delay = 1e3 * (alarm.raised - began)
        lines.append(f"{alarm.kind}: detected at {alarm.raised:.3f} s, {delay:.0f} ms later, joint {alarm.joint}")
    external, threshold = (np.array([getattr(now, name) for now in tracked]) for name in ("external", "threshold"))
    error = np.sqrt(np.mean((external - run.external)[touching] ** 2, axis=0))
    size, limit = np.sqrt(np.mean(run.external[touching] ** 2, axis=0)), np.median(threshold[touching], axis=0)
    lines.append("joint  RMS torque  RMS error of observer  threshold   N m")
    lines += [f"{j + 1:5}  {size[j]:10.3f}  {error[j]:21.3f}  {limit[j]:9.3f}" for j in range(len(error))]
    return "\n".join(lines)


def run_with_contact(arm: Arm) -> Recording:
    """Another motion, with the ball in the path for 0.3 s."""
    other = bayesid.random_trajectory(arm.model.robot.n_joints, 20.0, rng=5)
    return record(arm, other, 8.0, seed=2, disturb=obstacle_on(arm, other, BEGIN, 0.3))


if __name__ == "__main__":
    arm = make_arm()
    run = run_with_contact(arm)
    print(summary(run, track(bayesid.SignTracker(identify(arm), rate=RATE), run)))
