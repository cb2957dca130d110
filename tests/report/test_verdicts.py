"""Traffic lights: each state of each check, what it says, and that there is something to do about it."""

from dataclasses import replace

import numpy as np
import pytest
from made_findings import make_findings, make_samples, with_summary

from bayesid.fit.effects.confounded import TooNarrow
from bayesid.identification.other_readings import BetterReading
from bayesid.report.findings.summary import CompletionSummary, ErrorsSummary, LowPassSummary, ModeSummary
from bayesid.report.verdicts import Check, check_findings, sure_share, verdict, worst


def asked(findings, *narrow):
    """The catalogue, of which nothing entered."""
    errors = ErrorsSummary(before=(0.2, 0.1), after=(0.2, 0.1), effort=(4.0, 3.0))
    return with_summary(findings, complete=CompletionSummary((), errors, (), too_narrow=narrow))


GOOD = asked(make_findings(validated=True))
SIGNED = asked(make_findings(signed_joints=(1, 2)))
NAMES = [
    "Robot file",
    "Excitation",
    "Signs of the segments",
    "Proof",
    "Sampling",
    "Modes",
    "Fit",
    "Beyond the terms",
    "Intervals",
    "Whiteness of the residual",
    "Data or prior",
    "Validation",
    "Warnings",
]


def silent():
    """The log does not show two coefficients."""
    table = GOOD.coefficients
    return replace(GOOD, coefficients=replace(table, sd=np.where(np.arange(8) < 2, np.inf, table.sd)))


def decided(count):
    return replace(GOOD, coefficients=replace(GOOD.coefficients, by_data=np.arange(8) < count))


def unsure(joint, share):
    """A share of a joint's |effort| in motion has a sign that is sure to 98 % only."""
    samples = GOOD.samples
    effort = np.abs(samples.recorded[:, joint]) * samples.used[:, joint]
    doubtful = np.cumsum(effort) <= share * effort.sum()
    probability = samples.probability.copy()
    probability[doubtful, joint] = 0.98
    return replace(GOOD, samples=replace(samples, probability=probability))


def with_modes(first, second, mode=1):
    """Joint 2 is turned round in the second one."""
    name = GOOD.coefficients.name[0]
    modes = (ModeSummary(first, 0.1, ()), ModeSummary(second, 0.2, (2,), {name: 9.5}))
    posterior = replace(GOOD.summary.posterior, mode=mode)
    return replace(GOOD, summary=replace(GOOD.summary, modes=modes, posterior=posterior))


def predicted(**changes):
    changes = {key: np.array(value) for key, value in changes.items()}
    return replace(GOOD, prediction=replace(GOOD.prediction, **changes))


def lasting(*share):
    """Of each joint's variance of the residual."""
    sd = np.array(GOOD.summary.noise.sd)
    return with_summary(GOOD, "noise", coloured_sd=tuple(sd * np.sqrt(share)))


SPRING = TooNarrow(("gravity_spring", "joint_spring"), (2,), ("mc2x", "J2xx"))
FAR_OFF = TooNarrow(("kinematics",), (), ("a", "b", "c", "d", "e", "f", "g"), 3.14)
OTHER = BetterReading("joint order", "joints 2 and 3 exchanged", 0.041, 0.213)


def poor(reading):
    """The fit leaves much, and another reading of the log may leave less."""
    findings = with_summary(GOOD, "fit", relative_residual=[0.04, 0.21])
    return replace(findings, summary=replace(findings.summary, better_reading=reading))


