"""One log in every format comes back as its CSV does; and what is wrong with a file is said in one line."""

import sys
import warnings
from datetime import datetime, timedelta

import numpy as np
import pyarrow as pa
import pytest
from conftest import real_log
from log_files import Bag, assert_same, flat, kuka, refusal, save, save_hdf5, save_matlab, save_parquet, text, without

from bayesid.log.reading import read_log
from bayesid.log.sources import find_logs

ROWS = 64
N = 3
J = ["base_yaw", "arm_lift", "wrist_roll"]

pytestmark = pytest.mark.filterwarnings("ignore:.*assumed joint order from base to tip")


@pytest.fixture
def recorded():
    """Columns of a log of three joints, no two alike."""
    rng = np.random.default_rng(7)
    t = 12.25 + np.cumsum(rng.integers(3, 6, ROWS)) * 1e-3
    offset = np.array([0.4, -1.5, 0.9])
    blocks = {"q": offset + 0.6 * rng.normal(size=(ROWS, N)), "dq": 0.3 + rng.normal(size=(ROWS, N))}
    return {"t": t, **blocks, "tau": rng.normal(size=(ROWS, N)) * [30.0, 9.0, 0.7]}


def test_parquet_is_known_by_what_it_holds(tmp_path, recorded):
    """Words among its columns, whole numbers, time stamps (since 1970 a float counts in steps of 2.4e-7 s)."""
    columns = {"mode": ["auto"] * ROWS, **flat(recorded), "q9_raw": [None] * ROWS}
    assert_same(read_log(save_parquet(tmp_path / "log.csv", columns)), recorded)
    start, t = datetime(2026, 2, 3, 4, 5, 6), np.arange(ROWS) * 4e-3
    times = [start + timedelta(seconds=float(one)) for one in t]
    columns["tau2"], columns["q1"] = pa.array(np.arange(ROWS) - 9, pa.int32()), pa.array(np.arange(ROWS) % 3, pa.int8())
    for kind, values, zero in (("timestamp", times, start), ("duration", [one - start for one in times], None)):
        columns["t"] = pa.array(values, getattr(pa, kind)("ns"))
        log = read_log(save_parquet(tmp_path / "log.parquet", columns))
        first = (zero - datetime(1970, 1, 1)).total_seconds() if zero else 0.0
        np.testing.assert_allclose(log.t, first + t, rtol=0.0, atol=2.4e-7 if zero else 1e-15)
        np.testing.assert_array_equal(log.q[:, 0], np.arange(ROWS) % 3)
        np.testing.assert_array_equal(log.effort[:, 1], np.arange(ROWS) - 9)


