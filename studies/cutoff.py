"""Which cut-off? The motion's low-pass from 1.5 to 32 Hz, and as chosen from the data; noisy encoders.

The motion takes 6 s, so its positions hold up to 0.83 Hz; the positions' noise of 0.05 mrad makes accelerations noisy.
"""

from __future__ import annotations

from bayesid.studies.sensitivity import Level, Varied, of_field, sensitivity
from bayesid.studies.simulated import Scenario

LEVELS = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
_AUTOMATIC = 96.0
"""Where the figure shows the cut-off that the data choose."""
STUDY = sensitivity(
    "cutoff",
    Varied(
        "cut-off of the motion's low-pass, Hz",
        [*of_field("cutoff", LEVELS), Level("auto", _AUTOMATIC, {"cutoff": 0.0})],
        base=Scenario(duration=6.0, encoder=5e-5),
    ),
    trials=196,
)
