"""Shapes that a URDF gives its links for collisions; of meshes the convex hulls, which hold them."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.bounded import MOST_BYTES, read_source, xml_of
from bayesid.robot.arm import Origin
from bayesid.robot.collision.shapes import Shape, enclosing_capsule
from bayesid.robot.held_joints import hold_joints
from bayesid.robot.numbers import LONGEST, given_numbers
from bayesid.robot.urdf import place_links
from bayesid.robot.urdf_tree import read_tree

MOST_MESH_BYTES = 8 * MOST_BYTES
"""Of a mesh file, 64 MiB; the largest of example-robot-data has 28."""
_PACKAGE, _FILE = "package://", "file://"
_HOW_TO_FIND = "set ROS_PACKAGE_PATH to the folder that holds its package, or give radii by --capsules"


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
    frame[:3, 3] = given_numbers(given.get("xyz", "0 0 0").split(), (3,), "origin xyz", where, LONGEST)
    angles = given_numbers(given.get("rpy", "0 0 0").split(), (3,), "origin rpy", where)
    frame[:3, :3] = scipy.spatial.transform.Rotation.from_euler("xyz", angles).as_matrix()
    return frame


class _Meshes:
    """Finds the mesh files of a URDF.

    Args:
        urdf: the file.
        folders: where packages are looked for first.
        where: what to name in an error.
    """

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
        raise InputError(f"mesh {printable(name)} is not found", self.where, _HOW_TO_FIND)

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
            remedy = "give a coarser mesh, or radii by --capsules"
            raise InputError(f"mesh {shown} is longer than {MOST_MESH_BYTES >> 20} MiB", self.where, remedy)
        try:
            mesh = coal.MeshLoader().load(str(path), np.array(scale))
            points = np.array(mesh.vertices()).reshape(-1, 3)
        except (ValueError, RuntimeError):
            points = np.zeros((0, 3))
        if not len(points) or not (np.abs(points) < LONGEST).all():
            remedy = "give an STL, OBJ or DAE file in m, or radii by --capsules"
            raise InputError(f"mesh {shown} cannot be read", self.where, remedy)
        return _hull(points), points


def _hull(points: Array) -> Any:
    """Coal's convex hull; None of points in one plane."""
    try:
        corners = points[scipy.spatial.ConvexHull(points).vertices]
        return coal.Convex.convexHull(_vectors(corners), True, "Qt")
    except (scipy.spatial.QhullError, ValueError, RuntimeError):
        return None


def _vectors(points: Array) -> coal.StdVec_Vec3s:
    vectors = coal.StdVec_Vec3s()
    for point in points:
        vectors.append(point)
    return vectors


def _shapes(element: ET.Element, name: str, body: int, place: Array, meshes: _Meshes) -> Iterator[Shape]:
    """The shape of a <collision>; none of an element that is empty."""

    def length(found: ET.Element, key: str) -> float:
        value = float(given_numbers(found.get(key), (), f"{found.tag} {key}", meshes.where, LONGEST))
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
            sides = given_numbers(found.get("size", "").split(), (3,), "box size", meshes.where, LONGEST)
            corners = np.array(np.meshgrid(*((-side / 2.0, side / 2.0) for side in sides))).reshape(3, -1).T
            yield shape(*enclosing_capsule(corners), coal.Box(*np.abs(sides)))
        elif found.tag == "mesh":
            hull, points = meshes.hull(found)
            yield shape(*enclosing_capsule(points), hull)
        else:
            raise InputError(f"a shape <{printable(found.tag)}> is not known", meshes.where, "give radii by --capsules")
