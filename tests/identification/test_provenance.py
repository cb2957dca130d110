"""What was run on which data: options as plain values, the call, fingerprints; and searches of a user's own."""

import hashlib
import json
import struct
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version

import numpy as np
from identified_arm import ROBOT, log_of

import bayesid
from bayesid.identification.options import call_of, call_of_log, fingerprint, hashes, plain_options, record_provenance
from bayesid.log.log import Log, join_logs
from bayesid.log.reading import read_log
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, no_steps
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search


def test_a_run_is_told_as_a_python_call(tmp_path):
    """What is usual is left out; a log that was read is read again with the same joints unsigned."""
    usual = {"search": Certified(), "posterior": True}
    assert call_of("identify", "'kr5'", "log", search=(Certified(), usual["search"])) == "bayesid.identify('kr5', log)"
    chosen = {"search": Certified(budget=2.5, fallback=Beam(width=7)), "posterior": Sampling(rng=3)}
    told = call_of("identify", "'kr5'", "log", **{name: (chosen[name], usual[name]) for name in usual})
    assert told == (
        "bayesid.identify('kr5', log, search=bayesid.Certified(budget=2.5, fallback=bayesid.Beam(width=7)), "
        "posterior=bayesid.Sampling(rng=3))"
    )
    repeated = eval(told.partition("search=")[2].partition(", posterior")[0])
    assert repeated == chosen["search"]
    log = log_of(0, signed=False)
    assert call_of_log(log) == "log"
    path = tmp_path / "a log.csv"
    log.save(path)
    again = eval(call_of_log(replace(read_log(path), signed=np.array([False, True, False]))))
    np.testing.assert_array_equal(again.signed, [False, True, False])
    np.testing.assert_array_equal(again.q, read_log(path).q)


@dataclass(frozen=True)
class Mine(Search):
    """A beam under another name, which claims nothing and has no last word."""

    width: int = 2
    any_model = False

    def find(self, problem, steps=no_steps):
        return replace(Beam(width=self.width).find(problem, steps), method="mine", lower_bound=None)

    def certify(self, problem, progress=SILENT):
        return problem.earlier


def test_a_search_of_a_users_own_finds_the_signs_and_is_named():
    log = log_of(0)
    result = bayesid.identify(ROBOT, log.rectified(), search=Mine(), posterior=False)
    options = result.provenance.options
    assert (options["search"], options["search.width"], options["posterior"]) == ("mine", 2, None)
    assert result.search.method == "mine"
    assert not result.search.certified
    assert result.model_selection.effects == (), "a search that knows one model completes none"
    strong = np.abs(log.effort) >= 0.05 * np.abs(log.effort).max(axis=0)
    assert np.mean((result.sample_signs == np.sign(log.effort))[strong]) >= 0.99


def test_a_search_that_knows_one_model_gives_no_second_opinion():
    result = bayesid.identify(ROBOT, log_of(0, False), ["rigid_body"], complete="off", search=Mine(), posterior=False)
    assert result.sign_terms == ("rigid_body",)
    assert result.completed_model_weight == 1.0


@dataclass(frozen=True)
class Odd:
    price: Callable[[float], float] = abs
    weights: dict[str, object] = field(default_factory=lambda: {"a": np.ones(2)})


def test_options_are_plain_values_under_their_names():
    """What JSON cannot hold is written out."""
    options = plain_options({"search": Odd(), "posterior": Sampling(rng=3), "other": Beam(width=3)})
    assert (options["posterior.rng"], options["other"], options["other.width"]) == (3, "beam", 3)
    assert "abs" in options["search.price"]
    assert "array" in options["search.weights"]
    assert json.loads(json.dumps(options)) == options


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
    assert fingerprint(make_log(q=np.asfortranarray(Q), source="elsewhere")) == fingerprint(make_log())
    dq = Q * 3.0
    numbers = [*T, *Q.ravel(), *EFFORT.ravel(), *dq.ravel(), 0.0, 1.0]
    assert fingerprint(make_log(dq=dq)) == hashlib.sha256(struct.pack(f"<{len(numbers)}d", *numbers)).hexdigest()


def test_a_log_is_known_again_however_it_is_read_or_joined(tmp_path):
    """By its file where signs are taken for known, by its samples where the file is another one."""
    for name, shift in (("a.csv", 0.0), ("b.csv", 0.5), ("c.csv", 0.7)):
        long_log(shift).save(tmp_path / name)
    recorded = record_provenance({}, read_log(tmp_path / "a.csv"))
    assert recorded.files == {str(tmp_path / "a.csv"): hashlib.sha256((tmp_path / "a.csv").read_bytes()).hexdigest()}
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
    assert (recorded.options, recorded.files, recorded.command) == (options, {}, None)
    assert recorded.versions["python"] == ".".join(map(str, sys.version_info[:3]))
    assert recorded.versions["bayesid"] == version("bayesid")
    assert recorded.date.endswith("+00:00")
    assert json.loads(json.dumps(asdict(recorded)))["data"] == fingerprint(make_log())
