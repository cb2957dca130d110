"""What was run on which data."""

import hashlib
import json
import struct
import sys
from dataclasses import asdict, replace
from importlib.metadata import version

import numpy as np
import pytest

from bayesid.identification.provenance import fingerprint, hashes, record_provenance
from bayesid.log.log import Log, join_logs, read_log, write_log

T = np.array([0.0, 0.01, 0.02])
Q = np.array([[0.1, -0.2], [0.3, 0.4], [-0.5, 0.6]])
EFFORT = np.array([[1.0, -2.0], [3.0, 4.0], [5.0, -6.0]])


def make_log(**changes):
    values = {"t": T, "q": Q, "effort": EFFORT, "signed": np.array([False, True]), "dq": None, "source": "made"}
    return Log(**{**values, **changes})


def long_log(shift=0.0):
    """As long as a file must be."""
    rows = np.arange(60.0)[:, None]
    return make_log(t=0.01 * rows[:, 0], q=rows * [0.01, -0.02] + shift, effort=rows * [0.5, -0.25])


def test_the_fingerprint_by_hand():
    """Row by row, little-endian: t, q, effort, dq where there is one, then the signed joints as 0 and 1."""
    numbers = [*T, *Q.ravel(), *EFFORT.ravel(), 0.0, 1.0]
    assert fingerprint(make_log()) == hashlib.sha256(struct.pack(f"<{len(numbers)}d", *numbers)).hexdigest()
    dq = Q * 3.0
    numbers = [*T, *Q.ravel(), *EFFORT.ravel(), *dq.ravel(), 0.0, 1.0]
    assert fingerprint(make_log(dq=dq)) == hashlib.sha256(struct.pack(f"<{len(numbers)}d", *numbers)).hexdigest()


@pytest.mark.parametrize(
    "changes",
    [
        {"t": T + 1e-9},
        {"q": Q[::-1]},
        {"effort": EFFORT * (1.0 + 1e-15)},
        {"dq": Q},
        {"dq": 2.0 * Q},
        {"signed": np.array([True, True])},
    ],
)
def test_other_samples_have_another_fingerprint(changes):
    assert fingerprint(make_log(**changes)) != fingerprint(make_log())


def test_names_and_memory_make_no_difference():
    turned = make_log(q=np.asfortranarray(Q), source="elsewhere")
    assert fingerprint(turned) == fingerprint(make_log())


def test_the_same_from_a_file(tmp_path):
    write_log(tmp_path / "log.csv", long_log())
    back = read_log(tmp_path / "log.csv", unsigned="1")
    assert fingerprint(back) == fingerprint(long_log())
    recorded = record_provenance({}, back)
    digest = hashlib.sha256((tmp_path / "log.csv").read_bytes()).hexdigest()
    assert recorded.files == {str(tmp_path / "log.csv"): digest}


def test_all_files_of_joined_logs_are_recorded(tmp_path):
    logs = []
    for name, shift in (("a.csv", 0.0), ("b.csv", 0.5)):
        write_log(tmp_path / name, long_log(shift))
        logs.append(read_log(tmp_path / name, unsigned="1"))
    recorded = record_provenance({}, join_logs(logs))
    assert [path.rpartition("/")[2] for path in recorded.files] == ["a.csv", "b.csv"]
    assert len(set(recorded.files.values())) == 2


def test_a_log_is_known_again_however_it_is_read_or_joined(tmp_path):
    """By its file where signs are taken for known, by its samples where the file is another one."""
    for name, shift in (("a.csv", 0.0), ("b.csv", 0.5), ("c.csv", 0.7)):
        write_log(tmp_path / name, long_log(shift))
    first, second, third = (read_log(tmp_path / name, unsigned="1") for name in ("a.csv", "b.csv", "c.csv"))
    joined = hashes(join_logs([first, second]))
    assert joined & hashes(read_log(tmp_path / "b.csv", unsigned="none"))
    assert joined & hashes(replace(second, source="from elsewhere"))
    assert joined & hashes(join_logs([third, first]))
    assert not joined & hashes(third)
    (tmp_path / "a.csv").rename(tmp_path / "renamed.csv")
    assert joined & hashes(read_log(tmp_path / "renamed.csv", unsigned="none"))


def test_what_is_recorded_of_a_run():
    options = {"seed": 3, "terms": ["rigid_body"], "cutoff": None}
    recorded = record_provenance(options, make_log())
    assert recorded.options == options
    assert recorded.files == {}
    assert recorded.command is None
    assert recorded.versions["python"] == ".".join(map(str, sys.version_info[:3]))
    assert recorded.versions["bayesid"] == version("bayesid")
    assert recorded.versions["clarabel"] == version("clarabel")
    assert recorded.date.endswith("+00:00")
    assert json.loads(json.dumps(asdict(recorded)))["data"] == fingerprint(make_log())
    assert replace(recorded, command="bayesid demo").command == "bayesid demo"
