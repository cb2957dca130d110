"""Rigid-body dynamics worked out apart from bayesid: textbook frames, point masses, the principle of virtual work."""

from __future__ import annotations

import tomllib
from importlib import resources

import numpy as np

from bayesid.motion import Motion

STEP = 1e-30  # of complex-step derivatives, which are exact to rounding


def built_in_table(name):
    name = {"kr5": "kr5-paper"}.get(name, name)
    return tomllib.loads((resources.files("bayesid.robot") / "robots" / f"{name}.toml").read_text())


def random_table(convention, n, seed, coupled=False):
    """A DH file's table: skewed axes, one joint in three prismatic, tilted gravity, perhaps coupled motors."""
    rng = np.random.default_rng(seed)
    joints = [
        {
            **dict(zip(("a", "d"), rng.uniform(-0.5, 0.5, 2).tolist(), strict=True)),
            **dict(zip(("alpha", "theta"), rng.uniform(-3.0, 3.0, 2).tolist(), strict=True)),
            "type": "prismatic" if (i + seed) % 3 == 2 else "revolute",
        }
        for i in range(n)
    ]
    table = {"name": "random", "convention": convention, "joints": joints, "gravity": [2.0, -3.5, 8.5]}
    if coupled:
        gears = np.diag(rng.uniform(20, 120, n) * rng.choice([-1, 1], n)) + rng.uniform(-9, 9, (n, n))
        table["transmission"] = gears.tolist()
    return table


def random_motion(n, samples=4, seed=0):
    rng = np.random.default_rng(seed)
    q, dq, ddq = rng.uniform(-3, 3, (3, samples, n))
    return Motion(np.arange(samples) / 100, q, dq, ddq)


# Frames: a chain takes joint positions to the links' frames and the joints' axes (origin, direction, whether it slides)
def dh_chain(table):
    """As in Spong, Hutchinson, Vidyasagar (standard) and in Craig (modified), where joint i turns about z_i."""

    def standard(a, alpha, d, theta):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        return [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]

    def modified(a, alpha, d, theta):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        return [[ct, -st, 0, a], [st * ca, ct * ca, -sa, -sa * d], [st * sa, ct * sa, ca, ca * d], [0, 0, 0, 1]]

    def chain(q):
        frames, axes, frame = [], [], np.eye(4)
        for row, x in zip(table["joints"], q, strict=True):
            slides = row.get("type") == "prismatic"
            theta, d = (row["theta"], row["d"] + x) if slides else (row["theta"] + x, row["d"])
            matrix = {"standard": standard, "modified": modified}[table["convention"]]
            after = frame @ np.array(matrix(row["a"], row["alpha"], d, theta))
            turning = frame if table["convention"] == "standard" else after
            axes.append((turning[:3, 3], turning[:3, 2], slides))
            frames.append(after)
            frame = after
        return frames, axes

    return chain


# A URDF arm with everything that could go wrong: (type, xyz, rpy, axis as written)
URDF_JOINTS = (
    ("fixed", (0.1, -0.2, 0.5), (0.3, 0.2, -0.4), None),
    ("continuous", (0.0, 0.05, 0.1), (-0.7, 1.1, 2.9), (0.0, 3.0, 4.0)),
    ("fixed", (0.3, 0.0, -0.1), (1.0, -1.3, 0.2), None),
    ("fixed", (0.0, 0.1, 0.02), (0.0, 1.5707963267948966, 0.3), None),
    ("prismatic", (-0.2, 0.1, 0.3), (2.0, 0.4, -1.0), (2.0, -1.0, 0.5)),
    ("revolute", (0.25, 0.0, 0.1), (0.6, -0.8, 1.7), None),
    ("fixed", (0.0, 0.0, 0.1), (0.1, 0.0, 0.0), None),
)


def urdf_text(joints=URDF_JOINTS):
    """The arm as URDF; a revolute joint without <limit>, and an inertial that identification must ignore."""
    inertial = '<inertial><mass value="7"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    text = "".join(f'<link name="part{i}">{inertial}</link>' for i in range(len(joints) + 1))
    for i, (kind, xyz, rpy, axis) in enumerate(joints):
        text += f'<joint name="j{i}" type="{kind}"><parent link="part{i}"/><child link="part{i + 1}"/>'
        text += f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'
        text += (f'<axis xyz="{" ".join(map(str, axis))}"/>' if axis else "") + "</joint>"
    return f'<?xml version="1.0"?><robot name="odd">{text}</robot>'


