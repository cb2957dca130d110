"""Logs that hold something else than they seem to: decoded, mended or refused, and said; right ones stay the same."""

import numpy as np
import pytest
from log_files import flat, read, refusal, save, smooth_recording, text

from bayesid.log.log import join_logs
from bayesid.log.reading import read_log, read_motion
from bayesid.log.signals import prepare

RECORDED = smooth_recording(rows=1200)
T, Q, DQ = (RECORDED[name] for name in ("t", "q", "dq"))
COUNTS = np.rint(RECORDED["tau"] * [10.0, 20.0, 30.0])
GAINS = [0.1, 0.05, 1.0 / 30.0]
TAU = COUNTS * GAINS


def log_of(counts, **more):
    return {"t": T, "q": Q, "i": counts} | more


# ---- Readings that hold a sign ----
@pytest.mark.parametrize(
    ("counts", "said"),
    [
        (np.where(COUNTS < 0, COUNTS + 65536, COUNTS), "two's complement of 16 bits"),
        (np.where(COUNTS < 0, COUNTS + 2.0**32, COUNTS), "two's complement of 32 bits"),
        (np.where(COUNTS < 0, 1024 - COUNTS, COUNTS), "a sign in bit 10"),
        (np.where(COUNTS < 0, 32768 - COUNTS, COUNTS), "a sign in bit 15"),
        (COUNTS + 2048, "zero at 2048"),
    ],
)
def test_a_sign_in_a_code_is_decoded_and_said(counts, said):
    log, heard = read(log_of(counts), GAINS)
    np.testing.assert_allclose(log.effort, TAU, atol=1e-9)
    assert log.signed.all()
    assert said in heard
    assert any(said in note for note in log.notes), "for the result's warnings"
    if counts.max() < 1e6:  # else no current of this world
        np.testing.assert_allclose(read(log_of(counts), GAINS, encoding="magnitude")[0].effort, counts * GAINS)


def test_absolute_values_are_no_code():
    """Whole numbers that cross powers of two, one with an outlier at the end of a register's scale."""
    outlier = np.abs(COUNTS)
    outlier[300, 1] = 65535
    for counts in (np.abs(COUNTS), 7.0 * np.abs(COUNTS), outlier, np.abs(RECORDED["tau"])):
        log, heard = read(log_of(counts), GAINS)
        assert not log.signed.any()
        assert not heard
        np.testing.assert_allclose(log.effort, counts * GAINS)


def test_an_offset_that_no_register_has_is_refused_and_can_be_stated():
    volts = 2.5 + COUNTS / 1000.0
    said = refusal(log_of(volts), GAINS)
    assert "never come near zero" in said
    assert "--encoding" in said
    gains = np.array(GAINS) * 1000.0
    np.testing.assert_allclose(read_log(log_of(volts), gains, encoding="offset:2.5").effort, TAU, atol=1e-9)
    with pytest.raises(ValueError, match="is not an encoding"):
        read_log(log_of(volts), gains, encoding="offset")


def test_directions_in_columns_of_their_own(tmp_path):
    ways = flat({"direction": np.sign(COUNTS) + (COUNTS == 0)})
    log, heard = read(save(tmp_path / "log.csv", flat({"t": T, "q": Q, "tau": np.abs(TAU)}) | ways))
    np.testing.assert_allclose(log.effort, TAU, atol=1e-9)
    assert "the direction column" in heard
    bits = flat({"dir": (COUNTS < 0) * 1.0})
    log, _ = read(flat({"t": T, "q": Q, "tau": np.abs(TAU)}) | bits, encoding="direction:1")
    np.testing.assert_allclose(log.effort, TAU, atol=1e-9)


# ---- Desired values ----
@pytest.mark.parametrize("name", ["q_d[{}]", "target_q_{}", "cmd/position_{}", "SollPosition{}", "q_ref{}"])
def test_what_is_wanted_is_never_taken_for_what_was_measured(tmp_path, name):
    columns = flat({"q": Q * 1.01}, q=name) | flat(
        {"t": T, "q": Q, "dq": DQ, "tau": TAU}, t="time", q="q[{}]", dq="dq[{}]", tau="tau_J[{}]"
    )
    log, _ = read(save(tmp_path / "log.csv", columns | flat({"dq": 0.9 * DQ}, dq="dq_d[{}]")))
    np.testing.assert_array_equal(log.q, Q)
    np.testing.assert_array_equal(log.dq, DQ)
    assert "column q1 is missing" in refusal(flat({"t": T, "q": Q, "tau": TAU}, q=name))


