"""Traffic lights: each state of each check, the numbers and names that it tells, and that there is something to do."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from made_findings import make_findings, make_samples, with_summary

from bayesid.identification.checks import Check
from bayesid.identification.misread import Misreading
from bayesid.regression.selection.nuisance_scales import TooNarrow
from bayesid.report.grading import verdict, worst
from bayesid.report.summary import CompletionSummary, ErrorsSummary, GainsSummary, LowPassSummary, ModeSummary
from bayesid.report.verdicts import check_findings, sure_share


def asked(findings, *narrow):
    """The catalogue was searched, nothing entered."""
    errors = ErrorsSummary(before=(0.2, 0.1), after=(0.2, 0.1), effort=(4.0, 3.0))
    return with_summary(findings, complete=CompletionSummary((), errors, (), too_narrow=narrow))


GOOD = asked(make_findings(validated=True))
SIGNED = asked(make_findings(signed_joints=(1, 2)))
summary, fit, search, posterior = (
    partial(with_summary, GOOD),
    *(partial(with_summary, GOOD, part) for part in ("fit", "search", "posterior")),
)


def silent():
    """The log does not show two coefficients."""
    table = GOOD.coefficients
    return replace(GOOD, coefficients=replace(table, sd=np.where(np.arange(8) < 2, np.inf, table.sd)))


def decided(count):
    return replace(GOOD, coefficients=replace(GOOD.coefficients, by_data=np.arange(8) < count))


def by_factor(size):
    """The common factor of the gains makes every sd nine times as large as the value; without it they are `size`."""
    table = replace(GOOD.coefficients, by_data=np.ones(8, dtype=bool), sd=9.0 * np.abs(GOOD.coefficients.mean))
    gains = with_gains(sd_of_coefficients=tuple(size * np.abs(table.mean)), factor_decided_by="prior").summary.gains
    return replace(summary(gains=gains), coefficients=table)


def unsure(joint, share):
    """A share of a joint's |effort| in motion has a sign that is sure to 98 % only."""
    samples = GOOD.samples
    effort = np.abs(samples.recorded[:, joint]) * samples.used[:, joint]
    probability = samples.probability.copy()
    probability[np.cumsum(effort) <= share * effort.sum(), joint] = 0.98
    return replace(GOOD, samples=replace(samples, probability=probability))


def with_modes(first, second, mode=1):
    """Joint 2 is turned round in the second one."""
    modes = (ModeSummary(first, 0.1, ()), ModeSummary(second, 0.2, (2,), {GOOD.coefficients.name[0]: 9.5}))
    return summary(modes=modes, posterior=replace(GOOD.summary.posterior, mode=mode))


def predicted(**changes):
    changes = {key: np.array(value) for key, value in changes.items()}
    return replace(GOOD, prediction=replace(GOOD.prediction, **changes))


def without_effort(*joints):
    """Of the log that is predicted: nothing of these joints can be compared."""
    values = {name: getattr(GOOD.prediction, name).copy() for name in ("rms_error", "relative_residual", "coverage")}
    for each in values.values():
        each[list(joints)] = np.nan
    return predicted(**values)


def pushed(joint, share):
    """A joint's residual is this share of its RMS effort in one fifth of the time, and zero elsewhere."""
    samples = GOOD.samples
    size = share * np.sqrt(np.mean(samples.signed[samples.used[:, joint], joint] ** 2))
    residual = np.zeros_like(samples.residual)
    residual[samples.t > 0.8 * samples.t[-1], joint] = -size
    return replace(GOOD, samples=replace(samples, residual=residual))


def coloured(share, effective):
    """Of joint 2's variance of the residual, and so many samples of each joint that are left then."""
    sd = np.array(GOOD.summary.noise.sd)
    coloured = tuple(sd * np.sqrt((0.0, share)))
    return with_summary(GOOD, "noise", coloured_sd=coloured, effective_samples=(effective,) * 2)


def with_gains(**changes):
    """Both gains were stated to 20 %."""
    each = {
        "mean": (12.5, 9.5),
        "sd": (0.4, 0.3),
        "lower": (11.7, 8.9),
        "upper": (13.3, 10.1),
        "ratio_sd": (0.03, 0.04),
    }
    factor = {"factor": 1.04, "factor_sd": 0.05, "factor_decided_by": "data"}
    made = GainsSummary(**each, **factor, decided_by=("data",) * 2, unit="N m/A", stated="12~20%,9~20%", converged=True)
    return summary(gains=replace(made, **changes))


