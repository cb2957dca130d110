"""`bayesid track`: a recording replayed, rows as they come, what is written, and what is refused."""

import csv
import io
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from command_line import run, unfolded
from matplotlib.figure import Figure
from payload_cases import PAYLOAD, PayloadCase

import bayesid
from bayesid.identification.model_file import model_table
from bayesid.report import stream as stream_folder

RATE = 50.0
FILES = ["alarms.json", "signed_stream.csv", "stream.json"]
NAMES = ["t", *(f"{kind}{j}" for kind in ("tau", "p", "predicted", "external") for j in (1, 2, 3))]
GAINS = np.array([10.0, 20.0, 5.0])
FOLLOW = "track", "result", "-", "--follow", "--rate", RATE


def shortened(log, seconds):
    """Its first rows."""
    rows = log.t <= seconds
    return replace(log, t=log.t[rows], q=log.q[rows], effort=log.effort[rows])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result, a log like the first, one in which a payload comes at 4 s, and one with signs."""
    place, arm = tmp_path_factory.mktemp("made"), PayloadCase(0)
    bayesid.save(arm.result, place / "result", report=False)
    later, loaded = arm.later(), arm.later(PAYLOAD)
    shortened(later, 4.0).save(place / "log.csv")
    taken = (loaded.t >= 4.0)[:, None]
    replace(later, effort=np.where(taken, loaded.effort, later.effort)).save(place / "taken.csv")
    signed = np.where(arm.result.predict(arm.after).mean < 0.0, -later.effort, later.effort)
    shortened(replace(later, effort=signed, signed=np.ones(3, dtype=bool)), 4.0).save(place / "signed.csv")
    return place


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def stream_of(text):
    """(M, 13) what a stream says."""
    rows = list(csv.reader(text.splitlines()))
    assert rows[0] == NAMES
    return np.array(rows[1:], dtype=float).reshape(-1, len(NAMES))


def read(folder):
    """signed_stream.csv, alarms.json and the summary of stream.json."""
    assert sorted(path.name for path in folder.iterdir() if path.name != "stream.svg") == FILES
    alarms = json.loads((folder / "alarms.json").read_text())
    said = json.loads((folder / "stream.json").read_text())
    assert said["n_alarms"] == len(alarms)
    return stream_of((folder / "signed_stream.csv").read_text()), alarms, said["summary"]


def on_input(monkeypatch, content):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))


def test_a_recording_is_signed_as_it_would_have_been_live(place, monkeypatch, capfd):
    monkeypatch.setattr(stream_folder, "stream_figure", lambda streamed: Figure())  # it takes seconds
    assert run("track", "result", "log.csv", "--lag", 0.04, "--plot", "svg") == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert out.endswith("written to bayesid-track-log/\n")
    for said in ("signs agree", "RMS residual, N m", "no alarms", "rows processed", "delay 0.04 s", "Verdict: good."):
        assert said in unfolded(out)
    stream, alarms, summary = read(place / "bayesid-track-log")
    assert alarms == []
    tracker = bayesid.SignTracker(bayesid.load("result"), RATE, 0.04)
    log = bayesid.read_log("log.csv")
    seen = [tracker.update(*row) for row in zip(log.t, log.q, log.effort, strict=True)]
    seen = [now for now in seen if np.isfinite(now.predicted).all()]
    np.testing.assert_array_equal(stream[:, 0], [now.t for now in seen])
    np.testing.assert_allclose(stream[:, 1:4], [now.effort for now in seen], rtol=1e-6)
    np.testing.assert_allclose(stream[:, 4:7], [now.probability for now in seen], atol=1e-6)
    np.testing.assert_allclose(stream[:, 10:], [now.external for now in seen], rtol=1e-6, atol=1e-9)
    assert summary["instants"] == len(stream)
    assert (summary["counts"]["updates"], summary["counts"]["bad"], summary["lag"]) == (len(log), 0, 0.04)
    assert summary["smoothing"]["share"] > 0.95
    assert 0.0 < summary["update_microseconds"]["median"] <= summary["update_microseconds"]["p99_9"]
    assert (place / "bayesid-track-log" / "stream.svg").stat().st_size > 0
    kept = (place / "bayesid-track-log" / "signed_stream.csv").read_text()
    on_input(monkeypatch, (place / "log.csv").read_bytes())  # read to its end first; an earlier folder is replaced
    assert run("track", "result", "-", "--lag", 0.04, "--out", "bayesid-track-log", "--quiet", "--force") == 0
    assert (place / "bayesid-track-log" / "signed_stream.csv").read_text() == kept
    assert sorted(path.name for path in (place / "bayesid-track-log").iterdir()) == FILES
    assert run("track", "result", "log.csv", "--out", "result") == 2
    assert "holds other files" in capfd.readouterr().err


def test_signs_that_the_log_has_count_where_it_is_said(place, monkeypatch, capfd):
    assert run("track", "result", "signed.csv", "--out", "out", "--lag", 0.04) == 0
    stream, _, summary = read(place / "out")
    assert set(np.unique(stream[:, 4:7])) <= {0.0, 1.0}
    assert summary["smoothing"]["share"] is None
    assert summary["known_signs"]["share"] > 0.95
    assert "Known signs" in capfd.readouterr().out
    assert run("track", "result", "signed.csv", "--out", "out", "--unsigned", "all", "--quiet", "--force") == 0
    assert read(place / "out")[2]["known_signs"] is None
    for options, said in ((("--unsigned", "none"), ""), ((), "signs of negative efforts"), (("--unsigned", "all"), "")):
        on_input(monkeypatch, (place / "signed.csv").read_bytes())
        assert run(*FOLLOW, "--quiet", *options) == 0
        out, err = capfd.readouterr()
        assert said in err
        assert bool(said) == bool(err)
        assert (set(np.unique(stream_of(out)[-150:, 4:7])) == {0.0, 1.0}) == ("none" in options)


def test_a_payload_is_an_alarm_with_the_way_to_go_on(place, monkeypatch, capfd):
    assert run("track", "result", "taken.csv", "--out", "out", "--lag", 0.1) == 0
    out = capfd.readouterr().out
    _, alarms, _ = read(place / "out")
    changes = [one for one in alarms if one["kind"] != "contact"]
    assert changes
    assert all(one["time"] >= 3.5 and one["raised"] >= one["time"] for one in changes)
    keys = {"time", "joint", "kind", "joints", "raised", "duration", "amount", "unit", "explained"}
    assert all(set(one) == keys for one in alarms)
    assert "Verdict: look." in out
    assert "`bayesid discrepancy result ROWS.csv`" in out
    assert f"{changes[0]['time']:.2f} s: {changes[0]['kind']}" in out

    def refuse(model, log, posterior):
        assert log.t[0] >= changes[0]["time"] >= log.t[0] - 1.0 / RATE
        raise bayesid.InputError("is too short", "log", "record more")

    monkeypatch.setattr("bayesid.discrepancy.workflow.explain_log", refuse)
    assert run("track", "result", "taken.csv", "--out", "out", "--lag", 0.1, "--explain", "--quiet", "--force") == 0
    change = next(one for one in read(place / "out")[1] if one["kind"] != "contact")
    assert change["named"] == []
    assert "is too short" in change["named_status"]


def test_rows_that_are_followed_are_answered_as_the_recording_is(place, monkeypatch, capfd):
    content = (place / "taken.csv").read_bytes()
    on_input(monkeypatch, content)
    assert run(*FOLLOW, "--lag", 0.1, "--out", "followed") == 0
    out, err = capfd.readouterr()
    assert run("track", "result", "taken.csv", "--lag", 0.1, "--out", "out", "--quiet") == 0
    (stream, alarms, summary), answers = read(place / "followed"), stream_of(out)
    recorded, of_recording, _ = read(place / "out")
    assert len(answers) == len(content.splitlines()) - 1
    np.testing.assert_allclose(stream, recorded, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(answers[-len(stream) :], stream)
    assert np.isnan(answers[0, 1:4]).all()
    assert np.isnan(answers[0, 10:]).all()
    logged = [line.split(",")[0] for line in content.decode().splitlines()[1:]]
    t = [line.split(",")[0] for line in out.splitlines()[1:]]
    assert t[0] == logged[0]
    assert set(t) <= set(logged)
    assert t == sorted(t, key=float)
    assert alarms == of_recording
    raised = [json.loads(line) for line in err.splitlines() if line.startswith("{")]
    assert [one["kind"] for one in raised if one["kind"] != "contact"] == [
        one["kind"] for one in alarms if one["kind"] != "contact"
    ]
    assert summary["smoothing"] is None
    assert "rows processed" in err


def test_the_first_second_gives_the_rate_of_a_stream(place, monkeypatch, capfd):
    """Rows in ms by the header, one of them late; from 1 s on each answer is as with the rate stated."""
    header, *rows = (place / "log.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    in_ms = [",".join([repr(1e3 * float(t)), *others]) for t, *others in [*cells[:20], cells[15], *cells[20:]]]
    content = "\n".join([header.replace("t,", "t[ms],", 1), *in_ms]).encode()
    found = {}
    for name, options in (("stated", ("--rate", RATE)), ("found", ())):
        on_input(monkeypatch, content)
        assert run(*FOLLOW[:4], *options, "--lag", 0.1, "--out", name) == 0
        out, err = capfd.readouterr()
        assert ("rate: 50 Hz" in err) == (name == "found")
        found[name] = stream_of(out), read(place / name)[0]
    (answers, written), (expected, all_rows) = found["found"], found["stated"]
    np.testing.assert_array_equal(written, all_rows)
    assert len(answers) == len(rows) + 1
    assert np.isnan(answers[:52]).all()
    np.testing.assert_array_equal(answers[52:], expected[52:])


def test_a_stream_in_disorder_is_counted_and_goes_on(place, monkeypatch, capfd):
    """Rows repeated, late, not a number, no rows at all, and a gap."""
    header, *rows = (place / "log.csv").read_text().splitlines()
    cells = rows[60].split(",")
    missing, invert_sensor = ",".join([cells[0], "nan", *cells[2:]]), rows[120].rpartition(",")[0] + ","
    bad = ["stray words", rows[80][:20], "", "# a remark"]
    kept = [*rows[:50], rows[49], rows[40], *rows[50:60], missing, *rows[61:81], *bad, *rows[81:120], invert_sensor]
    lines = [header, *kept, *rows[121:140], *rows[170:]]
    on_input(monkeypatch, "\n".join(lines).encode())
    assert run(*FOLLOW, "--out", "out") == 0
    out, err = capfd.readouterr()
    stream, _, summary = read(place / "out")
    expected = {"repeated": 1, "late": 1, "missing": 1, "unread": 1, "gaps": 1, "set_back": 0, "bad": 2}
    assert {name: summary["counts"][name] for name in expected} == expected
    assert len(stream_of(out)) == len(lines) - 3  # the header, a blank line and a remark
    assert "2 unreadable lines" in err
    assert np.all(np.diff(stream[:, 0]) > 0.0)


def test_units_gains_and_names_count_as_in_files(place, monkeypatch, capfd):
    log = bayesid.read_log("log.csv")
    names = ["Zeit", *(f"q{j} [deg]" for j in (1, 2, 3)), *(f"Strom{j}" for j in (1, 2, 3))]
    values = np.column_stack([1e3 * log.t, np.rad2deg(log.q), log.effort / GAINS])
    units = ";".join(["ms", *[""] * 3, *["A"] * 3])
    rows = [";".join(repr(x).replace(".", ",") for x in row) for row in values.tolist()]
    on_input(monkeypatch, "\n".join([";".join(names), units, *rows]).encode())
    options = "--gains", ",".join(map(str, GAINS)), "--columns", 't=Zeit [ms],i="Strom{} [A]"'
    assert run(*FOLLOW, *options, "--quiet") == 0
    strange = stream_of(capfd.readouterr().out)
    on_input(monkeypatch, (place / "log.csv").read_bytes())
    assert run(*FOLLOW, "--quiet") == 0
    np.testing.assert_allclose(strange, stream_of(capfd.readouterr().out), rtol=1e-4, atol=1e-4)


def test_a_stream_is_decoded_as_the_log_of_the_result_was(place, monkeypatch, capfd):
    log = bayesid.read_log("signed.csv")
    step = np.abs(log.effort).max() / 900.0
    counts = np.rint(log.effort / step)
    names = ["t", *(f"q{j}" for j in (1, 2, 3)), *(f"i{j}" for j in (1, 2, 3))]
    coded = np.column_stack([log.t, log.q, np.where(counts < 0, counts + 65536, counts)])
    np.savetxt("coded.csv", coded, delimiter=",", header=",".join(names), comments="")
    (place / "of_counts").mkdir()
    stored = replace(bayesid.load("result"), encoding="twos:16")
    (place / "of_counts" / "model.toml").write_text(tomli_w.dumps(model_table(stored)))
    assert bayesid.load("of_counts").encoding == "twos:16"
    on_input(monkeypatch, (place / "coded.csv").read_bytes())
    gains = "--gains", ",".join([repr(float(step))] * 3)
    assert run("track", "of_counts", *FOLLOW[2:], *gains) == 0
    out, err = capfd.readouterr()
    assert "two's complement of 16 bits" in err
    assert set(np.unique(stream_of(out)[-150:, 4:7])) == {0.0, 1.0}
    assert bayesid.read_log("coded.csv", [step] * 3).encoding == "twos:16"


def test_a_few_rows_at_another_rate_are_answered_with_a_warning(place, monkeypatch, capfd):
    rows = "".join(f"{0.2 * k},0,0,0,0,0,0,1,1,1\n" for k in range(20))
    on_input(monkeypatch, (HEADER.replace("tau1", "dq1,dq2,dq3,tau1") + rows).encode())
    assert run(*FOLLOW, "--quiet") == 0
    out, err = capfd.readouterr()
    assert len(stream_of(out)) == 20
    assert "give --rate 5" in err


@pytest.fixture
def live(place):
    """A `bayesid track --follow` of its own, with its ends."""
    command = [sys.executable, "-u", "-m", "bayesid.cli", *map(str, FOLLOW), "--out", "out"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    running = subprocess.Popen(
        command, **pipes, cwd=place, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    )
    yield running
    running.kill()
    for end in (running.stdin, running.stdout, running.stderr):
        end.close()
    running.wait()


def say(running, text):
    running.stdin.write(text)
    running.stdin.flush()


def test_each_row_is_answered_before_the_next_comes(place, live):
    header, *rows = (place / "log.csv").read_bytes().splitlines(keepends=True)
    say(live, b"\n" + header)
    assert live.stdout.readline().decode().strip().split(",") == NAMES  # before any row: nobody waits for the other
    say(live, rows[0][:7])
    time.sleep(0.05)
    say(live, rows[0][7:])
    assert live.stdout.readline().count(b",") == len(NAMES) - 1
    for row in rows[1:40]:
        say(live, row)
        answer = live.stdout.readline()
    assert float(answer.split(b",")[0]) == float(rows[39].split(b",")[0])
    say(live, rows[40].rstrip())  # the last line may lack its end
    live.stdin.close()
    assert live.wait(timeout=20) == 0
    assert len(live.stdout.read().splitlines()) == 1
    assert read(place / "out")[2]["counts"]["updates"] == 41


def test_a_stream_that_is_interrupted_leaves_nothing(place, live):
    before = sorted(os.listdir(place))
    header, *rows = (place / "log.csv").read_bytes().splitlines(keepends=True)
    say(live, header + b"".join(rows[:30]))
    for _ in range(31):
        live.stdout.readline()
    live.send_signal(signal.SIGINT)
    assert live.wait(timeout=20) == 130
    assert live.stderr.read().endswith(b"; nothing was written\n")
    assert sorted(os.listdir(place)) == before


HEADER = "t,q1,q2,q3,tau1,tau2,tau3\n"
MS = "".join(f"{20 * k},0,0,0,1,1,1\n" for k in range(60))
BAD = [
    (("--lag", 2), ["--lag", "2 s"]),
    (("--rate", 0), ["a rate of 0 Hz"]),
    (("--rate", 500), ["--rate", "50 Hz", "500 Hz", "leave it out"]),
    (("--false-alarms", 0), ["--false-alarms"]),
    (("--gains", "1,2,3"), ["drop --gains"]),
    (("--plot", "bmp"), ["--plot", "'bmp'"]),
    (("--follow", "--rate", 50), ["log.csv", "give -"]),
]
BAD_STREAMS = [
    (("--plot", "png"), HEADER, ["--plot", "whole recording"]),
    (("--lag", 7), HEADER, ["--lag", "7 s"]),
    ((), "", ["does not begin with a header"]),
    ((), "t,q1,q2,tau1,tau2\n0,0,0,1,1\n", ["2 joints", "has 3"]),
    ((), "t,q1,q2,q3\n0,0,0,1\n", ["tau1", "is missing"]),
    ((), "0,0,0,0,1,1,1\n0.1,0,0,0,1,1,1\n", ["holds numbers"]),
    ((), HEADER.replace("tau", "i") + "0,0,0,0,1,1,1\n", ["no gains"]),
    ((), HEADER + "0,90,80,70,1,1,1\n", ["may be degrees"]),
    ((), HEADER + MS, ["t[ms]", "50 Hz"]),
    ((), (HEADER + MS).encode("utf-16"), ["UTF-16", "UTF-8"]),
    (("--topic", "x"), HEADER, ["has no topic"]),
]


def test_bad_input_is_one_line_and_nothing_is_written(place, monkeypatch, capfd):
    before = sorted(os.listdir(place))
    cases = [(("track", "result", "log.csv", *options), "", says) for options, says in BAD]
    cases += [((*FOLLOW, *options), content, says) for options, content, says in BAD_STREAMS]
    cases.append((FOLLOW[:4], HEADER, ["increasing times", "give --rate HZ"]))
    cases.append((FOLLOW[:4], HEADER + MS, ["time steps are 20 s", "t[ms]"]))
    for arguments, content, says in cases:
        on_input(monkeypatch, content if isinstance(content, bytes) else content.encode())
        assert run(*arguments, "--out", "out") == 2
        err = capfd.readouterr().err
        assert err.count("\n") == 1
        assert all(word in err for word in says), err
        assert sorted(os.listdir(place)) == before
