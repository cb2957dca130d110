"""One log in every format comes back as its CSV does; and what is wrong with a file is said in one line."""

import shutil
import sys
import warnings
from datetime import datetime, timedelta

import numpy as np
import pyarrow as pa
import pytest
from conftest import real_log
from log_files import Bag, assert_same, flat, refusal, save, save_hdf5, save_matlab, save_parquet, text, without

from bayesid.log.log import find_logs, read_log

ROWS = 64
N = 3
NAMES = ("base_yaw", "arm_lift", "wrist_roll")
J = ["j1", "j2", "j3"]


@pytest.fixture
def recorded():
    """Columns of a log of three joints, no two alike."""
    rng = np.random.default_rng(7)
    t = 12.25 + np.cumsum(rng.integers(3, 6, ROWS)) * 1e-3
    offset = np.array([0.4, -1.5, 0.9])
    blocks = {"q": offset + 0.6 * rng.normal(size=(ROWS, N)), "dq": 0.3 + rng.normal(size=(ROWS, N))}
    return {"t": t, **blocks, "tau": rng.normal(size=(ROWS, N)) * [30.0, 9.0, 0.7]}


# ---------------------------------------------------------------------------------------------------------------
# Parquet
# ---------------------------------------------------------------------------------------------------------------
def test_parquet_is_known_by_what_it_holds(tmp_path, recorded):
    name = "log.csv"
    columns = {"mode": ["auto"] * ROWS, **flat(recorded), "q9_raw": [None] * ROWS}
    log = read_log(save_parquet(tmp_path / name, columns))
    assert_same(log, recorded)
    assert log.source == str(tmp_path / name)


@pytest.mark.parametrize("unit", ["s", "ns"])
def test_parquet_of_whole_numbers_and_time_stamps(tmp_path, unit):
    """Since 1970 a float counts in steps of 2.4e-7 s."""
    rng = np.random.default_rng(1)
    q, tau = rng.integers(-3, 4, ROWS), rng.integers(-90, 90, ROWS)
    start, step = datetime(2026, 2, 3, 4, 5, 6), timedelta(seconds=1) if unit == "s" else timedelta(milliseconds=4)
    times = [start + k * step for k in range(ROWS)]
    columns = {"q1": pa.array(q, pa.int8()), "tau1": pa.array(tau, pa.int32())}
    columns["t"] = pa.array(times, pa.timestamp(unit))
    log = read_log(save_parquet(tmp_path / "log.parquet", columns))
    since_1970 = (start - datetime(1970, 1, 1)).total_seconds()
    expected = np.arange(ROWS) * step.total_seconds()
    np.testing.assert_allclose(log.t, since_1970 + expected, rtol=0.0, atol=2.4e-7)
    np.testing.assert_array_equal(log.q[:, 0], q)
    np.testing.assert_array_equal(log.effort[:, 0], tau)
    columns["t"] = pa.array([time - start for time in times], pa.duration(unit))
    log = read_log(save_parquet(tmp_path / "since.parquet", columns))
    np.testing.assert_allclose(log.t, expected, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("q2", [*[0.5] * 9, None, *[0.7] * (ROWS - 10)], "log.parquet, row 10: column q2 holds no value; "),
        ("dq3", [*[0.5] * 4, np.inf, *[0.7] * (ROWS - 5)], "log.parquet, row 5: column dq3 holds inf; "),
        ("q1", ["far"] * ROWS, "log.parquet, column q1: holds string, not numbers; "),
        ("q1", pa.array(range(ROWS), pa.timestamp("us")), "column q1: holds timestamp[us], not numbers; "),
        ("t", np.zeros(ROWS), "log.parquet, column t: time never advances; "),
    ],
)
def test_parquet_with_a_bad_column(tmp_path, recorded, name, values, said):
    assert said in refusal(save_parquet(tmp_path / "log.parquet", flat(recorded) | {name: values}))


def test_parquet_that_cannot_be_used(tmp_path, recorded):
    path = save_parquet(tmp_path / "log.parquet", without(flat(recorded), "tau2"))
    assert "log.parquet: column tau2 is missing; add it; q1..q3 are there" in refusal(path)
    path.write_bytes(path.read_bytes()[:-20])
    assert "log.parquet: is damaged (" in refusal(path)


