"""A discrepancy in five lines: missing effects, size, gap before and after, what remains, what to do."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from bayesid.discrepancy.selection import GROWN
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.catalogue import noun
from bayesid.identification.checks import Check
from bayesid.number_text import percent, quantity, rounded
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.report.discrepancy import (
    above_floor,
    above_the_floor,
    below_zero,
    data_in_words,
    effort_in_words,
    equivalents,
    main_number,
    over_the_floor,
)
from bayesid.report.tuning import TUNING
from bayesid.report.words import joints_in_words, label, listed, unit_of


def in_brief(discrepancy: Discrepancy) -> tuple[Check, ...]:
    """Missing effects, the largest one's size, the gap before and after, what remains, and what to do."""
    return (
        _missing(discrepancy),
        *_how_large(discrepancy),
        Check("Gap", "good" if discrepancy.added else "look" if discrepancy.where else "good", _gap(discrepancy)),
        _remaining(discrepancy),
        Check("Next", "good", _next(discrepancy)),
    )


def _missing(discrepancy: Discrepancy) -> Check:
    name, named = "Missing", _named_effects(discrepancy)
    if named:
        unsure = any(_is_open(added) for added in discrepancy.added)
        return Check(name, "look" if unsure else "good", "; ".join(named))
    if discrepancy.unexplained:
        return Check(name, "bad", "an effect that is not in the catalogue")
    if discrepancy.where:
        joints = joints_in_words(excess.joint for excess in discrepancy.where)
        return Check(name, "look", f"no effect; the parameters fit {joints} poorly")
    return Check(name, "good", f"nothing{above_the_floor(discrepancy)}")


def _named_effects(discrepancy: Discrepancy) -> list[str]:
    """A payload of 3.1 +- 0.3 kg; a change of load-dependent friction in joints 2 and 3; the largest first."""
    groups: dict[tuple[str, bool, bool], list[AddedEffect]] = {}
    for added in sorted(discrepancy.added, key=lambda one: 0.0 if one.size is None else -one.size.share):
        impossible = bool(below_zero(added))
        groups.setdefault((added.effect, bool(added.hypothesis.changes), impossible), []).append(added)
    named = []
    for (effect, changed, impossible), alike in groups.items():
        brief, readable = alike[0].hypothesis.source.phrase.brief, alike[0].readable
        if brief and readable and not changed:
            named.append(brief.format(**{symbol: quantity(*number) for symbol, number in readable.items()}))
            continue
        where = _where({joint for added in alike for joint in added.joints})
        how = "an effect similar to " if impossible else "a change of " if changed else ""
        named.append(f"{how}{label(effect)}{where}{_or(alike)}")
    return named


def _where(joints: Collection[int]) -> str:
    return f" in {joints_in_words(joints)}" if joints else ""


def _or(alike: Sequence[AddedEffect]) -> str:
    names = list(dict.fromkeys(name for added in alike for name in equivalents(added, label)))
    more = ", .." if len(names) > 2 else ""
    return f" (or {listed(names[:2], 'or')}{more})" if names else ""


def _is_open(added: AddedEffect) -> bool:
    """Whether the effect is not identified for certain."""
    return bool(added.probability < TUNING.sure or equivalents(added, noun) or below_zero(added))


def _how_large(discrepancy: Discrepancy) -> Iterator[Check]:
    sizes = [(added.size, added) for added in discrepancy.added if added.size is not None]
    if sizes:
        size, added = max(sizes, key=lambda one: one[0].share)
        largest = effort_in_words(discrepancy, size.largest, size.joint)
        share = f"{percent(size.share)} of its {size.of}"
        what = f"{label(added.effect)} {main_number(added, len(discrepancy.before))}".rstrip()
        yield Check("Size", "good", f"{what}: up to {largest} in joint {size.joint}, {share}")
    elif discrepancy.where:
        ratios, joints = discrepancy.before / discrepancy.floor.rms, [shown.joint for shown in discrepancy.where]
        above = {j: above_floor(discrepancy, j, float(ratios[j - 1])) for j in joints}
        joint = max(above, key=lambda j: above[j])
        if above[joint] > 0.0:
            excess = f"{effort_in_words(discrepancy, above[joint], joint)} (RMS above the noise floor) in joint {joint}"
            yield Check("Size", "look", f"{excess}, on {data_in_words(discrepancy)}")


def _remaining(discrepancy: Discrepancy) -> Check:
    """The unexplained RMS above the noise floor, and joints that got worse."""
    above, worse = [], []
    for joint, _ in discrepancy.unexplained:
        if set(discrepancy.unexplained_on[joint]) == {GROWN}:
            worse.append(joint)
        else:
            ratio, _ = over_the_floor(discrepancy, joint)
            size = above_floor(discrepancy, joint, ratio)
            above.append(f"{rounded(size, 2)} {unit_of(discrepancy, joint)} in joint {joint}")
    said = [f"{listed(above)} above the noise floor, unexplained"] if above else []
    if worse:
        said.append(f"larger error than before in {joints_in_words(worse)} on {data_in_words(discrepancy)}")
    if said:
        return Check("Remaining", "bad", "; ".join(said))
    ratios = discrepancy.after / discrepancy.floor.rms
    worst = int(ratios.argmax()) + 1
    remains = f"{effort_in_words(discrepancy, discrepancy.after[worst - 1], worst)} in joint {worst}"
    return Check("Remaining", "good", f"at most {rounded(ratios.max())} times the noise floor ({remains})")


def _next(discrepancy: Discrepancy) -> str:
    if discrepancy.unexplained:
        joints = joints_in_words(joint for joint, _ in discrepancy.unexplained)
        return f"see the residual of {joints} in discrepancy.html"
    for added in discrepancy.added:
        if _is_open(added):
            others = equivalents(added, label)
            named = f"{label(added.effect)}{_where(added.joints)}"
            what = f"it distinguishes {named} from {others[0]}" if others else f"it shows whether this is {named}"
            return f"record another log ({added.hypothesis.source.shown_by}): {what}"
    if discrepancy.added:
        return "check discrepancy.html, then use the extended model"
    if discrepancy.where:
        return "identify again from this log or from both logs"
    return "nothing to do: the model explains this log"


def _gap(discrepancy: Discrepancy) -> str:
    """On the holdout: 2.4 -> 0.31 N m in joint 3 (noise floor 0.30 N m)."""
    parts = []
    for joint in _named_joints(discrepancy)[: TUNING.joints_named]:
        before, j = rounded(float(discrepancy.before[joint - 1])), joint - 1
        after, floor = (effort_in_words(discrepancy, of[j], joint) for of in (discrepancy.after, discrepancy.floor.rms))
        parts.append(f"{before} -> {after} in joint {joint} (noise floor {floor})")
    return f"on {data_in_words(discrepancy)}: {', '.join(parts)}"


def _named_joints(discrepancy: Discrepancy) -> list[int]:
    """Joints whose gap is named, the largest first: above the floor before, and not named as unexplained."""
    unexplained = {joint for joint, _ in discrepancy.unexplained}
    acting = {joint for added in discrepancy.added for joint in added.joints}
    above = {excess.joint for excess in discrepancy.where}
    preferred = above - unexplained, acting - unexplained, above, acting, set(range(1, len(discrepancy.before) + 1))
    chosen = next(joints for joints in preferred if joints)
    return sorted(chosen, key=lambda j: -float(discrepancy.before[j - 1] / discrepancy.floor.rms[j - 1]))
