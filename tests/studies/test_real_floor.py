"""The floors of real logs: figures below a floor, and the exit code of the command."""

from dataclasses import replace

import pytest

from bayesid.cli import main
from bayesid.errors import InputError
from bayesid.studies import load, real, real_floor
from bayesid.studies.real_floor import FLOORS, Floor, below


@pytest.fixture
def floors(monkeypatch):
    """Two logs with floors."""
    floors = {"arm/a": Floor(0.998, 0.98, 2, True, 30.0), "arm/b": Floor(0.9, 0.5, 100, False, 60.0)}
    monkeypatch.setattr(real_floor, "FLOORS", floors)
    return floors


def row(log="arm/a", right=0.999, joints=(1.0, 0.99), sure_wrong=2, proven=True, cpu=20.0):
    timings = {"cpu": cpu}
    return {
        "log": log,
        "right": right,
        "joints": list(joints),
        "sure_wrong": sure_wrong,
        "proven": proven,
        "timings": timings,
    }


def test_each_figure_below_its_floor_is_listed(floors):
    other = row("arm/b", 0.95, proven=False)
    assert below([row(), other]) == []
    for worse, word in (
        ({"right": 0.9979}, "99.7900 % right"),
        ({"joints": (1.0, 0.97)}, "worst joint"),
        ({"sure_wrong": 3}, "3 samples"),
        ({"proven": False}, "not proven"),
        ({"cpu": 31.0}, "31 s"),
    ):
        (said,) = below([row(**worse), other])
        assert said.startswith("arm/a: ")
        assert word in said


def test_a_log_without_result_is_listed(floors):
    (said,) = below([row()])
    assert said.startswith("arm/b")


def test_without_logs_the_guard_names_their_variable(monkeypatch, tmp_path):
    monkeypatch.setattr(real, "DATA", tmp_path / "nowhere")
    with pytest.raises(InputError, match="BAYESID_DATA"):
        load("real", floor=True).plan(3, 0)


def test_a_study_without_floors_refuses_the_option(capsys, tmp_path):
    assert main(["study", "noise", "--floor", "--out", str(tmp_path / "new")]) == 2
    assert "--floor" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.real
def test_one_log_at_its_floor_and_below(monkeypatch, tmp_path, capsys):
    """The command ends with 0 where a floor is held, and with 1 where it is not."""
    if not real.DATA.is_dir():
        pytest.skip(f"the real logs are not at {real.DATA}; set BAYESID_DATA to their folder")
    log = "tx40/a"
    monkeypatch.setattr(real_floor, "FLOORS", {log: FLOORS[log]})
    command = ["study", "real", "--floor", "--workers", "1", "--quiet", "--out"]
    assert main([*command, str(tmp_path / "held")]) == 0
    monkeypatch.setattr(real_floor, "FLOORS", {log: replace(FLOORS[log], sure_wrong=-1)})
    assert main([*command, str(tmp_path / "broken")]) == 1
    assert "floor" in capsys.readouterr().err
