"""How a result's log was read is kept with it: other logs and motions of the recorder are read so."""

import warnings

import numpy as np
import pytest
from command_line import run
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.errors import InputError

TERMS = ["rigid_body", "viscous_friction"]
ROBOT = small_robot(2)
OTHER_WAY = "q2=-q2,tau2=-tau2"


def simulated(seed):
    """t, q and signed efforts of a run of one and the same robot."""
    motion = smooth_motion(2, 6.0, 100.0, seed=seed)
    model = bayesid.Model.of(ROBOT, TERMS, motion)
    theta = bayesid.random_parameters(model, rng=np.random.default_rng(2))
    log = bayesid.simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=0.03, signed=True)
    return log.t, log.q, log.effort


def write(path, t, q, readings, names="t,q1,q2,tau1,tau2"):
    np.savetxt(path, np.column_stack([t, q, readings]), delimiter=",", header=names, comments="", fmt="%.17g")
    return str(path)


def identified(place, path, **options):
    """A stored result of a log as it is read by these options."""
    log = bayesid.read_log(path, **options)
    result = bayesid.identify(ROBOT, log, TERMS, complete="off", posterior=False)
    bayesid.save(result, place / "result", report=False)
    return bayesid.load(place / "result")


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """A result of a log whose joint 2 counts the other way, a second log, and its true efforts by the robot's count."""
    place = tmp_path_factory.mktemp("turned")
    for name, seed in (("log", 1), ("other", 3)):
        t, q, effort = simulated(seed)
        write(place / f"{name}.csv", t, q * [1, -1], effort * [1, -1])
    return place, identified(place, str(place / "log.csv"), correct=OTHER_WAY), (t, q, effort)


def test_a_corrected_result_reads_other_logs_and_motions_corrected(turned):
    place, stored, (t, q, effort) = turned
    other = str(place / "other.csv")
    assert stored.validate(other).relative_residual.max() < 0.1
    predicted = stored.predict(other)
    np.testing.assert_allclose(predicted.mean, stored.predict((t, q)).mean, rtol=1e-9)
    assert np.corrcoef(predicted.mean[:, 1], effort[:, 1])[0, 1] > 0.99
    assert stored.validate(bayesid.read_log(other)).relative_residual.max() > 0.15, "a log is as it was read"
    assert bayesid.find_discrepancy(stored, other, posterior=False).identification.read_with["correct"] == OTHER_WAY


def test_a_result_from_before_bayesid_toml_keeps_its_reading(turned, tmp_path):
    place, stored, _ = turned
    text = (place / "result" / "model.toml").read_text()
    (tmp_path / "model.toml").write_text(f'{text}\n[reading]\ncorrect = "{OTHER_WAY}"\n')
    assert bayesid.load(tmp_path).reading == stored.reading == {"correct": OTHER_WAY}
    (tmp_path / "bayesid.toml").write_text("")
    assert bayesid.load(tmp_path).reading == {}, "which counts alone"


def test_the_signed_log_of_a_corrected_result_counts_as_the_log(turned):
    place, stored, _ = turned
    log, signed = (
        np.genfromtxt(place / name, delimiter=",", names=True) for name in ("log.csv", "result/signed_log.csv")
    )
    for name in ("q1", "q2", "tau1", "tau2"):
        np.testing.assert_allclose(signed[name], log[name], atol=1e-6)
    assert ((signed["tau2"] >= 0.0) == (signed["p2"] > 0.5)).all()
    assert stored.validate(str(place / "result" / "signed_log.csv")).relative_residual.max() < 0.1


def test_commands_read_by_what_is_kept_unless_an_option_is_given(turned, tmp_path, monkeypatch, capfd):
    place, stored, _ = turned
    monkeypatch.chdir(place)
    torques = {}
    for name, options in (("kept", ()), ("given", ("--correct", OTHER_WAY)), ("other", ("--correct", "q1=q1"))):
        command = "predict", "result", "other.csv", "--out", tmp_path / f"{name}.csv", *options
        assert run(*command) == 0
        err = capfd.readouterr().err
        said = {"kept": "read like the result's log", "given": "", "other": "--correct differs"}[name]
        assert said in err if said else err == ""
        assert ("warning" in err) == (name == "other"), "that the options are kept is no warning"
        torques[name] = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(torques["kept"], torques["given"])
    assert np.abs(torques["kept"] - torques["other"]).max() > 0.05
    figures = []
    for options in ((), ("--correct", OTHER_WAY), ("--correct", "q1=q1")):
        assert run("validate", "result", "other.csv", *options) == 0
        figures.append([line for line in capfd.readouterr().out.splitlines() if line.strip()[:2] in ("1 ", "2 ")])
    assert figures[0] == figures[1] != figures[2]


