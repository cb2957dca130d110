"""Logs of well-known recorders, by samples of our own: known by their columns, with the units that they state."""

import warnings

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from bayesid.errors import InputError
from bayesid.log.log import read_log

ROWS, N = 120, 3


@pytest.fixture
def recorded():
    """A motion of three joints, no two alike."""
    rng = np.random.default_rng(5)
    t = np.arange(ROWS) / 100.0
    w, phase = rng.uniform(3.0, 6.0, N), rng.uniform(0.0, 6.0, N)
    q = np.sin(w * t[:, None] + phase)
    return {"t": t, "q": q, "dq": w * np.cos(w * t[:, None] + phase), "tau": rng.normal(size=(ROWS, N)) * [30, 7, 2]}


def columns_of(values, pattern, start=0):
    """Columns by name, a number a joint."""
    return {pattern.replace("{}", str(j + start)): column for j, column in enumerate(np.atleast_2d(values.T))}


def write(path, columns, separator=","):
    rows = [separator.join(columns), *(separator.join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(rows))
    return path


def read(source, *arguments, **options):
    """A log, and what was said about it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        log = read_log(source, *arguments, **options)
    return log, " ".join(str(one.message) for one in said)


def assert_same(log, recorded, **other):
    expected = recorded | other
    np.testing.assert_allclose(log.t - log.t[0], expected["t"], atol=1e-9)
    np.testing.assert_allclose(log.q, expected["q"], atol=1e-9)
    np.testing.assert_allclose(log.effort, expected["tau"], atol=1e-9)
    if log.dq is not None:
        np.testing.assert_allclose(log.dq, expected["dq"], atol=1e-9)


def refusal(source, **options):
    with pytest.raises(InputError) as caught:
        read_log(source, **options)
    return caught.value.on_command_line


# ---------------------------------------------------------------------------------------------------------------
# Tables of text
# ---------------------------------------------------------------------------------------------------------------
def rtde(recorded, *efforts):
    columns = {"timestamp": 5000.0 + recorded["t"]}
    columns |= columns_of(recorded["q"] + 0.01, "target_q_{}") | columns_of(recorded["tau"] * 1.1, "target_moment_{}")
    columns |= columns_of(recorded["q"], "actual_q_{}") | columns_of(recorded["dq"], "actual_qd_{}")
    for name, factor in efforts:
        columns |= columns_of(recorded["tau"] * factor, f"{name}_{{}}")
    return columns | {"robot_mode": np.full(ROWS, 7)} | columns_of(recorded["q"] + 9.0, "actual_TCP_pose_{}")


@pytest.mark.parametrize("separator", [" ", ","])
def test_recordings_of_rtde(tmp_path, recorded, separator):
    """Of UR's own client, with spaces, and of ur_rtde: currents, and the torques of newer controllers."""
    gains = [2.0, 3.0, 4.0]
    path = write(tmp_path / "a.csv", rtde(recorded, ("actual_current", 1.0)), separator)
    log, said = read(path, gains)
    assert_same(log, recorded, tau=recorded["tau"] * gains)
    assert "as UR's RTDE has it, t is timestamp, q is actual_q_{}, i is actual_current_{}, dq is actual_qd_{}" in said
    assert "not target_q_{}, target_moment_{}" in said
    assert "the log holds currents but no gains are given" in refusal(path)
    both = write(
        tmp_path / "b.csv", rtde(recorded, ("actual_current", 0.1), ("actual_current_as_torque", 1.0)), separator
    )
    assert_same(read(both)[0], recorded)
    assert_same(read(both, gains)[0], recorded, tau=0.1 * recorded["tau"] * gains)
    said = refusal(write(tmp_path / "c.csv", rtde(recorded), separator))
    assert "among timestamp (t), target_q_{} (not used), target_moment_{} (not used), actual_q_{} (q), " in said
    assert "; record actual_current too; target_moment and target_current are the controller's model" in said


def test_logs_of_libfranka(tmp_path, recorded):
    """Its time is in ms, and spaces stand behind some commas."""
    columns = {"time": np.round(recorded["t"] * 1e3), " success_rate": np.ones(ROWS)}
    columns |= columns_of(recorded["q"], " state.q[{}]") | columns_of(recorded["q"] + 0.02, "state.q_d[{}]")
    columns |= columns_of(recorded["dq"], " state.dq[{}]") | columns_of(recorded["tau"], "state.tau_J[{}]")
    columns |= columns_of(recorded["tau"] * 0.1, "state.tau_ext_hat_filtered[{}]")
    columns |= columns_of(recorded["q"] + 0.02, "cmd.q_d[{}]") | columns_of(recorded["tau"] + 1.0, "cmd.tau_J_d[{}]")
    log, said = read(write(tmp_path / "a.csv", columns))
    assert_same(log, recorded)
    assert "tau is state.tau_J[{}], " in said
    assert "not state.q_d[{}], state.tau_ext_hat_filtered[{}], cmd.q_d[{}], cmd.tau_J_d[{}]" in said


@pytest.mark.parametrize(
    ("q", "dq", "tau"),
    [("field.position{}", "field.velocity{}", "field.effort{}"), ("field.q{}", "field.dq{}", "field.tau_J{}")],
)
def test_tables_of_rostopic(tmp_path, recorded, q, dq, tau):
    stamps = [str(1_600_000_000_000_000_000 + 10_000_000 * k) for k in range(ROWS)]
    columns = {"%time": stamps, "field.header.seq": range(ROWS), "field.header.stamp": stamps}
    columns |= {f"field.name{j}": ["joint"] * ROWS for j in range(N)} | columns_of(recorded["q"], q)
    columns |= columns_of(recorded["dq"], dq) | columns_of(recorded["tau"], tau)
    log, said = read(write(tmp_path / "a.csv", columns))
    assert_same(log, recorded, t=log.t - log.t[0])
    np.testing.assert_allclose(np.diff(log.t), 0.01, atol=1e-6)
    assert "as rostopic's table of" in said


@pytest.mark.parametrize(
    ("q", "effort", "gains"),
    [
        ("Istposition_A{} [Grad]", "Istmoment_A{} [Nm]", None),
        ("Istposition A{} (°)", "Iststrom A{} (A)", [1.0] * N),
        ("$AXIS_ACT_MEAS.A{}", "$TORQUE_AXIS_ACT[{}]", None),
        ("$AXIS_ACT_MEAS.A{}", "$CURR_ACT[{}]", [1.0] * N),
    ],
)
def test_traces_of_kuka(tmp_path, recorded, q, effort, gains):
    """Of the oscilloscope, with the units that the trace states, and system variables, whose units KRL states."""
    columns = {"Zeit [ms]": recorded["t"] * 1e3} | columns_of(recorded["q"] * 57.0, "Sollposition_A{} [Grad]", 1)
    columns |= columns_of(np.rad2deg(recorded["q"]), q, 1) | columns_of(recorded["tau"], effort, 1)
    assert_same(read(write(tmp_path / "a.csv", columns, ";"), gains)[0], recorded)


def test_test_signals_of_abb(tmp_path, recorded):
    """torque_ref is the motor's: gear ratios make it the joint's, and without them it is refused."""
    columns = {"Time [s]": recorded["t"]} | columns_of(np.rad2deg(recorded["q"]), "position_{} [deg]", 1)
    columns |= columns_of(recorded["tau"] / 100.0, "torque_ref_{}", 1) | columns_of(recorded["dq"], "speed_ref_{}", 1)
    path = write(tmp_path / "a.txt", columns, "\t")
    log, said = read(path, [100.0] * N)
    assert_same(log, recorded)
    assert log.dq is None
    assert "i is torque_ref_{}, not speed_ref_{}" in said
    assert "no gains are given" in refusal(path)


@pytest.mark.parametrize(
    ("q", "dq", "tau", "beside"),
    [
        ("joint_pos[{}]", "joint_vel[{}]", "applied_torque[{}]", "computed_torque[{}]"),
        ("joint_positions_{}", "joint_velocities_{}", "measured_joint_efforts_{}", "applied_joint_efforts_{}"),
        ("robot.dof_pos_{}", "robot.dof_vel_{}", "robot.dof_force_{}", "robot.dof_pos_target_{}"),
    ],
)
def test_tables_of_isaac(tmp_path, recorded, q, dq, tau, beside):
    columns = {"sim_time": recorded["t"]} | columns_of(recorded["q"], q) | columns_of(recorded["dq"], dq)
    columns |= columns_of(recorded["tau"], tau) | columns_of(recorded["tau"] * 2.0, beside)
    log, said = read(write(tmp_path / "a.csv", columns))
    assert_same(log, recorded)
    assert f"not {beside}" in said


def test_names_that_nothing_else_could_mean_need_no_word(tmp_path, recorded):
    columns = {"time": recorded["t"]} | columns_of(recorded["q"], "q_{}") | columns_of(recorded["tau"], "tau_{}")
    log, said = read(write(tmp_path / "a.csv", columns | {"mode": np.zeros(ROWS)}))
    assert said == ""
    assert_same(log, recorded)


def test_what_a_user_names_counts_before_a_convention(tmp_path, recorded):
    path = write(tmp_path / "a.csv", rtde(recorded, ("actual_current", 1.0)))
    assert_same(read(path, columns={"tau": "target_moment_{}"})[0], recorded, tau=recorded["tau"] * 1.1)


# ---------------------------------------------------------------------------------------------------------------
# Parquet
# ---------------------------------------------------------------------------------------------------------------
def lerobot(recorded, lengths, fixed, **efforts):
    """Episodes of one length after the other, each from time 0; the state holds a gripper too."""
    state = np.column_stack([recorded["q"], 0.5 * recorded["t"]])
    rows = np.concatenate([np.arange(length) for length in lengths])
    columns = {"action": state + 0.1, "observation.state": state}
    columns |= {f"observation.{name}": np.column_stack([values, recorded["t"]]) for name, values in efforts.items()}
    kind = pa.list_(pa.float64(), N + 1) if fixed else pa.list_(pa.float64())
    arrays = {name: pa.array(values[rows].tolist(), kind) for name, values in columns.items()}
    arrays["observation.images.top"] = pa.array([{"bytes": b"x", "path": "y"}] * len(rows))
    episodes = np.repeat(np.arange(len(lengths)), lengths)
    numbers = {"timestamp": rows / 100.0, "frame_index": rows, "episode_index": episodes, "index": np.arange(len(rows))}
    return pa.table(arrays | {name: pa.array(values) for name, values in numbers.items()})


ARM = {"q": "observation.state{1-3}", "dq": "observation.velocity{1-3}", "tau": "observation.effort{1-3}"}


@pytest.mark.parametrize("fixed", [False, True])
def test_data_sets_of_lerobot(tmp_path, recorded, fixed):
    """Episodes are recordings; one that is too short is left out."""
    table = lerobot(recorded, [120, 20, 70], fixed, velocity=recorded["dq"], effort=recorded["tau"])
    parquet.write_table(table, tmp_path / "a.parquet")
    log, said = read(tmp_path / "a.parquet")
    assert log.n_joints == N + 1
    assert "as LeRobot has it" in said
    assert "it states no units, so rad, rad/s and N m are taken" in said
    assert "not action{}" in said
    log, _ = read(tmp_path / "a.parquet", columns=ARM)
    assert [(piece.start_row, piece.stop_row, piece.t[0]) for piece in log.pieces] == [(0, 120, 0.0), (120, 190, 0.0)]
    assert log.pieces[1].source.endswith("a.parquet, episode_index 2")
    np.testing.assert_array_equal(log.effort[120:], recorded["tau"][:70])
    np.testing.assert_array_equal(log.dq[:120], recorded["dq"])


def test_a_data_set_without_efforts(tmp_path, recorded):
    parquet.write_table(lerobot(recorded, [ROWS], True), tmp_path / "a.parquet")
    said = refusal(tmp_path / "a.parquet")
    assert (
        "among action{} (not used), observation.state{} (q), observation.images.top (not used), timestamp (t), " in said
    )
    assert said.endswith("; record observation.effort too; action holds commands, no efforts")


def test_data_sets_of_short_episodes_only(tmp_path, recorded):
    parquet.write_table(lerobot(recorded, [30, 40], False, effort=recorded["tau"]), tmp_path / "a.parquet")
    assert "holds 2 recordings of episode_index, none with 50 rows" in refusal(tmp_path / "a.parquet")


def test_lists_of_other_recorders(tmp_path, recorded):
    arrays = {"joint_pos": recorded["q"], "joint_vel": recorded["dq"], "applied_torque": recorded["tau"]}
    columns = {"sim_time": pa.array(recorded["t"])} | {k: pa.array(v.tolist()) for k, v in arrays.items()}
    parquet.write_table(pa.table(columns), tmp_path / "a.parquet")
    assert_same(read(tmp_path / "a.parquet")[0], recorded)
    columns["joint_pos"] = pa.array([[1.0], *recorded["q"][1:].tolist()])
    parquet.write_table(pa.table(columns), tmp_path / "b.parquet")
    assert "column joint_pos: holds lists of 1 to 3 values" in refusal(tmp_path / "b.parquet")


def test_a_recorders_names_do_not_vouch_for_units(tmp_path, recorded):
    """Somebody may have put degrees or milliseconds there: what shows in any log shows in these too."""
    gains, columns = [1.0] * N, rtde(recorded | {"q": 600.0 * recorded["q"]}, ("actual_current", 1.0))
    columns = {name: values for name, values in columns.items() if "qd" not in name}
    assert "are they degrees?" in refusal(write(tmp_path / "a.csv", columns), gains=gains)
    columns = rtde(recorded, ("actual_current", 1.0)) | {"timestamp": 1e3 * recorded["t"]}
    assert "milliseconds?" in refusal(write(tmp_path / "b.csv", columns), gains=gains)
