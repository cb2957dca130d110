"""Collision models: against coal, MuJoCo, closed forms, and paths looked at on fine grids."""

from itertools import combinations, pairwise

import coal
import mujoco
import numpy as np
import pytest
from conftest import real_log
from oracles import built_in_table, dh_chain, random_table, turn

import bayesid
from bayesid.errors import InputError
from bayesid.model.collision import Capsules, NoShapes, collision_model
from bayesid.model.collision import clearance as clearances
from bayesid.model.collision.distances import PairDistances, solid_of
from bayesid.model.collision.frames import line_distances
from bayesid.model.collision.shapes import capsules, enclosing_capsule
from bayesid.model.robot import load_robot, robot_from_table

WIDTHS = (0.05, 0.04, 0.03, 0.06, 0.035, 0.045, 0.025)
GJK = 1e-5  # ten times the tolerance of coal's iterations


def arm(n=7, seed=0, convention="standard", slides=False):
    """A random arm that is level, and its table; with sliding joints if asked for."""
    table = random_table(convention, n, seed)
    table["gravity"] = [0.0, 0.0, -9.81]
    if not slides:
        table["joints"] = [{**row, "type": "revolute"} for row in table["joints"]]
    return robot_from_table(table, "test"), table


def poses(n, count, seed=0, size=2.5):
    return np.random.default_rng(seed).uniform(-size, size, (count, n))


# ---------------------------------------------------------------------------------------------------------------
# Lines and capsules
# ---------------------------------------------------------------------------------------------------------------
def by_search(a, b):
    """Distance of two lines by bounded least squares, whose problem is convex."""
    from scipy.optimize import lsq_linear

    matrix = np.stack([a[1] - a[0], b[0] - b[1]], axis=1)
    found = lsq_linear(matrix, b[0] - a[0], (0.0, 1.0), method="bvls", tol=1e-14)
    return np.linalg.norm(matrix @ found.x - (b[0] - a[0]))


LINES = [
    *(np.random.default_rng(seed).uniform(-1, 1, (2, 2, 3)) for seed in range(300)),
    *(np.random.default_rng(seed).uniform(-1, 1, (2, 2, 3)) * [[[1, 1, 0]], [[1, 1, 0]]] for seed in range(50)),
    np.array([[[0, 0, 0], [1, 0, 0]], [[0.2, 0.3, 0], [0.9, 0.3, 0]]]),  # parallel, side by side
    np.array([[[0, 0, 0], [1, 0, 0]], [[2.0, 0.3, 0], [3.0, 0.3, 0]]]),  # parallel, one after the other
    np.array([[[0, 0, 0], [0, 0, 0]], [[2.0, 0.3, 0], [3.0, 0.3, 0]]]),  # a point and a line
    np.array([[[0, 0, 0], [0, 0, 0]], [[2.0, 0.3, 0], [2.0, 0.3, 0]]]),  # two points
    np.array([[[0, 0, 0], [1, 0, 0]], [[0.3, -1, 0], [0.3, 2, 0]]]),  # crossing
    np.array([[[0, 0, 0], [1, 0, 0]], [[0.3, -1e-7, 0.2], [0.9, 1e-7, 0.2]]]),  # nearly parallel
]


