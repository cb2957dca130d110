"""What does not fit is refused before any work."""

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.identification import memory
from bayesid.identification.memory import check_memory, memory_needed
from bayesid.log.log import Log
from bayesid.model.robot import robot_from_table


def log_of(t, n=2):
    values = np.ones((len(t), n))
    return Log(np.asarray(t, dtype=float), values, values, np.zeros(n, dtype=bool), source="log.csv")


def test_more_rows_or_joints_need_more():
    short, long, wide = log_of(np.arange(1e4) / 500), log_of(np.arange(1e5) / 500), log_of(np.arange(1e5) / 500, n=6)
    assert memory_needed(short) < memory_needed(long) < memory_needed(wide) < 1.5


def test_stamps_in_bursts_count_by_their_even_grid():
    """900 rows of ten in a nanosecond's distance once asked for a terabyte."""
    rows = np.arange(900)
    assert memory_needed(log_of((rows // 10) * 0.1 + (rows % 10) * 1e-9)) > 500.0


def test_a_limit_is_kept_and_the_line_says_how_to_go_on():
    log = log_of(np.arange(1e5) / 500)
    check_memory(log, 100.0)
    with pytest.raises(InputError, match=r"100000 rows of 2 joints need about 0\.5\d GB of memory, 0\.5 are allowed"):
        check_memory(log, 0.5)


def test_by_default_it_is_a_share_of_the_machine(monkeypatch):
    pages = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr(memory.os, "sysconf", pages.__getitem__)
    with pytest.raises(InputError, match="resample the log"):
        check_memory(log_of(np.arange(100) / 500), None)
    monkeypatch.delattr(memory.os, "sysconf")
    check_memory(log_of(np.arange(100) / 500), None)


def test_identify_asks_first(monkeypatch):
    monkeypatch.setattr("bayesid.identification.pipeline.prepare", lambda *_: pytest.fail("work has begun"))
    t = np.arange(300) / 100
    q = np.stack([np.sin(3 * t), np.cos(2 * t)], axis=1)
    log = Log(t, q, np.abs(q), np.zeros(2, dtype=bool), source="log.csv")
    joints = [{"a": 0.1, "alpha": 1.0, "d": 0.4, "theta": 0.0}, {"a": 0.35, "alpha": 0.0, "d": 0.0, "theta": 0.0}]
    robot = robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "arm")
    with pytest.raises(InputError, match=r"Preparation\(max_memory=\.\.\.\)"):
        bayesid.identify(robot, log, preparation=bayesid.Preparation(max_memory=0.1))
    with pytest.raises(InputError, match="a memory of 0 GB"):
        bayesid.Preparation(max_memory=0.0)
