"""Robots: kinematics, transmission and gravity, with Pinocchio doing the rigid-body mathematics.

A robot comes from a built-in name, a Denavit-Hartenberg file (TOML; standard or modified) or a URDF. Link parameters
are those of `bayesid.robot.inertia`, each link in its own frame: the DH frame of the link, or the joint's for a URDF.

Efforts are measured at the motors. With motor speed = R q' (the `transmission`) a controller reports motor torque times
the gear ratio, |diag R|. In these *actuator* coordinates, u = C q with C = |diag R|^-1 R, the effort is
e = C^-T tau by the principle of virtual work; without a transmission C is the identity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from bayesid.arrays import Array, frozen
from bayesid.errors import InputError, printable
from bayesid.files.bounded import LARGEST
from bayesid.motion import Motion
from bayesid.robot import inertia
from bayesid.robot.tuning import TUNING

if TYPE_CHECKING:
    from bayesid.robot.collision import Capsules, CollisionModel, NoShapes

_TO_PINOCCHIO = [9, 6, 7, 8, 0, 1, 3, 2, 4, 5]  # pinocchio: m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz


@dataclass(frozen=True)
class Robot:
    """A fixed-base arm with n actuated joints.

    Attributes:
        name: name for messages and files.
        joints: the moving joints, from base to tip (a parent comes before its children).
        gravity: (3,) acceleration of gravity in the base frame, m/s^2.
        transmission: (n, n) motor speeds = transmission @ joint speeds, or None for motors on their joints.
        lengths: symbol to value of the DH table's lengths (a1, d1, ...; m); empty for a URDF.
        notes: remarks on how it was read, one sentence each: held joints, a base that may move.
        origin: source from which `load_robot` read it; None for a robot made or changed in Python.
        pinocchio: its joints as Pinocchio's model, without bodies.

    Example:
        >>> arm = bayesid.load_robot("ur10e")
        >>> arm.name, arm.n_joints, arm.gravity.tolist()
        ('ur10e', 6, [0.0, 0.0, -9.81])
    """

    name: str
    joints: tuple[Joint, ...]
    gravity: Array
    transmission: Array | None = None
    lengths: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    origin: Origin | None = field(init=False, default=None, repr=False, compare=False)
    pinocchio: Any = field(init=False, repr=False, compare=False)
    _link_to_joint: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.joints)
        object.__setattr__(self, "name", printable(self.name))
        object.__setattr__(self, "gravity", frozen(self.gravity, (3,), "gravity"))
        if self.transmission is not None:
            object.__setattr__(self, "transmission", frozen(self.transmission, (n, n), "transmission"))
        object.__setattr__(self, "pinocchio", _pinocchio_model(self))
        frames = [inertia.change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3]) for joint in self.joints]
        object.__setattr__(self, "_link_to_joint", np.stack(frames)[:, _TO_PINOCCHIO, :])

    def __repr__(self) -> str:
        slides = sum(joint.prismatic for joint in self.joints)
        parts = [f"{self.n_joints} joints", *([f"{slides} of them sliding"] if slides else [])]
        parts += [] if self.transmission is None else ["coupled motors"]
        return f"Robot {self.name}: {', '.join(parts)}, gravity {', '.join(f'{g:g}' for g in self.gravity)} m/s^2"

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.joints)

    @property
    def coupling(self) -> Array:
        """(n, n) C, with actuator positions u = C q and efforts e = C^-T tau.

        :eq:`actuator-position` and :eq:`actuator-effort`.
        """
        if self.transmission is None:
            return np.eye(self.n_joints)
        return self.transmission / np.abs(np.diag(self.transmission))[:, None]

    def actuators(self, motion: Motion) -> Motion:
        """The motion in actuator coordinates, u = C q: rad at the link side of each motor's gear."""
        if self.transmission is None:
            return motion
        c = self.coupling.T
        return replace(motion, q=motion.q @ c, dq=motion.dq @ c, ddq=motion.ddq @ c)

    @property
    def link_ends(self) -> Array:
        """(n, 2, 3) start and end of each link in its own frame, m: from its joint to the next.

        The last link ends at its own frame, which the standard convention puts at the flange.
        """
        ends = []
        for i, joint in enumerate(self.joints):
            children = [child.placement for child in self.joints if child.parent == i]
            far = (children[0] if children else joint.link_frame)[:3, 3]
            rotation, origin = joint.link_frame[:3, :3], joint.link_frame[:3, 3]
            ends.append((np.stack([np.zeros(3), far]) - origin) @ rotation)
        return np.array(ends)

    @property
    def stretched(self) -> float:
        """Length of the stretched arm from its first joint, m: the sum of its link lengths."""
        return float(np.linalg.norm(self.link_ends[:, 1] - self.link_ends[:, 0], axis=1).sum())

    def joint_frames(self, q: Array) -> Array:
        """(n, 4, 4) frames of the joints in the base frame at positions q (n,), rad or m."""
        data = self.pinocchio.createData()
        pin.forwardKinematics(self.pinocchio, data, q)
        return np.stack([place.homogeneous for place in list(data.oMi)[1:]])

    def to_base(self, joint: int) -> list[int]:
        """Indices of a joint and its ancestors, ending with -1 for the base."""
        path = []
        while joint >= 0:
            path.append(joint)
            joint = self.joints[joint].parent
        return path

    def regressor(self, motion: Motion) -> Array:
        """(N, n, 10 n) Y with actuator efforts e = Y pi, pi the link parameters stacked from base to tip.

        Source: the joint torque regressor of the Newton-Euler equations (Atkeson, An, Hollerbach 1986), by Pinocchio.
        """
        (model, data), width = self._bodies.of(self), 10 * self.n_joints
        regressor = np.empty((len(motion), self.n_joints, width))
        at_once = TUNING.samples_at_once  # fits into the processor's cache
        raw = np.empty((min(at_once, len(motion)), self.n_joints, width))
        for start in range(0, len(motion), at_once):
            some = slice(start, start + at_once)
            for row, q, dq, ddq in zip(raw, motion.q[some], motion.dq[some], motion.ddq[some], strict=False):
                row[:] = pin.computeJointTorqueRegressor(model, data, q, dq, ddq)
            rows = regressor[some].reshape(-1, width)
            for first, change in zip(range(0, width, 10), self._link_to_joint, strict=True):
                link = slice(first, first + 10)
                np.matmul(raw.reshape(-1, width)[: len(rows), link], change, out=rows[:, link])
            if self.transmission is not None:
                regressor[some] = self._to_actuators.T @ regressor[some]
        return regressor

    def inverse_dynamics(self, motion: Motion, parameters: Array) -> Array:
        """(N, n) actuator efforts, N m, of the rigid bodies by recursive Newton-Euler (Luh, Walker, Paul 1980).

        Link parameters (10 n,) are as in `regressor`; a link without mass has no first moment either.
        """
        model, data = self._bodies.of(self, parameters)
        samples = zip(motion.q, motion.dq, motion.ddq, strict=True)
        torque = np.array([pin.rnea(model, data, q, dq, ddq) for q, dq, ddq in samples])
        return torque if self.transmission is None else torque @ self._to_actuators

    def dynamics(self, motion: Motion, parameters: Array) -> Dynamics:
        """Rigid bodies of parameters as in `regressor` at the first instant of a motion.

        The mass matrix by the composite rigid body algorithm (Featherstone 2008, chapter 6), the Coriolis matrix of
        Christoffel symbols.
        """
        model, data = self._bodies.of(self, parameters)
        q, dq, ddq = motion.q[0], motion.dq[0], motion.ddq[0]
        torque = pin.rnea(model, data, q, dq, ddq).copy()
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq)
        drift = coriolis.T @ dq - pin.computeGeneralizedGravity(model, data, q)
        return Dynamics(pin.crba(model, data, q).copy(), drift, torque)

    @cached_property
    def _to_actuators(self) -> Array:
        inverse: Array = np.linalg.inv(self.coupling).astype(float)
        return inverse

    @cached_property
    def _bodies(self) -> _Bodies:
        return _Bodies()

    def tool_jacobian(self, motion: Motion, in_base: bool) -> Array:
        """(N, 6, n) linear and angular velocity of the last link's frame, in its own or the base's axes.

        Both are per unit of actuator speed.
        """
        model, data, last = self.pinocchio, self.pinocchio.createData(), self.n_joints
        flange = pin.SE3(self.joints[-1].link_frame)
        jacobian = np.empty((len(motion), 6, self.n_joints))
        for row, q in zip(jacobian, motion.q, strict=True):
            pin.computeJointJacobians(model, data, q)
            tool = data.oMi[last] * flange
            seen_from = pin.SE3(np.eye(3), -tool.translation) if in_base else tool.inverse()
            row[:] = seen_from.action @ pin.getJointJacobian(model, data, last, pin.WORLD).reshape(6, -1)
        return jacobian @ self._to_actuators

    def collision_model(
        self,
        rest: Array,
        capsules: Capsules | None = None,
        *,
        floor: float | None = 0.0,
        margin: float = 0.01,
        folders: Sequence[str | Path] = (),
    ) -> CollisionModel | NoShapes:
        """Collision model: capsules if given, else the shapes of the robot's URDF.

        Args:
            rest: (n,) or (M, n) poses of the robot in the log, rad or m; pairs too close there are not checked.
            capsules: radii of the links (`bayesid.types.Capsules`); needed unless a URDF has shapes.
            floor: height of the floor above the base's origin, against gravity, m; None for no floor.
            margin: minimum distance, m; pairs that never keep it, or did not in the log, are not checked.
            folders: folders searched first for mesh packages; then ROS_PACKAGE_PATH and above the URDF.

        Returns:
            A `bayesid.types.CollisionModel`, or the reason for none: no shapes are known, or nothing can collide.

        Raises:
            InputError: radii or meshes cannot be used; or a link was below the floor, or nearer to it than the margin,
                in the log; or all pairs are nearer than the margin, so the capsules are too wide.

        Example:
            >>> capsules = bayesid.types.Capsules(0.03)
            >>> robot.collision_model(motion.q[::20], capsules, floor=None).source
            'capsules of 0.03 m about the lines between the joints, no floor'
        """
        from bayesid.robot.collision import collision_model

        return collision_model(self, rest, capsules, floor, margin, folders)

    def same_kinematics(self, other: Robot) -> bool:
        """Whether both robots have equal kinematics and transmission (to 1e-6), so that a model fits both."""
        if self.n_joints != other.n_joints or not np.allclose(self.coupling, other.coupling, atol=1e-6):
            return False
        pairs = zip(self.joints, other.joints, strict=True)
        return all(a.matches(b) for a, b in pairs) and np.allclose(self.gravity, other.gravity, atol=1e-6)