# ---------------------------------------------------------------------------------------------------------------
# MATLAB
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("write", [save_matlab, save_hdf5])
@pytest.mark.parametrize("form", ["matrices", "transposed", "vectors", "struct", "aliases", "no velocities"])
def test_matlab(tmp_path, recorded, write, form):
    kept = without(recorded, "dq") if form == "no velocities" else recorded
    variables = {
        "matrices": kept | {"comment": np.array([[67.0]]), "other": {"t": kept["t"]}},
        "transposed": {"t": kept["t"][:, None], **{name: kept[name].T for name in kept if name != "t"}},
        "vectors": flat(kept),
        "struct": {"rig": {"rate": 250.0}, "log": kept},
        "aliases": {"time": kept["t"], "q": kept["q"], "qd": recorded["dq"], "torque": kept["tau"]},
        "no velocities": kept,
    }[form]
    assert_same(read_log(write(tmp_path / "log.mat", variables)), kept)


def test_matlab_currents_of_one_joint(tmp_path, recorded):
    for write in (save_matlab, save_hdf5):
        path = write(tmp_path / "log.mat", {"t": recorded["t"], "q": recorded["q"][:, 1], "i": recorded["tau"][:, 2]})
        np.testing.assert_array_equal(read_log(path, gains=[3.5]).effort[:, 0], recorded["tau"][:, 2] * 3.5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q": None}, "there is no t with a q among t, dq, tau; save t (N x 1), q (N x n)"),
        ({"tau": None}, "column tau1 (or i1 with gains) is missing"),
        ({"q": np.ones((ROWS - 1, 3))}, "variable q has shape (63, 3) for 64 instants"),
        ({"q": np.ones((2, 3, ROWS))}, "variable q has shape (2, 3, 64) for 64 instants"),
        ({"q": np.ones((ROWS, ROWS))}, "variable q is square: its rows or its columns may be instants"),
        ({"t": np.ones((ROWS, 2))}, "variable t has shape (64, 2)"),
        ({"time": np.arange(ROWS)}, "variables t and time may be the same"),
        ({"q2": np.arange(ROWS)}, "variables q and q2 may be the same"),
        ({"dq": np.full((ROWS, 3), np.nan)}, "row 1: column dq1 holds nan"),
    ],
)
def test_matlab_that_cannot_be_used(tmp_path, recorded, change, said):
    variables = {name: value for name, value in (recorded | change).items() if value is not None}
    assert said in refusal(save_matlab(tmp_path / "log.mat", variables))


@pytest.mark.parametrize("write", [save_matlab, save_hdf5])
def test_two_structs_and_damaged_files(tmp_path, recorded, write):
    path = write(tmp_path / "log.mat", {"monday": recorded, "tuesday": recorded})
    assert "log.mat: structs monday and tuesday both hold a log; " in refusal(path)
    path.write_bytes(path.read_bytes()[:700])
    assert "log.mat: cannot be read as a MATLAB file (" in refusal(path)
    path.write_bytes(b"not MATLAB at all")
    assert "save it again with save(..., '-v7')" in refusal(path)


