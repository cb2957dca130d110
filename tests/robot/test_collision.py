"""Collision models: against coal, closed forms, and paths looked at on fine grids."""

import numpy as np
import pytest
from conftest import real_log
from made_paths import FINE, poses, sines
from oracles import built_in_table, dh_chain, random_table

from bayesid.errors import InputError
from bayesid.robot import load_robot, robot_from_table
from bayesid.robot.collision import FINEST, Capsules, collision_model
from bayesid.robot.shapes import capsule_shapes

WIDTHS = (0.05, 0.04, 0.03, 0.06, 0.035, 0.045, 0.025)
AT_REST = {
    "kr5": np.array([0.1, -1.2, 0.5, 0.2, 0.8, 0.0]),
    "ur10e": np.array([0.0, -1.2, 1.5, -1.0, -1.5, 0.0]),
    "panda": np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7]),
}


def arm(n=7, seed=0, convention="standard", slides=False):
    """A random arm that is level, and its table; with sliding joints if asked for."""
    table = random_table(convention, n, seed)
    table["gravity"] = [0.0, 0.0, -9.81]
    if not slides:
        table["joints"] = [{**row, "type": "revolute"} for row in table["joints"]]
    return robot_from_table(table, "test"), table


def by_search(a, b):
    """Distance of two lines by bounded least squares, whose problem is convex."""
    from scipy.optimize import lsq_linear

    matrix = np.stack([a[1] - a[0], b[0] - b[1]], axis=1)
    found = lsq_linear(matrix, b[0] - a[0], (0.0, 1.0), method="bvls", tol=1e-14)
    return np.linalg.norm(matrix @ found.x - (b[0] - a[0]))


def lines_of(robot, shapes, q):
    """Ends of the capsules' lines in the base's frame."""
    frames, lines = [*robot.joint_frames(q), np.eye(4)], []
    for shape in shapes:
        half = getattr(shape.solid, "halfLength", 0.0) * shape.place[:3, 2]
        ends = np.stack([shape.place[:3, 3] - half, shape.place[:3, 3] + half])
        if shape.rod:
            ends = np.stack([-q[shape.body] * robot.joints[shape.body].axis, np.zeros(3)])
        lines.append(ends @ frames[shape.body][:3, :3].T + frames[shape.body][:3, 3])
    return lines


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("slides", [False, True])
def test_capsules_follow_the_table(convention, slides):
    """Corners at the table's own frames: offsets along z, lengths along x; what slides out may overlap."""
    robot, table = arm(6, 1, convention, slides)
    shapes, chain = capsule_shapes(robot, WIDTHS[:6], np.zeros(3)), dh_chain(table)
    for q in poses(6, 8, 1, 0.8):
        frames, rows = [np.eye(4), *chain(q)[0]], table["joints"]
        lines = []
        for before, after, row in zip(frames[:-1], frames[1:], rows, strict=True):
            # standard: along z of the frame before; modified: along x of the frame before, then along z of the next
            corner = before[:3, 3] + before[:3, 0] * row["a"]
            if convention == "standard":
                corner = after[:3, 3] - after[:3, 0] * row["a"]
            lines += [(before[:3, 3], corner), (corner, after[:3, 3])]
        found = lines_of(robot, shapes, q)
        for points, skeleton in ((lines, found),) if slides else ((lines, found), (found, lines)):
            on_line = [(1 - s) * a + s * b for a, b in points for s in (0.0, 0.3, 1.0)]
            assert max(min(by_search((p, p), line) for line in skeleton) for p in on_line) < 1e-9


def test_radii_and_a_tool_are_checked():
    robot, _ = arm()
    for radii in (0.0, -0.1, [0.1] * 6, 80.0, float("nan")):
        with pytest.raises(InputError, match="capsules"):
            collision_model(robot, np.zeros(7), Capsules(radii))
    for tool in ((0.0, 0.1), (0.0, 0.0, float("inf"))):
        with pytest.raises(InputError, match=r"^`tool`: \d numbers"):
            collision_model(robot, np.zeros(7), Capsules(0.05, tool))
    for radius, margin in ((5.0, 0.01), (0.06, 2.0)):  # that tell nothing, so that no motion passes for a checked one
        with pytest.raises(InputError, match=rf"all distances are less than {margin:g} m.*narrower"):
            collision_model(load_robot("ur10e"), AT_REST["ur10e"], Capsules(radius), floor=None, margin=margin)


