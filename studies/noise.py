"""How much noise may the efforts have? White noise of 2 to 80 % of each joint's RMS effort."""

from __future__ import annotations

from bayesid.studies.sensitivity import Varied, of_field, sensitivity

LEVELS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
STUDY = sensitivity("noise", Varied("noise, share of RMS effort", of_field("noise", LEVELS, "{:.0%}")), trials=192)
