"""Samples of a stream: decoded and unwrapped as they come, as the recording of it would be."""

import io

import numpy as np
import pytest
from log_files import flat, smooth_recording, text

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.log.formats.table import Options
from bayesid.log.rows import RowReader

RECORDED = smooth_recording()
T, Q = RECORDED["t"], RECORDED["q"]
COUNTS = np.rint(RECORDED["tau"] * [10.0, 20.0, 30.0])


def rows_of(columns, encoding=None, **options):
    """What comes of a stream, row by row, and its reader."""
    content = columns if isinstance(columns, str) else text(columns)
    reader = RowReader(io.BytesIO(content.encode()), "stream", options=Options(encoding=encoding), **options)
    return list(reader), reader


def refusal(columns, encoding=None):
    with pytest.raises(InputError) as caught:
        rows_of(columns, encoding)
    return in_options(str(caught.value))


@pytest.mark.parametrize(
    ("encoding", "counts"),
    [
        ("twos:16", np.where(COUNTS < 0, COUNTS + 65536, COUNTS)),
        ("twos:32", np.where(COUNTS < 0, COUNTS + 2.0**32, COUNTS)),
        ("sign-bit:10", np.where(COUNTS < 0, 1024 - COUNTS, COUNTS)),
        ("offset:2048", COUNTS + 2048),
        ("twos:64", COUNTS.astype(np.int64).view(np.uint64)),
    ],
)
def test_a_code_that_is_known_is_decoded_in_each_row(encoding, counts):
    lines = [
        ",".join([repr(float(t)), *map(repr, q.tolist()), *(f"{c:.0f}" for c in n)])
        for t, q, n in zip(T, Q, counts, strict=True)
    ]
    if encoding == "twos:64":
        lines = [",".join([*line.split(",")[:4], *map(str, n)]) for line, n in zip(lines, counts, strict=True)]
    rows, reader = rows_of("\n".join(["t,q1,q2,q3,tau1,tau2,tau3", *lines]), encoding)
    np.testing.assert_array_equal([row.effort for row in rows], COUNTS)
    assert reader.signed.all()
    assert not reader.assumed
    assert reader.bad == 0
    if encoding != "twos:64":
        assert "--encoding" in refusal(flat({"t": T, "q": Q, "tau": COUNTS}), encoding)


def test_directions_count_where_it_is_known_which_is_negative():
    columns = flat({"t": T, "q": Q, "tau": np.abs(COUNTS)})
    for encoding, ways in (
        ("direction:1", COUNTS < 0),
        ("direction:0", COUNTS >= 0),
        ("direction:-1", np.sign(COUNTS)),
    ):
        directed = columns | flat({"direction": ways * 1.0})
        rows, _ = rows_of(directed, encoding)
        np.testing.assert_array_equal([row.effort for row in rows], COUNTS)
        assert "--encoding" in refusal(directed)
        assert not rows_of(directed, "magnitude")[1].signed.any()
    assert "no direction columns" in refusal(columns, "direction:1")


@pytest.mark.parametrize("degrees", [True, False])
def test_wrapped_angles_are_unwrapped_as_they_come(degrees):
    q = 2.0 * Q + 3.0
    wrapped = (q + np.pi) % (2.0 * np.pi) - np.pi
    wrapped[:, 2] = 4.0 * Q[:, 2]
    kept = np.delete(np.arange(len(T)), np.arange(100, 140))
    columns = flat({"t": T, "q": np.rad2deg(wrapped) if degrees else wrapped, "tau": COUNTS})
    rows, _ = rows_of({name: values[kept] for name, values in columns.items()}, degrees=degrees)
    seen = np.array([row.q for row in rows])
    turns = (seen[:, :2] - q[kept, :2]) / (2.0 * np.pi)
    np.testing.assert_allclose(turns[:100], np.tile(np.rint(turns[0]), (100, 1)), atol=1e-9)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)
    assert np.abs(np.diff(seen[100:], axis=0)).max() < 0.5
    np.testing.assert_allclose(seen[:, 2], wrapped[kept, 2], atol=1e-9)
    late = [*T[:60], T[20], *T[60:]]
    again = np.insert(wrapped, 60, wrapped[20], axis=0)
    rows, _ = rows_of(flat({"t": late, "q": again, "tau": np.insert(COUNTS, 60, 0.0, axis=0)}))
    np.testing.assert_allclose(np.delete([row.q for row in rows], 60, axis=0)[:100], seen[:100], atol=1e-9)


def test_a_jump_by_360_is_one_of_degrees():
    wrapped = Q.copy()
    wrapped[:, 1] = np.rad2deg(2.0 * Q[:, 1]) % 360.0
    assert "q2[deg]" in refusal(flat({"t": T, "q": wrapped, "tau": COUNTS}))
    columns = flat({"t": T, "q": wrapped, "tau": COUNTS})
    rows, _ = rows_of({name.replace("q2", "q2[deg]"): values for name, values in columns.items()})
    assert np.abs(np.diff([row.q[1] for row in rows])).max() < 0.5


def test_seconds_and_what_is_to_be_added():
    whole = np.floor(T + 1e-9)
    columns = {"sec": whole, "nanosec": np.rint((T - whole) * 1e9)} | flat({"q": Q, "tau": COUNTS})
    rows, reader = rows_of(columns)
    np.testing.assert_allclose([row.t for row in rows], T, atol=1e-9)
    assert reader.bad == 0
