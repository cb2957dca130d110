"""Robots: kinematics, transmission and gravity, with Pinocchio doing the rigid-body mathematics.

A robot comes from a built-in name, a Denavit-Hartenberg file (TOML; standard or modified) or a URDF. Link parameters
are those of `bayesid.model.inertia`, each link in its own frame: the DH frame of the link, or the joint's for a URDF.

Efforts are measured at the motors. With motor speed = R q' (the `transmission`) a controller reports motor torque times
the gear ratio, |diag R|. In these *actuator* coordinates, u = C q with C = |diag R|^-1 R, the effort is
e = C^-T tau by the principle of virtual work; without a transmission C is the identity and nothing changes.
"""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.arrays import Array, frozen
from bayesid.errors import InputError
from bayesid.model import inertia
from bayesid.motion import Motion

_AS_WRITTEN = "use the table as bayesid wrote it"
"""Remedy for a damaged model.toml."""
BUILT_IN = ("kr5", "ur10e", "panda", "tx40")
_TO_PINOCCHIO = [9, 6, 7, 8, 0, 1, 3, 2, 4, 5]  # pinocchio: m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz


@dataclass(frozen=True)
class Robot:
    """A fixed-base arm with n actuated joints.

    Attributes:
        name: what to call it.
        joints: the moving joints, from base to tip (a parent comes before its children).
        gravity: (3,) acceleration of gravity in the base frame, m/s^2.
        transmission: (n, n) motor speeds = transmission @ joint speeds, or None for motors on their joints.
        lengths: symbol to value of the DH table's lengths (a1, d1, ...; m); empty for a URDF.

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
    _pinocchio: Any = field(init=False, repr=False, compare=False)
    _link_to_joint: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.joints)
        object.__setattr__(self, "gravity", frozen(self.gravity, (3,), "gravity"))
        if self.transmission is not None:
            object.__setattr__(self, "transmission", frozen(self.transmission, (n, n), "transmission"))
        object.__setattr__(self, "_pinocchio", _pinocchio_model(self))
        frames = [inertia.change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3]) for joint in self.joints]
        object.__setattr__(self, "_link_to_joint", np.stack(frames)[:, _TO_PINOCCHIO, :])

    @property
    def n_joints(self) -> int:
        """Number of joints n.

        Example:
            >>> robot.n_joints
            3
        """
        return len(self.joints)

    @property
    def coupling(self) -> Array:
        """(n, n) C, with actuator positions u = C q and efforts e = C^-T tau.

        :eq:`actuator-position` and :eq:`actuator-effort`.

        Example:
            >>> bayesid.load_robot("tx40").coupling[5].tolist()  # motor 6 turns with joints 5 and 6
            [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]
        """
        if self.transmission is None:
            return np.eye(self.n_joints)
        return self.transmission / np.abs(np.diag(self.transmission))[:, None]

    def actuators(self, motion: Motion) -> Motion:
        """The motion in actuator coordinates, u = C q: rad at the link side of each motor's gear.

        Example:
            >>> arm = bayesid.load_robot("tx40")  # motor 6 turns with joints 5 and 6
            >>> motion = bayesid.random_trajectory(6, duration=2.0, seed=0).motion(np.arange(201) / 100.0)
            >>> bool(np.allclose(arm.actuators(motion).q[:, 5], motion.q[:, 4] + motion.q[:, 5]))
            True
        """
        if self.transmission is None:
            return motion
        c = self.coupling.T
        return Motion(motion.t, motion.q @ c, motion.dq @ c, motion.ddq @ c, motion.origin)

    @property
    def link_ends(self) -> Array:
        """(n, 2, 3) where each link starts and ends, in its own frame, m: from its joint to the next.

        The last link ends at its own frame, which the standard convention puts at the flange.

        Example:
            >>> robot.link_ends.shape
            (3, 2, 3)
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
        """Length of the stretched arm from its first joint on, m: the sum of its links' lengths.

        Example:
            >>> round(robot.stretched, 2)
            1.05
        """
        return float(np.linalg.norm(self.link_ends[:, 1] - self.link_ends[:, 0], axis=1).sum())

    def regressor(self, motion: Motion) -> Array:
        """(N, n, 10 n) Y with actuator efforts e = Y pi, pi the link parameters stacked from base to tip.

        Source: the joint torque regressor of the Newton-Euler equations (Atkeson, An, Hollerbach 1986), by Pinocchio.

        Example:
            >>> robot.regressor(motion).shape
            (201, 3, 30)
        """
        model, data = self._pinocchio, self._pinocchio.createData()
        regressor = np.empty((len(motion), self.n_joints, 10 * self.n_joints))
        for row, q, dq, ddq in zip(regressor, motion.q, motion.dq, motion.ddq, strict=True):
            row[:] = pin.computeJointTorqueRegressor(model, data, q, dq, ddq)
        blocks = regressor.reshape(-1, self.n_joints, 10).swapaxes(0, 1)
        regressor = (blocks @ self._link_to_joint).swapaxes(0, 1).reshape(regressor.shape)
        if self.transmission is None:
            return regressor
        return np.einsum("ji,njp->nip", np.linalg.inv(self.coupling), regressor)

    def inverse_dynamics(self, motion: Motion, parameters: Array) -> Array:
        """(N, n) actuator efforts, N m, of the rigid bodies by recursive Newton-Euler (Luh, Walker, Paul 1980).

        Args:
            motion: the motion of the joints.
            parameters: (10 n,) link parameters, as in `regressor`; without mass, no first moment either.

        Example:
            >>> parameters = model.links(theta).ravel()
            >>> bool(np.allclose(robot.inverse_dynamics(motion, parameters), robot.regressor(motion) @ parameters))
            True
        """
        model = self._pinocchio.copy()
        in_joint_frames = (self._link_to_joint @ parameters.reshape(-1, 10, 1))[:, :, 0]
        mass = in_joint_frames[:, 0]
        mass[mass == 0.0] = np.finfo(float).tiny  # pinocchio divides by it
        for i, link in enumerate(in_joint_frames, start=1):
            model.inertias[i] = pin.Inertia.FromDynamicParameters(link)
        data = model.createData()
        samples = zip(motion.q, motion.dq, motion.ddq, strict=True)
        torque = np.array([pin.rnea(model, data, q, dq, ddq) for q, dq, ddq in samples])
        return torque if self.transmission is None else torque @ np.linalg.inv(self.coupling)

    def tool_jacobian(self, motion: Motion, in_base: bool) -> Array:
        """(N, 6, n) velocity and angular velocity of the last link's frame per unit of actuator speed.

        Args:
            motion: the motion of the joints.
            in_base: whether they are given along the axes of the base, not of the link.

        Example:
            >>> jacobian = robot.tool_jacobian(motion, in_base=True)
            >>> jacobian.shape
            (201, 6, 3)
        """
        model, data, last = self._pinocchio, self._pinocchio.createData(), self.n_joints
        flange = pin.SE3(self.joints[-1].link_frame)
        jacobian = np.empty((len(motion), 6, self.n_joints))
        for row, q in zip(jacobian, motion.q, strict=True):
            pin.computeJointJacobians(model, data, q)
            tool = data.oMi[last] * flange
            seen_from = pin.SE3(np.eye(3), -tool.translation) if in_base else tool.inverse()
            row[:] = seen_from.action @ pin.getJointJacobian(model, data, last, pin.WORLD).reshape(6, -1)
        return jacobian @ np.linalg.inv(self.coupling)

    def same_kinematics(self, other: Robot) -> bool:
        """Whether the two robots move and are geared alike (to 1e-6): a model of one then serves the other.

        Example:
            >>> [robot.same_kinematics(bayesid.load_robot(other)) for other in ("robot.toml", "ur10e")]
            [True, False]
        """
        if self.n_joints != other.n_joints or not np.allclose(self.coupling, other.coupling, atol=1e-6):
            return False
        pairs = zip(self.joints, other.joints, strict=True)
        return all(a.matches(b) for a, b in pairs) and np.allclose(self.gravity, other.gravity, atol=1e-6)


