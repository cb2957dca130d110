"""Several logs as one: what the files say of each, on its own clock."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot
from saved_results import numbers, save, simulated, strict, table

from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.log.reading import read_log

TERMS = ["rigid_body", "viscous_friction"]
TOLD = ((4, 5.0, 1.7e9, "a.csv"), (5, 3.0, -7.003, "b, two.csv"), (6, 4.0, 0.0, "c.csv"))


@pytest.fixture(scope="module")
def recordings():
    """Signed logs of one robot: three clocks, three lengths, and the second begins between two samples of the grid."""
    logs = []
    for seed, duration, start, name in TOLD:
        log = simulated(small_robot(3), True, TERMS, seed, duration, parameters=0)
        logs.append(replace(log, t=log.t * 1.003 + start, source=name))
    return logs


@pytest.fixture(scope="module")
def pooled(recordings):
    """All of them as one, the sign of joint 2 known."""
    joined = join_logs(recordings)
    signed = np.array([False, True, False])
    log = replace(joined, effort=np.where(signed, joined.effort, np.abs(joined.effort)), signed=signed)
    return identify(small_robot(3), log, TERMS, posterior=False, complete="off")


@pytest.fixture(scope="module")
def folder(pooled, tmp_path_factory):
    return save(pooled, tmp_path_factory.mktemp("pooled") / "result")


def test_segments_are_told_on_the_clocks_of_their_logs(recordings, pooled, folder):
    """Of each log and joint they follow one another from its first to its last instant, none in between."""
    rows = table(folder / "segments.csv")
    assert list(rows[0]) == ["joint", "start", "end", "n_samples", "sign", "confidence", "log"]
    assert [(row["joint"], row["log"]) for row in rows] == sorted((row["joint"], row["log"]) for row in rows)
    period = 1.0 / pooled.signals.rate
    clock = 0.01 * period + 1e-6  # s, to which a sample belongs to a row, and seconds since 1970 are told
    for log in recordings:
        for joint in "123":
            mine = [row for row in rows if row["joint"] == joint and row["log"] == log.source]
            starts, ends, counts = numbers(mine, "start", "end", "n_samples").T
            assert log.t[0] - clock <= starts[0] < log.t[0] + period
            assert log.t[-1] + clock >= ends[-1] > log.t[-1] - period
            np.testing.assert_allclose(starts[1:] - ends[:-1], period, atol=clock)
            np.testing.assert_allclose(ends - starts, (counts - 1) * period, atol=clock)
            assert abs(counts.sum() - len(log)) <= 1
    told = numbers(rows, "n_samples").sum() / 3
    assert len(pooled.signals.motion) - told == pytest.approx(2 * 3.0 / period, abs=5), "two pauses of 3 s are left out"


def test_signs_are_those_of_each_log(recordings, folder):
    """Looked up in the logs themselves, by their own time."""
    rows, signed = table(folder / "segments.csv"), table(folder / "signed_log.csv")
    assert list(signed[0]) == ["t", *(f"{kind}{j}" for kind in ("tau", "p", "q", "dq") for j in (1, 2, 3)), "log"]
    assert [row["log"] for row in signed] == [log.source for log in recordings for _ in log.t]
    np.testing.assert_array_equal(numbers(signed, "t"), np.concatenate([log.t for log in recordings]))
    for log in recordings:
        found = numbers([row for row in signed if row["log"] == log.source], "tau1", "tau2", "tau3")
        np.testing.assert_array_equal(np.abs(found), np.abs(log.effort))
        for j, truth in enumerate(log.effort.T):
            strong = np.abs(truth) > 0.05 * np.abs(truth).max()
            assert np.mean(np.sign(found[:, j]) == np.sign(truth), where=strong) > 0.99
            of_segments = np.zeros(len(log))
            for row in (row for row in rows if (row["joint"], row["log"]) == (str(j + 1), log.source)):
                inside = (log.t > float(row["start"]) - 0.005) & (log.t < float(row["end"]) + 0.005)
                of_segments[inside] = row["sign"]
            assert np.mean(of_segments == np.sign(truth), where=strong) > 0.98


def test_the_signed_log_is_read_as_the_logs_that_it_holds(recordings, folder):
    again = read_log(folder / "signed_log.csv")
    np.testing.assert_array_equal(again.q, np.concatenate([log.q for log in recordings]))
    for piece, log in zip(again.pieces, recordings, strict=True):
        np.testing.assert_array_equal(piece.t, log.t)


def test_a_segment_that_spans_a_pause_is_cut_there(pooled):
    """Signs and confidences of all others stay what they were; those of its parts follow from the parts' samples."""
    segments, signs, confidence = pooled.recorded_segments
    before = zip(pooled.segments.joint, pooled.segments.start, pooled.segments.end, strict=True)
    known = dict(zip(before, zip(pooled.signs, pooled.confidence, strict=True), strict=True))
    where = list(zip(segments.joint, segments.start, segments.end, strict=True))
    same = [k for k, one in enumerate(where) if one in known]
    assert [(signs[k], confidence[k]) for k in same] == [known[where[k]] for k in same]
    cut = [k for k in range(len(where)) if k not in same]
    assert 6 <= len(cut) <= 12, "two pauses, three joints, and what ends or begins exactly there"
    for k in cut:
        j, a, b = where[k]
        energy = pooled.signals.raw_effort[a:b, j] ** 2
        plus = (energy * pooled.probability[a:b, j]).sum() / energy.sum()
        assert signs[k] == (1 if plus >= 0.5 else -1)
        assert confidence[k] == pytest.approx(max(plus, 1.0 - plus))


def test_the_summary_names_all_logs(recordings, pooled, folder):
    content = strict((folder / "summary.json").read_text())
    assert content["log"] == "a.csv + b, two.csv + c.csv"
    assert content["logs"] == [{"source": log.source, "n_samples": len(log)} for log in recordings]
    assert content["n_samples"] == sum(map(len, recordings))
    assert content["n_segments"] == len(table(folder / "segments.csv"))
