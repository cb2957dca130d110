from dataclasses import replace

import numpy as np
import pytest
from log_files import refusal

from bayesid.errors import InputError
from bayesid.log.log import Log, Piece, join_logs
from bayesid.log.reading import read_log
from bayesid.log.sources import find_logs

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
    """One column set to a value (or a function of the old one)."""
    j = column(table, name)
    for row in table[1:]:
        row[j] = str(value(float(row[j]))) if callable(value) else value


def test_good_log_is_read_as_it_is(table, save):
    log = read_log(save(table))
    expected = np.array(table[1:], dtype=float)
    np.testing.assert_array_equal(np.column_stack([log.t, log.q, log.dq, log.effort]), expected)
    assert log.signed.all()
    assert len(log) == ROWS
    assert log.n_joints == 2


def test_bad_value_is_named_with_its_row_and_column(table, save):
    for row, name, text, said in (
        (31, "dq2", "1e400", "column dq2 holds inf"),
        (61, "q2", "-1e280", "column q2 holds -1e+280"),
        (61, "t", "1e282", "time jumps, from 0.58 s to 1e+282 s"),
        (17, "t", "0.03", "time runs backwards, from 0.14 s to 0.03 s"),
        (5, "q1", "1_000", "column q1 holds '1_000', not a number"),
    ):
        bad = [list(one) for one in table]
        bad[row - 1][column(table, name)] = text
        for end in ("\n", "\r\n"):
            assert f"log.csv, row {row}: {said};" in refusal(save(bad, end))
        bad.insert(1, [])  # a blank line counts
        assert f"log.csv, row {row + 1}: {said};" in refusal(save(bad))


def test_table_that_cannot_be_used(table, save):
    assert "row 7: holds 3 values, but the he" in refusal(save([*table[:6], table[6][:3], *table[7:]]))
    for old, new, said in (
        ("t", "clock", "column t is missing"),
        ("q2", "q3", "column q2 is missing"),
        ("q2", "x", "column tau2 has no matching q"),
        ("dq1", "t", "column t appears twice"),
    ):
        header = [new if name == old else name for name in table[0]]
        assert f"row 1: {said}" in refusal(save([header, *table[1:]]))
    assert "row 1: has 7 names for 8 columns" in refusal(save([table[0], *([*row, "1"] for row in table[1:])]))
    bare = [[*table[0][:-2], "a", "b"], *table[1:]]
    assert "row 1: column tau1 (or i1 with gains) is missing" in refusal(save(bare))
    for rows in (0, 1, 49):
        assert f"holds {rows} rows, too few" in refusal(save(table[: rows + 1]))
    for names, value, said in (
        (["q1", "q2"], "0.3", "all positions are constant"),
        (["tau1", "tau2"], "0", "all efforts are zero in every row"),
        (["t"], "3.5", "time never advances"),
    ):
        bad = [list(row) for row in table]
        for one in names:
            fill(bad, one, value)
        assert said in refusal(save(bad))


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
    log.save(tmp_path / "log.csv")
    back = read_log(tmp_path / "log.csv")
    for name in ("t", "q", "effort", "signed", "dq"):
        np.testing.assert_array_equal(getattr(back, name), getattr(log, name))
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_unsigned_joints_are_recognised_or_named(table, save):
    """Of torques as logged, and of currents times gains, which may be negative."""
    fill(table, "tau1", abs)
    recorded, gains = np.array([row[-2:] for row in table[1:]], dtype=float), np.array([-3.0, -0.5])
    for unit in ("tau", "i"):
        table[0][-2:] = [f"{unit}1", f"{unit}2"]
        path, factors = save(table), gains if unit == "i" else np.ones(2)
        for unsigned, signed in {"all": [0, 0], "none": [1, 1], "2": [1, 0], " 1,2": [0, 0], None: [0, 1]}.items():
            log = read_log(path, gains=gains if unit == "i" else None, unsigned=unsigned)
            assert log.signed.tolist() == list(map(bool, signed))
            np.testing.assert_array_equal(log.effort, np.where(signed, recorded * factors, abs(recorded * factors)))


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
        ({"pieces": (Piece("a", 0, 4, np.arange(4.0)),)}, "in order"),
    ):
        with pytest.raises(ValueError, match=said):
            Log(**good | change)
    with pytest.raises(ValueError, match="no rows"):
        Piece("a", 3, 3, np.arange(0.0))


