"""What `import bayesid` and a command cost before they do anything."""

import json
import resource
import subprocess
import sys

import pytest

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


def test_what_an_extra_installs_is_missed_by_its_own_command_alone(tmp_path):
    (tmp_path / "log.parquet").write_bytes(b"PAR1")
    script = f"""
import sys
sys.modules |= dict.fromkeys(("pyarrow", "rosbags", "shtab", "distributed", "mujoco", "cvxpy"))
import bayesid.cli.demo, bayesid.cli.discrepancy, bayesid.cli.excite, bayesid.cli.identify, bayesid.cli.results
import bayesid.cli.robot, bayesid.cli.track
from bayesid.cli import main
for words in ("completion bash", "study noise", "identify {tmp_path}/log.parquet --robot ur10e --out {tmp_path}/out"):
    assert main(words.split()) == 2
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stderr.splitlines() == [
        "bayesid: bayesid completion: needs shtab, which is not installed; pip install 'bayesid[completion]'",
        "bayesid: the rows of a study: needs pyarrow, which is not installed; pip install 'bayesid[parquet]'",
        f"bayesid: {tmp_path}/log.parquet: needs pyarrow, which is not installed; pip install 'bayesid[parquet]'",
    ]
