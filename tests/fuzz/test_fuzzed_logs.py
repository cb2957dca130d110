"""Logs of every format, mutated: they are read, or refused in one line."""

import io
import os
import sqlite3
import struct
import sys
import threading
import zlib
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import strategies as st
from mutations import BUDGETS, check_reader, fuzz, mutated_bytes
from pyarrow import parquet
from scipy.io import savemat

from bayesid.errors import InputError
from bayesid.excitation.limits import read_limits
from bayesid.files.writing import check_folder
from bayesid.fit.knowledge import read_nominal
from bayesid.identification.options import call_of_log
from bayesid.identification.provenance import fingerprint, hashes
from bayesid.log.log import find_logs, read_log
from bayesid.log.motions import read_motion
from bayesid.model.robot import load_robot
from bayesid.report.findings import read_findings
from bayesid.results.model_file import load_model

ROWS = 60
T = np.arange(ROWS) / 50.0
COLUMNS = {
    "t": T,
    **{f"q{j}": np.sin(2.0 * j * T + j).round(5) for j in (1, 2)},
    **{f"dq{j}": (2.0 * j * np.cos(2.0 * j * T + j)).round(5) for j in (1, 2)},
    **{f"tau{j}": np.abs(9.0 * j * np.cos(2.0 * j * T)).round(3) for j in (1, 2)},
}
KUKA = ["IPOC", "AIPos.A1", "AIPos.A2", "AxisVel.A1", "AxisVel.A2", "Torque.A1", "Torque.A2"]
GERMAN = ["Zeit [ms]", "Achse 1 [Grad]", "Achse 2 [Grad]", "dq1 [deg/s]", "dq2 [deg/s]", "Strom1", "Strom2"]
RTDE = ["timestamp", "actual_q_0", "actual_q_1", "actual_qd_0", "actual_qd_1", "actual_current_0", "actual_current_1"]


def text(names=tuple(COLUMNS), separator=",", scale=None, encoding="utf-8", decimal="."):
    values = np.column_stack(list(COLUMNS.values())) * (np.ones(len(names)) if scale is None else scale)
    rows = [separator.join(names), *(separator.join(f"{x:.6g}".replace(".", decimal) for x in row) for row in values)]
    return ("\n".join(rows) + "\n").encode(encoding)


def clocked():
    """The time of day in place of seconds."""
    head, *rows = text().decode().splitlines()
    rows = [f"12:00:{t:06.3f},{row.partition(',')[2]}" for t, row in zip(T, rows, strict=True)]
    return "\n".join([head, *rows]).encode()


DEGREES = np.array([1000.0, *[57.29578] * 4, 1.0, 1.0])
TEXTS = {
    "csv": text(),
    "spaces in UTF-16": text(separator=" ", encoding="utf-16"),
    "German": text(GERMAN, ";", DEGREES, "cp1252", ","),
    "KUKA": text(KUKA, "\t", DEGREES),
    "RTDE": text(RTDE, " "),
    "clock": clocked(),
}


def matlab(**options):
    file = io.BytesIO()
    q, tau = (np.column_stack([COLUMNS[f"{kind}{j}"] for j in (1, 2)]) for kind in ("q", "tau"))
    variables = {"log": {"t": T, "q": q, "tau": tau, "names": np.array(["a", "bc"], dtype=object)}, "n": 2.0}
    savemat(file, variables if options.get("format") != "4" else {"t": T, "q": q, "tau": tau}, **options)
    return file.getvalue()


def hdf5():
    file = io.BytesIO()
    with h5py.File(file, "w", userblock_size=512) as content:
        group = content.create_group("log")
        for name in ("q", "tau"):
            group[name] = np.array([COLUMNS[f"{name}{j}"] for j in (1, 2)])
        group.create_dataset("t", data=T[None], compression="gzip")
    return b"MATLAB 7.3 MAT-file".ljust(512, b" ") + file.getvalue()[512:]


def table(**options):
    file = io.BytesIO()
    lists = {"state": [[float(a), float(b)] for a, b in zip(COLUMNS["q1"], COLUMNS["q2"], strict=True)]}
    parquet.write_table(pa.table({**COLUMNS, **lists}), file, **options)
    return file.getvalue()


