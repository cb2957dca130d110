import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from conftest import real_log, small_robot, smooth_motion
from made_trials import TERMS, arm_log

import bayesid
from bayesid.cli import main
from bayesid.discrepancy.case import NoiseFloor
from bayesid.discrepancy.selection import GROWN
from bayesid.discrepancy.tuning import TUNING
from bayesid.discrepancy.workflow import _unexplained
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.regression.selection.cross_validation import CrossValidation
from bayesid.report.discrepancy import discrepancy_summary
from bayesid.studies import blind


def blind_case(folder, seed, effect, size=0.0, style="bare", robot="random", trouble=blind.NO_TROUBLE, holdout=True):
    """Findings in a blind case, and the truth."""
    truth = blind.make_case(folder, seed, effect, size, robot, style, trouble=trouble)
    options = {"complete": "auto" if trouble == blind.NO_TROUBLE else "off", "posterior": False}
    options["terms"] = (folder / "terms.txt").read_text().strip().split(",")
    healthy = bayesid.identify(folder / "robot.toml", folder / "baseline.csv", **options)
    cross_validation = folder / "holdout.csv" if holdout else None
    return bayesid.find_discrepancy(healthy, folder / "log.csv", cross_validation, posterior=False), truth


LONG = [("rotor_inertia", "standard", 14), ("payload", "bare", 5), ("torque_ripple", "standard", 4)]


@pytest.mark.parametrize(
    ("effect", "style", "seed"),
    [("clipping", "bare", 11), *(pytest.param(*case, marks=pytest.mark.long) for case in LONG)],
)
def test_hidden_effect_is_named_and_added(tmp_path, effect, style, seed):
    result, truth = blind_case(tmp_path, seed, effect, 5.0, style)
    assert result.status == "explained"
    first = result.added[0]
    assert effect in (first.effect, *first.equivalent)
    assert first.joints == truth.joints[0]
    assert first.probability > 0.9
    assert np.max(result.before / truth.floor) > 1.5
    assert np.max(result.after / truth.floor) < 1.15
    strong = np.abs(truth.log_efforts) > 0.05 * np.abs(truth.log_efforts).max(axis=0)
    assert np.mean((result.identification.sample_signs == truth.log_signs)[strong]) > 0.995


def test_nothing_hidden_nothing_named(tmp_path):
    result, truth = blind_case(tmp_path, 21, None, style="standard", holdout=False)
    assert result.status == "no_discrepancy"
    assert not result.added
    assert not result.unexplained
    np.testing.assert_allclose(result.floor.rms, truth.noise, rtol=0.1)
    np.testing.assert_allclose(result.after / truth.noise, 1.0, atol=0.15)  # a quarter of 2400 samples, or less


@pytest.mark.long
def test_outside_of_the_catalogue_is_unexplained(tmp_path):
    result, truth = blind_case(tmp_path, 30, "outside", 6.0)
    assert result.status == "unexplained"
    (joint,) = truth.joints[0]
    assert [j for j, _ in result.unexplained] == [joint]
    assert [excess.joint for excess in result.where] == [joint]
    assert not result.added


WRONG_TABLE, LASTING_NOISE = blind.Trouble(length=0.005, angle=np.deg2rad(0.5)), blind.Trouble(memory=0.97)


@pytest.mark.long
@pytest.mark.parametrize(("trouble", "seed", "joints"), [(WRONG_TABLE, 6, {4, 5}), (LASTING_NOISE, 4, {1})])
def test_a_holdout_above_the_floor_or_growing_is_never_no_discrepancy(tmp_path, trouble, seed, joints):
    """No effect is hidden or visible on the log; the residual is 1.7 and 2.0, or 1.3 times the noise."""
    result, truth = blind_case(tmp_path, seed, None, style="standard", robot="kr5", trouble=trouble)
    assert result.status == "unexplained"
    assert {joint for joint, _ in result.unexplained} == joints
    assert not result.added
    for joint, ratio in result.unexplained:
        assert "log" not in result.unexplained_on[joint]
        assert ratio == pytest.approx(result.after[joint - 1] / result.floor.rms[joint - 1])
        assert result.after[joint - 1] > 1.25 * truth.floor[joint - 1]
    off = result.floor.rms > 1.3 * truth.noise  # of which the earlier model's error is the larger part
    assert not off[~result.floor.mostly_coloured].any()
    seen_on = [(one["joint"], tuple(one["seen_on"])) for one in discrepancy_summary(result)["unexplained"]]
    assert seen_on == list(result.unexplained_on.items())