# ---- Positions and velocities ----
@pytest.mark.parametrize("least", [-np.pi, 0.0])
@pytest.mark.parametrize("degrees", [True, False])
def test_wrapped_angles_are_unwrapped_and_said(least, degrees):
    q = Q * 2.0 + (3.0 if least else 6.0)
    wrapped = (q - least) % (2.0 * np.pi) + least
    wrapped[:, 2] = Q[:, 2]
    unit = np.rad2deg(1.0) if degrees else 1.0
    log, heard = read({"t": T, "q": wrapped * unit, "tau": np.abs(TAU)}, degrees=degrees)
    assert "wrapped" in heard
    assert "joint 3" not in heard
    turns = (log.q[:, :2] - q[:, :2]) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.tile(np.rint(turns[0]), (len(T), 1)), atol=1e-9)
    with pytest.warns(UserWarning, match="unwrapped"):
        np.testing.assert_allclose(read_motion({"t": T, "q": wrapped}).q, log.q, atol=1e-9)


@pytest.mark.parametrize("least", [-180.0, 0.0])
@pytest.mark.parametrize("per_second", [1.0, np.rad2deg(1.0)])
def test_one_joint_that_jumps_by_360_is_in_degrees(least, per_second):
    q, dq = Q.copy(), DQ.copy()
    q[:, 1] = (np.rad2deg(2.0 * Q[:, 1]) + 90.0 - least) % 360.0 + least
    dq[:, 1] *= 2.0 * per_second
    for source in ({"t": T, "q": q, "tau": TAU}, {"t": T, "q": q, "dq": dq, "tau": TAU}):
        log, heard = read(source)
        assert "joint 2 jump by 360" in heard
        assert "joint 2 (" in heard
        np.testing.assert_allclose(np.diff(log.q, axis=0), np.diff(Q * [1.0, 2.0, 1.0], axis=0), atol=1e-9)
        assert log.dq is None or np.allclose(log.dq, DQ * [1.0, 2.0, 1.0])
    q[:, 2] = np.rad2deg(0.2 * Q[:, 2])
    said = refusal({"t": T, "q": q, "tau": TAU})
    assert "jump by 360" in said
    assert "q3 reaches 11" in said


@pytest.mark.parametrize("strange", [np.full(len(T), -3.0), np.zeros(len(T)), DQ[:, 0]])
def test_velocities_of_something_else_are_left_out(strange):
    dq = DQ.copy()
    dq[:, 1] = strange
    log, heard = read({"t": T, "q": Q, "dq": dq, "tau": np.abs(TAU)})
    assert "velocities of joint 2 are not" in heard
    np.testing.assert_allclose(log.dq, DQ, atol=1e-2)
    prepare(log)


def test_local_faults_of_velocities_are_left_out():
    dq = DQ.copy()
    dq[400:404, 1] = 60.0
    dq[800:900, 2] = dq[800, 2]
    log, heard = read({"t": T, "q": Q, "dq": dq, "tau": np.abs(RECORDED["tau"])})
    assert not heard
    signals, right = prepare(log), prepare(read_log({"t": T, "q": Q, "dq": DQ, "tau": np.abs(RECORDED["tau"])}))
    assert {fault.joint for fault in signals.faults} == {1, 2}
    assert not right.faults
    np.testing.assert_allclose(signals.motion.dq, right.motion.dq, atol=0.1)


@pytest.mark.parametrize("seconds", [0.3, 1.5, 5.0, 60.0])
def test_velocities_are_judged_within_what_a_clock_that_jumps_has_recorded(seconds):
    late = np.where(np.arange(len(T)) < 700, T, T + seconds)
    log, heard = read({"t": late, "q": Q, "dq": DQ, "tau": TAU})
    assert "velocit" not in heard
    np.testing.assert_array_equal(log.dq, DQ)
    assert not prepare(log).faults
    derived = np.gradient(Q, late, axis=0)
    assert "velocit" not in read({"t": late, "q": Q, "dq": derived, "tau": TAU})[1]


def test_an_encoder_that_stops_for_a_while_says_nothing_of_its_velocity():
    q = Q.copy()
    q[700:880, 1] = q[700, 1]
    log, heard = read({"t": T, "q": q, "dq": DQ, "tau": TAU})
    assert not heard
    np.testing.assert_array_equal(log.dq, DQ)
    signals = prepare(log)
    assert [(one.joint, one.reading, one.kind) for one in signals.faults] == [(1, "position", "held")]
    known = signals.measured.all(axis=1)
    right = prepare(read_log({"t": T, "q": Q, "dq": DQ, "tau": TAU}))
    np.testing.assert_allclose(signals.motion.dq[known], right.motion.dq[known], atol=1e-3)