BINARIES = {
    "MATLAB 5": (".mat", matlab()),
    "MATLAB 5, packed": (".mat", matlab(do_compression=True)),
    "MATLAB 4": (".mat", matlab(format="4")),
    "MATLAB 7.3": (".mat", hdf5()),
    "Parquet": (".parquet", table()),
    "Parquet, plain": (".parquet", table(compression="none", use_dictionary=False)),
}


def read_as_anything(path):
    """As a log of torques, of currents and as a motion."""
    reads = [
        check_reader(lambda: read_log(path)),
        check_reader(lambda: read_log(path, gains=[12.0, 9.0], unsigned="1")),
        check_reader(lambda: read_motion(path, degrees=True)),
    ]
    return any(reads)


@BUDGETS
@pytest.mark.parametrize("form", TEXTS)
def test_tables_of_text(tmp_path, form, examples):
    path = tmp_path / "log.csv"
    path.write_bytes(TEXTS[form])
    assert read_as_anything(path)

    def check(content):
        path.write_bytes(content)
        read_as_anything(path)

    fuzz(mutated_bytes(TEXTS[form]), check, examples)


@BUDGETS
@pytest.mark.parametrize("form", BINARIES)
def test_binary_files(tmp_path, form, examples):
    ending, sample = BINARIES[form]
    path = tmp_path / f"log{ending}"
    path.write_bytes(sample)
    assert check_reader(lambda: read_log(path))

    def check(content):
        path.write_bytes(content)
        check_reader(lambda: read_log(path))

    fuzz(mutated_bytes(sample), check, examples)


