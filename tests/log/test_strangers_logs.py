"""Logs of people who have not read the documentation: read right at once, or one line that says what to do."""

import csv
import io
import time
from datetime import datetime, timedelta

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from bayesid.errors import InputError
from bayesid.excitation.judgement import judge_log
from bayesid.identification.pipeline import identify
from bayesid.log.formats.base import Options
from bayesid.log.formats.stated import parse_columns
from bayesid.log.log import read_log
from bayesid.log.rows import RowReader
from bayesid.model.robot import load_robot

ROWS = 60
N = 2


@pytest.fixture
def recorded():
    """Columns of a log of two joints, no two alike."""
    rng = np.random.default_rng(11)
    offset = np.array([0.4, -1.1])
    blocks = {"q": offset + 0.3 * rng.normal(size=(ROWS, N)), "dq": 0.2 + rng.normal(size=(ROWS, N))}
    return {"t": np.arange(ROWS) / 125.0, **blocks, "tau": rng.normal(size=(ROWS, N)) * [30.0, 7.0]}


def flat(columns, **names):
    """Vectors by name: q1, q2, ..., or after a pattern as in q="Achse{} [Grad]", from 1 or from `start`."""
    start, found = names.pop("start", 1), {}
    for kind, values in columns.items():
        pattern = names.get(kind, kind if kind == "t" else f"{kind}{{}}")
        block = [values] if values.ndim == 1 else values.T
        found |= {pattern.replace("{}", str(j + start)): column for j, column in enumerate(block)}
    return found


def text(columns, separator=",", decimal=".", end="\n", quote=csv.QUOTE_MINIMAL):
    """A table as text; columns of words stay as they are."""
    file = io.StringIO()
    writer = csv.writer(file, delimiter=separator, lineterminator=end, quoting=quote)
    writer.writerow(columns)
    cells = [[c if isinstance(c, str) else repr(float(c)).replace(".", decimal) for c in v] for v in columns.values()]
    writer.writerows(zip(*cells, strict=True))
    return file.getvalue()


def save(path, content, encoding="utf-8"):
    path.write_bytes(content.encode(encoding))
    return path


def assert_same(log, recorded):
    np.testing.assert_allclose(log.t, recorded["t"], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(log.q, recorded["q"], rtol=1e-13)
    np.testing.assert_allclose(log.effort, recorded["tau"], rtol=1e-13)
    if "dq" in recorded:
        np.testing.assert_allclose(log.dq, recorded["dq"], rtol=1e-13)


def refusal(source, **options):
    """The one line that refuses a log, for those who gave options."""
    with pytest.raises(InputError) as caught:
        read_log(source, **options)
    assert "\n" not in caught.value.on_command_line
    assert caught.value.remedy
    return caught.value.on_command_line


# ---------------------------------------------------------------------------------------------------------------
# A time that is not in seconds
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scale", "steps", "unit", "word"),
    [(1e3, "8", "ms", "milliseconds"), (1e6, "8000", "us", "microseconds"), (1e9, "8e+06", "ns", "nanoseconds")],
)
def test_a_time_in_another_unit_is_told_by_its_steps(tmp_path, recorded, scale, steps, unit, word):
    columns = flat(recorded | {"t": recorded["t"] * scale})
    said = refusal(save(tmp_path / "log.csv", text(columns)))
    span = f"{recorded['t'][-1] * scale:.6g}"
    assert f"log.csv: column t spans {span} s with steps of {steps} s: {word}?; name the column t[{unit}], or " in said
    columns = {f"t [{unit}]" if name == "t" else name: values for name, values in columns.items()}
    assert_same(read_log(save(tmp_path / "log.csv", text(columns))), recorded)


@pytest.mark.parametrize(
    ("period", "refused"), [(0.5, True), (0.499, False), (0.3, False), (0.01, False), (1000.0, True), (2e9, True)]
)
def test_how_slow_a_log_may_be(tmp_path, recorded, period, refused):
    """Repeated times and a pause do not count: the typical step does."""
    t = period * np.arange(ROWS).repeat(2)[:ROWS]
    path = save(tmp_path / "log.csv", text(flat(recorded | {"t": t})))
    assert ("with steps of" in refusal(path)) if refused else len(read_log(path)) == ROWS
    stated = text(flat(recorded | {"t": t}, t="t[s]"))
    if period < 3600.0:
        assert len(read_log(save(tmp_path / "stated.csv", stated))) == ROWS


