"""What is installed: packages, files and dependencies in pyproject.toml, and the wheel, far from its source."""

import ast
import email
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import bayesid

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
SOURCES = {"bayesid": ROOT / "bayesid", "bayesid.studies": ROOT / "studies"}
"""Packages and the folders they are made from."""
PROVIDES = {"pin": "pinocchio", "arviz-stats": "arviz_stats"}
"""What a distribution is imported as, where the names differ."""
BROUGHT = {"coal": "pin", "h5py": "h5netcdf", "markupsafe": "jinja2", "pandas": "xarray", "tomli_w": "msgspec"}
"""Packages that are imported too, with what is declared and needs them."""
BY_NAME = {"example-robot-data", "robot_descriptions", "h5netcdf"}
"""Never imported: the files of two are read, and xarray takes the third by name."""
TOOLS = {"test", "docs", "browser", "release"}
"""Extras of those who work on bayesid, not of those who use it."""
FOLDERS = (".ci", "bayesid", "docs", "studies", "tests")
"""Of the repository: the source distribution holds all of them."""


def top_files():
    """Files of the repository that lie in no folder."""
    made = {"PKG-INFO", "setup.cfg", ".git"}  # as the tests are run in an unpacked source distribution
    return [path for path in ROOT.iterdir() if path.is_file() and path.name not in made]