def bag_bytes(folder, storage):
    """The file of a bag with joint states."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    kinds = store.types
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin[storage])
    if storage == "MCAP":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer as bag:
        connection = bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for k, t in enumerate(T):
            at = round(1e9 * t)
            stamp = kinds["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            q, dq, tau = (np.array([COLUMNS[f"{kind}{j}"][k] for j in (1, 2)]) for kind in ("q", "dq", "tau"))
            state = kinds["sensor_msgs/msg/JointState"](
                header=header, name=["a1", "a2"], position=q, velocity=dq, effort=tau
            )
            bag.write(connection, at, store.serialize_cdr(state, connection.msgtype))
    return next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3")).read_bytes()


@BUDGETS
@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_bags(tmp_path, storage, examples):
    pytest.importorskip("rosbags")
    sample = bag_bytes(tmp_path / "bag", storage)
    path = tmp_path / ("log.mcap" if storage == "MCAP" else "log.db3")
    path.write_bytes(sample)
    assert check_reader(lambda: read_log(path))

    def check(content):
        path.write_bytes(content)
        check_reader(lambda: read_log(path))

    fuzz(mutated_bytes(sample), check, examples // 2)


@BUDGETS
def test_options(tmp_path, examples):
    path = tmp_path / "log.csv"
    path.write_bytes(TEXTS["csv"])
    words = st.text(st.sampled_from('123456789,;=-+{}[]"taudqi. e\u0661\u00b2\n\0'), max_size=30)
    words |= st.sampled_from(["9" * 5000, "1," * 5000, "all", "q{1-" + "9" * 5000 + "}", "[" * 5000, "x" * 5000, "\0"])

    def check(word):
        check_reader(lambda: read_log(path, unsigned=word))
        check_reader(lambda: read_log(path, columns=word))
        check_reader(lambda: read_log(path, columns={"t": "t", "q": word, "tau": word}))
        check_reader(lambda: read_log(word))
        check_reader(lambda: read_log(path, topic=word or "x"))

    fuzz(words, check, examples)


# ---------------------------------------------------------------------------------------------------------------
# What was found
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["q\u0661", "q" + "9" * 5000, "q" + "a" * 100_000, "tau1[" + " " * 50_000])
def test_headers_beyond_all_recorders(tmp_path, name):
    path = tmp_path / "log.csv"
    path.write_bytes(TEXTS["csv"].replace(b"q1", name.encode(), 1))
    with pytest.raises(InputError, match="q1"):
        read_log(path)


@pytest.mark.parametrize("unsigned", ["9" * 5000, "\u0661", "1,,2", "0"])
def test_joints_beyond_all_robots(tmp_path, unsigned):
    path = tmp_path / "log.csv"
    path.write_bytes(TEXTS["csv"])
    with pytest.raises(InputError, match="is not a joint") as caught:
        read_log(path, unsigned=unsigned)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("path", ["a\0b.csv", "x" * 5000, "/".join(["d" * 200] * 50)])
def test_names_that_no_system_has(path):
    for read in (read_log, read_limits, read_nominal, load_model, read_findings, lambda one: load_robot(one, tip="x")):
        with pytest.raises(InputError):
            read(path)
    with pytest.raises(InputError, match="cannot be the name of a file"):
        check_folder(path, set(), "summary.json")


def test_a_parquet_file_that_unpacks_to_too_much(tmp_path, monkeypatch):
    """Equal rows take next to nothing in the file."""
    monkeypatch.setattr("bayesid.files.bounded.MOST_UNPACKED", 1 << 20)
    path = tmp_path / "log.parquet"
    parquet.write_table(pa.table({name: np.ones(60_000) for name in ("t", "q1", "tau1")}), path)
    assert path.stat().st_size < 20_000
    with pytest.raises(InputError, match="its columns unpack to more than"):
        read_log(path)


def test_bags_that_unpack_to_too_much(tmp_path, monkeypatch):
    """An MCAP file's chunk, a database's message, and a whole file that was packed."""
    pytest.importorskip("rosbags")
    monkeypatch.setattr("bayesid.files.bounded.MOST_UNPACKED", 1 << 20)
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
    assert len(packed) < 10_000
    for bad in (tmp_path / "log.mcap", tmp_path / "log.db3", folder):
        with pytest.raises(InputError, match="unpacks to too much"):
            read_log(bad)


def test_matlab_files_that_claim_more_than_they_hold(tmp_path):
    path = tmp_path / "log.mat"
    packed = zlib.compress(bytes(8) + bytes(1 << 20))
    wide = struct.pack("<2I4I2I2i", 14, 48, 6, 8, 1, 0, 5, 8, 30_000, 30_000) + bytes(16)  # cells in 16 bytes
    header = BINARIES["MATLAB 5"][1][:128]
    for content in (
        header + struct.pack("<2I", 15, len(packed)) + packed,
        header + wide,
        struct.pack("<5i", 0, 1 << 20, 1 << 10, 0, 2) + b"t\0",
    ):
        path.write_bytes(content)
        assert not check_reader(lambda: read_log(path))


# ---------------------------------------------------------------------------------------------------------------
# Streams
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture
def pipe(tmp_path):
    """A named pipe into which a thread writes what it is given, once."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    return lambda content: (threading.Thread(target=path.write_bytes, args=(content,), daemon=True).start(), path)[1]


@pytest.mark.parametrize("form", ["csv", "KUKA", "German", "MATLAB 7.3", "Parquet"])
def test_a_pipe_is_read_once(tmp_path, pipe, form):
    ending, content = BINARIES.get(form, (".csv", TEXTS.get(form)))
    path = tmp_path / f"log{ending}"
    path.write_bytes(content)
    gains = [2.0, 3.0] if form == "German" else None
    log, of_file = read_log(pipe(content), gains=gains), read_log(path, gains=gains)
    assert log.source == str(tmp_path / "pipe")
    np.testing.assert_array_equal(log.effort, of_file.effort)
    assert hashes(log) == {fingerprint(of_file)}, "the same samples; of the file itself nothing is left"
    assert call_of_log(log) == "log"


def test_a_bad_row_of_a_pipe_is_named(pipe, tmp_path):
    with pytest.raises(InputError) as caught:
        read_log(pipe(TEXTS["csv"].replace(b"\n0.04,", b"\nnan,")))
    assert str(caught.value).startswith(f"{tmp_path / 'pipe'}, row 4: column t holds nan")


def test_standard_input(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(TEXTS["csv"])))
    assert find_logs(["-"]) == [Path("-")]
    assert read_log("-").source == "standard input"


def test_a_device_is_no_log():
    with pytest.raises(InputError, match="is a device, no file"):
        read_log("/dev/zero")
