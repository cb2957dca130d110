"""`bayesid payload`: the table, payload.json, and what is refused."""

import json

import numpy as np
import pytest
from command_line import run, unfolded
from payload_cases import MASS, PAYLOAD, PayloadCase

import bayesid

GAINS = [10.0, 20.0, 5.0]
QUICK = "--posterior-budget", 0


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result, logs with a payload, without one, and of currents."""
    place, arm = tmp_path_factory.mktemp("made"), PayloadCase(0)
    bayesid.save(arm.result, place / "result", report=False)
    loaded = arm.later(PAYLOAD)
    loaded.save(place / "loaded.csv")
    arm.later().save(place / "empty.csv")
    arm.first.save(place / "first.csv")
    bayesid.Log(loaded.t, loaded.q, loaded.effort / GAINS, loaded.signed).save(place / "currents.csv")
    path = place / "currents.csv"
    path.write_text(path.read_text().replace("tau", "i", 3))
    return place


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    """A folder of an earlier result of the command."""
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "payload.json").write_text("an earlier one")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(place, folder="out"):
    assert [path.name for path in (place / folder).iterdir()] == ["payload.json"]
    return json.loads((place / folder / "payload.json").read_text())


def test_a_payload_is_shown_and_written(place, capfd):
    assert run("payload", "result", "loaded.csv", "--out", "out", "--force") == 0
    out, err = capfd.readouterr()
    assert err == ""
    for said in ("Payload: 2.0", "link 3", "Other changes", "converged", "centre of mass x", "inertia yz"):
        assert said in out
    assert out.endswith("written to out/\n")
    read = written(place)
    assert abs(read["mass"]["value"] - MASS) < 3.0 * read["mass"]["sd"]
    assert (len(read["com"]), len(read["inertia"])) == (3, 6)
    for one in (read["mass"], *read["com"], *read["inertia"]):
        assert set(one) == {"value", "sd", "interval"}
        assert one["interval"][0] <= one["value"] <= one["interval"][1]
        assert one["sd"] > 0.0
    assert read["frame"] == "link 3"
    assert (read["check"]["passed"], read["check"]["joints"]) == (True, [])
    assert read["gain_factor"] is read["gains"] is read["known_mass"] is None
    assert read["log"] == "loaded.csv"
    assert out.index("Torque scale: ") < out.index("Payload: "), "why it is not known better comes first"
    assert read["common_factor"] == {"sd": 0.1, "from": "assumed"}
    assert [one.partition(":")[0] for one in read["warnings"]] == ["Torque scale", "Payload"], (
        "what is no warning on the terminal"
    )
    assert run("payload", "result", "loaded.csv", "--common-sd", "1%", "--out", "out", "--force", *QUICK) == 0
    assert 0.01 < written(place)["mass"]["sd"] / MASS < 0.03 < read["mass"]["sd"] / MASS


def test_a_known_mass_corrects_the_gains(place, capfd):
    gains = ",".join(map(str, GAINS))
    assert (
        run("payload", "result", "currents.csv", "--gains", gains, "--known-mass", "2~0.01", "--out", "out", "--force")
        == 0
    )
    out, read = capfd.readouterr().out, written(place)
    factor = read["gain_factor"]
    assert read["known_mass"] == {"value": 2.0, "sd": 0.01}
    assert abs(factor["value"] * read["mass"]["value"] - 2.0) < 0.01
    assert factor["interval"][0] < factor["value"] < factor["interval"][1]
    np.testing.assert_allclose(read["gains"]["read_with"], GAINS)
    np.testing.assert_allclose(read["gains"]["corrected"], factor["value"] * np.array(GAINS))
    for said in ("multiply them by", "not significantly different from 1", "--gains "):
        assert said in out


def test_without_a_payload_null_stands_in_place_of_numbers(place, capfd):
    assert run("payload", "result", "empty.csv", "--known-mass", 2, "--out", "out", "--force", *QUICK) == 0
    out = capfd.readouterr().out
    assert "not significantly above zero" in out
    assert "centre of mass x" not in out
    assert "does not calibrate" in unfolded(out)
    read = written(place)
    assert read["com"] is read["inertia"] is read["gain_factor"] is None
    assert read["mass"]["interval"][0] == 0.0
    assert read["shown"] is False
