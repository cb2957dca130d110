"""Shapes of a robot's links: capsules along its kinematics, or a URDF's collision shapes."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.bounded import MOST_BYTES, read_source, xml_of
from bayesid.robot import Robot
from bayesid.robot.arm import Origin, given_numbers
from bayesid.robot.tuning import TUNING
from bayesid.robot.urdf import hold_joints, place_links
from bayesid.robot.urdf_tree import origin_of, read_tree

BASE = -1  # index of the body that does not move, as a joint's parent
_SHORTEST = 1e-9  # m; a line that is shorter is rounding
MOST_MESH_BYTES = 8 * MOST_BYTES  # of a mesh file, 64 MiB; the largest of example-robot-data has 28
_PACKAGE, _FILE = "package://", "file://"


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a link, in the frame of the joint that moves it."""

    name: str  #: of the link
    body: int  #: index of the joint that moves it; `BASE` for none
    solid: Any  #: geometry of coal
    place: Array  #: (4, 4) frame of the solid
    #: whether it is the capsule of a prismatic joint's extension, from its zero to its position
    rod: bool = False

    @property
    def round(self) -> bool:
        """Whether it is a capsule or a ball that keeps its length."""
        return isinstance(self.solid, coal.Capsule | coal.Sphere) and not self.rod

    @property
    def floor(self) -> bool:
        """Whether it is the half space below a plane."""
        return isinstance(self.solid, coal.Halfspace)

    @cached_property
    def corners(self) -> Array:
        """(8, 3) of a box that holds it, m."""
        self.solid.computeLocalAABB()
        box = self.solid.aabb_local
        corners = np.array(list(product(*zip(box.min_, box.max_, strict=True))))
        return corners @ self.place[:3, :3].T + self.place[:3, 3]


def floor_shape(up: Array, height: float) -> Shape:
    """Half space below a plane with unit normal (3,) in the base frame, at a height along it, m."""
    return Shape("floor", BASE, coal.Halfspace(up, height), np.eye(4))


def capsule_shapes(robot: Robot, radii: float | Sequence[float], tool: Sequence[float]) -> list[Shape]:
    """One capsule per link, about the line from its joint to the next (`bayesid.robot.collision.Capsules`).

    A link with both an offset along an axis and a length across it has a corner, as in a Denavit-Hartenberg step, and
    two capsules. The last link ends at its own frame, or at the tool's end. InputError for invalid radii or tool.
    """
    widths, end = _widths(robot, radii), np.asarray(tool, dtype=float)
    if end.shape != (3,) or not np.isfinite(end).all():
        remedy = "give x,y,z of its end in the last link's frame, m"
        raise InputError(f"{end.size} numbers", field="tool", remedy=remedy)
    standard = any(not np.array_equal(joint.link_frame, np.eye(4)) for joint in robot.joints)
    found = []
    for body in range(BASE, robot.n_joints):
        name, radius = "base" if body == BASE else f"link {body + 1}", widths[max(body, 0)]
        if body != BASE and robot.joints[body].prismatic:
            found.append(Shape(name, body, coal.Capsule(radius, 0.0), np.eye(4), rod=True))
        lines = [line for corners in _lines(robot, body, end, standard) for line in _pieces(corners)]
        for start, stop in lines:
            way, place = stop - start, np.eye(4)
            place[:3, :3], place[:3, 3] = upright(way), (start + stop) / 2.0
            found.append(Shape(name, body, coal.Capsule(radius, float(np.linalg.norm(way))), place))
        if not lines and body != BASE:
            found.append(Shape(name, body, coal.Sphere(radius), np.eye(4)))
    return found


def upright(way: Array) -> Array:
    """(3, 3) rotation of z, the axis of a capsule, into a direction (3,)."""
    rotation, _ = scipy.spatial.transform.Rotation.align_vectors(way[None], np.array([[0.0, 0.0, 1.0]]))
    return rotation.as_matrix()


def _widths(robot: Robot, radii: float | Sequence[float]) -> list[float]:
    given = np.atleast_1d(np.asarray(radii, dtype=float)).tolist()
    given = given * robot.n_joints if len(given) == 1 else given
    remedy = f"give one radius in m, or {robot.n_joints} from base to tip"
    if len(given) != robot.n_joints:
        raise InputError(f"{len(given)} radii, but {robot.n_joints} links", field="capsules", remedy=remedy)
    if not all(0.0 < radius <= 10.0 for radius in given):  # a larger one is in another unit
        raise InputError("a radius is not between 0 and 10 m", field="capsules", remedy=remedy)
    return given


def _lines(robot: Robot, body: int, tool: Array, standard: bool) -> Iterator[Array]:
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
        frame = here.link_frame if here.tip is None else here.link_frame @ here.tip
        flange = frame[:3, 3]
        end = flange + frame[:3, :3] @ tool
        yield np.stack([np.zeros(3), here.axis * (here.axis @ flange), flange, end])


def _pieces(corners: Array) -> Iterator[Array]:
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - kept[-1]) > _SHORTEST:
            yield np.stack([kept[-1], corner])
            kept.append(corner)