def test_a_position_that_stands_while_its_velocity_moves_is_refused():
    q = Q.copy()
    q[:, 0] = 1.0
    assert "position of joint 1 is constant" in refusal({"t": T, "q": q, "dq": DQ, "tau": TAU})


def test_logs_of_which_one_has_velocities_are_joined():
    one, other = read_log({"t": T, "q": Q, "dq": DQ, "tau": TAU}), read_log({"t": T, "q": Q, "tau": TAU})
    both = join_logs([one, other])
    np.testing.assert_array_equal(both.dq[: len(T)], DQ)
    np.testing.assert_allclose(both.dq[len(T) :], DQ, atol=1e-2)
    assert any("no measured velocities" in note for note in both.notes)


# ---- Time, blanks, no signal ----
def test_clocks_that_pause_or_are_too_coarse():
    late = np.where(np.arange(len(T)) < 700, T, T + 5.0)
    assert "time jumps 1 time" in read({"t": late, "q": Q, "tau": TAU})[1]
    stands = np.where((T > 3.0) & (T < 4.0), 3.0, T)
    log, heard = read({"t": stands, "q": Q, "tau": TAU})
    assert "rows repeat the time of the row before" in heard
    prepare(log)
    said = refusal({"t": np.floor(T), "q": Q, "tau": TAU})
    assert "12 instants in 1,200 rows" in said
    assert "t[10ms]" in said
    assert len(read_log({"t[10ms]": np.arange(len(T)), "q": Q, "tau": TAU})) == len(T)
    parts = {"stamp.sec": np.floor(T + 1e-9), "stamp.nanosec": np.rint((T - np.floor(T + 1e-9)) * 1e9)}
    np.testing.assert_allclose(read_log(parts | flat({"position": Q, "effort": TAU}, 0)).t, T, atol=1e-9)


def test_rows_with_blank_cells_are_dropped_and_counted(tmp_path):
    lines = text(flat({"t": T, "q": Q, "tau": TAU})).splitlines()
    for row, cell in ((30, ""), (31, "nan"), (60, "#DIV/0!")):
        lines[row] = ",".join([*lines[row].split(",")[:-1], cell])
    log, heard = read(save(tmp_path / "log.csv", "\n".join(lines)))
    assert "3 of 1,200 rows" in heard
    np.testing.assert_array_equal(log.t, np.delete(T, [29, 30, 59]))
    apart = flat({"q": Q, "tau": TAU})
    odd = np.arange(len(T)) % 2 == 1
    apart = {name: np.where(odd == name.startswith("q"), values, np.nan) for name, values in apart.items()}
    log, heard = read({"t": T} | apart)
    assert "joined by time" in heard
    np.testing.assert_allclose(log.q, Q[~odd][1:], atol=1e-3)


def test_columns_that_were_never_read():
    tau, dq = TAU.copy(), DQ.copy()
    tau[:, 1], dq[:, 2] = np.nan, np.nan
    log, heard = read({"t": T, "q": Q, "dq": dq, "tau": tau})
    assert "tau2 holds no number in any row" in heard
    assert "dq3 holds no number in any row; velocities are ignored" in heard
    assert log.dq is None
    np.testing.assert_array_equal(log.effort, TAU * [1.0, 0.0, 1.0])
    assert not prepare(log).measured[:, 1].any()
    assert "no number" in refusal({"t": T, "q": Q, "tau": TAU * np.nan})


def test_no_signal_is_refused():
    for effort, said in ((1e-310 * TAU, "all efforts are zero"), (0.0 * TAU + 3.0, "all efforts are constant")):
        assert said in refusal({"t": T, "q": Q, "tau": effort})
    slow = np.arange(len(T)) // 10 * 10
    log, heard = read({"t": T, "q": Q, "tau": TAU[slow]})
    assert "efforts change only every 10 rows" in heard
    np.testing.assert_array_equal(log.effort, TAU[::10])
    log, heard = read({"t": T, "q": Q[slow], "tau": TAU})
    assert "positions change only every 10 rows" in heard
    np.testing.assert_allclose(log.q[:-10], Q[:-10], atol=0.02)
    log, heard = read({"t": T, "q": Q, "dq": DQ[slow], "tau": TAU})
    assert "velocities change only every 10 rows" in heard
    np.testing.assert_allclose(log.dq[:-10], DQ[:-10], atol=0.2)


@pytest.mark.parametrize("cutoff", [1e-9, 0.001, 0.3, 50.0, float("nan")])
def test_cutoffs_that_no_filter_of_the_log_can_have_are_refused(cutoff):
    log = read_log({"t": T, "q": Q, "tau": TAU})
    with pytest.raises(ValueError, match=r"between 0\.33 and 50 Hz"):
        prepare(log, cutoff)
    assert prepare(log, 0.34).cutoff == 0.34
