"""`--tip` and `--hold`: one arm of a robot with two, from a simulated log to a validated model."""

import json
import shlex
import tomllib

import pytest
from command_line import run

import bayesid

ENDS = {
    "lift": ("prismatic", "trunk", "chest", "0 0 1"),
    "left1": ("revolute", "chest", "left_upper", "0 1 0"),
    "left2": ("revolute", "left_upper", "left_hand", "0.6 0 0.8"),
    "right1": ("revolute", "chest", "right_upper", "1 0 0"),
    "right2": ("continuous", "right_upper", "right_hand", "0 0 1"),
    "finger1": ("prismatic", "left_hand", "thumb", "0 1 0"),
    "finger2": ("prismatic", "left_hand", "index", "0 -1 0"),
}
LINKS = ("trunk", "chest", "left_upper", "left_hand", "right_upper", "right_hand", "thumb", "index")
QUICK = "--no-posterior", "--no-report", "--complete", "off"
LEFT = "--tip", "left_hand", "--hold", "lift=0.3"


def urdf():
    text = "".join(f'<link name="{link}"/>' for link in LINKS)
    for k, (name, (kind, parent, child, axis)) in enumerate(ENDS.items()):
        limit = f'<limit lower="-{k + 1}.5" upper="{k + 1}.25" effort="9" velocity="2.{k}"/>'
        place = f'<origin xyz="0.{k} 0.1 0.2" rpy="0.3 0.{k} -0.2"/>' if "finger" not in name else ""
        mimic = '<mimic joint="finger1"/>' if name == "finger2" else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        text += f'<joint name="{name}" type="{kind}">{ends}{place}{limit}{mimic}</joint>'
    return f'<robot name="two_arms">{text}</robot>'


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    place = tmp_path_factory.mktemp("shop")
    (place / "two arms.urdf").write_text(urdf())
    simulated = "simulate", "--robot", place / "two arms.urdf", *LEFT, "--duration", 6, "--out", place / "left.csv"
    assert run(*simulated) == 0
    return place


@pytest.fixture
def place(shop, monkeypatch):
    monkeypatch.chdir(shop)
    return shop


def test_one_arm_from_log_to_validation(place, capfd):
    assert run("identify", "left.csv", "--robot", "two arms.urdf", *LEFT, "--out", "left", *QUICK) == 0
    told = capfd.readouterr().err.splitlines()
    held = "joints finger1, finger2, right1, right2 are held: not on the chain to left_hand"
    assert told[:2] == [f"warning: {held}", "warning: joint lift (at 0.3) is held: by --hold"]
    summary = json.loads((place / "left" / "summary.json").read_text())
    assert summary["warnings"][0] == held
    table = tomllib.loads((place / "left" / "model.toml").read_text())["robot"]
    assert [joint["name"] for joint in table["joints"]] == ["left1", "left2"]
    assert table["notes"][0] == held
    assert run("validate", "left", "left_signed.csv") == 0
    robot = bayesid.load_robot("two arms.urdf", tip="left_hand", hold={"lift": 0.3})
    assert bayesid.load("left").model.robot.same_kinematics(robot)
    provenance = summary["provenance"]
    again = eval(provenance["call"], {"bayesid": bayesid})
    assert again.model.robot.same_kinematics(robot)
    assert json.dumps(provenance["options"]["hold"]) == '{"lift": 0.3}'


def test_a_log_of_fewer_joints_is_told_the_options_that_help(place, capfd):
    identify = "identify", "left.csv", "--robot", "two arms.urdf", "--out", "chosen", *QUICK
    assert run(*identify) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    proposed = said.split("choose its chain of 2 joints by ")[1].strip().split(", or by ")
    assert proposed == ["--tip left2 --hold lift=0", "--tip right2 --hold lift=0"]
    assert run(*identify, *shlex.split(proposed[0])) == 0
    assert not capfd.readouterr().err.startswith("bayesid")


def test_show_names_the_joints_in_the_logs_order(place, capfd):
    assert run("robot", "show", "two arms.urdf", *LEFT, "--q", "0.1,0.2") == 0
    out, err = capfd.readouterr()
    assert [line.split()[:3] for line in out.splitlines() if line.startswith("joint")] == [
        ["joint", "1", "left1"],
        ["joint", "2", "left2"],
    ]
    assert "not on the chain to left_hand" in err
    for command, options, says in (
        (("identify", "left.csv"), ("--tip", "left_hnd"), "two arms.urdf: has no link or joint 'left_hnd'; --tip take"),
        (("excite",), ("--hold", "lift"), "--hold: 'lift' are not positions; give JOINT=POSITION,.. in rad or m"),
        (("simulate",), ("--hold", "lif=1"), "two arms.urdf: has no moving joint 'lif'; --hold takes lift"),
    ):
        assert run(*command, "--robot", "two arms.urdf", *options, "--out", "none") == 2
        assert capfd.readouterr().err.startswith(f"bayesid: {says}")
    assert not (place / "none").exists()


def test_limits_are_those_of_the_chosen_joints(place, monkeypatch, capfd):
    """The file's own limits, although it branches; those of another file with the same names too."""
    seen = {}

    def spy(robot, *arguments, **named):
        seen.update(named, robot=robot)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesid.cli.excite.design_for_robot", spy)
    for options in ((), ("--limits", "two arms.urdf")):
        assert run("excite", "--robot", "two arms.urdf", "--tip", "right2", *options) == 130
        assert [joint.name for joint in seen["robot"].joints] == ["lift", "right1", "right2"]
        limits = seen["settings"].limits
        assert (limits.lower[:2], limits.upper[:2]) == ((-1.5, -4.5), (1.25, 4.25))
        assert limits.velocity == (2.0, 2.3, 2.4)
    assert "not on the chain to right2" in capfd.readouterr().err
    (place / "other.urdf").write_text(urdf().replace("right1", "wright1"))
    assert run("excite", "--robot", "two arms.urdf", "--tip", "right2", "--limits", "other.urdf") == 2
    assert "other.urdf: has no joint 'right1'" in capfd.readouterr().err
