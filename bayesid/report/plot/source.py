"""What figures can be drawn from."""

from __future__ import annotations

from pathlib import Path

from bayesid.identification.identification import Identification
from bayesid.report.findings import Findings, find_findings, read_findings

Source = Identification | Findings | str | Path
"""An identification, its findings, or its result folder."""


def findings_of(result: Source) -> Findings:
    """What there is to draw.

    Raises:
        InputError: a folder holds no result.
    """
    if isinstance(result, Findings):
        return result
    return find_findings(result) if isinstance(result, Identification) else read_findings(result)
