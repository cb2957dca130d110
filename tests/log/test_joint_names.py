"""Joints by their names: those of the robot, in whatever order and among whatever others a log has them."""

import numpy as np
import pytest
from log_files import Bag, read, refusal, save, smooth_recording

from bayesid.robot.load import load_robot

NAMES = ["shoulder", "elbow", "wrist"]
JOINT = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}_link"/><axis xyz="0 1 0"/></joint>'
RECORDED = smooth_recording()


@pytest.fixture
def robot(tmp_path):
    links = ["base", *(f"{name}_link" for name in NAMES)]
    joints = "".join(JOINT.format(name, link) for name, link in zip(NAMES, links, strict=False))
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(f"""<link name="{link}"/>""" for link in links)}{joints}</robot>')
    return load_robot(path)


def named(pattern, order):
    """Columns of joints in an order, with those of a gripper first."""
    columns = {"time": RECORDED["t"]}
    for name in order:
        for kind, word in (("q", "position"), ("dq", "velocity"), ("tau", "effort")):
            values = RECORDED[kind][:, NAMES.index(name)] if name in NAMES else np.zeros(len(RECORDED["t"]))
            columns[pattern.format(name=name, kind=word)] = values
    return columns


@pytest.mark.parametrize("pattern", ["/joint_states/{name}/position", "{name}_{kind}", "{kind}.{name}"])
def test_columns_are_in_the_robots_order(tmp_path, robot, pattern):
    pattern = pattern.replace("position", "{kind}")
    path = save(tmp_path / "log.csv", named(pattern, ["gripper", "elbow", "shoulder", "wrist"]))
    log, heard = read(path, robot=robot)
    np.testing.assert_array_equal(log.q, RECORDED["q"])
    np.testing.assert_array_equal(log.effort, RECORDED["tau"])
    np.testing.assert_array_equal(log.dq, RECORDED["dq"])
    assert not heard
    assert log.read_with["joints"] == NAMES


@pytest.mark.parametrize("pattern", ["/joint_states/{name}/{kind}", "{kind}.{name}"])
def test_names_that_the_robot_has_in_part_are_never_taken_as_they_come(tmp_path, robot, pattern):
    path = save(tmp_path / "log.csv", named(pattern, ["elbow", "wrist", "gripper"]))
    said = refusal(path, robot=robot)
    assert "joints elbow, wrist match the robot's, but shoulder" in said
    assert "--joints gripper,elbow,wrist" in said
    log, _ = read(path, robot=robot, joints=["gripper", "elbow", "wrist"])
    np.testing.assert_array_equal(log.q[:, 1:], RECORDED["q"][:, 1:])
    cells = {"t": RECORDED["t"]} | {
        f"name_{k}": [name] * len(RECORDED["t"]) for k, name in enumerate(("elbow", "wrist", "a"))
    }
    cells |= {f"{word}_{k}": RECORDED["q"][:, k] for k in range(3) for word in ("position", "effort")}
    assert "but shoulder" in refusal(save(tmp_path / "cells.csv", cells), robot=robot)


def test_a_bag_that_names_some_of_the_robots_joints_is_refused(tmp_path, robot):
    bag = Bag()
    path = bag.write(tmp_path / "bag", {"/joint_states": bag.states(RECORDED, ["elbow", "wrist", "tool"])})
    assert "--joints tool,elbow,wrist" in refusal(path, robot=robot)


def test_names_that_no_robot_has_are_taken_as_they_come_and_said(tmp_path):
    path = save(tmp_path / "log.csv", named("/s/{name}/{kind}", ["elbow", "shoulder", "wrist"]))
    log, heard = read(path)
    np.testing.assert_array_equal(log.q, RECORDED["q"][:, [1, 0, 2]])
    assert "from base to tip: elbow, shoulder, wrist" in heard
    np.testing.assert_array_equal(read(path, joints=NAMES)[0].q, RECORDED["q"])


def test_names_in_cells_may_change_from_row_to_row(tmp_path, robot):
    rng = np.random.default_rng(0)
    order = np.array([rng.permutation(3) for _ in RECORDED["t"]])
    columns = {"t": RECORDED["t"]} | {f"name_{k}": [NAMES[j] for j in order[:, k]] for k in range(3)}
    for kind, word in (("q", "position"), ("tau", "effort")):
        block = np.take_along_axis(RECORDED[kind], order, axis=1)
        columns |= {f"{word}_{k}": block[:, k] for k in range(3)}
    log, _ = read(save(tmp_path / "log.csv", columns), robot=robot)
    np.testing.assert_array_equal(log.q, RECORDED["q"])
    np.testing.assert_array_equal(log.effort, RECORDED["tau"])


def test_a_bag_with_a_gripper_first_is_in_the_robots_order(tmp_path, robot):
    bag = Bag()
    states = bag.states(RECORDED, NAMES)
    for t in RECORDED["t"][::2]:
        states.insert(0, bag.state(t, ["finger"], [0.1], [0.0], [0.0]))
    states.sort(key=lambda one: one[0])
    log, heard = read(bag.write(tmp_path / "bag", {"/joint_states": states}), robot=robot)
    np.testing.assert_allclose(log.q, RECORDED["q"])
    assert not heard
