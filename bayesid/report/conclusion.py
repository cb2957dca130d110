"""The verdict of a command or a page in one sentence, and what to do, the worst check first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bayesid.identification.checks import Check, State
from bayesid.report.grading import failed, worst
from bayesid.report.tuning import TUNING
from bayesid.report.words import listed

_RESULT: Mapping[State, str] = {
    "good": "All checks passed",
    "look": "Usable with care",
    "bad": "Do not rely on this result yet",
}
VALIDATED: Mapping[State, str] = {
    "good": "The model predicts this log",
    "look": "The model predicts this log; its error or the coverage of its bands needs attention",
    "bad": "Do not use the model for such motions",
}
"""Verdicts of a validation."""


@dataclass(frozen=True)
class Conclusion:
    """A verdict, and the most important things to do."""

    state: State  #: good, to be looked at, or bad
    sentence: str  #: the verdict in words
    actions: tuple[Check, ...] = ()  #: the most important checks that are not good
    others: int = 0  #: number of other checks that are not good; the report lists them

    def in_brief(self) -> Conclusion:
        """The same with the remedies alone, for output that shows the messages already."""
        return replace(self, actions=tuple(replace(one, message="") for one in self.actions if one.remedy), others=0)


def conclude(checks: Sequence[Check], says: Mapping[State, str] = _RESULT, of: str = "checks") -> Conclusion:
    """The verdict of checks, with at most `TUNING.actions` things to do.

    If a check is bad, only bad ones are listed. Checks that were not done do not affect the verdict.

    Args:
        checks: all of them.
        says: a sentence for each state.
        of: what the checks are called in the sentence.
    """
    reasons, state = failed(checks), worst(checks)
    of_state = [one for one in reasons if one.state == state]
    not_done = [one for one in reasons if one.state == "not done"]
    said = says[state]
    if of_state and len(checks) > 1:
        which = ("fails", "fail") if state == "bad" else ("needs attention", "need attention")
        names = listed([one.name for one in of_state])
        said += f": {len(of_state)} of {len(checks)} {of} {which[len(of_state) > 1]} ({names})"
    elif not_done:
        said += f"; not checked: {listed([one.name for one in not_done])}"
    shown = first(of_state if state == "bad" else [*of_state, *not_done])
    left = len({one.remedy or one.message for one in reasons}) - len(shown) if of == "checks" else 0
    return Conclusion(state, sentence(state, said), shown, left)


def first(reasons: Sequence[Check]) -> tuple[Check, ...]:
    """The first checks with different remedies."""
    by_remedy: dict[str, Check] = {}
    for one in reasons:
        by_remedy.setdefault(one.remedy or one.message, one)
    return tuple(by_remedy.values())[: TUNING.actions]


def sentence(state: State, said: str) -> str:
    """The sentence of a verdict, alike in terminal and page."""
    return f"Verdict: {state}. {said}."