@dataclass(frozen=True)
class Joint:
    """One joint and the link it moves.

    Attributes:
        placement: (4, 4) the joint's frame at q = 0 in the parent joint's frame.
        axis: (3,) unit axis of motion in the joint's frame.
        prismatic: whether it slides rather than turns.
        parent: index of the parent joint, -1 for the base.
        link_frame: (4, 4) the link's frame in the joint's frame; the link's parameters are given in it.
    """

    placement: Array
    axis: Array
    prismatic: bool = False
    parent: int = -1
    link_frame: Array = field(default_factory=lambda: np.eye(4))

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
        if not joint.prismatic and np.array_equal(joint.axis, [0.0, 0.0, 1.0]):
            kind = _revolute_z
        model.addJoint(joint.parent + 1, kind(joint.axis), pin.SE3(joint.placement), f"joint{i}")
    return model


def _revolute_z(_axis: Array) -> pin.JointModelRZ:
    return pin.JointModelRZ()


def load_robot(source: str | Path) -> Robot:
    """A robot from a built-in name, a DH file (.toml) or a URDF file (.urdf, .xml).

    Raises:
        InputError: no such robot, or the file cannot be read as one.

    Example:
        >>> bayesid.load_robot("ur10e").n_joints, bayesid.load_robot("robot.toml").name
        (6, 'arm')
    """
    if str(source) in BUILT_IN:
        text = (resources.files("bayesid.model") / "robots" / f"{source}.toml").read_text()
        return robot_from_table(tomllib.loads(text), f"built-in robot {source}")
    path = Path(source)
    if not path.is_file():
        remedy = f"give one of {', '.join(BUILT_IN)}, a DH file (.toml) or a URDF file"
        raise InputError("no such robot", str(source), remedy)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", str(path), "give a text file in TOML or URDF") from None
    if path.suffix == ".toml":
        try:
            return robot_from_table(tomllib.loads(text), str(path))
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"is not valid TOML ({error})", str(path), "correct the file") from None
    return robot_from_urdf(text, str(path))


