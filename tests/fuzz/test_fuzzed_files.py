"""Logs, robots and tables of every format, mutated: they are read, or refused in one line."""

import io
import os
import sqlite3
import struct
import sys
import threading
import tomllib
import zlib
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import tomli_w
from hypothesis import strategies as st
from log_files import Bag, flat, save_hdf5, save_matlab, save_parquet, scaled, smooth_recording, text
from mutations import BUDGETS, check_reader, fuzz, mutated_files, mutated_tree
from pyarrow import parquet
from scipy.io import savemat

from bayesid.errors import InputError
from bayesid.excitation.limits import read_limits
from bayesid.files.writing import check_folder
from bayesid.identification.model_file import load
from bayesid.log.formats.stated import parse_columns
from bayesid.log.reading import read_log, read_motion
from bayesid.log.sources import find_logs
from bayesid.regression.knowledge import ParameterPrior, read_nominal
from bayesid.report.report_data import read_report_data
from bayesid.robot import load_robot, robot_from_table

RECORDED = {name: values.round(5) for name, values in smooth_recording(2, 60, 50.0).items()}
IN_DEGREES = scaled(RECORDED, t=1000.0, q=180.0 / np.pi, dq=180.0 / np.pi)
KUKA = {"t": "IPOC", "q": "AIPos.A{}", "dq": "AxisVel.A{}", "tau": "Torque.A{}"}
GERMAN = {"t": "Zeit [ms]", "q": "Achse {} [Grad]", "dq": "dq{} [deg/s]", "tau": "Strom{}"}
RTDE = {"t": "timestamp", "q": "actual_q_{}", "dq": "actual_qd_{}", "tau": "actual_current_{}"}
CLOCK = flat(RECORDED) | {"t": [f"12:00:{t:06.3f}" for t in RECORDED["t"]]}
TEXTS = {
    "csv": ("log.csv", text(flat(RECORDED)).encode()),
    "spaces in UTF-16": ("log.csv", text(flat(RECORDED), " ").encode("utf-16")),
    "German": ("log.csv", text(flat(IN_DEGREES, **GERMAN), ";", ",").encode("cp1252")),
    "KUKA": ("log.csv", text(flat(IN_DEGREES, **KUKA), "\t").encode()),
    "RTDE": ("log.csv", text(flat(RECORDED, start=0, **RTDE), " ").encode()),
    "clock": ("log.csv", text(CLOCK).encode()),
}
DH = b"""name = "arm"
convention = "standard"
gravity = [0.0, 0.0, -9.81]
transmission = [[1.0, 0.0, 0.0], [0.2, 90.0, 0.0], [0.0, 0.0, 70.0]]
joints = [
  { a = 0.3, alpha = 1.5708, d = 0.2, theta = 0.1 },
  { a = 0.2, alpha = 0.0, d = 0.0, theta = -1.2 },
  { type = "prismatic", a = 0.0, alpha = -1.5, d = 0.1, theta = 0.0 },
]
"""
URDF = b"""<?xml version="1.0" encoding="utf-8"?>
<robot name="arm">
  <link name="base"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="hand"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="l1"/>
    <origin xyz="0 0 0.3" rpy="0 0.2 0"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="3"/></joint>
  <joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1.5" velocity="2" effort="9"/></joint>
  <joint name="j3" type="prismatic"><parent link="l2"/><child link="l3"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.5" velocity="1" effort="9"/><mimic joint="j2"/></joint>
  <joint name="weld" type="fixed"><parent link="l3"/><child link="hand"/></joint>
</robot>
"""
LIMITS = b"lower = [-2.0, -1.0, 0.0]\nupper = [2.0, 1.5, 0.5]\nvelocity = 2.5\nacceleration = [8, 8, 2]\n"
OTHERS = {
    "robot.toml": ("", DH),
    "robot.urdf": ("", URDF),
    "limits.toml": ("", LIMITS),
    "limits.urdf": ("", URDF),
    "nominal.csv": ("", b'name,mean,sd,decided\nm1,2.5,0.3,data\n"Fv2",1.5,,prior\nFc3,0.7,1e-2,data\n'),
    "columns.toml": ("", b't = "Zeit [ms]"\nq = "Achse{} [Grad]"\ni = "Strom{1-6} [A]"\ndq2 = "v2"\n'),
}
READERS = {
    "robot": load_robot,
    "limits": read_limits,
    "nominal": lambda path: ParameterPrior(nominal=path),
    "columns": lambda path: parse_columns(str(path)),
}