# ---------------------------------------------------------------------------------------------------------------
# ROS 2
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture
def bag():
    return Bag()


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag(tmp_path, recorded, bag, storage):
    path = bag.write(tmp_path / "bag", {"/joint_states": bag.states(recorded, NAMES), "/talk": []}, storage)
    with pytest.warns(UserWarning, match="the order base_yaw, arm_lift, wrist_roll; if that is not from base to tip"):
        assert_same(read_log(path), recorded, atol=1e-15)
    [file] = [one for one in path.iterdir() if one.suffix != ".yaml"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        log = read_log(file, joints=[NAMES[2], NAMES[0]])
    assert_same(log, {name: values if name == "t" else values[:, [2, 0]] for name, values in recorded.items()}, 1e-15)
    assert find_logs([str(tmp_path / "b*"), file]) == [path, file]
    assert find_logs([str(tmp_path / "**")]) == [path]


def test_a_bag_without_definitions(tmp_path, recorded, bag):
    """As Humble writes it: neither the table of definitions nor hashes of types."""
    apsw = pytest.importorskip("apsw")
    path = bag.write(tmp_path / "bag", {"/joint_states": bag.states(recorded, J)})
    [file] = path.glob("*.db3")
    connection = apsw.Connection(str(file))
    connection.execute("DROP TABLE message_definitions")
    connection.execute("UPDATE schema SET schema_version = 3")
    connection.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    connection.close()
    assert_same(read_log(file), recorded, atol=1e-15)


@pytest.mark.filterwarnings("error")
def test_numbers_tell_the_order_of_joints(tmp_path, recorded, bag):
    """In the messages the second joint stands first, and 10 after 9."""
    order = [1, 2, 0]
    stated = {name: values if name == "t" else values[:, order] for name, values in recorded.items()}
    path = bag.write(tmp_path / "bag", {"/states": bag.states(stated, ["arm2_joint9", "arm2_joint10", "arm2_joint8"])})
    assert_same(read_log(path), recorded, atol=1e-15)


def test_velocities_that_are_not_known_are_left_out(tmp_path, recorded, bag):
    for name, dq in {"none": None, "nan": np.full((ROWS, N), np.nan)}.items():
        given = without(recorded, "dq") if dq is None else recorded | {"dq": dq}
        path = bag.write(tmp_path / name, {"/states": bag.states(given, J)})
        assert_same(read_log(path), without(recorded, "dq"), atol=1e-15)


def test_stamps_that_are_zero(tmp_path, recorded, bag):
    names = J
    path = bag.write(tmp_path / "bag", {"/states": bag.states(recorded, names, stamped=False)})
    with pytest.warns(UserWarning, match="the stamps are zero; time is when the bag received the messages"):
        log = read_log(path)
    assert_same(log, recorded | {"t": recorded["t"] + 1e-3}, atol=1e-12)
    mixed = [*bag.states(recorded, names)[:5], *bag.states(recorded, names, stamped=False)[5:]]
    path = bag.write(tmp_path / "mixed", {"/states": mixed})
    assert "mixed, topic /states, message 6: time runs backwards, from 12.2" in refusal(path)
    simulated = recorded | {"t": recorded["t"] - recorded["t"][0]}
    path = bag.write(tmp_path / "simulated", {"/states": bag.states(simulated, names)})
    assert_same(read_log(path), simulated, atol=1e-15)


def test_which_topic(tmp_path, recorded, bag):
    names = J
    states, commands = bag.states(recorded, names), bag.states(without(recorded, "tau"), names)
    path = bag.write(tmp_path / "bag", {"/commands": commands, "/states": states})
    assert_same(read_log(path), recorded, atol=1e-15)
    assert "topic /commands, message 1: holds no effort of each joint; " in refusal(path, topic="/commands")
    assert "--topic: '/other' is no topic of joint states; give /commands, /states" in refusal(path, topic="/other")
    scaled = recorded | {"tau": 2.0 * recorded["tau"]}
    path = bag.write(tmp_path / "two", {"/left": states, "/right": bag.states(scaled, names)})
    assert "2 of the topics /left, /right have efforts; say which with --topic" in refusal(path)
    assert_same(read_log(path, topic="/right"), scaled, atol=1e-15)
    path = bag.write(tmp_path / "no", {"/left": commands, "/right": commands})
    assert "none of the topics /left, /right has efforts; record one with efforts" in refusal(path)


def test_a_topic_of_several_publishers(tmp_path, recorded, bag):
    gripper = [bag.state(t + 5e-4, ["finger1", "finger2"], [0.1, t], [], []) for t in recorded["t"]]
    path = bag.write(
        tmp_path / "bag", {"/states": sorted([*bag.states(recorded, NAMES), *gripper], key=lambda one: one[0])}
    )
    assert "there are messages of base_yaw, arm_lift, wrist_roll, and of finger1, finger2; say which" in refusal(path)
    assert_same(read_log(path, joints=NAMES), recorded, atol=1e-15)
    expected = "no message holds all of the joints elbow; give --joints those of base_yaw, arm_lift, wrist_roll, fing"
    assert expected in refusal(path, joints=["elbow"])
    assert "--joints: a joint is named twice; " in refusal(path, joints=["base_yaw", "base_yaw"])


def test_incomplete_messages(tmp_path, recorded, bag):
    states = bag.states(recorded, J)
    for k, (q, tau, said) in enumerate(
        (
            ([0.1], [1.0] * 3, "message 3: holds no position of each joint; "),
            ([0.1] * 3, [1.0] * 2, "message 3: holds no effort of each joint; "),
            ([0.1, np.nan, 0.2], [1.0] * 3, "message 3: column q2 (j2) holds nan; "),
        )
    ):
        states[2] = bag.state(recorded["t"][2], J, q, [], tau)
        assert said in refusal(bag.write(tmp_path / f"bag{k}", {"/states": states}))


def test_bags_that_cannot_be_read(tmp_path, recorded, bag):
    assert "holds no message of sensor_msgs/msg/JointState" in refusal(bag.write(tmp_path / "talk", {"/talk": []}))
    for storage in ("mcap", "sqlite3"):
        path = bag.write(tmp_path / storage, {"/states": bag.states(recorded, NAMES)}, storage)
        [file] = [one for one in path.iterdir() if one.suffix != ".yaml"]
        file.write_bytes(file.read_bytes()[:900])
        assert f"{path}: cannot be read as a bag (" in refusal(path)
        assert f"{file}: cannot be read as a bag (" in refusal(file)
        (path / "metadata.yaml").unlink()
        assert f"{path}: is a bag without its metadata.yaml; " in refusal(path)


def test_without_rosbags(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    (tmp_path / "metadata.yaml").touch()
    assert refusal(tmp_path).endswith("bags need the library rosbags; pip install 'bayesid[ros]'")


def test_only_bags_have_topics_and_joints(tmp_path, recorded):
    path = save(tmp_path / "log.csv", flat(recorded))
    for option in ({"topic": "/states"}, {"joints": ["j1"]}):
        [name] = option
        said = f"log.csv: is a CSV table, which has no {name}; leave --{name} out"
        assert said in refusal(path, **option)


# ---------------------------------------------------------------------------------------------------------------
# KUKA
# ---------------------------------------------------------------------------------------------------------------
def kuka(recorded, position="AIPos.A", effort="MACur.A", velocity="AxisVel.A", clock="IPOC"):
    """A controller's columns, among others; efforts in N m and in A are the same numbers here."""
    blocks = {position: np.rad2deg(recorded["q"]), velocity: np.rad2deg(recorded["dq"]), effort: recorded["tau"]}
    columns = {"RIst.X": np.full(ROWS, 812.5), clock: np.round(recorded["t"] * 1e3)}
    for name, block in blocks.items():
        columns |= {f"{name}{j + 1}": values for j, values in enumerate(block.T)} if name else {}
    return columns | {"EIPos.E1": np.zeros(ROWS), "Digout.o1": np.ones(ROWS)}


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ",")])
def test_kuka_in_any_dialect(tmp_path, recorded, separator, decimal):
    path = save(tmp_path / "rsi.csv", text(kuka(recorded), separator, decimal))
    log = read_log(path, gains=[2.0, -3.0, 0.5])
    assert_same(log, recorded | {"tau": recorded["tau"] * [2.0, -3.0, 0.5]}, atol=1e-13)
    assert "rsi.csv: the log holds currents but no gains are given" in refusal(path)


