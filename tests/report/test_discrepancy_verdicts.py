"""Verdicts of a discrepancy: their states, numbers, joints and effects."""

import re
import string
from dataclasses import replace

import numpy as np
from made_discrepancy import FRICTION, NOTHING, floor_of, found, friction, made_of, make

from bayesid import effects
from bayesid.discrepancy.case import Excess
from bayesid.effects.bodies import CarriedPayload, Payload
from bayesid.effects.catalogue import forms, make_effect
from bayesid.effects.drive import Delay, GainError, TorqueOffset
from bayesid.effects.friction import CoulombFriction, ThermalDrift
from bayesid.effects.kinematic_errors import BaseTilt
from bayesid.effects.learned_effect import LearnedEffect
from bayesid.number_text import quantity, rounded
from bayesid.regression.selection.added_effect import Cost, EffortSize
from bayesid.report.brief import in_brief
from bayesid.report.discrepancy import added_summary, discrepancy_checks

BODY = {
    "mass": (2.8, 0.04, "kg"),
    "centre of mass x": (0.03, 0.004, "m"),
    "centre of mass y": (-0.2, 0.002, "m"),
    "centre of mass z": (0.1104, 0.0006, "m"),
    "inertia xx": (0.005, 0.002, "kg m^2"),
    "inertia xy": (-0.0012, 0.0003, "kg m^2"),
    "inertia xz": (0.0004, 0.0001, "kg m^2"),
    "inertia yy": (0.007, 0.001, "kg m^2"),
    "inertia yz": (0.0003, 0.0002, "kg m^2"),
    "inertia zz": (0.009, 0.003, "kg m^2"),
}
WORTH = {"size": EffortSize(2, 1.5, 2.25, 45.0, "rated effort"), "cost": Cost(3, 3.2, 0.5, 40.0)}
PAYLOAD = found(Payload(), {"mp3": (2.8, 0.04, "kg")}, readable=BODY)
DRIFT = ThermalDrift(joints=(2,), smoothing=(0.05,), time=(300.0,))
OWN = {"Fcold2": (-1.8, 0.5, "N m"), "Fwarm2": (0.8, 0.2, "N m"), "time2": (300.0, np.nan, "s")}


def holds(text, *parts):
    """Whether a text has all parts, in this order."""
    return re.search(".*".join(map(re.escape, parts)), text, re.DOTALL) is not None


def checks_of(result, name=None):
    """Of one name, or all."""
    return [one for one in discrepancy_checks(result) if name in (None, one.name)]


def line(result, name):
    """Text of one of the lines on top; empty without it."""
    return next((one.message for one in in_brief(result) if one.name == name), "")


def test_numbers_keep_the_digits_that_are_known():
    for value, sd, unit, text in (
        (1.9, 0.1, "N m", "1.90 +- 0.10 N m"),
        (1.9, 0.31, "N m", "1.90 +- 0.31 N m"),
        (1.9, np.nan, "N m", "1.90 N m"),
        (-0.0431, 0.00096, "rad", "-0.0431 +- 0.0010 rad"),
        (123.4, 20.0, "", "123 +- 20"),
        (2.5e-6, 1.2e-7, "kg m^2", "(2.50 +- 0.12)e-6 kg m^2"),
        (0.0, 0.02, "N m", "0.000 +- 0.020 N m"),
        (np.nan, np.nan, "N m", "unknown N m"),
        (3.0, 0.0, "s", "3.00 s"),
    ):
        assert quantity(value, sd, unit) == text
    text = [rounded(value) for value in (0.3, 2.4, 0.09999, 123.4, 0.0, 2e-7)]
    assert text == ["0.300", "2.40", "0.100", "123", "0.00", "2.00e-07"]


TILT = {"tilt1": (np.deg2rad(1.5), np.deg2rad(0.02), "rad"), "tilt2": (np.deg2rad(-0.5), np.nan, "rad")}


