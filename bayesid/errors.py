"""The exceptions of bayesid.

Bad input raises `InputError`, which carries one line a user can act on; the command line turns it into exit code 2.
A numerical stage without a solution raises `SolverError`, which carries the solver's status.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches


def printable(text: str) -> str:
    r"""Text with control characters and invalid UTF-8 bytes escaped.

    Apply it once to each name from outside that is shown or written.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def near_names(name: str, known: Iterable[str]) -> str:
    """A hint "did you mean ...?" with the known names nearest to an unknown one; empty if none is near."""
    near = get_close_matches(name, list(dict.fromkeys(known)), n=3, cutoff=0.5)  # half the letters of both are shared
    likeness = [SequenceMatcher(None, candidate, name).ratio() for candidate in near]
    meant = [candidate for candidate, share in zip(near, likeness, strict=True) if share == likeness[0]]
    return f"did you mean {' or '.join(meant)}?" if meant else ""


class BayesidError(Exception):
    """Base of every exception that bayesid raises on purpose."""


class InputError(BayesidError, ValueError):
    """The user's input cannot be used.

    Arguments are in backticks, as `cutoff` or `Sampling.budget`; the command line replaces them by its options.

    Args:
        what: what is wrong, in a few words.
        where: file and row, column or key.
        remedy: what the user can do about it.
        field: name of the invalid argument, if any.

    Example:
        >>> error = bayesid.InputError("3 joints, but 2 gains", "log.csv", "give one per joint", field="gains")
        >>> error.field, str(error)
        ('gains', '`gains` log.csv: 3 joints, but 2 gains; give one per joint')
    """

    def __init__(self, what: str, where: str = "", remedy: str = "", field: str = "") -> None:
        self.what, self.where, self.remedy, self.field = what, where, remedy, field
        super().__init__(what, where, remedy, field)

    def __str__(self) -> str:
        place = " ".join(filter(None, (f"`{self.field}`" if self.field else "", self.where)))
        return printable(f"{place}: {self.what}; {self.remedy}")


def missing(library: str, extra: str, where: str) -> InputError:
    """The error for a missing library, which an extra of bayesid installs."""
    return InputError(f"needs {library}, which is not installed", where, f"pip install 'bayesid[{extra}]'")


class SolverError(BayesidError, RuntimeError):
    """An optimisation ended without a solution: its stage, and the solver's status."""

    def __init__(self, stage: str, status: str) -> None:
        self.stage, self.status = stage, status
        super().__init__(f"{stage}: the solver ended with status {status!r}, which is not a solution")
