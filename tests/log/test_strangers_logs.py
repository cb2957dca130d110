"""Logs of people who have not read the documentation: read right at once, or one line that says what to do."""

import csv
import io
import time

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.log.log import read_log

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
    """The one line that refuses a log."""
    with pytest.raises(InputError) as caught:
        read_log(source, **options)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy
    return str(caught.value)


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
    """100,000 rows of six joints; the limit of a loaded machine is far above what it takes."""
    t = np.arange(100_000) * 2.0
    block = np.sin(1e-3 * t[:, None] + np.arange(12))
    path = tmp_path / "long.csv"
    names = ["t", *(f"q{j}" for j in range(1, 7)), *(f"tau{j}" for j in range(1, 7))]
    np.savetxt(path, np.column_stack([t, block]), "%.6g", ",", header=",".join(names), comments="")
    began = time.perf_counter()
    assert "milliseconds?" in refusal(path)
    assert time.perf_counter() - began < 5.0
