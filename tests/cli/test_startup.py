"""What `import bayesid` and a command cost before they do anything, and the promised names."""

import ast
import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import bayesid

ROOT = Path(bayesid.__file__).parent
HEAVY = {"arviz", "cvxpy", "emcee", "matplotlib", "numpy", "pinocchio", "pyarrow", "scipy", "xarray", "rich", "tqdm"}
BUDGET = 0.3
"""s of CPU, as promised; measured 0.06 for the import and 0.14 for `--version` on a busy machine of two cores."""
STARTS = {
    "import": "import bayesid",
    "version": "from bayesid.cli import main\ntry: main(['--version'])\nexcept SystemExit: pass",
    "help": "from bayesid.cli import main\ntry: main(['identify', '--help'])\nexcept SystemExit: pass",
}


def cpu_time(script):
    """Seconds of CPU that a program takes, by the system's account of it."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize("script", STARTS.values(), ids=STARTS)
def test_nothing_heavy_is_imported_at_the_start(script):
    listing = f"{script}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", listing], capture_output=True, text=True, check=True)
    modules = {name.partition(".")[0] for name in json.loads(done.stdout.splitlines()[-1])}
    assert not modules & HEAVY


@pytest.mark.parametrize("script", [STARTS["import"], STARTS["version"]])
def test_the_start_takes_little_time(script):
    """The best of three: other programs steal caches, not CPU time."""
    assert min(cpu_time(script) for _ in range(3)) <= BUDGET


def test_every_promised_name_is_there():
    for name in bayesid.__all__:
        assert getattr(bayesid, name) is not None, name
    assert callable(bayesid.plot.torques)
    assert set(dir(bayesid.plot)) == set(bayesid.plot.__all__)
    assert set(bayesid.__all__) <= set(dir(bayesid))
    with pytest.raises(AttributeError):
        bayesid.nonsense  # noqa: B018


def test_editors_see_the_same_names():
    """A stub names each once, as itself, which is what a type checker takes for an export."""
    tree = ast.parse(Path(bayesid.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    aliases = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.asname == alias.name for alias in aliases)
    assert sorted(alias.name for alias in aliases) == sorted(bayesid.__all__)


@pytest.mark.parametrize("command", ["identify", "report"])
def test_commands_load_what_they_need(command):
    """Of SciPy no part that takes long before it is called; nothing that only figures in Python, or ArviZ, need."""
    listing = f"import bayesid.cli.commands.{command}, bayesid.report.pages.identification_page, json, sys\n"
    listing += "import bayesid.posterior.kept\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", listing], capture_output=True, text=True, check=True)
    unneeded = {"arviz", "dask", "matplotlib", "pandas", "xarray", "bayesid.discrepancy"}
    parts = {f"scipy.{part}" for part in ("interpolate", "optimize", "signal", "spatial", "stats")}
    assert not (unneeded | parts) & set(json.loads(done.stdout))
