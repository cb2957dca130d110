from dataclasses import replace

import numpy as np
import pytest
from log_files import refusal

from bayesid.errors import InputError
from bayesid.log.log import Log, Piece, find_logs, join_logs, read_log, write_log
from bayesid.log.signals import prepare

ROWS = 60


@pytest.fixture
def table():
    """Cells of a good log of two joints: the header, then ROWS rows of both signs."""
    rng = np.random.default_rng(1)
    values = np.column_stack([np.arange(ROWS) * 0.01, rng.normal(size=(ROWS, 6))])
    return [["t", "q1", "q2", "dq1", "dq2", "tau1", "tau2"], *[[repr(x) for x in row] for row in values.tolist()]]


@pytest.fixture
def save(tmp_path):
    """Writes cells to a file."""

    def write(cells, end="\n"):
        path = tmp_path / "log.csv"
        path.write_text(end.join(",".join(row) for row in cells) + end, newline="")
        return path

    return write


def column(table, name):
    return table[0].index(name)


def fill(table, name, value):
    """The table with one column set to a value (or a function of the old one)."""
    j = column(table, name)
    for row in table[1:]:
        row[j] = str(value(float(row[j]))) if callable(value) else value
    return table


def as_currents(table):
    table[0][-2:] = ["i1", "i2"]
    return table


def test_good_log_is_read_as_it_is(table, save):
    log = read_log(save(table))
    expected = np.array(table[1:], dtype=float)
    np.testing.assert_array_equal(np.column_stack([log.t, log.q, log.dq, log.effort]), expected)
    assert log.signed.all()
    assert len(log) == ROWS
    assert log.n_joints == 2


@pytest.mark.parametrize(
    ("row", "name", "text", "said"),
    [
        (2, "q1", "nan", "column q1 holds nan"),
        (9, "tau1", "-inf", "column tau1 holds -inf"),
        (31, "dq2", "1e400", "column dq2 holds inf"),
        (61, "q2", "-1e280", "column q2 holds -1e+280"),
        (2, "t", "nan", "column t holds nan"),
        (61, "t", "1e282", "time jumps, from 0.58 s to 1e+282 s"),
        (17, "t", "0.03", "time runs backwards, from 0.14 s to 0.03 s"),
        (5, "tau2", "", "column tau2 holds '', not a number"),
        (5, "q1", "1_000", "column q1 holds '1_000', not a number"),
    ],
)
def test_bad_value_is_named_with_its_row_and_column(table, save, row, name, text, said):
    table[row - 1][column(table, name)] = text
    for end in ("\n", "\r\n"):
        assert f"log.csv, row {row}: {said};" in refusal(save(table, end))
    table.insert(1, [])  # a blank line counts
    assert f"log.csv, row {row + 1}: {said};" in refusal(save(table))


def test_corrupted_first_time(table, save):
    table[1][0] = "1e282"
    assert "row 3: time runs backwards, from 1e+282 s to 0.01 s" in refusal(save(table))


def test_row_of_the_wrong_length(table, save):
    for row in (7, ROWS + 1):
        good, bad = [*table[row - 1], "1"], list(table)
        bad[row - 1] = good
        assert f"row {row}: holds 8 values" in refusal(save(bad))
        bad[row - 1] = good[:3]
        assert f"row {row}: holds 3 values, the header names 7" in refusal(save(bad))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("t", "clock", "column t is missing"),
        ("q1", "x", "column q1 is missing"),
        ("q2", "q3", "column q2 is missing"),
        ("dq2", "v2", "column dq2 is missing"),
        ("tau2", "x", "column tau2 is missing"),
        ("q2", "x", "column tau2 has no q beside it"),
        ("q2", "q1", "column q1 appears twice"),
        ("dq1", "t", "column t appears twice"),
    ],
)
def test_header_that_cannot_be_used(table, save, old, new, said):
    table[0][column(table, old)] = new
    assert f"row 1: {said}" in refusal(save(table))


def test_headers_without_efforts_or_of_another_length(table, save):
    for row in table[1:]:
        row.append("1")
    assert "row 1: has 7 names for 8 columns" in refusal(save(table))
    table[0][-2:] = ["a", "b", "c"]
    assert "row 1: column tau1 (or i1 with gains) is missing" in refusal(save(table))


@pytest.mark.filterwarnings("error")
def test_too_few_rows(table, save):
    for rows in (0, 1, 49):
        assert f"holds {rows} rows, too few" in refusal(save(table[: rows + 1]))


