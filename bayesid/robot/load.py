"""Loads robots by name or from a file, and compares their joints with a log.

Built-in robots are Denavit-Hartenberg files in the folder robots/, each named after its file. They hold the keys of
`robot_from_table` and three more: `description` (maker and models), `source` (where the numbers are published) and
`notes` (meaning of the positions, place of the last frame).

URDF files of installed packages have the names of these packages; nothing is imported or downloaded. example-robot-data
holds its files. robot_descriptions clones git repositories when one of its modules is imported. Here only the modules'
assignments are evaluated, and files are used if an earlier clone is in the cache.
"""

from __future__ import annotations

import ast
import os
import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
from importlib import resources
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.files.bounded import read_source, toml_of
from bayesid.robot.arm import Origin, Robot
from bayesid.robot.dh_table import robot_from_table
from bayesid.robot.mjcf import is_mjcf, robot_from_mjcf
from bayesid.robot.tuning import TUNING
from bayesid.robot.urdf import robot_from_urdf

_FOLDER = resources.files("bayesid.robot") / "robots"
BUILT_IN = tuple(sorted(file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")))
"""Names of all built-in robots."""
CONTROLLERS = {"kr5-paper": "kr5r650"}
"""For tables with different zeros, the table with the controller's zeros."""
ALIASES = {"kr5": "kr5-paper"}
"""Other names of built-in robots."""
_DATA, _DESCRIPTIONS = "example-robot-data", "robot_descriptions"
# Names of example-robot-data's loaders (`ROBOTS`, in a package of their own since 4.4) that are not those of files.
_LOADERS_NAMES = """
    anymal_c=anymal_c_simple_description/urdf/anymal anymal_kinova=anymal-kinova asr_twodof=TwoDofs b1_z1=b1-z1
    borinot=borinot_flying_arm_2 hector=quadrotor_base hextilt=hextilt_flying_arm_5 hyq=hyq_no_sensors solo8=solo
    talos=talos_reduced talos_arm=talos_left_arm talos_box=talos_reduced_box talos_full=talos_full_v2
    talos_full_box=talos_full_v2_box ur10=ur10_robot ur10_limited=ur10_joint_limited_robot ur3=ur3_robot
    ur3_limited=ur3_joint_limited_robot ur5=ur5_robot ur5_limited=ur5_joint_limited_robot
"""


def load_robot(
    source: str | Path | Mapping[str, Any],
    tip: str | None = None,
    hold: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
) -> Robot:
    """A robot from a built-in name, a file (DH table .toml, URDF, MJCF), a table, or a name of an installed package.

    Args:
        source: name, file, or content of a DH file: `name`, `convention` ("standard" or "modified"), `joints` (each
            with a, alpha, d, theta; m and rad; optional `type` "revolute" or "prismatic" and `rated_effort`, N m or N),
            optional `gravity` (m/s^2) and `transmission`. Names of example-robot-data and of robot_descriptions are
            known if these are installed.
        tip: for a URDF: link or joint at the end of the identified chain; all other joints are held. By default all
            chains are identified, but not grippers.
        hold: for a URDF: positions of further held joints, rad or m, by name.
        gravity: (3,) acceleration of gravity in the base frame, m/s^2, instead of the file's: (0, 0, 9.81) for a base
            upside down, (0, 0, 0) for gravity-compensated efforts.

    Returns:
        The robot; its `notes` list held joints, and a base that is assumed to be fixed.

    Raises:
        InputError: no such robot, the file cannot be read as one, or it has no such link or joint.

    Example:
        >>> bayesid.load_robot("ur10e").n_joints, bayesid.load_robot("robot.toml").name
        (6, 'arm')
        >>> joints = [{"a": a, "alpha": 0.0, "d": 0.1, "theta": 0.0} for a in (0.35, 0.3)]
        >>> bayesid.load_robot({"name": "scara", "convention": "standard", "joints": joints}).n_joints
        2
    """
    if gravity is not None and (len(gravity) != 3 or not np.all(np.isfinite(gravity))):
        remedy = "give three numbers, m/s^2, as in (0, 0, 9.81)"
        raise InputError(f"{gravity!r} is not an acceleration", field="gravity", remedy=remedy)
    of_base = None if gravity is None else tuple(map(float, gravity))
    if isinstance(source, Mapping):
        return _of_table(source, Origin("", tip=tip, hold=dict(hold or {}), gravity=of_base))
    chosen = Origin(str(source), tip=tip, hold=dict(hold or {}), gravity=of_base)
    if is_built_in(str(source)):
        return _from_table(built_in_table(str(source)), f"built-in robot {source}", chosen)
    path = Path(source) if os.path.isfile(source) else installed_urdf(str(source))
    if path is None:
        raise _unknown(str(source))
    text = read_source(path, "give a text file in TOML or URDF")
    if path.suffix == ".toml":
        return _from_table(toml_of(text, str(path), "correct the file"), str(path), chosen)
    if is_mjcf(text):
        return _loaded(robot_from_mjcf(text, str(path), tip, hold), chosen)
    return _loaded(robot_from_urdf(text, str(path), tip, hold), replace(chosen, urdf=path))


def _of_table(table: Mapping[str, Any], chosen: Origin) -> Robot:
    """A robot from a table in Python, without an origin."""
    return replace(_from_table(table, f"robot {table.get('name', '')!s:.60}".rstrip(), chosen))


def _from_table(table: Mapping[str, Any], where: str, chosen: Origin) -> Robot:
    for name, value in (("tip", chosen.tip), ("hold", chosen.hold)):
        if value:
            raise InputError("is a table of one chain; all its joints are identified", where, f"leave `{name}` out")
    return _loaded(robot_from_table(table, where), chosen)


def _loaded(robot: Robot, origin: Origin) -> Robot:
    """The robot with its origin (changed copies have none) and the chosen gravity."""
    robot = robot if origin.gravity is None else replace(robot, gravity=np.array(origin.gravity))
    object.__setattr__(robot, "origin", origin)
    return robot


def _unknown(name: str) -> InputError:
    files = "a DH file (.toml) or a URDF file"
    if Path(name).suffix or len(Path(name).parts) > 1:
        return InputError("no such file", name, f"give {files}, or a built-in name (`bayesid robot list`)")
    known = list(dict.fromkeys([*ALIASES, *BUILT_IN, *installed_names()]))
    plain = re.sub(r"[\s-]+", "", name.lower())
    nearest = get_close_matches(plain, known, n=3, cutoff=TUNING.near_name)
    nearest = nearest or [other for other in known if plain in other][:3]
    suggestion = f", did you mean {' or '.join(nearest)}?" if nearest else ""
    missing = "" if _robot_data() and _descriptions() else ", which come with `pip install 'bayesid[robots]'`"
    remedy = f"give a built-in name (`bayesid robot list`), {files}, or a name of {_DATA} or {_DESCRIPTIONS}{missing}"
    return InputError(f"no such robot{suggestion}", name, remedy)


def is_built_in(name: str) -> bool:
    """Whether a built-in robot has this name."""
    return name in BUILT_IN or name in ALIASES


def built_in_table(name: str) -> dict[str, Any]:
    """Content of a built-in robot's file."""
    return tomllib.loads((_FOLDER / f"{ALIASES.get(name, name)}.toml").read_text(encoding="utf-8"))


# ---- Robots of installed packages ----
def alias_note(name: str) -> str | None:
    """Note on a robot whose zeros differ from the controller's, or None."""
    table_name = ALIASES.get(name)
    if table_name is None:
        return None
    remedy = f"for positions of the controller give {CONTROLLERS[table_name]}"
    return f"the zeros of {name} ({table_name}) are not the controller's; {remedy}"


def installed_urdf(name: str) -> Path | None:
    """File of a robot in an installed package; None if no package has the name.

    Names are those of example-robot-data's loaders or files, and of robot_descriptions, with or without `_description`;
    InputError if the file of a known name is missing.
    """
    if name in _robot_data():
        return _robot_data()[name]
    module = next((known for known in (name, f"{name}_description") if known in _descriptions()), None)
    return None if module is None else _described(module)


def installed_names() -> list[str]:
    """All names of robots in installed packages."""
    return [*_robot_data(), *_descriptions()]


def _files(package: str, ending: str) -> tuple[Path, ...]:
    try:
        files = distribution(package).files or []
    except PackageNotFoundError:
        return ()
    return tuple(sorted(Path(str(file.locate())).resolve() for file in files if file.name.endswith(ending)))


@cache
def _robot_data() -> Mapping[str, Path]:
    """Name to file, for loaders' names, files without their ending, and a robot's folder."""
    files, loaders = _files(_DATA, ".urdf"), (pair.split("=") for pair in _LOADERS_NAMES.split())
    loaded = {name: [file for file in files if file.match(f"{end}.urdf")] for name, end in loaders}
    names = {name: found[0] for name, found in loaded.items() if found}
    for file in files:
        names.setdefault(file.stem, file)
        if f"{file.stem}_description" in file.parts:
            names.setdefault(f"{file.stem}_description", file)
    return names


@cache
def _descriptions() -> Mapping[str, Path]:
    """Name to the module that states its paths; those of MuJoCo's format have no URDF."""
    files = _files(_DESCRIPTIONS, "_description.py")
    return {file.stem: file for file in files if not file.stem.startswith("_") and "_mj_" not in file.stem}


def _described(name: str) -> Path:
    module, cache = _descriptions()[name], _cache_folder()

    def clone(repository: str, **_: object) -> str:
        """Where robot_descriptions keeps a repository."""
        known = _assigned(module.with_name("_repositories.py"), Repository=lambda **given: given)
        folder, commit = known["REPOSITORIES"][repository]["cache_path"], os.environ.get("ROBOT_DESCRIPTION_COMMIT")
        return str(cache / (f"{folder}-{commit}/{folder}" if commit else folder))

    stated = _assigned(module, _path=os.path, _getenv=os.environ.get, _clone_to_cache=clone)
    fetch = f"`python -m robot_descriptions pull {name}`"
    if "URDF_PATH" in stated:
        place = Path(stated["URDF_PATH"])
        if place.is_file():
            return place
        raise InputError(f"its files are missing ({place})", name, f"fetch them once by {fetch}, with a network")
    if "XACRO_PATH" not in stated:
        raise InputError("states no URDF file", name, f"give the file that {fetch} prints, if it is a URDF")
    rendered = sorted(cache.glob(f"xacrodoc/{name}/*.urdf"), key=lambda file: file.stat().st_mtime)
    if not rendered:
        remedy = f"generate it once by {fetch}, with a network and `pip install xacrodoc`"
        raise InputError("is generated by xacro, and its URDF is missing", name, remedy)
    return rendered[-1]


def _cache_folder() -> Path:
    return Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")).expanduser()


def _assigned(module: Path, **imported: Any) -> dict[str, Any]:
    """Assignments of a module, with `imported` in place of its imports; those that need other names are left out."""
    names = {"__builtins__": {}, **imported}
    for node in ast.parse(module.read_text(encoding="utf-8")).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(target, ast.Name) and node.value is not None:
            with suppress(Exception):
                names[target.id] = eval(compile(ast.Expression(node.value), str(module), "eval"), names)
    return names


# ---- Joints of a log ----
def check_joints(robot: Robot, count: int, source: str) -> None:
    """InputError unless log and robot have equally many joints; it names options that select a matching chain."""
    if count == robot.n_joints:
        return
    what = f"the log has {count} joints, but robot {robot.name} has {robot.n_joints}"
    remedy = "give matching log and robot"
    if count > robot.n_joints:
        what += f" ({', '.join(robot.notes)})" if robot.notes else ""
        remedy += " (or select only the robot's joints with `columns`)"
    elif chains := chains_of(robot, count):
        remedy += f", or choose its chain of {count} joints by {', or by '.join(chains[: TUNING.named_chains])}"
    raise InputError(what, source, remedy)


def chains_of(robot: Robot, count: int) -> list[str]:
    """Options that select a chain of so many joints from a robot with more.

    A chain begins at the base, or after a joint that carries several, such as a torso's last; the joints before it are
    held. It ends at a joint that carries none or several, or anywhere if there is no such chain. Chains with the fewest
    held joints are listed.
    """
    names = [joint.name for joint in robot.joints]
    paths = [robot.to_base(k)[::-1] for k in range(robot.n_joints)]
    carried = Counter(joint.parent for joint in robot.joints)
    limbs = [
        (path[:-count], path[-1])
        for path in paths
        if len(path) >= count and carried[path[-1]] != 1 and (len(path) == count or carried[path[-count - 1]] > 1)
    ]
    fewest = min((len(before) for before, _ in limbs), default=0)
    limbs = [limb for limb in limbs if len(limb[0]) == fewest]
    limbs = limbs or [([], path[-1]) for path in paths if len(path) == count]
    held = [",".join(f"{names[k]}=0" for k in before) for before, _ in limbs]
    options = [
        f"`tip` {names[last]}{f' `hold` {joints}' if joints else ''}"
        for (_, last), joints in zip(limbs, held, strict=True)
    ]
    return options if all(names) else []