# ---------------------------------------------------------------------------------------------------------------
# Denavit-Hartenberg files
# ---------------------------------------------------------------------------------------------------------------
def robot_from_table(table: Mapping[str, Any], where: str) -> Robot:
    """A robot from the keys of a DH file.

    Args:
        table: `name`, `convention` ("standard" or "modified"), `joints` (each with a, alpha, d, theta; m and rad;
            optional `type` "revolute" or "prismatic"), optional `gravity` (m/s^2) and `transmission`.
        where: what to name in an error.

    Raises:
        InputError: a key is missing or its value cannot be used.

    Example:
        >>> joints = [{"a": a, "alpha": 0.0, "d": 0.1, "theta": 0.0} for a in (0.35, 0.3)]
        >>> bayesid.robot_from_table({"name": "scara", "convention": "standard", "joints": joints}, "scara").n_joints
        2
    """
    convention = table.get("convention")
    if convention == "chain":
        return _robot_from_chain(table, where)
    if convention not in ("standard", "modified"):
        said = "key 'convention' is missing" if convention is None else f"unknown convention {convention!r}"
        raise InputError(said, where, 'give convention = "standard" or "modified"')
    rows = table.get("joints")
    if not isinstance(rows, list) or not rows:
        raise InputError("key 'joints' is missing", where, "give one [[joints]] table a joint with a, alpha, d, theta")
    dh = [_dh_row(row, f"{where}, joint {i}") for i, row in enumerate(rows, start=1)]
    joints = _standard_joints(dh) if convention == "standard" else _modified_joints(dh)
    lengths = {f"{symbol}{i}": row[symbol] for i, row in enumerate(dh, start=1) for symbol in ("a", "d")}
    return Robot(
        name=str(table.get("name", "robot")),
        joints=joints,
        gravity=_numbers(table.get("gravity", [0.0, 0.0, -9.81]), (3,), "gravity", where),
        transmission=_transmission(table.get("transmission"), len(joints), where),
        lengths={symbol: value for symbol, value in lengths.items() if value != 0.0},
    )


def robot_table(robot: Robot) -> dict[str, Any]:
    """A robot as plain tables that `robot_from_table` reads back to the last digit: joint placements, no DH angles."""
    table: dict[str, Any] = {
        "name": robot.name,
        "convention": "chain",
        "gravity": robot.gravity.tolist(),
        "lengths": dict(robot.lengths),
        "joints": [
            {
                "placement": joint.placement.tolist(),
                "axis": joint.axis.tolist(),
                "type": "prismatic" if joint.prismatic else "revolute",
                "parent": int(joint.parent),
                "link_frame": joint.link_frame.tolist(),
            }
            for joint in robot.joints
        ],
    }
    if robot.transmission is not None:
        table["transmission"] = robot.transmission.tolist()
    return table


