"""What a terminal shows, and what a pipe gets instead."""

import os
import pty
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

LONG = "word " * 60 + "end"
MESSAGES = (
    f"from bayesid.cli import terminal as t; t.show('[bold] {LONG}'); t.warn('w {LONG}'); t.complain('c [1] {LONG}')"
)
BARS = """
import sys, time
from bayesid.cli.progress import CountBar, StageBars
with StageBars({quiet}) as bars:
    bars.show("short", 0, 1)
    bars.show("long", 0, 7)
    time.sleep(1.1)
    bars.show("long", 3, 7)
    time.sleep(0.6)
with CountBar("logs", {quiet}) as bar:
    bar.show(2, 9, 0)
    time.sleep(0.7)
    bar.show(3, 9, 1)
    time.sleep(1.2)
print("done")
"""


def in_pipe(script, **environment):
    """What a program writes to stdout and stderr that are no terminal."""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env={**os.environ, **environment}
    )
    return done.stdout, done.stderr


def on_terminal(script, **environment):
    """What a program writes to a terminal of 60 columns."""
    ours, theirs = pty.openpty()
    variables = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "60", "LINES": "20", **environment}
    variables = {name: value for name, value in variables.items() if value is not None}
    with subprocess.Popen([sys.executable, "-c", script], stdout=theirs, stderr=theirs, env=variables) as program:
        os.close(theirs)
        written = b""
        try:
            while chunk := os.read(ours, 65536):
                written += chunk
        except OSError:  # Linux: the other end is closed
            pass
        os.close(ours)
    assert program.returncode == 0, written.decode()
    return written.decode()


def test_a_pipe_gets_whole_lines_without_colours():
    out, err = in_pipe(MESSAGES, COLUMNS="40")
    assert out == f"[bold] {LONG}\n"
    assert err == f"warning: w {LONG}\nbayesid: c [1] {LONG}\n"


def test_a_terminal_gets_colours_and_whole_lines():
    """The terminal itself folds what is too long, so that it can be copied as one line."""
    written = on_terminal(MESSAGES, NO_COLOR=None)
    assert written.count("\n") == 3
    assert re.search("\x1b\\[[0-9;]*33m.*warning:", written)
    assert re.search("\x1b\\[[0-9;]*31m.*bayesid:", written)


def test_bars_of_what_takes_long_where_somebody_watches():
    """A terminal, one that is to be quiet, and a pipe; they sleep at the same time."""
    shown, quiet = BARS.format(quiet=False), BARS.format(quiet=True)
    with ThreadPoolExecutor() as together:
        written = [together.submit(*what) for what in ((on_terminal, shown), (on_terminal, quiet), (in_pipe, shown))]
    terminal, silent, piped = (one.result() for one in written)
    assert all(word in terminal for word in ("long", "0/7", "3/7", "3/9", "1 failed"))
    assert "short" not in terminal
    assert terminal.rstrip().endswith("done")
    assert "/7" not in silent
    assert piped == ("done\n", "")