def test_a_long_log_in_milliseconds_is_refused_at_once(tmp_path):
    """100,000 rows of six joints; processor time, for other programs may run."""
    t = np.arange(100_000) * 2.0
    block = np.sin(1e-3 * t[:, None] + np.arange(12))
    path = tmp_path / "long.csv"
    names = ["t", *(f"q{j}" for j in range(1, 7)), *(f"tau{j}" for j in range(1, 7))]
    np.savetxt(path, np.column_stack([t, block]), "%.6g", ",", header=",".join(names), comments="")
    began = time.process_time()
    assert "milliseconds?" in refusal(path)
    assert time.process_time() - began < 5.0


# ---------------------------------------------------------------------------------------------------------------
# Columns that a user names
# ---------------------------------------------------------------------------------------------------------------
GERMAN = {"t": "Uhr [ms]", "q": "Gelenk {} ist [Grad]", "dq": "Tempo{}", "i": "Last{} [A]"}
"""Names of which none is known beforehand."""


def german(recorded):
    """A stranger's columns, with words and other numbers among them."""
    n_rows = len(recorded["t"])
    blocks = {"t": recorded["t"] * 1e3, "q": np.rad2deg(recorded["q"]), "dq": recorded["dq"], "i": recorded["tau"]}
    names = GERMAN | {"q": "Gelenk {} ist [°]"}
    return {
        "Nr": np.arange(n_rows),
        **flat(blocks, **names),
        "Soll1": np.zeros(n_rows),
        "Bemerkung": ["a;b, c"] * n_rows,
    }


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_columns_that_a_user_names(tmp_path, recorded, separator, decimal):
    path = save(tmp_path / "log.csv", text(german(recorded), separator, decimal))
    gains = [-2.0, 0.5]
    log = read_log(path, gains, columns=GERMAN)
    assert_same(log, recorded | {"tau": recorded["tau"] * gains})


@pytest.mark.parametrize(
    "change",
    [
        {"t": "Uhr"},
        {"q": "Gelenk{}ist"},
        {"q": "Gelenk {1-2} ist [deg]"},
        {"q1": "Gelenk 1 ist [Grad]"},
        {"dq": "Tempo{} [rad/s]"},
    ],
)
def test_units_and_spaces_of_names_need_not_be_told(tmp_path, recorded, change):
    path = save(tmp_path / "log.csv", text(german(recorded), ";", ","))
    assert_same(read_log(path, [1.0, 1.0], columns=GERMAN | change), recorded)


def test_a_unit_of_a_user_counts_where_the_file_has_none(tmp_path, recorded):
    columns = flat(recorded | {"t": recorded["t"] * 1e6, "q": np.rad2deg(recorded["q"])})
    path = save(tmp_path / "log.csv", text(columns))
    assert_same(read_log(path, columns={"t": "t [us]", "q": "q{} [deg]"}), recorded)


def test_columns_of_single_joints_and_of_a_range(tmp_path, recorded):
    """External axes stand before and behind; the joints are named from tip to base."""
    columns = flat({"q": recorded["q"]}, q="pose{}", start=3) | {"pose2": np.zeros(ROWS), "pose5": np.ones(ROWS)}
    columns |= {"clock": recorded["t"], "wrist": recorded["tau"][:, 1], "base": recorded["tau"][:, 0]}
    path = save(tmp_path / "log.csv", text(columns))
    stated = {"t": "clock", "q": "pose{3-4}", "tau1": "base", "tau2": "wrist"}
    assert_same(read_log(path, columns=stated), {name: recorded[name] for name in ("t", "q", "tau")})


LOG = {"t": "t", "q": "q{}", "dq": "dq{}", "tau": "tau{}"}
USUAL = {"t": "timestamp", "q": "actual_q_{}", "dq": "actual_qd_{}", "tau": "actual_current_as_torque_{}"}


def renamed(recorded, names, start, kind, joint):
    """A log in which a column of one joint has a name of its own."""
    columns = flat(recorded, start=start, **names)
    old = names[kind].replace("{}", str(joint - 1 + start))
    return {"Gelenk_zwei" if name == old else name: values for name, values in columns.items()}


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("kind", ["q", "dq", "tau", "i"])
def test_a_column_of_a_single_joint_that_is_named_stands_beside_the_others(tmp_path, recorded, kind, joint):
    """These go by their own names, in a file, in memory and in a stream."""
    names = LOG | ({"tau": "i{}"} if kind == "i" else {})
    columns = renamed(recorded, names, 1, "tau" if kind == "i" else kind, joint) | {"Bemerkung": np.ones(ROWS)}
    gains = [1.0, 1.0] if kind == "i" else None
    stated = {f"{kind}{joint}": "Gelenk_zwei"}
    content = text(columns)
    assert_same(read_log(save(tmp_path / "log.csv", content), gains, columns=stated), recorded)
    assert_same(read_log(columns, gains, columns=stated), recorded)
    currents = gains is not None
    reader = RowReader(
        io.BytesIO(content.encode()), "stream", gains, options=Options(columns=stated, currents=currents)
    )
    rows = list(reader)
    for part, expected in (("q", "q"), ("dq", "dq"), ("effort", "tau")):
        np.testing.assert_allclose([getattr(row, part) for row in rows], recorded[expected], rtol=1e-13)


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("kind", ["q", "dq", "tau"])
def test_it_stands_beside_names_that_are_usual_elsewhere(tmp_path, recorded, kind, start):
    path = save(tmp_path / "log.csv", text(renamed(recorded, USUAL, start, kind, 2)))
    assert_same(read_log(path, columns={f"{kind}2": "Gelenk_zwei"}), recorded)


