"""How far a command has come: every stage ends, and off a terminal a line comes every ten seconds, on stderr alone."""

import io
import re
import shutil
from dataclasses import replace

import pytest
from command_line import run
from payload_cases import PAYLOAD, PayloadCase
from rich.console import Console

import bayesid
from bayesid.cli import bars
from bayesid.cli.tuning import TUNING
from bayesid.progress import Progress


class Clock:
    """Seconds that pass when told so."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result, a log of the same arm with a payload, and one without."""
    place, arm = tmp_path_factory.mktemp("made"), PayloadCase(0)
    bayesid.save(arm.result, place / "result", report=False)
    arm.later(PAYLOAD).save(place / "loaded.csv")
    arm.later().save(place / "log.csv")
    return place


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bars, "TUNING", replace(bars.TUNING, between_lines=0.001))


def test_a_line_comes_every_ten_seconds_and_says_what_runs(monkeypatch):
    monkeypatch.setattr(bars, "TUNING", TUNING)
    clock, lines = Clock(), []
    shown = bars.Lines("identify", lines.append, clock)
    progress = Progress(shown.show)

    def after(seconds):
        """The lines of so many seconds, in which nothing else happens."""
        lines.clear()
        for _ in range(round(seconds / 0.5)):
            clock.now += 0.5
            shown.tick()
        return list(lines)

    with progress.stage("read"):
        assert after(9.5) == []
        assert after(0.5) == ["identify: read, 10 s"]
    with progress.under("joint 2").stage("search, round 2 of at most 4"):
        assert after(20.0) == [f"identify: joint 2: search, round 2 of at most 4, {at} s" for at in (20, 30)]
    with progress.stage("posterior") as steps:
        steps(3, 8)
        assert after(10.0) == ["identify: posterior, 3 of 8, 40 s"]
        steps(8, 8)
    assert after(10.0) == ["identify: posterior, done, 50 s"]
    clock.now += 35.0  # one call that took long, in which no other thread ran
    shown.tick()
    assert lines[1:] == ["identify: posterior, done, 85 s"]
    assert after(5.0) == ["identify: posterior, done, 90 s"]


def test_a_stage_is_begun_and_ended_once_whatever_its_steps():
    told = []
    progress = Progress(lambda *call: told.append(call))
    for steps_told in ([], [(1, 4), (2, 4)], [(0, 3), (3, 3), (1, 2)]):
        with progress.stage("one") as steps:
            for one in steps_told:
                steps(*one)
        assert (told[0], told[-1]) == (("one", 0, 1), ("one", told[-1][2], told[-1][2]))
        assert sum(done == total for _, done, total in told) == 1
        told.clear()
    with pytest.raises(ValueError, match="no log"), progress.stage("read"):
        raise ValueError("no log")
    assert told == [("read", 0, 1)]


COMMANDS = {
    "identify": ("log.csv", "--robot", "result/robot.urdf", "--posterior-budget", 1, "--out", "out"),
    "validate": ("result", "log.csv", "--out", "out"),
    "predict": ("result", "log.csv", "--out", "out.csv"),
    "payload": ("result", "loaded.csv", "--out", "out", "--posterior-budget", 0),
    "discrepancy": ("result", "loaded.csv", "--no-posterior", "--out", "out"),
    "track": ("result", "log.csv", "--explain", "--out", "out"),
    "report": ("result",),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_stage_of_a_command_ends_and_is_told_on_stderr_alone(place, command, capfd, monkeypatch):
    calls = []
    show = bars.Lines.show
    monkeypatch.setattr(bars.Lines, "show", lambda self, *call: (calls.append(call), show(self, *call)))
    assert run(command, *COMMANDS[command]) == 0
    open_stages = []
    for stage, done, total in calls:
        if (done, total) == (0, 1):
            open_stages.append(stage)
        elif done == total:
            assert open_stages.pop() == stage
        else:
            assert open_stages[-1] == stage
    assert open_stages == []
    assert calls
    out, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert lines
    assert all(re.fullmatch(rf"{command}: .+, \d+ s", line) for line in lines)
    assert not re.search(r", \d+ s$", out, re.MULTILINE)


def test_nothing_is_told_where_nobody_wants_it(place, capfd):
    assert run("validate", "result", "log.csv", "--quiet") == 0
    assert capfd.readouterr() == ("", "")


def test_on_a_terminal_a_bar_is_seen_at_its_end(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(bars, "console", lambda stderr: Console(file=screen, force_terminal=True, width=100))
    monkeypatch.setattr(bars, "TUNING", replace(bars.TUNING, patience=-1.0))
    monkeypatch.setattr(bars.sys.stderr, "isatty", lambda: True, raising=False)
    options = type("Options", (), {"quiet": False, "command": "identify"})
    with bars.stages(options) as progress:
        for name in ("search", "posterior"):
            with progress.stage(name) as steps:
                steps(2, 5)
    seen = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue())
    assert re.search("search.*done", seen)
    assert re.search("posterior.*done", seen)
