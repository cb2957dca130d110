"""One `save` for all results."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import Any

from bayesid.discrepancy.comparison import ChangeReport
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.errors import InputError
from bayesid.excitation.design import ExcitationDesign
from bayesid.excitation.next_motion import NextExperiment
from bayesid.identification.identification import Identification
from bayesid.identification.payload import PayloadEstimate
from bayesid.identification.prediction import Validation
from bayesid.report.folders import save_comparison, save_discrepancy, save_identification, save_validation
from bayesid.report.motions import save_design, save_next_motion
from bayesid.report.payload import save_payload


@singledispatch
def save(result: object, folder: str | Path, **options: Any) -> Path:
    """Writes the folder of a result; an earlier one there of its kind is replaced as a whole.

    Args:
        result: an identification, a validation, a discrepancy, a comparison of logs, a payload, or a motion that was
            designed. Predicted efforts and logs have their own method `save`.
        folder: where. What each kind holds: docs/result-folder.md.
        options: of an identification, a discrepancy and a comparison `report=False`, which skips report.html
            (`bayesid.make_report` makes it later), and `progress`. Of an identification also `with_log=True`, which
            adds log.csv, and `validation`, of another log, for the report.

    Returns:
        The folder.

    Raises:
        InputError: this is not a result, or the folder cannot be written or holds other files than an earlier result.
        KeyboardInterrupt: its text states whether the result is already written.

    Warns:
        IncompleteWarning: an export or the report could not be written; all other files are.

    Example:
        >>> folder = bayesid.save(result, "saved", report=False)
        >>> bayesid.load(folder).model.robot.name
        'arm'
        >>> sorted(path.name for path in bayesid.save(check, "validation").iterdir())
        ['prediction.csv', 'signed_log.csv', 'summary.json']
        >>> (bayesid.save(found, "found", report=False) / "discrepancy.json").is_file()
        True
        >>> sorted(path.name for path in bayesid.save(reading, "payload").iterdir())
        ['payload.json']
        >>> sorted(path.name for path in bayesid.save(design, "design").iterdir())
        ['design.json', 'excitation.svg', 'trajectory.csv']
    """
    raise InputError(f"{type(result).__name__} is not a result", field="result", remedy="give a result of bayesid")


save.register(Identification, save_identification)
save.register(Validation, save_validation)
save.register(Discrepancy, save_discrepancy)
save.register(ChangeReport, save_comparison)
save.register(PayloadEstimate, save_payload)
save.register(ExcitationDesign, save_design)
save.register(NextExperiment, save_next_motion)
