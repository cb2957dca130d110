"""What a command and a page say first: a verdict in one sentence, and what to do about it, the worst first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bayesid.identification.checks import Check, State
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import failed, worst
from bayesid.report.words import listed

_RESULT: Mapping[State, str] = {
    "good": "Nothing speaks against this result",
    "look": "Usable with care",
    "bad": "Do not rely on this result yet",
}
VALIDATED: Mapping[State, str] = {
    "good": "The model predicts this log",
    "look": "The model predicts this log, but not as well as its bands say",
    "bad": "Do not use the model for such motions",
}
"""What a validation alone says."""


@dataclass(frozen=True)
class Conclusion:
    """A verdict, and the most important things to do."""

    state: State  #: good, to be looked at, or bad
    sentence: str  #: that says so, in plain words
    actions: tuple[Check, ...] = ()  #: the checks that say what to do first
    others: int = 0  #: number of checks that are not good either, and are left to the report

    def in_brief(self) -> Conclusion:
        """The same where what was seen has been said before: what to do, without it."""
        return replace(self, actions=tuple(replace(one, message="") for one in self.actions if one.remedy), others=0)


def conclude(checks: Sequence[Check], says: Mapping[State, str] = _RESULT, of: str = "checks") -> Conclusion:
    """The verdict of checks, with as many things to do as are worth reading at once.

    Where something is bad, what is merely to be looked at can wait. What was not done speaks neither for nor against.
    """
    reasons, state = failed(checks), worst(checks)
    of_state = [one for one in reasons if one.state == state]
    not_done = [one for one in reasons if one.state == "not done"]
    said = says[state]
    if of_state and len(checks) > 1:
        which = ("fails", "fail") if state == "bad" else ("needs a look", "need a look")
        names = listed([one.name for one in of_state])
        said += f": {len(of_state)} of {len(checks)} {of} {which[len(of_state) > 1]} ({names})"
    elif not_done:
        said += f"; not checked: {listed([one.name for one in not_done])}"
    shown = first(of_state if state == "bad" else [*of_state, *not_done])
    left = len({one.remedy or one.message for one in reasons}) - len(shown) if of == "checks" else 0
    return Conclusion(state, sentence(state, said), shown, left)


def first(reasons: Sequence[Check]) -> tuple[Check, ...]:
    """The first ones of which each says something else to do."""
    by_remedy: dict[str, Check] = {}
    for one in reasons:
        by_remedy.setdefault(one.remedy or one.message, one)
    return tuple(by_remedy.values())[: TUNING.actions]


def sentence(state: State, said: str) -> str:
    """The sentence of a verdict: terminal and page have the same."""
    return f"Verdict: {state}. {said}."