SPRING = TooNarrow(("gravity_spring", "joint_spring"), (2,), ("mc2x", "J2xx"))
FAR_OFF = TooNarrow(("kinematics",), (), ("a", "b", "c", "d", "e", "f", "g"), 3.14)
OTHER = Misreading("joint order", "joints 2 and 3 exchanged", 0.041, 0.213, 9.0, "check the robot file")
NO_PROOF = {"certified": False, "lower_bound": None, "gap": None, "optimality_gap": None, "assignments": None}
PRESSED = {"mass of all links, from above": 0.97}
MENDED = ("rows of 0; 37 are dropped",)
LOW_PASS = LowPassSummary(8.1, 1, True, (0.2, 0.3), "8.1 Hz (so)")

CASES = {  # of each check: state, findings, and what the message contains, in the order of the pipeline
    "Robot file": [
        ("good", GOOD, ""),
        ("bad", summary(better_reading=OTHER), "joints 2 and 3|4.1|21.3"),
        ("bad", asked(GOOD, replace(FAR_OFF, times=66.0)), "66 mm|6.6 degrees"),
    ],
    "Excitation": [
        ("good", GOOD, "42"),
        ("look", fit(condition_number=101.0), "101"),
        ("bad", fit(condition_number=1001.0), "1001"),
        ("bad", fit(condition_number=None), "8"),
        ("bad", fit(condition_number=None, relative_residual=[0.1, 0.0]), "joint 2: no effort"),
        ("bad", silent(), "2|8"),
    ],
    "Signs of the segments": [
        ("good", GOOD, "100|2|10|0.95"),
        ("good", SIGNED, ""),
        ("look", unsure(1, 0.2), "2|10"),
        ("bad", unsure(0, 0.5), ""),
        (
            "look",
            with_summary(GOOD, "signs", model_error_probability=[0.0, 0.3]),
            "capped at 0.85|99 % certain in joint 2",
        ),
    ],
    "Low-pass after the rectifier": [("look", summary(low_pass_after_rectifier=LOW_PASS), "8.1 Hz")],
    "Proof": [
        ("good", GOOD, ""),
        ("good", SIGNED, ""),
        ("good", search(assignments=4, persistent_share=0.97), "3 alternatives|3.0 %"),
        ("look", search(assignments=4, persistent_share=0.9), "3 alternatives|10.0 %|1/992"),
        ("look", search(**NO_PROOF), "beam"),
        ("look", search(certified=False, uncertified_because="tikhonov"), "not proven"),
        ("bad", posterior(posterior_conflict=0.83), "83"),
        ("look", posterior(posterior_conflict=0.14), "14"),
        ("look", search(certified=False, lower_bound=800.25, gap=12.25), "not proven|1.5 %"),
    ],
    "Sampling": [
        ("good", GOOD, "1.004|812"),
        ("not done", summary(posterior=None), ""),
        ("bad", posterior(converged=False, max_rhat=1.37, min_ess=12.0), "1.37|12"),  # of an earlier version
        (
            "bad",
            posterior(converged=False, max_rhat=1.0062, min_ess=523.9, wanted_rhat=1.01, wanted_ess=1024.0),
            "needs 1,024 effective samples, has 523",
        ),
    ],
    "Modes": [
        ("good", GOOD, "1 %"),
        ("look", with_modes(0.9, 0.1), "0.1|mode 2|joint 2|9.5"),
        ("bad", with_modes(0.54, 0.46), "mode 1|0.54|mode 2|0.46"),
        ("bad", with_modes(0.97, 0.03, mode=2), "mode 2|0.03|mode 1|0.97"),
    ],
    "Fit": [
        ("good", GOOD, "2.3|2.6|joint 2"),
        ("good", fit(links_on_edge=[2, 3]), "2.3|2.6"),
        ("look", fit(relative_residual=[0.11, 0.04]), "4.0|11.0|joint 1"),
        ("bad", fit(relative_residual=[0.04, 0.26]), "26 %|joint 2"),
    ],
    "Additional effects": [("good", GOOD, "")],
    "Gains": [
        ("good", with_gains(), "joints 1 and 2|4.0 %|1.04"),
        ("look", with_gains(decided_by=("data", "prior"), factor_decided_by="prior"), "joint 1|3.0 %|joint 2|prior"),
        ("look", with_gains(like_friction=(2,), factor_decided_by="given"), "joint 2|friction|exact"),
        ("bad", with_gains(converged=False), ""),
    ],
    "Intervals": [
        ("good", GOOD, ""),
        ("not done", summary(complete=None), ""),
        ("not done", with_summary(asked(GOOD, SPRING), "fit", relative_residual=[0.04, 0.26]), ""),
        ("not done", asked(GOOD, SPRING), "balancing spring|joint spring|joint 2|mc2x|J2xx"),
        ("look", asked(GOOD, FAR_OFF), "3.1 mm or 0.31 degrees|assumed: 1.0 mm|a, b, c, d, e, f and g"),
    ],
    "Whiteness of the residual": [
        ("good", coloured(0.8, 12.0), "80 %|joint 2|24 effective|8 coefficients"),  # intervals allow for it
        ("look", coloured(0.8, 11.0), "22 effective"),
        ("bad", coloured(0.8, 3.0), "6 effective"),
        ("good", pushed(joint=1, share=0.5), "joint 2, 50 % of its RMS effort"),
    ],
    "Data or prior": [
        ("good", decided(8), "8|1|3"),
        ("look", decided(7), "7|8"),
        ("look", decided(4), "4|8"),
        ("bad", decided(3), "3|8"),
        ("bad", posterior(active_bounds=PRESSED), "mass of all links, from above|97"),
        ("good", by_factor(0.1), "common factor of the gains|8 of 8|0 are smaller"),
        ("good", by_factor(2.0), "common factor of the gains|8 of 8|8 are smaller"),
    ],
    "Validation": [
        ("good", GOOD, "another.csv|3.1|3.2|93.0|93.5"),
        ("not done", replace(GOOD, prediction=None), ""),
        ("look", predicted(coverage=[0.89, 0.95]), "89|95|good: 90 to 99 %"),
        ("look", predicted(coverage=[0.95, 0.996]), "95.0 % to 99.6 %|cautious"),
        (
            "look",
            predicted(rms_error=[0.38, 0.3]),
            f"joint 1 {0.38 / GOOD.summary.noise.residual_sd[0]:.2f} times|good: up to 1.5",
        ),
        ("bad", predicted(relative_residual=[0.03, 0.26]), "26.0|good: up to 25 %"),
        ("look", without_effort(0), "joint 1|3.2"),
        ("bad", without_effort(0, 1), "no effort"),
    ],
    "Warnings": [
        ("good", GOOD, ""),
        ("look", summary(warnings=["a dog; beware", "a cat; look up"]), "2"),
        ("look", summary(warnings=[*MENDED, "joint 3 stands; look"], corrected=MENDED), "joint 3 stands"),
        ("good", summary(warnings=[*MENDED, "no remedy"], corrected=MENDED), "2"),
        ("good", summary(warnings=["relative residual"]), "none besides the checks"),
    ],
}