def read_as_anything(path):
    """A table as a log of torques, of currents and as a motion; others as a log, or by their reader."""
    if path.stem in READERS:
        return check_reader(lambda: READERS[path.stem](path))
    reads = [check_reader(lambda: read_log(path))]
    if path.suffix == ".csv":
        reads.append(check_reader(lambda: read_log(path, gains=[12.0, 9.0], unsigned="1")))
        reads.append(check_reader(lambda: read_motion(path, degrees=True)))
    return any(reads)


@pytest.fixture(scope="module")
def binaries(tmp_path_factory):
    """Name to file name and bytes."""
    folder = tmp_path_factory.mktemp("binaries")
    variables = {"log": RECORDED | {"names": np.array(["a", "bc"], dtype=object)}, "n": 2.0}
    save_matlab(folder / "5.mat", variables)
    save_hdf5(folder / "73.mat", {"log": RECORDED})
    lists = {"state": RECORDED["q"].tolist()}
    save_parquet(folder / "1.parquet", flat(RECORDED) | lists)
    parquet.write_table(pa.table(flat(RECORDED)), folder / "2.parquet", compression="none", use_dictionary=False)
    try:
        for storage, ending in (("sqlite3", ".db3"), ("mcap", ".mcap")):
            bag = Bag()
            bag.write(folder / storage, {"/states": bag.states(RECORDED, ["a1", "a2"])}, storage)
            next((folder / storage).glob(f"*{ending}")).rename(folder / f"bag{ending}")
    except pytest.skip.Exception:
        pass  # without rosbags
    return {path.name: (f"log{path.suffix}", path.read_bytes()) for path in folder.iterdir() if path.is_file()}


@BUDGETS
@pytest.mark.parametrize("family", ["texts", "binaries", "others"])
def test_bytes(tmp_path, binaries, family, examples):
    samples = {"texts": TEXTS, "binaries": binaries, "others": OTHERS}[family]

    def reads(named):
        name, content = named
        path = tmp_path / (samples[name][0] or name)
        path.write_bytes(content)
        return read_as_anything(path)

    assert all(reads((name, content)) for name, (_, content) in samples.items())
    fuzz(mutated_files(samples), reads, 3 * examples)