def test_lines_are_as_far_apart_as_a_search_finds():
    lines = np.array(LINES, dtype=float)
    found = line_distances(lines[:, :, 0], lines[:, :, 1], np.array([0]), np.array([1]))[:, 0]
    expected = [by_search(*pair) for pair in lines]
    np.testing.assert_allclose(found, expected, atol=1e-7)  # the root of the rounding of squared lengths
    assert (np.array(expected) < 1e-7).sum() > 3  # some do cross


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("slides", [False, True])
def test_capsules_follow_the_table(convention, seed, slides):
    """Corners at the table's own frames: offsets along z, lengths along x; what slides out may overlap."""
    robot, table = arm(6, seed, convention, slides)
    shapes = capsules(robot, WIDTHS[:6])
    pairs = list(combinations(shapes, 2))
    distances, chain = PairDistances(robot, pairs, None), dh_chain(table)
    for q in poses(6, 4, seed, 0.8):
        frames, rows = [np.eye(4), *chain(q)[0]], table["joints"]
        lines = []
        for before, after, row in zip(frames[:-1], frames[1:], rows, strict=True):
            # standard: along z of the frame before; modified: along x of the frame before, then along z of the next
            corner = before[:3, 3] + before[:3, 0] * row["a"]
            if convention == "standard":
                corner = after[:3, 3] - after[:3, 0] * row["a"]
            lines += [(before[:3, 3], corner), (corner, after[:3, 3])]
        starts, ends = distances.lines(distances.bounds(q[None])[1])
        found = list(zip(starts[0], ends[0], strict=True))
        for points, skeleton in ((lines, found),) if slides else ((lines, found), (found, lines)):
            on_line = [(1 - s) * a + s * b for a, b in points for s in (0.0, 0.3, 1.0)]
            assert max(min(by_search((p, p), line) for line in skeleton) for p in on_line) < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_coal_finds_the_capsules_distances(seed):
    robot, _ = arm(7, seed)
    shapes = capsules(robot, WIDTHS)
    pairs = list(combinations(shapes, 2))
    distances = PairDistances(robot, pairs, None)
    q = poses(7, 20, seed)
    found, frames = distances.bounds(q)
    apart = 0
    for row, at in zip(found, frames, strict=True):
        for distance, pair in zip(row, pairs, strict=True):
            placed = [(solid, at[shape.body] @ place) for shape in pair for solid, place in [solid_of(shape)]]
            (a, ta), (b, tb) = ((s, coal.Transform3s(t[:3, :3], t[:3, 3])) for s, t in placed)
            theirs = coal.distance(a, ta, b, tb, coal.DistanceRequest(), coal.DistanceResult())
            assert theirs == pytest.approx(distance, abs=GJK)
            apart += distance > 0.0
    assert 0 < apart < found.size


def test_a_capsule_holds_the_points_that_it_encloses(rng):
    for scale in ([1.0, 1.0, 1.0], [3.0, 0.2, 0.5], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0]):
        points = rng.normal(size=(60, 3)) * scale @ turn((0.6, 0.0, 0.8), 1.1).T + [0.3, -0.2, 0.1]
        ends, radius = enclosing_capsule(points)
        reach = max(by_search((p, p), ends) for p in points)
        assert reach <= radius + 1e-9
        assert reach >= radius - 1e-6  # and none smaller about this line


def test_a_capsule_around_the_points_of_one_is_hardly_larger(rng):
    along, normals = rng.uniform(-0.4, 0.4, (4000, 1)) * [1.0, 0.0, 0.0], rng.normal(size=(4000, 3))
    along[np.abs(along) > 0.35] = np.sign(along[np.abs(along) > 0.35]) * 0.4
    points = along + 0.1 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    ends, radius = enclosing_capsule(points)
    assert 0.099 < radius < 0.103
    assert 0.78 < np.linalg.norm(ends[1] - ends[0]) < 0.86


def test_radii_are_checked():
    robot, _ = arm()
    for radii in (0.0, -0.1, [0.1] * 6, 80.0, float("nan")):
        with pytest.raises(InputError, match="capsules"):
            collision_model(robot, np.zeros(7), Capsules(radii))


def test_a_tool_is_checked():
    robot, _ = arm()
    for tool in ((0.0, 0.1), (0.0, 0.0, float("inf"))):
        with pytest.raises(InputError, match=r"^tool: \d numbers"):
            collision_model(robot, np.zeros(7), Capsules(0.05, tool))


def test_capsules_that_tell_nothing_are_refused():
    """They were asked for: a motion that nobody has checked must not pass for one that was."""
    robot, rest = load_robot("ur10e"), np.array([0.0, -1.2, 1.5, -1.0, -1.5, 0.0])
    for radius, margin in ((5.0, 0.01), (0.06, 2.0)):
        with pytest.raises(InputError, match=rf"all distances are less than {margin:g} m.*narrower"):
            collision_model(robot, rest, Capsules(radius), floor=None, margin=margin)


# ---------------------------------------------------------------------------------------------------------------
# Which pairs count
# ---------------------------------------------------------------------------------------------------------------
def test_built_in_robots_are_clear_where_they_stand():
    """With radii of about their links'."""
    for name, q, radius in (
        ("kr5", [0.1, -1.2, 0.5, 0.2, 0.8, 0.0], 0.06),
        ("ur10e", [0.0, -1.2, 1.5, -1.0, -1.5, 0.0], 0.06),
        ("panda", [0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7], 0.06),
    ):
        robot = load_robot(name)
        model = collision_model(robot, np.array(q), Capsules(radius))
        assert not model.left_out
        assert model.distance(np.array([q]))[0] >= 0.01
        assert ("link 1", "link 2") not in model.pairs + model.inseparable
        assert {pair[1] for pair in model.pairs} >= {"floor", "link 4", "link 6"}