def test_a_column_that_a_user_prefers_counts_in_place_of_the_joints_own(tmp_path, recorded):
    columns = flat(recorded) | {"Geber": recorded["q"][:, 0] + 1.0}
    expected = recorded | {"q": recorded["q"] + [1.0, 0.0]}
    assert_same(read_log(save(tmp_path / "log.csv", text(columns)), columns={"q1": "Geber"}), expected)


def test_joints_that_are_named_one_by_one_are_all_there_are(tmp_path, recorded):
    """Of three joints by usual names the first two, in another order."""
    third = {name: np.column_stack([recorded[name], recorded["q"][:, 0]]) for name in ("q", "dq", "tau")}
    path = save(tmp_path / "log.csv", text(flat({"t": recorded["t"]} | third, start=0, **USUAL)))
    stated = {f"{kind}{j}": USUAL[kind].replace("{}", str(2 - j)) for kind in ("q", "dq", "tau") for j in (1, 2)}
    turned = {name: recorded[name][:, ::-1] for name in ("q", "dq", "tau")}
    assert_same(read_log(path, columns=stated), recorded | turned)


@pytest.mark.parametrize(("kind", "said"), [("q", "has no q beside it"), ("tau", "is missing")])
def test_where_counting_begins_is_not_guessed(tmp_path, recorded, kind, said):
    """Without the first joint's column those of joints 2 and 3 may be numbered from 0 or from 1."""
    third = {name: np.column_stack([recorded[name], recorded["q"][:, 0]]) for name in ("q", "dq", "tau")}
    columns = flat({"t": recorded["t"]} | third, start=0, **USUAL)
    old = USUAL[kind].replace("{}", "0")
    path = save(tmp_path / "log.csv", text({"first" if name == old else name: v for name, v in columns.items()}))
    assert said in refusal(path, columns={f"{kind}1": "first"})


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (
            {"t": "Uhr [s]"},
            "row 1: no column is called Uhr [s] among Nr, Uhr [ms], Gelenk {} ist [°], Tempo{}, Last{} [A]",
        ),
        ({"x": "Uhr"}, "--columns: 'x' is no column of a log; give t, q, dq, tau or i, or one joint's as q1"),
        ({"t1": "Uhr"}, "--columns: 't1' is no column of a log"),
        ({"tau": "Last{}"}, "--columns: tau and i are both given"),
        ({"t": " "}, "--columns: t has no name of a column"),
        ({"q": "Gelenk {} {}"}, "--columns: Gelenk {} {} has more than one number"),
        ({"q": "Gelenk {2-2} ist"}, "column Last2 [A] has no q beside it"),
        (
            {"q": "Gelenk {1-3} ist", "dq": "Soll{}"},
            "row 1: column Soll2 is missing; add it; Gelenk 1 ist [°]..Gelenk 2",
        ),
        ({"dq": "Last{}"}, "row 1: column Last1 [A] is in A, which is no known unit of dq; give it in rad/s"),
    ],
)
def test_columns_that_cannot_be_used(tmp_path, recorded, columns, said):
    path = save(tmp_path / "log.csv", text(german(recorded), ";", ","))
    assert said in refusal(path, gains=[1.0, 1.0], columns=GERMAN | columns)


def test_what_is_missing_is_said_with_the_columns_that_are_there(tmp_path, recorded):
    """The line that it suggests reads the log."""
    path = save(tmp_path / "log.csv", text(german(recorded), ";", ","))
    said = refusal(path)
    assert "row 1: column t is missing among Nr (not used), Uhr [ms] (not used), Gelenk {} ist [°] (not used), " in said
    assert 'say which columns are meant with --columns t="Uhr [ms]",q="Gelenk {} ist [°]",i="Last{} [A]"' in said
    suggested = parse_columns(said.partition("--columns ")[2])
    assert_same(read_log(path, [1.0, 1.0], columns=suggested), {name: recorded[name] for name in ("t", "q", "tau")})


