"""docs/reference/public-api.txt: what it lists is there, is what the docs use, and breaks with no release before it."""

import ast
import importlib
import json
import re
import shutil
import subprocess
from operator import attrgetter
from pathlib import Path

import pytest

import bayesid

ROOT = Path(__file__).parents[1]
LIST = "docs/reference/public-api.txt"
LISTED = (ROOT / LIST).read_text(encoding="utf-8").split()
CLASSES = [one for p in (bayesid, bayesid.types) for name in p.__all__ if isinstance(one := getattr(p, name), type)]
OF_OTHERS = {"columns", "converged", "ddq", "lag"}
"""Attributes in the docs' code that are those of a data frame, `Posterior`, `Motion` and a distortion."""


def stub_names(stub):
    """Name to module, of __init__.pyi or types.pyi."""
    tree = ast.parse((ROOT / "bayesid" / stub).read_text(encoding="utf-8"))
    imports = (node for node in tree.body if isinstance(node, ast.ImportFrom))
    return {alias.asname: f"bayesid.{node.module or ''}".rstrip(".") for node in imports for alias in node.names}


def members_of(cls):
    """Public attributes, methods and fields of a class, whichever class they are inherited from."""
    bases = [base for base in cls.__mro__ if base.__module__.startswith("bayesid")]
    return {one for base in bases for one in (*vars(base), *vars(base).get("__annotations__", ())) if one[0] != "_"}


def python_of_docs():
    """Each piece of Python in README, docs/ and its notebooks."""
    docs = ROOT / "docs"
    for page in (ROOT / "README.md", *docs.rglob("*.md")):
        yield from re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S)
    for script in (docs / "examples").glob("*.py"):
        yield script.read_text(encoding="utf-8")
    for notebook in (docs / "notebooks").glob("*.ipynb"):
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        yield from (
            re.sub("^%.*", "", "".join(cell["source"]), flags=re.M) for cell in cells if cell["cell_type"] == "code"
        )


def git(*words):
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()


def breakages(ref):
    """A line for each name, member or argument that a git reference promised, and that is gone or has changed."""
    griffe = pytest.importorskip("griffe", reason="griffe is not installed: pip install 'bayesid[test]'")
    before = griffe.load_git("bayesid", ref=ref, repo=ROOT, resolve_aliases=True)
    now = griffe.load("bayesid", search_paths=[ROOT], resolve_aliases=True)
    promised = {name: before[name].canonical_path for name in git("show", f"{ref}:{LIST}")}
    gone = [f"bayesid.{name}: removed" for name in promised if name not in LISTED]
    changed = [
        one.explain(griffe.ExplanationStyle.ONE_LINE)
        for one in griffe.find_breaking_changes(before, now)
        if one.kind is not griffe.BreakageKind.OBJECT_REMOVED  # from its module: it may have moved to another
        if one.obj.path.partition("(")[0] in promised.values()
    ]
    return gone + sorted(set(changed))


def test_what_is_promised_is_there():
    assert len(LISTED) == len(set(LISTED)) <= 250
    names = [name for name in LISTED if name.removeprefix("types.").count(".") == 0]
    assert {*names} == {*bayesid.__all__, *(f"types.{name}" for name in bayesid.types.__all__)}
    assert len(bayesid.__all__) <= 36
    for member in sorted({*LISTED} - {*names}):
        owner, _, name = member.rpartition(".")
        assert name in members_of(attrgetter(owner)(bayesid)), member


def test_what_the_docs_use_is_promised():
    used = {
        node.attr for code in python_of_docs() for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Attribute)
    }
    assert used >= {"beta", "predict", "update", "com_in_box"}
    promised = {one.rpartition(".")[2] for one in LISTED}
    assert (used & set().union(*map(members_of, CLASSES))) - promised == OF_OTHERS


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
    tags = git("tag", "--list", "v*", "--sort=-v:refname")
    if not tags:
        pytest.skip("no release yet: there is no tag v*")
    assert breakages(tags[0]) == []
