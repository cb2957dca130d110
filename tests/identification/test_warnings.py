"""What a user is warned of, each sentence by itself; whole identifications that end in a warning."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.identification.other_readings import BetterReading
from bayesid.identification.pipeline import identify
from bayesid.identification.warnings import warnings_of
from bayesid.log.log import Log
from bayesid.log.low_pass import AfterRectifier, LowPass
from bayesid.signs.search.certified import Certified


def fit_with(relative=(0.1, 0.2), sd=(0.3, 0.5, 0.1), on_edge=(False, False, False), tolerance=1e-10):
    return SimpleNamespace(
        relative_residual=np.array(relative), sd=np.array(sd), on_edge=np.array(on_edge), tolerance=tolerance
    )


def signs_with(certified=True, lower_bound=90.0, unsplit=0, withheld=""):
    search = SimpleNamespace(certified=certified, lower_bound=lower_bound, cost=120.0, withheld=withheld)
    return SimpleNamespace(search=search, unsplit=unsplit, rounds=4)


def model_of(*names, notes=()):
    """Terms of all joints, or of some, as in "gravity_spring 7"."""
    effects = [
        SimpleNamespace(name=name, joints=tuple(map(int, joints))) for name, *joints in (text.split() for text in names)
    ]
    model = SimpleNamespace(terms=effects, effects=effects, robot=SimpleNamespace(notes=notes))
    return SimpleNamespace(model=model, evidence=read_through(None))


def read_through(low_pass):
    """Evidence of a log whose |effort| has passed a low-pass."""
    after = low_pass and AfterRectifier(low_pass, np.zeros((1, 2)), np.zeros(2))
    motion = SimpleNamespace(t=np.arange(2.0), q=np.eye(2))
    return SimpleNamespace(signals=SimpleNamespace(after_rectifier=after, faults=(), motion=motion))


@dataclass
class Averaged:
    """Signs by the model asked for, nothing wrong with them."""

    fit: SimpleNamespace = field(default_factory=fit_with)
    settled: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(signs=signs_with()))
    asked: SimpleNamespace = field(default_factory=lambda: model_of("rigid_body"))
    by_asked: bool = True


@pytest.fixture(scope="module")
def log():
    """Joint 1 is rectified, joint 2 has its signs."""
    motion = smooth_motion(2, 2.0, 50.0)
    return Log(
        motion.t, motion.q, np.stack([np.abs(motion.dq[:, 0]), motion.dq[:, 1]], axis=1), np.array([False, True])
    )


def posterior_with(converged=True, weights=(1.0,), chosen=0, asked=1, excluded=None, pressed=()):
    return SimpleNamespace(
        excluded=excluded,
        converged=converged,
        max_rhat=1.0512,
        min_ess=73.4,
        modes=[SimpleNamespace(weight=weight) for weight in weights],
        turned_joints=lambda mode: ((), (2, 3), ())[mode],
        chosen=chosen,
        sampling=SimpleNamespace(mode=asked),
        pressed=pressed,
    )


def warnings(log, doubt=(0.0, 0.0), posterior=None, reading=None, **changes):
    return warnings_of(log, Averaged(**changes), np.array(doubt), posterior, reading)


def test_nothing_wrong_is_nothing_said(log):
    assert warnings(log) == ()
    assert warnings(log, posterior=posterior_with()) == ()
    assert warnings(log, posterior=posterior_with(weights=(0.995, 0.005))) == ()
    assert warnings(log, posterior=posterior_with(excluded=0.008)) == ()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"fit": fit_with(relative=(0.1, 0.26))}, "joint 2 leaves 26% of its effort unexplained"),
        ({"fit": fit_with(sd=(0.3, np.inf, np.inf))}, "the log does not excite 2 coefficients"),
        (
            {"fit": fit_with(on_edge=(True, True, False))},
            "single masses, centres of mass and inertias of links 1, 2 cannot be trusted one by one: the fit pressed "
            "them to the edge of what is physically possible (coefficients and predicted efforts are not touched); "
            "state what is known of them by --nominal",
        ),
        (
            {"fit": fit_with(on_edge=(True, False, True))},
            "inertias of link 1, and inertias of what the last link carries cannot be trusted",
        ),
        ({"fit": fit_with(tolerance=2e-8)}, "a relative gap of 2e-08 only"),
        ({"settled": SimpleNamespace(signs=signs_with(certified=False))}, "others may cost up to 30 less than 120"),
        (
            {"settled": SimpleNamespace(signs=signs_with(certified=False, lower_bound=120.0, withheld="pull"))},
            "the signs are not proven to be the best: others that it lists may cost the data less",
        ),
        (
            {"settled": SimpleNamespace(signs=signs_with(certified=False, lower_bound=120.0, withheld="noise"))},
            "which assignment is the best depends on how large each joint's noise is taken to be",
        ),
        ({"posterior": posterior_with(excluded=0.83)}, "the search excludes signs of up to 83% of a joint's effort"),
        ({"settled": SimpleNamespace(signs=signs_with(unsplit=3))}, "3 segments still cross zero after 4 searches"),
        ({"settled": SimpleNamespace(signs=signs_with(unsplit=1))}, "1 segment still crosses zero after 4 searches"),
        ({"doubt": (0.0, 0.3)}, "confidences of joint 2 are lowered, to 0.85 at worst"),
        (
            {"posterior": posterior_with(weights=(0.7, 0.3))},
            "the log allows other models than the one written, mode 1 (0.7): 0.3 for mode 2, which has the signs of "
            "joint 2, 3 turned round against the first; --mode writes another one",
        ),
        (
            {"posterior": posterior_with(weights=(0.7, 0.28, 0.02), chosen=1)},
            "the log allows other models than the one written, mode 2 (0.28): 0.7 for mode 1; 0.02 for mode 3, which "
            "differs in single segments from the first; --mode writes another one",
        ),
        ({"posterior": posterior_with(asked=3)}, "there is no mode 3 of the posterior, of 1: the heaviest is written"),
        (
            {"posterior": posterior_with(converged=False)},
            "has not converged (R-hat 1.051, effective sample size 73); give more --posterior-budget",
        ),
        (
            {"posterior": posterior_with(pressed=(("mass of all links, from above", 0.87),))},
            "the prior's window on the mass of all links, from above (87% of the draws near its edge) decides, not the "
            "data; if links are heavier or longer than that, say so by --links",
        ),
        (
            {"reading": BetterReading("joint order", "joints 2 and 3 exchanged", 0.041, 0.213)},
            "check the robot file: this is not the robot of the log, or the log is read wrongly; with joints 2 and 3 "
            "exchanged the model leaves 4.1% of the effort instead of 21.3%",
        ),
    ],
)
def test_each_fault_is_one_sentence(log, changes, sentence):
    (warning,) = warnings(log, **changes)
    assert sentence in warning
    assert "\n" not in warning


def test_a_low_pass_after_the_rectifier_is_named(log):
    asked = SimpleNamespace(model=model_of().model, evidence=read_through(LowPass(2, 7.934, zero_phase=False)))
    (warning,) = warnings(log, asked=asked)
    assert "was low-passed after it was rectified, at about 7.93 Hz (Butterworth, order 2, with its delay)" in warning


def test_what_a_robot_was_read_with_comes_first(log):
    notes = ("joints finger1, finger2 are held: a gripper is not identified",)
    found = warnings(log, asked=model_of("rigid_body", notes=notes), doubt=(0.0, 0.3))
    assert found[0] == notes[0]
    assert len(found) == 2


def test_a_search_that_proves_nothing_has_no_gap(log):
    """A beam has no lower bound; not to have one is no fault."""
    assert warnings(log, settled=SimpleNamespace(signs=signs_with(certified=False, lower_bound=None))) == ()


def test_terms_that_are_missing_are_named(log):
    richer = SimpleNamespace(signs=signs_with(), **vars(model_of("rigid_body", "viscous_friction", "torque_offset")))
    (warning,) = warnings(log, settled=richer, by_asked=False)
    assert "the model lacks viscous_friction, torque_offset:" in warning


def test_an_effect_that_the_model_has_in_another_joint_is_named_with_its_own(log):
    asked, richer = model_of("rigid_body", "gravity_spring 2"), model_of("rigid_body", "gravity_spring 2", "delay 7")
    (warning,) = warnings(log, asked=asked, settled=SimpleNamespace(signs=signs_with(), **vars(richer)), by_asked=False)
    assert "the model lacks delay 7:" in warning


def test_a_joint_that_is_hardly_ever_negative_is_named(log):
    """Signed by the rule, but no lower than 5 % of its largest effort below zero."""
    effort = log.effort.copy()
    effort[:, 1] = np.abs(effort[:, 1])
    for share, named in ((0.049, True), (0.051, False)):
        effort[7, 1] = -share * effort[:, 1].max()
        sentences = warnings(Log(log.t, log.q, effort, log.signed))
        assert ["--unsigned 2" in sentence for sentence in sentences] == [True] * named


# ---------------------------------------------------------------------------------------------------------------
# Whole identifications
# ---------------------------------------------------------------------------------------------------------------
def test_a_rectified_effort_that_undershoots_is_pointed_out():
    """A filter after the rectifier: hardly ever negative, yet by the rule it counts as signed."""
    motion = smooth_motion(2, 6.0, 100.0, seed=3)
    effort = np.abs(motion.ddq) + 0.5
    effort[7, 1] = -0.01
    log = Log(motion.t, motion.q, effort, np.array([False, True]))
    result = identify(small_robot(2, 1), log, terms=["rigid_body"], posterior=False)
    assert any("--unsigned 2" in warning for warning in result.warnings)
    assert not any("--unsigned 1" in warning for warning in result.warnings)


def test_a_poor_fit_is_said_aloud():
    """Efforts that have nothing to do with the motion: the confidences rest on a model that does not hold."""
    robot, motion = small_robot(2, 1), smooth_motion(2, 6.0, 100.0, seed=3)
    effort = np.abs(np.stack([3.0 * np.sin(11.0 * motion.t), 2.0 * np.sin(13.0 * motion.t + 1.0)], axis=1))
    log = Log(motion.t, motion.q, effort, np.zeros(2, dtype=bool))
    result = identify(robot, log, terms=["rigid_body"], search=Certified(budget=0.5), posterior=False)
    assert any("unexplained" in warning for warning in result.warnings)
