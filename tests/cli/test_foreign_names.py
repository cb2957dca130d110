"""Names that no screen shows, or that the locale cannot: what was computed is kept, and told escaped."""

import json
import os
import subprocess
import sys

import pytest
from command_line import TWO_JOINTS

from bayesid.cli import main
from bayesid.identification.model_file import load

NAME = 'name = "arm"'
QUICK = ("--robot", "arm.toml", "--no-posterior", "--complete", "off")
ASCII = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """Robot and log."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(TWO_JOINTS.replace(NAME, 'name = "é中"'), encoding="utf-8")
    files = ("--robot", str(place / "arm.toml"), "--out", str(place / "log.csv"))
    assert main(["simulate", *files, "--duration", "4", "--quiet"]) == 0
    return place


@pytest.fixture
def place(shop, tmp_path, monkeypatch):
    """A folder of one's own with both in it."""
    for name in ("arm.toml", "log.csv"):
        (tmp_path / name).write_bytes((shop / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_result_is_kept_whatever_the_names(place):
    """One command and another one in a process of their own, with a locale that knows no such names."""
    os.rename(b"log.csv", b"l\xff\x1b[31m\n.csv")
    name = os.fsdecode(b"l\xff\x1b[31m\n.csv")
    first, second = ["identify", name, *QUICK, "--out", "result"], ["validate", "result", name]
    code = f"import sys\nfrom bayesid.cli import main\nsys.exit(main({first!r}) or main({second!r}))"
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | ASCII, capture_output=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\x1b" not in done.stdout
    assert load(place / "result").model.robot.name == "é中"
    summary = json.loads((place / "result" / "summary.json").read_text(encoding="utf-8"))
    assert summary["log"] == r"l\udcff\x1b[31m\n.csv"
    assert (place / "result" / "report.html").stat().st_size > 50_000
    assert b"95 % band: " in done.stdout


def test_what_a_file_says_reaches_the_terminal_escaped(place, capfd):
    (place / "odd.csv").write_text("t,q1,q2,tau1,tau2,\x1b]0;mine\x07\n0,1,2,3,x\x1b[2J,4\n", encoding="utf-8")
    assert main(["identify", "odd.csv", *QUICK]) == 2
    err = capfd.readouterr().err
    assert "\x1b" not in err
    assert err.count("\n") == 1
