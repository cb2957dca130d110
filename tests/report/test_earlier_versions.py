"""Result folders that earlier versions wrote: they load, or say how to write them anew.

Each folder under `earlier` is named after the day on which the version that wrote it was current. Tables and pages,
which are never read back, are left out of them, and most draws of the posterior.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.errors import InputError
from bayesid.motion import Motion

pytestmark = pytest.mark.usefixtures("any_motion")

FOLDERS = sorted((Path(__file__).parent / "earlier").iterdir())
OTHER = """convention = "standard"
name = "another"
joints = [
  {a = 0.0, alpha = 1.2, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.1, theta = 0.3},
]
"""


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_models_of_earlier_versions_load(folder):
    """At rest joint 2 bears what weighs about it; with its axis horizontal, gravity is along y of its frame."""
    identified = bayesid.load(folder)
    assert identified.model.robot.name == "arm"
    names = [parameter.name for parameter in identified.model.parameters]
    x, y = (identified.theta[names.index(name)] for name in ("mc2x", "mc2y"))
    mass = identified.theta[names.index("m2")]
    q = np.array([[0.3, 0.7]])
    rest = Motion(np.zeros(1), q, 0.0 * q, 0.0 * q)
    lever = (x + 0.35 * mass) * np.cos(0.7) - y * np.sin(0.7)
    np.testing.assert_allclose(identified.model.effort(rest, identified.theta)[0, 1], 9.81 * lever, rtol=1e-9)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_report_data_of_unreleased_versions_say_how_to_write_them_anew(folder):
    with pytest.raises(InputError, match="identify again"):
        bayesid.load(folder).report_data()


def test_draws_of_earlier_versions_load():
    assert np.isfinite(bayesid.load(FOLDERS[1]).draws.theta).all()


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_an_earlier_result_makes_room_for_a_new_one(folder, tmp_path, monkeypatch):
    shutil.copytree(folder, tmp_path / "result")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.toml").write_text(OTHER)
    assert main(["simulate", "--robot", "other.toml", "--duration", "4", "--out", "log.csv", "--quiet"]) == 0
    run = "identify log.csv --robot other.toml --no-posterior --no-report --complete off --search beam --out result"
    assert main([*run.split(), "--quiet"]) == 2, "nothing is replaced unless that is asked for"
    assert main([*run.split(), "--quiet", "--force"]) == 0
    assert bayesid.load("result").model.robot.name == "another"
    assert not (tmp_path / "result" / "posterior.nc").exists()