def files_of(folder):
    return [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def installed_files():
    """Every file of the source tree, where it is to stand in site-packages."""
    places = {package: Path(*package.split(".")) for package in SOURCES}
    return {
        (places[package] / path.relative_to(folder)).as_posix()
        for package, folder in SOURCES.items()
        for path in files_of(folder)
    }


def requirements(extras=()):
    return [
        Requirement(need) for needs in (PROJECT["project"]["dependencies"], *map(EXTRAS.get, extras)) for need in needs
    ]


def lower_bounds(extras=()):
    """Of the dependencies, and of those of extras."""
    bounds = [(need.name, one) for need in requirements(extras) for one in need.specifier]
    return {name: Version(one.version) for name, one in bounds if one.operator == ">="}


def imported(*folders):
    """Third-party packages that the modules of folders import, anywhere in them."""
    names = set()
    for path in (path for folder in folders for path in files_of(folder) if path.suffix == ".py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {name.name.split(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add((node.module or "").split(".")[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                names |= {name.value.split(".")[0] for name in node.args[:1] if isinstance(name, ast.Constant)}
    return names - set(sys.stdlib_module_names) - {"bayesid"}


def test_the_list_of_packages_is_complete():
    folders = {Path(name).parent.as_posix().replace("/", ".") for name in installed_files() if name.endswith(".py")}
    assert PROJECT["tool"]["setuptools"]["packages"] == sorted(folders)


def test_whatever_is_imported_is_declared_with_a_lower_bound_and_whatever_is_declared_is_imported():
    """And what every import needs is no extra."""
    declared = {need.name for need in requirements(set(EXTRAS) - TOOLS)}
    assert declared >= set(BROUGHT.values())
    named = {PROVIDES.get(name, name) for name in declared} | BROUGHT.keys()
    assert imported(*SOURCES.values()) | BY_NAME == named
    core = {PROVIDES.get(need.name, need.name) for need in requirements()} | BROUGHT.keys()
    assert imported(ROOT / "bayesid") - core == {"distributed", "pyarrow", "rosbags", "shtab"}
    assert set(lower_bounds(EXTRAS)) >= declared


def test_the_citation_is_of_this_version():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", text, re.M)[1] == bayesid.__version__


@pytest.mark.skipif("BAYESID_RESOLUTION" not in os.environ, reason="of the environments that .ci/run makes")
def test_the_lowest_versions_are_the_declared_ones():
    """A bound below what can be installed at all, beside the other bounds, promises what nobody has tried."""
    lowest = lower_bounds(["test"])
    installed = {name: Version(version(name)) for name in lowest}
    if os.environ["BAYESID_RESOLUTION"] == "lowest-direct":
        assert installed == lowest
    assert all(installed[name] >= lowest[name] for name in lowest)


def execute(arguments, place, python=sys.executable, code=0):
    """A Python without the source tree on its path; what it printed, if it ended with this code."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [str(python), *map(str, arguments)]
    ended = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == code, f"{' '.join(command)}\n{ended.stdout}\n{ended.stderr}"
    return ended.stderr if code else ended.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Wheel and source distribution, built from a copy, for setuptools leaves folders beside what it builds."""
    place = tmp_path_factory.mktemp("built")
    copy = place / "source"
    copy.mkdir()
    for folder in FOLDERS:
        left_out = shutil.ignore_patterns("__pycache__", *(["studies"] if folder == "bayesid" else []))
        shutil.copytree(ROOT / folder, copy / folder, ignore=left_out)
    for path in top_files():
        shutil.copy(path, copy)
    execute(["-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", place, copy], place)
    script = f"from setuptools import build_meta; build_meta.build_sdist({str(place)!r})"
    execute(["-c", script], copy)
    return next(place.glob("*.whl")), next(place.glob("*.tar.gz"))


@pytest.fixture(scope="module")
def elsewhere(built, tmp_path_factory):
    """A Python that has the wheel and this one's packages, but not the source tree."""
    place = tmp_path_factory.mktemp("elsewhere")
    execute(["-m", "venv", "--without-pip", "venv"], place)
    python = place / "venv" / "bin" / "python"
    execute(["-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index", built[0]], place)
    packages = [path for path in sys.path if "site-packages" in path]  # as paths: no editable install is followed
    own = next((place / "venv").glob("lib/python*/site-packages"))
    (own / "packages.pth").write_text("\n".join(packages) + "\n")
    return python


@pytest.mark.long
def test_the_wheel_and_the_source_distribution_hold_every_file(built):
    with zipfile.ZipFile(built[0]) as wheel:
        names = set(wheel.namelist())
        about = next(name for name in names if name.endswith(".dist-info/METADATA"))
        metadata = email.message_from_string(wheel.read(about).decode())
    assert {name.split("/")[0] for name in names} == {"bayesid", f"bayesid-{bayesid.__version__}.dist-info"}
    assert {name for name in names if name.startswith("bayesid/")} == installed_files()
    assert "bayesid/py.typed" in names
    text = metadata.get_payload()
    assert text.startswith("# bayesid\n")
    assert re.findall(r"\]\((?!https?://)[^)]*\)", text) == [], "a link that leads nowhere beside the wheel"
    with tarfile.open(built[1]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    paths = [*top_files(), *(path for folder in FOLDERS for path in files_of(ROOT / folder))]
    assert {path.relative_to(ROOT).as_posix() for path in paths} <= names
    assert not [name for name in names if name.startswith("bayesid/studies") or "__pycache__" in name]


@pytest.mark.long
def test_everything_works_from_the_wheel(elsewhere, tmp_path):
    def command(*arguments, code=0):
        return execute(["-m", "bayesid.cli", *arguments], tmp_path, elsewhere, code)

    where = execute(["-c", "import bayesid.studies as s; print(s.__file__)"], tmp_path, elsewhere)
    assert Path(where.strip()).is_relative_to(elsewhere.parents[1])
    assert command("--version") == f"bayesid {bayesid.__version__}\n"
    for robot in ("kr5", "panda"):
        command("simulate", "--robot", robot, "--duration", 4, "--rate", 50, "--out", f"{robot}.csv", "--quiet")
    command("identify", "kr5.csv", "--robot", "kr5", "--posterior-budget", 0, "--out", "result", "--quiet")
    assert {"report.html", "model.toml", "posterior.nc"} <= {path.name for path in (tmp_path / "result").iterdir()}
    command("report", "result", "--out", "again.html", "--quiet")
    assert "<svg" in (tmp_path / "again.html").read_text(encoding="utf-8")
    assert "written to" in command("study", "noise", "--trials", 2, "--out", "noise")
    assert (tmp_path / "noise" / "figure.svg").exists()
    script = "import sys; sys.modules['mujoco'] = None; from bayesid.cli import main; sys.exit(main(sys.argv[1:]))"
    said = execute(["-c", script, "study", "discrepancy", "--trials", 2], tmp_path, elsewhere, code=2)
    assert said == "bayesid: study discrepancy: needs mujoco; pip install 'bayesid[studies]'\n"
