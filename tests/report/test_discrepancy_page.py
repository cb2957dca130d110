"""The report of a discrepancy: words, figures and the page, of results made by hand."""

import re
import string
from dataclasses import fields, replace
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import smooth_motion
from matplotlib.colors import to_hex
from rich.console import Console

from bayesid.cli.discrepancy_tables import discrepancy_parts
from bayesid.discrepancy.compare import Excess, NoiseFloor, Trial
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.fit.effects.added_effect import AddedEffect
from bayesid.fit.effects.columns import Columns
from bayesid.fit.effects.explanation import LN10
from bayesid.fit.effects.hypotheses import Hypothesis
from bayesid.fit.effects.scores import Score
from bayesid.fit.effects.thresholds import Thresholds
from bayesid.fit.effects.worth import Cost, EffortSize
from bayesid.log.signals import Signals
from bayesid.model import distortions, terms
from bayesid.model.catalogue import forms, make_effect
from bayesid.model.distortions.base_tilt import BaseTilt
from bayesid.model.distortions.delay import Delay
from bayesid.model.distortions.gain_error import GainError
from bayesid.model.terms.cable_drag import CableDrag
from bayesid.model.terms.coulomb_friction import CoulombFriction
from bayesid.model.terms.hysteresis import Hysteresis
from bayesid.model.terms.learned_effect import LearnedEffect
from bayesid.model.terms.payload import CarriedPayload, Payload
from bayesid.model.terms.thermal_drift import ThermalDrift
from bayesid.model.terms.torque_offset import TorqueOffset
from bayesid.report.discrepancy_verdicts import discrepancy_checks, lead
from bayesid.report.pages.discrepancy_page import discrepancy_page
from bayesid.report.pages.rendering import typeset
from bayesid.report.plot.discrepancy import (
    AFTER,
    BEFORE,
    INK,
    candidate_figure,
    effort_figure,
    gap_figure,
    residual_figure,
)
from bayesid.report.plot.paper import Paper
from bayesid.report.thinning import binned
from bayesid.report.words import joints_in_words, label, listed, quantity, rounded
from bayesid.results.discrepancy_json import discrepancy_summary

N_JOINTS, COULOMB, NOISE = 3, 1.9, 0.3
EMPTY = Columns({}, {}, np.zeros(0), np.zeros(0, dtype=bool))
VOID = {"tags": {"meta", "br"}, "svg": {"path", "use", "image", "rect"}}


def hypothesis(source, changes=()):
    return Hypothesis(source, EMPTY, lambda other: hypothesis(other), changes)


def found(source, parameters=None, changes=(), equivalent=(), probability=0.99, rivals=(), **more):
    what, alike = hypothesis(source, changes), tuple(equivalent)
    return AddedEffect(what, 40.0 * LN10, probability, 0.004, 0.006, rivals, alike, parameters=parameters or {}, **more)


def score(source, log10, **more):
    return Score(hypothesis(source), log10 * LN10, 9.0, **more)


def friction(joint=2):
    return CoulombFriction(joints=(joint,), smoothing=(0.05,))


def make_trial():
    """A log without signs; joint 2 has Coulomb friction that its model lacks."""
    motion, rng = smooth_motion(N_JOINTS, 20.0, 100.0, seed=3), np.random.default_rng(4)
    before = 5.0 * np.sin(motion.q) + 8.0
    after = before.copy()
    after[:, 1] += COULOMB * np.tanh(motion.dq[:, 1] / 0.05)
    effort = np.abs(after + NOISE * rng.standard_normal(after.shape))
    everywhere = np.ones(effort.shape, dtype=bool)
    signals = Signals(motion, effort, effort, np.zeros(N_JOINTS, dtype=bool), 100.0, 8.0, {}, everywhere)
    used = everywhere.copy()
    used[:50] = False
    return Trial(signals, motion, used), before, after


def make_robot(sliding=()):
    joints = [SimpleNamespace(prismatic=j in sliding) for j in range(1, N_JOINTS + 1)]
    return SimpleNamespace(name="arm <A&B>", joints=joints)


FLOOR_IS_SHARP = np.array([True, True, False])
TRIAL, PREDICTED_BEFORE, PREDICTED_AFTER = make_trial()
FRICTION = {"Fc2": (COULOMB, 0.1, "N m")}


def floor_of(rms, origin="repeated periods", lasting=(), white=0.9):
    """Of joints, those of some (0-based) most of which lasts."""
    which = np.isin(np.arange(len(rms)), lasting)
    limits, every = np.stack([rms, rms], axis=1), np.ones(len(rms), dtype=bool)
    return NoiseFloor(rms, (origin,) * len(rms), limits, every, white * rms, which)