CASES = [
    ("Robot file", "good", GOOD, ["nothing speaks for another robot"]),
    (
        "Robot file",
        "bad",
        with_summary(GOOD, better_reading=OTHER),
        ["with joints 2 and 3 exchanged", "leaves 4.1% of the effort instead of 21.3%"],
    ),
    ("Excitation", "good", GOOD, ["condition number", "42"]),
    ("Excitation", "good", with_summary(GOOD, "fit", condition_number=100.0), ["100"]),
    ("Excitation", "look", with_summary(GOOD, "fit", condition_number=101.0), ["101"]),
    ("Excitation", "look", with_summary(GOOD, "fit", condition_number=999.0), ["999"]),
    ("Excitation", "bad", with_summary(GOOD, "fit", condition_number=1001.0), ["1001"]),
    ("Excitation", "bad", with_summary(GOOD, "fit", condition_number=None), ["some of 8"]),
    ("Excitation", "bad", silent(), ["2 of 8"]),
    ("Signs of the segments", "good", GOOD, ["100.0%", "2 of 10 segments", "0.95"]),
    ("Signs of the segments", "good", SIGNED, ["all signs were known"]),
    ("Signs of the segments", "look", unsure(1, 0.2), ["of the |effort|", "2 of 10"]),
    ("Signs of the segments", "bad", unsure(0, 0.5), ["of the |effort|"]),
    (
        "Signs of the segments",
        "look",
        with_summary(GOOD, "signs", doubt=[0.0, 0.3]),
        ["of joint 2 are lowered, to 0.85"],
    ),
    (
        "Low-pass after the rectifier",
        "look",
        with_summary(GOOD, low_pass_after_rectifier=LowPassSummary(8.1, 1, True, (0.2, 0.3), "8.1 Hz (so)")),
        ["low-passed after it was rectified, at about 8.1 Hz (so)"],
    ),
    ("Proof", "good", GOOD, ["no assignment of signs costs less", "no other", "13.8"]),
    ("Proof", "good", SIGNED, ["nothing to prove"]),
    (
        "Proof",
        "look",
        with_summary(GOOD, "search", assignments=2),
        ["one other of the strong segments comes within 13.8"],
    ),
    (
        "Proof",
        "look",
        with_summary(GOOD, "search", assignments=4),
        ["3 others of the strong segments come within 13.8"],
    ),
    (
        "Proof",
        "look",
        with_summary(GOOD, "search", certified=False, lower_bound=None, gap=None, within=None, assignments=None),
        ["beam"],
    ),
    ("Proof", "look", with_summary(GOOD, "search", certified=False, withheld="pull"), ["may cost the data less"]),
    (
        "Proof",
        "look",
        with_summary(GOOD, "search", certified=False, withheld="noise"),
        ["how large each joint's noise"],
    ),
    ("Proof", "bad", with_summary(GOOD, "posterior", excluded=0.83), ["excludes signs of up to 83%"]),
    ("Proof", "look", with_summary(GOOD, "search", certified=False, lower_bound=800.25, gap=12.25), ["12.2", "812.5"]),
    ("Sampling", "good", GOOD, ["converged", "1.004", "812"]),
    ("Sampling", "not done", with_summary(GOOD, posterior=None), ["no posterior"]),
    (
        "Sampling",
        "bad",
        with_summary(GOOD, "posterior", converged=False, max_rhat=1.37, min_ess=12.0),
        ["not converged", "1.370", "12"],
    ),
    ("Sampling", "bad", with_summary(GOOD, "posterior", converged=False, max_rhat=None, min_ess=None), ["unknown"]),
    ("Modes", "good", GOOD, ["no other model has more than 1%"]),
    ("Modes", "good", with_modes(0.992, 0.008), ["no other model"]),
    ("Modes", "look", with_modes(0.97, 0.03), ["0.03 for mode 2", "joint 2 turned round", "9.5 instead"]),
    ("Modes", "bad", with_modes(0.54, 0.46), ["mode 1 (0.54): 0.46 for mode 2"]),
    ("Modes", "bad", with_modes(0.97, 0.03, mode=2), ["mode 2 (0.03): 0.97 for mode 1"]),
    ("Fit", "good", GOOD, ["2.3% to 2.6%", "joint 2"]),
    ("Fit", "look", with_summary(GOOD, "fit", relative_residual=[0.11, 0.04]), ["4.0% to 11.0%", "joint 1"]),
    ("Fit", "good", with_summary(GOOD, "fit", links_on_edge=[2, 3]), ["2.3% to 2.6%"]),
    ("Fit", "bad", with_summary(GOOD, "fit", relative_residual=[0.04, 0.26]), ["26.0%", "joint 2"]),
    ("Beyond the terms", "good", GOOD, ["nothing that evidence"]),
    ("Intervals", "not done", with_summary(GOOD, complete=None), ["nobody asked"]),
    ("Intervals", "not done", with_summary(asked(GOOD, SPRING), "fit", relative_residual=[0.04, 0.26]), ["not judged"]),
    ("Intervals", "good", GOOD, ["nothing of the catalogue"]),
    (
        "Intervals",
        "look",
        asked(GOOD, SPRING),
        ["cannot tell a balancing spring or a joint spring from the links: if joint 2 has one, mc2x and J2xx are off"],
    ),
    ("Intervals", "look", asked(GOOD, FAR_OFF), ["3.1 times as far", "a, b, c, d, e, f and g may be farther off"]),
    ("Whiteness of the residual", "good", lasting(0.1, 0.29), ["29%", "joint 2", "2 samples"]),
    ("Whiteness of the residual", "look", lasting(0.45, 0.2), ["45%", "joint 1"]),
    ("Data or prior", "good", decided(8), ["8 of 8", "1 are smaller", "3 single"]),
    ("Data or prior", "look", decided(7), ["7 of 8"]),
    ("Data or prior", "look", decided(4), ["4 of 8"]),
    ("Data or prior", "bad", decided(3), ["3 of 8"]),
    (
        "Data or prior",
        "bad",
        with_summary(GOOD, "posterior", pressed_windows={"mass of all links, from above": 0.97}),
        ["mass of all links, from above (97% of the draws"],
    ),
    ("Validation", "good", GOOD, ["another.csv", "3.1% to 3.2%", "93% to 94%"]),
    ("Validation", "not done", replace(GOOD, prediction=None), ["not been tried"]),
    ("Validation", "look", predicted(coverage=[0.89, 0.95]), ["89% to 95%"]),
    ("Validation", "look", predicted(coverage=[0.95, 1.0]), ["95% to 100%"]),
    ("Validation", "look", predicted(rms_error=[0.38, 0.3]), ["3.1%"]),
    ("Validation", "bad", predicted(relative_residual=[0.03, 0.26]), ["26.0%"]),
    ("Warnings", "good", GOOD, ["none"]),
    ("Warnings", "look", with_summary(GOOD, warnings=["beware"]), ["one"]),
    ("Warnings", "look", with_summary(GOOD, warnings=["beware", "of the dog"]), ["2"]),
]