class Dynamics(NamedTuple):
    """Rigid-body dynamics at an instant, in coordinates of the n joints."""

    mass: Array  # (n, n) M(q), kg m^2
    drift: Array  # (n,) C(q, dq)' dq - g(q), N m: moves the momentum M dq beside torques (De Luca and Mattone 2003)
    torque: Array  # (n,) M ddq + C dq + g, N m


class _Bodies:
    """Cache of Pinocchio models with bodies; copies and pickles start empty."""

    def __init__(self) -> None:
        self._made: dict[bytes, tuple[Any, Any]] = {}

    def __reduce__(self) -> tuple[type[_Bodies], tuple[()]]:
        return _Bodies, ()

    def of(self, robot: Robot, parameters: Array | None = None) -> tuple[Any, Any]:
        """Pinocchio's model and data with these link parameters (10 n,), or without bodies."""
        key = b"" if parameters is None else parameters.tobytes()
        if key not in self._made:
            if len(self._made) > TUNING.bodies_remembered:
                self._made.pop(next(iter(self._made)))
            model = robot.pinocchio if parameters is None else _with_bodies(robot, parameters)
            self._made[key] = model, model.createData()
        return self._made[key]


def _with_bodies(robot: Robot, parameters: Array) -> Any:
    model = robot.pinocchio.copy()
    in_joint_frames = (robot._link_to_joint @ parameters.reshape(-1, 10, 1))[:, :, 0]
    mass = in_joint_frames[:, 0]
    mass[mass == 0.0] = np.finfo(float).tiny  # pinocchio divides by it
    for i, link in enumerate(in_joint_frames, start=1):
        model.inertias[i] = pin.Inertia.FromDynamicParameters(link)
    return model


