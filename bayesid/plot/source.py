"""What figures can be drawn from."""

from __future__ import annotations

from pathlib import Path

from bayesid.findings import Findings, find, read_findings
from bayesid.identification import Identification

Source = Identification | Findings | str | Path
"""An identification, its findings, or its result folder."""


def findings_of(result: Source) -> Findings:
    """What there is to draw.

    Raises:
        InputError: a folder holds no result.
    """
    if isinstance(result, Findings):
        return result
    return find(result) if isinstance(result, Identification) else read_findings(result)
