"""What was computed stands, whatever becomes of its exports and pages."""

import json
import signal
import tempfile
import warnings

import pytest

import bayesid
from bayesid.cli import main
from bayesid.results import folders
from bayesid.results.folders import IncompleteWarning, make_report, save_identification

ARM = """convention = "standard"
name = "arm"
joints = [
  {a = 0.0, alpha = 1.5707963267948966, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.0, theta = 0.0},
]
"""
QUICK = {"terms": ["rigid_body", "viscous_friction"], "complete": "off", "posterior": False}
OPTIONS = "--terms rigid_body,viscous_friction --complete off --no-posterior --quiet"


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(ARM)
    assert main(f"simulate --robot {place}/arm.toml --duration 6 --out {place}/log.csv --quiet".split()) == 0
    return place


@pytest.fixture(scope="module")
def result(shop):
    return bayesid.identify(shop / "arm.toml", shop / "log.csv", **QUICK)


def no_page(*_):
    raise RuntimeError("no fonts\nhere")


def names(folder):
    return {path.name for path in folder.iterdir()}


def not_written(folder):
    return json.loads((folder / "summary.json").read_text())["not_written"]


def test_a_whole_result_lacks_nothing(result, tmp_path):
    save_identification(result, tmp_path / "r", report=False)
    assert not_written(tmp_path / "r") == {}


def test_exports_that_fail_are_named_and_the_rest_stands(result, tmp_path, monkeypatch):
    save_identification(result, tmp_path / "whole")
    monkeypatch.setattr(folders, "urdf", no_page)
    monkeypatch.setattr(folders, "_write_report", no_page)
    with pytest.warns(IncompleteWarning) as said:
        save_identification(result, tmp_path / "r")
    assert names(tmp_path / "whole") - names(tmp_path / "r") == {"robot.urdf", "report.html"}
    assert not_written(tmp_path / "r") == dict.fromkeys(("robot.urdf", "report.html"), "RuntimeError: no fonts\\nhere")
    (warning,) = said
    assert "report.html could not be written (RuntimeError: no fonts\\nhere)" in str(warning.message)
    assert bayesid.load_model(tmp_path / "r").model.robot.name == "arm"
    monkeypatch.undo()
    make_report(tmp_path / "r", out=tmp_path / "elsewhere.html")
    assert set(not_written(tmp_path / "r")) == {"robot.urdf", "report.html"}
    assert make_report(tmp_path / "r").is_file()
    assert set(not_written(tmp_path / "r")) == {"robot.urdf"}, "what stands now is no longer named"
    assert names(tmp_path) == {"whole", "r", "elsewhere.html"}


def test_the_command_ends_as_one_that_failed(shop, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(folders, "_write_report", no_page)
    assert main(f"identify {shop}/log.csv --robot {shop}/arm.toml {OPTIONS} --out {tmp_path}/r".split()) == 1
    lines = capfd.readouterr().err.splitlines()
    (last,) = [line for line in lines if not line.startswith("warning: ")]
    assert last.startswith(f"bayesid: {tmp_path}/r: report.html could not be written (RuntimeError: no fonts")
    assert (tmp_path / "r" / "model.toml").is_file()


def test_the_demo_ends_as_one_that_failed_too(tmp_path, monkeypatch, capfd):
    def run_demo(*_):
        warnings.warn("demo: report.html could not be written", IncompleteWarning, stacklevel=2)
        return ["all of it"]

    monkeypatch.setattr("bayesid.cli.commands.demo.run_demo", run_demo)
    assert main(["demo", "--out", str(tmp_path / "r")]) == 1
    said = capfd.readouterr()
    assert said.out.strip() == "all of it"
    assert said.err.strip() == "bayesid: demo: report.html could not be written"


def test_a_disk_that_is_full_by_then_does_not_lose_the_result(shop, tmp_path, monkeypatch, capfd):
    """It is kept among the temporary files, and the line says where."""
    write, aside = folders.write_table, tmp_path / "temporary"
    aside.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(aside))

    def full(path, rows):
        if aside not in path.parents:
            raise OSError(28, "No space left on device")
        write(path, rows)

    monkeypatch.setattr(folders, "write_table", full)
    run = f"identify {shop}/log.csv --robot {shop}/arm.toml {OPTIONS} --no-report --out {tmp_path}/r"
    assert main(run.split()) == 2
    (line,) = [one for one in capfd.readouterr().err.splitlines() if not one.startswith("warning: ")]
    assert "No space left on device" in line
    kept = line.rpartition("meanwhile the result stands in ")[2]
    assert bayesid.load_model(kept).model.robot.name == "arm"
    assert names(tmp_path) == {"temporary"}


@pytest.mark.parametrize(
    ("number", "said", "code"),
    [("SIGINT", "interrupted", 130), ("SIGTERM", "terminated", 143), ("SIGHUP", "terminated", 129)],
)
def test_stopped_while_the_report_is_drawn(shop, tmp_path, monkeypatch, capfd, number, said, code):
    """The result stands, and that is what is told."""
    monkeypatch.setattr(folders, "_write_report", lambda *_: signal.raise_signal(getattr(signal, number)))
    assert main(f"identify {shop}/log.csv --robot {shop}/arm.toml {OPTIONS} --out {tmp_path}/r".split()) == code
    (line,) = capfd.readouterr().err.splitlines()
    assert line == f"bayesid: {said}; the result stands in {tmp_path}/r/, without report.html"
    assert names(tmp_path / "r") >= {"summary.json", "model.toml", "signed_log.csv"}
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_a_table_that_fails_keeps_the_earlier_result(result, tmp_path, monkeypatch):
    save_identification(result, tmp_path / "r", report=False)
    before = (tmp_path / "r" / "summary.json").read_bytes()
    monkeypatch.setattr(folders, "write_table", no_page)
    with pytest.raises(RuntimeError):
        save_identification(result, tmp_path / "r", report=False)
    assert (tmp_path / "r" / "summary.json").read_bytes() == before
    assert names(tmp_path) == {"r"}
