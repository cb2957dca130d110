"""What the figures and the report of an identification show: computed once, kept in the result folder, drawn anywhere.

Plotting code computes nothing: all that it draws stands here, from an identification (`find_findings`) or from a result
folder (`read_findings`), which gives the same.
"""

from bayesid.report.findings.collect import coefficient_table, find_findings
from bayesid.report.findings.content import (
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
from bayesid.report.findings.recorded import recorded_segments
from bayesid.report.findings.store import FILE, read_findings, write_findings
from bayesid.report.findings.summary import Summary, as_json, from_json, log_parts, summarise

__all__ = [
    "AMBIGUOUS",
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
    "coefficient_table",
    "find_findings",
    "from_json",
    "log_parts",
    "read_findings",
    "recorded_segments",
    "summarise",
    "write_findings",
]