@pytest.mark.parametrize(("log", "robot"), [("ur10e/a_50s.csv", "ur10e"), ("panda/a.csv", "panda")])
def test_robots_are_clear_where_their_logs_were(log, robot):
    table = np.genfromtxt(real_log(log), delimiter=",", names=True)
    arm_ = load_robot(robot)
    q = np.stack([table[f"q{j}"] for j in range(1, arm_.n_joints + 1)], axis=1)[::20]
    model = collision_model(arm_, q, Capsules(0.05), floor=None)
    assert set(model.left_out) <= {("link 2", "link 4")}  # at panda's elbow, whose lines pass at 83 mm
    assert model.distance(q).min() >= model.margin
    assert ("base" if robot == "panda" else "link 1", "link 5") in model.pairs


def test_wrists_that_never_part_are_named_and_do_not_count():
    """Three axes of kr5's wrist meet: links 4 and 6 have one point in common in every pose."""
    robot = load_robot("kr5")
    model = collision_model(robot, np.array([0.0, -1.2, 0.5, 0.0, 0.8, 0.0]), Capsules(0.06))
    assert ("link 4", "link 6") in model.inseparable
    assert ("link 4", "link 6") not in model.pairs
    q = poses(6, 200)
    chain = dh_chain(built_in_table("kr5"))
    for one in q[:20]:
        frames = chain(one)[0]
        np.testing.assert_allclose(frames[3][:3, 3], frames[4][:3, 3], atol=1e-12)


def test_what_overlaps_where_the_robot_has_been_is_named():
    robot = load_robot("ur10e")
    folded = np.array([0.0, -1.2, 3.0, -1.0, -1.5, 0.0])
    wide = collision_model(robot, folded, Capsules(0.08), floor=None)
    distance, pair = collision_model(robot, np.array([0.0, -1.2, 1.5, -1.0, -1.5, 0.0]), Capsules(0.08), None).nearest(
        folded
    )
    assert distance < 0.0
    assert pair in wide.left_out
    assert pair not in wide.pairs
    both = collision_model(robot, np.stack([folded * 0.5, folded]), Capsules(0.08), floor=None)
    assert both.left_out == wide.left_out


def test_a_wrist_that_touches_the_base_column():
    """UR10e, folded: the flange's line and the column's, of 181 mm, by the table's own frames."""
    robot = load_robot("ur10e")
    model = collision_model(robot, np.array([0.0, -1.2, 1.5, -1.0, -1.5, 0.0]), Capsules(0.06), floor=None)
    chain, column = dh_chain(built_in_table("ur10e")), (np.zeros(3), np.array([0.0, 0.0, 0.1807]))
    q = poses(6, 10000, 3, 3.0)
    touched = 0
    for one in q[model.distance(q) < 0.03][:150]:
        frames = chain(one)[0]
        lines = [(a[:3, 3], b[:3, 3]) for a, b in pairwise(frames[2:])]
        expected = min(by_search(column, line) for line in lines) - 0.12
        if model.nearest(one)[1] in [("link 1", f"link {k}") for k in (4, 5, 6)]:
            assert model.nearest(one)[0] == pytest.approx(expected, abs=1e-6)
            touched += expected < 0.0
    assert touched >= 5


def test_a_robot_without_shapes_says_why():
    found = collision_model(load_robot("ur10e"), np.zeros(6))
    assert isinstance(found, NoShapes)
    assert "not known" in found.reason


# ---------------------------------------------------------------------------------------------------------------
# The floor
# ---------------------------------------------------------------------------------------------------------------
STANDING = np.array([0.3, -1.2, 1.5, -1.0, -1.5, 0.4])