@pytest.mark.parametrize("end", ["/position", "_joint_position", ".pos [deg]"])
def test_joints_with_names_of_their_own_are_suggested_one_by_one(tmp_path, recorded, end):
    """In the order of the header; two of the three only differ by a number."""
    blocks = {
        end: np.column_stack([recorded["q"], recorded["q"][:, 0]]),
        "/effort": 10.0 * recorded["dq"][:, [0, 1, 1]],
    }
    names = "elbow", "wrist_1", "wrist_2"
    columns = {f"{name}{end}": block[:, j] for end, block in blocks.items() for j, name in enumerate(names)}
    path = save(tmp_path / "log.csv", text({"time": recorded["t"]} | columns))
    said = refusal(path)
    assert f'--columns t="time",q1="elbow{end}",q2="wrist_1{end}",q3="wrist_2{end}",tau1="elbow/effort",' in said
    log = read_log(path, columns=parse_columns(said.partition("--columns ")[2]))
    np.testing.assert_allclose(log.effort, blocks["/effort"], rtol=1e-13)
    np.testing.assert_allclose(log.q, blocks[end] * (np.pi / 180.0 if "deg" in end else 1.0), rtol=1e-13)


def test_what_a_user_has_named_stays_in_the_suggestion(tmp_path, recorded):
    columns = flat(recorded, t="clock", q="x{}", start=0) | {"x2": np.zeros(ROWS)}
    path = save(tmp_path / "log.csv", text(columns))
    said = refusal(path, columns={"q": "x{0-1}"})
    assert said.endswith('--columns t="clock",q="x{0-1}",tau="tau{}"')
    assert_same(read_log(path, columns=parse_columns(said.partition("--columns ")[2])), recorded)


def test_columns_of_the_command_line(tmp_path):
    expected = {"t": "Zeit, ab Start [ms]", "q": "Achse{} [Grad]", "tau2": "M=2"}
    assert parse_columns("t=\"Zeit, ab Start [ms]\", q=Achse{} [Grad],tau2 = 'M=2'") == expected
    path = save(tmp_path / "columns.toml", 't = "Zeit, ab Start [ms]"\nq = "Achse{} [Grad]"\ntau2 = "M=2"\n')
    assert parse_columns(str(path)) == expected


def test_columns_in_python_may_be_those_of_the_command_line(tmp_path, recorded):
    path = save(tmp_path / "log.csv", text(german(recorded), ";", ","))
    stated = save(tmp_path / "columns.toml", "".join(f'{key} = "{name}"\n' for key, name in GERMAN.items()))
    for columns in (stated, ",".join(f'{key}="{name}"' for key, name in GERMAN.items())):
        assert_same(read_log(path, [1.0, 1.0], columns=columns), recorded)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("t=a,t=b", "--columns: t is given twice"),
        ("z=a", "--columns: 'z' is no column of a log"),
        ("nowhere.toml", "--columns nowhere.toml: cannot be read (No such file or directory); give t="),
        ("=", "--columns: '' is no column of a log"),
    ],
)
def test_columns_that_cannot_be_understood(given, said):
    with pytest.raises(InputError) as caught:
        parse_columns(given)
    assert said in caught.value.on_command_line


def test_a_file_of_columns_that_is_none(tmp_path):
    for content, said in {"t = ": "is not valid TOML (", "t = 5": "t has no name of a column"}.items():
        with pytest.raises(InputError) as caught:
            parse_columns(str(save(tmp_path / "columns.toml", content)))
        assert said in caught.value.on_command_line


def test_columns_of_other_formats(tmp_path, recorded):
    columns = {name: values for name, values in german(recorded).items() if name != "Bemerkung"}
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet")
    assert_same(read_log(tmp_path / "log.parquet", [1.0, 1.0], columns=GERMAN), recorded)
    variables = {"uhr": recorded["t"] * 1e3, "gelenke": recorded["q"].T, "last": recorded["tau"]}
    savemat(tmp_path / "log.mat", {"mess": variables})
    stated = {"t": "uhr[ms]", "q": "gelenke{}", "tau": "last{}"}
    assert_same(read_log(tmp_path / "log.mat", columns=stated), {name: recorded[name] for name in ("t", "q", "tau")})


