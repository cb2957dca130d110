"""Figures of results, as matplotlib Axes.

Each function takes a result: an identification, its `bayesid.types.ReportData` or a result folder; `excitation` takes a
design, `skeleton` a robot. It draws into the given `ax` or `axes`, or into a new Figure that `ax.figure.savefig(...)`
saves, and returns the Axes. `joints` count from 1, all by default; `count` is the largest number of coefficients; `key`
adds a legend. A folder that holds no result raises an `InputError`; wrong joints, too few Axes, or a result without
the data raise a `ValueError`.

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
    """The figures, for completion."""
    return __all__
