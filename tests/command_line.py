"""Commands run in this process, and what a refused one must be."""

import resource
from contextlib import contextmanager
from pathlib import Path

from bayesid import cli

ARM = """
name = "arm"
convention = "modified"
joints = [
  {a = 0.0, alpha = 0.0, d = 0.3, theta = 0.0},
  {a = 0.15, alpha = -1.2, d = 0.1, theta = 0.3},
  {a = 0.4, alpha = 0.5, d = 0.2, theta = -0.4},
]
"""
TWO_JOINTS = """convention = "standard"
name = "arm"
joints = [
  {a = 0.0, alpha = 1.5707963267948966, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.0, theta = 0.0},
]
"""
QUICK = "--quiet", "--no-posterior", "--no-report"


def run(*arguments):
    """Exit code of `bayesid ARGUMENTS`."""
    try:
        return cli.main([str(argument) for argument in arguments])
    except SystemExit as end:
        return end.code


def unfolded(text):
    """A text whose lines were folded, in one."""
    return " ".join(text.split())


def identify(log="log.csv", robot="arm.toml", out="out"):
    return "identify", log, "--robot", robot, "--out", out


def everything(folder):
    """All that is in a folder, to the byte."""
    return {path.relative_to(folder): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def assert_refused(capture, arguments, says, place=None):
    """Code 2, one line with what is wrong and what helps, nothing printed, and nothing written to a folder."""
    place = place or Path.cwd()
    capture.readouterr()
    before = everything(place)
    assert run(*arguments) == 2
    out, err = capture.readouterr()
    err = "".join(line for line in err.splitlines(keepends=True) if not line.startswith("warning: "))
    assert out == ""
    assert err.endswith("\n")
    assert err.count("\n") == 1, err
    assert err.startswith("bayesid")
    assert "Traceback" not in err
    assert err.partition("; ")[2].strip(), err
    for word in says:
        assert word in err
    assert everything(place) == before


@contextmanager
def no_large_files(size):
    """A disk on which no file grows beyond a size, bytes: writing more fails in the middle of the file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
