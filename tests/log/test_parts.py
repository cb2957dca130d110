"""One run in several files: joined by time, positions at the stamps of the efforts, efforts as they were recorded."""

import numpy as np
import pytest
from conftest import real_log
from log_files import flat, read, refusal, save, text

from bayesid import cli
from bayesid.log.reading import read_log, read_motion

N = 2


def motion(t):
    """Positions of two joints at any time."""
    return np.column_stack([np.sin(2.0 * t), 0.4 * np.cos(3.0 * t + 0.5)])


def efforts(t):
    """Rectified efforts with cusps."""
    return np.abs(np.column_stack([30.0 * np.sin(5.0 * t), 8.0 * np.cos(2.0 * t) - 3.0]))


def columns(t, **blocks):
    return flat({"t": t, **blocks})


@pytest.fixture
def places(tmp_path):
    """Positions at 125 Hz from 0 s to 10 s, efforts at 100 Hz from 1 s to 11 s."""
    slow, fast = 1.003 + np.arange(1000) / 100.0, np.arange(1250) / 125.0
    return save(tmp_path / "q.csv", columns(fast, q=motion(fast))), save(
        tmp_path / "tau.csv", text(columns(slow, tau=efforts(slow)), ";")
    )


def test_positions_and_efforts_in_two_files(places):
    """No |effort| is interpolated: each is one of the file's, at its own stamp."""
    log, said = read("+".join(map(str, places)))
    assert len(log) == 899
    np.testing.assert_allclose(log.t, 1.003 + np.arange(899) / 100.0, atol=1e-12)
    np.testing.assert_allclose(log.q, motion(log.t), atol=1e-6)
    np.testing.assert_array_equal(log.effort, efforts(1.003 + np.arange(1000) / 100.0)[:899])
    assert "q.csv+" in log.source
    assert "joined by time: 899 rows at the stamps of " in said
    assert "tau.csv (100 Hz); positions of " in said
    assert "q.csv (125 Hz) by a spline; 101 rows outside the other files' time ranges are left out" in said
    fast, slow = np.arange(1250) / 125.0, 1.003 + np.arange(1000) / 100.0
    given = {"t": fast, "q": motion(fast)}
    for parts in (tuple(places), (given, {"t": slow, "tau": efforts(slow)}), (given, places[1])):
        again, _ = read(parts)
        np.testing.assert_allclose(again.q, log.q, atol=1e-12)
        np.testing.assert_array_equal(again.effort, log.effort)


def test_a_file_a_joint_without_numbers(tmp_path):
    """As KUKA's trace has it: the place of the file is the joint's number; a pattern stands for all of these."""
    t = np.arange(400) / 250.0
    for j in range(N):
        table = {"Zeit": t, "Istposition [Grad]": np.rad2deg(motion(t)[:, j]), "Istmoment [Nm]": efforts(t)[:, j]}
        save(tmp_path / f"trace_{j + 1}.csv", text(table, ";"))
    log, said = read(f"{tmp_path}/trace_?.csv+")
    np.testing.assert_allclose(log.q, motion(t), atol=1e-12)
    np.testing.assert_array_equal(log.effort, efforts(t))
    assert "joined by time: 400 rows at the stamps of " in said
    assert "spline" not in said
    with pytest.warns(UserWarning, match="joined by time: 400 rows"):
        np.testing.assert_allclose(read_motion(f"{tmp_path}/trace_?.csv+").q, motion(t), atol=1e-12)


def test_efforts_at_other_stamps_are_taken_from_the_nearest(tmp_path):
    t, other = np.arange(500) / 100.0, 0.004 + np.arange(500) / 100.0
    first = save(tmp_path / "a.csv", columns(t, q=motion(t)) | {"tau1": efforts(t)[:, 0]})
    second = save(tmp_path / "b.csv", {"t": other, "tau2": efforts(other)[:, 1]})
    log, said = read(f"{first}+{second}")
    np.testing.assert_array_equal(log.effort[:, 1], efforts(other)[1:, 1])
    assert "b.csv from its nearest stamps, at most 4 ms away" in said


def test_rows_in_a_pause_of_the_positions_are_left_out(tmp_path):
    """And repeated rows, as a controller holds its last reading, are no steps."""
    t = np.arange(1000) / 100.0
    kept = t[(t < 4.0) | (t > 5.0)]
    held = np.repeat(motion(kept)[::2], 2, axis=0)[: len(kept)]
    paths = save(tmp_path / "q.csv", columns(kept, q=held)), save(tmp_path / "i.csv", columns(t, i=efforts(t)))
    log, _ = read("+".join(map(str, paths)), [1.0, 1.0])
    inside = (log.t > 0.05) & (log.t < 9.9)
    np.testing.assert_allclose(log.q[inside], motion(log.t[inside]), atol=2e-3)
    assert not np.any((log.t > 4.0) & (log.t < 5.0))
    assert np.sum(log.t < 4.0) > 395


def test_parts_that_do_not_make_a_log(places, tmp_path, capfd):
    q, tau = places
    assert cli.main(["identify", *map(str, places), "--robot", "kr5"]) == 2
    assert "; if another file of the run has them, give both as FILE+OTHER\n" in capfd.readouterr().err
    for late, said in ((1000.0, "have nothing in common: "), (9.0, "the files have 1.99 s in common: ")):
        t = np.arange(1100) / 100.0
        first = save(tmp_path / "first.csv", columns(t, q=motion(t)))
        line = refusal(f"{first}+{save(tmp_path / 'late.csv', columns(t + late, tau=efforts(t)))}")
        assert said in line
        assert line.endswith("; give parts of one run, with times on the same clock")
    t = np.arange(1250) / 125.0
    more = save(tmp_path / "more.csv", columns(t, q=motion(t)))
    assert "q1 is in " in refusal(f"{q}+{more}+{tau}")
    assert "no part holds efforts tau1.. or i1..; add the file with them" in refusal(f"{q}+")
    assert "no part holds positions q1..; add the file with them" in refusal(f"{tau}+")
    assert "no such file" in refusal(f"{q}+nowhere.csv")
    one = save(tmp_path / "one.csv", columns(t, tau=efforts(t)[:, :1]))
    assert "tau2 is in no part; add its file; there are positions of 2 joints" in refusal(f"{q}+{one}")
    assert "no part has a column Last{}" in refusal(f"{q}+{tau}", columns={"i": "Last{}"})
    timeless = save(tmp_path / "timeless.csv", {"x": t, "tau1": t, "tau2": t})
    assert "column t is missing among x, tau{}; name it with --columns t=" in refusal(f"{q}+{timeless}")


@pytest.mark.real
@pytest.mark.parametrize("name", ["ur10e/b_20s.csv", "tx40/a.csv"])
def test_efforts_of_a_real_log_at_a_lower_rate(tmp_path, name):
    """The log is then what it would be with the other rows left out, time stamps that jitter and all."""
    whole = read_log(real_log(name)).rectified()
    position = save(tmp_path / "q.csv", columns(whole.t, q=whole.q))
    effort = save(tmp_path / "tau.csv", columns(whole.t[1::3], tau=whole.effort[1::3]))
    joined, _ = read(f"{position}+{effort}")
    np.testing.assert_array_equal(joined.effort, whole.effort[1::3])
    np.testing.assert_allclose(joined.q, whole.q[1::3], atol=5e-4)