def _robot_from_chain(table: Mapping[str, Any], where: str) -> Robot:
    rows, lengths = table.get("joints"), table.get("lengths", {})
    if not isinstance(rows, list) or not rows or not isinstance(lengths, Mapping):
        raise InputError("key 'joints' or 'lengths' cannot be used", where, _AS_WRITTEN)
    return Robot(
        name=str(table.get("name", "robot")),
        joints=tuple(_chain_joint(row, i, f"{where}, joint {i + 1}") for i, row in enumerate(rows)),
        gravity=_numbers(table.get("gravity", [0.0, 0.0, -9.81]), (3,), "gravity", where),
        transmission=_transmission(table.get("transmission"), len(rows), where),
        lengths={str(key): float(_numbers(value, (), str(key), where)) for key, value in lengths.items()},
    )


def _chain_joint(row: object, index: int, where: str) -> Joint:
    if not isinstance(row, Mapping):
        raise InputError("is not a table", where, _AS_WRITTEN)
    for key in ("placement", "axis", "type", "parent", "link_frame"):
        if key not in row:
            raise InputError(f"key '{key}' is missing", where, _AS_WRITTEN)
    placement, link_frame = (_numbers(row[key], (4, 4), key, where) for key in ("placement", "link_frame"))
    axis = _numbers(row["axis"], (3,), "axis", where)
    if not np.isclose(np.linalg.norm(axis), 1.0):
        raise InputError("key 'axis' is no unit vector", where, _AS_WRITTEN)
    if not isinstance(row["parent"], int) or not -1 <= row["parent"] < index:
        raise InputError("key 'parent' names no earlier joint", where, _AS_WRITTEN)
    return Joint(placement, axis, row["type"] == "prismatic", row["parent"], link_frame)


def _dh_row(row: object, where: str) -> dict[str, Any]:
    if not isinstance(row, Mapping):
        raise InputError("is not a table", where, "write it as [[joints]] with a, alpha, d, theta")
    kind = row.get("type", "revolute")
    if kind not in ("revolute", "prismatic"):
        raise InputError(f"unknown joint type {kind!r}", where, 'give "revolute" or "prismatic"')
    values: dict[str, Any] = {"prismatic": kind == "prismatic"}
    for key in ("a", "alpha", "d", "theta"):
        if key not in row:
            raise InputError(f"key '{key}' is missing", where, "give a and d in m, alpha and theta in rad")
        values[key] = float(_numbers(row[key], (), key, where))
    return values


def _numbers(value: object, shape: tuple[int, ...], key: str, where: str) -> Array:
    try:
        return frozen(value, shape, key)
    except (TypeError, ValueError):
        wanted = "a finite number" if not shape else f"finite numbers in the shape {' x '.join(map(str, shape))}"
        raise InputError(f"key '{key}' cannot be used", where, f"give {wanted}") from None


def _transmission(value: object, n: int, where: str) -> Array | None:
    if value is None:
        return None
    matrix = _numbers(value, (n, n), "transmission", where)
    if np.any(np.diag(matrix) == 0.0) or np.linalg.matrix_rank(matrix) < n:
        remedy = "motor speeds = transmission @ joint speeds needs an invertible matrix with a non-zero diagonal"
        raise InputError("key 'transmission' cannot be used", where, remedy)
    return matrix


