"""Do confidences fall where the model cannot be right? The logs of `calibration` with an effect that it does not hold.

docs/posterior.md says how confidences are lowered where the model's own error is large: this is what that does.
"""

from __future__ import annotations

from bayesid.studies.calibration import MISFITTING, shuffled, trial
from bayesid.studies.calibration_report import draw, report
from bayesid.studies.study import Study

STUDY = Study("misfit", 240, shuffled(MISFITTING), trial, report, draw)
