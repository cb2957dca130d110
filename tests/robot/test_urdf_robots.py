"""URDFs as strangers have them: grippers, several arms, floating bases; the full model by Pinocchio is the oracle."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from oracles import assert_close, random_motion

import bayesid
from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.robot import check_joints, load_robot, robot_from_table, robot_from_urdf, robot_table


def joint(name, kind, parent, child, axis="0 0 1", extra="", seed=0):
    """A joint at a random place."""
    rng = np.random.default_rng([seed, *map(ord, name)])
    xyz, rpy = (" ".join(map(str, rng.uniform(-size, size, 3).round(3))) for size in (0.4, 1.5))
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>'
    limit = '<limit lower="-2" upper="2" effort="9" velocity="3"/>' if kind in ("revolute", "prismatic") else ""
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="{axis}"/>{limit}{extra}</joint>'


def urdf(*joints, links=None, name="stranger"):
    """Joints, and a link of random inertia for each end of theirs."""
    text = "".join(joints)
    ends = links or list(dict.fromkeys(part.split('"')[0] for part in text.split('link="')[1:]))
    rng = np.random.default_rng(len(ends))
    bodies = []
    for link in ends:
        mass, at, size = rng.uniform(0.5, 4.0), rng.uniform(-0.2, 0.2, 3), rng.uniform(0.02, 0.03, 3)
        inertia = " ".join(f'{key}="{value}"' for key, value in zip(("ixx", "iyy", "izz"), size, strict=True))
        origin = f'<origin xyz="{" ".join(map(str, at))}"/>'
        inertial = (
            f'<inertial>{origin}<mass value="{mass}"/><inertia {inertia} ixy="0.001" ixz="0" iyz="0.002"/></inertial>'
        )
        bodies.append(f'<link name="{link}">{inertial}</link>')
    return f'<robot name="{name}">{"".join(bodies)}{text}</robot>'


MIMIC = '<mimic joint="finger1" multiplier="-0.5" offset="0.3"/>'
HAND = urdf(
    joint("j1", "revolute", "base", "l1", "0 0 1"),
    joint("j2", "continuous", "l1", "l2", "1 2 0"),
    joint("j3", "prismatic", "l2", "l3", "0 1 1"),
    joint("mount", "fixed", "l3", "hand"),
    joint("finger1", "prismatic", "hand", "f1", "0 1 0"),
    joint("finger2", "prismatic", "hand", "f2", "0 -1 0", MIMIC),
)
TORSO = urdf(
    joint("weld", "fixed", "floor", "trunk"),
    joint("lift", "prismatic", "trunk", "chest", "0 0 1"),
    joint("bend", "revolute", "chest", "breast", "0 1 0"),
    joint("left1", "revolute", "breast", "la", "1 0 0"),
    joint("left2", "revolute", "la", "lb", "0 1 1"),
    joint("left3", "revolute", "lb", "lc", "0 0 1"),
    joint("right1", "revolute", "breast", "ra", "1 0 0"),
    joint("right2", "revolute", "ra", "rb", "0 1 0"),
    joint("tail", "revolute", "trunk", "tip_of_tail", "0 1 0"),
)
LEGS = urdf(
    joint("a0", "revolute", "trunk", "a1_"),
    joint("a1", "revolute", "a1_", "a2_"),
    joint("b0", "revolute", "trunk", "b1_"),
    joint("b1", "revolute", "b1_", "b2_"),
)


def full_model_torques(text, robot, motion, positions):
    """(N, n) torques of a robot's joints in Pinocchio's full model, the others at rest; and (10 n,) what they carry."""
    model = pin.buildModelFromXML(text)
    data, torques = model.createData(), []
    names = [one.name for one in robot.joints]
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        state, speed, acceleration = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for name, x in {**positions, **dict(zip(names, q, strict=True))}.items():
            one = model.joints[model.getJointId(name)]
            state[one.idx_q : one.idx_q + one.nq] = [np.cos(x), np.sin(x)] if one.nq == 2 else x
        indices = [model.joints[model.getJointId(name)].idx_v for name in names]
        speed[indices], acceleration[indices] = dq, ddq
        torques.append(pin.rnea(model, data, state, speed, acceleration)[indices])
    return np.array(torques), lumped(model, names, positions)


def lumped(model, names, positions):
    state = pin.neutral(model)
    for name, x in positions.items():
        state[model.joints[model.getJointId(name)].idx_q] = x
    locked = [k for k in range(1, model.njoints) if model.names[k] not in names]
    reduced = pin.buildReducedModel(model, locked, state)
    order = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]  # of pinocchio's m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
    links = [reduced.inertias[reduced.getJointId(name)].toDynamicParameters()[order] for name in names]
    return np.concatenate(links)


CASES = {
    "a gripper": (HAND, {}, {"finger1": 0.0, "finger2": 0.3}, ["j1", "j2", "j3"]),
    "a gripper that is stretched out": (HAND, {"hold": {"finger1": 0.4}}, {"finger1": 0.4, "finger2": 0.1}, None),
    "a tip before the end": (HAND, {"tip": "l2"}, {"j3": 0.0, "finger1": 0.0, "finger2": 0.3}, ["j1", "j2"]),
    "all of a tree": (TORSO, {}, {}, ["lift", "bend", "left1", "left2", "left3", "right1", "right2", "tail"]),
    "one arm on a torso that stands": (
        TORSO,
        {"tip": "lc", "hold": {"lift": 0.35, "bend": -0.7}},
        {"lift": 0.35, "bend": -0.7, "right1": 0.0, "right2": 0.0, "tail": 0.0},
        ["left1", "left2", "left3"],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_held_is_at_rest_in_the_full_model(case):
    text, chosen, positions, names = CASES[case]
    robot = robot_from_urdf(text, "test", **chosen)
    if names:
        assert [one.name for one in robot.joints] == names
    motion = random_motion(robot.n_joints, seed=3)
    torques, parameters = full_model_torques(text, robot, motion, positions)
    assert_close(robot.inverse_dynamics(motion, parameters), torques, 1e-12)
    assert_close(robot.regressor(motion) @ parameters, torques, 1e-12)


def notes(text, **chosen):
    return robot_from_urdf(text, "test", **chosen).notes


def held(text, **chosen):
    """Names of the joints that notes tell as held."""
    told = [re.match("joints? (.*?) (?:is|are) held", note) for note in notes(text, **chosen)]
    return [name for found in told if found for name in found[1].split(", ")]


def test_grippers_are_held_and_told():
    assert held(HAND) == ["finger1", "finger2"]
    fingers = [
        f'<joint name="{name}" type="KIND"><parent link="l1"/><child link="{name}_"/><axis xyz="0 {way} 0"/></joint>'
        for name, way in (("left", "1"), ("right", "-1"))
    ]
    for kind in ("prismatic", "revolute"):
        text = urdf(joint("j1", "revolute", "base", "l1"), *(finger.replace("KIND", kind) for finger in fingers))
        assert held(text) == ["left", "right"]
        assert notes(text.replace("0 -1 0", "0 1 0")) == (), "two tools side by side"


def test_followers_are_held_and_their_leader_is_identified():
    """A follower of a leader that is the arm's own, in a parallel linkage, or of one that stands still."""
    first, follows = joint("j1", "revolute", "base", "l1"), '<mimic joint="j1"/>'
    last = urdf(first, joint("j2", "revolute", "l1", "l2", extra=follows))
    bar = urdf(first, joint("j2", "revolute", "base", "bar", extra=follows), joint("j3", "revolute", "l1", "l3"))
    still = urdf(first, joint("j2", "revolute", "l1", "l2", extra='<mimic joint="gone"/>'))
    for text in (last, bar, still):
        assert held(text) == ["j2"]
    assert "joint j1" in notes(last)[0], "that it does not follow is told"
    assert [one.name for one in robot_from_urdf(bar, "test").joints] == ["j1", "j3"]


