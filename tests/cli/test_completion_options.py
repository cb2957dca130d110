"""What identify is told of the catalogue's say and of the geometry's tolerance, and what is refused."""

import math

import pytest

from bayesid import cli
from bayesid.cli import demo
from bayesid.cli.options import beliefs
from bayesid.cli.parser import parse
from bayesid.fit.effects.kinematics import KinematicTolerance

IDENTIFY = ("identify", "log.csv", "--robot", "kr5")


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """A folder with a log that nobody gets to read."""
    (tmp_path / "log.csv").write_text("t,q1,tau1\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments):
    try:
        return cli.main([*IDENTIFY, *arguments])
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize(
    ("text", "length", "angle"),
    [
        ("1mm,0.1deg", 1e-3, math.radians(0.1)),
        ("2cm,1mrad", 0.02, 1e-3),
        ("0.003m, 0.2rad", 3e-3, 0.2),
        ("5e-1 mm , 3 deg", 5e-4, math.radians(3.0)),
        ("0mm,0deg", 0.0, 0.0),
    ],
)
def test_tolerances_are_read_with_their_units(text, length, angle):
    found = beliefs(parse([*IDENTIFY, "--kinematic-tolerance", text])).kinematics
    assert found.length == pytest.approx(length, rel=1e-12)
    assert found.angle == pytest.approx(angle, rel=1e-12)


def test_tolerance_and_completion_unless_said():
    options = parse([*IDENTIFY])
    said, own = beliefs(options).kinematics, KinematicTolerance()
    assert (said.length, said.angle) == pytest.approx((own.length, own.angle))
    assert options.complete == "auto"


BAD = ("", "1mm", "1,0.1", "1mm,0.1", "1mm,0.1deg,3", "0.1deg,1mm", "1deg,1deg", "1inch,1deg", "-1mm,1deg", "1mm,-1deg")
BAD += ("nanmm,1deg", "infmm,1deg", "1e400mm,1deg", "1..mm,1deg", "mm,deg", "1mm;1deg", "1MM,1deg")


@pytest.mark.parametrize("text", BAD)
def test_what_is_no_tolerance_is_refused_in_one_line(text, place, capfd):
    assert run(f"--kinematic-tolerance={text}") == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("bayesid")
    assert "--kinematic-tolerance" in err
    assert "1mm,0.1deg" in err
    assert repr(text) in err
    assert [path.name for path in place.iterdir()] == ["log.csv"]


def test_what_is_no_way_to_complete_is_refused_in_one_line(place, capfd):
    assert run("--complete", "nonsense") == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "--complete" in err
    assert "nonsense" in err
    assert all(word in err for word in ("auto", "only-uncertainty", "off"))
    assert [path.name for path in place.iterdir()] == ["log.csv"]


@pytest.mark.parametrize("how", ["auto", "only-uncertainty", "off"])
def test_completion_and_tolerance_reach_the_identification(how, place, monkeypatch):
    asked = {}

    def spy(*_, **options):
        asked.update(options)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesid.cli.commands.identify.identify", spy)
    monkeypatch.setattr("bayesid.cli.commands.identify.read", lambda *_: None)
    monkeypatch.setattr("bayesid.cli.commands.identify.join_logs", lambda logs: None)
    assert run("--complete", how, "--kinematic-tolerance", "3mm,0.5deg") == 130
    assert asked["complete"] == how
    assert asked["beliefs"].kinematics == KinematicTolerance(length=3 * 1e-3, angle=0.5 * (math.pi / 180.0))


def test_the_catalogue_finds_nothing_in_the_demo(monkeypatch):
    """Rigid bodies and nothing else: that is why it need not be asked there."""
    results, plain = [], demo.identify

    def asked(*arguments, complete, **options):
        results.append(plain(*arguments, complete="auto", **options))
        return results[-1]

    monkeypatch.setattr(demo, "identify", asked)
    assert demo.run_experiment().wrong == 0
    assert results[0].completion.effects == ()
