"""Commands for remedies; unknown files and folders are placeholders in capitals."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from bayesid.identification.checks import Check
from bayesid.report.report_data import ReportData
from bayesid.report.summary import Summary
from bayesid.report.tuning import TUNING

ANOTHER_LOG = "ANOTHER_LOG.csv"
"""Placeholder of a log."""
LIMITS = "LIMITS.toml"
"""Placeholder of a file of joint limits."""


def find_discrepancy(findings: ReportData, log: str = "") -> str:
    """The command that finds what the model lacks to explain another log."""
    return f"`bayesid discrepancy {_folder(findings)} {_tried(findings, log)}`"


def payload(findings: ReportData, log: str) -> str:
    """The command that identifies the payload in another log."""
    return f"`bayesid payload {_folder(findings)} {_tried(findings, log)}`"


def _tried(findings: ReportData, log: str) -> str:
    """A log with its reading options, as it was validated; a placeholder if it is not there."""
    if not (log and Path(log).exists()):
        return ANOTHER_LOG
    tried = findings.prediction
    read_with = f" {tried.read_with}" if tried is not None and tried.source == log and tried.read_with else ""
    return shlex.quote(log) + read_with


def validate(findings: ReportData) -> str:
    """The command that validates the model on another log."""
    return f"`bayesid validate {_folder(findings)} {ANOTHER_LOG}`"


def excite(summary: Summary) -> str:
    """The command that designs a motion."""
    options = summary.provenance.options
    words, hold = ["--robot", str(options.get("robot", "ROBOT"))], options.get("hold")
    if "tip" in options:
        words += ["--tip", str(options["tip"])]
    if isinstance(hold, Mapping):
        words += ["--hold", ",".join(f"{name}={position}" for name, position in hold.items())]
    if not words[1].endswith(".urdf"):  # a URDF holds limits
        words += ["--limits", LIMITS]
    return f"`bayesid excite {shlex.join(words)}`"


def again(summary: Summary, added: str = "", without: Sequence[str] = ()) -> str:
    """The command that was run, with an option and its value added or words removed; empty if none was run.

    `--force` makes it replace the earlier result.
    """
    words = _words(summary)
    if added:
        option = added.split()[0]
        at = [k for k, word in enumerate(words) if word == option]
        given = {*at, *(k + 1 for k in at)}
        words = [word for k, word in enumerate(words) if k not in given and not word.startswith(f"{option}=")]
    for k in range(len(words) - len(without) + 1) if without else ():
        if words[k : k + len(without)] == list(without):
            words = words[:k] + words[k + len(without) :]
            break
    if without:  # the paper's search by itself does nothing else
        words = [word for word in words if word != "--paper"]
    more = [*added.split(), *(["--force"] if "--force" not in words else [])]
    return f": `{shlex.join([*words, *more])}`" if words else ""


def with_more(summary: Summary, check: Check, budget: str) -> Check:
    """The check; if its remedy is a larger budget, with the command."""
    option, given = f"--{budget}-budget", summary.provenance.options.get(f"{budget}.budget")
    if f"give more {option}" not in check.remedy or not isinstance(given, float):
        return check
    return replace(check, remedy=check.remedy + again(summary, f"{option} {TUNING.larger * given:g}"))


def program(summary: Summary) -> str:
    """Name of the command that was run; empty if none was."""
    return next(iter(_words(summary)[1:]), "")


def _words(summary: Summary) -> list[str]:
    try:
        return shlex.split(summary.provenance.command or "")
    except ValueError:
        return []


def _folder(findings: ReportData) -> str:
    return shlex.quote(findings.folder) if findings.folder else "RESULT"
