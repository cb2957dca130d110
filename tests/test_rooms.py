"""The rooms of bayesid/: which may import which, which third-party packages are known where, how long functions are."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from statistics import median

import pytest

ROOT = Path(__file__).parents[1]
GROUND = ("errors", "arrays", "motion", "files", "process", "progress")
ROOMS = (
    "model",
    "log",
    "fit",
    "simulation",
    "signs",
    "posterior",
    "identification",
    "discrepancy",
    "monitor",
    "excitation",
    "report",
    "study",
    "results",
    "cli",
)
"""From the ground up, in the order in which data pass through them."""
EVERYWHERE = {"numpy", "scipy"}
HOMES = {
    "threadpoolctl": {"process"},
    "pinocchio": {"model"},
    "coal": {"model"},
    "rosbags": {"log"},
    "pyarrow": {"log", "study"},
    "h5py": {"log", "posterior"},
    "h5netcdf": {"posterior"},
    "clarabel": {"fit"},
    "emcee": {"posterior"},
    "arviz": {"posterior"},
    "xarray": {"posterior"},
    "pandas": {"posterior"},
    "matplotlib": {"report"},
    "jinja2": {"report"},
    "markupsafe": {"report"},
    "distributed": {"study"},
    "tomli_w": {"results"},
    "rich": {"cli"},
    "shtab": {"cli"},
    "lazy_loader": {"", "report"},
}
"""A package to the rooms that may import it; "" is bayesid/__init__.py. Two files h5py and pyarrow read and write:
logs, and what we keep ourselves."""
FILES = sorted((ROOT / "bayesid").rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    """What a file says."""
    return ast.parse(path.read_text(encoding="utf-8"))


def module_of(path: Path) -> str:
    """The dotted name of a file below bayesid/."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of all that a file imports: at the top, in functions, and for types alone."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, name.name) for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno} imports relatively"
            yield from ((node.lineno, f"{node.module}.{name.name}") for name in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            literal = isinstance(node.args[0], ast.Constant | ast.JoinedStr)  # else a catalogue loads its own folder
            yield from [(node.lineno, ast.unparse(node.args[0]).strip("'\"f"))] if literal else []


def room_of(module: str) -> str:
    """The room, or the ground's module, of a dotted name; "" for bayesid itself."""
    return module.split(".")[1] if "." in module else ""


def height(room: str) -> int:
    """Floors of the plan: the ground is 0."""
    return 0 if room in GROUND else 1 + ROOMS.index(room)


def test_every_entry_is_in_the_plan():
    entries = {path.stem for path in (ROOT / "bayesid").iterdir() if path.suffix in ("", ".py")} - {"__pycache__"}
    assert entries == {"__init__", *GROUND, *ROOMS}
    assert len(entries - {"__init__"}) <= 20


@pytest.mark.parametrize("path", [path for path in FILES if room_of(module_of(path))], ids=module_of)
def test_no_room_imports_from_above(path):
    here = room_of(module_of(path))
    for line, name in imports_of(path):
        if name.split(".")[0] != "bayesid" or name.startswith("bayesid.studies"):
            continue
        there = room_of(name)
        assert there in (*GROUND, *ROOMS), f"{path}:{line} imports {name}: only a room's own module, not bayesid's face"
        above = height(there) > height(here)
        assert not above, f"{path.relative_to(ROOT)}:{line} ({here}) imports {name} ({there}), which stands above it"


def test_studies_are_known_to_the_command_line_alone():
    for path in FILES:
        if any(name.startswith("bayesid.studies") for _, name in imports_of(path)):
            assert room_of(module_of(path)) == "cli", path


def test_no_file_imports_itself_in_a_circle():
    modules = {module_of(path): path for path in FILES if path.name != "__init__.py" or path.parent.name != "bayesid"}
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        named = {name if name in modules else name.rpartition(".")[0] for _, name in imports_of(path)}
        graph[module] = (named & set(modules)) - {module}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


@pytest.mark.parametrize("path", FILES, ids=module_of)
def test_third_party_packages_stay_in_their_rooms(path):
    room = room_of(module_of(path))
    for line, name in imports_of(path):
        package = name.split(".")[0]
        if package in sys.stdlib_module_names or package == "bayesid" or package in EVERYWHERE or name.startswith("{"):
            continue
        assert package in HOMES, f"{path}:{line} imports {package}, which has no room"
        assert room in HOMES[package], f"{path.relative_to(ROOT)}:{line} imports {package} of room {HOMES[package]}"


# ---------------------------------------------------------------------------------------------------------------
# Files
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("path", FILES, ids=module_of)
def test_text_is_utf_8_whatever_the_locale(path):
    """Whatever opens, reads or writes text says in which encoding."""
    for node in ast.walk(tree_of(path)):
        if not isinstance(node, ast.Call):
            continue
        owner, _, name = ast.unparse(node.func).rpartition(".")
        binary = any(isinstance(one, ast.Constant) and "b" in str(one.value) for one in node.args[:2])
        if owner != "os" and ((owner and name in ("write_text", "read_text")) or (name == "open" and not binary)):
            assert "encoding" in {keyword.arg for keyword in node.keywords}, f"{path}:{node.lineno}"


# ---------------------------------------------------------------------------------------------------------------
# Functions
# ---------------------------------------------------------------------------------------------------------------
def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Place and definition of every function and method of bayesid/."""
    for path in FILES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.FunctionDef):
                yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node


def length(node: ast.FunctionDef) -> int:
    """Lines without those of the docstring, which may have an example."""
    docstring = [] if ast.get_docstring(node) is None else node.body[:1]
    return node.end_lineno - node.lineno + 1 - sum(part.end_lineno - part.lineno + 1 for part in docstring)


def test_functions_are_short():
    lengths = {place: length(node) for place, node in functions()}
    assert not {place: lines for place, lines in lengths.items() if lines > 52}
    assert median(lengths.values()) <= 6


def test_functions_take_few_arguments():
    def count(arguments: ast.arguments) -> int:
        named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        return sum(one.arg not in ("self", "cls") for one in named)

    allowed = {"identify": 9}  # the front door: robot, log, terms, and six groups of options by their names
    counts = {place: (count(node.args), allowed.get(node.name, 8)) for place, node in functions()}
    assert not {place: found for place, (found, most) in counts.items() if found > most}


def test_nothing_escapes_the_formatter():
    mark = "fmt" + ": "
    files = [path for folder in ("bayesid", "studies", "tests") for path in (ROOT / folder).rglob("*.py")]
    assert not [str(path) for path in files if f"# {mark}" in path.read_text(encoding="utf-8")]
