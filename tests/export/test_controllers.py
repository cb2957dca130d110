"""Programs of a planned motion: each format is read back by other means and compared with the motion."""

import csv
import re
from types import SimpleNamespace

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.export.controllers import (
    PROGRAM_FILES,
    PlannedMotion,
    check_programs,
    cubic,
    joint_trajectory,
    krl_axes,
    krl_program,
    quintic,
    rsi_table,
    save_programs,
    urscript,
)
from bayesid.motion import Motion

DURATION = 2.05
CENTRE = np.array([0.3, -1.7, 0.9, 2.2, -0.4, 1.1])
SWING = np.array([0.5, -0.31, 0.23, 0.17, -0.41, 0.07])
ASYMMETRIC = np.array([1.0, 2.0, 3.0, 1.0, 2.0, 4.0])
"""Number of periods of each joint in the duration."""


def formula(t, joints):
    """Positions alone: a smooth bump from rest to rest between different poses."""
    s = (np.asarray(t) / DURATION)[:, None]
    smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return CENTRE[:joints] + SWING[:joints] * (np.sin(0.5 * np.pi * ASYMMETRIC[:joints] * smooth) + 0.3 * smooth)


def at(joints=6):
    def motion(t):
        s = (np.asarray(t) / DURATION)[:, None]
        smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        first, second = 30.0 * s**2 * (1.0 - s) ** 2 / DURATION, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / DURATION**2
        w = 0.5 * np.pi * ASYMMETRIC[:joints]
        inner, curve = w * np.cos(w * smooth) + 0.3, -(w**2) * np.sin(w * smooth)
        swing = SWING[:joints]
        return Motion(t, formula(t, joints), swing * inner * first, swing * (inner * second + curve * first**2))

    return motion


def planned(joints=6, rate=100.0, prismatic=None, **what):
    names = what.pop("joint_names", tuple(f"joint_{j}" for j in range(1, joints + 1)))
    what = {"checked": ("self-collisions",), "not_checked": ("efforts",), **what}
    return PlannedMotion("arm", names, prismatic or (False,) * joints, at(joints), DURATION, rate, **what)


def numbers(text):
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?(?:[eE]-?\d+)?", text)]


def test_a_slowed_motion_has_the_same_path_and_the_derivatives_of_its_own_time():
    share = 0.1
    slow = planned().slowed(share)
    assert slow.duration == pytest.approx(DURATION / share, rel=1e-15)
    t, step = np.linspace(0.1, 0.9, 17) * slow.duration, 1e-3 / share
    before, here, after = (slow.at(t + shift) for shift in (-step, 0.0, step))
    np.testing.assert_allclose(here.q, formula(share * t, 6), rtol=0, atol=1e-14)
    for values, ahead, back in ((here.dq, after.q, before.q), (here.ddq, after.dq, before.dq)):
        scale = np.abs(values).max()
        np.testing.assert_allclose((ahead - back) / (2.0 * step), values, rtol=0, atol=3e-4 * scale)
    assert slow.slowed(0.5).share == pytest.approx(0.5 * share)


def test_via_points_determine_the_motion_between_them():
    t = np.linspace(0.0, DURATION, 4001)
    for between in (cubic, quintic):
        points, deviation = planned().points(500, between)
        truth = np.abs(between(points, t) - formula(t, 6)).max()
        assert truth <= 1.2e-5
        assert deviation == pytest.approx(truth, rel=0.2)
    with pytest.raises(InputError, match="intervals are too few"):
        planned().points(3, cubic)


def poses(text, command):
    """(K, n) numbers, and the axes, of all lines with a command."""
    lines = [line.split("{")[1].rstrip("}") for line in text.splitlines() if line.strip().startswith(f"{command} {{")]
    pairs = [[part.split() for part in line.split(", ")] for line in lines]
    (axes,) = {tuple(axis for axis, _ in row) for row in pairs}
    return axes, np.array([[float(value) for _, value in row] for row in pairs])


def test_krl_points_are_the_motion():
    share = 0.3
    slides = (False, True, False, False, False, False)
    text = krl_program(planned(prismatic=slides).slowed(share))
    axes, values = poses(text, "SPTP")
    assert axes == ("A1", "A2", "A3", "A4", "A5", "A6")
    parts = np.array([numbers(line.split("=")[1])[0] for line in text.splitlines() if "TIME_BLOCK PART" in line])
    (end,) = (numbers(line.split("=")[1])[0] for line in text.splitlines() if "TIME_BLOCK END =" in line)
    assert end == pytest.approx(DURATION / share, abs=5e-5)
    assert len(parts) == len(values) - 1
    np.testing.assert_allclose(parts, 100.0 / len(parts), rtol=0, atol=5.1e-7, err_msg="even in time")
    units = np.array([180.0 / np.pi, 1000.0, *[180.0 / np.pi] * 4])
    exact = units * formula(np.linspace(0.0, DURATION, len(values)), 6)
    np.testing.assert_allclose(values, exact, rtol=0, atol=5.1e-7)
    np.testing.assert_array_equal(poses(text, "PTP")[1], values[:1])


