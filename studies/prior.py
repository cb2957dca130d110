"""What does the prior decide? Its standard deviations from a quarter to four times as wide, and values from a drawing.

`drawing 10 %`: all link parameters are given beforehand, each off by 10 % of itself (one standard deviation) and known
to be. With the posterior, so intervals are its quantiles. Logs of 8 s with 10 % noise, where the prior has a say.
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
