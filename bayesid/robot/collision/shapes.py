"""Shapes of a robot's links: capsules about the lines of its kinematics, or what a URDF gives for collisions.

Every shape has a capsule: the points within a radius of a line. Where a URDF gives a box, a cylinder or a mesh (of
which the convex hull counts), the capsule encloses it, its distances are lower bounds, and coal has the true ones.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.bounded import MOST_BYTES, read_source, xml_of
from bayesid.robot import Robot
from bayesid.robot.arm import Origin
from bayesid.robot.numbers import given_numbers
from bayesid.robot.tuning import TUNING
from bayesid.robot.urdf import hold_joints, place_links
from bayesid.robot.urdf_tree import read_tree

BASE = -1
"""Index of the body that does not move, as a joint's parent."""
_SHORTEST = 1e-9
"""m; a line that is shorter is rounding."""
MOST_MESH_BYTES = 8 * MOST_BYTES
"""Of a mesh file, 64 MiB; the largest of example-robot-data has 28."""
_PACKAGE, _FILE = "package://", "file://"


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a link, in the frame of the joint that moves it.

    Attributes:
        name: of the link.
        body: index of the joint that moves it; `BASE` for none.
        ends: (2, 3) of the capsule's line, m.
        radius: of the capsule, m.
        solid: what coal has within the capsule; None where the capsule itself is the shape.
        place: (4, 4) frame of the solid.
        rod: whether its line begins at the joint's frame before the joint has moved: what slides out of a link.
    """

    name: str
    body: int
    ends: Array
    radius: float
    solid: Any = None
    place: Any = None
    rod: bool = False


def capsules(robot: Robot, radii: float | Sequence[float], tool: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Shape]:
    """One line a link, from its joint to the next, with a radius.

    The line of a link with an offset along an axis and a length across it has a corner, as a Denavit-Hartenberg step
    has, and two capsules. The last link ends at its own frame, or at a point that is given in it.

    Args:
        robot: the robot.
        radii: m, one for all links or one for each; the base has that of the first.
        tool: (3,) the end of what is mounted, in the last link's frame, m.

    Raises:
        InputError: a radius is not positive, or there is not one for each; or the tool's end is no point.
    """
    widths, end = _widths(robot, radii), np.asarray(tool, dtype=float)
    if end.shape != (3,) or not np.isfinite(end).all():
        raise InputError(
            f"{end.size} numbers", field="tool", remedy="give x,y,z of its end in the last link's frame, m"
        )
    standard = any(not np.array_equal(joint.link_frame, np.eye(4)) for joint in robot.joints)
    found = []
    for body in range(BASE, robot.n_joints):
        name = "base" if body == BASE else f"link {body + 1}"
        if body != BASE and robot.joints[body].prismatic:
            found.append(Shape(name, body, np.zeros((2, 3)), widths[body], rod=True))
        lines = [line for corners in _lines(robot, body, end, standard) for line in _pieces(corners)]
        if not lines and body != BASE:
            lines = [np.zeros((2, 3))]
        found += [Shape(name, body, line, widths[max(body, 0)]) for line in lines]
    return found


def _widths(robot: Robot, radii: float | Sequence[float]) -> list[float]:
    given = [float(one) for one in np.atleast_1d(np.asarray(radii, dtype=float))]
    given = given * robot.n_joints if len(given) == 1 else given
    remedy = f"give one radius in m, or {robot.n_joints} from base to tip"
    if len(given) != robot.n_joints:
        raise InputError(f"{len(given)} radii, but {robot.n_joints} links", field="capsules", remedy=remedy)
    if not all(0.0 < one <= 10.0 for one in given):  # a larger one was given in other units
        raise InputError("a radius is not between 0 and 10 m", field="capsules", remedy=remedy)
    return given


def _lines(robot: Robot, body: int, tool: Array, standard: bool) -> Iterator[Array]:
    """Corners of a link's lines, in its joint's frame."""
    here = None if body == BASE else robot.joints[body]
    children = [joint for joint in robot.joints if joint.parent == body]
    for child in children:
        far = child.placement[:3, 3]
        if child.name:  # of a URDF, whose frames sit where its author put them
            yield np.stack([np.zeros(3), far])
        elif standard and here is not None:
            yield np.stack([np.zeros(3), here.axis * (here.axis @ far), far])
        else:
            along = child.placement[:3, :3] @ child.axis
            yield np.stack([np.zeros(3), far - along * (along @ far), far])
    if here is not None and not children:
        flange = here.link_frame[:3, 3]
        end = flange + here.link_frame[:3, :3] @ tool
        yield np.stack([np.zeros(3), here.axis * (here.axis @ flange), flange, end])


def _pieces(corners: Array) -> Iterator[Array]:
    """Lines between corners that differ."""
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - kept[-1]) > _SHORTEST:
            yield np.stack([kept[-1], corner])
            kept.append(corner)


def enclosing_capsule(points: Array) -> tuple[Array, float]:
    """(2, 3) line and radius of a capsule around points, along their longest direction.

    Its line goes through the middle of what is seen along it, and is no longer than the rounded ends need.
    """
    centre = points.mean(axis=0)
    axis = np.linalg.eigh((points - centre).T @ (points - centre))[1].T[::-1]
    seen = (points - centre) @ axis.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2.0
    along, across = seen[:, 0], np.linalg.norm(seen[:, 1:] - middle[1:], axis=1)
    radius = float(across.max()) + _SHORTEST
    reach = np.sqrt(radius**2 - across**2)
    low, high = (along + reach).min(), (along - reach).max()
    if low > high:  # one ball holds them all
        low = high = (low + high) / 2.0
    ends = np.array([[low, *middle[1:]], [high, *middle[1:]]])
    return centre + ends @ axis, radius


def urdf_shapes(origin: Origin, n_joints: int, folders: Sequence[str | Path] = ()) -> list[Shape]:
    """Shapes of <collision> elements, in the frames of the joints that move.

    Args:
        origin: of a robot that was loaded from a URDF.
        n_joints: of that robot.
        folders: where packages of meshes are looked for first.

    Raises:
        InputError: a mesh is not found or cannot be read, a number cannot be used, or the file is not what it was.
    """
    assert origin.urdf is not None
    where = printable(str(origin.urdf))
    text = read_source(origin.urdf, "give a URDF file")
    tree = read_tree(text, where)
    joints, places = place_links(tree, hold_joints(tree, origin.tip, origin.hold, where))
    if len(joints) != n_joints:
        raise InputError("has other joints than when the robot was loaded", where, "load the robot again")
    shapes = []
    for link in xml_of(text, where).findall("link"):
        name = link.get("name", "")
        body, frame = places[name]
        for element in link.findall("collision"):
            here = f"{where}, link {printable(name)}"
            place = frame @ _origin(element, here)
            shapes += list(_shapes(element, printable(name), body, place, _Meshes(origin.urdf, folders, here)))
    return shapes


def _origin(element: ET.Element, where: str) -> Array:
    found = element.find("origin")
    given = {} if found is None else found.attrib
    frame = np.eye(4)
    frame[:3, 3] = given_numbers(given.get("xyz", "0 0 0").split(), (3,), "origin xyz", where, TUNING.longest)
    angles = given_numbers(given.get("rpy", "0 0 0").split(), (3,), "origin rpy", where)
    frame[:3, :3] = scipy.spatial.transform.Rotation.from_euler("xyz", angles).as_matrix()
    return frame


class _Meshes:
    """Finds the mesh files of a URDF: packages in `folders` first; errors name `where`."""

    def __init__(self, urdf: Path, folders: Sequence[str | Path], where: str) -> None:
        self._urdf, self.where = urdf.resolve(), where
        listed = [folder for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if folder]
        self._folders = [Path(folder) for folder in (*folders, *listed)]

    def find(self, name: str) -> Path:
        """The file of a mesh's name: of a package in the folders or in one above the URDF, or relative to the URDF."""
        for path in self._candidates(name):
            try:
                if path.is_file():
                    return path
            except (OSError, ValueError):  # no name of a file
                continue
        remedy = "set ROS_PACKAGE_PATH to the folder that holds its package, or give radii by `capsules`"
        raise InputError(f"mesh {printable(name)} is not found", self.where, remedy)

    def _candidates(self, name: str) -> Iterator[Path]:
        above = self._urdf.parents
        if not name.startswith(_PACKAGE):
            yield self._urdf.parent / name.removeprefix(_FILE)
            return
        inside = name.removeprefix(_PACKAGE)
        package, _, rest = inside.partition("/")
        for folder in (*self._folders, *above):
            yield folder / inside
            if folder.name == package:
                yield folder / rest
        for folder in above:  # a package that was renamed, or a part of it: its files next to the URDF
            yield folder / rest

    def hull(self, element: ET.Element) -> tuple[Any, Array]:
        """Coal's convex hull of a <mesh>, None of one that is flat; and its points."""
        path = self.find(element.get("filename", ""))
        scale = given_numbers(element.get("scale", "1 1 1").split(), (3,), "mesh scale", self.where)
        shown = printable(str(path))
        if path.stat().st_size > MOST_MESH_BYTES:
            remedy = "give a coarser mesh, or radii by `capsules`"
            raise InputError(f"mesh {shown} is longer than {MOST_MESH_BYTES >> 20} MiB", self.where, remedy)
        try:
            mesh = coal.MeshLoader().load(str(path), np.array(scale))
            points = np.array(mesh.vertices()).reshape(-1, 3)
        except (ValueError, RuntimeError):
            points = np.zeros((0, 3))
        if not len(points) or not (np.abs(points) < TUNING.longest).all():
            remedy = "give an STL, OBJ or DAE file in m, or radii by `capsules`"
            raise InputError(f"mesh {shown} cannot be read", self.where, remedy)
        return _hull(points), points