def test_columns_without_information(table, save):
    for names, value, said in (
        (["q1", "q2"], "0.3", "all columns of positions are constant"),
        (["tau1", "tau2"], "0", "all efforts are zero in every row"),
        (["t"], "3.5", "time never advances"),
    ):
        bad = [list(row) for row in table]
        for one in names:
            fill(bad, one, value)
        assert said in refusal(save(bad))


def test_no_such_file(tmp_path):
    for name in ("absent.csv", "."):
        assert "no such file" in refusal(tmp_path / name)


def test_ignored_columns_may_hold_anything(table, save):
    for row, extra in zip(table, [["mode", "mode", ""], *[['"a,b"', "nan", ""]] * ROWS], strict=True):
        row[1:1] = extra
    assert read_log(save(table)).n_joints == 2
    table[6][column(table, "tau1")] = "?"
    assert "row 7: column tau1 holds '?'" in refusal(save(table))


def test_times_may_repeat(table, save):
    table[9][0] = table[8][0]
    assert len(read_log(save(table))) == ROWS


@pytest.mark.parametrize(("offset", "velocity"), [(0.0, True), (1.7e9, False)])
def test_write_then_read_gives_the_same_log(tmp_path, offset, velocity):
    rng = np.random.default_rng(2)
    effort = rng.normal(size=(ROWS, 3)) * 10.0 ** rng.integers(-6, 3, (ROWS, 3))
    effort[:, 1] = np.abs(effort[:, 1])
    log = Log(
        t=offset + np.cumsum(rng.uniform(1e-3, 1e-2, ROWS)),
        q=rng.normal(size=(ROWS, 3)),
        effort=effort,
        signed=[True, False, True],
        dq=rng.normal(size=(ROWS, 3)) if velocity else None,
    )
    write_log(tmp_path / "log.csv", log)
    back = read_log(tmp_path / "log.csv")
    for name in ("t", "q", "effort", "signed", "dq"):
        np.testing.assert_array_equal(getattr(back, name), getattr(log, name))
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_unsigned_joints_are_recognised_or_named(table, save):
    fill(table, "tau1", abs)[7][column(table, "tau1")] = "0"
    path, recorded = save(table), np.array([row[-2:] for row in table[1:]], dtype=float)
    named = {"all": [False] * 2, "none": [True] * 2, "2": [True, False], " 1,2": [False] * 2, None: [False, True]}
    for unsigned, signed in named.items():
        log = read_log(path, unsigned=unsigned)
        assert log.signed.tolist() == signed
        np.testing.assert_array_equal(log.effort, np.where(signed, recorded, np.abs(recorded)))


def test_bad_unsigned_option(table, save):
    path = save(table)
    for word in ("", "0", "3", "-1", "1.0", "1,", "1;2", "ALL", "\u00b2", "1,,2", "9" * 5000):
        said = refusal(path, unsigned=word)
        assert said.startswith("--unsigned: ")
        assert len(said) < 200


@pytest.mark.parametrize("unsigned", [None, "all", "none", "1"])
def test_currents_times_gains(table, save, unsigned):
    path = save(as_currents(fill(table, "tau1", abs)))
    current = np.array([row[-2:] for row in table[1:]], dtype=float)
    gains = np.array([-3.0, -0.5])
    log = read_log(path, gains=gains, unsigned=unsigned)
    signed = {None: [False, True], "all": [False, False], "none": [True, True], "1": [False, True]}[unsigned]
    assert log.signed.tolist() == signed
    np.testing.assert_array_equal(log.effort, np.where(signed, current * gains, np.abs(current) * np.abs(gains)))


def test_bad_gains(table, save):
    path = save(as_currents(table))
    for gains, said in (
        (None, "no gains are given"),
        ([1.0], "--gains: 1 gains for 2 joints"),
        ([1.0, 2.0, 3.0], "--gains: 3 gains for 2 joints"),
        ([1.0, 0.0], "--gains: a gain is zero or not finite"),
        ([1.0, np.nan], "--gains: a gain is zero or not finite"),
    ):
        assert said in refusal(path, gains=gains)


def test_gains_for_torques(table, save):
    assert "gains are given but the log holds torques" in refusal(save(table), gains=[1.0, 2.0])


def test_torques_come_before_currents(table, save):
    for row, extra in zip(table, [["i1", "i2"], *[["nan", "1e300"]] * ROWS], strict=True):
        row += extra
    np.testing.assert_array_equal(read_log(save(table)).effort[0], np.array(table[1][-4:-2], dtype=float))