def test_a_gap_that_grows_below_the_floor_is_explained():
    """Joints 1 and 2 grow alike from 0.5 to 0.7 N m; only the floor of joint 2 is lower."""
    counts = np.full((4, 2), 100.0)
    before, after = (CrossValidation(counts * level**2, counts) for level in (0.5, 0.7))
    rms, reliable = np.array([1.2, 0.6]), np.zeros(2, dtype=bool)
    floor = NoiseFloor(rms, ("", ""), np.stack([rms, rms], axis=1), reliable, rms, reliable)
    ratios, shown_on = _unexplained({}, before, after, floor)
    assert shown_on == {2: (GROWN,)}
    assert ratios == ((2, pytest.approx(0.7 / 0.6)),)


def spring(motion):
    return np.array([0.0, 7.0, 0.0]) * motion.q


@pytest.fixture(scope="module")
def healthy():
    return bayesid.identify(small_robot(3, seed=2), arm_log(1), terms=TERMS, posterior=False)


def test_a_different_size_of_the_models_effect_is_a_change(healthy):
    def worn(motion):
        return np.array([0.0, 0.0, 0.4]) * motion.dq

    result = bayesid.find_discrepancy(healthy, arm_log(2, worn), arm_log(3, worn), posterior=False)
    (effect,) = result.added
    assert (effect.effect, effect.joints) == ("viscous_friction", (3,))
    change, sd, _ = effect.parameters["change of Fv3"]
    assert abs(change - 0.4) < 5.0 * sd + 0.01
    names = [parameter.name for parameter in result.identification.model.parameters]
    assert names == [parameter.name for parameter in healthy.model.parameters]


