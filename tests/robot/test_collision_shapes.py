"""Collision models of the shapes in a URDF: against MuJoCo, closed forms, and paths looked at on fine grids."""

import mujoco
import numpy as np
import pytest
from made_paths import FINE, GJK, poses, sines

from bayesid.errors import InputError
from bayesid.robot import load_robot
from bayesid.robot.collision import Capsules, NoShapes, collision_model


def link(name, *shapes):
    """A link with <collision> elements, each (shape, xyz, rpy)."""
    inertial = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    parts = (
        f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>'
        for shape, xyz, rpy in shapes
    )
    return f'<link name="{name}">{inertial}{"".join(parts)}</link>'


def joint(name, kind, parent, child, xyz, axis="0 0 1", rpy="0 0 0"):
    limit = "" if kind in ("fixed", "continuous") else '<limit lower="-9" upper="9" effort="9" velocity="9"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


BOX, BALL = '<box size="0.10 0.16 0.3"/>', '<sphere radius="0.07"/>'
ROLL = '<cylinder radius="0.05" length="0.4"/>'
ARM = (
    link("floor_plate", (BOX, "0.05 0 0.1", "0.2 0 0.4")),
    link("turret", (ROLL, "0 0.02 0.15", "0 0.3 0")),
    link("upper", (BOX, "0.2 0.05 0", "0 1.57 0.2"), (BALL, "0.35 0 0.05", "0 0 0")),
    link("slide", (ROLL, "0 0 0.2", "0.4 0 0")),
    link("bracket", (BOX, "0 0.1 0.1", "0.5 0.6 0.7")),
    link("hand", (BALL, "0.05 0 0.1", "0 0 0"), (BOX, "0 0 0.3", "0.3 0 0")),
    joint("a", "revolute", "floor_plate", "turret", "0 0 0.4"),
    joint("b", "continuous", "turret", "upper", "0.1 0 0.3", "0 1 0.2", "0.1 0 0.3"),
    joint("c", "prismatic", "upper", "slide", "0.5 0 0", "1 0 0.5"),
    joint("weld", "fixed", "slide", "bracket", "0 0 0.45", rpy="0 0.4 0.2"),
    joint("d", "revolute", "bracket", "hand", "0 0.1 0.2", "1 1 0"),
)


def urdf_robot(folder, *parts, name="robot.urdf"):
    (folder / name).write_text(f'<robot name="shaped">{"".join(parts)}</robot>', encoding="utf-8")
    return load_robot(folder / name)


def test_mujoco_finds_the_same_distances(tmp_path):
    """Of boxes, cylinders and balls on a chain with a fixed joint in it."""
    robot = urdf_robot(tmp_path, *ARM)
    model = collision_model(robot, np.array([0.3, -0.4, 0.2, 0.5]), floor=None, margin=-1.0)
    assert len(model.pairs) == 8
    assert all(("turret", other) in model.pairs for other in ("slide", "bracket", "hand"))
    keep = '<mujoco><compiler fusestatic="false"/></mujoco>'
    theirs = mujoco.MjModel.from_xml_string(
        (tmp_path / "robot.urdf").read_text().replace("</robot>", f"{keep}</robot>")
    )
    data, bodies = mujoco.MjData(theirs), {}
    for k in range(theirs.ngeom):
        bodies.setdefault(theirs.body(theirs.geom_bodyid[k]).name, []).append(k)
    base = next(name for name in bodies if name in ("world", "floor_plate"))
    bodies["floor_plate"] = bodies[base]
    apart = 0
    for q in poses(4, 60, 1, 1.5):
        data.qpos[:] = q
        mujoco.mj_forward(theirs, data)
        expected = min(
            mujoco.mj_geomDistance(theirs, data, i, j, 10.0, None)
            for one, other in model.pairs
            for i in bodies[one]
            for j in bodies[other]
        )
        found = model.distance(q[None])[0]
        if expected > 0.0:  # depths are not unique
            assert found == pytest.approx(expected, abs=GJK)
            apart += 1
        else:
            assert found <= GJK
    assert 20 <= apart <= 55


def test_a_path_of_solids_is_clear_where_a_fine_grid_is(tmp_path):
    robot = urdf_robot(tmp_path, *ARM)
    for seed in range(4):
        path, speed = sines(4, seed, 0.4)
        try:
            model = collision_model(robot, path(np.zeros(1))[0], floor=-2.0, margin=0.01)
        except InputError:
            continue
        least = model.distance(path(FINE[::4])).min()
        for margin, clear in ((least + 1e-4, False), (least - 0.01, True)):
            object.__setattr__(model, "margin", margin)
            assert model.stays_clear(path, np.linspace(0.0, 1.5, 5), speed) is clear


def stl(points, faces):
    lines = ["solid part"]
    for face in faces:
        corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in np.asarray(points, dtype=float)[list(face)])
        lines.append(f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet")
    return "\n".join([*lines, "endsolid part", ""])


BRACKET = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1], [0.02, 0.02, 0.02]])  # the last is inside
FACES = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (4, 1, 2), (4, 2, 3), (4, 1, 3)]
ON_SLIDES = (
    joint("x", "prismatic", "plate", "carriage", "0 0 0", "1 0 0"),
    joint("y", "prismatic", "carriage", "tool", "0 0 0", "0 1 0"),
)


