"""How short may a log be? Exciting motions of 2 to 48 s; from 24 s the motion of 12 s repeats."""

from __future__ import annotations

from bayesid.studies.sensitivity import Varied, of_field, sensitivity

LEVELS = (2.0, 3.0, 5.0, 8.0, 12.0, 24.0, 48.0)
STUDY = sensitivity("duration", Varied("length of the log, s", of_field("duration", LEVELS, "{:g} s")), trials=196)
