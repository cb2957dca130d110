"""URDF files of packages that are installed, by the names that these packages use. Nothing is imported or downloaded.

example-robot-data holds its files. robot_descriptions names files of git repositories, which it clones when one of its
modules is imported: here its modules are read as text, and a file counts where an earlier clone is in its cache.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from bayesid.errors import InputError

_DATA, _DESCRIPTIONS = "example-robot-data", "robot_descriptions"
_LOADERS_NAMES = {
    "anymal_c": "anymal_c_simple_description/urdf/anymal",
    "anymal_kinova": "anymal-kinova",
    "asr_twodof": "TwoDofs",
    "b1_z1": "b1-z1",
    "borinot": "borinot_flying_arm_2",
    "hector": "quadrotor_base",
    "hextilt": "hextilt_flying_arm_5",
    "hyq": "hyq_no_sensors",
    "solo8": "solo",
    "talos": "talos_reduced",
    "talos_arm": "talos_left_arm",
    "talos_box": "talos_reduced_box",
    "talos_full": "talos_full_v2",
    "talos_full_box": "talos_full_v2_box",
    "ur10": "ur10_robot",
    "ur10_limited": "ur10_joint_limited_robot",
    "ur3": "ur3_robot",
    "ur3_limited": "ur3_joint_limited_robot",
    "ur5": "ur5_robot",
    "ur5_limited": "ur5_joint_limited_robot",
}
"""Names of example-robot-data's loaders (`ROBOTS`, in a package of their own since 4.4) that are not those of files."""


def installed_urdf(name: str) -> Path | None:
    """The file of a robot of an installed package; None if no package knows the name.

    Args:
        name: of example-robot-data's loaders or files, or of robot_descriptions, with or without `_description`.

    Raises:
        InputError: robot_descriptions knows the name, but its file is not here.
    """
    if name in _robot_data():
        return _robot_data()[name]
    module = next((known for known in (name, f"{name}_description") if known in _descriptions()), None)
    return None if module is None else _described(module)


def installed_names() -> list[str]:
    """All names that installed packages know."""
    return [*_robot_data(), *_descriptions()]


def how_to_name() -> str:
    """What else may be given as a robot, in words."""
    missing = "" if _robot_data() and _descriptions() else ", which come with `pip install 'bayesid[robots]'`"
    return f"a name of {_DATA} or {_DESCRIPTIONS}{missing}"


@cache
def _files(package: str, ending: str) -> tuple[Path, ...]:
    try:
        files = distribution(package).files or []
    except PackageNotFoundError:
        return ()
    return tuple(sorted(Path(str(file.locate())).resolve() for file in files if file.name.endswith(ending)))


@cache
def _robot_data() -> Mapping[str, Path]:
    """Name to file, for loaders' names, files without their ending, and a robot's folder."""
    files = _files(_DATA, ".urdf")
    loaded = {name: [file for file in files if file.match(f"{end}.urdf")] for name, end in _LOADERS_NAMES.items()}
    names = {name: found[0] for name, found in loaded.items() if found}
    for file in files:
        names.setdefault(file.stem, file)
        if f"{file.stem}_description" in file.parts:
            names.setdefault(f"{file.stem}_description", file)
    return names


# ---------------------------------------------------------------------------------------------------------------
# robot_descriptions
# ---------------------------------------------------------------------------------------------------------------
@cache
def _descriptions() -> Mapping[str, Path]:
    """Name to the module that states its paths; those of MuJoCo's format have no URDF."""
    files = _files(_DESCRIPTIONS, "_description.py")
    return {file.stem: file for file in files if not file.stem.startswith("_") and "_mj_" not in file.stem}


def _described(name: str) -> Path:
    stated = _stated_paths(_descriptions()[name])
    fetch = f"`python -m robot_descriptions pull {name}`"
    if "URDF_PATH" in stated:
        if stated["URDF_PATH"].is_file():
            return stated["URDF_PATH"]
        place = stated["URDF_PATH"]
        raise InputError(f"its files are not here ({place})", name, f"fetch them once by {fetch}, with a network")
    if "XACRO_PATH" not in stated:
        raise InputError("states no URDF file", name, f"give the file that {fetch} prints, if it is a URDF")
    rendered = sorted(_cache_folder().glob(f"xacrodoc/{name}/*.urdf"), key=lambda file: file.stat().st_mtime)
    if not rendered:
        remedy = f"make it once by {fetch}, with a network and `pip install xacrodoc`"
        raise InputError("is made by xacro, and its URDF is not here", name, remedy)
    return rendered[-1]


def _cache_folder() -> Path:
    return Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")).expanduser()


def _stated_paths(module: Path) -> dict[str, Path]:
    """Paths that a module assigns by joining strings and a repository's folder; what it computes is left out."""
    paths: dict[str, Path] = {}
    for node in ast.parse(module.read_text(encoding="utf-8")).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(target, ast.Name) and node.value is not None:
            path = _path(node.value, paths, module.with_name("_repositories.py"))
            paths |= {} if path is None else {target.id: path}
    return paths


def _path(value: ast.expr, known: Mapping[str, Path], repositories: Path) -> Path | None:
    """What an expression is as a path; None if it is something else."""
    if isinstance(value, ast.Name):
        return known.get(value.id)
    if isinstance(value, ast.Constant):
        return Path(str(value.value))
    if not isinstance(value, ast.Call) or not value.args:
        return None
    function = ast.unparse(value.func)
    if function == "_clone_to_cache" and isinstance(value.args[0], ast.Constant):
        return _clone(str(value.args[0].value), repositories)
    parts = [_path(part, known, repositories) for part in value.args]
    if function == "_path.join":
        return None if None in parts else Path(*(part for part in parts if part is not None))
    return parts[0].parent if function == "_path.dirname" and parts[0] is not None else None


def _clone(repository: str, repositories: Path) -> Path | None:
    """Where robot_descriptions keeps a repository."""
    for node in ast.walk(ast.parse(repositories.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Dict):
            continue
        for key, entry in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and key.value == repository and isinstance(entry, ast.Call):
                folder = next(ast.literal_eval(word.value) for word in entry.keywords if word.arg == "cache_path")
                commit = os.environ.get("ROBOT_DESCRIPTION_COMMIT")
                return _cache_folder() / (f"{folder}-{commit}/{folder}" if commit else folder)
    return None