# ---------------------------------------------------------------------------------------------------------------
# Names that are usual elsewhere
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("start", "names"),
    [
        (0, {}),
        (0, {"t": "timestamp", "q": "actual_q_{}", "dq": "actual_qd_{}", "tau": "actual_current_{}"}),
        (0, {"q": "q_{}", "dq": "dq_{}", "tau": "tau_J_{}"}),
        (0, {"t": "time", "q": "q[{}]", "dq": "dq[{}]", "tau": "tau_J[{}]"}),
        (1, {"t": "time", "q": "q_{}", "dq": "qd_{}", "tau": "tau_{}"}),
        (1, {"t": "Time", "q": "joint_{}", "dq": "velocity_{}", "tau": "effort_{}"}),
        (1, {"t": "Timestamp", "q": "position_{}", "dq": "joint_{}_velocity", "tau": "current_{}"}),
        (1, {"t": "time_s", "q": "joint_{}_position", "dq": "Joint{}Velocity", "tau": "joint{}.torque"}),
        (
            0,
            {
                "t": "/states/header/stamp",
                "q": "/states/position[{}]",
                "dq": "/states/velocity[{}]",
                "tau": "/states/tau[{}]",
            },
        ),
        (
            1,
            {
                "t": "__time",
                "q": "/arm/joint_{}/position",
                "dq": "/arm/joint_{}/velocity",
                "tau": "/arm/joint_{}/effort",
            },
        ),
        (1, {"t": "Zeit [s]", "q": "Achse {} [rad]", "dq": "Geschwindigkeit{}", "tau": "Drehmoment {} [Nm]"}),
        (1, {"t": "Zeit", "q": "Achse{}", "dq": "Geschwindigkeit{} (rad/s)", "tau": "Strom{} [%]"}),
    ],
)
def test_usual_names_are_known(tmp_path, recorded, start, names):
    columns = flat(recorded, start=start, **names)
    columns |= {"robot_mode": np.full(ROWS, 7), **flat({"q": recorded["q"] + 9.0}, q="target_q_{}", start=start)}
    columns = dict(reversed(columns.items()))
    gains = [1.0, 1.0] if any(word in names.get("tau", "") for word in ("urrent", "Strom")) else None
    assert_same(read_log(save(tmp_path / "log.csv", text(columns)), gains), recorded)


def test_the_names_of_a_csv_log_come_first(tmp_path, recorded):
    """As ever: what stands beside a whole log is ignored, whatever it holds."""
    more = {
        "time": np.nan,
        "position_1": np.nan,
        "velocity_1": np.nan,
        "torque_1": np.nan,
        "q_1": np.nan,
        "Q1": np.nan,
        "cmd/q1": np.nan,
    }
    columns = flat(recorded) | {name: np.full(ROWS, value) for name, value in more.items()}
    assert_same(read_log(save(tmp_path / "log.csv", text(columns))), recorded)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q0": 0.1}, "q0..q2 count from 0, tau1..tau2 from 1; say which belong together with --columns, as in "),
        ({"tau0": 0.1}, "tau0..tau2 count from 0, q1..q2 from 1; say which"),
        (
            {"t": None, "time": 0.1, "timestamp": 0.2},
            "time and timestamp may both be the time; say which with --columns t=",
        ),
        (
            {"q1": None, "q2": None, "position_1": 0.1, "joint_1": 0.2},
            "columns position_1 and joint_1 may both be q; say",
        ),
        ({"q1": None, "q2": None, "joint_1": 0.1, "Joint1": 0.2}, "columns joint_1 and Joint1 may both be q; say"),
        ({"q2": None, "q3": 1.0}, "column q2 is missing; add it; q1..q3 are there"),
        (
            {"q1": None, "q2": None, "joint_1": 0.1, "joint_3": 1.0},
            "joint_2 is missing; add it; joint_1..joint_3 are there",
        ),
        (
            {"t": None},
            'is missing among q{} (q), dq{} (dq), tau{} (tau); say which columns are meant with --columns t="NAME"',
        ),
        ({"t": None, "clock": 0.1}, 'columns are meant with --columns t="clock",q="q{}",tau="tau{}"'),
    ],
)
def test_names_that_leave_open_what_is_meant(tmp_path, recorded, change, said):
    columns = {name: values for name, values in flat(recorded).items() if name not in change}
    columns |= {name: np.arange(ROWS) * value for name, value in change.items() if value is not None}
    assert said in refusal(save(tmp_path / "log.csv", text(columns)))


def test_a_time_that_a_user_names_changes_nothing_else(tmp_path, recorded):
    """What stands beside a whole log is ignored all the same."""
    columns = flat({"t": recorded["t"] * 1e3, "q": recorded["q"], "tau": recorded["tau"]})
    columns |= {"velocity_1": np.full(ROWS, np.nan), "torque_1": np.full(ROWS, np.nan)}
    path = save(tmp_path / "log.csv", text(columns))
    assert_same(read_log(path, columns={"t": "t[ms]"}), {name: recorded[name] for name in ("t", "q", "tau")})


def test_efforts_that_are_currents(tmp_path, recorded):
    """As some drivers of ROS have it: the line that refuses them says how they are read."""
    path = save(tmp_path / "log.csv", text(flat(recorded, tau="effort_{}")))
    assert_same(read_log(path), recorded)
    said = refusal(path, gains=[2.0, 3.0])
    assert 'drop --gains, or give --columns i="effort_{}" if they are currents' in said
    log = read_log(path, [2.0, 3.0], columns={"i": "effort_{}"})
    assert_same(log, recorded | {"tau": recorded["tau"] * [2.0, 3.0]})