def recorded(rows=100, period=0.01, joints=2, start=5.0, velocities=False, signed=(False, False), name="log"):
    """A log that tells its rows apart."""
    t = start + period * np.arange(rows)
    q = np.sin(t[:, None] + np.arange(joints))
    effort = np.where(signed, q, np.abs(q))
    return Log(t, q, effort, np.array(signed), np.cos(t[:, None] + np.arange(joints)) if velocities else None, name)


def test_logs_join_with_a_pause_between_them_and_keep_their_own_times():
    """Those that are joined already, too."""
    lengths = (80, 60, 51)
    logs = [recorded(n, start=s, velocities=True) for n, s in zip(lengths, (1.7e9, -3.0, 10.0), strict=True)]
    joined, rows = join_logs([join_logs(logs[:2]), logs[2]]), [(0, 80), (80, 140), (140, 191)]
    assert joined.pooled
    assert joined.source == "log + log + log"
    for name in ("q", "dq", "effort"):
        np.testing.assert_array_equal(getattr(joined, name), np.concatenate([getattr(log, name) for log in logs]))
    steps = np.diff(joined.t)
    assert (steps[[79, 139]] >= 1.0).all(), "longer than 20 periods, which is a pause, and than any filter"
    np.testing.assert_allclose(np.delete(steps, [79, 139]), 0.01, rtol=1e-4)
    np.testing.assert_allclose(joined.t, join_logs(logs).t, rtol=0.0, atol=1e-6)
    for log in (joined, joined.rectified(), replace(joined, effort=2.0 * joined.effort, source="twice as strong")):
        assert [(one.start_row, one.stop_row) for one in log.pieces] == rows
        for piece, one in zip(log.pieces, logs, strict=True):
            np.testing.assert_array_equal(piece.t, one.t, err_msg="to the last digit, though 1.7e9 s were added")
    assert join_logs(logs[:1]) is logs[0]
    assert not logs[0].pooled


def test_logs_that_do_not_belong_together():
    for other, said in (
        ({"joints": 3, "signed": (False,) * 3}, "has 3 joints, but log has 2"),
        ({"signed": (True, False)}, "the signed joints differ"),
        ({"period": 0.004}, "has 250 Hz, but log has 100 Hz"),
    ):
        with pytest.raises(InputError, match=f"b.csv: {said}"):
            join_logs([recorded(), recorded(**other, name="b.csv")])


def test_a_list_is_several_logs(tmp_path):
    """Files are read by the options, a log stays as it is; a tuple would be parts of one run."""
    first, second = (recorded(n, signed=(True, True), name=f"{n}") for n in (90, 70))
    joined = read_log([first.save(tmp_path / "first.csv"), second.rectified()], unsigned="all")
    np.testing.assert_array_equal(joined.effort, np.abs(np.concatenate([first.effort, second.effort])))
    assert [len(piece.t) for piece in joined.pieces] == [90, 70]
    for wrong, said in (([], "`source`: is an empty list"), (first, "90: is already a Log")):
        with pytest.raises(InputError, match=said):
            read_log(wrong)


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
        (["runs/b.csv", "no/where.csv"], ["runs/b.csv", "no/where.csv"]),
        (["runs/*.csv"], ["runs/10.csv", "runs/2.csv", "runs/A.csv", "runs/a.csv", "runs/b.csv"]),
        (["runs/b.csv", "runs/[aA].csv"], ["runs/b.csv", "runs/A.csv", "runs/a.csv"]),
        (["x[1].csv"], ["x[1].csv"]),
    ):
        assert [path.as_posix() for path in find_logs(patterns)] == found


def test_patterns_that_match_nothing_or_a_log_twice(shelf):
    for pattern in ("runs/*.txt", "nowhere/*", "runs/fol*", "[", "z" * 300 + "*"):
        with pytest.raises(InputError) as caught:
            find_logs(["runs/a.csv", pattern])
        assert str(caught.value).startswith(f"{pattern}: matches no file; ")
    for patterns, said in (
        (["runs/a.csv", "runs/b.csv", "runs/a.csv"], "runs/a.csv: is given twice"),
        (["runs/*.csv", "runs/a.csv"], "runs/a.csv: is given twice"),
        (["runs/a.csv", "runs/deep/../a.csv"], "runs/deep/../a.csv: is the same file as runs/a.csv"),
        (["runs/a.csv", "link.csv"], "link.csv: is the same file as runs/a.csv"),
    ):
        with pytest.raises(InputError) as caught:
            find_logs(patterns)
        assert str(caught.value).startswith(f"{said}; give every log once")