ALSO = {
    "Excitation": {"Data or prior"},  # what the log does not show is not known either
    "Fit": {"Intervals"},  # of a poor model none holds
    "Intervals": {"Beyond the terms", "Fit"},  # one catalogue speaks for both
    "Robot file": {"Data or prior"},  # nothing is to be mended before
}


@pytest.mark.parametrize(("name", "state", "findings", "says"), CASES)
def test_states(name, state, findings, says):
    (found,) = [one for one in check_findings(findings) if one.name == name]
    assert found.state == state
    for words in says:
        assert words in found.message
    assert bool(found.remedy) == (state != "good")
    for text in (found.message, found.remedy):
        assert not text.endswith(".")
        assert "\n" not in text
        assert text.count("`") % 2 == 0


def test_all_checks_in_the_order_of_the_pipeline():
    assert [one.name for one in check_findings(GOOD)] == NAMES
    assert [one.state for one in check_findings(GOOD) if one.name != "Data or prior"] == ["good"] * (len(NAMES) - 1)
    assert {(name, state) for name, state, _, _ in CASES} >= {(name, "good") for name in NAMES}


def test_one_change_moves_one_light():
    """What a check says rests on nothing that another one is about."""
    before = {one.name: one for one in check_findings(GOOD)}
    for name, _, findings, _ in CASES:
        also = ALSO.get(name, set())
        if findings is not SIGNED:
            assert {one.name for one in check_findings(findings) if one != before.get(one.name)} <= {name} | also


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


def test_joints_that_stand_still_are_no_fault():
    samples = replace(GOOD.samples, used=np.zeros_like(GOOD.samples.used))
    assert sure_share(replace(GOOD, samples=samples)) == 0.0


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        (["good", "good"], "good"),
        (["good", "not done"], "look"),
        (["look", "good"], "look"),
        (["not done", "bad", "look"], "bad"),
        ([], "good"),
    ],
)
def test_the_worst_light_counts(states, expected):
    assert worst(Check("x", state, "y") for state in states) == expected


