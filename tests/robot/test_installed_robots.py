"""Robots of installed packages: of packages made up here and, where they are installed, of the real ones."""

import importlib
import os
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.robot import load, load_robot

ARM = (
    '<robot name="NAME"><link name="base"/><link name="l1"/><joint name="j1" type="revolute"><parent link="base"/>'
    '<child link="l1"/><axis xyz="0 1 0"/></joint></robot>'
)
REPOSITORIES = """raise RuntimeError("imported")
REPOSITORIES = {
    "arms": Repository(url="https://localhost/arms.git", commit="v1", cache_path="arms_clone"),
    "others": Repository(url="https://localhost/others.git", commit="v2", cache_path="others"),
}
"""
MODULE = """raise RuntimeError("imported")
from os import path as _path
from ._cache import clone_to_cache as _clone_to_cache
REPOSITORY_PATH: str = _clone_to_cache("arms", commit=_getenv("ROBOT_DESCRIPTION_COMMIT", None))
PACKAGE_PATH: str = _path.join(_path.dirname(_path.join(REPOSITORY_PATH, "robots", "x")), "seven")
"""
MODULES = {
    "seven_description": MODULE + 'URDF_PATH: str = _path.join(PACKAGE_PATH, "urdf", "seven.urdf")\n',
    "eight_description": MODULE + 'URDF_PATH: str = _path.join(PACKAGE_PATH, "urdf", "eight.urdf")\n',
    "made_description": MODULE + 'XACRO_PATH: str = _path.join(PACKAGE_PATH, "made.xacro")\n',
    "bare_description": MODULE,
    "_empty_description": MODULE,
    "_repositories": REPOSITORIES,
    "__init__": 'raise RuntimeError("imported")\n',
}
DATA = ("ur_description/urdf/ur5_robot", "seven_description/urdf/seven", "b_description/any", "a_description/any")


def install(place, name, files):
    """A package as pip leaves it."""
    info = place / f"{name.replace('-', '_')}-9.9.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.9\n")
    for file, text in files.items():
        (place / file).parent.mkdir(parents=True, exist_ok=True)
        (place / file).write_text(text)
    (info / "RECORD").write_text("".join(f"{file},,\n" for file in files))


@pytest.fixture
def forgotten():
    """What is known of installed packages is looked up anew."""
    importlib.reload(load)
    yield
    importlib.reload(load)


@pytest.fixture
def packages(tmp_path, monkeypatch, forgotten):
    """Both packages, made up; importing a module of theirs fails."""
    place = tmp_path / "site-packages"
    place.mkdir()
    share = "cmeel.prefix/share/example-robot-data/robots"
    install(place, "example-robot-data", {f"{share}/{file}.urdf": ARM.replace("NAME", file[:2]) for file in DATA})
    install(place, "robot_descriptions", {f"robot_descriptions/{name}.py": text for name, text in MODULES.items()})
    monkeypatch.syspath_prepend(place)
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ROBOT_DESCRIPTION_COMMIT", raising=False)
    yield tmp_path / "cache"
    assert "robot_descriptions" not in sys.modules


def refusal(name):
    with pytest.raises(InputError) as caught:
        load_robot(name)
    assert caught.value.where == name
    return in_options(str(caught.value))


def test_names_of_files_and_of_loaders(packages, tmp_path, monkeypatch):
    for name in ("ur5_robot", "ur5"):
        robot = load_robot(name)
        assert (robot.name, robot.origin.source, robot.origin.urdf.name) == ("ur", name, "ur5_robot.urdf")
        assert robot.origin.in_python == repr(name)
    assert load_robot("seven_description").name == load_robot("seven").name == "se"
    assert load_robot("any").name == "a_", "of two files with a name the first"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ur5").write_text(ARM.replace("NAME", "mine"))
    assert load_robot("ur5").name == "mine"
    assert load_robot("kr5").n_joints == 6, "files and built-in robots come first"


def test_a_description_whose_files_are_not_here(packages, monkeypatch):
    place = packages / "arms_clone" / "robots" / "seven" / "urdf" / "eight.urdf"
    said = refusal("eight_description")
    assert str(place) in said
    assert "`python -m robot_descriptions pull eight_description`" in said
    assert not packages.exists(), "nothing was fetched"
    place.parent.mkdir(parents=True)
    place.write_text(ARM.replace("NAME", "cloned"))
    assert load_robot("eight").name == "cloned"
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "abc")
    assert f"({packages}/arms_clone-abc/arms_clone/robots/seven" in refusal("eight_description")


def test_descriptions_by_xacro_are_those_that_were_made_last(packages):
    assert "states no URDF file" in refusal("bare_description")
    assert "is made by xacro, and its URDF is not here" in refusal("made_description")
    place = packages / "xacrodoc" / "made_description"
    place.mkdir(parents=True)
    for age, name in enumerate(("b", "a")):
        (place / f"{name}.urdf").write_text(ARM.replace("NAME", name))
        os.utime(place / f"{name}.urdf", (age, age))
    assert load_robot("made").name == "a"


def test_without_the_packages(monkeypatch, forgotten):
    def nothing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(load, "distribution", nothing)
    assert "pip install 'bayesid[robots]'" in refusal("ur5")
    assert load.installed_names() == []


def test_robots_of_the_real_packages():
    """All files but two rigid bodies with propellers and one without a link; arms, a hand that is held, a limb."""
    try:
        files = [Path(str(file.locate())) for file in distribution("example-robot-data").files]
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install 'bayesid[robots]'")
    refused = set()
    for file in (file for file in files if file.suffix == ".urdf"):
        try:
            load_robot(file)
        except InputError:
            refused.add(file.name)
    assert {"quadrotor_base.urdf", "iris_simple.urdf", "ur3.urdf"} <= refused
    assert len(refused) <= 4
    panda = load_robot("panda_description")
    assert [joint.name for joint in panda.joints] == [f"panda_joint{k}" for k in range(1, 8)]
    assert panda.notes == ("joints panda_finger_joint1, panda_finger_joint2 are held: a gripper is not identified",)
    left = load_robot("tiago_pro", "arm_left_7_link", {"torso_lift_joint": 0.1})
    assert [joint.name for joint in left.joints] == [f"arm_left_{k}_joint" for k in range(1, 8)]
    assert load_robot("talos_arm").n_joints == load_robot("ur3").n_joints == load_robot("solo12").n_joints / 2 == 6
