"""A simulated arm meets an obstacle, and the contact is found from |effort| alone.

MuJoCo moves the arm: bodies, dry friction, rotors and contact forces are its own, and its controller is a PD with
feed-forward. bayesid sees positions with the noise of encoders, and absolute values of noisy efforts. A first run is
identified; in a second one a soft ball is held in the way of the flange. MuJoCo is in the extra `studies`.

    python contact.py
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

import bayesid

RATE, STEPS = 200.0, 5  # samples a second; steps of the simulation a sample
ENCODER, SENSOR = 5e-6, 0.01  # sd of positions, rad (encoders at motors), and of efforts as a share of the largest
STIFFNESS = 30.0  # rad/s of the controller's closed loop
TERMS = ["rigid_body", "viscous_friction", "coulomb_friction", "rotor_inertia"]
TIP, BALL = 0.06, 0.08  # m, radii at the flange and of the obstacle
SOFT = {"solref": [0.4, 1.0], "solimp": [0.02, 0.02, 0.001, 0.5, 2.0]}  # some 10 N at the flange's speed
AWAY = np.array([0.0, 0.0, 50.0])
BEGIN = 5.0  # s, of the contact
Disturbance = Callable[[float, mujoco.MjData], None]


@dataclass(frozen=True)
class Arm:
    """A robot in MuJoCo, with the model that it was made from."""

    model: bayesid.Model
    theta: np.ndarray
    simulated: mujoco.MjModel


@dataclass(frozen=True)
class Recording:
    """What the arm did: t (N,); q, efforts as a sensor has them and, known to MuJoCo alone, external torques (N, n)."""

    t: np.ndarray
    q: np.ndarray
    effort: np.ndarray
    external: np.ndarray


def make_arm(seed: int = 2) -> Arm:
    """A KR5 with random bodies, friction and rotors, a ball at its flange and one that can be put in its way."""
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
    """The arm along a trajectory, sampled; `disturb` may put obstacles in its way or push it at every step."""
    simulated, data, rng = arm.simulated, mujoco.MjData(arm.simulated), np.random.default_rng(seed)
    wanted = trajectory.motion(np.arange(round(seconds * RATE) * STEPS) / (RATE * STEPS))
    forward = arm.model.effort(wanted, arm.theta)
    data.qpos[:], data.qvel[:] = wanted.q[0], wanted.dq[0]
    stiffness, damping = STIFFNESS**2 * simulated.dof_M0, 2.0 * STIFFNESS * simulated.dof_M0
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
    return Recording(wanted.t[::STEPS], q + ENCODER * rng.normal(size=q.shape), effort + noise, external)


def contact_torque(simulated: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(n,) J' f of all contacts, N m."""
    torque, first = np.zeros(simulated.nv), int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
    mujoco.mj_mulJacTVec(simulated, data, torque, np.where(data.efc_type >= first, data.efc_force, 0.0))
    return torque


def hold_in_the_way(arm: Arm, trajectory: bayesid.FourierTrajectory, begin: float, seconds: float) -> Disturbance:
    """The ball where the flange comes to touch it at an instant, s, taken away some time later."""
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
    """The arm's model, from a run without contact and without any sign."""
    n = arm.model.robot.n_joints
    free = record(arm, bayesid.random_trajectory(n, 20.0, rng=3), 20.0, seed=1)
    log = bayesid.Log(free.t, free.q, np.abs(free.effort), np.zeros(n, dtype=bool))
    return bayesid.identify(arm.model.robot, log, TERMS, complete="off", posterior=False)


def track(tracker: bayesid.SignTracker, run: Recording) -> list[bayesid.types.TrackedSample]:
    """A run as a stream: one update a sample."""
    return [tracker.update(*sample) for sample in zip(run.t, run.q, np.abs(run.effort), strict=True)]


def tell(run: Recording, seen: list[bayesid.types.TrackedSample]) -> str:
    """When the contact began and when that was said, and the observer's torques beside the true ones."""
    touching = run.external.any(axis=1)
    began, ended = run.t[touching][[0, -1]]
    felt = sorted({joint for now, there in zip(seen, touching, strict=True) if there for joint in now.contact})
    lines = [f"The flange touches the ball from {began:.3f} s to {ended:.3f} s; it is felt by joints {felt}"]
    for alarm in (alarm for now in seen for alarm in now.alarms):
        late = 1e3 * (alarm.raised - began)
        lines.append(f"{alarm.kind}: said at {alarm.raised:.3f} s, {late:.0f} ms after, of joint {alarm.joint}")
    external, threshold = (np.array([getattr(now, name) for now in seen]) for name in ("external", "threshold"))
    off = np.sqrt(np.mean((external - run.external)[touching] ** 2, axis=0))
    size, limit = np.sqrt(np.mean(run.external[touching] ** 2, axis=0)), np.median(threshold[touching], axis=0)
    lines.append("joint  J'f, rms  observer's error, rms  threshold   N m")
    lines += [f"{j + 1:5}  {size[j]:8.3f}  {off[j]:21.3f}  {limit[j]:9.3f}" for j in range(len(off))]
    return "\n".join(lines)


def meet(arm: Arm) -> Recording:
    """Another motion, in which the ball is in the way for 0.3 s."""
    other = bayesid.random_trajectory(arm.model.robot.n_joints, 20.0, rng=5)
    return record(arm, other, 8.0, seed=2, disturb=hold_in_the_way(arm, other, BEGIN, 0.3))


if __name__ == "__main__":
    arm = make_arm()
    run = meet(arm)
    print(tell(run, track(bayesid.SignTracker(identify(arm), rate=RATE), run)))
