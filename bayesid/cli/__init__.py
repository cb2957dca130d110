"""The command line: every command is a thin layer over the Python interface.

Exit codes: 0 done, 1 failed, 2 bad input (one line on stderr), 3 bad verdict with --strict, 130 interrupted, 141 broken
pipe, 143 terminated. Arguments are parsed before any numerical module is imported.
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
    """A command line that cannot be parsed: name of the command, and the reason."""


class RedVerdictError(Exception):
    """The command is done, its verdict is bad, and --strict was given."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    with _terminated_as_interrupted() as terminated:
        return _run(arguments, terminated)


@contextmanager
def _terminated_as_interrupted() -> Iterator[list[int]]:
    """SIGTERM and SIGHUP end a command like Ctrl-C; the list holds the first signal."""
    came: list[int] = []

    def interrupt(number: int, _: object) -> None:
        if not came:
            came.append(number)
            raise KeyboardInterrupt

    alone = threading.current_thread() is threading.main_thread()
    ours = [number for number in _ENDS if alone and signal.getsignal(number) == signal.SIG_DFL]  # nohup ignores SIGHUP
    for number in ours:
        signal.signal(number, interrupt)
    try:
        yield came
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def _run(arguments: Sequence[str] | None, terminated: Sequence[int]) -> int:
    """Runs the command; an exception becomes a line and an exit code; `terminated` is filled by SIGTERM."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # other characters are escaped on an ASCII terminal
            stream.reconfigure(errors="backslashreplace")
    try:
        from bayesid.cli.arguments import parse  # here, so that Ctrl-C works while modules load

        options = parse(sys.argv[1:] if arguments is None else arguments)
        _print_config(options)
        module = import_module(f"bayesid.cli.{_MODULES.get(options.command, options.command)}")
        getattr(module, f"{options.command}_command")(options)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # so that Python does not complain at exit
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
        reason, code = ("terminated", 128 + terminated[0]) if terminated else ("interrupted", 130)
        return _complain(f"{reason}; {str(stop) or 'nothing was written'}", code)
    return 0


def _print_config(options: Namespace) -> None:
    if options.configured is not None:
        from bayesid.cli.terminal import note, warn

        if not options.quiet:
            note(options.configured.summary)
        if options.configured.contradiction:
            warn(options.configured.contradiction)


def _complain(message: str, code: int, name: str = "bayesid") -> int:
    from bayesid.cli.terminal import complain

    complain(message, name)
    return code
