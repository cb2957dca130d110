"""Which low-pass cut-off is best? 1.5 to 48 Hz, and the automatic choice.

The motion takes 6 s and reaches 0.83 Hz. Encoder noise of 0.05 mrad makes accelerations noisy.
"""

from __future__ import annotations

from bayesid.studies.sensitivity import Level, Varied, of_field, sensitivity
from bayesid.studies.simulated import Scenario

LEVELS = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
_AUTOMATIC = 96.0
"""Hz, where the figure shows the automatic choice."""
STUDY = sensitivity(
    "cutoff",
    Varied(
        "cut-off of the motion's low-pass, Hz",
        [*of_field("cutoff", LEVELS), Level("auto", _AUTOMATIC, {"cutoff": 0.0})],
        base=Scenario(duration=6.0, encoder=5e-5),
    ),
    trials=196,
)
