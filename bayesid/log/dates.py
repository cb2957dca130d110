"""When logs were recorded, as far as they say: by absolute time stamps, else by a date in the name of the file.

The time at which a file was last changed is not used: copies and checkouts have another one.
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
"""s since 1970; a log's clock that stands between them is absolute, for no clock that begins at zero comes so far."""
_NAMED = re.compile(
    r"(?<!\d)(20\d\d)([-_.]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])"
    r"(?:[T_ -]?([01]\d|2[0-3])[-:h.]?([0-5]\d)(?:[-:m.]?([0-5]\d))?)?(?!\d)"
)  # an ISO date, with or without what stands between its parts, and a time of day right behind it


@dataclass(frozen=True)
class Dates:
    """When K logs were recorded: (K,) in ISO 8601, UTC where a clock says it; and (K,) days since the first.

    They are "1", "2", .. and 0, 1, .. where nothing is known. The basis is `STAMPS`, `NAMES` or `ORDER`.
    """

    texts: tuple[str, ...]
    days: Array
    basis: str

    @property
    def known(self) -> bool:
        """Whether there are any."""
        return self.basis != ORDER

    @property
    def ascending(self) -> bool:
        """Whether the logs come in the order of their dates."""
        return bool(np.all(np.diff(self.days) >= 0.0))


def dates_of(logs: Sequence[Log]) -> Dates:
    """The dates of K logs in the order in which they were given: all by the first rule that gives one for each."""
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
    """When its clock says that it began; None for a clock that begins anywhere."""
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
