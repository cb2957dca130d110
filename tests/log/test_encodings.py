"""Readings that hold a sign in a code: what cannot be |effort|, what is stated wrongly, 64 bits, directions."""

import re

import numpy as np
import pytest
from log_files import flat, read, refusal, save, smooth_recording

from bayesid.log.reading import read_log

RECORDED = smooth_recording(rows=1200)
T, Q = RECORDED["t"], RECORDED["q"]
COUNTS = np.rint(RECORDED["tau"] * [10.0, 20.0, 30.0])
GAINS = [0.1, 0.05, 1.0 / 30.0]
TAU = COUNTS * GAINS
CODED = {
    "two's complement": np.where(COUNTS < 0, COUNTS + 65536, COUNTS),
    "a sign in bit 10": np.where(COUNTS < 0, 1024 - COUNTS, COUNTS),
    "about 2048": COUNTS + 2048,
    "never come near zero": COUNTS + 1500,
    "two bands": np.where(COUNTS < 0, 3.07 * (1024.0 - COUNTS), 3.01 * COUNTS),
}


def log_of(counts, **more):
    return {"t": T, "q": Q, "i": counts} | more


@pytest.mark.parametrize("seen", CODED)
def test_what_cannot_be_a_magnitude_is_not_offered_as_one_and_named_where_it_is_stated(seen):
    try:
        heard = read(log_of(CODED[seen]), GAINS)[1]
    except ValueError:
        heard = refusal(log_of(CODED[seen]), GAINS)
        assert "--encoding" in heard
    assert "magnitude" not in heard
    log, said = read(log_of(CODED[seen]), GAINS, encoding="magnitude")
    np.testing.assert_allclose(log.effort, CODED[seen] * GAINS)
    assert len(log.notes) == 1, "for the result's warnings"
    assert seen in said
    assert seen in log.notes[0]
    assert not read(log_of(np.abs(COUNTS)), GAINS, encoding="magnitude")[1]


def test_two_bands_suggest_the_codes_of_their_scale():
    volts = np.where(COUNTS < 0, 1024.02 - 1.003 * COUNTS, 1.003 * COUNTS)
    said = refusal(log_of(volts), GAINS)
    assert "twos:11 or sign-bit:10" in said
    assert re.search("two bands, 0.* and 102.*", said)


@pytest.mark.parametrize("stated", ["twos:16", "twos:12", "sign-bit:10", "offset:4096", "direction:1"])
def test_a_code_that_readings_cannot_hold_is_refused(stated):
    assert "--encoding" in refusal(log_of(COUNTS + 1500), GAINS, encoding=stated)
    np.testing.assert_allclose(read_log(log_of(COUNTS + 1500), GAINS, encoding="offset:1500").effort, TAU, atol=1e-9)


def test_64_bits_are_decoded_as_whole_numbers_alone(tmp_path):
    whole = COUNTS.astype(np.int64).view(np.uint64)
    rows = [
        ",".join([repr(float(t)), *map(repr, q.tolist()), *map(str, c)]) for t, q, c in zip(T, Q, whole, strict=True)
    ]
    path = save(tmp_path / "log.csv", "\n".join(["t,q1,q2,q3,i1,i2,i3", *rows]))
    for source in (path, log_of(whole)):
        log, heard = read(source, GAINS)
        np.testing.assert_allclose(log.effort, TAU, atol=1e-9)
        assert log.signed.all()
        assert "two's complement of 64 bits" in heard
    np.testing.assert_allclose(read(path, GAINS, encoding="twos:64")[0].effort, TAU, atol=1e-9)
    assert "64-bit" in refusal(log_of(whole.astype(float)), GAINS)
    assert "64 bits" in refusal(path, GAINS, encoding="twos:16")


@pytest.mark.parametrize("kinds", [(0.0, 1.0), (1.0, 0.0), (1.0, 2.0), (1.0, -1.0), (255.0, 0.0)])
def test_directions_by_convention_or_by_the_work_of_all_joints(kinds):
    """Friction makes drives lose work, whatever gravity does."""
    counts = np.rint(20.0 * np.sin(Q) + 30.0 * np.sign(RECORDED["dq"]))
    ways = flat({"dir": np.where(counts < 0, kinds[1], kinds[0])})
    log, heard = read(flat({"t": T, "q": Q, "tau": np.abs(counts)}) | ways)
    np.testing.assert_array_equal(log.effort, counts)
    assert f"{kinds[1]:g} is negative" in heard


def test_all_joints_are_signed_where_readings_were_decoded():
    counts = COUNTS + np.array([0.0, 0.0, 900.0])
    log, _ = read(log_of(np.where(counts < 0, counts + 65536, counts)), GAINS)
    assert log.signed.all()
    assert log.effort[:, 2].min() > 0.0


def test_directions_of_efforts_that_do_no_work_are_refused_with_the_option_that_says_which():
    counts = np.rint(100.0 * Q) * [1.0, 1.0, -1.0]
    columns = flat({"t": T, "q": Q, "tau": np.abs(counts)}) | flat({"dir": (counts < 0) * 1.0})
    said = refusal(columns)
    assert "direction:1 (1 is negative) or direction:0" in said
    np.testing.assert_array_equal(read(columns, encoding="direction:1")[0].effort, counts)
    assert "not 3" in refusal(columns, encoding="direction:3")
