"""Logs of every format, mutated: they are read, or refused in one line."""

import io
import os
import threading

import h5py
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import strategies as st
from mutations import BUDGETS, check_reader, fuzz, mutated_bytes
from pyarrow import parquet
from scipy.io import savemat

from bayesid import cli
from bayesid.errors import InputError
from bayesid.log.log import read_log
from bayesid.log.motions import read_motion

ROWS = 60
T = np.arange(ROWS) / 50.0
COLUMNS = {
    "t": T,
    **{f"q{j}": np.sin(2.0 * j * T + j).round(5) for j in (1, 2)},
    **{f"dq{j}": (2.0 * j * np.cos(2.0 * j * T + j)).round(5) for j in (1, 2)},
    **{f"tau{j}": np.abs(9.0 * j * np.cos(2.0 * j * T)).round(3) for j in (1, 2)},
}
KUKA = ["IPOC", "AIPos.A1", "AIPos.A2", "AxisVel.A1", "AxisVel.A2", "Torque.A1", "Torque.A2"]
GERMAN = ["Zeit [ms]", "Achse 1 [Grad]", "Achse 2 [Grad]", "Geschwindigkeit1", "Geschwindigkeit2", "Strom1", "Strom2"]
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
    words |= st.sampled_from(["9" * 5000, "1," * 5000, "all", "q{1-" + "9" * 5000 + "}", "[" * 5000, "x" * 5000, "\0", "\ud800"])

    def check(word):
        check_reader(lambda: read_log(path, unsigned=word))
        check_reader(lambda: read_log(path, columns=word))
        check_reader(lambda: read_log(path, columns={"t": "t", "q": word, "tau": word}))
        check_reader(lambda: read_log(word))
        check_reader(lambda: read_log(path, topic=word or "x"))

    fuzz(words, check, examples)
