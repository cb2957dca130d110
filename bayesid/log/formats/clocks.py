"""Times that are written as a date, as a time of day, or as minutes and seconds."""

from __future__ import annotations

import re
from datetime import UTC, datetime

_DAY = re.compile(r"(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})[T ,]+(.+)")
_TIME = re.compile(
    r"(?:(?P<hours>\d{1,2}):)?(?P<minutes>\d{1,4}):(?P<seconds>\d{1,2}(?:[.,:]\d+)?)\s*(?P<half>[AP]M)?", re.IGNORECASE
)


def is_clock(cell: str) -> bool:
    """Whether a cell holds such a time."""
    try:
        clock_seconds(cell)
    except ValueError:
        return False
    return ":" in cell


def clock_seconds(cell: str) -> float:
    """A date and time in s since 1970, UTC where no zone is given; a time of day in s since midnight.

    Dates are those of ISO 8601, or days, months and years with points (3.2.2026) or with slashes, where either of the
    first two may be the month: a log is about differences. "12:03.4" is 12 minutes and 3.4 s, as spreadsheets have it.

    Raises:
        ValueError: it is none of these.
    """
    cell = cell.strip().strip('"')
    day = _DAY.fullmatch(cell)
    if day is None:
        return _since_midnight(cell) if "-" not in cell else _iso(cell)
    first, _, second, third, time = day.groups()
    if len(first) == 4:
        return _iso(f"{first}-{second:0>2}-{third:0>2}", time)
    month, of_month = (first, second) if day[2] == "/" and int(first) <= 12 else (second, first)
    return _iso(f"{third}-{month:0>2}-{of_month:0>2}", time)


def _iso(date: str, time: str | None = None) -> float:
    """A date with a time of day, or both in one text."""
    if time is not None and _TIME.fullmatch(time):
        return datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp() + _since_midnight(time)
    moment = datetime.fromisoformat(date if time is None else f"{date}T{time}")
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _since_midnight(time: str) -> float:
    """Hours, minutes and seconds, or minutes and seconds; fractions behind a point, a comma or a third colon."""
    found = _TIME.fullmatch(time.strip())
    if found is None:
        raise ValueError(f"{time!r} is no time")
    whole, _, fraction = re.sub("[,:]", ".", found["seconds"]).partition(".")
    hours = int(found["hours"] or 0)
    if found["half"]:
        hours = hours % 12 + (12 if found["half"].upper() == "PM" else 0)
    return hours * 3600.0 + int(found["minutes"]) * 60.0 + float(f"{whole}.{fraction or 0}")
