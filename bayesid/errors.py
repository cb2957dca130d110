"""The exceptions of bayesid.

Bad input raises `InputError`, which carries one line a user can act on; the command line turns it into exit code 2.
A numerical stage that ends without an answer raises `SolverError`, which carries the solver's own word for it.
"""

from __future__ import annotations


class BayesidError(Exception):
    """Base of every exception that bayesid raises on purpose."""


class InputError(BayesidError, ValueError):
    """The user's input cannot be used.

    Args:
        what: what is wrong, in a few words.
        where: file and row, column or key.
        remedy: what the user can do about it.
    """

    def __init__(self, what: str, where: str, remedy: str) -> None:
        self.what, self.where, self.remedy = what, where, remedy
        super().__init__(f"{where}: {what}; {remedy}")


class SolverError(BayesidError, RuntimeError):
    """An optimisation ended without a solution.

    Args:
        stage: which problem was being solved.
        status: the solver's own status, verbatim.
    """

    def __init__(self, stage: str, status: str) -> None:
        self.stage, self.status = stage, status
        super().__init__(f"{stage}: the solver ended with status {status!r}, which is not a solution")