def make(**changes):
    """A result in which joint 2 lacked Coulomb friction."""
    values = {
        "status": "explained",
        "where": (Excess(2, 1.87, "velocity", (-1.25, 0.75)),),
        "added": (found(friction(), FRICTION),),
        "sets": (),
        "before": np.array([0.292, 2.41, 0.313]),
        "after": np.array([0.291, 0.312, 0.312]),
        "floor": replace(floor_of(np.array([0.29, 0.30, 0.31])), sharp=np.array([True, True, False])),
        "holdout": "later <b>.csv",
        "unexplained": (),
        "scores": (
            score(friction(), 40.25, improvement=30.0, mean_square=np.ones(3)),
            score(TorqueOffset(joints=(2,)), 1.5),
            score(Payload(), -0.75),
        ),
        "refused": (found(TorqueOffset(joints=(3,)), {}),),
        "not_testable": (("hysteresis", (1,)), ("hysteresis", (2,)), ("hysteresis", (3,)), ("payload", ())),
        "identification": SimpleNamespace(
            model=SimpleNamespace(robot=make_robot()), log=SimpleNamespace(source='log "1" & <2>.csv')
        ),
        "trial": TRIAL,
        "predicted_before": PREDICTED_BEFORE,
        "predicted_after": PREDICTED_AFTER,
        "warnings": ("beware of <script>alert(1)</script>",),
        "thresholds": Thresholds(),
        "seconds": 1.0,
    }
    values["unexplained_on"] = {joint: ("log",) for joint, _ in changes.get("unexplained", ())}
    return Discrepancy(**{**{one.name: values.get(one.name) for one in fields(Discrepancy)}, **changes})


def table_text(parts):
    """What a terminal of 200 columns shows."""
    with (console := Console(width=200)).capture() as caught:
        console.print(*parts, sep="\n")
    return caught.get()


def paragraph(result):
    """All verdicts, one after the other; where nothing was found, the sentence that leads them first."""
    first = [] if result.added else [lead(result)]
    return " ".join([*first, *(f"{check.message}." for check in discrepancy_checks(result))])


NOTHING = {"added": (), "where": (), "refused": (), "not_testable": (), "warnings": ()}


# --- Words -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("value", "sd", "unit", "told"),
    [
        (1.9, 0.1, "N m", "1.90 +- 0.10 N m"),
        (1.9, 0.31, "N m", "1.9 +- 0.3 N m"),
        (1.9, np.nan, "N m", "1.90 N m"),
        (-0.0431, 0.00096, "rad", "-0.043 +- 0.001 rad"),
        (123.4, 20.0, "", "123 +- 20"),
        (2.5e-6, 1.2e-7, "kg m^2", "(2.50 +- 0.12)e-6 kg m^2"),
        (0.0, 0.02, "N m", "0.00 +- 0.02 N m"),
        (np.nan, np.nan, "N m", "unknown N m"),
        (3.0, 0.0, "s", "3.00 s"),
    ],
)
def test_quantities_are_told_to_the_digits_that_are_known(value, sd, unit, told):
    assert quantity(value, sd, unit) == told


@pytest.mark.parametrize(
    ("value", "told"),
    [(0.3, "0.300"), (2.4, "2.40"), (0.09999, "0.100"), (123.4, "123"), (0.0, "0.00"), (2e-7, "2.00e-07")],
)
def test_numbers_keep_three_digits(value, told):
    assert rounded(value) == told


def test_lists_are_read_aloud():
    assert joints_in_words([3]) == "joint 3"
    assert joints_in_words([5, 1, 2, 3]) == "joints 1 to 3 and 5"
    assert joints_in_words([1, 2, 4]) == "joints 1, 2 and 4"
    assert listed(["a", "b", "c"], "or") == "a, b or c"
    assert label("gain_error", (2,)) == "gain error, joint 2"


def test_what_was_found_is_told_with_its_size_and_what_it_explains():
    said = paragraph(make())
    assert said.startswith(
        "Joint 2 needs Coulomb friction of 1.90 +- 0.10 N m. With it the gap on the holdout falls from 2.41 to 0.312 "
        "N m in joint 2, the noise floor being 0.300 N m."
    )
    assert said.endswith(
        "Even of a usual size this log could not show presliding hysteresis in joints 1 to 3; a payload."
    )
    assert "unexplained" not in said


def test_nothing_missing_is_said_plainly():
    said = paragraph(
        make(
            status="no_discrepancy",
            **NOTHING,
            after=np.array([0.292, 0.301, 0.313]),
            before=np.array([0.292, 0.312, 0.313]),
        )
    )
    assert said == (
        "Nothing is missing: the model explains this log as it is. On the holdout it leaves 1.04 times the noise floor "
        "in joint 2 (0.312 N m, the floor being 0.300 N m), and no more than that in any other."
    )


def test_parameters_that_moved_without_an_effect_are_said():
    said = paragraph(make(status="no_discrepancy", added=(), holdout="stretches 3 and 6 of 8 of log.csv"))
    assert said.startswith("No effect is missing from the model, but its parameters do not quite fit joint 2")
    assert "on the stretches held back falls from 2.41 to 0.312 N m in joint 2 (noise floor 0.300)" in said


def test_joints_that_stay_unexplained_are_named():
    said = paragraph(make(status="unexplained", unexplained=((2, 5.24),), added=(), not_testable=()))
    assert said == (
        "Something is missing from the model, but no effect of the catalogue explains it. Joint 2 keeps 1.5 N m above "
        "the noise that nothing explains. Joint 2 stays unexplained: what is left there is 5.2 times the noise floor, "
        "and it shows best over velocity (-1.2 to 0.75 rad/s)."
    )


