"""Columns that a user names, in files of every format, in memory and in streams; and logs in memory."""

import numpy as np
import pytest
from log_files import (
    GERMAN,
    RECORDED,
    assert_same,
    flat,
    refusal,
    save,
    save_matlab,
    save_parquet,
    smooth_recording,
    strange,
    text,
    without,
)

from bayesid.errors import InputError
from bayesid.excitation.assessment import assess_excitation
from bayesid.log.formats.stated import parse_columns
from bayesid.log.formats.table import DEGREE, ReadingNote
from bayesid.log.reading import read_log
from bayesid.robot import load_robot

ROWS = len(RECORDED["t"])
NO_DQ = without(RECORDED, "dq")


def test_columns_that_a_user_names(tmp_path):
    """As a dict, in a file, in words; units and spaces need not be told; in any dialect and format."""
    gains = [-2.0, 0.5, 1.0]
    expected = RECORDED | {"tau": RECORDED["tau"] * gains}
    toml = save(tmp_path / "columns.toml", "".join(f'{key} = "{name}"\n' for key, name in GERMAN.items()))
    for separator, decimal in ((",", ","), (";", ","), ("\t", "."), ("|", ",")):
        path = save(tmp_path / "log.csv", text(strange(), separator, decimal))
        for columns in (GERMAN, toml, ",".join(f'{key}="{name}"' for key, name in GERMAN.items())):
            assert_same(read_log(path, gains, columns=columns), expected)
    for change in (
        {"t": "Uhr"},
        {"q": "Gelenk{}ist"},
        {"q": "Gelenk {1-3} ist [deg]"},
        {"q1": "Gelenk 1 ist [Grad]"},
        {"dq": "Tempo{} [rad/s]"},
    ):
        assert_same(read_log(path, gains, columns=GERMAN | change), expected)
    path = save_parquet(tmp_path / "log.parquet", without(strange(), "Bemerkung"))
    assert_same(read_log(path, gains, columns=GERMAN), expected)
    variables = {"uhr": RECORDED["t"] * 1e3, "gelenke": RECORDED["q"].T, "last": RECORDED["tau"]}
    path = save_matlab(tmp_path / "log.mat", {"mess": variables})
    assert_same(read_log(path, columns={"t": "uhr[ms]", "q": "gelenke{}", "tau": "last{}"}), NO_DQ)


def test_columns_of_single_joints_and_of_a_range(tmp_path):
    """External axes stand before and behind; the joints are named from tip to base."""
    q, tau = RECORDED["q"][:, :2], RECORDED["tau"]
    columns = flat({"q": q}, q="pose{}", start=3) | {"pose2": np.zeros(ROWS), "pose5": np.ones(ROWS)}
    columns |= {"clock": RECORDED["t"], "wrist": tau[:, 1], "base": tau[:, 0]}
    stated = {"t": "clock", "q": "pose{3-4}", "tau1": "base", "tau2": "wrist"}
    log = read_log(save(tmp_path / "log.csv", columns), columns=stated)
    assert_same(log, {"t": RECORDED["t"], "q": q, "tau": tau[:, :2]})


USUAL = {"t": "timestamp", "q": "actual_q_{}", "dq": "actual_qd_{}", "tau": "actual_current_as_torque_{}"}


def test_a_column_that_a_user_prefers_counts_in_place_of_the_joints_own(tmp_path):
    path = save(tmp_path / "log.csv", flat(NO_DQ) | {"Geber": RECORDED["q"][:, 0] + 1.0})
    assert_same(read_log(path, columns={"q1": "Geber"}), NO_DQ | {"q": RECORDED["q"] + [1.0, 0.0, 0.0]})
    usual = flat(RECORDED, start=0, **USUAL)
    path = save(tmp_path / "log.csv", usual)
    stated = {f"{kind}{j}": USUAL[kind].replace("{}", str(2 - j)) for kind in ("q", "dq", "tau") for j in (1, 2)}
    turned = {name: RECORDED[name][:, 1::-1] for name in ("q", "dq", "tau")}
    assert_same(read_log(path, columns=stated), RECORDED | turned)  # joints named one by one are all there are
    for kind, said in (("q", "has no matching q"), ("tau", "is missing")):
        # without the first joint's column those of joints 2 and 3 may be numbered from 0 or from 1
        old = USUAL[kind].replace("{}", "0")
        path = save(tmp_path / "log.csv", {"first" if name == old else name: v for name, v in usual.items()})
        assert said in refusal(path, columns={f"{kind}1": "first"})


HEADINGS = [
    {"t": "Zeit [s]", "q": "Winkel Achse {} [Grad]", "tau": "Drehmoment Achse {} [Nm]"},
    {"t": "time [s]", "q": "Angle of joint {} (deg)", "dq": "Joint {} Speed (deg/s)", "tau": "Torque_Joint{} [N m]"},
]