def test_joints_of_an_open_count_are_read_as_stated(tmp_path, recorded):
    """q0 may be a rail before the arm: the suggested line reads the arm alone, and another one the rail too."""
    rail = flat(recorded) | {name: 0.1 * np.arange(ROWS) for name in ("q0", "dq0")}
    path = save(tmp_path / "log.csv", text(rail))
    said = refusal(path)
    assert_same(read_log(path, columns=parse_columns(said.partition("as in ")[2])), recorded)
    assert_same(read_log(path, columns={"q": "q{1-2}", "dq": "dq{1-2}"}), recorded)


# ---------------------------------------------------------------------------------------------------------------
# Logs in memory
# ---------------------------------------------------------------------------------------------------------------
def in_memory(recorded, form):
    vectors = flat(recorded)
    if form in ("vectors", "matrices", "transposed", "lists"):
        return {
            "vectors": vectors,
            "matrices": recorded | {"comment": "a text", "gripper": np.zeros(ROWS)},
            "transposed": {name: values.T for name, values in recorded.items()},
            "lists": {name: values.tolist() for name, values in recorded.items()},
        }[form]
    if form == "structured":
        return np.rec.fromarrays(list(vectors.values()), names=list(vectors))
    if form == "structured matrices":
        array = np.zeros(ROWS, [("t", float), ("q", float, (N,)), ("dq", float, (N,)), ("tau", float, (N,))])
        for name in array.dtype.names:
            array[name] = recorded[name]
        return array
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(vectors)
    when = pandas.Timestamp("2026-02-03") + pandas.to_timedelta(recorded["t"] - recorded["t"][0], unit="s")
    return {
        "frame": frame.assign(comment="a text"),
        "index": frame.set_index("t"),
        "levels": frame.set_axis([(n.rstrip("12"), n[1:].lstrip("qau")) for n in frame], axis=1),
        "stamps": frame.assign(t=when),
        "stamped index": frame.drop(columns="t").set_axis(when),
    }[form]


FORMS = ("vectors", "matrices", "transposed", "lists", "structured", "structured matrices")
FRAMES = ("frame", "index", "levels", "stamps", "stamped index")


@pytest.mark.parametrize("form", [*FORMS, *FRAMES])
def test_logs_in_memory(recorded, form):
    log = read_log(in_memory(recorded, form))
    start = log.t[0] if "stamp" in form else 0.0
    np.testing.assert_allclose(log.t - start, recorded["t"] - (recorded["t"][0] if start else 0.0), rtol=0.0, atol=5e-7)
    assert_same(log, recorded | {"t": log.t})


def test_options_of_logs_in_memory(recorded):
    angles = {"Uhr": recorded["t"] * 1e3, "Winkel": np.rad2deg(recorded["q"]), "Strom": recorded["tau"]}
    stated = {"t": "Uhr [ms]", "q": "Winkel{} [deg]", "i": "Strom{}"}
    log = read_log(angles, [2.0, 3.0], "all", columns=stated)
    expected = {"t": recorded["t"], "q": recorded["q"], "tau": np.abs(recorded["tau"]) * [2.0, 3.0]}
    assert_same(log, expected)
    assert log.source == "dict"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q": None}, "dict: column q1 is missing among t (t), dq{} (dq), tau{} (tau); say which"),
        ({"tau": None}, "dict: column tau1 (or i1 with gains) is missing among t (t), "),
        ({"t": np.arange(ROWS) * 4}, "dict: column t spans 236 s with steps of 4 s: milliseconds?"),
        ({"q": np.ones((9, 2))}, "dict: variable q has shape (9, 2) for 60 instants"),
        ({"q": "a text"}, "dict: variable q is not an array of numbers"),
        ({"q": [[1.0], [1.0, 2.0]]}, "dict: variable q is not an array of numbers"),
        (
            {"tau": None, "tau1": ["0,5"] * ROWS, "tau2": np.ones(ROWS)},
            "dict, row 1: column tau1 holds '0,5', not a num",
        ),
        (
            {"tau": None, "tau1": [None] * ROWS, "tau2": np.ones(ROWS)},
            "dict, row 1: column tau1 holds None, not a number",
        ),
        ({"tau": None, "tau1": np.ones(9), "tau2": np.ones(ROWS)}, "dict: tau1 has 9 values, t has 60; "),
        ({"tau": None, "tau1": np.ones(ROWS), "tau2": [{}] * ROWS}, "dict, row 1: column tau2 holds {}, not a number"),
        ({"t": np.ones((ROWS, 2))}, "dict: variable t has shape (60, 2); give the time as a vector"),
    ],
)
def test_logs_in_memory_that_cannot_be_used(recorded, change, said):
    assert said in refusal({name: value for name, value in (recorded | change).items() if value is not None})


