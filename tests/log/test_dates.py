"""When logs were recorded: by stamps, by names, or nobody knows."""

from datetime import UTC, datetime

import numpy as np

from bayesid.log.dates import NAMES, ORDER, STAMPS, dates_of
from bayesid.log.log import Log, join_logs


def log(source="log", start=0.0):
    t = start + np.arange(50) / 100.0
    return Log(t, np.column_stack([t, t]), np.ones((50, 2)), [False, False], source=source)


def test_absolute_stamps_come_first():
    first = datetime(2026, 3, 14, 8, 30, tzinfo=UTC).timestamp()
    dates = dates_of([log("2020-01-01.csv", first), log("2020-01-02.csv", first + 86400.0 * 1.5)])
    assert dates.basis == STAMPS
    assert dates.texts == ("2026-03-14", "2026-03-15")
    np.testing.assert_allclose(dates.days, [0.0, 1.5])


def test_dates_in_names():
    """A joined log is of its first recording."""
    for names, texts, days in (
        (("arm_20260314_b.csv", "runs/2026-05-02.csv"), ("2026-03-14", "2026-05-02"), 49.0),
        (("2026-05-02.csv", "2026-03-14.csv"), ("2026-05-02", "2026-03-14"), -49.0),
        (("2026-03-14T0830.csv", "2026-03-14T1700.csv"), ("2026-03-14T08:30:00", "2026-03-14T17:00:00"), 8.5 / 24.0),
    ):
        first, second = (log(name) for name in names)
        dates = dates_of([join_logs([first, log("2026-06-01.csv")]), second])
        assert (dates.basis, dates.texts, dates.ascending) == (NAMES, texts, days > 0.0)
        np.testing.assert_allclose(dates.days, [0.0, days])


def test_without_a_date_for_each_the_order_counts():
    for name in ("a.csv", "20261314.csv", "2026-02-30.csv", "serial120260314.csv", "2026-03-14/a.csv"):
        dates = dates_of([log("2026-03-14.csv"), log(name), log("2026-05-02.csv")])
        assert (dates.basis, dates.texts, dates.known) == (ORDER, ("1", "2", "3"), False)
        np.testing.assert_allclose(dates.days, [0.0, 1.0, 2.0])