@pytest.mark.parametrize("names", HEADINGS)
def test_headings_with_quantity_joint_and_unit_are_used_and_said_once(tmp_path, names):
    names = {kind: names[kind] for kind in ("t", "q", "dq", "tau") if kind in names}
    degrees = {kind: RECORDED[kind] / (DEGREE if kind in ("q", "dq") else 1.0) for kind in names}
    columns = flat(degrees, **names) | {f"Soll-Drehmoment Achse {j} [Nm]": np.zeros(ROWS) for j in (1, 2, 3)}
    path = save(tmp_path / "log.csv", text(columns, ";", ","))
    with pytest.warns(ReadingNote) as said:
        log = read_log(path)
    assert_same(log, {kind: RECORDED[kind] for kind in names}, atol=1e-9)
    meanings = ", ".join(f"{kind} is {names[kind]}" for kind in ("t", "q", "tau", "dq") if kind in names)
    assert [str(one.message) for one in said] == [f"columns by their headings: {meanings}"]


@pytest.mark.parametrize(
    ("name", "effort"),
    [
        ("a second quantity", "Motorstrom Achse {} [A]"),
        ("no unit", "Drehmoment Achse {}"),
        ("another unit", "Drehmoment Achse {} [%]"),
        ("no quantity", "Achse {} [Nm]"),
        ("of the motor", "Drehmoment Motor Achse {} [Nm]"),
        ("commanded", "Soll-Drehmoment Achse {} [Nm]"),
    ],
)
def test_headings_in_doubt_are_refused(tmp_path, name, effort):
    columns = flat(NO_DQ, t="Zeit [s]", q="Winkel Achse {} [rad]", tau=effort)
    if name == "a second quantity":
        columns |= flat({"tau": RECORDED["tau"]}, tau="Strom Achse {} [A]")
    said = refusal(save(tmp_path / "log.csv", columns), gains=[1.0] * 3)
    assert ("could both be i" if name == "a second quantity" else "column tau1 (or i1 with gains) is missing") in said


def test_columns_that_cannot_be_used(tmp_path):
    path = save(tmp_path / "log.csv", text(strange(), ";", ","))
    bad, number = save(tmp_path / "bad.toml", "t = "), save(tmp_path / "number.toml", "t = 5")
    for columns, said in (
        ({"t": "Uhr [s]"}, "row 1: no column is called Uhr [s] among Nr, Uhr [ms], Gelenk {} ist [°], Tempo{}, Last{}"),
        ({"t1": "Uhr"}, "--columns: 't1' is not a column of a log"),
        ({"tau": "Last{}"}, "--columns: tau and i are both given"),
        ({"t": " "}, "--columns: t has no name of a column"),
        ({"q": "Gelenk {} {}"}, "--columns: Gelenk {} {} has more than one joint number"),
        ({"q": "Gelenk {1-4} ist", "dq": "Soll{}"}, "row 1: column Soll2 is missing"),
        ({"dq": "Last{}"}, "row 1: column Last1 [A] is in A, an unknown unit of dq; give it in rad/s"),
        ("t=a,t=b", "--columns: t is given twice"),
        ("nowhere.toml", "cannot be read (No such file or directory); give t="),
        (str(bad), "is not valid TOML ("),
        (str(number), "t has no name of a column"),
    ):
        stated = GERMAN | columns if isinstance(columns, dict) else columns
        assert said in refusal(path, gains=[1.0] * 3, columns=stated)
    expected = {"t": "Zeit, ab Start [ms]", "q": "Achse{} [Grad]", "tau2": "M=2"}
    assert parse_columns("t=\"Zeit, ab Start [ms]\", q=Achse{} [Grad],tau2 = 'M=2'") == expected


def forms_in_memory():
    vectors = flat(RECORDED)
    structured = np.zeros(ROWS, [("t", float), *((name, float, (3,)) for name in ("q", "dq", "tau"))])
    for name in structured.dtype.names:
        structured[name] = RECORDED[name]
    yield from (vectors, np.rec.fromarrays(list(vectors.values()), names=list(vectors)), structured)
    yield RECORDED | {"comment": "a text", "gripper": np.zeros(ROWS)}
    yield {name: values.T for name, values in RECORDED.items()}
    yield {name: values.tolist() for name, values in RECORDED.items()}
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(vectors)
    when = pandas.Timestamp("2026-02-03") + pandas.to_timedelta(RECORDED["t"], unit="s")
    levels = frame.set_axis([(n.rstrip("123"), n[1:].lstrip("qau")) for n in frame], axis=1)
    yield from (frame.assign(comment="a text"), frame.set_index("t"), levels)
    yield from (frame.assign(t=when), frame.drop(columns="t").set_axis(when))
    frame.columns = ["q1" if name == "q2" else name for name in frame.columns]
    assert "DataFrame: column q1 appears twice" in refusal(frame)