@pytest.mark.parametrize(
    ("says", "told"),
    [
        (("held-back data",), "on the holdout is 1.6 times the noise floor."),
        (("log", "held-back data"), "what is left there is 1.6 times the noise floor."),
        (("gap grew on held-back data",), "identified again, its gap on the holdout rises from 0.313 to 0.496 N m."),
        (
            ("log", "gap grew on held-back data"),
            "1.6 times the noise floor; identified again, its gap on the holdout rises from 0.313 to 0.496 N m.",
        ),
    ],
)
def test_which_data_say_that_a_joint_is_unexplained_is_said(says, told):
    after = np.array([0.292, 0.312, 0.496])
    changes = {**NOTHING, "status": "unexplained", "unexplained": ((3, 1.6),), "after": after}
    result = make(**changes, unexplained_on={3: says})
    said = paragraph(result)
    assert said.startswith("Something is missing from the model, but no effect of the catalogue explains it. Joint 3 ")
    assert said.endswith(told)
    (remark,) = [row[7] for row in page_of(result)[0].table("Gap on later")[1:] if row[7]]
    assert remark == [1.6]


def test_a_floor_that_is_a_models_own_error_is_called_so():
    floor = floor_of(np.array([0.29, 0.30, 0.31]), "earlier model's residual", lasting=[0, 2], white=0.5)
    result = make(status="no_discrepancy", **NOTHING, floor=floor)
    said = paragraph(result)
    assert "Nothing is missing above the noise floor: " in paragraph(
        replace(result, before=np.array([0.292, 0.312, 0.313]))
    )
    assert said.endswith(
        "In joints 1 and 3 the noise floor is the earlier model's own error, or noise that lasts: only 0.145 of 0.290 "
        "N m in joint 1 and 0.155 of 0.310 N m in joint 3 change from sample to sample; what is below the floor may "
        "still be wrong."
    )
    page, text = page_of(result)
    assert text.count("most of it lasts") == 2
    assert [row[4] for row in page.table("Gap on later")[1:]] == [[0.5 * rms] for rms in floor.rms]
    assert "Nothing is missing above the noise floor" in text
    refit = floor_of(np.ones(3), "refit with standard effects", lasting=[1], white=0.5)
    assert "In joint 2 the noise floor is the refitted model's own error" in paragraph(replace(result, floor=refit))


def test_what_was_found_is_told_apart_from_what_was_not():
    where = (Excess(1, 0.5, "load", (0.0, 1.0)), Excess(2, 1.8, "velocity", (0.0, 1.0)))
    said = paragraph(make(status="unexplained", unexplained=((1, 3.0),), where=where))
    assert "falls from 2.41 to 0.312 N m in joint 2, the noise floor" in said
    assert "Joint 1 stays unexplained: what is left there is 3.0 times the noise floor" in said
    assert "no effect of the catalogue" not in said