def test_log_checks_its_arrays():
    good = {"t": np.arange(8.0), "q": np.ones((8, 2)), "effort": np.ones((8, 2)), "signed": [True, False]}
    assert not Log(**good).q.flags.writeable
    for change, said in (
        ({"t": np.arange(9.0)}, "t has shape"),
        ({"t": -np.arange(8.0)}, "time runs backwards"),
        ({"effort": np.ones((8, 3))}, "effort has shape"),
        ({"q": np.full((8, 2), np.nan)}, "not finite"),
        ({"signed": [True]}, "signed has shape"),
        ({"effort": -np.ones((8, 2))}, "cannot be negative"),
    ):
        with pytest.raises(ValueError, match=said):
            Log(**good | change)


# ---------------------------------------------------------------------------------------------------------------
# Several logs as one
# ---------------------------------------------------------------------------------------------------------------
def recorded(rows=100, period=0.01, joints=2, start=5.0, velocities=False, signed=(False, False), name="log"):
    """A log that tells its rows apart."""
    t = start + period * np.arange(rows)
    q = np.sin(t[:, None] + np.arange(joints))
    effort = np.where(signed, q, np.abs(q)) if len(signed) == joints else np.abs(q)
    known = np.array(signed) if len(signed) == joints else np.zeros(joints, dtype=bool)
    return Log(t, q, effort, known, np.cos(t[:, None] + np.arange(joints)) if velocities else None, name)


def test_logs_join_with_a_pause_between_them():
    first, second = recorded(80, start=1.7e9, velocities=True), recorded(60, start=-3.0, velocities=True)
    joined = join_logs([first, second, first])
    assert len(joined) == 220
    np.testing.assert_array_equal(joined.q, np.concatenate([first.q, second.q, first.q]))
    np.testing.assert_array_equal(joined.effort, np.concatenate([first.effort, second.effort, first.effort]))
    steps = np.diff(joined.t)
    assert (steps[[79, 139]] >= 1.0).all(), "longer than 20 periods, which is a pause, and than any filter"
    np.testing.assert_allclose(np.delete(steps, [79, 139]), 0.01, rtol=1e-4)
    assert joined.source == "log + log + log"
    np.testing.assert_array_equal(joined.dq, np.concatenate([first.dq, second.dq, first.dq]))


def test_a_single_log_is_not_touched():
    log = recorded()
    assert join_logs([log]) is log
    assert not log.pooled
    instants = np.array([-100.0, 5.5, 1e9])
    place, t = log.clock(instants)
    np.testing.assert_array_equal(place, 0)
    np.testing.assert_array_equal(t, instants)


def test_joined_logs_keep_their_own_times():
    first, second = recorded(80, start=1.7e9, name="a.csv"), recorded(60, start=-3.0, name="b.csv")
    joined = join_logs([first, second])
    assert joined.pooled
    for log in (joined, joined.rectified(), replace(joined, effort=2.0 * joined.effort, source="twice as strong")):
        rows = [(one.source, one.start_row, one.stop_row) for one in log.pieces]
        assert rows == [("a.csv", 0, 80), ("b.csv", 80, 140)]
        np.testing.assert_array_equal(log.pieces[0].t, first.t)
        np.testing.assert_array_equal(log.pieces[1].t, second.t, err_msg="to the last digit, though 1.7e9 s were added")
    with pytest.raises(ValueError, match="read-only"):
        joined.pieces[0].t[0] = 0.0


def test_joined_logs_can_be_joined():
    logs = [recorded(50 + k, start=10.0 * k, name=f"{k}.csv") for k in range(4)]
    there = join_logs([join_logs(logs[:2]), join_logs(logs[2:])])
    assert [(one.source, one.start_row, one.stop_row) for one in there.pieces] == [
        ("0.csv", 0, 50),
        ("1.csv", 50, 101),
        ("2.csv", 101, 153),
        ("3.csv", 153, 206),
    ]
    for one, log in zip(there.pieces, logs, strict=True):
        np.testing.assert_array_equal(one.t, log.t)
        np.testing.assert_array_equal(there.q[one.start_row : one.stop_row], log.q)
    np.testing.assert_allclose(there.t, join_logs(logs).t, rtol=0.0, atol=1e-9)


def test_the_clock_of_joined_logs():
    """By hand: rows at 5.00 to 5.99 s, a pause of 3 s, rows at 8.99 s to 9.58 s that began at -3 s."""
    joined = join_logs([recorded(100, start=5.0), recorded(60, start=-3.0)])
    instants = np.array([4.98, 5.0, 5.504, 5.99, 6.0, 7.5, 8.98, 8.99, 9.2, 9.58, 9.6])
    place, t = joined.clock(instants)
    np.testing.assert_array_equal(place, [-1, 0, 0, 0, -1, -1, -1, 1, 1, 1, -1])
    there = place >= 0
    np.testing.assert_allclose(t[there], [5.0, 5.504, 5.99, -3.0, -2.79, -2.41], atol=1e-12)
    np.testing.assert_array_equal(t[~there], instants[~there])
    np.testing.assert_array_equal(joined.clock(joined.t)[0], np.repeat([0, 1], [100, 60]))


