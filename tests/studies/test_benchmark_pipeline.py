"""The benchmark of whole commands, on the shortest of its parts."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bayesid.studies.benchmarks import pipeline


@pytest.mark.long
@pytest.mark.parametrize(
    ("part", "line", "target"),
    [("many", "4 logs: one worker", "target >= 1.9 x"), ("memory", "a minute at 1 kHz", "target <= 1.5 GB +met")],
)
def test_a_part_prints_its_line_and_its_target(capsys, tmp_path, part, line, target):
    """Of memory the target is met in the short form too; a few logs are mostly beginnings."""
    pipeline.main(["--parts", part, "--short", "--data", str(tmp_path)])
    shown = capsys.readouterr().out
    assert line in shown
    assert re.search(target, shown)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_is_that_of_copies_too():
    """A child that holds 315 MB of its own."""
    code = "import os, time\nif os.fork() == 0: held = bytearray(os.urandom(1 << 20)) * 300\n"
    code += "print(flush=True)\ntime.sleep(30)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        for _ in range(2):
            process.stdout.readline()
        memory = pipeline._memory_of_all(process.pid)
        for child in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split():
            os.kill(int(child), signal.SIGKILL)
        process.kill()
    assert 0.3 < memory < 0.4


def test_a_command_that_fails_is_named(tmp_path):
    place = pipeline.Place(tmp_path, tmp_path, short=True)
    with pytest.raises(RuntimeError, match=r"bayesid identify missing\.csv .* ended with 2"):
        place.run("identify", "missing.csv", "--robot", "kr5")


def test_other_parts_are_refused(capsys):
    with pytest.raises(SystemExit):
        pipeline.main(["--parts", "identify,speed"])
    assert "no part speed" in capsys.readouterr().err


def test_a_log_in_parts_holds_every_row_once(tmp_path):
    place = pipeline.Place(tmp_path, tmp_path, short=True)
    rows = [f"{i},0.5\n" for i in range(place.samples + 7)]
    (tmp_path / "log.csv").write_text("t,q1\n" + "".join(rows))
    first, second = (part.read_text().splitlines(keepends=True) for part in place.parts(tmp_path / "log.csv"))
    assert first[0] == second[0] == "t,q1\n"
    assert len(first) == place.samples + 1
    assert first[1:] + second[1:] == rows