def test_of_many_joints_the_worst_are_told():
    many = dict.fromkeys(("before", "after"), np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    floor = floor_of(np.ones(5))
    robot = SimpleNamespace(name="r", joints=[SimpleNamespace(prismatic=False)] * 5)
    model = SimpleNamespace(model=SimpleNamespace(robot=robot), log=SimpleNamespace(source="x"))
    where = tuple(Excess(j, 1.0, "load", (0.0, 1.0)) for j in range(1, 6))
    many["after"] = np.array([0.9, 1.1, 3.0, 0.5, 6.0])
    said = paragraph(make(**many, floor=floor, where=where, identification=model))
    assert "the holdout rises from 5.00 to 6.00 N m in joint 5 (noise floor 1.00), falls from 4.00 to 0.500 N m" in said
    assert (
        "and stays at 3.00 N m in joint 3 (noise floor 1.00); in joints 1 and 2 it ends at 1.10 times the floor" in said
    )


def test_changes_of_what_the_model_had_are_told_as_changes():
    parameters = {"Fc2": (2.3, 0.1, "N m"), "change of Fc2": (0.4, 0.1, "N m")}
    said = paragraph(make(added=(found(friction(), parameters, changes=("Fc2",)),)))
    assert said.startswith("Joint 2's Coulomb friction has changed: 1.90 -> 2.30 +- 0.10 N m.")
    parameters = {"Fc2": (2.3, 0.1, "N m"), "change of Fc2": (-0.19, 0.1, "N m")}
    said = paragraph(make(added=(found(friction(), parameters, changes=("Fc2",)),)))
    assert said.startswith(
        "Joint 2's Coulomb friction was free to change, and has not surely done so (2.49 -> 2.30 +- "
    )
    assert "has changed" not in said
    sizes = ("", 2.5), ("change of ", -0.5)
    body = {f"{sign}{name}p3": (value, np.nan, "kg") for sign, value in sizes for name in ("Jxx", "mcx", "m")}
    said = paragraph(make(added=(found(Payload(), body, changes=("mp3",)),)))
    assert said.startswith("The payload has changed: 3.00 -> 2.50 kg.")


@pytest.mark.parametrize(
    ("source", "parameters", "told"),
    [
        (Payload(), {"Jxxp3": (1e-4, 1e-5, "kg m^2"), "mp3": (2.5, 0.04, "kg")}, "a payload of 2.50 +- 0.04 kg"),
        (
            BaseTilt(angle=(0.02, -0.01)),
            {"tilt1": (np.deg2rad(1.5), np.deg2rad(0.02), "rad"), "tilt2": (np.deg2rad(-0.5), np.nan, "rad")},
            "The base is tilted by 1.50 +- 0.02 degrees and -0.500 degrees",
        ),
        (Delay(lag=(0.004,)), {"lag": (0.004, 0.0003, "s")}, "All joints' efforts lag 4.0 +- 0.3 ms behind the motion"),
        (Delay(joints=(2,), lag=(0.0,)), {"lag2": (-0.004, 0.0003, "s")}, "Joint 2's efforts come 4.0 +- 0.3 ms ahead"),
        (GainError(joints=(1,), gain=(1.1,)), {"gain1": (1.1, 0.02, "1")}, "efforts read 10 +- 2 % too large."),
        (GainError(joints=(1,), gain=(0.9,)), {"gain1": (0.9, 0.02, "1")}, "efforts read 10 +- 2 % too small."),
    ],
)
def test_people_hear_degrees_milliseconds_and_percent(source, parameters, told):
    assert told in paragraph(make(added=(found(source, parameters),)))


@pytest.mark.parametrize(("side", "told"), [(1.0, "beyond"), (-1.0, "below")])
def test_a_cable_pulls_on_its_side(side, told):
    cable = CableDrag(joints=(2,), start=(0.5,), side=(side,))
    numbers = {"kd2": (0.05, 0.001, "N m/rad"), "start2": (0.5, np.nan, "rad")}
    said = paragraph(make(added=(found(cable, numbers),)))
    assert said.startswith(f"Joint 2 needs a cable that pulls with 0.0500 +- 0.0010 N m/rad {told} 0.500 rad.")


def test_without_numbers_the_effect_is_still_named():
    assert paragraph(make(added=(found(friction()),))).startswith("Joint 2 needs Coulomb friction. With it")
    assert paragraph(make(added=(found(Payload()),))).startswith("The robot needs a payload. With it")
    other = found(friction(), {"F2": (1.0, np.nan, "N m")})
    assert paragraph(make(added=(other,))).startswith("Joint 2 needs Coulomb friction (F = 1.00 N m).")
    both = found(CoulombFriction(joints=(1, 2), smoothing=(0.1, 0.1)))
    assert paragraph(make(added=(both,))).startswith("Joints 1 and 2 need Coulomb friction.")
    changed = paragraph(make(added=(found(friction(), changes=("Fc2",)),)))
    assert changed.startswith("Joint 2's Coulomb friction has changed. With it")


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


def test_a_payload_is_told_with_the_inertia_about_its_centre_of_mass():
    payload = found(Payload(), {"mp3": (2.8, 0.04, "kg")}, readable=BODY)
    assert (
        "Its inertia about that, along this frame's axes, is xx 0.005 +- 0.002 kg m^2, yy 0.0070 +- 0.0010 kg m^2, "
        "zz 0.009 +- 0.003 kg m^2, xy -0.0012 +- 0.0003 kg m^2, xz 0.00040 +- 0.00010 kg m^2, "
        "yz 0.0003 +- 0.0002 kg m^2."
    ) in paragraph(make(added=(payload,)))


def test_what_an_effect_is_worth_is_told():
    """Its size in joint 2, 2.25 of 45 N m; its cost in joint 3, 3.2 and 0.5 of 40 N."""
    identification = SimpleNamespace(
        model=SimpleNamespace(robot=make_robot(sliding=(3,))), log=SimpleNamespace(source="log.csv")
    )
    result = make(added=(found(friction(), FRICTION, **WORTH),), identification=identification)
    assert paragraph(result).startswith(
        "Joint 2 needs Coulomb friction of 1.90 +- 0.10 N m. Its own effort is at most 2.25 N m, 5.0 % of 45.0 N m, "
        "joint 2's rated effort (RMS 1.50 N m). Ignored, it costs 3.20 N on the holdout (8.0 % of joint 3's RMS "
        "effort); with it 0.500 N (1.2 %) is left."
    )
    (row,) = page_of(result)[0].table("What each is worth")[1:]
    assert row[2:] == [[2.25], [1.5], [0.05], [3.2], [0.08], [0.5], [0.0125]]
    printed = table_text(discrepancy_parts(result))
    assert "3.20 -> 0.500 N (8.0 -> 1.2 %) in joint 3" in printed
    told = discrepancy_summary(replace(result, unexplained_on={}, all_along=(), floor=make().floor))["found"][0]
    assert told["effort"] == {"joint": 2, "rms": 1.5, "largest": 2.25, "percent": 5.0, "of": "rated effort"}
    cost = {"joint": 3, "before": 3.2, "after": 0.5, "percent_before": 8.0, "percent_after": 1.25}
    assert told["cost_if_ignored"] == pytest.approx(cost)


def test_where_nothing_stands_out_on_the_log_it_is_said_what_shows_it():
    texts = [
        page_of(make(where=(), **changes))[1]
        for changes in ({}, {"added": (), "status": "unexplained", "unexplained": ((3, 1.6),)}, {"added": ()})
    ]
    assert "could not: on the log the gap alone would not show that anything is missing. What was added" in texts[0]
    assert "could not. It is the data that score that show that something is missing" in texts[1]
    assert "could not.</p>" in texts[2]


def test_where_all_is_explained_the_lead_says_what_remains():
    """Joint 3 is the worst by its floor, joint 1 by N m."""
    floor = make().floor
    after = np.array([1.02, 1.01, 1.17]) * floor.rms
    payload = replace(found(Payload(), {"mp3": (2.8, 0.04, "kg")}), readable=BODY)
    result = make(added=(payload,), where=(Excess(1, 3.0, "load", (0.0, 1.0)),), unexplained=(), after=after)
    assert lead(result).endswith(
        "It explains what showed in joint 1; what remains is at most 1.17 times the noise floor "
        f"({after[2]:.3g} N m in joint 3)."
    )


def test_what_was_found_and_what_is_left_leads():
    """Joint 2 keeps 1.5 of 1.9 N m of excess: not most of it is explained; joint 3 had 0.9 and keeps 0.35."""
    payload = replace(found(Payload(), {"mp3": (2.8, 0.04, "kg")}), readable=BODY)
    changed = found(friction(1), {"Fc1": (7.3, 0.5, "N m"), "change of Fc1": (-1.8, 0.5, "N m")}, changes=("Fc1",))
    where = tuple(Excess(j, excess, "load", (0.0, 1.0)) for j, excess in ((1, 3.0), (2, 1.9), (3, 0.9)))
    result = make(
        status="partly_explained",
        added=(payload, changed),
        where=where,
        unexplained=((2, 5.1), (3, np.hypot(1.0, 0.35 / 0.31))),
    )
    assert lead(result) == (
        "Found: a payload of 2.80 kg at (0.030, -0.200, 0.1104) m in the last link's frame; changed Coulomb friction "
        "in joint 1. Together they explain what showed in joint 1 and most of what showed in joint 3; joint 2 keeps "
        "1.5 N m above the noise that nothing explains; joint 3 keeps 0.35 N m above the noise that nothing explains."
    )
    states = [(check.name, check.state) for check in discrepancy_checks(result)]
    assert states[:5] == [
        ("Payload", "good"),
        ("Coulomb friction, joint 1", "good"),
        ("Gap", "good"),
        ("What is left", "bad"),
        ("What is left", "bad"),
    ]
    page, text = page_of(result)
    assert '<p class="status partly_explained">Partly explained: ' in text
    assert page.table("Effects that were added")[1][2] == [value for value, _, _ in BODY.values()]
    assert page.table("Effects that were added")[2][2] == [7.3]
    assert "9.1&nbsp;&rarr;&nbsp;7.3&nbsp;&plusmn;&nbsp;0.5 N&nbsp;m" in text
    assert "mp3" not in text


def test_friction_that_adds_to_the_earlier_models_is_told_before_and_now():
    """Of a drift from -1.8 N m on; what would be negative altogether is not told as found."""
    drift = ThermalDrift(joints=(2,), smoothing=(0.05,), time=(300.0,))
    own = {"Fcold2": (-1.8, 0.5, "N m"), "Fwarm2": (0.8, 0.2, "N m"), "time2": (300.0, np.nan, "s")}
    total = {"Fc2": (7.3, 0.5, "N m"), "change of Fc2": (-1.8, 0.5, "N m")}
    result = make(added=(found(drift, own | total),))
    said = (
        "Joint 2 needs dry friction of 9.1 -> 7.3 +- 0.5 N m that changes by 0.8 +- 0.2 N m as it warms up, over 300 s"
    )
    assert discrepancy_checks(result)[0].message == said
    page, text = page_of(result)
    assert sorted(page.table("Effects that were added")[1][2]) == [0.8, 7.3, 300.0]
    impossible = make(added=(found(drift, own | {"Fc2": (-0.3, 0.5, "N m"), "change of Fc2": (-1.8, 0.5, "N m")}),))
    for result in (impossible, make(added=(found(drift, own),))):
        (check, *_) = discrepancy_checks(result)
        assert check.state == "look"
        assert check.message.startswith("by itself it would make the Coulomb friction of joint 2 negative")
        assert "1.8" not in check.message


def test_what_became_of_each_candidate_is_told():
    """What was added is listed however poor it was by itself."""
    drift = Hysteresis(joints=(2,), width=(0.01,))
    scores = (
        *(score(TorqueOffset(joints=(1,)), gain) for gain in range(10, 40)),
        score(friction(), 9.0),
        score(drift, -2.0),
        score(TorqueOffset(joints=(3,)), 50.0),
        score(Payload(), 45.0),
    )
    result = make(added=(found(friction(), FRICTION), found(drift, {})), scores=scores)
    page, text = page_of(result)
    rows = re.findall(
        r'<tr><th scope="row">(\d+)</th><td>([^<]+)</td><td>[^<]+</td><td>.*?</td><td>([^<]+)</td></tr>', text
    )
    assert rows[0] == ("1", "torque offset", "left out: see below")
    assert rows[1] == ("2", "payload", "not needed, given those that were added")
    assert rows[-2:] == [("33", "Coulomb friction", "added first"), ("34", "presliding hysteresis", "added second")]
    assert len(page.table("The best 25 of 34")) == 1 + 25 + 2


def test_a_candidate_that_is_not_needed_is_held_against_what_took_its_place():
    """By itself it has 60; in the place of the friction 12.5 against 40, in that of the payload 3 against 40."""
    rivals = [(score(TorqueOffset(joints=(2,)), gain),) for gain in (3.0, 12.5)]
    added = (found(Payload(), {}, rivals=rivals[0]), found(friction(), FRICTION, rivals=rivals[1]))
    scores = (score(friction(), 40.25), score(TorqueOffset(joints=(2,)), 60.0))
    _, text = page_of(make(added=added, scores=scores))
    said = "not needed, given those that were added"
    assert f"<td>{said}: in place of Coulomb friction, joint 2, it has 12.5, that 40.0</td>" in text
    stronger = (found(friction(), FRICTION, rivals=(score(TorqueOffset(joints=(2,)), 41.0),)),)
    _, text = page_of(make(added=stronger, scores=scores))
    assert f"<td>{said}</td>" in text


def test_doubt_is_said():
    said = paragraph(make(added=(found(friction(), FRICTION, equivalent=["viscous_friction", "torque_offset"]),)))
    shown_by = (CoulombFriction.shown_by, terms.CATALOGUE["viscous_friction"].shown_by, TorqueOffset.shown_by)
    assert "cannot tell it from viscous friction or a torque offset." in said
    (verdict, *_) = discrepancy_checks(make(added=(found(friction(), FRICTION, equivalent=["torque_offset"]),)))
    assert (verdict.state, verdict.remedy) == ("look", f"{shown_by[0]}, or {shown_by[2]} would tell")
    said = paragraph(make(added=(found(friction(), FRICTION, probability=0.72),)))
    assert "The probability of this, the others given, is 72 %; that nothing is missing in its place, under 1 %" in said


def test_rows_of_the_table_that_look_alike_are_told_with_their_joints():
    error = found(make_effect("link_offset", {"joints": [2], "error": [0.0]}), {"d2": (0.0052, 1e-4, "m")})
    (verdict, *_) = discrepancy_checks(make(added=(replace(error, elsewhere=(("link_offset", (3,)),)),)))
    assert "sits 5.20 +- 0.10 mm further along its axis" in verdict.message
    assert verdict.message.endswith("cannot tell it from an error of a length d of the table (joint 3)")
    assert verdict.state == "look"


def test_sliding_joints_have_newtons():
    model = SimpleNamespace(model=SimpleNamespace(robot=make_robot(sliding=(2,))), log=SimpleNamespace(source="x"))
    said = paragraph(make(identification=model, unexplained=((2, 2.0),)))
    assert "0.312 N in joint 2" in said
    assert "m/s)" in said


def numbers_of(kind):
    """Names, without joints, that a form's numbers have in a result."""
    if issubclass(kind, distortions.Distortion):
        own = {"base_tilt": {"tilt1", "tilt2"}, "delay": {"lag"}, "gear_ratio": {"ratio"}}
        return {kind.symbol} if kind.of_table else own.get(kind.name, set(kind.shape_units))
        return {"base_tilt": {"tilt1", "tilt2"}, "delay": {"lag"}}.get(
            kind.name, set(kind.shape_units) or {kind.phrase.size}
        )
    if issubclass(kind, terms.ActuatorTerm):
        return {symbol.rstrip("_") for symbol in kind.symbols} | set(kind.shape_units)
    if kind is LearnedEffect:  # its formula holds them
        return set()
    if kind is CarriedPayload:
        return {"m"}
    return {"mp"} if kind is Payload else {f"{kind.symbol}{axis}" for axis, _ in kind.parts}


@pytest.mark.parametrize("name", sorted(name for name, kind in forms().items() if kind.phrase.sentence))
def test_sentences_hold_the_numbers_of_their_form(name):
    kind = forms()[name]
    braces = {field for _, field, _, _ in string.Formatter().parse(kind.phrase.sentence) if field}
    assert braces - {"who", "whose"} == numbers_of(kind)
    assert forms()[name.split(".")[0]].phrase.noun


# --- Figures ---------------------------------------------------------------------------------------------------------
def test_bins_hold_equally_many_samples():
    value = np.linspace(-1.0, 1.0, 2400)
    centre, mean, error = binned(value, np.where(np.arange(2400) % 2, 1.5, 0.5))
    assert len(centre) == 24
    np.testing.assert_allclose(np.diff(centre), np.ptp(value) / 2399 * 100, rtol=1e-9)
    np.testing.assert_allclose(mean, 1.0, rtol=1e-12)
    np.testing.assert_allclose(error, 0.5 * np.sqrt(100 / 99) / 10.0, rtol=1e-12)
    assert len(binned(value[:1], value[:1])[0]) == 0


def test_residuals_are_drawn_over_the_variable_that_shows_them():
    result = make()
    axes = residual_figure(result, 2).axes
    used = TRIAL.used[:, 1]
    speed = TRIAL.actuators.dq[used, 1]
    for ax, predicted in zip(axes, (PREDICTED_BEFORE, PREDICTED_AFTER), strict=True):
        points = np.asarray(ax.collections[0].get_offsets())
        assert len(points) == 1500
        assert ax.collections[0].get_rasterized()
        residual = (TRIAL.nearest(predicted) - predicted)[used, 1]
        order = np.argsort(speed)
        place = order[np.searchsorted(speed[order], points[:, 0])]
        np.testing.assert_allclose(residual[place], points[:, 1], rtol=1e-12)
        np.testing.assert_allclose(
            ax.containers[0].lines[0].get_xydata(), np.stack(binned(speed, residual)[:2], axis=1)
        )
        band = ax.patches[0].get_extents().transformed(ax.transData.inverted())
        np.testing.assert_allclose([band.y0, band.y1], [-0.30, 0.30], rtol=1e-9)
    means = [ax.containers[0].lines[0].get_ydata() for ax in axes]
    assert means[0].max() > 0.8 * COULOMB
    assert means[0].min() < -0.8 * COULOMB
    assert np.abs(means[1]).max() < 0.5 * NOISE


def test_efforts_are_drawn_over_time():
    (ax,) = effort_figure(make(), 2).axes
    time = TRIAL.signals.motion.t - TRIAL.signals.motion.origin
    drawn = TRIAL.nearest(PREDICTED_AFTER), PREDICTED_BEFORE, PREDICTED_AFTER
    for line, effort in zip(ax.lines, drawn, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), np.stack([time, effort[:, 1]], axis=1))


