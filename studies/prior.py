"""Does the prior change the result? Standard deviations times 0.25 to 4, and stated link parameters.

`drawing 10 %`: all link parameters are stated, with errors and standard deviations of 10 %. Intervals are quantiles of
the posterior. Logs of 8 s with 10 % noise, where the prior matters.
"""

from __future__ import annotations

from bayesid.studies.sensitivity import Level, Varied, posterior_columns, sensitivity
from bayesid.studies.simulated import Scenario

WIDTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
DRAWINGS = (0.3, 0.1)
LEVELS = [Level(f"width {width:g}", float(k), {"prior_width": width, "nominal": 0.0}) for k, width in enumerate(WIDTHS)]
LEVELS += [
    Level(f"drawing {error:.0%}", len(WIDTHS) + 0.5 + k, {"prior_width": 1.0, "nominal": error})
    for k, error in enumerate(DRAWINGS)
]
STUDY = sensitivity(
    "prior",
    Varied(
        "prior: factor on its width, or known parameters",
        LEVELS,
        log_x=False,
        base=Scenario(noise=0.1, duration=8.0, posterior=True),
        extra=posterior_columns,
    ),
    trials=112,
)