def test_remedies_name_the_options_that_the_result_does_not_keep(turned, monkeypatch):
    place, stored, _ = turned
    monkeypatch.chdir(place)
    for options, told in (({}, ""), ({"correct": "q2=-q2", "unsigned": "1"}, " --correct q2=-q2 --unsigned 1")):
        options = {"correct": OTHER_WAY, **options}
        tried = stored.validate(bayesid.read_log("other.csv", **options))
        remedies = " ".join(check.remedy for check in bayesid.load("result").checks(tried))
        assert (
            ("other.csv`" in remedies or "other.csv" not in remedies) if not told else f"other.csv{told}`" in remedies
        )


def test_exact_gains_and_which_joints_are_unsigned_are_kept(tmp_path):
    gains = [12.0, 0.3]
    for name, seed in (("log", 1), ("other", 3)):
        t, q, effort = simulated(seed)
        write(tmp_path / f"{name}.csv", t, q, effort / gains, "t,q1,q2,i1,i2")
    stored = identified(tmp_path, str(tmp_path / "log.csv"), gains=gains, unsigned="2")
    tried = stored.validate(str(tmp_path / "other.csv"))
    assert tried.relative_residual.max() < 0.1
    assert tried.log.signed.tolist() == [True, False]
    torques = write(tmp_path / "torques.csv", t, q, effort)
    with pytest.warns(UserWarning, match="gains of currents are ignored"):
        assert stored.validate(torques).relative_residual.max() < 0.1


def test_uncertain_gains_of_exchanged_joints_are_those_of_the_recorded_ones(tmp_path):
    t, q, effort = simulated(1)
    path = write(tmp_path / "log.csv", t, q, effort[:, ::-1] / [0.3, 12.0], "t,q1,q2,i1,i2")
    stored = identified(tmp_path, path, gains="0.3~10%,12~10%", correct="tau1=tau2,tau2=tau1")
    assert stored.gains.stated.value.tolist() == [12.0, 0.3]
    again = stored.validate(path).log
    assert np.abs(again.effort / effort - 1.0).max() < 0.5


def test_columns_that_another_file_does_not_have_are_left_out_and_said(tmp_path):
    t, q, effort = simulated(1)
    path = write(tmp_path / "log.csv", t, q, effort, "Zeit,A1,A2,M1,M2")
    stored = identified(tmp_path, path, columns={"t": "Zeit", "q": "A{}", "tau": "M{}"}, correct="q1=q1")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert stored.validate(path).relative_residual.max() < 0.1
    plain = write(tmp_path / "plain.csv", t, q, effort)
    with pytest.warns(UserWarning, match="read without the result's columns"):
        assert stored.validate(plain).relative_residual.max() < 0.1
    with pytest.raises(InputError, match="column t is missing among a"):
        stored.validate(write(tmp_path / "foreign.csv", t, q, effort, "a,b,c,d,e"))
    with pytest.raises(InputError, match="may be degrees"):
        stored.validate(write(tmp_path / "degrees.csv", t, 50.0 * np.degrees(q), effort))


def test_kept_degrees_do_not_make_degrees_of_what_may_be_rad(tmp_path):
    t, q, effort = simulated(1)
    stored = identified(tmp_path, write(tmp_path / "log.csv", t, np.degrees(q), effort), degrees=True)
    assert stored.validate(str(tmp_path / "log.csv")).relative_residual.max() < 0.1
    assert stored.validate(str(tmp_path / "result" / "signed_log.csv")).relative_residual.max() < 0.1, "says its unit"
    with pytest.raises(InputError) as refused:
        stored.validate(write(tmp_path / "rad.csv", t, q, effort))
    assert "degrees=False" in refused.value.remedy
    assert stored.validate(bayesid.read_log(str(tmp_path / "rad.csv"))).relative_residual.max() < 0.1