def test_gaps_are_drawn_in_units_of_the_floor():
    result = make()
    (ax,) = gap_figure(result).axes
    widths = np.array([[bar.get_width() for bar in bars] for bars in ax.containers])
    np.testing.assert_allclose(widths * result.floor.rms, [result.before, result.after], rtol=1e-12)
    assert [text.get_text() for text in ax.texts] == [
        f"{rounded(gap)} N m" for gap in (*result.before.tolist(), *result.after.tolist())
    ]
    assert [line.get_xdata()[0] for line in ax.lines] == [1.0]


def test_candidates_are_drawn_best_first_and_at_most_twelve():
    more = [score(TorqueOffset(joints=(1,)), gain) for gain in np.arange(20.0, 32.0)]
    result = make(scores=(*make().scores, *more))
    (ax,) = candidate_figure(result).axes
    bars = ax.containers[0]
    np.testing.assert_allclose([bar.get_width() for bar in bars], [40.25, *np.arange(31.0, 20.0, -1.0)], rtol=1e-12)
    assert [to_hex(bar.get_facecolor()) for bar in bars] == [AFTER, *[INK] * 11]
    assert ax.lines[0].get_xdata()[0] == 2.0
    assert to_hex(ax.lines[0].get_color()) == BEFORE
    assert ax.get_yticklabels()[0].get_text() == "Coulomb friction, joint 2"


