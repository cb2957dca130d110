"""Folders that are whole or not there, and what stands whatever becomes of its exports and pages."""

import json
import signal
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from saved_results import PROMISED, contents, identified, save, validated

import bayesid
from bayesid.cli import main
from bayesid.errors import InputError
from bayesid.report import result_files
from bayesid.report.folders import (
    IncompleteWarning,
    check_result_folder,
    make_report,
    save_identification,
    save_validation,
)
from bayesid.report.report_data import read_report_data

PAGE = "bayesid.report.pages.identification_page.identification_page"
ARM = """convention = "standard"
name = "arm"
joints = [
  {a = 0.0, alpha = 1.5707963267948966, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.0, theta = 0.0},
]
"""
OPTIONS = "--terms rigid_body,viscous_friction --complete off --no-posterior --quiet"


@pytest.fixture(scope="module")
def result():
    return identified()


@pytest.fixture(scope="module")
def other(result):
    return replace(result, warnings=("another result",))


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """A robot and a log: `bayesid identify` with it takes a second."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(ARM)
    assert main(f"simulate --robot {place}/arm.toml --duration 6 --out {place}/log.csv --quiet".split()) == 0
    return place


def run(shop, folder, more=""):
    return main(f"identify {shop}/log.csv --robot {shop}/arm.toml {OPTIONS} {more} --out {folder}".split())


def test_an_earlier_result_is_replaced_through_a_link_too(result, other, tmp_path):
    place, link = save(result, tmp_path / "r"), tmp_path / "link"
    link.symlink_to(place)
    (place / "posterior.nc").write_text("of the earlier result")
    assert save(other, link) == link
    assert link.is_symlink()
    assert set(contents(place)) == PROMISED
    assert b"another result" in contents(place)["summary.json"]
    assert sorted(tmp_path.iterdir()) == [link, place]


def test_the_report_of_a_discrepancys_folder_has_its_verdict_too(result, tmp_path, capsys):
    place = save(result, tmp_path / "found")
    for status, state in (("partly_explained", "look"), ("unexplained", "bad"), ("explained", "good")):
        (place / "discrepancy.json").write_text(json.dumps({"status": status}))
        assert main(["report", str(place)]) == 0
        (check,) = (one for one in bayesid.load(place).checks() if one.name == "Discrepancy")
        assert check.state == state
        assert ("Discrepancy" in capsys.readouterr().out) == (state != "good")
        assert check.message in (place / "report.html").read_text()


def test_other_files_are_never_deleted(result, tmp_path, monkeypatch):
    for k, names in enumerate((["notes.txt"], ["model.toml"], ["summary.json", "thesis.tex"])):
        place = tmp_path / str(k)
        place.mkdir()
        for name in names:
            (place / name).write_text("mine")
        with pytest.raises(InputError, match=rf"holds other files \({names[-1]}\)"):
            save(result, place)
        assert contents(place) == dict.fromkeys(names, b"mine")
    with pytest.raises(InputError, match="not a folder"):
        check_result_folder(tmp_path / "0" / "notes.txt" / "r")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(InputError, match="is the working folder"):
        save(result, ".")


def test_a_validation_and_the_model_it_is_of_do_not_replace_each_other(result, tmp_path):
    places = save(result, tmp_path / "r"), save_validation(validated(), tmp_path / "v")
    before = [contents(place) for place in places]
    for what, write, place in ((validated(), save_validation, places[0]), (result, save, places[1])):
        with pytest.raises(InputError, match="holds other files"):
            write(what, place)
    assert [contents(place) for place in places] == before


def test_a_log_that_was_seen_takes_no_validations_place(result, tmp_path):
    """It may stand there, marked, until there is a validation."""
    place, again = save(result, tmp_path / "r"), result.validate(result.log)
    make_report(place, again)
    assert read_report_data(place).prediction.seen
    make_report(place, validated())
    before = contents(place)
    with pytest.raises(InputError, match="was identified from"):
        make_report(place, again)
    assert contents(place) == before
    assert not read_report_data(place).prediction.seen


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=repr)
def test_whatever_goes_wrong_everything_is_as_it_was(result, other, tmp_path, monkeypatch, fault):
    before = contents(save(result, tmp_path / "r"))

    def fail(*_):
        raise fault

    monkeypatch.setattr(result_files, "write_findings", fail)
    for place in (tmp_path / "r", tmp_path / "new"):
        with pytest.raises(InputError if isinstance(fault, OSError) else type(fault)):
            save(other, place)
    assert [path.name for path in tmp_path.iterdir()] == ["r"]
    assert contents(tmp_path / "r") == before


def test_a_rename_that_fails_puts_the_earlier_result_back(result, other, tmp_path, monkeypatch):
    place = save(result, tmp_path / "r")
    before, rename = contents(place), Path.rename

    def fail_once(path, target):
        if target == place and path.name == "new":
            raise OSError(13, "Permission denied")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fail_once)
    with pytest.raises(InputError, match="Permission denied"):
        save(other, place)
    assert list(tmp_path.iterdir()) == [place]
    assert contents(place) == before


def no_page(*_):
    raise RuntimeError("no fonts\nhere")


def not_written(folder):
    return json.loads((folder / "summary.json").read_text())["not_written"]


def test_exports_that_fail_are_named_and_the_rest_stands(result, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(result_files, "urdf", no_page)
        patch.setattr(PAGE, no_page)
        with pytest.warns(IncompleteWarning) as said:
            save_identification(result, tmp_path / "r")
    why = "RuntimeError: no fonts\\nhere"
    assert set(contents(tmp_path / "r")) == PROMISED - {"robot.urdf"}
    assert not_written(tmp_path / "r") == dict.fromkeys(("robot.urdf", "report.html"), why)
    (warning,) = said
    assert all(one in str(warning.message) for one in ("report.html", "robot.urdf", why))
    assert bayesid.load(tmp_path / "r").model.robot.name == "arm3"
    make_report(tmp_path / "r", out=tmp_path / "elsewhere.html")
    assert set(not_written(tmp_path / "r")) == {"robot.urdf", "report.html"}
    assert make_report(tmp_path / "r").is_file()
    assert set(not_written(tmp_path / "r")) == {"robot.urdf"}, "what stands now is no longer named"
    assert {path.name for path in tmp_path.iterdir()} == {"r", "elsewhere.html"}


def test_a_command_whose_page_fails_ends_with_code_1(shop, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(PAGE, no_page)
    assert run(shop, tmp_path / "r") == 1
    (last,) = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("warning: ")]
    assert all(one in last for one in (f"bayesid: {tmp_path}/r: ", "report.html", "no fonts"))
    assert (tmp_path / "r" / "model.toml").is_file()


def test_a_disk_that_is_full_by_then_does_not_lose_the_result(shop, tmp_path, monkeypatch, capfd):
    """It is kept among the temporary files, and the line says where."""
    write, aside = result_files.write_table, tmp_path / "temporary"
    aside.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(aside))

    def full(path, rows):
        if aside not in path.parents:
            raise OSError(28, "No space left on device")
        write(path, rows)

    monkeypatch.setattr(result_files, "write_table", full)
    assert run(shop, tmp_path / "r", "--no-report") == 2
    (line,) = [one for one in capfd.readouterr().err.splitlines() if not one.startswith("warning: ")]
    assert "No space left on device" in line
    (kept,) = aside.glob("*/r")
    assert str(kept) in line
    assert bayesid.load(kept).model.robot.name == "arm"
    assert [path.name for path in tmp_path.iterdir()] == ["temporary"]


@pytest.mark.parametrize(("number", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_stopped_while_the_report_is_drawn(shop, tmp_path, monkeypatch, capfd, number, code):
    """The result stands, and that is what is told."""
    monkeypatch.setattr(PAGE, lambda *_: signal.raise_signal(getattr(signal, number)))
    assert run(shop, tmp_path / "r") == code
    (line,) = capfd.readouterr().err.splitlines()
    assert all(one in line for one in ("bayesid: ", f"{tmp_path}/r/", "report.html"))
    assert {path.name for path in (tmp_path / "r").iterdir()} >= {"summary.json", "model.toml", "signed_log.csv"}
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