def test_the_floor_is_as_far_as_the_lowest_frame_less_the_radius():
    robot, chain = load_robot("ur10e"), dh_chain(built_in_table("ur10e"))
    model = collision_model(robot, STANDING, Capsules(WIDTHS[:6]), floor=-0.4)
    both = PairDistances(robot, [pair for pair in model._shapes if pair[1] is None], model._distances._floor)
    for q in poses(6, 50):
        frames = [np.eye(4), *chain(q)[0]]
        lows = [min(a[2, 3], b[2, 3]) - w for a, b, w in zip(frames[1:6], frames[2:7], WIDTHS[1:6], strict=True)]
        assert both.least(q[None])[0][0] == pytest.approx(min(lows) + 0.4, abs=1e-9)


def test_a_link_that_stands_on_the_floor_does_not_count_and_another_is_refused():
    robot = load_robot("ur10e")
    model = collision_model(robot, STANDING, Capsules(0.06))
    assert ("link 1", "floor") in model.inseparable
    assert ("link 2", "floor") in model.pairs
    down = np.array([0.0, 0.4, 0.5, 0.0, -1.5, 0.0])  # the elbow 240 mm below the shoulder
    lowest = min(frame[2, 3] for frame in dh_chain(built_in_table("ur10e"))(down)[0]) - 0.06
    with pytest.raises(InputError, match=rf"link \d is {-lowest:.3f} m below the floor") as refused:
        collision_model(robot, down, Capsules(0.06))
    enough = float(refused.value.remedy.split("origin, ")[1].split(" or less")[0])
    assert lowest - 0.01 - 0.01 <= enough <= lowest - 0.01
    assert collision_model(robot, down, Capsules(0.06), floor=enough).distance(down[None])[0] >= 0.01
    with pytest.raises(InputError, match=r"0.005 m above the floor"):
        collision_model(robot, down, Capsules(0.06), floor=lowest - 0.005)
    assert all(pair[1] != "floor" for pair in collision_model(robot, down, Capsules(0.06), floor=None).pairs)


def test_the_floor_is_level_also_where_the_robot_hangs_on_a_wall():
    """The table's own frames, turned so that its z is level."""
    table = {**built_in_table("ur10e"), "gravity": [9.81 * 0.6, 0.0, 9.81 * -0.8]}
    robot, chain = robot_from_table(table, "wall"), dh_chain(table)
    model = collision_model(robot, STANDING, Capsules(0.06), floor=-1.1)
    assert "against gravity" in model.source
    floor = [pair for pair in model._shapes if pair[1] is None]
    distances = PairDistances(robot, floor, model._distances._floor)
    for q in poses(6, 50):
        ends = np.array([np.zeros(3), *(frame[:3, 3] for frame in chain(q)[0])])
        lowest = (ends @ [-0.6, 0.0, 0.8]).min()
        assert distances.least(q[None])[0][0] == pytest.approx(lowest - 0.06 + 1.1, abs=1e-9)


# ---------------------------------------------------------------------------------------------------------------
# Paths
# ---------------------------------------------------------------------------------------------------------------
def sines(n, seed, size=1.0):
    """A motion (path, bounds of its speeds) with amplitudes of their own."""
    rng = np.random.default_rng(seed)
    start, amplitude, rate, phase = rng.uniform([[-2], [0.2], [0.5], [0]], [[2], [0.6], [3.0], [6]], (4, n))

    def path(t):
        return start + size * amplitude * np.sin(rate * t[:, None] + phase)

    return path, size * amplitude * rate


FINE = np.linspace(0.0, 1.5, 2001)


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("samples", [2, 40])
def test_a_path_is_clear_where_a_fine_grid_is(slides, samples):
    """Both ways, with a margin a little below and above the least distance: nothing but what lies between is unsure."""
    clear = 0
    for seed in range(8):
        robot, table = arm(7, seed, slides=slides)
        path, speed = sines(7, seed)
        longest = sum(abs(row["a"]) + abs(row["d"]) + 3.0 * (row["type"] == "prismatic") for row in table["joints"])
        begin = path(np.zeros(1))[0]
        model = collision_model(robot, begin, Capsules(WIDTHS), floor=None, margin=0.01)
        least = model.distance(path(FINE)).min()
        between = np.diff(FINE)[0] / 2.0 * speed.sum() * max(longest, 1.0)  # no link is farther from an axis
        for margin in (0.01, least + between + 1e-4, least - between - clearances.FINEST - 2e-5):
            object.__setattr__(model, "margin", margin)
            found = model.stays_clear(path, np.linspace(0.0, 1.5, samples), speed)
            if margin > least:
                assert not found
            elif margin < least - between - clearances.FINEST:
                assert found
                clear += 1
    assert clear >= 8