def test_no_candidates_make_an_empty_figure():
    assert not candidate_figure(make(scores=())).axes[0].containers[0].patches


def test_an_inline_figure_takes_the_ink_of_its_page_and_holds_all_it_shows():
    svg = gap_figure(make(), Paper).svg("gap", 'a "gap" <1>')
    assert svg.startswith('<svg role="img" aria-label="a &quot;gap&quot; &lt;1&gt;" viewBox="0 0 ')
    assert svg.endswith("</svg>")
    assert "currentColor" in svg
    assert "<text" in svg
    assert not re.search(f"{INK}|font-family|<style|<metadata|<!--|http", svg)
    identifiers = re.findall(r'\bid="([^"]*)"', svg)
    assert len(set(identifiers)) == len(identifiers)
    assert all(one.startswith("gap-") for one in identifiers)
    assert set(re.findall(r'(?:url\(|href=")#([^")]*)', svg)) <= set(identifiers)
    assert svg == gap_figure(make(), Paper).svg("gap", 'a "gap" <1>')


def test_curves_of_long_logs_are_drawn_by_their_extremes(monkeypatch):
    whole = effort_figure(make(), 1).axes[0].lines
    monkeypatch.setattr("bayesid.report.plot.discrepancy._CURVE", 100)
    for line, full in zip(effort_figure(make(), 1).axes[0].lines, whole, strict=True):
        assert len(line.get_ydata()) <= 102 < len(full.get_ydata())
        assert line.get_ydata().min() == full.get_ydata().min()
        assert line.get_ydata().max() == full.get_ydata().max()