def told(findings, name):
    (check,) = [one for one in check_findings(findings) if one.name == name]
    return check


@pytest.mark.parametrize("name", CASES)
def test_each_state_of_a_check_has_its_numbers_and_a_remedy(name):
    for state, findings, says in CASES[name]:
        found = told(findings, name)
        assert found.state == state, found
        assert all(one in found.message for one in says.split("|")), found
        nothing_to_do = state == "good" or ((name, state) == ("Gains", "look") and "friction" in says)
        assert bool(found.remedy) != nothing_to_do, found
        assert "\n" not in found.message + found.remedy


def test_a_poor_validation_names_the_payload_command():
    check = told(predicted(relative_residual=[0.03, 0.26]), "Validation")
    assert "`bayesid payload RESULT ANOTHER_LOG.csv`" in check.remedy


def test_checks_come_in_the_order_of_the_pipeline():
    names = [name for name in CASES if name not in ("Low-pass after the rectifier", "Gains")]
    assert [one.name for one in check_findings(GOOD)] == names
    assert [one.state for one in check_findings(GOOD) if one.name != "Data or prior"] == ["good"] * (len(names) - 1)


def test_the_sure_share_counts_each_joint_alike():
    """By hand: of joint 1 |effort| 1, 2 and 3 in motion, of joint 2 10 and 30."""
    samples = make_samples(2, 4)
    samples = replace(
        samples,
        recorded=np.array([[100.0, 7.0], [1.0, 10.0], [2.0, 30.0], [3.0, 0.0]]),
        used=np.array([[False, False], [True, True], [True, True], [True, True]]),
        probability=np.array([[0.5, 0.5], [0.995, 0.98], [0.5, 0.005], [0.01, 0.5]]),
    )
    expected = 0.5 * ((1.0 + 3.0) / 6.0 + 30.0 / 40.0)
    assert sure_share(replace(GOOD, samples=samples)) == pytest.approx(expected, rel=1e-12)
    still = replace(GOOD.samples, used=np.zeros_like(GOOD.samples.used))
    assert sure_share(replace(GOOD, samples=still)) == 0.0


