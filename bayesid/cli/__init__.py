"""The command line: every command is a thin layer over the Python interface.

Exit codes: 0 done, 2 bad input (one line on stderr), 1 a fault of ours.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from bayesid.cli.messages import complain
from bayesid.cli.parser import STUDIES, make_parser
from bayesid.errors import BayesidError, InputError

__all__ = ["STUDIES", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    options = make_parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], None] = options.command
    try:
        command(options)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nor shall Python complain when it ends
        return 141
    except InputError as error:
        complain(str(error))
        return 2
    except (OSError, BayesidError) as error:
        complain(str(error))
        return 1
    except KeyboardInterrupt as stop:
        complain(f"interrupted; {stop or 'nothing was written'}")
        return 130
    return 0