FOUND = [
    (found(friction(), FRICTION), "good", ["Joint 2", "Coulomb friction", "1.90 +- 0.10 N m"]),
    (found(CoulombFriction(joints=(1, 2), smoothing=(0.1, 0.1)), FRICTION), "good", ["Joints 1 and 2", "Fc", "1.90"]),
    (found(Payload(), {"mp3": (2.5, 0.04, "kg")}), "good", ["payload", "2.50 +- 0.04 kg"]),
    (found(BaseTilt(angle=(0.02, -0.01)), TILT), "good", ["1.500 +- 0.020 degrees", "-0.500 degrees"]),
    (found(Delay(lag=(0.004,)), {"lag": (0.004, 3e-4, "s")}), "good", ["All joints", "lag 4.00 +- 0.30 ms"]),
    (found(Delay(joints=(2,), lag=(0.0,)), {"lag2": (-0.004, 3e-4, "s")}), "good", ["4.00 +- 0.30 ms", "ahead"]),
    (found(Delay(lag=(-0.004,))), "good", ["All joints'", "0.00400", "ahead"]),
    (found(GainError(joints=(1,), gain=(0.9,)), {"gain1": (0.9, 0.02, "1")}), "good", ["10.0 +- 2.0 %", "too small"]),
    (
        found(friction(), {"Fc2": (2.3, 0.1, "N m"), "change of Fc2": (0.4, 0.1, "N m")}, changes=("Fc2",)),
        "good",
        ["changed", "1.90 -> 2.30 +- 0.10 N m"],
    ),
    (
        found(friction(), {"Fc2": (2.3, 0.1, "N m"), "change of Fc2": (-0.19, 0.1, "N m")}, changes=("Fc2",)),
        "good",
        ["not changed significantly", "2.49 -> 2.30 +- 0.10 N m"],
    ),
    (
        found(friction(), FRICTION, equivalent=["viscous_friction", "torque_offset"]),
        "look",
        ["1.90", "viscous friction", "torque offset"],
    ),
    (found(friction(), FRICTION, probability=0.72), "look", ["1.90", "72 %", "under 1 %"]),
    (found(DRIFT, OWN | {"Fc2": (-0.3, 0.5, "N m"), "change of Fc2": (-1.8, 0.5, "N m")}), "look", ["negative"]),
    (
        found(DRIFT, OWN | {"Fc2": (7.3, 0.5, "N m"), "change of Fc2": (-1.8, 0.5, "N m")}),
        "good",
        ["Joint 2", "9.1 -> 7.3 +- 0.5 N m", "0.80 +- 0.20 N m", "300 s"],
    ),
    (PAYLOAD, "good", ["2.80 +- 0.04 kg", "xx 0.0050 +- 0.0020", "yy 0.0070 +- 0.0010", "xz 0.00040 +- 0.00010"]),
]


def test_a_found_effect_is_reported_with_its_numbers():
    for added, state, says in FOUND:
        check = discrepancy_checks(make(added=(added,)))[0]
        assert check.state == state
        assert holds(check.message, *says), check.message
        assert state == "good" or "-1.8" not in check.message  # a negative friction is not reported as found


def test_indistinguishable_effects_have_a_motion_that_distinguishes_them():
    many = ["torque_offset", "viscous_friction", "delay", "hysteresis", "thermal_drift"]
    added = found(friction(), FRICTION, equivalent=many)
    check = discrepancy_checks(make(added=(added,)))[0]
    assert holds(check.remedy, CoulombFriction.shown_by, "bayesid excite --for")
    assert len(check.remedy.split()) < 40
    assert added_summary(added)["told_apart_by"]["torque_offset"] == TorqueOffset.shown_by
    error = found(make_effect("link_offset", {"joints": [2], "error": [0.0]}), {"d2": (0.0052, 1e-4, "m")})
    check = discrepancy_checks(make(added=(replace(error, elsewhere=(("link_offset", (3,)),)),)))[0]
    assert check.state == "look"
    assert holds(check.message, "5.20 +- 0.10 mm", "joint 3")


def test_a_found_effect_is_not_listed_as_untestable():
    result = make(not_testable=(("coulomb_friction", (2,)), ("coulomb_friction", (3,)), ("payload", ())))
    (check,) = checks_of(result, "Not testable")
    assert holds(check.message, "Coulomb friction in joint 3", "payload")
    assert "joint 2" not in check.message


def test_the_size_of_an_effect_is_reported():
    """Its size in joint 2, 2.25 of 45 N m."""
    result = make(added=(found(friction(), FRICTION, **WORTH),), identification=made_of(sliding=(3,)))
    assert holds(discrepancy_checks(result)[0].message, "2.25 N m", "5.0 %", "joint 2's rated effort")