def told(findings, name):
    (check,) = [one for one in check_findings(findings) if one.name == name]
    return check


def test_remedies_are_commands_with_the_result_and_its_robot():
    """As far as they are known; a command that was run is run again with what helps."""
    found = replace(with_summary(GOOD, "fit", relative_residual=[0.3, 0.1]), folder="my results/un")
    run = {
        "command": "bayesid identify 'a log.csv' --robot ur10e --no-posterior --out x",
        "options": {"robot": "ur10e"},
    }
    found = with_summary(replace(found, prediction=None), "provenance", **run)
    assert "`bayesid discrepancy 'my results/un' ANOTHER_LOG.csv`" in told(found, "Fit").remedy
    assert told(found, "Validation").remedy == "run `bayesid report 'my results/un' --validation ANOTHER_LOG.csv`"
    silent_one = with_summary(found, "fit", condition_number=None)
    assert "`bayesid excite --robot ur10e`" in told(silent_one, "Excitation").remedy
    arm = {"robot": "two arms.urdf", "tip": "left_hand", "hold": {"lift": 0.25, "waist": -1.0}}
    one_arm = told(with_summary(silent_one, "provenance", options=arm), "Excitation").remedy
    assert "`bayesid excite --robot 'two arms.urdf' --tip left_hand --hold lift=0.25,waist=-1.0`" in one_arm
    unsampled = with_summary(found, posterior=None)
    assert told(unsampled, "Sampling").remedy == (
        "leave out --no-posterior: `bayesid identify 'a log.csv' --robot ur10e --out x`"
    )
    unproven = with_summary(found, "search", certified=False, gap=2.0)
    unproven = with_summary(unproven, "provenance", options={"search.budget": 10.0})
    assert told(unproven, "Proof").remedy.endswith(" --out x --search-budget 40`")
    by_hand = with_summary(unsampled, "provenance", command=None)
    assert told(by_hand, "Sampling").remedy == "leave out --no-posterior"


def test_the_log_of_the_identification_is_no_validation():
    found = replace(GOOD, prediction=replace(GOOD.prediction, seen=True), folder="un")
    check = told(found, "Validation")
    assert check.state == "not done"
    assert "the model was identified from another.csv" in check.message
    assert check.remedy == "run `bayesid report un --validation ANOTHER_LOG.csv`"


def test_doubts_at_standstill_are_told_beside_those_in_motion():
    """The one of the largest |effort| is named: joint 2's, half of what that joint reaches."""
    table, samples = GOOD.segments, GOOD.samples
    still = ~table.moving
    recorded = np.ones_like(samples.recorded)
    recorded[: len(recorded) // 12] = [0.2, 0.5]
    found = replace(
        GOOD,
        samples=replace(samples, recorded=recorded),
        segments=replace(table, ambiguous=table.ambiguous | still, end=np.where(still, table.start + 0.2, table.end)),
    )
    said = (
        "at standstill, where friction may point either way, 2 of 2 segments are ambiguous (the largest, 50% of its "
        "joint's |effort|, in joint 2, 0.00 to 0.20 s)"
    )
    assert said in told(found, "Signs of the segments").message
    assert told(found, "Signs of the segments").state == "good"
    assert "standstill" not in told(GOOD, "Signs of the segments").message


@pytest.mark.parametrize("kind", ["joint order", "direction", "units", "mounting", "robot"])
def test_a_wrong_robot_is_red_and_the_first_remedy_is_its_file(kind):
    found = verdict(check_findings(poor(replace(OTHER, kind=kind))))
    assert found.state == "bad"
    assert found.reasons[0].name == "Robot file"
    assert found.reasons[0].remedy.startswith("check the robot file")
    assert found.plain["reasons"][0]["remedy"] == found.reasons[0].remedy


def test_a_verdict_names_all_that_is_not_good_the_worst_first():
    checks = check_findings(replace(poor(None), prediction=None))
    found = verdict([*checks, Check("Another", "bad", "seen", "do this")])
    assert [one.name for one in found.reasons] == ["Another", "Fit", "Data or prior", "Validation"]
    assert verdict([Check("One", "good", "seen")]).plain == {"state": "good", "reasons": []}
