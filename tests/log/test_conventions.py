"""Logs of well-known recorders, by samples of our own: known by their columns, with the units that they state."""

import numpy as np
import pyarrow as pa
import pytest
from log_files import assert_same, flat, read, refusal, save, smooth_recording, text, without
from pyarrow import parquet

ROWS, N = 120, 3
RECORDED = smooth_recording(N, ROWS)
T, Q, DQ, TAU = (RECORDED[name] for name in ("t", "q", "dq", "tau"))
GAINS = [2.0, 3.0, 4.0]
CURRENTS = TAU / GAINS


def block(pattern, values, start=0):
    return flat({"q": values}, start=start, q=pattern)


def rtde(**efforts):
    columns = {"timestamp": T} | block("target_q_{}", Q + 0.01) | block("target_moment_{}", TAU * 1.1)
    columns |= block("actual_q_{}", Q) | block("actual_qd_{}", DQ)
    for name, values in efforts.items():
        columns |= block(f"{name}_{{}}", values)
    return columns | {"robot_mode": np.full(ROWS, 7)} | block("actual_TCP_pose_{}", Q + 9.0)


FRANKA = {"time": T * 1e3, " success_rate": np.ones(ROWS)} | block(" state.q[{}]", Q) | block("state.q_d[{}]", Q + 0.02)
FRANKA |= block(" state.dq[{}]", DQ) | block("state.tau_J[{}]", TAU) | block("cmd.tau_J_d[{}]", TAU + 1.0)
STAMPS = [str(1_600_000_000_000_000_000 + 10_000_000 * k) for k in range(ROWS)]
ROSTOPIC = {"%time": STAMPS, "field.header.seq": range(ROWS), "field.header.stamp": STAMPS}
ROSTOPIC |= {f"field.name{j}": ["joint"] * ROWS for j in range(N)} | block("field.position{}", Q)
ROSTOPIC |= block("field.velocity{}", DQ) | block("field.effort{}", TAU)
KUKA = {"Zeit [ms]": T * 1e3} | block("Sollposition_A{} [Grad]", Q * 57.0, 1)
TRACE = KUKA | block("Istposition_A{} [Grad]", np.rad2deg(Q), 1) | block("Iststrom_A{} [A]", CURRENTS, 1)
SYSTEM = KUKA | block("$AXIS_ACT_MEAS.A{}", np.rad2deg(Q), 1) | block("$TORQUE_AXIS_ACT[{}]", TAU, 1)
ABB = {"Time [s]": T} | block("position_{} [deg]", np.rad2deg(Q), 1) | block("torque_ref_{}", CURRENTS, 1)
ABB |= block("speed_ref_{}", DQ, 1)
ISAAC = {"sim_time": T} | block("joint_pos[{}]", Q) | block("joint_vel[{}]", DQ) | block("applied_torque[{}]", TAU)
ISAAC |= block("computed_torque[{}]", TAU * 2.0)
READ = {
    "UR, currents": (rtde(actual_current=CURRENTS), " ", GAINS, ["UR's RTDE", "i is actual_current_{}"]),
    "UR, torques": (rtde(actual_current=0.1 * TAU, actual_current_as_torque=TAU), ",", None, []),
    "libfranka": (FRANKA, ",", None, ["tau is state.tau_J[{}], ", "not state.q_d[{}], cmd.tau_J_d[{}]"]),
    "rostopic": (ROSTOPIC, ",", None, ["rostopic"]),
    "KUKA's trace": (TRACE, ";", GAINS, []),
    "KUKA's variables": (SYSTEM, ";", None, []),
    "ABB": (ABB, "\t", GAINS, ["i is torque_ref_{}, not speed_ref_{}"]),
    "Isaac": (ISAAC, ",", None, ["not computed_torque[{}]"]),
}


@pytest.mark.parametrize("recorder", READ)
def test_a_recorders_log_is_known_by_its_columns(tmp_path, recorder):
    columns, separator, gains, words = READ[recorder]
    path = save(tmp_path / "log.csv", text(columns, separator))
    log, said = read(path, gains)
    assert_same(log, (without(RECORDED, "dq") if log.dq is None else RECORDED) | {"t": log.t}, atol=1e-9)
    np.testing.assert_allclose(log.t - log.t[0], T, atol=1e-6)
    assert all(word in said for word in words), said
    if gains:
        assert "no gains are given" in refusal(path)


def test_what_a_recorder_lacks_is_said_with_what_it_has(tmp_path):
    said = refusal(save(tmp_path / "log.csv", rtde()))
    assert "timestamp (t), target_q_{} (not used), target_moment_{} (not used), actual_q_{} (q), " in said
    assert "record actual_current too" in said


def lerobot(lengths, fixed=False, **efforts):
    """Episodes of one length after the other, each from time 0; the state holds a gripper too."""
    state = np.column_stack([Q, 0.5 * T])
    rows = np.concatenate([np.arange(length) for length in lengths])
    columns = {"action": state + 0.1, "observation.state": state}
    columns |= {f"observation.{name}": np.column_stack([values, T]) for name, values in efforts.items()}
    kind = pa.list_(pa.float64(), N + 1) if fixed else pa.list_(pa.float64())
    arrays = {name: pa.array(values[rows].tolist(), kind) for name, values in columns.items()}
    arrays["observation.images.top"] = pa.array([{"bytes": b"x", "path": "y"}] * len(rows))
    episodes = np.repeat(np.arange(len(lengths)), lengths)
    numbers = {"timestamp": rows / 100.0, "frame_index": rows, "episode_index": episodes, "index": np.arange(len(rows))}
    return pa.table(arrays | {name: pa.array(values) for name, values in numbers.items()})


@pytest.mark.parametrize("fixed", [False, True])
def test_data_sets_of_lerobot(tmp_path, fixed):
    """Episodes are recordings; one that is too short is left out."""
    parquet.write_table(lerobot([120, 20, 70], fixed, velocity=DQ, effort=TAU), tmp_path / "a.parquet")
    log, said = read(tmp_path / "a.parquet")
    assert log.n_joints == N + 1
    for word in ("as in LeRobot", "units are not stated", "rad, rad/s and N m", "not action{}"):
        assert word in said
    arm = {"q": "observation.state{1-3}", "dq": "observation.velocity{1-3}", "tau": "observation.effort{1-3}"}
    log, _ = read(tmp_path / "a.parquet", columns=arm)
    assert [(piece.start_row, piece.stop_row, piece.t[0]) for piece in log.pieces] == [(0, 120, 0.0), (120, 190, 0.0)]
    assert log.pieces[1].source.endswith("a.parquet, episode_index 2")
    np.testing.assert_array_equal(log.effort[120:], TAU[:70])
    np.testing.assert_array_equal(log.dq[:120], DQ)


def test_data_sets_of_lerobot_that_cannot_be_used(tmp_path):
    parquet.write_table(lerobot([ROWS], True), tmp_path / "a.parquet")
    said = refusal(tmp_path / "a.parquet")
    assert "among action{} (not used), observation.state{} (q), " in said
    assert said.endswith("; record observation.effort too; action holds commands, no efforts")
    parquet.write_table(lerobot([30, 40], effort=TAU), tmp_path / "b.parquet")
    assert "holds 2 recordings of episode_index, none with 50 rows" in refusal(tmp_path / "b.parquet")
