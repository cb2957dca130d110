"""The verdict that terminal and page share, and what it says to do first."""

import re
from dataclasses import replace
from html import unescape

import pytest
from made_findings import make_findings, with_summary

from bayesid.identification.checks import Check
from bayesid.report.conclusion import conclude
from bayesid.report.grading import unsaid
from bayesid.report.pages.identification_page import identification_page
from bayesid.report.verdicts import check_findings

GOOD, OPEN = Check("Fit", "good", "fits"), Check("Validation", "not done", "not tried", "try it")
LOOKS = [Check(f"Look {k}", "look", f"seen {k}", f"do {k}") for k in range(5)]
BADS = [Check("Proof", "bad", "off", "record more"), Check("Modes", "bad", "several", "record more")]


@pytest.mark.parametrize(
    ("checks", "state", "names"),
    [
        ([GOOD], "good", []),
        ([GOOD, OPEN], "good", ["Validation"]),
        ([GOOD, LOOKS[0], OPEN], "look", ["Look 0", "Validation"]),
        ([OPEN, *LOOKS], "look", ["Look 0", "Look 1", "Look 2"]),
        ([LOOKS[0], *BADS, OPEN], "bad", ["Proof"]),  # what two have in common is done once
    ],
)
def test_the_worst_is_said_first_and_no_more_than_is_read_at_once(checks, state, names):
    found = conclude(checks)
    assert found.state == state
    assert found.sentence.startswith(f"Verdict: {state}. ")
    assert [one.name for one in found.actions] == names


def test_reasons_that_are_not_shown_are_counted():
    assert conclude([GOOD, OPEN, *LOOKS[:2]]).others == 0
    assert conclude([GOOD, OPEN, *LOOKS]).others == 3, "two looks, and what was not done"
    assert conclude([*BADS, *(replace(one, state="bad") for one in LOOKS), OPEN]).others == 4, "one remedy is done once"


def test_a_page_says_what_the_terminal_says():
    made = make_findings(validated=True)
    for findings in (made, with_summary(made, "fit", relative_residual=[0.04, 0.3]), replace(made, prediction=None)):
        (status,) = re.findall(r'<p class="status \w+">(.*?)</p>', identification_page(findings))
        assert unescape(status) == conclude(check_findings(findings)).sentence


def test_warnings_that_a_check_tells_are_not_told_again():
    checks = [Check("Proof", "bad", "search and posterior disagree; on much"), GOOD]
    warnings = ["search and posterior disagree; record more", "joint 3 stands still; if it moved, see why"]
    assert unsaid(warnings, checks) == warnings[1:]
    assert unsaid(["seen otherwise; record more", *warnings[1:]], BADS) == warnings[1:], "nothing else to do"


def test_what_a_command_cannot_be_asked_is_no_check_of_it():
    """`bayesid demo` and `discrepancy` have no --complete."""
    made = with_summary(make_findings(validated=True), complete=None)
    for command, there in (("bayesid identify a.csv --complete off", True), ("bayesid demo", False), (None, True)):
        findings = with_summary(made, "provenance", command=command)
        found = [one for one in check_findings(findings) if one.name == "Intervals"]
        assert bool(found) == there
        assert [one.remedy for one in found if command] == [
            "leave out --complete off: `bayesid identify a.csv --force`"
        ] * (there and command is not None)
