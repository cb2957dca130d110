from dataclasses import replace

import numpy as np
import pytest
from oracles import (
    actuator_efforts,
    assert_close,
    built_in_table,
    dh_chain,
    joint_torques,
    parameters_of,
    random_clouds,
    random_motion,
    random_table,
    urdf_chain,
    urdf_text,
)

from bayesid.errors import InputError
from bayesid.robot import load_robot, robot_from_table, robot_from_urdf, robot_table
from bayesid.robot.load import alias_note

DIFFERENT = ("kr5", "panda", "tx40")  # standard, modified, coupled wrist
TABLES = {
    "one joint": random_table("standard", 1, seed=1),
    "standard": random_table("standard", 4, seed=4, coupled=True),
    "modified": random_table("modified", 5, seed=5),
    "modified, coupled": random_table("modified", 6, seed=6, coupled=True),
    **{name: built_in_table(name) for name in DIFFERENT},
}


@pytest.mark.parametrize("name", TABLES)
def test_dynamics_equal_those_of_point_masses(name):
    table = TABLES[name]
    n = len(table["joints"])
    robot, clouds, motion = robot_from_table(table, "test"), random_clouds(n, seed=n), random_motion(n)
    torques = joint_torques(dh_chain(table), clouds, table["gravity"], motion)
    expected = actuator_efforts(torques, table.get("transmission"))
    theta = parameters_of(clouds)
    assert_close(robot.regressor(motion) @ theta, expected, 1e-12)
    assert_close(robot.inverse_dynamics(motion, theta), expected, 1e-12)


def test_link_without_mass_may_have_inertia():
    robot, motion = load_robot("kr5"), random_motion(6)
    theta = parameters_of(random_clouds(6))
    theta[6:10] = theta[36:40] = 0.0
    assert_close(robot.inverse_dynamics(motion, theta), robot.regressor(motion) @ theta, 1e-12)
    np.testing.assert_allclose(robot.inverse_dynamics(motion, 0 * theta), 0.0, atol=1e-300)


@pytest.mark.parametrize("name", TABLES)
def test_robot_table_comes_back_the_same(name):
    robot = robot_from_table(TABLES[name], "test")
    back, motion = robot_from_table(robot_table(robot), "test"), random_motion(robot.n_joints)
    np.testing.assert_array_equal(back.regressor(motion), robot.regressor(motion))
    assert back.lengths == robot.lengths


def test_tables_of_chains_that_cannot_be_used():
    table = robot_table(robot_from_table(TABLES["standard"], "test"))
    one = table["joints"][0]
    for change, said in (
        ({"joints": []}, "cannot be used"),
        ({"joints": [3]}, "written by bayesid"),
        ({"joints": [one] * 500}, "has 500 moving joints"),
        ({"joints": [one | {"axis": "up"}]}, "joint 1: key 'axis'"),
        ({"joints": [one | {"parent": 3}]}, "a joint precedes its parent"),
        ({"joints": [one | {"rated_effort": "x"}]}, "joint 1: key 'rated_effort'"),
        ({"transmission": [1.0]}, "key 'transmission'"),
    ):
        with pytest.raises(InputError, match=said):
            robot_from_table(table | change, "test")


def test_another_geometry_mounting_or_gear_is_not_the_same():
    kr5 = load_robot("kr5")
    assert kr5.same_kinematics(load_robot("kr5-paper"))
    assert "kr5r650" in alias_note("kr5")
    assert alias_note("kr5-paper") is alias_note("kr5r650") is None
    assert kr5.same_kinematics(robot_from_table(built_in_table("kr5"), "test"))
    for joint, key, value in ((0, "a", 0.1), (5, "alpha", 0.1), (2, "d", 0.1), (5, "theta", 0.1), (2, "type", "")):
        table = built_in_table("kr5")
        row = table["joints"][joint]
        row[key] = "prismatic" if key == "type" else row[key] + value
        assert not robot_from_table(table, "test").same_kinematics(kr5)
    assert not replace(kr5, gravity=[0.0, 0.1, -9.81]).same_kinematics(kr5)
    assert not replace(kr5, transmission=np.diag([1, 1, 1, 1, 1, -2.0])).same_kinematics(kr5)
    assert not kr5.same_kinematics(load_robot("panda"))


def test_urdf_with_fixed_continuous_and_skewed_joints(tmp_path):
    path = tmp_path / "odd.urdf"
    path.write_text(urdf_text())
    robot, clouds, motion = load_robot(path), random_clouds(3), random_motion(3)
    assert [joint.prismatic for joint in robot.joints] == [False, True, False]
    assert robot.name == "odd"
    expected = joint_torques(urdf_chain(), clouds, [0, 0, -9.81], motion)
    assert_close(robot.regressor(motion) @ parameters_of(clouds), expected, 1e-12)
    assert_close(robot.inverse_dynamics(motion, parameters_of(clouds)), expected, 1e-12)