@dataclass(frozen=True)
class Origin:
    """Arguments of `load_robot`, and the URDF file that was read; None for a DH table."""

    source: str
    urdf: Path | None = None
    tip: str | None = None
    hold: Mapping[str, float] = field(default_factory=dict)
    gravity: tuple[float, ...] | None = None

    @property
    def options(self) -> dict[str, object]:
        """Chosen options by name."""
        tip: dict[str, object] = {} if self.tip is None else {"tip": self.tip}
        gravity: dict[str, object] = {} if self.gravity is None else {"gravity": self.gravity}
        return {"robot": self.source, **tip, **({"hold": dict(self.hold)} if self.hold else {}), **gravity}

    @property
    def in_python(self) -> str:
        """The robot as an argument in Python."""
        chosen = [f", {name}={value!r}" for name, value in self.options.items() if name != "robot"]
        return f"bayesid.load_robot({self.source!r}{''.join(chosen)})" if chosen else repr(self.source)


@dataclass(frozen=True)
class Joint:
    """One joint and the link it moves."""

    placement: Array  #: (4, 4) the joint's frame at q = 0 in the parent joint's frame
    axis: Array  #: (3,) unit axis of motion in the joint's frame
    prismatic: bool = False  #: whether the joint is prismatic
    parent: int = -1  #: index of the parent joint, -1 for the base
    #: (4, 4) the link's frame in the joint's frame; the link's parameters are given in it
    link_frame: Array = field(default_factory=lambda: np.eye(4))
    name: str = ""  #: in the URDF; empty for a DH table
    #: rated effort, N m (N of a prismatic joint); None if no file states it
    rated_effort: float | None = None
    #: (4, 4) the flange in the link's frame, if a file has one after its last joint; None if it is that frame
    tip: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", printable(self.name))

    def matches(self, other: Joint) -> bool:
        """Same place, axis and kind to 1e-6."""
        arrays = ((self.placement, other.placement), (self.axis, other.axis), (self.link_frame, other.link_frame))
        alike = all(np.allclose(a, b, atol=1e-6) for a, b in arrays)
        return alike and self.prismatic == other.prismatic and self.parent == other.parent