@pytest.mark.parametrize(
    "names",
    [
        {"position": "AIPos_A", "effort": "GearTorque_A"},
        {"position": "aiposa", "effort": "axistorque", "velocity": "axisvel"},
        {"position": "A", "effort": "Torque.A"},
        {"position": "rx.AIPos.A", "effort": "rx.Torque.A", "velocity": "rx.AxisVel.A", "clock": "rx.IPOC"},
        {"position": "Receive.AIPos.A", "clock": "Send.IPOC"},
        {"clock": "Time[ms]"},
    ],
)
def test_names_of_kuka(tmp_path, recorded, names):
    columns = kuka(recorded, **{"effort": "Torque.A"} | names)
    path = save(tmp_path / "rsi.csv", text(columns, ";", ","))
    assert_same(read_log(path), recorded, atol=1e-13)


def test_what_kuka_prefers(tmp_path, recorded):
    """Actual positions to commanded ones, the controller's clock to others, torques to currents, one prefix."""
    more = {f"ASPos.A{j}": np.zeros(ROWS) for j in (1, 2, 3)} | {f"A{j}": np.ones(ROWS) for j in (1, 2, 3)}
    more |= {"Time": np.ones(ROWS), "Send.IPOC": np.ones(ROWS), "Receive.IPOC": np.round(recorded["t"] * 1e3)}
    more |= {f"MACur.A{j}": np.full(ROWS, np.nan) for j in (1, 2, 3)}
    more |= {f"Send.AKorr.A{j}": np.full(ROWS, np.nan) for j in (1, 2, 3)}
    columns = without(kuka(recorded, "Receive.AIPos.A", "Torque.A"), "IPOC")
    assert_same(read_log(save(tmp_path / "rsi.csv", more | columns)), recorded, atol=1e-13)