def turn(axis, angle):
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def placement(rotation, translation):
    frame = np.eye(4, dtype=np.result_type(rotation, translation))
    frame[:3, :3], frame[:3, 3] = rotation, translation
    return frame


def urdf_chain(joints=URDF_JOINTS):
    def chain(q):
        frames, axes, frame, positions = [], [], np.eye(4), iter(q)
        for kind, xyz, (roll, pitch, yaw), written in joints:
            rotation = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
            frame = frame @ placement(rotation, np.array(xyz))
            if kind == "fixed":
                continue
            axis = np.array(written or (1.0, 0.0, 0.0))
            axis /= np.linalg.norm(axis)
            axes.append((frame[:3, 3], frame[:3, :3] @ axis, kind == "prismatic"))
            x = next(positions)
            move = placement(np.eye(3), axis * x) if kind == "prismatic" else placement(turn(axis, x), np.zeros(3))
            frame = frame @ move
            frames.append(frame)
        return frames, axes

    return chain


# Bodies: a link is a cloud of point masses in its own frame
def random_clouds(n, seed=0):
    """n clouds (points, masses) around centres of their own."""
    rng = np.random.default_rng(seed)
    centres, spreads = rng.uniform(-0.2, 0.2, (n, 3)), rng.uniform(0.05, 0.2, (n, 3))
    return [(c + s * rng.normal(size=(6, 3)), rng.uniform(0.1, 1.0, 6)) for c, s in zip(centres, spreads, strict=True)]


def cloud_parameters(points, masses):
    """Jxx, Jxy, Jxz, Jyy, Jyz, Jzz, mcx, mcy, mcz, m by their definitions."""
    (x, y, z), m = points.T, masses
    second = [m @ (y**2 + z**2), -m @ (x * y), -m @ (x * z), m @ (x**2 + z**2), -m @ (y * z), m @ (x**2 + y**2)]
    return np.array([*second, m @ x, m @ y, m @ z, m.sum()])


def parameters_of(clouds):
    """(10 n,) link parameters of n clouds."""
    return np.concatenate([cloud_parameters(*cloud) for cloud in clouds])


def positions(chain, clouds, q):
    """(points, 3) positions of all point masses."""
    return np.concatenate([p @ f[:3, :3].T + f[:3, 3] for f, (p, _) in zip(chain(q)[0], clouds, strict=True)])


def jacobian(chain, clouds, q):
    """(points, 3, n) of all point masses: z x (p - o) for a joint that turns, z for one that slides."""
    frames, axes = chain(q)
    blocks = []
    for i, (frame, (points, _)) in enumerate(zip(frames, clouds, strict=True)):
        p = points @ frame[:3, :3].T + frame[:3, 3]
        block = np.zeros((len(p), 3, len(q)), dtype=p.dtype)
        for j, (origin, direction, slides) in enumerate(axes[: i + 1]):
            block[:, :, j] = direction if slides else np.cross(direction, p - origin)
        blocks.append(block)
    return np.concatenate(blocks)


def joint_torques(chain, clouds, gravity, motion):
    """(N, n) torques that move the point masses so: tau = sum of m J' (a - g) (d'Alembert)."""
    masses = np.concatenate([m for _, m in clouds])
    torques = []
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        later = jacobian(chain, clouds, q + 1j * STEP * dq) @ (dq + 1j * STEP * ddq)
        acceleration = later.imag / STEP
        torques.append(np.einsum("p,pij,pi->j", masses, jacobian(chain, clouds, q), acceleration - gravity))
    return np.array(torques)


def actuator_efforts(torques, transmission):
    """Motor torques m with R' m = tau, times the gear ratios."""
    if transmission is None:
        return torques
    gears = np.array(transmission)
    return np.linalg.solve(gears.T, torques.T).T * np.abs(np.diag(gears))


def gear(table, values):
    """Joint speeds (or accelerations) to those of the motors, divided by the gear ratios."""
    if "transmission" not in table:
        return values
    gears = np.array(table["transmission"])
    return values @ gears.T / np.abs(np.diag(gears))


def assert_close(found, expected, relative):
    """Equal to a share of the largest value expected."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * np.abs(expected).max())
