"""The verdict of a command or a page in one sentence, and remedies, that of the worst check first."""

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
    "look": "The model predicts this log; its errors or its bands differ from the expected ones",
    "bad": "Do not use the model for such motions",
}
"""Verdicts of a validation."""
EXPLAINED: Mapping[str, tuple[State, str]] = {
    "explained": ("good", "The missing effects were found"),
    "partly_explained": ("look", "Missing effects were found; part of the residual is unexplained"),
    "unexplained": ("bad", "The residual is above the noise floor, and no tested effect explains it"),
}
"""Verdicts of a discrepancy in which an effect is missing, by its status."""


@dataclass(frozen=True)
class Conclusion:
    """A verdict, and its most important remedies."""

    state: State  #: good, look or bad
    sentence: str  #: the verdict in words
    actions: tuple[Check, ...] = ()  #: the most important checks that are not good
    others: int = 0  #: number of other checks that are not good; the report lists them

    def in_brief(self) -> Conclusion:
        """The same with the remedies alone, for output that shows the messages already."""
        return replace(
            self, actions=tuple(replace(check, message="") for check in self.actions if check.remedy), others=0
        )


def conclude(checks: Sequence[Check], sentences: Mapping[State, str] = _RESULT, of: str = "checks") -> Conclusion:
    """The verdict of checks, with at most `TUNING.actions` remedies.

    If a check is bad, only bad ones are listed. Checks that were not done do not affect the verdict.

    Args:
        checks: all of them.
        sentences: a sentence for each state.
        of: what the checks are called in the sentence.
    """
    reasons, state = failed(checks), worst(checks)
    of_state = [check for check in reasons if check.state == state]
    not_done = [check for check in reasons if check.state == "not done"]
    words = sentences[state]
    if of_state and len(checks) > 1:
        which = ("fails", "fail") if state == "bad" else ("needs attention", "need attention")
        names = listed([check.name for check in of_state])
        words += f": {len(of_state)} of {len(checks)} {of} {which[len(of_state) > 1]} ({names})"
    elif not_done:
        words += f"; not checked: {listed([check.name for check in not_done])}"
    shown = first(of_state if state == "bad" else [*of_state, *not_done])
    others = len({check.remedy or check.message for check in reasons}) - len(shown) if of == "checks" else 0
    return Conclusion(state, sentence(state, words), shown, others)


def first(reasons: Sequence[Check]) -> tuple[Check, ...]:
    """The first checks with different remedies."""
    by_remedy: dict[str, Check] = {}
    for check in reasons:
        by_remedy.setdefault(check.remedy or check.message, check)
    return tuple(by_remedy.values())[: TUNING.actions]


def sentence(state: State, words: str) -> str:
    """The sentence of a verdict, alike in terminal and page."""
    return f"Verdict: {state}. {words}."
