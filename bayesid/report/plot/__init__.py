"""Figures of results, as matplotlib Axes.

Each takes a result: an identification, its findings (`bayesid.types.ReportData`) or a result folder; `excitation` a
design, `skeleton` a robot. It draws into the Axes given, `ax` where there is one and `axes` where there are several, or
into a new Figure, which `ax.figure.savefig(...)` saves; the Axes drawn into come back. `joints` count from 1, all by
default; `count` is that of coefficients, at most; `key` says whether colours and lines are named. A folder that holds
no result is an `InputError`; no such joint, too few Axes, or a result without what is to be drawn, is a `ValueError`.
Nothing is computed here.

Example:
    >>> for ax in bayesid.plot.torques(result):
    ...     limits = ax.set_xlim(2.0, 4.0)
    >>> ax.figure.savefig("torques.png")
"""

from bayesid.report.plot.identification import (
    alternatives,
    autocorrelation,
    coefficients,
    residuals,
    torques,
    validation,
)
from bayesid.report.plot.motions import excitation
from bayesid.report.plot.posterior import forest, pair, rank, trace
from bayesid.report.plot.robots import skeleton

__all__ = [
    "alternatives",
    "autocorrelation",
    "coefficients",
    "excitation",
    "forest",
    "pair",
    "rank",
    "residuals",
    "skeleton",
    "torques",
    "trace",
    "validation",
]


def __dir__() -> list[str]:
    """What completion offers: the figures, not the modules that draw them."""
    return __all__
