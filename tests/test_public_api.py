"""The promised names of `import bayesid`: all are there, typed, and break with no release before them."""

import ast
import importlib
import shutil
import subprocess
from pathlib import Path

import pytest

import bayesid

ROOT = Path(__file__).parents[1]


def stub_names(stub):
    """Name to module, of __init__.pyi or types.pyi."""
    tree = ast.parse((ROOT / "bayesid" / stub).read_text(encoding="utf-8"))
    imports = (node for node in tree.body if isinstance(node, ast.ImportFrom))
    return {alias.asname: f"bayesid.{node.module or ''}".rstrip(".") for node in imports for alias in node.names}


def breakages(ref):
    """What of the promised names and their signatures a git reference had, and is not as it was: a line each."""
    griffe = pytest.importorskip("griffe", reason="griffe is not installed: pip install 'bayesid[test]'")
    before = griffe.load_git("bayesid", ref=ref, repo=ROOT, resolve_aliases=True)
    now = griffe.load("bayesid", search_paths=[ROOT], resolve_aliases=True)
    exported = {name: one for name, one in before.members.items() if one.is_alias}
    promised = tuple(one.final_target.path for one in exported.values())
    gone = [f"bayesid.{name}: removed" for name in exported if name not in now.members]
    changed = [one for one in griffe.find_breaking_changes(before, now) if promises(one, promised)]
    return gone + sorted({one.explain(griffe.ExplanationStyle.ONE_LINE) for one in changed})


def promises(breakage, promised):
    """Whether it is of a promised name or a public part of it; a name may move to another module."""
    path, kind = breakage.obj.path, breakage.kind.name
    moved = kind == "OBJECT_REMOVED" and path in promised
    inside = any(path == one or path.startswith((f"{one}.", f"{one}(")) for one in promised)
    return inside and not moved and "._" not in path


def test_every_promised_name_is_there():
    assert 30 < len(bayesid.__all__) <= 36
    for module in (bayesid, bayesid.types):
        assert [name for name in module.__all__ if getattr(module, name, None) is None] == []


@pytest.mark.parametrize(("stub", "package"), [("__init__.pyi", bayesid), ("types.pyi", bayesid.types)])
def test_the_stub_and_the_package_agree(stub, package):
    names = stub_names(stub)
    assert set(names) == set(package.__all__)
    assert bayesid.__version__
    for name, home in names.items():
        module = importlib.import_module(home)
        promised = getattr(module, name, None) or importlib.import_module(f"{home}.{name}")
        assert getattr(package, name) is promised, name


def test_nothing_of_the_last_release_is_broken():
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("no git repository: there is nothing to compare with")
    tags = subprocess.run(
        ["git", "tag", "--list", "v*", "--sort=-v:refname"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    if not tags:
        pytest.skip("no release yet: there is no tag v*")
    assert breakages(tags[0]) == []