def urdf_shapes(origin: Origin, n_joints: int, folders: Sequence[str | Path] = ()) -> list[Shape]:
    """Shapes of <collision> elements of a robot that was loaded from a URDF, in the frames of the joints that move.

    Mesh packages are searched in the folders first. InputError if a mesh is not found or cannot be read, a number is
    invalid, or the file has changed.
    """
    assert origin.urdf is not None
    where = printable(str(origin.urdf))
    text = read_source(origin.urdf, "give a URDF file")
    tree = read_tree(text, where)
    held, _ = hold_joints(tree, origin.tip, origin.hold, where)
    joints, places = place_links(tree, held)
    if len(joints) != n_joints:
        raise InputError("its joints have changed since the robot was loaded", where, "load the robot again")
    shapes = []
    for link in xml_of(text, where).findall("link"):
        name = link.get("name", "")
        body, frame = places[name]
        for element in link.findall("collision"):
            here = f"{where}, link {printable(name)}"
            place = frame @ origin_of(element, here)
            for found in element.findall("geometry/*"):
                solid, inside = _solid(found, origin.urdf, folders, here)
                shapes.append(Shape(printable(name), body, solid, place @ inside))
    return shapes


def _mesh_file(name: str, urdf: Path, folders: Sequence[str | Path], where: str) -> Path:
    """File of a mesh: in a package of the folders or above the URDF, or relative to the URDF."""
    above, listed = urdf.resolve().parents, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    inside = name.removeprefix(_PACKAGE)
    package, _, relative = inside.partition("/")
    candidates = [above[0] / name.removeprefix(_FILE)]
    if name.startswith(_PACKAGE):
        places, candidates = [*map(Path, [*folders, *filter(None, listed)]), *above], []
        for folder in places:
            candidates += [folder / inside, *([folder / relative] if folder.name == package else [])]
        candidates += [folder / relative for folder in above]  # a renamed or partial package
    for path in candidates:
        try:
            if path.is_file():
                return path
        except (OSError, ValueError):  # not a file name
            continue
    remedy = "set ROS_PACKAGE_PATH to the folder that holds its package, or give radii by `capsules`"
    raise InputError(f"mesh {printable(name)} is not found", where, remedy)


def mesh_points(path: Path, scale: Array, where: str) -> Array:
    """(N, 3) corners of a mesh, m, each axis scaled.

    Raises:
        InputError: it cannot be read.
    """
    shown = printable(str(path))
    if not path.is_file():
        raise InputError(f"mesh {shown} is not found", where, "give an STL, OBJ or DAE file in m")
    if path.stat().st_size > MOST_MESH_BYTES:
        remedy = "give a coarser mesh, or radii by `capsules`"
        raise InputError(f"mesh {shown} is longer than {MOST_MESH_BYTES >> 20} MiB", where, remedy)
    try:
        mesh = coal.MeshLoader().load(str(path), np.array(scale))
        points: Array = np.array(mesh.vertices()).reshape(-1, 3)
    except (ValueError, RuntimeError):
        points = np.zeros((0, 3))
    if not len(points) or not (np.abs(points) < TUNING.longest).all():
        remedy = "give an STL, OBJ or DAE file in m, or radii by `capsules`"
        raise InputError(f"mesh {shown} cannot be read", where, remedy)
    return points


def _mesh_hull(path: Path, scale: Array, where: str) -> tuple[Any, Array]:
    """Convex hull of a mesh (a box for a flat one), and its (4, 4) frame in the mesh frame."""
    points, frame = mesh_points(path, scale, where), np.eye(4)
    try:
        corners = points[scipy.spatial.ConvexHull(points).vertices]
        vectors = coal.StdVec_Vec3s()
        for corner in corners:
            vectors.append(corner)
        return coal.Convex.convexHull(vectors, True, "Qt"), frame
    except (scipy.spatial.QhullError, ValueError, RuntimeError):  # flat
        low, high = points.min(axis=0), points.max(axis=0)
        frame[:3, 3] = (low + high) / 2.0
        return coal.Box(*(high - low + 2.0 * _SHORTEST)), frame


def _solid(found: ET.Element, urdf: Path, folders: Sequence[str | Path], where: str) -> tuple[Any, Array]:
    """The solid of a <collision> shape, and its (4, 4) frame in the element's."""

    def length(key: str) -> float:
        value = float(given_numbers(found.get(key), (), f"{found.tag} {key}", where, TUNING.longest))
        if value <= 0.0:
            raise InputError(f"key '{found.tag} {key}' is not positive", where, "give a length in m")
        return value

    if found.tag == "mesh":
        path = _mesh_file(found.get("filename", ""), urdf, folders, where)
        scale = given_numbers(found.get("scale", "1 1 1").split(), (3,), "mesh scale", where)
        return _mesh_hull(path, scale, where)
    if found.tag == "sphere":
        return coal.Sphere(length("radius")), np.eye(4)
    if found.tag in ("cylinder", "capsule"):
        kind = coal.Cylinder if found.tag == "cylinder" else coal.Capsule
        return kind(length("radius"), length("length")), np.eye(4)
    if found.tag == "box":
        sides = given_numbers(found.get("size", "").split(), (3,), "box size", where, TUNING.longest)
        return coal.Box(*np.abs(sides)), np.eye(4)
    raise InputError(f"shape <{printable(found.tag)}> is not supported", where, "give radii by `capsules`")