def test_commanded_positions_of_kuka_are_warned_of(tmp_path, recorded):
    path = save(tmp_path / "rsi.csv", kuka(recorded, "ASPos.A", "Torque.A"))
    with pytest.warns(UserWarning, match="positions are commanded ones"):
        assert_same(read_log(path), recorded, atol=1e-13)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"AIPos.A1": None, "AIPos.A2": None, "AIPos.A3": None}, "there are no axis positions among RIst.X, IPOC, "),
        ({"IPOC": None}, "there is no time among RIst.X, AIPos.A1, AIPos.A2, "),
        (
            {"MACur.A1": None, "MACur.A2": None, "MACur.A3": None},
            "there are neither motor currents nor torques of the axes among RIst.X, IPOC, AIPos.A1, AIPos.A2, "
            "AIPos.A3, AxisVel.A1, AxisVel.A2, AxisVel.A3, EIPos.E1, Digout.o1; needed are IPOC or Time, AIPos.A1..",
        ),
        ({"MACur.A2": None}, "row 1: column MACur.A1 has none beside it for axis 2; add it: there are positions of 3"),
        ({"R2.AIPos.A1": 1.0, "R2.AIPos.A2": 1.0, "R2.AIPos.A3": 1.0}, "AIPos.A1 and R2.AIPos.A1 hold the same"),
        ({"Torque.A1": 1.0, "GearTorque.A1": 1.0}, "row 1: Torque.A1 and GearTorque.A1 are torques; leave all but one"),
        (
            {"IPOC": None, "Time": 4.0},
            "column Time spans 252 s with steps of 4 s: milliseconds?; name the column Time[ms]",
        ),
        ({"MACur.A2": None, "MACur.A2[%]": np.nan}, "row 2: column MACur.A2[%] holds nan"),
        ({"AxisVel.A1": None, "AxisVel.A1[%]": 1.0}, "column AxisVel.A1[%] is in a unit that is not known; give it in"),
    ],
)
def test_kuka_that_cannot_be_used(tmp_path, recorded, change, said):
    columns = {name: values for name, values in kuka(recorded).items() if name not in change}
    columns |= {name: np.arange(1, ROWS + 1) * value for name, value in change.items() if value is not None}
    assert said in refusal(save(tmp_path / "rsi.csv", text(columns, ";", ",")), gains=[1.0, 1.0, 1.0])


def test_a_user_names_the_columns_of_kuka(tmp_path, recorded):
    """The time alone, in a unit that the header does not state, or all."""
    path = save(tmp_path / "rsi.csv", text(kuka(recorded, effort="Torque.A", clock="Time"), ";", ","))
    assert_same(read_log(path, columns={"t": "Time[ms]"}), recorded, atol=1e-13)
    columns = {"t": "Time [ms]", "q": "AIPos.A{}", "tau": "Torque.A{}", "dq": "AxisVel.A{} [deg/s]"}
    assert_same(read_log(path, columns=columns, degrees=True), recorded, atol=1e-13)


# ---------------------------------------------------------------------------------------------------------------
# Degrees
# ---------------------------------------------------------------------------------------------------------------
def in_degrees(recorded):
    return recorded | {name: np.rad2deg(recorded[name]) for name in ("q", "dq")}


@pytest.mark.parametrize("form", ["q1 (deg)", "q1_deg", "q1[°]"])
def test_degrees_by_the_header(tmp_path, recorded, form):
    columns = {}
    for name, values in flat(in_degrees(recorded)).items():
        speed = form.replace("deg", "deg_s" if "_" in form else "deg/s").replace("°", "°/s")
        pattern = form if name[0] == "q" else speed if name[0] == "d" else "q1"
        columns[pattern.replace("q1", name)] = values
    assert_same(read_log(save_parquet(tmp_path / "log.parquet", columns)), recorded, atol=1e-14)