def _pinocchio_model(robot: Robot) -> pin.Model:
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = robot.gravity
    for i, joint in enumerate(robot.joints, start=1):
        kind = pin.JointModelPrismaticUnaligned if joint.prismatic else pin.JointModelRevoluteUnaligned
        about_z = not joint.prismatic and np.array_equal(joint.axis, [0.0, 0.0, 1.0])
        made = pin.JointModelRZ() if about_z else kind(joint.axis)
        model.addJoint(joint.parent + 1, made, pin.SE3(joint.placement), f"joint{i}")
    return model


def given_numbers(value: object, shape: tuple[int, ...], key: str, where: str, most: float = LARGEST) -> Array:
    """Numbers of a robot file's key in a given shape, each at most `most` in size; else an InputError."""
    try:
        numbers = frozen(value, shape, key)
    except (TypeError, ValueError):
        expected = "a finite number" if not shape else f"finite numbers in the shape {' x '.join(map(str, shape))}"
        raise InputError(f"key '{key}' cannot be used", where, f"give {expected}") from None
    if (largest := np.abs(numbers).max(initial=0.0)) > most:
        raise InputError(f"key '{key}' holds {largest:g}", where, f"give at most {most:g}, in SI units")
    return numbers


def check_count(n_joints: int, where: str) -> None:
    """InputError for more moving joints than any robot has."""
    if n_joints > TUNING.most_joints:
        remedy = f"give a robot with at most {TUNING.most_joints} joints, or the chain to identify (`tip`)"
        raise InputError(f"has {n_joints} moving joints", where, remedy)