def test_the_gap_is_reported_before_and_after_with_the_floor():
    assert holds(line(make(), "Gap"), "2.41", "0.312 N m", "joint 2", "0.300 N m")
    assert holds(line(make(identification=made_of(sliding=(2,))), "Gap"), "0.312 N in joint 2")
    sizes = {"before": np.arange(1.0, 6.0), "after": np.array([0.9, 1.1, 3.0, 0.5, 6.0]), "floor": floor_of(np.ones(5))}
    where = tuple(Excess(j, 1.0, "load", (0.0, 1.0)) for j in range(1, 6))
    gap = line(make(**sizes, where=where, identification=made_of(n=5)), "Gap")
    assert holds(gap, "5.00", "6.00", "joint 5", "4.00", "0.500", "joint 4", "3.00", "joint 3")


def test_unexplained_joints_are_reported_with_their_residual():
    result = make(status="unexplained", unexplained=((2, 5.24),), added=(), not_testable=())
    (check,) = discrepancy_checks(result)
    assert check.state == "bad"
    assert holds(check.message, "Joint 2", "5.2", "velocity (-1.2 to 0.75 rad/s)")
    assert holds(line(result, "Remaining"), "1.5 N m", "joint 2")
    assert "residual of joint 2" in line(result, "Next")


def test_the_data_that_show_an_unexplained_joint_are_reported():
    changes = {**NOTHING, "status": "unexplained", "after": np.array([0.292, 0.312, 0.496])}
    for says in (("held-back data",), ("log", "held-back data"), ("gap grew on held-back data",)):
        ratio = 2.3 if len(says) > 1 else 1.6  # on the log, where held-back data have their own
        result = make(**changes, unexplained=((3, ratio),), unexplained_on={3: says})
        (check,) = discrepancy_checks(result)
        grown = "gap grew on held-back data" in says
        assert holds(check.message, "Joint 3", *(("0.313", "0.496 N m") if grown else ("1.6",)))
        assert ("0.39 N m" in line(result, "Remaining")) != grown, "0.31 N m times the root of 1.6 squared less one"


def test_sizes_are_of_the_held_back_data_and_the_largest_comes_first():
    """Joint 3 has the larger ratio to its floor, joint 2 the larger excess; sizes on the log are others."""
    where = Excess(2, 9.9, "load", (0.0, 1.0)), Excess(3, 8.8, "load", (0.0, 1.0))
    before, floor = np.array([0.292, 5.0, 1.3]), floor_of(np.array([0.29, 3.0, 0.5]))
    result = make(status="unexplained", added=(), where=where, before=before, floor=floor, unexplained=((2, 1.5),))
    assert holds(line(result, "Size"), "4.00 N m", "joint 2", "holdout")


def test_without_missing_effects_the_worst_joint_is_reported():
    result = make(status="no_discrepancy", **NOTHING, before=np.array([0.292, 0.312, 0.313]))
    assert discrepancy_checks(result) == ()
    assert [one.name for one in in_brief(result)] == ["Missing", "Gap", "Remaining", "Next"]
    assert {one.state for one in in_brief(result)} == {"good"}
    assert line(result, "Missing") == "nothing"
    assert holds(line(result, "Remaining"), "1.04", "0.312 N m", "joint 2")
    moved = make(status="no_discrepancy", added=(), holdout="stretches 3 and 6 of 8 of log.csv")
    assert holds(line(moved, "Missing"), "no effect", "joint 2")
    assert holds(line(moved, "Gap"), "2.41", "0.312 N m", "0.300")


def test_a_floor_that_is_a_models_error_needs_attention():
    rms = np.array([0.29, 0.30, 0.31])
    floor = floor_of(rms, "earlier model's residual", mostly_coloured=[0, 2], white=0.5)
    result = make(status="no_discrepancy", **NOTHING, floor=floor)
    (check,) = discrepancy_checks(result)
    assert check.state == "look"
    assert holds(check.message, "joints 1 and 3", "earlier model's error")
    assert holds(line(result, "Missing"), "above the noise floor")
    refit = floor_of(rms, "refit with standard effects", mostly_coloured=[1], white=0.5)
    (check,) = discrepancy_checks(replace(result, floor=refit))
    assert holds(check.message, "joint 2", "refitted model")