def test_a_touch_between_two_samples_is_found_and_a_near_miss_passes():
    """A link of 0.5 m dips to the floor for 20 ms; the three samples see it 0.2 m above."""
    table = {
        "name": "pendulum",
        "convention": "standard",
        "joints": [
            {"a": 0.0, "alpha": -np.pi / 2, "d": 0.4, "theta": 0.0},
            {"a": 0.5, "alpha": 0.0, "d": 0.0, "theta": 0.0},
        ],
    }
    robot = robot_from_table(table, "test")
    model = collision_model(robot, np.zeros(2), Capsules(0.05), margin=0.01)

    def dip(depth):
        """Joint 2 turns the link down, for an instant as far as the floor is `depth` within the margin."""
        deepest = np.arcsin((0.4 - 0.05 - 0.01 + depth) / 0.5)

        def path(t):
            bell = np.exp(-(((t - 0.31) / 0.01) ** 2))
            return np.stack([0.8 * np.sin(3.0 * t), 0.2 + (deepest - 0.2) * bell], axis=1)

        return path, np.array([2.4, (deepest - 0.2) * np.sqrt(2.0 / np.e) / 0.01])

    t = np.array([0.0, 0.7, 1.4])
    for depth, clear in ((2e-5, False), (0.002, False), (0.1, False), (-0.003, True), (-0.01, True)):
        path, speed = dip(depth)
        assert model.distance(path(t)).min() > 0.2
        assert model.stays_clear(path, t, speed) is clear


def test_speeds_may_differ_from_interval_to_interval():
    robot = load_robot("ur10e")
    model = collision_model(robot, STANDING, Capsules(0.06))

    def path(t):
        return STANDING + np.maximum(t - 1.0, 0.0)[:, None] * [0.5, 0.0, 0.4, 0.0, 0.0, 0.0]

    t = np.linspace(0.0, 1.5, 31)
    speeds = np.where(t[:-1, None] < 1.0 - 1e-9, 0.0, [0.5, 0.0, 0.4, 0.0, 0.0, 0.0])
    assert model.stays_clear(path, t, speeds)
    assert model.stays_clear(path, t, speeds.max(axis=0))
    object.__setattr__(model, "margin", float(model.distance(path(t)).min()) + 1e-4)
    assert not model.stays_clear(path, t, speeds)


@pytest.mark.parametrize("slides", [False, True])
def test_no_distance_changes_faster_than_its_bound(slides):
    closest = 0.0
    for seed in range(4):
        robot, _ = arm(6, seed, slides=slides)
        model = collision_model(robot, np.full(6, 0.1), Capsules(WIDTHS[:6]), floor=-20.0)
        q = poses(6, 300, seed)
        table, step = model._table(np.abs(q).max(axis=0) + 1e-5), 1e-6
        here = model._distances.bounds(q)[0]
        for j in range(6):
            change = np.abs(model._distances.bounds(q + step * np.eye(6)[j])[0] - here) / step
            away = here > 1e-3 - 20.0
            assert (change <= table[:, j] + 1e-6)[away].all()
            moved = table[:, j] > 0.0
            closest = max(closest, (change[:, moved] / table[moved, j]).max(initial=0.0))
    assert closest > 0.8  # the bounds are not far off


# ---------------------------------------------------------------------------------------------------------------
# URDFs
# ---------------------------------------------------------------------------------------------------------------
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
CHAIN = ("floor_plate", "turret", "upper", ("slide", "bracket"), "hand")


def urdf_robot(folder, *parts, name="robot.urdf"):
    (folder / name).write_text(f'<robot name="shaped">{"".join(parts)}</robot>', encoding="utf-8")
    return load_robot(folder / name)


def test_mujoco_finds_the_same_distances(tmp_path):
    """Of boxes, cylinders and balls on a chain with a fixed joint in it."""
    robot = urdf_robot(tmp_path, *ARM)
    model = collision_model(robot, np.array([0.3, -0.4, 0.2, 0.5]), floor=None, margin=-1.0)
    assert {frozenset(pair) for pair in model.pairs} == {
        frozenset(pair)
        for pair in (
            *(("floor_plate", other) for other in ("upper", "slide", "bracket", "hand")),
            *(("turret", other) for other in ("slide", "bracket", "hand")),
            ("upper", "hand"),
        )
    }
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