# --- The page --------------------------------------------------------------------------------------------------------
class Page(HTMLParser):
    """Checks that tags are balanced; keeps the numbers of tables by their captions, references and labels."""

    def __init__(self, text):
        super().__init__()
        self.open, self.references, self.identifiers, self.tags = [], [], [], []
        self.tables, self.captions, self.labels = [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.tags.append(tag)
        self.references += [attributes[key] for key in ("href", "src", "xlink:href", "action") if key in attributes]
        self.identifiers += [attributes["id"]] if "id" in attributes else []
        if tag == "table":
            self.tables.append([])
            self.captions.append("")
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append([])
        if tag == "data":
            self.tables[-1][-1][-1].append(float(attributes["value"]))
        if tag == "svg":
            self.labels.append(attributes["aria-label"])
        if tag not in VOID["tags"]:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        assert tag in VOID["svg"] | VOID["tags"] | {"g", "defs"}, tag
        self.handle_starttag(tag, attributes)
        if tag not in VOID["tags"]:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "caption":
            self.captions[-1] += data

    def table(self, words):
        """The table (rows of cells of numbers) whose caption begins so."""
        return next(t for t, text in zip(self.tables, self.captions, strict=True) if text.startswith(words))


def page_of(result):
    text = discrepancy_page(result)
    return Page(text), text


STATUSES = {
    "explained": {},
    "partly_explained": {"status": "partly_explained", "unexplained": ((3, 1.5),)},
    "unexplained": {"status": "unexplained", "unexplained": ((2, 5.24),), "added": ()},
    "no_discrepancy": {"status": "no_discrepancy", **NOTHING},
    "bare": {"status": "no_discrepancy", **NOTHING, "scores": ()},
}


@pytest.mark.parametrize("status", STATUSES)
def test_the_page_is_whole_and_needs_nothing_else(status):
    page, text = page_of(make(**STATUSES[status]))
    assert all(one.startswith(("#", "data:image/png;base64,")) for one in page.references)
    assert "http" not in text
    assert "@import" not in text
    assert "script" not in page.tags
    assert len(set(page.identifiers)) == len(page.identifiers)
    assert text.count("<table") == text.count("<caption>") == len(page.tables)
    assert all(page.labels)
    assert all(page.captions)
    assert page.tags.count("svg") == page.tags.count("figure") == page.tags.count("figcaption")
    assert len(text.encode()) < 1_000_000
    assert page.tags.count("h1") == page.tags.count("main") == 1
    assert text == discrepancy_page(make(**STATUSES[status]))


def test_the_page_holds_the_numbers_of_the_result():
    result = make(unexplained=((3, 1.7),))
    page, text = page_of(result)
    gap = page.table("Gap on later")[1:]
    for j, row in enumerate(gap):
        ratio, white = result.after[j] / result.floor.rms[j], result.floor.white[j]
        assert row[1:6] == [[result.before[j]], [result.after[j]], [result.floor.rms[j]], [white], [ratio]]
    assert gap[2][7] == [1.7]
    assert "(a lower bound)" in text
    (verdict,) = page.table("Effects that were added")[1:]
    assert verdict[2:7] == [[COULOMB], [pytest.approx(40.0)], [0.99], [0.004], [0.006]]
    (where,) = page.table("Joints in which")[1:]
    assert where[1] == [1.87]
    assert where[3] == [-1.25, 0.75]
    candidates = page.table("The best 3 of 3")[1:]
    assert [row[3] for row in candidates] == [[pytest.approx(gain)] for gain in (40.25, 1.5, -0.75)]
    assert "torque offset" in text
    assert typeset(lead(result)) in text
    assert all(typeset(check.message) in text for check in discrepancy_checks(result))


def test_at_most_twenty_five_candidates_are_listed():
    page, _ = page_of(make(scores=tuple(score(TorqueOffset(joints=(1,)), gain) for gain in range(40))))
    rows = page.table("The best 25 of 40")[1:]
    assert [row[3][0] for row in rows] == pytest.approx(list(range(39, 14, -1)))


def test_what_was_left_out_and_what_cannot_be_tested_is_listed():
    _, text = page_of(make())
    assert "<li>torque offset, joint 3</li>" in text
    assert f'<th scope="row">presliding hysteresis</th><td>1 to 3</td><td>{Hysteresis.shown_by}</td>' in text
    assert '<th scope="row">payload</th><td>whole robot</td>' in text


def test_text_from_outside_is_escaped():
    page, text = page_of(make())
    for raw, escaped in (
        ("later <b>.csv", "later &lt;b&gt;.csv"),
        ('log "1" & <2>.csv', "log &#34;1&#34; &amp; &lt;2&gt;.csv"),
        ("arm <A&B>", "arm &lt;A&amp;B&gt;"),
        ("<script>alert(1)</script>", "&lt;script&gt;alert(1)&lt;/script&gt;"),
    ):
        assert raw not in text
        assert escaped in text
    assert "b" not in page.tags


def test_parameters_that_are_not_known_leave_no_gap_in_the_page():
    unknown = found(friction(), {"Fc2": (np.nan, np.nan, "N m")}, equivalent=["torque_offset"])
    page, text = page_of(make(added=(unknown, found(Payload()))))
    assert "unknown N&nbsp;m" in text
    assert TorqueOffset.shown_by in text
    assert page.table("Effects that were added")[2][2] == []


def test_plain_text_is_typeset():
    assert typeset("-1.2 +- 0.1 N m/rad^2 <a-1>") == (
        "&minus;1.2&nbsp;&plusmn;&nbsp;0.1 N&nbsp;m/rad&sup2; &lt;a-1&gt;"
    )
