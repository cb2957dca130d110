"""What the figures and the report of an identification show: computed once, kept in the result folder, drawn anywhere.

Plotting code computes nothing: all that it draws stands here, from an identification (`find`) or from a result folder
(`read_findings`), which gives the same.
"""

from bayesid.findings.collect import find
from bayesid.findings.content import (
    AMBIGUOUS,
    Alternatives,
    Bar,
    CoefficientTable,
    Correlation,
    Findings,
    Prediction,
    Samples,
    SegmentTable,
)
from bayesid.findings.store import FILE, read_findings, write_findings

__all__ = [
    "AMBIGUOUS", "FILE", "Alternatives", "Bar", "CoefficientTable", "Correlation", "Findings", "Prediction", "Samples",
    "SegmentTable", "find", "read_findings", "write_findings",
]  # fmt: skip