def test_rsi_rows_are_corrections_from_the_start_pose_once_a_cycle():
    lines = rsi_table(planned(rate=83.33)).splitlines()
    axes, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    assert axes == ["A1", "A2", "A3", "A4", "A5", "A6"]
    t = np.minimum(0.012 * np.arange(len(rows)), DURATION)
    assert t[-2] < DURATION == t[-1]
    expected = np.degrees(formula(t, 6) - formula([0.0], 6))
    np.testing.assert_allclose(np.array(rows, dtype=float), expected, rtol=0, atol=5.1e-7)


def run(script):
    """Calls of a script, which differs from Python by `end`."""
    lines = [line for line in script.splitlines() if line.strip() != "end"]
    calls = []

    def record(name):
        return lambda *given, **named: calls.append((name, given, named))

    functions = {name: record(name) for name in ("movej", "servoj", "sleep", "stopj")}
    exec("\n".join(lines), functions)
    functions["motion"]()
    return calls


def test_urscript_follows_the_motion_in_its_time():
    rate, cycle = 1000.0, 0.002
    (move, start, named), *between, stop = run(urscript(planned(rate=rate).slowed(0.3)))
    assert move == "movej"
    assert set(named) == {"a", "v"}
    np.testing.assert_allclose(start[0], formula([0.0], 6)[0], rtol=0, atol=5.1e-7)
    assert (between[0][0], stop[0]) == ("sleep", "stopj")
    servo = [given for name, given, _ in between if name == "servoj"]
    assert {given[3] for given in servo} == {cycle}
    t = np.minimum(0.3 * cycle * np.arange(len(servo)), DURATION)
    assert t[-1] == DURATION
    assert t[-2] < DURATION
    np.testing.assert_allclose([given[0] for given in servo], formula(t, 6), rtol=0, atol=5.1e-7)


POINT = re.compile(
    r"- \{positions: \[(.*)\], velocities: \[(.*)\], accelerations: \[(.*)\], "
    r"time_from_start: \{sec: (\d+), nanosec: (\d+)\}\}"
)


def points_of(text):
    found = [POINT.fullmatch(line) for line in text.splitlines() if line.startswith("- ")]
    assert all(found)
    values = [np.array([numbers(match[k]) for match in found]) for k in (1, 2, 3)]
    return *values, np.array([int(match[4]) + 1e-9 * int(match[5]) for match in found])


def test_ros_points_are_the_motion_after_a_lead():
    share = 0.3
    what = planned(4, prismatic=(False, False, True, False)).slowed(share)
    q, dq, ddq, t = points_of(joint_trajectory(what))
    assert t[0] == 10.0
    assert t[-1] - t[0] == pytest.approx(DURATION / share, abs=2e-9)
    here = what.at(t - t[0])
    np.testing.assert_allclose(q, formula(share * (t - t[0]), 4), rtol=0, atol=6e-7)
    np.testing.assert_allclose(dq, here.dq, rtol=0, atol=6e-7)
    np.testing.assert_allclose(ddq, here.ddq, rtol=0, atol=6e-7)


def test_each_speed_has_a_folder_with_the_same_files(tmp_path):
    programs = save_programs(planned(rate=50.0), tmp_path)
    assert [folder.name for folder in programs.folders] == ["speed_10", "speed_30", "speed_100"]
    assert not programs.left_out
    assert set(programs.files) == PROGRAM_FILES
    for folder, percent in zip(programs.folders, (10, 30, 100), strict=True):
        assert {path.name for path in folder.iterdir()} == PROGRAM_FILES
        table = np.genfromtxt(folder / "motion.csv", delimiter=",", names=True)
        assert table.dtype.names == ("t", *(f"{kind}{j}" for kind in ("q", "dq", "ddq") for j in range(1, 7)))
        t = np.minimum(table["t"] * percent / 100.0, DURATION)
        for j in range(6):
            np.testing.assert_allclose(table[f"q{j + 1}"], formula(t, 6)[:, j], rtol=0, atol=1e-8)
        for name in PROGRAM_FILES - {"motion.csv"}:
            head = (folder / name).read_text()[:2000]
            said = "robot: arm", f"at {percent} %", "checked: self-collisions", "NOT checked: efforts"
            assert all(one in head for one in said), name
    (tmp_path / "five").mkdir()
    five = save_programs(planned(5), tmp_path / "five")
    assert set(five.left_out) == {"motion.script"}, "only a UR of six joints has one"
    check_programs(tmp_path)
    (tmp_path / "speed_30" / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="mine"):
        check_programs(tmp_path)


def test_krl_names_joints_as_their_names_end_or_in_order():
    six = "joint_e1", "A2", "x_a3", "joint_a4", "E5", "a6"
    assert krl_axes(planned(joint_names=six)) == ["E1", "A2", "A3", "A4", "E5", "A6"]
    assert krl_axes(planned(3)) == ["A1", "A2", "A3"]
    seven = SimpleNamespace(n_joints=7, joint_names=("joint",) * 7, robot="long arm")
    for write in (krl_program, rsi_table):
        with pytest.raises(InputError, match="long arm: 7 joints need names"):
            write(seven)
