"""The exceptions of bayesid.

Bad input raises `InputError`, which carries one line a user can act on; the command line turns it into exit code 2.
A numerical stage that ends without an answer raises `SolverError`, which carries the solver's own word for it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher, get_close_matches

_NEAR = 0.5
"""Likeness, by `difflib`, from which on a name is suggested: half the letters of both are shared."""
PYTHON_NAMES: Mapping[str, str] = {
    "--beam-width": "Beam(width=...)",
    "--degrees": "degrees=True",
    "--effect": "effects",
    "--harmonics": "TrajectoryShape(harmonics=...)",
    "--initial-segments": "Beam(initial_segments=...)",
    "--links": "Beliefs(links=...)",
    "--log": "Log.carrying(label)",
    "--max-memory": "Preparation(max_memory=...)",
    "--mode": "Sampling(mode=...)",
    "--no-degrees": "degrees=False",
    "--no-posterior": "posterior=False",
    "--nominal": "Beliefs(nominal=...)",
    "--out": "",
    "--payload": "Log.carrying(label)",
    "--periods": "TrajectoryShape(periods=...)",
    "--posterior-budget": "Sampling(budget=...)",
    "--search-budget": "Certified(budget=...)",
    "--time-limit": "Certified(time_limit=...), Sampling(time_limit=...)",
    "--without-noise": "noise=False",
}
"""What an option of the command line is in Python, where it is no argument of the same name. Folders and files have an
argument of another name in every function, so they are not named."""
_OPTION = re.compile(r"`[^`\s]+\s[^`]*`|(?<![\w-])(--[a-z][a-z-]*)( ?)")
"""An option; or a whole command in backticks, which stays as it is."""


def in_python(text: str) -> str:
    """A sentence that speaks of options of the command line, with the arguments of the Python interface instead."""

    def argument(found: re.Match[str]) -> str:
        if found[1] is None:
            return found[0]
        name = PYTHON_NAMES.get(found[1], found[1].removeprefix("--").replace("-", "_"))
        return name + found[2] if name else ""

    return _OPTION.sub(argument, text)


def printable(text: str) -> str:
    r"""Text in which what no screen shows is escaped: control characters, and bytes of file names that are no UTF-8.

    What comes from outside and is shown or written as a name passes here once.

    Example:
        >>> printable("left\x1b[31m arm")
        'left\\x1b[31m arm'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def near_names(name: str, known: Iterable[str]) -> str:
    """The question which of the known names was meant by one that is not, the nearest; empty where none is near.

    Example:
        >>> near_names("Fc7", ["Fc1", "Fc2", "Fv1", "Ia3"])
        'did you mean Fc2 or Fc1?'
    """
    near = get_close_matches(name, list(dict.fromkeys(known)), n=3, cutoff=_NEAR)
    likeness = [SequenceMatcher(None, one, name).ratio() for one in near]
    meant = [one for one, share in zip(near, likeness, strict=True) if share == likeness[0]]
    return f"did you mean {' or '.join(meant)}?" if meant else ""


class BayesidError(Exception):
    """Base of every exception that bayesid raises on purpose.

    Example:
        >>> try:
        ...     bayesid.load_robot("ur99")
        ... except bayesid.BayesidError as error:
        ...     print(error.where, "is", error.what)
        ur99 is no such robot
    """


class InputError(BayesidError, ValueError):
    """The user's input cannot be used.

    What raises it speaks of options as the command line does, as in `--terms`; as text it has the names of Python's
    arguments, and `on_command_line` keeps the options.

    Args:
        what: what is wrong, in a few words.
        where: file and row, column or key, or the option.
        remedy: what the user can do about it.

    Example:
        >>> bayesid.InputError("no such robot", "ur99", "give ur10e").remedy
        'give ur10e'
    """

    def __init__(self, what: str, where: str, remedy: str) -> None:
        self.what, self.where, self.remedy = what, where, remedy
        super().__init__(what, where, remedy)

    def __str__(self) -> str:
        return printable(f"{in_python(self.where)}: {self.what}; {in_python(self.remedy)}")

    @property
    def on_command_line(self) -> str:
        """The line for those who gave options.

        Example:
            >>> error = bayesid.InputError("3 joints, but 2 gains", "log.csv", "correct --gains")
            >>> str(error), error.on_command_line
            ('log.csv: 3 joints, but 2 gains; correct gains', 'log.csv: 3 joints, but 2 gains; correct --gains')
        """
        return printable(f"{self.where}: {self.what}; {self.remedy}")


class SolverError(BayesidError, RuntimeError):
    """An optimisation ended without a solution.

    Args:
        stage: which problem was being solved.
        status: the solver's own status, verbatim.

    Example:
        >>> print(bayesid.SolverError("least squares in the cone", "numerical error"))
        least squares in the cone: the solver ended with status 'numerical error', which is not a solution
    """

    def __init__(self, stage: str, status: str) -> None:
        self.stage, self.status = stage, status
        super().__init__(f"{stage}: the solver ended with status {status!r}, which is not a solution")