def test_other_units_by_the_header(tmp_path, recorded):
    """A prismatic joint's beside a turning one's, in degrees by word of mouth."""
    columns = {
        "t[ms]": recorded["t"] * 1e3,
        "q1[mm]": recorded["q"][:, 0] * 1e3,
        "q2": np.rad2deg(recorded["q"][:, 1]),
        "dq1[m/s]": recorded["dq"][:, 0],
        "dq2[rpm]": recorded["dq"][:, 1] * 30.0 / np.pi,
        "tau1[N]": recorded["tau"][:, 0],
        "tau2[Nm]": recorded["tau"][:, 1],
    }
    log = read_log(save(tmp_path / "log.csv", columns), degrees=True)
    assert_same(log, {name: values if name == "t" else values[:, :2] for name, values in recorded.items()}, atol=1e-13)


def test_a_plain_name_comes_before_one_with_a_unit(tmp_path, recorded):
    columns = flat(recorded) | {"q1_deg": np.full(ROWS, np.nan), "tau1[Nm]": np.zeros(ROWS), "q2[ticks]": np.ones(ROWS)}
    assert_same(read_log(save(tmp_path / "log.csv", columns)), recorded)
    twice = without(columns, "q1") | {"q1[rad]": np.zeros(ROWS)}
    assert "row 1: column q1 appears twice" in refusal(save(tmp_path / "log.csv", twice))
    unknown = without(columns, "q2")
    assert "row 1: column q2 is missing" in refusal(save(tmp_path / "log.csv", unknown))


def test_degrees_by_word_of_mouth(tmp_path, recorded):
    columns = flat(in_degrees(recorded))
    for path in (
        save(tmp_path / "log.csv", columns),
        save_parquet(tmp_path / "log.parquet", columns),
        save_matlab(tmp_path / "log.mat", columns),
    ):
        assert_same(read_log(path, degrees=True), recorded, atol=1e-14)
        reach = np.abs(in_degrees(recorded)["q"]).max()
        expected = f"positions reach {reach:.4g}: are they degrees?; give --degrees, or --no-degrees if they are rad"
        assert expected in refusal(path)
        np.testing.assert_array_equal(read_log(path, degrees=False).q, in_degrees(recorded)["q"])


@pytest.mark.parametrize(
    ("reach", "refused"),
    [
        ([40.0], False),
        ([40.0, 13.0], True),
        ([40.0, 12.5], False),
        ([0.1, 40.0, 90.0], True),
        ([3.0, 3.0, 40.0], False),
        ([1.0, 1.0, 40.0, 40.0], False),
    ],
)
def test_positions_that_look_like_degrees(tmp_path, recorded, reach, refused):
    """Most joints, and two at least, beyond two turns, 12.57 rad: one that turns on and on is no sign of degrees."""
    n, q = len(reach), np.linspace(0.0, 1.0, ROWS)[:, None] * reach
    path = save(tmp_path / "log.csv", flat({"t": recorded["t"], "q": q, "tau": recorded["tau"][:, [0] * n]}))
    assert not refused or "are they degrees?" in refusal(path)
    read_log(path, degrees=False if refused else None)


@pytest.mark.real
@pytest.mark.parametrize("name", ["panda/a", "tx40/a", "ur10e/b_20s", "kr300/a", "lwr4/a"])
def test_real_logs_are_not_taken_for_other_units(name, tmp_path):
    path = real_log(f"{name}.csv")
    log = read_log(path)
    assert len(log) > 1000
    assert np.abs(log.q).max() < 2.0 * np.pi
    columns = flat({"t": log.t, "q": np.rad2deg(log.q), "tau": log.effort})
    assert "are they degrees?" in refusal(save_parquet(tmp_path / "log.parquet", columns))


# ---------------------------------------------------------------------------------------------------------------
# Which logs; the way back
# ---------------------------------------------------------------------------------------------------------------
def test_patterns_match_every_format(tmp_path, recorded):
    for name in ("a.csv", "b.parquet", "c.mat", "d.mcap", "bag/metadata.yaml", "bag/bag_0.db3", "other/deep.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = [path.relative_to(tmp_path).as_posix() for path in find_logs([str(tmp_path / "*")])]
    assert found == ["a.csv", "b.parquet", "bag", "c.mat", "d.mcap"]
    found = [path.relative_to(tmp_path).as_posix() for path in find_logs([str(tmp_path / "**" / "*")])]
    assert found == ["a.csv", "b.parquet", "bag", "c.mat", "d.mcap", "other/deep.csv"]
    shutil.rmtree(tmp_path / "bag")
    assert "no such file" in refusal(tmp_path / "bag")