def test_a_follower_on_the_chain_is_refused_but_not_beyond_the_tip():
    text = urdf(
        joint("j1", "revolute", "base", "l1"),
        joint("j2", "revolute", "l1", "l2", extra='<mimic joint="j1" multiplier="-1"/>'),
        joint("j3", "revolute", "l2", "l3"),
    )
    with pytest.raises(InputError, match=r"joint j2: follows joint j1 .* carries joint j3; .*with `tip`"):
        robot_from_urdf(text, "test")
    assert held(text, tip="l1") == ["j2", "j3"]


def test_a_base_that_may_move_is_told():
    for chosen in ({}, {"tip": "a1"}):
        assert "2 chains of joints begin at trunk" in notes(LEGS, **chosen)[-1]
    assert notes(LEGS.replace('"trunk"', '"world"')) == (), "that base is the ground"
    for kind in ("floating", "planar"):
        free = LEGS.replace("</robot>", f'<link name="world"/>{joint("root", kind, "world", "trunk")}</robot>')
        assert f"joint root is {kind}" in notes(free)[0]
        assert robot_from_urdf(free, "test").n_joints == 4


def test_choices_that_cannot_be_are_refused():
    for chosen, said in (
        ({"tip": "left_3"}, "no link or joint 'left_3'; `tip` takes left3"),
        ({"tip": "xyz"}, "no link or joint 'xyz'; `tip` takes lc, rb, tip_of_tail"),
        ({"hold": {"lift2": 0.0}}, "no moving joint 'lift2'; `hold` takes lift"),
        ({"hold": {"weld": 0.0}}, "no moving joint 'weld'"),
        ({"hold": {"lift": np.nan}}, "'lift'"),
        ({"tip": "trunk"}, "the chain to trunk has no moving joint; `tip` takes lc, rb, tip_of_tail"),
    ):
        with pytest.raises(InputError, match=said):
            robot_from_urdf(TORSO, "test", **chosen)