def refusal(path):
    with pytest.raises(InputError) as caught:
        load_robot(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    assert caught.value.remedy
    return message


ROW = "[[joints]]\na = 0.1\nalpha = 0.2\nd = 0.3\ntheta = 0.4\n"
HEAD = 'convention = "standard"\n'
BAD_TOML = {
    "convention = ": "is not valid TOML",
    "": "key 'convention' is missing",
    'convention = "denavit"\n' + ROW: "unknown convention 'denavit'",
    HEAD: "key 'joints' is missing",
    HEAD + "joints = [1]": "joint 1: is not a table",
    HEAD + ROW + ROW.replace("alpha = 0.2\n", ""): "joint 2: key 'alpha' is missing",
    HEAD + ROW + ROW.replace("0.3", '"x"'): "joint 2: key 'd' cannot be used",
    HEAD + ROW.replace("0.3", "nan") + ROW.replace("0.3", "nan"): "not filled in yet: d of joints 1, 2",
    HEAD + ROW + 'type = "helical"\n': "joint 1: unknown joint type 'helical'",
    HEAD + ROW + "rated_effort = -3.0\n": "joint 1: key 'rated_effort' is not positive",
    HEAD + "gravity = [0, 9.81]\n" + ROW: "key 'gravity' cannot be used",
    HEAD + "transmission = [[1, 2], [3, 4]]\n" + ROW: "key 'transmission' cannot be used",
    HEAD + "transmission = [[1, 2], [2, 4]]\n" + ROW + ROW: "key 'transmission' cannot be used",
}


def test_bad_dh_files_are_refused(tmp_path):
    path = tmp_path / "arm.toml"
    for text, said in BAD_TOML.items():
        path.write_text(text)
        assert said in refusal(path)


def arm(joint='<axis xyz="0 1 0"/>', kind="revolute", parent="b", child="l", extra=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    links = '<link name="b"/><link name="l"/>'
    return f'<robot name="r">{links}<joint name="elbow" type="{kind}">{ends}{joint}</joint>{extra}</robot>'


BAD_URDF = {
    "<robot": "is not valid XML",
    "<html/>": "its root is <html>",
    '<robot name="r"><link name="b"/></robot>': "has no moving joint",
    arm(kind="floating"): "has no moving joint",
    arm(kind="ball"): "joint elbow: is of type 'ball'",
    arm('<mimic joint="x"/>'): "has no moving joint but joint elbow, held",
    arm('<mimic joint="x" offset="far"/>'): "joint elbow: key 'mimic offset' cannot be used",
    arm('<axis xyz="0 0 0"/>'): "joint elbow: key 'axis xyz' cannot be used",
    arm('<axis xyz="up"/>'): "joint elbow: key 'axis xyz' cannot be used",
    arm('<origin rpy="up"/>'): "joint elbow: key 'origin rpy' cannot be used",
    arm('<origin xyz="0 0 up"/>'): "joint elbow: key 'origin xyz' cannot be used",
    arm(parent="x"): "joint elbow: its <parent> is not a link",
    arm(extra='<link name="c"/>'): "has 2 links without a parent joint: b, c",
    arm(extra='<link name="l"/>'): "link l: appears twice",
    arm(extra='<joint name="x" type="fixed"><parent link="b"/><child link="l"/></joint>'): "link l: is the child of",
    arm(extra='<link name="c"/><joint name="elbow" type="fixed"><parent link="l"/><child link="c"/></joint>'): (
        "joint elbow: appears twice"
    ),
}


def test_bad_urdfs_are_refused(tmp_path, capfd):
    path = tmp_path / "arm.urdf"
    for text, said in BAD_URDF.items():
        path.write_text(text)
        assert said in refusal(path)
    assert capfd.readouterr() == ("", ""), "the URDF library's own complaints are not ours"


def test_urdf_parts_that_do_not_move_the_arm_do_not_matter():
    for joint in ("", "<limit/>", '<limit effort="x"/>', '<dynamics damping="x"/>', "<axis/>"):
        np.testing.assert_array_equal(robot_from_urdf(arm(joint), "test").joints[0].axis, [1, 0, 0])


def test_no_such_file_and_no_text(tmp_path):
    assert "no such file" in refusal(tmp_path / "absent.urdf")
    assert "no such file" in refusal(tmp_path)
    for name in ("arm.urdf", "arm.toml"):
        (tmp_path / name).write_bytes(b"\xff\xfe\x00")
        assert "cannot be read" in refusal(tmp_path / name)
    with pytest.raises(InputError, match=r"kr55: no such robot, did you mean kr5\?; give a built-in name"):
        load_robot("kr55")
    with pytest.raises(InputError, match=r"my/kr5.toml: no such file; give a DH file"):
        load_robot("my/kr5.toml")


def test_gravity_replaces_the_files():
    """And is remembered as what was chosen; what is not an acceleration is refused."""
    hung = load_robot("ur10e", gravity=(0.0, 0.0, 9.81))
    np.testing.assert_array_equal(hung.gravity, [0.0, 0.0, 9.81])
    assert hung.origin.in_python == "bayesid.load_robot('ur10e', gravity=(0.0, 0.0, 9.81))"
    assert load_robot("ur10e").gravity.tolist() == [0.0, 0.0, -9.81]
    for wrong in ((0.0, 9.81), (0.0, 0.0, np.inf)):
        with pytest.raises(InputError) as refused:
            load_robot("ur10e", gravity=wrong)
        assert refused.value.field == "gravity"
