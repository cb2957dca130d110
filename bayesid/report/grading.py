"""Operations on checks: grades a number, sorts checks, compares them with warnings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bayesid.identification.checks import Check, State


def graded(name: str, value: float, limits: tuple[float, float], message: str, look: str = "", bad: str = "") -> Check:
    """A check of a number: good within the first limit, bad beyond the second, `look` between.

    If the first limit is the larger one, large values are good. By default a bad value has the same remedy as `look`.
    """
    good, passable = limits
    way = 1.0 if good <= passable else -1.0
    state: State = "good" if way * value <= way * good else "look" if way * value <= way * passable else "bad"
    remedy = {"good": "", "look": look, "bad": bad or look}[state]
    return Check(name, state, message, remedy, value, good)


def worst(checks: Iterable[Check]) -> State:
    """The worst state; checks that were not done are ignored."""
    states = {check.state for check in checks}
    return "bad" if "bad" in states else "look" if "look" in states else "good"


def failed(checks: Iterable[Check]) -> list[Check]:
    """Checks that are not good, the worst ones first."""
    order: tuple[State, ...] = ("bad", "look", "not done")
    return sorted((check for check in checks if check.state in order), key=lambda check: order.index(check.state))


def verdict(checks: Sequence[Check]) -> dict[str, object]:
    """For summary.json: the worst state, and the checks that are not good, the worst ones first."""
    reasons = [
        {"check": check.name, "state": check.state, "message": check.message, "remedy": check.remedy}
        for check in failed(checks)
    ]
    return {"state": worst(checks), "reasons": reasons}


def unsaid(warnings: Sequence[str], checks: Iterable[Check]) -> list[str]:
    """The warnings whose message and remedy no check contains."""

    def repeats(check: Check, warning: str) -> bool:
        seen, _, remedy = warning.partition("; ")
        return seen in check.message or (remedy != "" and remedy == check.remedy)

    return [warning for warning in warnings if not any(repeats(check, warning) for check in checks)]
