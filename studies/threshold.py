"""Prominence and threshold: how deep a minimum of |effort| ends a segment, and which small efforts are dropped.

The paper drops samples below a threshold and ends segments there. bayesid keeps them and ends segments at every
prominent minimum: an extra cut adds a binary unknown, a missing cut leaves samples with the wrong sign. Both are varied
from the defaults (prominence 2 %, nothing dropped), with 10 % noise. The figure shows prominences left, thresholds
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
        "least prominence of a cut, or effort below which samples are dropped",
        LEVELS,
        log_x=False,
        base=Scenario(noise=0.1),
    ),
    trials=220,
)