def test_logs_in_memory():
    for form in forms_in_memory():
        log = read_log(form)
        np.testing.assert_allclose(log.t - (log.t[0] if log.t[0] > 1e9 else 0.0), RECORDED["t"], rtol=0.0, atol=5e-7)
        assert_same(log, RECORDED | {"t": log.t})
    angles = {"Uhr": RECORDED["t"] * 1e3, "Winkel": np.rad2deg(RECORDED["q"]), "Strom": RECORDED["tau"]}
    stated = {"t": "Uhr [ms]", "q": "Winkel{} [deg]", "i": "Strom{}"}
    log = read_log(angles, [2.0, 3.0, 1.0], "all", columns=stated)
    assert_same(log, NO_DQ | {"tau": np.abs(RECORDED["tau"]) * [2.0, 3.0, 1.0]})
    with pytest.raises(InputError, match=r"the log has 3 joints, but robot .* has 6"):
        assess_excitation(load_robot("kr5"), RECORDED)


def test_logs_in_memory_that_cannot_be_used():
    recorded = smooth_recording(2, 60)
    for change, said in (
        ({"q": None}, "dict: column q1 is missing among t (t), dq{} (dq), tau{} (tau); name the columns"),
        ({"t": np.arange(60) * 4}, "dict: column t spans 236 s with steps of 4 s: milliseconds?"),
        ({"q": np.ones((9, 2))}, "dict: variable q has shape (9, 2) for 60 instants"),
        ({"tau": None, "tau1": [None] * 60, "tau2": np.ones(60)}, "dict, row 1: column tau1 holds None, not a number"),
        ({"tau": None, "tau1": np.ones(9), "tau2": np.ones(60)}, "dict: tau1 has 9 values, t has 60; "),
    ):
        assert said in refusal({name: value for name, value in (recorded | change).items() if value is not None})
    assert "has no topic; leave topic out" in refusal(RECORDED, topic="/states")
    for thing in (None, 5, [1.0, 2.0], np.ones((ROWS, 5)), b"log.csv", dict):
        assert "; give a path, a Log, a data frame, a structured array, or a dict of arrays t, q and" in refusal(thing)
    assert "variable q is not an array of numbers" in refusal({**RECORDED, "q": [[0.1], [0.1, 0.2]]})


def test_velocities_that_are_left_out(tmp_path):
    """Beside names that say themselves what they are, in a file and in memory; the refusal of wrong ones names it."""
    t = np.arange(300) / 100.0
    q = np.column_stack([np.sin(2.0 * t), np.cos(3.0 * t)])
    dq = np.column_stack([2.0 * np.cos(2.0 * t), -3.0 * np.sin(3.0 * t)])
    path = tmp_path / "a.csv"
    header = "t,q1,q2,dq1,dq2,tau1,tau2"
    np.savetxt(path, np.column_stack([t, q, 100.0 * dq, 5.0 * q]), delimiter=",", header=header, comments="")
    with pytest.raises(InputError, match="dq=none"):
        read_log(path)
    assert read_log(path, columns={"dq": "none"}).dq is None
    assert read_log(path, columns="dq=none").dq is None
    assert read_log({"t": t, "q": q, "dq": dq, "tau": 5.0 * q}, columns={"dq": "none"}).dq is None
    assert read_log({"t": t, "q": q, "dq": dq, "tau": 5.0 * q}).dq is not None
    parts = ({"t": t, "q": q, "dq": dq}, {"t": t, "tau": 5.0 * q})
    assert (read_log(parts).dq is None, read_log(parts, columns={"dq": "none"}).dq is None) == (False, True)


def test_numbers_alone_get_the_header_of_the_robot(tmp_path):
    """13 columns are six joints without velocities or four with them."""
    path = tmp_path / "bare.csv"
    np.savetxt(path, np.random.default_rng(1).normal(size=(50, 13)), delimiter=",")
    with pytest.raises(InputError, match="dq4"):
        read_log(path)
    with pytest.raises(InputError, match="tau6") as caught:
        read_log(path, robot=load_robot("ur10e"))
    assert "dq" not in str(caught.value)


def test_loads_of_a_servo_are_readings_for_gains(tmp_path):
    path = tmp_path / "servo.csv"
    values = np.arange(300.0).reshape(60, 5)
    np.savetxt(path, values, delimiter=",", header="t,q1,q2,load1,load2", comments="")
    with pytest.raises(InputError, match=r'give `gains`, .*,i="load{}"'):
        read_log(path)
