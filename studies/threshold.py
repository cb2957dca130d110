"""Which threshold? How deep a minimum of |effort| must be to cut there, and which small efforts are dropped.

The paper drops samples below a threshold and cuts where it does. bayesid keeps them and cuts at every prominent
minimum: a cut too many costs a binary unknown, a cut too few samples of the wrong sign. Both are varied here, from the
defaults (prominence 2 %, nothing dropped), with 10 % noise. In the figure the prominences stand left, the thresholds
right.
"""

from __future__ import annotations

from bayesid.studies.sensitivity import Level, Varied, sensitivity
from bayesid.studies.simulated import Scenario

PROMINENCES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.3)
_USUAL = Scenario()
LEVELS = [
    Level(f"cut {value:.1%}", float(k), {"prominence": value, "threshold": _USUAL.threshold})
    for k, value in enumerate(PROMINENCES)
] + [
    Level(f"drop {value:.0%}", len(PROMINENCES) + 0.5 + k, {"prominence": _USUAL.prominence, "threshold": value})
    for k, value in enumerate(THRESHOLDS)
]
STUDY = sensitivity(
    "threshold",
    Varied(
        "prominence that cuts, or effort under which samples are dropped", LEVELS, log_x=False, base=Scenario(noise=0.1)
    ),
    trials=220,
)