def test_parquet_that_cannot_be_used(tmp_path, recorded):
    path = tmp_path / "log.parquet"
    for name, values, said in (
        ("dq3", [*[0.5] * 4, np.inf, *[0.7] * (ROWS - 5)], ", row 5: column dq3 holds inf; "),
        ("q1", ["far"] * ROWS, ", row 1: column q1 holds 'far', not a number; "),
        ("q1", pa.array(range(ROWS), pa.timestamp("us")), ": column q1 holds datetime64[us], not numbers; "),
        ("t", np.zeros(ROWS), ", column t: time never advances; "),
    ):
        assert f"log.parquet{said}" in refusal(save_parquet(path, flat(recorded) | {name: values}))
    lists = [[0.1], *[[0.1, 0.2, 0.3]] * (ROWS - 1)]
    said = refusal(save_parquet(path, flat(without(recorded, "q")) | {"q": lists}))
    assert "column q: holds lists of 1 to 3 values" in said
    lacking = refusal(save_parquet(path, without(flat(recorded), "tau2")))
    assert "log.parquet: column tau2 is missing; add it; the file has q1..q3" in lacking
    path.write_bytes(path.read_bytes()[:-20])
    assert "log.parquet: is damaged (" in refusal(path)


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
    one = {"t": kept["t"], "q": kept["q"][:, 1], "i": kept["tau"][:, 2]}
    np.testing.assert_array_equal(read_log(write(tmp_path / "1.mat", one), [3.5]).effort[:, 0], one["i"] * 3.5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q": None}, "there is no t with a q among t, dq, tau; save t (N x 1), q (N x n)"),
        ({"tau": None}, "column tau1 (or i1 with gains) is missing"),
        ({"q": np.ones((ROWS - 1, 3))}, "variable q has shape (63, 3) for 64 instants"),
        ({"q": np.ones((ROWS, ROWS))}, "variable q is square, so its rows or its columns may be instants"),
        ({"t": np.ones((ROWS, 2))}, "variable t has shape (64, 2)"),
        ({"q2": np.arange(ROWS)}, "variables q and q2 may be the same"),
        ({"time": np.arange(ROWS)}, "variables t and time may be the same"),
        ({"q": np.full((ROWS, 3), "a")}, "variable q is not an array of numbers"),
        ({"q": np.full((ROWS, 3), np.nan)}, "row 1: column q1 holds no number in 100 % of the rows"),
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


@pytest.fixture
def bag():
    return Bag()


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag(tmp_path, recorded, bag, storage):
    path = bag.write(tmp_path / "bag", {"/joint_states": bag.states(recorded, J), "/talk": []}, storage)
    with pytest.warns(UserWarning, match="from base to tip: base_yaw, arm_lift, wrist_roll; if it is another"):
        assert_same(read_log(path), recorded, atol=1e-15)
    [file] = [one for one in path.iterdir() if one.suffix != ".yaml"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        log = read_log(file, joints=[J[2], J[0]])
    assert_same(log, {name: values if name == "t" else values[:, [2, 0]] for name, values in recorded.items()}, 1e-15)
    assert find_logs([str(tmp_path / "b*"), file]) == [path, file]
    assert find_logs([str(tmp_path / "**")]) == [path]


@pytest.mark.filterwarnings("error")
def test_numbers_tell_the_order_of_joints_and_unknown_velocities_are_left_out(tmp_path, recorded, bag):
    """In the messages the second joint stands first, and 10 after 9."""
    known = without(recorded, "dq")
    for name, given in {"none": known, "nan": known | {"dq": np.full((ROWS, N), np.nan)}}.items():
        stated = {kind: values if kind == "t" else values[:, [1, 2, 0]] for kind, values in given.items()}
        states = bag.states(stated, ["arm2_joint9", "arm2_joint10", "arm2_joint8"])
        assert_same(read_log(bag.write(tmp_path / name, {"/states": states})), known, atol=1e-15)


def test_stamps_that_are_zero(tmp_path, recorded, bag):
    path = bag.write(tmp_path / "bag", {"/states": bag.states(recorded, J, stamped=False)})
    with pytest.warns(UserWarning, match="the stamps are zero; times of receipt are used"):
        log = read_log(path)
    assert_same(log, recorded | {"t": recorded["t"] + 1e-3}, atol=1e-12)
    simulated = recorded | {"t": recorded["t"] - recorded["t"][0]}
    path = bag.write(tmp_path / "simulated", {"/states": bag.states(simulated, J)})
    assert_same(read_log(path), simulated, atol=1e-15)


def test_which_topic(tmp_path, recorded, bag):
    states, commands = bag.states(recorded, J), bag.states(without(recorded, "tau"), J)
    path = bag.write(tmp_path / "bag", {"/commands": commands, "/states": states})
    assert_same(read_log(path), recorded, atol=1e-15)
    assert "topic /commands, message 1: lacks efforts of some joints; " in refusal(path, topic="/commands")
    assert "--topic: '/other' is not a topic of joint states; give /commands, /states" in refusal(path, topic="/other")
    scaled = recorded | {"tau": 2.0 * recorded["tau"]}
    path = bag.write(tmp_path / "two", {"/left": states, "/right": bag.states(scaled, J)})
    assert "2 of the topics /left, /right have efforts; choose one with --topic" in refusal(path)
    assert_same(read_log(path, topic="/right"), scaled, atol=1e-15)
    path = bag.write(tmp_path / "no", {"/left": commands, "/right": commands})
    assert "none of the topics /left, /right has efforts; record one with efforts" in refusal(path)


def test_a_topic_of_several_publishers(tmp_path, recorded, bag):
    gripper = [bag.state(t + 5e-4, ["finger1", "finger2"], [0.1, t], [], []) for t in recorded["t"]]
    states = sorted([*bag.states(recorded, J), *gripper], key=lambda one: one[0])
    path = bag.write(tmp_path / "bag", {"/states": states})
    assert "there are messages of base_yaw, arm_lift, wrist_roll, and of finger1, finger2; give" in refusal(path)
    assert_same(read_log(path, joints=J), recorded, atol=1e-15)
    expected = "no message holds all of the joints elbow; give --joints from base_yaw, arm_lift, wrist_roll, fing"
    assert expected in refusal(path, joints=["elbow"])
    assert "--joints: a joint is named twice; " in refusal(path, joints=["base_yaw", "base_yaw"])


def in_degrees(recorded):
    return recorded | {name: np.rad2deg(recorded[name]) for name in ("q", "dq")}


def test_bags_that_cannot_be_read(tmp_path, recorded, bag, monkeypatch):
    states = bag.states(recorded, J)
    for k, (q, tau, said) in enumerate(
        (
            ([0.1], [1.0] * 3, "message 3: lacks positions of some joints; "),
            ([0.1] * 3, [1.0] * 2, "message 3: lacks efforts of some joints; "),
            ([0.1, np.inf, 0.2], [1.0] * 3, "message 3: column q2 (arm_lift) holds inf; "),
        )
    ):
        states[2] = bag.state(recorded["t"][2], J, q, [], tau)
        assert said in refusal(bag.write(tmp_path / f"bag{k}", {"/states": states}))
    assert "holds no message of sensor_msgs/msg/JointState" in refusal(bag.write(tmp_path / "talk", {"/talk": []}))
    for storage in ("mcap", "sqlite3"):
        path = bag.write(tmp_path / storage, {"/states": bag.states(recorded, J)}, storage)
        [file] = [one for one in path.iterdir() if one.suffix != ".yaml"]
        file.write_bytes(file.read_bytes()[:900])
        for one in (path, file):
            assert f"{one}: cannot be read as a bag (" in refusal(one)
        (path / "metadata.yaml").unlink()
        assert f"{path}: is a bag without its metadata.yaml; " in refusal(path)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    (tmp_path / "metadata.yaml").touch()
    assert refusal(tmp_path).endswith("bags need the library rosbags; pip install 'bayesid[ros]'")
    path = save(tmp_path / "log.csv", flat(recorded))
    for option in ({"topic": "/states"}, {"joints": ["j1"]}):
        [name] = option
        assert f"log.csv: is a CSV table, which has no {name}; leave --{name} out" in refusal(path, **option)


@pytest.mark.parametrize(
    "names",
    [
        {"effort": "MACur.A"},
        {"position": "AIPos_A", "effort": "GearTorque_A"},
        {"position": "aiposa", "effort": "axistorque", "velocity": "axisvel"},
        {"position": "rx.AIPos.A", "effort": "rx.Torque.A", "velocity": "rx.AxisVel.A", "clock": "rx.IPOC"},
    ],
)
def test_names_of_kuka(tmp_path, recorded, names):
    columns, currents = kuka(recorded, **{"effort": "Torque.A"} | names), names.get("effort") == "MACur.A"
    for separator, decimal in ((";", ","), ("\t", ",")) if currents else ((",", "."),):
        path, gains = save(tmp_path / "rsi.csv", text(columns, separator, decimal)), np.array([2.0, -3.0, 0.5])
        log = read_log(path, gains=gains if currents else None)
        assert_same(log, recorded | {"tau": recorded["tau"] * (gains if currents else 1.0)}, atol=1e-13)


def test_what_kuka_prefers(tmp_path, recorded):
    """Actual positions to commanded ones, the controller's clock to others, torques to currents, one prefix."""
    more = {f"ASPos.A{j}": np.zeros(ROWS) for j in (1, 2, 3)} | {f"A{j}": np.ones(ROWS) for j in (1, 2, 3)}
    more |= {"Time": np.ones(ROWS), "Send.IPOC": np.ones(ROWS), "Receive.IPOC": np.round(recorded["t"] * 1e3)}
    more |= {f"MACur.A{j}": np.full(ROWS, np.nan) for j in (1, 2, 3)}
    columns = without(kuka(recorded, "Receive.AIPos.A", "Torque.A"), "IPOC")
    assert_same(read_log(save(tmp_path / "rsi.csv", more | columns)), recorded, atol=1e-13)
    commanded = save(tmp_path / "set.csv", kuka(recorded, "ASPos.A", "Torque.A"))
    with pytest.warns(UserWarning, match="positions are commanded ones"):
        assert_same(read_log(commanded), recorded, atol=1e-13)


def test_kuka_that_cannot_be_used(tmp_path, recorded):
    for change, said in (
        ({f"AIPos.A{j}": None for j in (1, 2, 3)}, "column q1 is missing among RIst.X (not used), IPOC (t), "),
        ({f"MACur.A{j}": None for j in (1, 2, 3)}, "column tau1 (or i1 with gains) is missing among RIst.X "),
        ({"MACur.A2": None}, "column MACur.A2 is missing; add it; the file has AIPos.A1..AIPos.A3"),
        ({"IPOC": None}, "column t is missing among RIst.X (not used), AIPos.A{} (q), "),
        ({"aipos_a2": 1.0}, "row 1: columns AIPos.A2 and aipos_a2 could both be q"),
        ({f"R2.AIPos.A{j}": 1.0 for j in (1, 2, 3)}, "AIPos.A1 and R2.AIPos.A1 could both be q"),
        (
            {f"{name}.A{j}": 1.0 for name in ("Torque", "GearTorque") for j in (1, 2, 3)}
            | {f"MACur.A{j}": None for j in (1, 2, 3)},
            "row 1: columns Torque.A1 and GearTorque.A1 could both be tau",
        ),
        ({"AxisVel.A1": None, "AxisVel.A1[%]": 1.0}, "column AxisVel.A1 is missing; add it"),
        ({"IPOC": None, "Time": 4.0}, "column Time spans 252 s with steps of 4 s: milliseconds?; name the column Time"),
        (
            {"MACur.A2": None, "MACur.A2[%]": np.where(np.arange(ROWS) % 4, np.nan, 1.0)},
            "row 3: column MACur.A2[%] holds no number in 75 % of the rows",
        ),
    ):
        columns = without(kuka(recorded), *change)
        columns |= {name: np.arange(1, ROWS + 1) * value for name, value in change.items() if value is not None}
        assert said in refusal(save(tmp_path / "rsi.csv", text(columns, ";", ",")), gains=[1.0, 1.0, 1.0])
    assert "the log holds currents but no gains are given" in refusal(save(tmp_path / "rsi.csv", kuka(recorded)))


def test_units_by_the_header(tmp_path, recorded):
    degrees = in_degrees(recorded)
    for q, dq in (("q{} (deg)", "dq{} (deg/s)"), ("q{}_deg", "dq{}_deg_s"), ("q{}[°]", "dq{}[°/s]")):
        path = save_parquet(tmp_path / "log.parquet", flat(degrees, q=q, dq=dq))
        assert_same(read_log(path), recorded, atol=1e-14)
    columns = {  # a prismatic joint's beside a turning one's, in degrees by word of mouth
        "t[ms]": recorded["t"] * 1e3,
        "q1[mm]": recorded["q"][:, 0] * 1e3,
        "q2": degrees["q"][:, 1],
        "dq1[m/s]": recorded["dq"][:, 0],
        "dq2[rpm]": recorded["dq"][:, 1] * 30.0 / np.pi,
        "tau1[N]": recorded["tau"][:, 0],
        "tau2[Nm]": recorded["tau"][:, 1],
    }
    log = read_log(save(tmp_path / "log.csv", columns), degrees=True)
    assert_same(log, {name: values if name == "t" else values[:, :2] for name, values in recorded.items()}, atol=1e-13)


def test_positions_that_look_like_degrees(tmp_path, recorded):
    """Most joints, and two at least, beyond two turns, 12.57 rad: one that turns on and on is no sign of degrees."""
    for reach, refused in (
        ([40.0], False),
        ([40.0, 13.0], True),
        ([40.0, 12.5], False),
        ([0.1, 40.0, 90.0], True),
        ([3.0, 3.0, 40.0], False),
        ([1.0, 1.0, 40.0, 40.0], False),
    ):
        n, q = len(reach), np.linspace(0.0, 1.0, ROWS)[:, None] * reach
        path = save(tmp_path / "log.csv", flat({"t": recorded["t"], "q": q, "tau": recorded["tau"][:, [0] * n]}))
        assert not refused or "may be degrees" in refusal(path)
        read_log(path, degrees=False if refused else None)


@pytest.mark.real
@pytest.mark.parametrize("name", ["panda/a", "tx40/a", "ur10e/b_20s", "kr300/a", "lwr4/a"])
def test_real_logs_are_not_taken_for_other_units(name, tmp_path):
    path = real_log(f"{name}.csv")
    log = read_log(path)
    assert len(log) > 1000
    assert np.abs(log.q).max() < 2.0 * np.pi
    columns = flat({"t": log.t, "q": np.rad2deg(log.q), "tau": log.effort})
    assert "may be degrees" in refusal(save_parquet(tmp_path / "log.parquet", columns))
