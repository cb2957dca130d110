"""Logs as files of any format, and what is read of them."""

import csv
import io
import warnings

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.log.reading import read_log


def smooth_recording(n=3, rows=300, rate=100.0):
    """Columns t, q, dq, tau of n joints, no two alike; velocities are those of the positions."""
    t, j = np.arange(rows) / rate, np.arange(n)
    w, phase = 2.0 + 1.1 * j, 0.3 + 0.85 * j
    q, dq = np.sin(w * t[:, None] + phase), w * np.cos(w * t[:, None] + phase)
    return {"t": t, "q": q, "dq": dq, "tau": 30.0 / (1.0 + j) * q - 4.0 * dq + 1.5}


def flat(columns, start=1, **names):
    """Vectors by name: q1, q2, ..., or after a pattern as in q="Achse{} [Grad]", counted from `start`."""
    found = {}
    for kind, values in columns.items():
        pattern = names.get(kind, kind if kind == "t" else f"{kind}{{}}")
        for j, column in enumerate(np.atleast_2d(np.asarray(values).T)):
            found[pattern.replace("{}", str(j + start))] = column
    return found


def without(columns, *names):
    return {name: values for name, values in columns.items() if name not in names}


def scaled(columns, **factors):
    """The same in other units."""
    return columns | {name: np.asarray(columns[name]) * factor for name, factor in factors.items()}


def text(columns, separator=",", decimal=".", end="\n", quote=csv.QUOTE_MINIMAL):
    """A table as text, with all digits; columns of words stay as they are."""
    file = io.StringIO()
    writer = csv.writer(file, delimiter=separator, lineterminator=end, quoting=quote)
    writer.writerow(columns)
    cells = [[c if isinstance(c, str) else repr(float(c)).replace(".", decimal) for c in v] for v in columns.values()]
    writer.writerows(zip(*cells, strict=True))
    return file.getvalue()


RECORDED = smooth_recording()
GERMAN = {"t": "Uhr [ms]", "q": "Gelenk {} ist [Grad]", "dq": "Tempo{}", "i": "Last{} [A]"}
"""Names of which none is known beforehand."""


def strange():
    """A stranger's columns, with words and other numbers among them; efforts are currents of gain 1."""
    names, q = GERMAN | {"q": "Gelenk {} ist [°]"}, np.rad2deg(RECORDED["q"])
    columns = flat({"t": RECORDED["t"] * 1e3, "q": q, "dq": RECORDED["dq"], "i": RECORDED["tau"]}, **names)
    rows = len(q)
    return {"Nr": np.arange(rows), **columns, "Soll1": np.zeros(rows), "Bemerkung": ["a;b, c"] * rows}


def kuka(recorded, position="AIPos.A", effort="MACur.A", velocity="AxisVel.A", clock="IPOC"):
    """A controller's columns, among others; efforts in N m and in A are the same numbers here."""
    rows = len(recorded["t"])
    columns = {"RIst.X": np.full(rows, 812.5), clock: np.round(recorded["t"] * 1e3)}
    columns |= flat({"q": np.rad2deg(recorded["q"])}, q=f"{position}{{}}") | flat(
        {"dq": np.rad2deg(recorded["dq"])}, dq=f"{velocity}{{}}"
    )
    columns |= flat({"tau": recorded["tau"]}, tau=f"{effort}{{}}") if "tau" in recorded else {}
    return columns | {"EIPos.E1": np.zeros(rows), "Digout.o1": np.ones(rows)}


def save(path, content, encoding="utf-8"):
    """Writes text, or the table of some columns."""
    content = text(content) if isinstance(content, dict) else content
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def save_parquet(path, columns):
    parquet.write_table(pa.table(dict(columns)), path)
    return path


def save_matlab(path, variables):
    savemat(path, variables)
    return path


def save_hdf5(path, variables):
    """As MATLAB's `save(..., '-v7.3')` does: a block of text before HDF5, arrays transposed, structs as groups."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_group("#refs#")
        for name, value in variables.items():
            for field, array in value.items() if isinstance(value, dict) else [("", value)]:
                file[f"{name}/{field}".rstrip("/")] = np.atleast_2d(array).T
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Tue Feb 3 04:05:06 2026")
    return path


class Bag:
    """Writes bags of joint states."""

    def __init__(self):
        rosbag2, typesys = pytest.importorskip("rosbags.rosbag2"), pytest.importorskip("rosbags.typesys")
        self.rosbag2, self.types = rosbag2, typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)

    def state(self, t, names, q, dq, tau, stamped=True):
        """A message, and when it is received: 1 ms later."""
        kinds = self.types.types
        sec, rest = divmod(round(t * 1e9), 1_000_000_000)
        stamp = kinds["builtin_interfaces/msg/Time"](sec if stamped else 0, rest if stamped else 0)
        header = kinds["std_msgs/msg/Header"](stamp, "base")
        state = kinds["sensor_msgs/msg/JointState"](header, list(names), *map(np.array, (q, dq, tau)))
        return round(t * 1e9) + 1_000_000, state

    def states(self, recorded, names, stamped=True):
        """All rows of a log; from the second on, the joints in another order in each."""
        rng = np.random.default_rng(3)
        found = []
        for k, t in enumerate(recorded["t"]):
            order = rng.permutation(len(names)) if k else np.arange(len(names))
            blocks = [recorded[kind][k][order] if kind in recorded else [] for kind in ("q", "dq", "tau")]
            found.append(self.state(t, [names[j] for j in order], *blocks, stamped))
        return found

    def write(self, path, topics, storage="sqlite3"):
        with self.rosbag2.Writer(path, version=9, storage_plugin=self.rosbag2.StoragePlugin[storage.upper()]) as bag:
            for topic, states in topics.items():
                kind = "sensor_msgs/msg/JointState" if states else "std_msgs/msg/String"
                connection = bag.add_connection(topic, kind, typestore=self.types)
                for received, state in states:
                    bag.write(connection, received, self.types.serialize_cdr(state, kind))
        return path


def assert_same(log, recorded, atol=1e-12):
    """As recorded, to a rounding; velocities are only there if they were recorded."""
    np.testing.assert_allclose(log.t, recorded["t"], rtol=0.0, atol=max(atol, 1e-12))
    for name, values in {"q": log.q, "dq": log.dq, "tau": log.effort}.items():
        if name not in recorded:
            assert values is None
        else:
            np.testing.assert_allclose(values, recorded[name], rtol=1e-12, atol=atol)


def read(source, *arguments, **options):
    """A log, and what was said about it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        log = read_log(source, *arguments, **options)
    return log, " ".join(str(one.message) for one in said)


def refusal(source, *arguments, **options):
    """The one line that refuses a log, for those who gave options."""
    with pytest.raises(InputError) as caught:
        read_log(source, *arguments, **options)
    assert "\n" not in in_options(str(caught.value))
    assert caught.value.remedy
    return in_options(str(caught.value))