def mesh_arm(folder, filename="package://parts/meshes/tool.stl", scale="1 1 2", near=BALL):
    mesh = f'<mesh filename="{filename}" scale="{scale}"/>'
    return urdf_robot(
        folder,
        link("plate", (near, "1 0 0.07", "0 0 0")),
        link("carriage"),
        link("tool", (mesh, "0 0 0.3", "0 0 0")),
        *ON_SLIDES,
    )


@pytest.fixture
def package(tmp_path):
    """A ROS package `parts` with a mesh and a folder for URDFs."""
    for folder in ("meshes", "urdf"):
        (tmp_path / "parts" / folder).mkdir(parents=True)
    (tmp_path / "parts" / "meshes" / "tool.stl").write_text(stl(BRACKET, FACES), encoding="utf-8")
    return tmp_path / "parts"


def test_a_mesh_counts_as_its_convex_hull(package):
    """A tetrahedron with a dent: its distance to a ball is that to the slanted face; and it is scaled."""
    robot = mesh_arm(package / "urdf")
    model = collision_model(robot, np.zeros(2), floor=0.0)
    assert "convex hulls" in model.source
    assert "joint x" in model.source  # the carriage has no shape
    assert model.pairs == (("plate", "tool"),)  # sliding level, nothing comes nearer to the floor
    corners, ball = BRACKET[:4] * [1, 1, 2] + [0, 0, 0.3], np.array([1.0, 0.0, 0.07])
    for x, y in ((0.2, 0.05), (1.3, -0.1), (0.7, -0.6)):
        expected = to_hull(ball, corners + np.array([x, y, 0.0])) - 0.07
        assert model.distance(np.array([[x, y]]))[0] == pytest.approx(expected, abs=GJK)


def to_hull(point, corners):
    """Distance of a point from the hull of corners, as the quadratic problem that it is."""
    from scipy.optimize import minimize

    n = len(corners)
    found = minimize(
        lambda w: ((w @ corners - point) ** 2).sum(),
        np.full(n, 1.0 / n),
        jac=lambda w: 2.0 * corners @ (w @ corners - point),
        bounds=[(0.0, 1.0)] * n,
        constraints={"type": "eq", "fun": lambda w: w.sum() - 1.0, "jac": lambda w: np.ones(n)},
        options={"ftol": 1e-15, "maxiter": 500},
    )
    return float(np.sqrt(found.fun))


def test_a_flat_mesh_counts_as_a_capsule_that_holds_it(tmp_path):
    (tmp_path / "tool.stl").write_text(stl(BRACKET[:3], FACES[:1]), encoding="utf-8")
    model = collision_model(mesh_arm(tmp_path, "tool.stl", near=BOX), np.zeros(2), floor=None)
    assert 0.5 < model.distance(np.zeros((1, 2)))[0] < np.hypot(0.65, 0.08), "of the nearest corner"


def test_meshes_are_found_above_the_urdf_and_in_ros_package_path(package, tmp_path, monkeypatch):
    expected = collision_model(mesh_arm(package / "urdf"), np.zeros(2)).distance(np.zeros((1, 2)))
    hidden = tmp_path / "hidden" / "src"
    hidden.mkdir(parents=True)
    robot = mesh_arm(tmp_path)  # the folder that holds the package is above this URDF too
    np.testing.assert_array_equal(collision_model(robot, np.zeros(2)).distance(np.zeros((1, 2))), expected)
    package.rename(hidden / "parts")
    with pytest.raises(InputError, match=r"mesh package://parts/meshes/tool.stl is not found.*ROS_PACKAGE_PATH"):
        collision_model(robot, np.zeros(2))
    for folder in (hidden, hidden / "parts"):
        found = collision_model(robot, np.zeros(2), folders=[folder]).distance(np.zeros((1, 2)))
        np.testing.assert_array_equal(found, expected)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{hidden}")
    np.testing.assert_array_equal(collision_model(robot, np.zeros(2)).distance(np.zeros((1, 2))), expected)


def test_a_mesh_that_cannot_be_used_is_refused(tmp_path):
    huge = stl([[0, 0, 0], [2e3, 0, 0], [0, 1, 0]], [(0, 1, 2)])
    for content, filename in (("solid nothing", "tool.stl"), ("", "tool.obj"), (huge, "tool.stl")):
        (tmp_path / filename).write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match="cannot be read"):
            collision_model(mesh_arm(tmp_path, filename), np.zeros(2))


def test_a_shape_that_cannot_be_used_is_refused(tmp_path):
    for shape, said in (
        ('<sphere radius="-1"/>', "not positive"),
        ('<cylinder radius="1"/>', "length"),
        ('<box size="1 2"/>', "box size"),
        ('<cone radius="1"/>', "not supported"),
    ):
        tool = link("tool", (shape, "0 0 0", "0 0 0"))
        robot = urdf_robot(tmp_path, link("plate"), link("carriage"), tool, *ON_SLIDES)
        with pytest.raises(InputError, match=said):
            collision_model(robot, np.zeros(2))


def test_a_robot_without_shapes_says_why(tmp_path):
    bare = urdf_robot(tmp_path, link("plate"), link("carriage"), link("tool"), *ON_SLIDES)
    for robot, why in ((load_robot("ur10e"), "not known"), (bare, "no collision shapes")):
        found = collision_model(robot, np.zeros(robot.n_joints))
        assert isinstance(found, NoShapes)
        assert why in found.reason
    assert isinstance(collision_model(bare, np.zeros(2), Capsules(0.05), floor=None), NoShapes), "two links only"