@pytest.mark.long
def test_held_back_blocks_do_not_affect_the_selection(healthy):
    """Wrong efforts in them do not change the first scores, except at their edges; the chosen effects fail on them."""
    log = arm_log(2, spring)
    block = np.minimum(np.arange(len(log)) * TUNING.blocks // len(log), TUNING.blocks - 1)
    held = np.isin(block, TUNING.held_back_blocks)
    inner = held & np.roll(held, 30) & np.roll(held, -30)
    nonsense = replace(log, effort=np.where(inner[:, None], log.effort[::-1] * 1.5, log.effort))
    plain, odd = (bayesid.find_discrepancy(healthy, noisy, posterior=False) for noisy in (log, nonsense))
    assert [(effect.effect, effect.joints) for effect in plain.added] == [("joint_spring", (2,))]
    springs = {("joint_spring", (2,)), ("gravity_spring", (2,))}  # the two are a factor of e apart
    assert {score.key for score in plain.scores[:2]} == {score.key for score in odd.scores[:2]} == springs
    assert odd.scores[0].gain == pytest.approx(plain.scores[0].gain, rel=0.3)
    assert ("joint_spring", (2,)) in odd.vetoed
    assert np.all(odd.before > 2.0 * plain.before)
    assert plain.holdout == "held-back blocks 3 and 6 of 8 of log2"


def test_effects_that_a_log_cannot_show_are_not_testable(healthy):
    """Joint 3 has only encoder noise."""
    motion, rng = smooth_motion(3, 14.0, 100.0, seed=2), np.random.default_rng(0)
    moves = np.array([1.0, 1.0, 0.0])
    rest = replace(motion, q=motion.q * moves + [0.0, 0.0, 0.4], dq=motion.dq * moves, ddq=motion.ddq * moves)
    effort = healthy.model.effort(rest, healthy.theta) + 0.05 * rng.normal(size=motion.q.shape)
    log = Log(rest.t, rest.q + 1e-6 * rng.normal(size=motion.q.shape), np.abs(effort), np.zeros(3, dtype=bool))
    result = bayesid.find_discrepancy(healthy, log, posterior=False)
    assert ("hysteresis", (3,)) in result.not_testable
    assert ("torque_ripple", (3,)) in result.not_testable
    assert ("viscous_friction", (1,)) not in result.not_testable


@pytest.fixture(scope="module")
def folder(healthy, tmp_path_factory):
    place = tmp_path_factory.mktemp("logs")
    bayesid.save(healthy, place / "healthy", report=False)
    arm_log(1).save(place / "first.csv")
    arm_log(2, spring).save(place / "log.csv")
    arm_log(3, spring).save(place / "holdout.csv")
    arm_log(2, spring, duration=1.2).save(place / "short.csv")
    return place


def test_command_leaves_report_and_extended_model(folder):
    out = folder / "extended"
    arguments = ["discrepancy", str(folder / "healthy"), str(folder / "log.csv"), "--no-posterior", "--out", str(out)]
    assert main([*arguments, "--holdout", str(folder / "holdout.csv")]) == 0
    written = json.loads((out / "discrepancy.json").read_text())
    assert written["status"] == "explained"
    assert [(effect["effect"], effect["joints"]) for effect in written["found"]] == [("joint_spring", [2])]
    k2 = written["found"][0]["parameters"]["k2"]
    assert k2["unit"] == "N m/rad"
    assert abs(k2["value"] - 7.0) < 4.0 * k2["sd"] < 1.2
    assert (written["where"][0]["joint"], written["where"][0]["variable"]) == (2, "position")
    assert written["gap"]["holdout"].endswith("holdout.csv")
    assert written["gap"]["after"][1] < 0.5 * written["gap"]["before"][1]
    assert "spring" in (out / "discrepancy.html").read_text()
    stored = bayesid.load(out)
    assert stored.seen(arm_log(1))  # what the earlier log has shown is in it
    assert stored.seen(read_log(folder / "log.csv"))
    assert not stored.seen(arm_log(4, spring))
    assert "joint_spring" in [term.name for term in stored.model.terms]
    check = stored.validate(arm_log(4, spring))
    assert check.rms_error[1] < 1.3 * stored.noise.sigma[1]
    again = bayesid.find_discrepancy(stored, arm_log(5, spring), posterior=False)
    assert again.status == "no_discrepancy"


def test_bad_input_is_one_line_and_exit_code_2(folder, tmp_path, capsys):
    log = arm_log(2)
    Log(log.t, log.q[:, :2], log.effort[:, :2], log.signed[:2]).save(folder / "two.csv")
    arm_log(2, robot=9).save(folder / "other.csv")
    replace(log, q=np.zeros_like(log.q)).save(folder / "still.csv")
    shutil.copytree(folder / "healthy", folder / "broken")
    (folder / "broken" / "model.toml").write_text("robot = 3\n")
    for change, message in (
        ({"holdout": "log.csv"}, "same motion as the log"),
        ({"result": "nowhere"}, "holds no model.toml"),
        ({"log": "short.csv"}, "too short for cross-validation"),
        ({"log": "two.csv"}, "the log has 2 joints"),
        ({"log": "other.csv"}, "the robot that the model was identified from"),
        ({"log": "still.csv"}, "constant"),
        ({"log": "first.csv"}, "the model was identified from this log"),
        ({"holdout": "first.csv"}, "the model was identified from this log"),
        ({"out": ""}, "holds"),
        ({"result": "broken"}, "model.toml"),
    ):
        paths = {name: folder / file for name, file in {"result": "healthy", "log": "log.csv", **change}.items()}
        options = ["--holdout", str(paths["holdout"])] if "holdout" in paths else []
        options += ["--no-posterior", "--out", str(paths.get("out", tmp_path / "out"))]
        assert main(["discrepancy", str(paths["result"]), str(paths["log"]), *options]) == 2
        error = capsys.readouterr().err.strip()
        assert message in error
        assert "\n" not in error
        assert not (tmp_path / "out").exists()


def test_a_nominal_model_warns_of_unknown_uncertainty(folder, tmp_path):
    """A model.toml without uncertainty: its parameters were never measured."""
    shutil.copytree(folder / "healthy", tmp_path / "nominal")
    path = tmp_path / "nominal" / "model.toml"
    text = path.read_text()
    path.write_text(text[: text.index("[knowledge]")])
    result = bayesid.find_discrepancy(bayesid.load(tmp_path / "nominal"), arm_log(2), posterior=False)
    assert any("uncertainty" in warning for warning in result.warnings)


@pytest.mark.real
@pytest.mark.long
def test_ur10e_payload():
    model = bayesid.identify("ur10e", read_log(real_log("ur10e/c_unloaded.csv")).rectified(), posterior=False)
    log = read_log(real_log("ur10e/c_loaded.csv")).rectified()
    result = bayesid.find_discrepancy(model, log, posterior=False)
    assert result.added[0].effect == "payload"
    assert abs(result.added[0].parameters["mp6"][0] / 2.8 - 1.0) < 0.15