def test_remedies_are_commands_with_the_result_and_its_robot():
    """As far as they are known; a command that was run is run again with what helps."""
    found = posterior(converged=False)
    options = {"posterior.budget": 20.0}
    for typed in ("--posterior-budget 20", "--posterior-budget=20"):
        command = f"bayesid identify a.csv {typed} --out x"
        more = with_summary(found, "provenance", command=command, options=options)
        assert "`bayesid identify a.csv --out x --posterior-budget 80 --force`" in told(more, "Sampling").remedy
    found = replace(fit(relative_residual=[0.3, 0.1]), folder="my results/un", prediction=None)
    command = "bayesid identify 'a log.csv' --robot ur10e --no-posterior --out x"
    found = with_summary(found, "provenance", command=command, options={"robot": "ur10e"})
    assert "`bayesid discrepancy 'my results/un' ANOTHER_LOG.csv`" in told(found, "Fit").remedy
    assert "`bayesid validate 'my results/un' ANOTHER_LOG.csv`" in told(found, "Validation").remedy
    silent_one = with_summary(found, "fit", condition_number=None)
    assert "`bayesid excite --robot ur10e --limits LIMITS.toml`" in told(silent_one, "Excitation").remedy
    arm = {"robot": "two arms.urdf", "tip": "left_hand", "hold": {"lift": 0.25, "waist": -1.0}}
    one_arm = told(with_summary(silent_one, "provenance", options=arm), "Excitation").remedy
    assert "`bayesid excite --robot 'two arms.urdf' --tip left_hand --hold lift=0.25,waist=-1.0`" in one_arm
    unsampled = with_summary(found, posterior=None)
    assert "`bayesid identify 'a log.csv' --robot ur10e --out x --force`" in told(unsampled, "Sampling").remedy
    unproven = with_summary(found, "search", certified=False, gap=2.0)
    unproven = with_summary(unproven, "provenance", options={"search.budget": 10.0})
    assert " --out x --search-budget 40 --force`" in told(unproven, "Proof").remedy
    seen = told(replace(GOOD, prediction=replace(GOOD.prediction, seen=True), folder="un"), "Validation")
    assert seen.state == "not done", "the log of the identification is no validation"
    assert "`bayesid validate un ANOTHER_LOG.csv`" in seen.remedy


def test_a_wrong_robot_leads_the_verdict_and_the_first_remedy_is_its_file():
    """The fit leaves much, and another reading of the log leaves less."""
    for kind in ("joint order", "direction", "units", "mounting", "robot"):
        another = replace(OTHER, kind=kind)
        found = verdict(check_findings(with_summary(fit(relative_residual=[0.04, 0.21]), better_reading=another)))
        reasons = found["reasons"]
        assert [found["state"], *(one["check"] for one in reasons[:2])] == ["bad", "Robot file", "Fit"]
        assert "robot file" in reasons[0]["remedy"]
    assert verdict([Check("One", "good", "seen")]) == {"state": "good", "reasons": []}
    assert worst([Check("One", "good", "seen"), Check("Two", "not done", "seen")]) == "good"
