"""Figures of results, as matplotlib Axes.

Each takes an identification, its findings (`bayesid.report.findings`) or a result folder (`excitation` a design,
`skeleton` a robot), and draws into the Axes given or into a new Figure, which `axes.figure.savefig(...)` saves. Nothing
is computed here::

    for axes in bayesid.plot.torques(result):
        axes.set_xlim(2.0, 4.0)
    axes.figure.savefig("torques.png")
"""

from bayesid.report.plot.designs import excitation
from bayesid.report.plot.draws import forest, pair, rank, trace
from bayesid.report.plot.efforts import torques, validation
from bayesid.report.plot.estimates import coefficients
from bayesid.report.plot.proof import alternatives
from bayesid.report.plot.remainder import autocorrelation, residuals
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