def mesh_arm(folder, filename="package://parts/meshes/tool.stl", scale="1 1 2"):
    mesh = f'<mesh filename="{filename}" scale="{scale}"/>'
    return urdf_robot(
        folder,
        link("plate", (BALL, "1 0 0.07", "0 0 0")),
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


def test_meshes_are_found_above_the_urdf_and_in_ros_package_path(package, tmp_path, monkeypatch):
    expected = collision_model(mesh_arm(package / "urdf"), np.zeros(2)).distance(np.zeros((1, 2)))
    elsewhere = tmp_path / "other"
    elsewhere.mkdir()
    mesh_arm(elsewhere)
    # the folder that holds the package is above this URDF too
    beside = collision_model(load_robot(elsewhere / "robot.urdf"), np.zeros(2)).distance(np.zeros((1, 2)))
    np.testing.assert_array_equal(beside, expected)
    hidden = tmp_path / "hidden" / "src"
    hidden.mkdir(parents=True)
    package.rename(hidden / "parts")
    robot = load_robot(elsewhere / "robot.urdf")
    with pytest.raises(
        InputError, match=r"link tool: mesh package://parts/meshes/tool.stl is not found.*ROS_PACKAGE_PATH"
    ):
        collision_model(robot, np.zeros(2))
    for folder in (hidden, hidden / "parts"):
        found = collision_model(robot, np.zeros(2), folders=[folder]).distance(np.zeros((1, 2)))
        np.testing.assert_array_equal(found, expected)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{hidden}")
    np.testing.assert_array_equal(collision_model(robot, np.zeros(2)).distance(np.zeros((1, 2))), expected)
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    by_radii = collision_model(robot, np.zeros(2), Capsules(0.05), floor=None)
    assert isinstance(by_radii, NoShapes) or "capsules" in by_radii.source


@pytest.mark.parametrize(
    ("content", "filename"),
    [
        ("solid nothing", "tool.stl"),
        ("", "tool.obj"),
        (stl([[0, 0, 0], [2e3, 0, 0], [0, 1, 0]], [(0, 1, 2)]), "tool.stl"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_refused(tmp_path, content, filename):
    (tmp_path / filename).write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        collision_model(mesh_arm(tmp_path, filename), np.zeros(2))


def test_a_flat_mesh_counts_as_the_capsule_around_it(tmp_path):
    (tmp_path / "tool.stl").write_text(stl(BRACKET[:3], FACES[:1]), encoding="utf-8")
    model = collision_model(mesh_arm(tmp_path, "tool.stl"), np.zeros(2), floor=None)
    true = to_hull(np.array([1.0, 0.0, 0.07]), BRACKET[:3] + np.array([0.0, 0.0, 0.3])) - 0.07
    assert true - 0.2 < model.distance(np.zeros((1, 2)))[0] <= true


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ('<sphere radius="-1"/>', "not positive"),
        ('<cylinder radius="1"/>', "length"),
        ('<box size="1 2"/>', "box size"),
        ('<cone radius="1"/>', "not known"),
    ],
)
def test_a_shape_that_cannot_be_used_is_refused(tmp_path, shape, said):
    robot = urdf_robot(tmp_path, link("plate"), link("carriage"), link("tool", (shape, "0 0 0", "0 0 0")), *ON_SLIDES)
    with pytest.raises(InputError, match=said):
        collision_model(robot, np.zeros(2))


def test_a_urdf_without_shapes_says_so(tmp_path):
    found = collision_model(
        urdf_robot(tmp_path, link("plate"), link("carriage"), link("tool"), *ON_SLIDES), np.zeros(2)
    )
    assert isinstance(found, NoShapes)
    assert "no collision shapes" in found.reason


def test_capsules_stand_in_for_a_urdfs_shapes(tmp_path):
    robot = urdf_robot(tmp_path, *ARM)
    model = collision_model(
        robot, np.array([0.3, -0.4, 0.2, 0.5]), Capsules([0.05, 0.04, 0.03, 0.02], tool=(0, 0, 0.3))
    )
    assert model.source == "capsules of 0.02 to 0.05 m about the lines between the joints, floor at z = 0 m"
    assert ("link 2", "link 4") in model.pairs + model.inseparable + model.left_out
    assert bayesid.load_robot(tmp_path / "robot.urdf").n_joints == 4
