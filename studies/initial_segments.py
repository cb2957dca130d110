"""How many segments should T-PBPR enumerate before its beam begins? 1 to 9, with a beam of width 5."""

from __future__ import annotations

from bayesid.studies.sensitivity import Varied, of_field, searched, sensitivity
from bayesid.studies.simulated import Scenario

LEVELS = (1, 2, 3, 5, 7, 9)
STUDY = sensitivity(
    "initial_segments",
    Varied(
        "segments enumerated first, s0",
        of_field("initial_segments", LEVELS, "s0 = {}"),
        base=Scenario(search="beam", noise=0.1, duration=8.0),
        extra=searched,
        log_x=False,
    ),
    trials=192,
)
