"""Where an arm ends by its file: fixed tips of URDFs, and files of MuJoCo beside the URDF of the same arm."""

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.robot.dh_table import robot_from_table, robot_table
from bayesid.robot.kinematics import pose
from bayesid.robot.load import load_robot

URDF = """<robot name="arm"><link name="base"/><link name="l1"/><link name="l2"/><link name="l3"/>{links}
<joint name="yaw" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.5"/>
<axis xyz="0 0 1"/></joint>
<joint name="elbow" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.4 0 0" rpy="0.2 0 0"/>
<axis xyz="0 1 0"/></joint>
<joint name="wrist" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.3 0.1 0"/>
<axis xyz="0 1 0"/></joint>
{joints}</robot>"""
FIXED = '<joint name="f{0}" type="fixed"><parent link="{1}"/><child link="{0}"/><origin xyz="{2} 0 0"/></joint>'
MJCF = """<mujoco model="arm"><compiler angle="{unit}"/>
<default><joint axis="0 1 0"/><default class="up"><joint axis="0 0 1"/></default></default>
<worldbody><body name="l1" pos="0 0 0.5"><joint name="yaw" class="up"/>
<body name="l2" pos="0.4 0 0" euler="{angle} 0 0"><joint name="elbow"/>
<body name="l3" pos="0.3 0 0"><joint name="wrist" pos="0 0.1 0"/>
<site name="tool" pos="0.2 0.1 0"/></body></body></body>
</worldbody></mujoco>"""
Q = [0.3, 0.4, -0.5]


def urdf(path, *tips):
    joints = "".join(FIXED.format(*tip) for tip in tips)
    path.write_text(URDF.format(links="".join(f'<link name="{tip[0]}"/>' for tip in tips), joints=joints))
    return load_robot(path)


def flange(robot):
    return pose(robot, Q).flange[:3, 3]


def test_the_flange_is_what_is_fixed_behind_the_last_joint(tmp_path):
    bare = urdf(tmp_path / "bare.urdf")
    frame = pose(bare, Q).flange
    end = frame[:3, 3] + frame[:3, :3] @ [0.2, 0.0, 0.0]
    tipped = urdf(tmp_path / "tip.urdf", ("mount", "l3", 0.05), ("hand", "mount", 0.15))
    np.testing.assert_allclose(flange(tipped), end, atol=1e-12)
    usual = urdf(tmp_path / "usual.urdf", ("camera", "l3", 0.4), ("tool0", "l3", 0.2))
    np.testing.assert_allclose(flange(usual), end, atol=1e-12)
    several = urdf(tmp_path / "open.urdf", ("camera", "l3", 0.4), ("lamp", "l3", 0.2))
    np.testing.assert_allclose(flange(several), frame[:3, 3], atol=1e-12)
    again = robot_from_table(robot_table(tipped), "again")
    np.testing.assert_array_equal(flange(again), flange(tipped))
    assert tipped.same_kinematics(bare)


@pytest.mark.parametrize(("unit", "angle"), [("radian", 0.2), ("degree", np.rad2deg(0.2))])
def test_a_file_of_mujoco_is_the_same_arm(tmp_path, unit, angle):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.format(unit=unit, angle=angle))
    read, expected = load_robot(path), urdf(tmp_path / "arm.urdf", ("tool", "l3", 0.2))
    assert [joint.name for joint in read.joints] == ["yaw", "elbow", "wrist"]
    assert read.same_kinematics(expected)
    np.testing.assert_allclose(flange(read), flange(expected), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<worldbody>", '<include file="other.xml"/><worldbody>', "is not supported"),
        ('<joint name="elbow"/>', '<joint name="elbow" type="ball"/>', "of type ball"),
        ('<joint name="elbow"/>', "<freejoint/>", "has a free joint"),
        ("</worldbody>", "", "not readable as MJCF"),
        ('pos="0.3 0 0"', 'pos="0.3 0"', "key 'pos' cannot be used"),
    ],
)
def test_what_is_no_plain_chain_is_refused(tmp_path, old, new, said):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.format(unit="radian", angle=0.2).replace(old, new))
    with pytest.raises(InputError, match=said):
        load_robot(path)
