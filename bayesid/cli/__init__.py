"""The command line: every command is a thin layer over the Python interface.

Exit codes: 0 done, 2 bad input (one line on stderr), 1 a fault of ours, 3 a bad verdict with --strict, 130
interrupted, 143 terminated, 141 nobody reads on. Nothing that computes is imported before the arguments are understood.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module

from bayesid.errors import BayesidError, InputError

__all__ = ["RedVerdictError", "UsageError", "main"]

_MODULES = dict.fromkeys(("validate", "predict", "report", "payload"), "results") | {
    "completion": "arguments",
    "simulate": "demo",
    "study": "demo",
}
"""The module of each command whose module has another name."""


_ENDS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class UsageError(Exception):
    """The words of a command cannot be understood: its name, and why not."""


class RedVerdictError(Exception):
    """The command has done its work, its verdict is bad, and --strict makes that an exit code."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    with _terminated_as_interrupted() as terminated:
        return _run(arguments, terminated)


@contextmanager
def _terminated_as_interrupted() -> Iterator[list[int]]:
    """SIGTERM, and SIGHUP of a terminal that closes, end a command as Ctrl-C does; the list says which came first."""
    came: list[int] = []

    def interrupt(number: int, _: object) -> None:
        if not came:
            came.append(number)
            raise KeyboardInterrupt

    alone = threading.current_thread() is threading.main_thread()
    ours = [one for one in _ENDS if alone and signal.getsignal(one) == signal.SIG_DFL]  # nohup ignores SIGHUP
    for one in ours:
        signal.signal(one, interrupt)
    try:
        yield came
    finally:
        for one in ours:
            signal.signal(one, signal.SIG_DFL)


def _run(arguments: Sequence[str] | None, terminated: Sequence[int]) -> int:
    """The command, and what it raises as a line and a code; `terminated` is filled by SIGTERM."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # an ASCII terminal gets the rest escaped
            stream.reconfigure(errors="backslashreplace")
    try:
        from bayesid.cli.arguments import parse  # nor here: Ctrl-C while modules load is an interruption like any other

        options = parse(sys.argv[1:] if arguments is None else arguments)
        _tell_config(options)
        module = import_module(f"bayesid.cli.{_MODULES.get(options.command, options.command)}")
        getattr(module, f"{options.command}_command")(options)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nor shall Python complain when it ends
        return 141
    except UsageError as error:
        name, message = error.args
        return _complain(message, 2, name)
    except RedVerdictError as verdict:
        return _complain(f"{verdict} (--strict)", 3)
    except InputError as error:
        return _complain(str(error), 2)
    except (OSError, BayesidError) as error:
        return _complain(str(error), 1)
    except KeyboardInterrupt as stop:
        said, code = ("terminated", 128 + terminated[0]) if terminated else ("interrupted", 130)
        return _complain(f"{said}; {str(stop) or 'nothing was written'}", code)
    return 0


def _tell_config(options: Namespace) -> None:
    """Options that were not typed are never used in silence."""
    if options.configured is not None:
        from bayesid.cli.terminal import note, warn

        if not options.quiet:
            note(options.configured.said)
        if options.configured.contradiction:
            warn(options.configured.contradiction)


def _complain(message: str, code: int, name: str = "bayesid") -> int:
    from bayesid.cli.terminal import complain

    complain(message, name)
    return code