@pytest.mark.parametrize("thing", [None, 5, 2.5, [1.0, 2.0], np.ones((ROWS, 5)), object(), b"log.csv", dict, print])
def test_things_that_are_no_log(thing):
    assert "; give a path, a Log, a data frame, a structured array, or a dict of arrays t, q and" in refusal(thing)


def test_bags_options_are_none_of_logs_in_memory(recorded):
    assert "dict: is in memory, which has no topic; leave topic out" in refusal(recorded, topic="/states")


def test_a_frame_with_a_name_twice(recorded):
    frame = in_memory(recorded, "frame")
    frame.columns = ["q1" if name == "q2" else name for name in frame.columns]
    assert "DataFrame: column q1 appears twice; give every column its own name" in refusal(frame)


def test_logs_in_memory_are_logs_wherever_one_is(recorded):
    """One joint short of the robot: the same one line from all that take a log."""
    robot = load_robot("kr5")
    for form in ("matrices", "structured", "frame"):
        with pytest.raises(InputError, match=r"the log has 2 joints, robot .* has 6"):
            identify(robot, in_memory(recorded, form))
        with pytest.raises(InputError, match=r"the log has 2 joints, robot .* has 6"):
            judge_log(robot, in_memory(recorded, form))
    with pytest.raises(InputError, match="is no log: int"):
        identify(robot, 5)


# ---------------------------------------------------------------------------------------------------------------
# One log, written in many ways
# ---------------------------------------------------------------------------------------------------------------
def degrees(recorded):
    return recorded | {name: np.rad2deg(recorded[name]) for name in ("q", "dq")}


def with_units_beneath(recorded):
    lines = text(flat(recorded | {"t": recorded["t"] * 1e3}) | {"note": ["x"] * ROWS}, ";", ",").splitlines()
    units = ["ms", *["[rad]"] * N, *["rad/s"] * N, *["Nm"] * N, ""]
    return "\n".join([lines[0], ";".join(units), *lines[1:]])


def aligned(recorded):
    """Columns beneath each other, spaces between them."""
    cells = [line.split(",") for line in text(flat(recorded)).splitlines()]
    return "\n".join("  " + " ".join(cell.rjust(24) for cell in row) for row in cells)


def indexed(recorded):
    lines = text(flat(recorded)).splitlines()
    return "\n".join(f"{'' if k == 0 else k - 1},{line}" for k, line in enumerate(lines))


def noted(recorded):
    columns = flat(recorded)
    return {"note": ["Störung; ein, Wort"] * ROWS, **columns, "mode": ["auto"] * ROWS, "": [""] * ROWS}


