"""Do confidences fall where the model is wrong? Logs of `calibration` with an effect outside of the model.

docs/posterior.md explains how a large model error lowers confidences.
"""

from __future__ import annotations

from bayesid.studies.calibration import MISFITTING, shuffled, trial
from bayesid.studies.calibration_report import draw, report
from bayesid.studies.study import Study

STUDY = Study("misfit", 240, shuffled(MISFITTING), trial, report, draw)