def test_pieces_hold_all_rows_in_their_order():
    log = recorded(100)
    for rows in ([(0, 50)], [(0, 50), (60, 100)], [(0, 60), (50, 100)], [(1, 50), (50, 100)], [(50, 100), (0, 50)]):
        with pytest.raises(ValueError, match="one after the other"):
            replace(log, pieces=tuple(Piece("log", a, b, np.arange(b - a)) for a, b in rows))
    for a, b, times, said in ((5, 5, 0, "no rows"), (0, 5, 4, "piece's t has shape")):
        with pytest.raises(ValueError, match=said):
            Piece("log", a, b, np.arange(times))


@pytest.mark.parametrize(("period", "repeats"), [(0.2, 1), (0.05, 5), (0.01, 1)])
def test_the_pause_between_two_logs_is_one_at_any_rate(period, repeats):
    """A pause is 20 periods, of rows that bring something new."""
    t = period * np.arange(300)
    q = np.repeat(np.sin(t[::repeats]), repeats)[:300, None]
    joined = join_logs([Log(t, q, np.abs(q), [False]), Log(t, q, np.abs(q), [False])])
    signals = prepare(joined)
    between = joined.clock(signals.motion.t)[0] < 0
    assert between.sum() > 20 / repeats
    assert not signals.measured[between].any()
    assert signals.measured[~between].mean() > 0.9


# ---------------------------------------------------------------------------------------------------------------
# Which logs
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture
def shelf(tmp_path, monkeypatch):
    """A folder with logs in it, and some that only look like patterns or logs."""
    for name in ("runs/b.csv", "runs/a.csv", "runs/A.csv", "runs/2.csv", "runs/10.csv", "runs/deep/c.csv", "x[1].csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "runs" / "folder.csv").mkdir()
    (tmp_path / "link.csv").symlink_to(tmp_path / "runs" / "a.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_paths_and_patterns_name_logs(shelf):
    for patterns, found in (
        (["runs/b.csv", "link.csv"], ["runs/b.csv", "link.csv"]),
        (["no/where.csv"], ["no/where.csv"]),
        (["runs/*.csv"], ["runs/10.csv", "runs/2.csv", "runs/A.csv", "runs/a.csv", "runs/b.csv"]),
        (["runs/b.csv", "runs/[aA].csv"], ["runs/b.csv", "runs/A.csv", "runs/a.csv"]),
        (["runs/??.csv", "runs/2.csv"], ["runs/10.csv", "runs/2.csv"]),
        (["runs/**/c.csv"], ["runs/deep/c.csv"]),
        (["x[1].csv"], ["x[1].csv"]),
        (["x*.csv"], ["x[1].csv"]),
        (["runs/folder.csv"], ["runs/folder.csv"]),
    ):
        assert [path.as_posix() for path in find_logs(patterns)] == found


def test_patterns_that_match_nothing_or_a_log_twice(shelf):
    for pattern in ("runs/*.txt", "nowhere/*", "runs/fol*", "[", "z" * 300 + "*"):
        with pytest.raises(InputError) as caught:
            find_logs(["runs/a.csv", pattern])
        assert str(caught.value).startswith(f"{pattern}: matches no file; ")
    for patterns, said in (
        (["runs/a.csv", "runs/b.csv", "runs/a.csv"], "runs/a.csv: is named twice"),
        (["runs/*.csv", "runs/a.csv"], "runs/a.csv: is named twice"),
        (["runs/a.csv", "runs/deep/../a.csv"], "runs/deep/../a.csv: is the same file as runs/a.csv"),
        (["runs/a.csv", "link.csv"], "link.csv: is the same file as runs/a.csv"),
    ):
        with pytest.raises(InputError) as caught:
            find_logs(patterns)
        assert str(caught.value).startswith(f"{said}; name every log once")


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (recorded(joints=3, signed=(), name="b.csv"), "b.csv: has 3 joints, log has 2"),
        (recorded(signed=(True, False), name="b.csv"), "b.csv: other joints are signed"),
        (recorded(velocities=True, name="b.csv"), "b.csv: only one of it and log has measured velocities"),
        (recorded(period=0.004, name="b.csv"), "b.csv: 250 Hz, log has 100 Hz"),
    ],
)
def test_logs_that_do_not_belong_together(other, said):
    with pytest.raises(InputError) as caught:
        join_logs([recorded(), other])
    assert said in str(caught.value)
