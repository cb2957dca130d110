"""Dates of logs: from absolute time stamps, else from the file names.

The modification time of a file is not used: copying changes it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import PurePath

import numpy as np

from bayesid.arrays import Array
from bayesid.log.log import Log

STAMPS, NAMES = "time stamps in the logs", "dates in the names of the files"
ORDER = "the order in which logs were given"
_EARLIEST, _LATEST = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2000, 2100))
"""s since 1970. A clock between these times is absolute; clocks that start at zero never get there."""
_NAMED = re.compile(
    r"(?<!\d)(20\d\d)([-_.]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])"
    r"(?:[T_ -]?([01]\d|2[0-3])[-:h.]?([0-5]\d)(?:[-:m.]?([0-5]\d))?)?(?!\d)"
)  # an ISO date with or without separators, perhaps followed by a time of day


@dataclass(frozen=True)
class Dates:
    """Dates of K logs: (K,) in ISO 8601 (UTC for clocks), and (K,) days since the first.

    Unknown dates are "1", "2", .. and 0, 1, ... The basis is `STAMPS`, `NAMES` or `ORDER`.
    """

    texts: tuple[str, ...]
    days: Array
    basis: str

    @property
    def known(self) -> bool:
        """Whether dates were found."""
        return self.basis != ORDER

    @property
    def ascending(self) -> bool:
        """Whether the logs are in order of date."""
        return bool(np.all(np.diff(self.days) >= 0.0))


def dates_of(logs: Sequence[Log]) -> Dates:
    """Dates of K logs in the given order, from the first source that has a date for every log."""
    for basis, rule in ((STAMPS, _stamped), (NAMES, _named)):
        found = [moment for log in logs if (moment := rule(log)) is not None]
        if len(found) == len(logs):
            texts = [moment.date().isoformat() for moment in found]
            if len(set(texts)) < len(texts):  # two logs of one day
                texts = [moment.replace(tzinfo=None).isoformat(timespec="seconds") for moment in found]
            seconds = np.array([moment.timestamp() for moment in found])
            return Dates(tuple(texts), (seconds - seconds[0]) / 86400.0, basis)
    return Dates(tuple(str(k) for k in range(1, len(logs) + 1)), np.arange(len(logs), dtype=float), ORDER)


def _stamped(log: Log) -> datetime | None:
    """Start by the log's clock; None for a clock that is not absolute."""
    start = float(log.pieces[0].t[0] if log.pieces else log.t[0])
    return datetime.fromtimestamp(start, UTC) if _EARLIEST <= start < _LATEST else None


def _named(log: Log) -> datetime | None:
    name = PurePath(log.pieces[0].source if log.pieces else log.source).name
    for year, _, month, day, hour, minute, second in _NAMED.findall(name):
        try:
            date = datetime(int(year), int(month), int(day), tzinfo=UTC)
            return date.replace(hour=int(hour or 0), minute=int(minute or 0), second=int(second or 0))
        except ValueError:  # 30 February
            continue
    return None
