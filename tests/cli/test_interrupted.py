"""Ctrl-C and neighbours: what a run that does not come to its end, or is not alone, leaves and says."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import TWO_JOINTS

from bayesid.cli import main
from bayesid.study import batch as several_logs
from bayesid.study.batch import identify_each

pytestmark = pytest.mark.usefixtures("any_motion")


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """Robot and two logs, which no test changes."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(TWO_JOINTS)
    for seed, name in enumerate(("a.csv", "b.csv")):
        files = ("--robot", str(place / "arm.toml"), "--out", str(place / name))
        assert main(["simulate", *files, "--duration", "4", "--seed", str(seed), "--quiet"]) == 0
    return place


@pytest.fixture
def place(shop, monkeypatch):
    monkeypatch.chdir(shop)
    return shop


def left_in(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="asks Linux for a process's children")
@pytest.mark.parametrize(
    ("number", "said", "code"),
    [("SIGINT", "interrupted", 130), pytest.param("SIGTERM", "terminated", 143, marks=pytest.mark.long)],
)
def test_workers_are_gone_with_the_command(place, number, said, code):
    """One signal to the command alone, while its workers are at work or being born."""
    before = left_in(place)
    command = [sys.executable, "-m", "bayesid.cli", "identify", "a.csv", "b.csv", "--each", "--robot", "arm.toml"]
    running = subprocess.Popen(
        [*command, "--workers", "2", "--out", "each", "--quiet"],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: [signal.signal(one, signal.SIG_DFL) for one in (signal.SIGINT, signal.SIGTERM)],
    )
    workers = []
    while len(workers) < 2 and running.poll() is None:
        time.sleep(0.05)
        children = Path(f"/proc/{running.pid}/task/{running.pid}/children").read_text().split()
        workers = [child for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    running.send_signal(getattr(signal, number))
    sent = time.monotonic()
    while any(Path(f"/proc/{worker}").exists() for worker in workers) and time.monotonic() < sent + 20.0:
        time.sleep(0.01)
    assert time.monotonic() < sent + 2.0
    _, err = running.communicate(timeout=20)
    assert (running.returncode, err) == (code, f"bayesid: {said}; nothing was written\n")
    assert left_in(place) == before


def test_interrupted_between_logs(place, monkeypatch):
    """What is there is told."""
    saved = several_logs.save_identification

    def save(result, folder, **options):
        if folder.name == "b":
            raise KeyboardInterrupt
        return saved(result, folder, **options)

    monkeypatch.setattr(several_logs, "save_identification", save)
    with pytest.raises(KeyboardInterrupt, match="1 of 2 results were saved in each"):
        identify_each("arm.toml", ["a.csv", "b.csv"], "each", workers=0, report=False, posterior=False)
    assert left_in(place / "each") == ["a"]
    shutil.rmtree(place / "each")
