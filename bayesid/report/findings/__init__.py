"""What the figures and the report of an identification show: computed once, kept in the result folder, drawn anywhere.

Plotting code computes nothing: all that it draws stands here, from an identification (`find_findings`) or from a result
folder (`read_findings`), which gives the same.
"""

from bayesid.report.findings.collect import find_findings, log_parts, summarise
from bayesid.report.findings.content import (
    Alternatives,
    Bar,
    CoefficientTable,
    Correlation,
    Findings,
    Prediction,
    Samples,
    SegmentTable,
)
from bayesid.report.findings.store import FILE, read_findings, write_findings
from bayesid.report.findings.summary import Summary, as_json

__all__ = [
    "FILE",
    "Alternatives",
    "Bar",
    "CoefficientTable",
    "Correlation",
    "Findings",
    "Prediction",
    "Samples",
    "SegmentTable",
    "Summary",
    "as_json",
    "find_findings",
    "log_parts",
    "read_findings",
    "summarise",
    "write_findings",
]
