"""What there is to say of a stream, in words."""

from __future__ import annotations

import shlex

from bayesid.monitor.changes import Alarm
from bayesid.monitor.kinds import CONTACT, FRICTION, GAIN, PAYLOAD
from bayesid.monitor.replay import Agreement
from bayesid.monitor.tracked import Counts, StreamFigures
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import Check
from bayesid.report.words import joints_in_words, rounded

HEADINGS = ("joint", "signs agree", "sure (99 %)", "RMS residual, N m", "external / threshold")
NOTE = "external / threshold: the most that two samples in a row have of it; beyond 1 it is a contact, or a change"
_NOTHING = "-"


def track_rows(figures: StreamFigures, smoothing: Agreement | None) -> list[tuple[str, ...]]:
    """Of a table with `HEADINGS`, a joint each."""
    n = len(figures.moving)
    agree, sure = (None, None) if smoothing is None else (smoothing.by_joint, smoothing.sure_by_joint)
    rows = []
    for j in range(n):
        shares = [_NOTHING if part is None else _percent(float(part[j])) for part in (agree, sure)]
        rms, pushed = float(figures.rms[j]), float(figures.pushed[j])
        known = [_or_nothing(value, text) for value, text in ((rms, rounded(rms)), (pushed, f"{pushed:.2f}"))]
        rows.append((str(j + 1), *shares, *known))
    return rows


def track_lines(
    smoothing: Agreement | None, status: str, known: Agreement | None, seen: bool = False, *, signed: bool = False
) -> list[Check]:
    """How the stream's signs compare with the smoothing of the whole log and, where it has them, with its own.

    Args:
        smoothing: agreement with the smoothing; None where there is none.
        status: why not.
        known: agreement with the log's signs, of a stream without them.
        seen: whether the model was identified from this log.
        signed: whether the efforts of all joints have signs in the log.
    """
    said = []
    if smoothing is None:
        said.append(Check("Signs", "look", f"not compared with a smoothing of the whole log: {status}"))
    elif smoothing.samples.any():
        where = " (the log that the model was identified from)" if seen else ""
        said.append(Check("Signs", "good", f"{_agreed(smoothing, 'those of a smoothing of the whole log')}{where}"))
    elif signed:
        said.append(Check("Signs", "good", "known in the log: there was none to find"))
    else:
        said.append(Check("Signs", "look", "not compared: there is no sample in motion whose sign both have found"))
    if known is not None and known.samples.any():
        told = _agreed(known, "those in the log, where absolute values alone are fed")
        said.append(Check("Signs that are known", "good", told))
    return said


def count_line(counts: Counts, figures: StreamFigures, lag: float, bad: int = 0) -> str:
    """What became of the rows, and what an update took."""
    parts = [f"{counts.updates:,} rows taken"]
    named = {
        "repeated": counts.repeated,
        "late": counts.late,
        "without a number": counts.missing,
        "no rows at all": bad,
        "efforts without a number": counts.unread,
        "gaps" if counts.gaps != 1 else "gap": counts.gaps,
        "times that the clock was set back"
        if counts.set_back != 1
        else "time that the clock was set back": counts.set_back,
    }
    parts += [f"{count:,} {what}" for what, count in named.items() if count]
    if not counts.updates:
        return parts[0]
    middle, late = (1e6 * figures.times.quantile(share) for share in (0.5, 0.999))
    took = f"an update took {middle:.0f} microseconds in the middle, {late:.0f} in one of a thousand"
    return f"{', '.join(parts)}; {took}; {lag:.3g} s behind"


def alarm_line(alarm: Alarm) -> str:
    """When, what, in which joints, by how much, and when it was said."""
    later = alarm.raised - alarm.time
    said = f", said {later:.1f} s later" if later >= TUNING.soon else ""
    amount = _amount(alarm)
    lasted = f", {alarm.duration:.2f} s long" if alarm.kind == CONTACT and alarm.duration else ""
    name = "unknown change" if alarm.kind not in (CONTACT, PAYLOAD, FRICTION, GAIN) else alarm.kind
    return (
        f"{alarm.time:.2f} s: {name}, {joints_in_words(alarm.joints)}{f' ({amount})' if amount else ''}{lasted}{said}"
    )


def change_line(alarm: Alarm, result: str, log: str, last: float) -> str:
    """How to go on with a change: the command and its window, which ends at an instant, s."""
    command = shlex.join(["bayesid", "discrepancy", result, log])
    return (
        f"what has changed: `{command}` on the rows from {alarm.time:.2f} to {last:.2f} s, cut out as a log, or "
        "--explain here"
    )


def named_line(alarm: Alarm, status: str, effects: str) -> str:
    """What `bayesid.find_discrepancy` names of a change."""
    told = f"{effects} ({status})" if effects else status
    return f"what has changed from {alarm.time:.2f} s on: {told}"


def _amount(alarm: Alarm) -> str:
    if alarm.amount is None:
        return ""
    if alarm.kind == CONTACT:
        return f"up to {rounded(alarm.amount)} N m"
    if alarm.kind == GAIN:
        return f"{100.0 * alarm.amount:+.0f} %"
    sign = "+" if alarm.amount >= 0.0 else ""
    return f"{sign}{rounded(alarm.amount, 2)} {'kg' if alarm.kind == PAYLOAD else 'N m'}"


def _agreed(one: Agreement, what: str) -> str:
    return (
        f"{_percent(one.share)} of the samples in motion have {what}; sure to 99 % of {_percent(one.sure_share)}, of "
        f"which {_percent(one.share_of_sure)} agree"
    )


def _percent(share: float) -> str:
    return _or_nothing(share, f"{share:.1%}")


def _or_nothing(value: float, text: str) -> str:
    return _NOTHING if value != value else text
