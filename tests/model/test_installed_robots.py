"""Robots of installed packages: of packages made up here and, where they are installed, of the real ones."""

import importlib
import os
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from bayesid.errors import InputError
from bayesid.model.robot import installed, load_robot

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
    "made_description": MODULE + 'XACRO_PATH: str = _path.join(PACKAGE_PATH, "made.urdf.xacro")\n',
    "patched_description": MODULE + "URDF_PATH: str = _patch(PACKAGE_PATH)\n",
    "muscles_mj_description": MODULE + 'MJCF_PATH: str = _path.join(PACKAGE_PATH, "muscles.xml")\n',
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

    importlib.reload(installed)
    yield
    importlib.reload(installed)


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
    return caught.value.on_command_line


def test_names_of_files_and_of_loaders(packages):
    for name in ("ur5_robot", "ur5"):
        robot = load_robot(name)
        assert (robot.name, robot.origin.source, robot.origin.urdf.name) == ("ur", name, "ur5_robot.urdf")
        assert robot.origin.in_python == repr(name)
    assert load_robot("seven_description").name == load_robot("seven").name == "se"
    assert load_robot("any").name == "a_", "of two files with a name the first"
    assert load_robot("any").origin.urdf.is_absolute()


def test_files_and_built_in_robots_come_before_names(packages, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ur5").write_text(ARM.replace("NAME", "mine"))
    assert load_robot("ur5").name == "mine"
    assert load_robot("kr5").n_joints == 6


def test_descriptions_by_xacro_are_those_that_were_made(packages):
    name = "made_description"
    with pytest.raises(InputError, match=r"made_description: is made by xacro, and its URDF is not here; make it once"):
        load_robot("made")
    for age, text in enumerate(("old", "new")):
        rendered = packages / "xacrodoc" / name / f"{name}-{text}.urdf"
        rendered.parent.mkdir(parents=True, exist_ok=True)
        rendered.write_text(ARM.replace("NAME", text))
        os.utime(rendered, (age, age))
    assert load_robot(name).name == "new"


def test_a_description_whose_files_are_not_here(packages, monkeypatch):
    place = packages / "arms_clone" / "robots" / "seven" / "urdf" / "eight.urdf"
    said = refusal("eight_description")
    assert str(place) in said
    assert "`python -m robot_descriptions pull eight_description`" in said
    assert not packages.exists(), "nothing was fetched"
    place.parent.mkdir(parents=True)
    place.write_text(ARM.replace("NAME", "cloned"))
    assert load_robot("eight_description").name == load_robot("eight").name == "cloned"
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "abc")
    assert f"({packages}/arms_clone-abc/arms_clone/robots/seven" in refusal("eight_description")


def test_descriptions_without_a_urdf(packages):
    assert "patched_description: states no URDF file; give the file that `python -m" in refusal("patched_description")
    assert "no such robot" in refusal("muscles_mj_description")


def test_a_name_that_is_near_others(packages):
    for name, near in (("ur5_robt", "ur5_robot"), ("made_desciption", "made_description"), ("ven", "seven")):
        assert f"did you mean {near}" in refusal(name)
    assert "did you mean" not in refusal("zzzz")


def test_without_the_packages(monkeypatch, forgotten):
    def nothing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(installed, "distribution", nothing)
    assert "pip install 'bayesid[robots]'" in refusal("ur5")
    assert installed.installed_names() == []


# ---------------------------------------------------------------------------------------------------------------
# The real packages
# ---------------------------------------------------------------------------------------------------------------
def files_of(package):
    try:
        files = distribution(package).files
    except PackageNotFoundError:
        pytest.skip(f"{package} is not installed: pip install 'bayesid[robots]'")
    return [Path(str(file.locate())) for file in files]


REFUSED = {
    "quadrotor_base.urdf": "has no moving joint",
    "iris_simple.urdf": "has no moving joint",
    "ur3.urdf": "has 0 links without a parent joint",
}
"""Two rigid bodies with propellers, and a file without a link."""


def test_all_but_three_of_example_robot_data_load():
    refused, files = {}, sorted(file for file in files_of("example-robot-data") if file.suffix == ".urdf")
    for file in files:
        try:
            load_robot(file)
        except InputError as error:
            refused[file.name] = error.what
    assert {name: refused.get(name) for name in REFUSED} == REFUSED
    assert len(refused) <= 4
    assert len(files) >= 65


def test_arms_of_example_robot_data():
    files_of("example-robot-data")
    names = [f"panda_joint{k}" for k in range(1, 8)]
    assert [joint.name for joint in load_robot("panda_description").joints] == names
    assert load_robot("panda_description").notes == (
        "joints panda_finger_joint1, panda_finger_joint2 are held: a gripper is not identified",
    )
    assert load_robot("panda").origin.urdf is None, "the built-in one"
    left = load_robot("tiago_pro", "arm_left_7_link", {"torso_lift_joint": 0.1})
    assert [joint.name for joint in left.joints] == [f"arm_left_{k}_joint" for k in range(1, 8)]
    assert load_robot("talos").notes[-1] == "3 chains of joints begin at base_link: it is taken as fixed to the ground"
    assert load_robot("talos_arm").n_joints == load_robot("ur3").n_joints == load_robot("solo12").n_joints / 2 == 6
    assert load_robot("anymal_c").origin.urdf != load_robot("anymal").origin.urdf


def test_robot_descriptions_state_their_files(monkeypatch, tmp_path, forgotten):
    """But one, which patches its file; those of MuJoCo's format are left out."""
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path))
    if not any(file.stem == "iiwa7_description" for file in files_of("robot_descriptions")):
        pytest.skip("another version of robot_descriptions")
    unknown = []
    for name in installed.installed_names():
        try:
            installed.installed_urdf(name)
        except InputError as error:
            unknown += [name] if "states no URDF file" in error.what else []
    assert unknown == ["eve_r3_description"]
    file = tmp_path / "differentiable-robot-model" / "diff_robot_data" / "kuka_iiwa" / "urdf" / "iiwa7.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(ARM)
    assert installed.installed_urdf("iiwa7") == file
    assert "robot_descriptions" not in sys.modules