def _rotation(axis: str, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    i, j = (1, 2) if axis == "x" else (0, 1)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def _translation(x: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[0, 3], matrix[2, 3] = x, z
    return matrix


def _standard_joints(dh: list[dict[str, Any]]) -> tuple[Joint, ...]:
    """Distal convention: joint i acts at the end of link i - 1, and link i's frame sits at its own far end."""
    joints, placement = [], np.eye(4)
    for i, row in enumerate(dh):
        to_link = _rotation("z", row["theta"]) @ _translation(row["a"], row["d"]) @ _rotation("x", row["alpha"])
        joints.append(Joint(placement, np.array([0.0, 0.0, 1.0]), row["prismatic"], i - 1, to_link))
        placement = to_link
    return tuple(joints)


def _modified_joints(dh: list[dict[str, Any]]) -> tuple[Joint, ...]:
    """Proximal convention (Craig): link i's frame is joint i's own."""
    joints = []
    for i, row in enumerate(dh):
        before = _rotation("x", row["alpha"]) @ _translation(row["a"], 0.0)
        placement = before @ _rotation("z", row["theta"]) @ _translation(0.0, row["d"])
        joints.append(Joint(placement, np.array([0.0, 0.0, 1.0]), row["prismatic"], i - 1))
    return tuple(joints)


# ---------------------------------------------------------------------------------------------------------------
# URDF files
# ---------------------------------------------------------------------------------------------------------------
def robot_from_urdf(text: str, where: str) -> Robot:
    """A robot from URDF text; fixed joints merge into their parents, `continuous` ones count as revolute.

    Raises:
        InputError: the text is not a URDF, or a joint is neither revolute, continuous, prismatic nor fixed.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"is not readable as URDF ({error})", where, "give a well-formed URDF file") from None
    if root.tag != "robot":
        raise InputError(f"is not a URDF: its root is <{root.tag}>, not <robot>", where, "give a URDF file")
    root = _urdf_skeleton(root, where)
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except Exception as error:  # pinocchio raises several C++ exception types here
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(f"is not readable as URDF ({reason})", where, "correct the file") from None
    if model.nv == 0:
        raise InputError("has no moving joint", where, "give a URDF of an arm")
    axes = {e.get("name"): _urdf_axis(e) for e in root.findall("joint")}
    kinds = {e.get("name"): e.get("type") for e in root.findall("joint")}
    joints = tuple(
        Joint(
            placement=np.array(model.jointPlacements[i].homogeneous),
            axis=axes[model.names[i]],
            prismatic=kinds[model.names[i]] == "prismatic",
            parent=model.parents[i] - 1,
        )
        for i in range(1, model.njoints)
    )
    return Robot(name=model.name or "robot", joints=joints, gravity=np.array([0.0, 0.0, -9.81]))


def _urdf_skeleton(root: ET.Element, where: str) -> ET.Element:
    """The URDF's kinematics alone, checked here: urdfdom prints its complaints, and refuses files for other parts."""
    names = [element.get("name", "") for element in root.findall("link")]
    children = [child.get("link", "") for child in root.findall("joint/child")]
    for name in names:
        if names.count(name) > 1:
            raise InputError("appears twice", f"{where}, link {name}", "give every link its own name")
        if children.count(name) > 1:
            raise InputError("is the child of two joints", f"{where}, link {name}", "give a URDF without loops")
    loose = [name for name in names if name not in children]
    if len(loose) != 1:
        said = f"has {len(loose)} links without a parent joint{': ' + ', '.join(loose) if loose else ''}"
        raise InputError(said, where, "give a URDF with one base link")
    skeleton = ET.Element("robot", name=root.get("name") or "robot")
    for name in names:
        ET.SubElement(skeleton, "link", name=name)
    skeleton.extend([_urdf_joint(element, names, where) for element in root.findall("joint")])
    joints = [element.get("name") for element in skeleton.findall("joint")]
    for joint in joints:
        if joints.count(joint) > 1:
            raise InputError("appears twice", f"{where}, joint {joint}", "give every joint its own name")
    return skeleton


def _urdf_joint(element: ET.Element, links: list[str], where: str) -> ET.Element:
    kind, name = element.get("type"), element.get("name", "")
    here = f"{where}, joint {name}"
    if kind not in ("revolute", "continuous", "prismatic", "fixed") or element.find("mimic") is not None:
        said = "a mimic joint" if element.find("mimic") is not None else f"of type {kind!r}"
        raise InputError(f"is {said}", here, "bayesid identifies revolute, continuous, prismatic and fixed joints")
    # pinocchio would use (cos, sin) for a continuous joint; a log holds the angle
    joint = ET.Element("joint", name=name, type="revolute" if kind == "continuous" else kind)
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None or end.get("link") not in links:
            raise InputError(f"its <{tag}> names no link of the file", here, "name one")
        joint.append(end)
    for tag, key in (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz")):
        vector = element.find(tag)
        if vector is not None and key in vector.attrib:
            _numbers(vector.attrib[key].split(), (3,), f"{tag} {key}", here)
    joint.extend([child for tag in ("origin", "axis") if (child := element.find(tag)) is not None])
    if kind != "fixed":
        ET.SubElement(joint, "limit", lower="-1e9", upper="1e9", effort="1e9", velocity="1e9")
        if not _urdf_axis(joint).any():
            raise InputError("key 'axis xyz' cannot be used", here, "give a direction that is not zero")
    return joint


def _urdf_axis(element: ET.Element) -> Array:
    axis = element.find("axis")
    value = np.array([float(x) for x in axis.get("xyz", "1 0 0").split()]) if axis is not None else np.eye(3)[0]
    return value / (np.linalg.norm(value) or 1.0)
