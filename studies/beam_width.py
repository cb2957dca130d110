"""How wide must the beam of T-PBPR be? Widths of 1 to 50 on logs of 8 s with 10 % noise."""

from __future__ import annotations

from bayesid.studies.sensitivity import Varied, of_field, searched, sensitivity
from bayesid.studies.simulated import Scenario

LEVELS = (1, 2, 5, 10, 20, 50)
STUDY = sensitivity(
    "beam_width",
    Varied(
        "width of the beam, w",
        of_field("beam_width", LEVELS, "w = {}"),
        base=Scenario(search="beam", noise=0.1, duration=8.0),
        extra=searched,
    ),
    trials=192,
)
