"""Figures of results, as matplotlib Axes.

Each takes an identification, its findings (`bayesid.findings`) or a result folder (`excitation` a design), and draws
into the Axes given or into a new Figure, which `axes.figure.savefig(...)` saves. Nothing is computed here, and
matplotlib is imported nowhere else in this package::

    for axes in bayesid.plot.torques(result):
        axes.set_xlim(2.0, 4.0)
    axes.figure.savefig("torques.png")
"""

from bayesid.plot.designs import excitation
from bayesid.plot.draws import forest, pair, rank, trace
from bayesid.plot.efforts import torques, validation
from bayesid.plot.estimates import coefficients
from bayesid.plot.proof import alternatives
from bayesid.plot.remainder import autocorrelation, residuals

__all__ = [
    "alternatives", "autocorrelation", "coefficients", "excitation", "forest", "pair", "rank", "residuals", "torques",
    "trace", "validation",
]  # fmt: skip