def _hull(points: Array) -> Any:
    """Coal's convex hull; None of points in one plane."""
    try:
        corners = points[scipy.spatial.ConvexHull(points).vertices]
        vectors = coal.StdVec_Vec3s()
        for corner in corners:
            vectors.append(corner)
        return coal.Convex.convexHull(vectors, True, "Qt")
    except (scipy.spatial.QhullError, ValueError, RuntimeError):
        return None


def _shapes(element: ET.Element, name: str, body: int, place: Array, meshes: _Meshes) -> Iterator[Shape]:
    """The shape of a <collision>; none of an element that is empty."""

    def length(found: ET.Element, key: str) -> float:
        value = float(given_numbers(found.get(key), (), f"{found.tag} {key}", meshes.where, TUNING.longest))
        if value <= 0.0:
            raise InputError(f"key '{found.tag} {key}' is not positive", meshes.where, "give a length in m")
        return value

    def shape(ends: Array, radius: float, solid: Any = None) -> Shape:
        return Shape(name, body, ends @ place[:3, :3].T + place[:3, 3], radius, solid, place)

    for found in element.findall("geometry/*"):
        if found.tag == "sphere":
            yield shape(np.zeros((2, 3)), length(found, "radius"))
        elif found.tag in ("cylinder", "capsule"):
            radius, long = length(found, "radius"), length(found, "length")
            ends = np.array([[0.0, 0.0, -long / 2.0], [0.0, 0.0, long / 2.0]])
            yield shape(ends, radius, coal.Cylinder(radius, long) if found.tag == "cylinder" else None)
        elif found.tag == "box":
            sides = given_numbers(found.get("size", "").split(), (3,), "box size", meshes.where, TUNING.longest)
            corners = np.array(np.meshgrid(*((-side / 2.0, side / 2.0) for side in sides))).reshape(3, -1).T
            yield shape(*enclosing_capsule(corners), coal.Box(*np.abs(sides)))
        elif found.tag == "mesh":
            hull, points = meshes.hull(found)
            yield shape(*enclosing_capsule(points), hull)
        else:
            raise InputError(f"a shape <{printable(found.tag)}> is not known", meshes.where, "give radii by `capsules`")