@BUDGETS
def test_tables_of_robots_and_limits(tmp_path, examples):
    table, path = tomllib.loads(DH.decode()), tmp_path / "limits.toml"
    fuzz(mutated_tree(table), lambda one: check_reader(lambda: robot_from_table(one, "arm")), examples)

    def check(table):
        try:
            path.write_bytes(tomli_w.dumps(table).encode())
        except (TypeError, UnicodeEncodeError, ValueError):  # what TOML cannot hold
            return
        check_reader(lambda: read_limits(path))

    fuzz(mutated_tree(tomllib.loads(LIMITS.decode())), check, examples // 2)


@BUDGETS
def test_options_of_logs(tmp_path, examples):
    path = tmp_path / "log.csv"
    path.write_bytes(TEXTS["csv"][1])
    words = st.text(st.sampled_from('123456789,;=-+{}[]"taudqi. e\u0661\u00b2\n\0'), max_size=30)
    words |= st.sampled_from(["9" * 5000, "1," * 5000, "all", "q{1-" + "9" * 5000 + "}", "[" * 5000, "x" * 5000, "\0"])

    def check(word):
        check_reader(lambda: read_log(path, unsigned=word))
        check_reader(lambda: read_log(path, columns=word))
        check_reader(lambda: read_log(word))
        check_reader(lambda: read_log(path, topic=word or "x"))

    fuzz(words, check, examples)


def test_names_beyond_all_recorders_and_systems(tmp_path):
    path = tmp_path / "log.csv"
    for name in ("q\u0661", "q" + "9" * 5000, "q" + "a" * 100_000, "tau1[" + " " * 50_000):
        path.write_bytes(TEXTS["csv"][1].replace(b"q1", name.encode(), 1))
        with pytest.raises(InputError, match="q1"):
            read_log(path)
    for path in ("a\0b.csv", "x" * 5000, "/".join(["d" * 200] * 50)):
        for read in (read_log, read_limits, read_nominal, load, read_report_data, load_robot):
            with pytest.raises(InputError):
                read(path)
        with pytest.raises(InputError, match="cannot be a file name"):
            check_folder(path, set(), "summary.json")


def test_parquet_files_and_bags_that_unpack_to_too_much(tmp_path, monkeypatch):
    """Equal rows take next to nothing: a table, an MCAP file's chunk, a database's message, a whole packed file."""
    monkeypatch.setattr("bayesid.files.bounded.MOST_UNPACKED", 1 << 20)
    path = save_parquet(tmp_path / "log.parquet", {name: np.ones(60_000) for name in ("t", "q1", "tau1")})
    with pytest.raises(InputError, match="its columns unpack to more than"):
        read_log(path)
    pytest.importorskip("rosbags")
    packed = pa.compress(bytes(5 << 20), "zstd", asbytes=True)
    chunk = struct.pack("<QQQII", 0, 1, 5 << 20, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    magic = b"\x89MCAP0\r\n"
    (tmp_path / "log.mcap").write_bytes(magic + struct.pack("<BQ", 6, len(chunk)) + chunk + magic)
    with closing(sqlite3.connect(tmp_path / "log.db3")) as bag:
        bag.execute("CREATE TABLE messages(data BLOB)")
        bag.execute("INSERT INTO messages VALUES (?)", (packed,))
        bag.commit()
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    (folder / "bag_0.db3.zstd").write_bytes(packed)
    for bad in (tmp_path / "log.mcap", tmp_path / "log.db3", folder):
        with pytest.raises(InputError, match="unpacks to too much"):
            read_log(bad)


def chain(n, kind):
    """Links one after the other."""
    ends = '<joint name="j{0}" type="{2}"><parent link="l{0}"/><child link="l{1}"/><axis xyz="0 0 1"/></joint>'
    joints = "".join(ends.format(k, k + 1, kind) for k in range(n))
    return (
        f'<robot name="snake">{"".join(f"<link name={chr(34)}l{k}{chr(34)}/>" for k in range(n + 1))}{joints}</robot>'
    )


RING = '<joint name="{0}{1}" type="revolute"><parent link="{0}"/><child link="{1}"/></joint>'
LINKS = '<link name="x"/><link name="a"/><link name="b"/>'
SLIDES = URDF.decode().replace('lower="0" upper="0.5"', 'lower="0" upper="0"')
BEYOND = [
    ("limits.urdf", SLIDES.replace('<mimic joint="j2"/>', ""), "is prismatic without limits"),
    ("robot.urdf", chain(5000, "revolute"), "has 5001 links"),
    ("robot.urdf", f'<robot name="deep">{"<a>" * 100_000}{"</a>" * 100_000}</robot>', "more than 32 levels"),
    ("robot.urdf", URDF.decode().replace("0 0 0.3", "0 0 1e308"), "key 'origin xyz' holds 1e\\+308"),
    ("robot.toml", f"joints = {'[' * 5000}{']' * 5000}", "more than 32 levels"),
    ("robot.toml", DH.decode().replace("0.3", "1" + "0" * 400), "key 'a' cannot be used"),
    (
        "limits.urdf",
        f"<robot name='r'>{LINKS}{''.join(RING.format(*one) for one in ('xa', 'ab', 'ba'))}</robot>",
        "two joints",
    ),
]


def test_robots_and_limits_beyond_all_robots(tmp_path):
    for name, content, said in BEYOND:
        path = tmp_path / name
        path.write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match=said):
            READERS[path.stem](path)
    path.write_text(chain(100, "revolute").replace('"revolute"', '"fixed"', 60), encoding="utf-8")
    assert load_robot(path).n_joints == 40


def test_a_pipe_is_read_once(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    threading.Thread(target=path.write_bytes, args=(TEXTS["csv"][1],), daemon=True).start()
    np.testing.assert_array_equal(read_log(path).effort, RECORDED["tau"])


def test_standard_input_and_devices(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(TEXTS["csv"][1])))
    assert find_logs(["-"]) == [Path("-")]
    assert read_log("-").source == "standard input"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"t,q1\n0,0\n")))
    with pytest.raises(InputError, match=r"^standard input, row 1: column tau1"):
        read_log("-")
    with pytest.raises(InputError, match="is a device, not a file"):
        read_log("/dev/zero")


def test_matlab_files_that_claim_more_than_they_hold(tmp_path):
    savemat(path := tmp_path / "log.mat", {"t": np.arange(9.0)})
    header, packed = path.read_bytes()[:128], zlib.compress(bytes(8) + bytes(1 << 20))
    wide = struct.pack("<2I4I2I2i", 14, 48, 6, 8, 1, 0, 5, 8, 30_000, 30_000) + bytes(16)  # cells in 16 bytes
    level_4 = struct.pack("<5i", 0, 1 << 20, 1 << 10, 0, 2) + b"t\0"
    for content in (header + struct.pack("<2I", 15, len(packed)) + packed, header + wide, level_4):
        path.write_bytes(content)
        assert not check_reader(lambda: read_log(path))