@pytest.mark.real
@pytest.mark.parametrize(("log", "robot"), [("ur10e/a_50s.csv", "ur10e"), ("panda/a.csv", "panda")])
def test_robots_are_clear_where_their_logs_were(log, robot):
    table = np.genfromtxt(real_log(log), delimiter=",", names=True)
    arm_ = load_robot(robot)
    q = np.stack([table[f"q{j}"] for j in range(1, arm_.n_joints + 1)], axis=1)[::20]
    model = collision_model(arm_, q, Capsules(0.05), floor=None)
    assert set(model.left_out) <= {("link 2", "link 4")}  # at panda's elbow, whose lines pass at 83 mm
    assert model.distance(q).min() >= model.margin
    assert ("base" if robot == "panda" else "link 1", "link 5") in model.pairs


def test_what_overlaps_where_the_robot_has_been_is_named():
    robot = load_robot("ur10e")
    folded = np.array([0.0, -1.2, 3.0, -1.0, -1.5, 0.0])
    wide = collision_model(robot, folded, Capsules(0.08), floor=None)
    distance, pair = collision_model(robot, AT_REST["ur10e"], Capsules(0.08), None).nearest(folded)
    assert distance < 0.0
    assert pair in wide.left_out
    assert pair not in wide.pairs
    both = collision_model(robot, np.stack([folded * 0.5, folded]), Capsules(0.08), floor=None)
    assert both.left_out == wide.left_out


def test_the_distance_is_that_of_the_lines_less_the_radii():
    for seed, slides in ((0, False), (1, True), (2, True)):
        robot, _ = arm(6, seed, slides=slides)
        shapes = capsule_shapes(robot, 0.03, np.zeros(3))
        model = collision_model(robot, np.zeros(6), Capsules(0.03), floor=None, margin=-1.0)
        for q in poses(6, 20, seed, 0.8):
            lines = lines_of(robot, shapes, q)
            expected = min(
                by_search(a, b)
                for k, a in enumerate(lines)
                for m, b in enumerate(lines)
                if (shapes[k].name, shapes[m].name) in model.pairs
            )
            assert model.distance(q[None])[0] == pytest.approx(expected - 0.06, abs=1e-7)


STANDING = np.array([0.3, -1.2, 1.5, -1.0, -1.5, 0.4])


def test_the_floor_is_as_far_as_the_lowest_frame_less_the_radius():
    """Also where the robot hangs on a wall: the floor is level. By the table's own frames."""
    for gravity, floor in ((np.array([0.0, 0.0, -9.81]), -0.4), (np.array([9.81 * 0.6, 0.0, 9.81 * -0.8]), -0.8)):
        table = {**built_in_table("ur10e"), "gravity": gravity.tolist()}
        robot, chain = robot_from_table(table, "test"), dh_chain(table)
        model, q = collision_model(robot, STANDING, Capsules(0.06), floor), poses(6, 3000)
        below = q[model.distance(q) < -0.15]  # deeper than two capsules reach into each other
        assert len(below) > 10
        for one in below[:50]:
            distance, pair = model.nearest(one)
            heights = [frame[:3, 3] @ -gravity / 9.81 for frame in chain(one)[0]]
            assert pair[1] == "floor"
            assert distance == pytest.approx(min(heights) - 0.06 - floor, abs=1e-6)


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


@pytest.mark.parametrize(("slides", "samples"), [(False, 2), (True, 40)])
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
        for margin in (0.01, least + between + 1e-4, least - between - FINEST - 2e-5):
            object.__setattr__(model, "margin", margin)
            found = model.stays_clear(path, np.linspace(0.0, 1.5, samples), speed)
            if margin > least:
                assert not found
            elif margin < least - between - FINEST:
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