def test_a_loop_apart_from_the_base_is_refused():
    loop = joint("x", "revolute", "p", "q"), joint("y", "revolute", "q", "p")
    with pytest.raises(InputError, match="test, joint x: is part of a loop"):
        robot_from_urdf(urdf(joint("j1", "revolute", "base", "l1"), *loop), "test")


def test_xacro_files_are_told_from_urdfs():
    declared = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    assert robot_from_urdf(HAND.replace('<robot name="stranger">', declared), "test").n_joints == 3
    for text in (declared + '<xacro:arm/><link name="b"/></robot>', '<robot name="r"><xacro:arm prefix="l"/></robot>'):
        with pytest.raises(InputError, match=r"is a xacro file.*`xacro 'my arm' > robot.urdf`"):
            robot_from_urdf(text, "my arm")


def test_a_robot_keeps_its_choice_until_it_is_changed(tmp_path):
    path = tmp_path / "torso.urdf"
    path.write_text(TORSO)
    robot = load_robot(path, tip="lc", hold={"lift": 0.2})
    again = eval(robot.origin.in_python, {"bayesid": bayesid})
    assert again.same_kinematics(robot)
    assert (again.origin, again.notes) == (robot.origin, robot.notes)
    assert robot.origin.options == {"robot": str(path), "tip": "lc", "hold": {"lift": 0.2}}
    changed = replace(robot, gravity=np.array([9.81, 0.0, 0.0]))
    assert (changed.origin, changed.notes) == (None, robot.notes), "no file says gravity points there"
    robot = robot_from_urdf(TORSO, "test", "lc")
    back = robot_from_table(robot_table(robot), "test")
    assert back.notes == robot.notes
    assert [one.name for one in back.joints] == ["lift", "bend", "left1", "left2", "left3"]


def test_effort_limits_are_rated_efforts_where_they_can_be_meant():
    """Of the second joint alone; the table in model.toml keeps it."""
    unusable = [f'<limit effort="{effort}"/>' for effort in ("0", "1000000", "inf", "strong")]
    for limit, rated in (('<limit effort="87.5"/>', 87.5), *((limit, None) for limit in (*unusable, "<limit/>", ""))):
        text = urdf(joint("a", "revolute", "base", "l1", "0 0 1"), joint("b", "continuous", "l1", "l2", "0 1 0", limit))
        robot = robot_from_urdf(text, "test")
        for one in (robot, robot_from_table(robot_table(robot), "test")):
            assert [joint.rated_effort for joint in one.joints] == [9.0, rated]


def test_a_table_is_one_chain():
    for chosen in ({"tip": "l3"}, {"hold": {"j": 0.0}}):
        with pytest.raises(InputError, match=f"built-in robot kr5: .* leave `{next(iter(chosen))}` out"):
            load_robot("kr5", **chosen)


def test_other_numbers_of_joints_are_refused_with_the_way_out():
    robot = robot_from_urdf(TORSO, "test")
    with pytest.raises(
        InputError, match="or choose its chain of 3 joints by `tip` left3 `hold` lift=0,bend=0"
    ) as caught:
        check_joints(robot, 3, "log.csv")
    assert in_options(str(caught.value)).endswith("by --tip left3 --hold lift=0,bend=0")
    hand = robot_from_urdf(HAND, "test")
    with pytest.raises(InputError, match=r"5 joints, but robot stranger has 3 \(joints finger1, finger2 are held"):
        check_joints(hand, 5, "log.csv")
    check_joints(hand, 3, "log.csv")