def partly_explained():
    """Joint 2 keeps 1.5 of 1.9 N m of excess; joint 3 had 0.9 and keeps 0.35."""
    changed = found(friction(1), {"Fc1": (7.3, 0.5, "N m"), "change of Fc1": (-1.8, 0.5, "N m")}, changes=("Fc1",))
    where = tuple(Excess(j, excess, "load", (0.0, 1.0)) for j, excess in ((1, 3.0), (2, 1.9), (3, 0.9)))
    left = (2, 5.1), (3, np.hypot(1.0, 0.35 / 0.31))
    return make(status="partly_explained", added=(PAYLOAD, changed), where=where, unexplained=left)


def test_found_effects_and_remaining_residual_come_first():
    result = partly_explained()
    assert holds(line(result, "Missing"), "payload of 2.80 +- 0.04 kg", "change of Coulomb friction", "joint 1")
    assert holds(line(result, "Remaining"), "1.5 N m in joint 2", "0.35 N m in joint 3")
    assert [(check.name, check.state) for check in discrepancy_checks(result)[:4]] == [
        ("Payload", "good"),
        ("Coulomb friction, joint 1", "good"),
        ("Unexplained", "bad"),
        ("Unexplained", "bad"),
    ]


def test_the_brief_has_five_lines():
    """Indistinguishable or impossible effects are not certain; the next step is a motion that distinguishes them."""
    worth = {"size": EffortSize(2, 1.5, 2.25, 45.0, "rated effort")}
    alike = found(friction(), FRICTION, equivalent=["torque_offset"], **worth)
    weak = [found(TorqueOffset(joints=(joint,))) for joint in (1, 2, 3)]
    impossible = found(DRIFT, OWN | {"Fc2": (-0.3, 0.5, "N m"), "change of Fc2": (-1.8, 0.5, "N m")})
    result = make(added=(impossible, PAYLOAD, weak[0], found(Delay(lag=(0.004,))), alike))
    lines = in_brief(result)
    assert [one.name for one in lines] == ["Missing", "Size", "Gap", "Remaining", "Next"]
    assert max(len(one.message.split()) for one in lines) <= 40
    assert lines[0].state == "look"
    message = lines[0].message
    assert message.startswith("Coulomb friction in joint 2 (or torque offset); ")
    assert "an effect similar to thermal drift in joint 2" in message
    assert holds(message, "torque offset in joint 1", "delay")
    assert holds(lines[1].message, "2.25 N m in joint 2", "5.0 %", "rated effort")
    assert ThermalDrift.shown_by in lines[4].message
    assert CoulombFriction.shown_by in line(make(added=(PAYLOAD, alike)), "Next")
    assert "extended model" in line(make(added=(PAYLOAD,)), "Next")


def test_a_changed_parameter_is_not_called_known():
    changed = found(friction(), {"Fc2": (2.3, 0.1, "N m"), "change of Fc2": (0.4, 0.1, "N m")}, changes=("Fc2",))
    known = (("coulomb_friction", (2,)), ("coulomb_friction", (3,)))
    (check,) = checks_of(make(added=(changed,), preexisting=known), "In both logs")
    assert "joint 3" in check.message
    assert "joint 2" not in check.message
    assert checks_of(make(added=(changed,), preexisting=known[:1]), "In both logs") == []


def numbers_of(kind):
    """Names, without joints, that a form's numbers have in a result."""
    named = {number.name or key for key, number in kind.number_fields().items() if number.unit}
    if issubclass(kind, effects.Distortion):
        own = {"base_tilt": {"tilt1", "tilt2"}, "delay": {"lag"}}
        return {kind.symbol} if kind.of_table else own.get(kind.name, named)
    if issubclass(kind, effects.ActuatorTerm):
        return {one.symbol.rstrip("_") for one in kind.coefficients} | named
    if kind is LearnedEffect or kind.frees:  # its formula holds them; those of other terms
        return set()
    if kind is CarriedPayload:
        return {"m"}
    return {"mp"} if kind is Payload else {f"{kind.symbol}{axis}" for axis, _ in kind.parts}


def test_every_forms_sentence_holds_its_numbers():
    for name, kind in forms().items():
        if kind.phrase.sentence:
            braces = {field for _, field, _, _ in string.Formatter().parse(kind.phrase.sentence) if field}
            assert braces - {"who", "whose"} == numbers_of(kind), name
            assert forms()[name.split(".")[0]].phrase.noun