MANGLED = {
    "semicolons": lambda recorded: text(flat(recorded), ";"),
    "semicolons, decimal commas": lambda recorded: text(flat(recorded), ";", ","),
    "tabs, decimal commas": lambda recorded: text(flat(recorded), "\t", ","),
    "pipes": lambda recorded: text(flat(recorded), "|").replace("|", " | "),
    "spaces": lambda recorded: text(flat(recorded), " "),
    "aligned": aligned,
    "quoted": lambda recorded: text(flat(recorded), quote=csv.QUOTE_ALL),
    "quoted decimal commas": lambda recorded: text(flat(recorded), ",", ","),
    "milliseconds": lambda recorded: text(flat(recorded | {"t": recorded["t"] * 1e3}, t="Zeit [ms]")),
    "degrees": lambda recorded: text(flat(degrees(recorded), q="q{} [Grad]", dq="dq{} [°/s]")),
    "another order": lambda recorded: text(dict(reversed(flat(recorded).items()))),
    "words between": lambda recorded: text(noted(recorded), ";", ","),
    "index": indexed,
    "units beneath": with_units_beneath,
    "units beneath, every other line blank": lambda recorded: with_units_beneath(recorded).replace("\n", "\r\r\n"),
    "line ends of Windows": lambda recorded: text(flat(recorded), ";", ",", "\r\n"),
    "a note of the separator": lambda recorded: "sep=;\r\n" + text(flat(recorded), ";", ",", "\r\n"),
    "settings above": lambda recorded: f"Recorder 1.2\r\nDate;3.2.2026\r\n\r\n{text(flat(recorded), ';', ',')}",
    "notes above": lambda recorded: "# Recorder 1.2, of 2026, by hand\n# 125 Hz\n# " + text(flat(recorded)),
    "separators at the ends": lambda recorded: text(flat(recorded), ";").replace("\n", ";\n").replace(";\n", "\n", 1),
    "header behind a #": lambda recorded: "# " + text(flat(recorded)),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
@pytest.mark.parametrize("form", MANGLED)
def test_a_mangled_log_is_read_right_at_once(tmp_path, recorded, form, encoding):
    content = MANGLED[form](recorded)
    content = "\ufeff" + content if encoding in ("utf-16-le", "utf-16-be") else content
    assert_same(read_log(save(tmp_path / "log.csv", content, encoding)), recorded)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%H:%M:%S.%f", "%H:%M:%S,%f"])
def test_a_time_of_day_or_a_date(tmp_path, recorded, form):
    start = datetime(2026, 2, 3, 23, 59, 8, 250_000)
    cells = [(start + timedelta(seconds=t)).strftime(form) for t in recorded["t"]]
    path = save(tmp_path / "log.csv", text(flat(recorded) | {"t": cells}, ";"))
    log = read_log(path)
    midnight = 0.0 if form.startswith("%H") else (datetime(2026, 2, 3) - datetime(1970, 1, 1)).total_seconds()
    np.testing.assert_allclose(log.t, midnight + 86348.25 + recorded["t"], rtol=0.0, atol=3e-7)
    assert_same(log, recorded | {"t": log.t})
    path = save(tmp_path / "bad.csv", text(flat(recorded) | {"t": [*cells[:7], "late", *cells[8:]]}, ";"))
    assert "bad.csv, row 9: column t holds 'late', not a time; " in refusal(path)


def test_a_utf_16_file_without_its_mark(tmp_path, recorded):
    for encoding in ("utf-16-le", "utf-16-be"):
        assert_same(read_log(save(tmp_path / "log.csv", text(flat(recorded)), encoding)), recorded)


def test_rows_are_counted_from_the_first_line_of_the_file(tmp_path, recorded):
    content = "Recorder 1.2\n\n" + text(flat(recorded), ";")
    lines = content.splitlines()
    lines[9] = lines[9].replace(";", ";nan;", 1).rpartition(";")[0]
    path = save(tmp_path / "log.csv", "\n".join(lines))
    assert "log.csv, row 10: column q1 holds nan" in refusal(path)
    lines[9] = lines[9].replace("nan", "?")
    assert "log.csv, row 10: column q1 holds '?', not a number" in refusal(save(path, "\n".join(lines)))
    assert "log.csv, row 3: column q1 is missing" in refusal(save(path, content.replace("q1", "x1")))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            lambda recorded: text(flat(degrees(recorded) | {"q": recorded["q"] * 900.0})),
            "are they degrees?; give --degrees",
        ),
        (
            lambda recorded: text(flat(recorded | {"t": recorded["t"] * 1e3})),
            "milliseconds?; name the column t[ms], or ",
        ),
        (
            lambda recorded: text(flat(recorded)).partition("\n")[2],
            "row 1: holds numbers, not the names of the columns",
        ),
        (
            lambda recorded: text(flat(recorded), ",", ",").replace('"', ""),
            "if its numbers have decimal commas, write the",
        ),
        (
            lambda recorded: text(flat(recorded, q="X{}")),
            "(not used), dq{} (dq), tau{} (tau); say which columns are meant",
        ),
        (lambda recorded: text(flat(recorded, tau="i{}")), "give --gains K1,..,Kn in N m/A"),
    ],
)
def test_what_a_mangled_log_leaves_open_is_one_line(tmp_path, recorded, content, said):
    assert said in refusal(save(tmp_path / "log.csv", content(recorded)))


def test_velocities_are_not_taken_for_efforts(tmp_path):
    """Neither suggested nor read."""
    t = np.arange(400) / 100.0
    q, dq, tau = np.sin(2.0 * t), 2.0 * np.cos(2.0 * t), 40.0 * np.abs(np.sin(3.0 * t))
    names = "Unnamed: 0,Time stamp /s,Axis 1 act. pos,Axis 2 act. pos,Axis 1 act. vel,Axis 2 act. vel,|M1| Nm,|M2| Nm"
    path = tmp_path / "odd.csv"
    np.savetxt(
        path,
        np.column_stack([np.arange(400), t, q, q + 1.0, dq, dq, tau, tau]),
        delimiter=",",
        header=names,
        comments="",
    )
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert caught.value.remedy.endswith('--columns t="Time stamp /s",q="Axis {} act. pos",tau="|M{}| Nm"')
    with pytest.raises(InputError, match="the efforts are the joints' velocities"):
        read_log(path, columns={"t": "Time stamp /s", "q": "Axis {} act. pos", "tau": "Axis {} act. vel"})
    columns = {"t": "Time stamp /s", "q": "Axis {} act. pos", "tau": "|M{}| Nm"}
    assert read_log(path, columns=columns).n_joints == 2
