"""The next command, word for word as far as files and folders are known, else with placeholders in capitals."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from bayesid.report.findings import Findings, Summary

ANOTHER_LOG = "ANOTHER_LOG.csv"
"""Stands for a log that only the user knows."""


def find_discrepancy(findings: Findings, log: str = "") -> str:
    """What names what the model lacks to explain another log."""
    return f"`bayesid discrepancy {_folder(findings)} {_log(log)}`"


def validate(findings: Findings) -> str:
    """What tries the model on another log, in the report."""
    return f"`bayesid report {_folder(findings)} --validation {ANOTHER_LOG}`"


def excite(summary: Summary) -> str:
    """What designs a motion."""
    options = summary.provenance.options
    words, hold = ["--robot", str(options.get("robot", "ROBOT"))], options.get("hold")
    if "tip" in options:
        words += ["--tip", str(options["tip"])]
    if isinstance(hold, Mapping):
        words += ["--hold", ",".join(f"{name}={position}" for name, position in hold.items())]
    return f"`bayesid excite {shlex.join(words)}`"


def again(summary: Summary, added: str = "", without: Sequence[str] = ()) -> str:
    """The command that was run, with an option more, or without an option and its value; empty if none was run.

    Args:
        summary: of what was run.
        added: option with its value.
        without: the option and, if it has one, its value.
    """
    if not summary.provenance.command:
        return ""
    words = shlex.split(summary.provenance.command)
    for k in range(len(words) - len(without) + 1) if without else ():
        if words[k : k + len(without)] == list(without):
            words = words[:k] + words[k + len(without) :]
            break
    return f": `{shlex.join(words)}{f' {added}' if added else ''}`"


def _folder(findings: Findings) -> str:
    return shlex.quote(findings.folder) if findings.folder else "RESULT"


def _log(source: str) -> str:
    return shlex.quote(source) if source and Path(source).exists() else ANOTHER_LOG
