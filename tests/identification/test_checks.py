"""What a user is warned of, each sentence by itself; whole identifications that end in a warning."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import smooth_motion

from bayesid.identification.checks import warnings_of
from bayesid.identification.misread import Misreading
from bayesid.log.log import Log
from bayesid.log.low_pass import AfterRectifier, LowPass
from bayesid.regression.knowledge import NominalParameters


def fit_with(relative=(0.1, 0.2), sd=(0.3, 0.5, 0.1), on_edge=(False, False, False), tolerance=1e-10):
    return SimpleNamespace(
        relative_residual=np.array(relative), sd=np.array(sd), on_edge=np.array(on_edge), tolerance=tolerance
    )


def signs_with(certified=True, lower_bound=90.0, unresolved=0, uncertified_because="", timed_out=False):
    search = SimpleNamespace(
        certified=certified,
        lower_bound=lower_bound,
        cost=120.0,
        seconds=9.0,
        uncertified_because=uncertified_because,
        timed_out=timed_out,
        signs=np.ones(200),
    )
    return SimpleNamespace(search=search, unresolved=unresolved, rounds=4)


def model_of(*names, notes=()):
    """Terms of all joints, or of some, as in "gravity_spring 7"."""
    effects = [
        SimpleNamespace(name=name, joints=tuple(map(int, joints))) for name, *joints in (text.split() for text in names)
    ]
    model = SimpleNamespace(terms=effects, effects=effects, robot=SimpleNamespace(notes=notes))
    return SimpleNamespace(model=model, log_data=read_through(None))


def read_through(low_pass, used=(True, True)):
    """Evidence of a log whose |effort| has passed a low-pass, of which joints have one."""
    coefficients = SimpleNamespace(names=("mc1x", "Fv2", "Fc2"), selected=np.arange(3), projection=np.zeros((0, 20)))
    model = SimpleNamespace(parameters=[SimpleNamespace(joint=joint) for joint in (1, 2, 2)])
    known = {"coefficients": coefficients, "model": model, "used": np.array([used])}
    after = low_pass and AfterRectifier(low_pass, np.zeros((1, 2)), np.zeros(2))
    motion = SimpleNamespace(t=np.arange(4.0), q=np.eye(2))
    signals = SimpleNamespace(after_rectifier=after, faults=(), motion=motion, cutoff=10.0, rate=20.0)
    return SimpleNamespace(signals=signals, **known)


def blind():
    """No effort of joint 2."""
    return SimpleNamespace(model=model_of().model, log_data=read_through(None, used=(True, False)))


@dataclass
class Averaged:
    """Signs by the requested model, nothing wrong with them."""

    fit: SimpleNamespace = field(default_factory=fit_with)
    sign_solution: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(signs=signs_with()))
    requested: SimpleNamespace = field(default_factory=lambda: model_of("rigid_body"))
    by_requested: bool = True


@pytest.fixture(scope="module")
def log():
    """Joint 1 is rectified, joint 2 has its signs."""
    motion = smooth_motion(2, 2.0, 50.0)
    return Log(
        motion.t, motion.q, np.stack([np.abs(motion.dq[:, 0]), motion.dq[:, 1]], axis=1), np.array([False, True])
    )


def unproven(**changes):
    return SimpleNamespace(signs=signs_with(certified=False, **changes))


def posterior_with(
    converged=True,
    weights=(1.0,),
    chosen=0,
    asked=1,
    posterior_conflict=None,
    active_bounds=(),
    timed_out=False,
    edges=(),
):
    return SimpleNamespace(
        posterior_conflict=posterior_conflict,
        converged=converged,
        max_rhat=1.0512,
        min_ess=73.4,
        modes=[SimpleNamespace(weight=weight) for weight in weights],
        flipped_joints=lambda mode: ((), (2, 3), ())[mode],
        chosen=chosen,
        sampling=SimpleNamespace(mode=asked, max_rhat=1.01, wanted_ess=1024.0),
        active_bounds=active_bounds,
        active_constraints=dict(edges),
        timed_out=timed_out,
    )


def warnings(log, model_error_probability=(0.0, 0.0), posterior=None, reading=None, nominal=None, **changes):
    averaged = Averaged(**changes)
    return warnings_of(log, averaged, np.array(model_error_probability), posterior, reading, nominal=nominal)


def test_nothing_wrong_is_nothing_said(log):
    """Not to have a lower bound, as a beam, is no fault."""
    for changes in (
        {},
        {"posterior": posterior_with()},
        {"posterior": posterior_with(weights=(0.995, 0.005))},
        {"posterior": posterior_with(posterior_conflict=0.008)},
        {"sign_solution": SimpleNamespace(signs=signs_with(unresolved=1))},  # of 200 segments
        {"sign_solution": unproven(lower_bound=None)},
        {"fit": fit_with(on_edge=(True, True, False))},  # of single parameters, which the user did not request
        {"fit": fit_with(on_edge=(True, True, False)), "nominal": NominalParameters(*np.full((2, 20), np.nan))},
    ):
        assert warnings(log, **changes) == ()


FAULTS = (
    ({"fit": fit_with(relative=(0.1, 0.26))}, ("joint 2", "26 %")),
    ({"fit": fit_with(sd=(0.3, np.inf, np.inf))}, ("2 of 3 coefficients",)),
    ({"fit": fit_with(sd=(0.3, np.inf, np.inf)), "requested": blind()}, ("joint 2: no effort", "Fv2, Fc2")),
    (
        {"fit": fit_with(on_edge=(True, True, False)), "nominal": NominalParameters(*np.full((2, 20), 0.5))},
        ("links 1, 2", "--nominal"),
    ),
    ({"fit": fit_with(tolerance=2e-8)}, ("2e-08",)),
    ({"fit": fit_with(sd=(0.3, 0.5, 0.1, 0.2, 0.2))}, ("5 coefficients", "4 independent samples")),
    ({"sign_solution": unproven()}, ("not proven", "25.0 % lower", "--search-budget")),
    ({"sign_solution": unproven(lower_bound=120.0, uncertified_because="tikhonov")}, ("not proven",)),
    ({"sign_solution": unproven(lower_bound=120.0, uncertified_because="noise")}, ("noise",)),
    ({"posterior": posterior_with(posterior_conflict=0.83)}, ("83 %",)),
    ({"sign_solution": SimpleNamespace(signs=signs_with(unresolved=3))}, ("3 segments", "4 searches")),
    ({"sign_solution": SimpleNamespace(signs=signs_with(False, timed_out=True))}, ("search", "--time-limit")),
    ({"sign_solution": SimpleNamespace(signs=signs_with(False, None, timed_out=True))}, ("search", "--time-limit")),
    ({"posterior": posterior_with(converged=False, timed_out=True)}, ("sampling", "--time-limit")),
    ({"model_error_probability": (0.0, 0.3)}, ("joint 2", "0.85")),
    ({"posterior": posterior_with(weights=(0.7, 0.3))}, ("probability 0.7", "mode 2 with 0.3", "2, 3", "--mode")),
    (
        {"posterior": posterior_with(weights=(0.7, 0.28, 0.02), chosen=1)},
        ("mode 2 with probability 0.28", "1 with 0.7"),
    ),
    ({"posterior": posterior_with(asked=3)}, ("no mode 3", "modes: 1")),
    ({"posterior": posterior_with(converged=False)}, ("1.05,", "1.01 ", "needs 1,024", "has 73", "--posterior-budget")),
    (
        {"posterior": posterior_with(active_bounds=(("mass of all links, from above", 0.87),))},
        ("mass of all", "87 %", "--links"),
    ),
    ({"posterior": posterior_with(edges=(("m3 <= m2", 0.063),))}, ("constraint: m3 <= m2", "6.3 %")),
    (
        {"reading": Misreading("joint order", "joints 2 and 3 exchanged", 0.041, 0.213, 4.0, "give `correct` q2=q3")},
        ("1e4 times as likely", "`correct`", "joints 2 and 3 exchanged", "4.1 %", "21.3 %"),
    ),
    (
        {
            "requested": SimpleNamespace(
                model=model_of().model, log_data=read_through(LowPass(2, 7.934, zero_phase=False))
            )
        },
        ("low-passed", "7.93 Hz", "order 2"),
    ),
)


def test_each_fault_is_one_line_that_names_what_is_at_fault_and_the_option(log):
    for changes, words in FAULTS:
        (warning,) = warnings(log, **changes)
        assert [word for word in words if word not in warning] == [], warning
        assert "\n" not in warning


def test_what_a_robot_was_read_with_comes_first(log):
    notes = ("joints finger1, finger2 are held: a gripper is not identified",)
    found = warnings(log, requested=model_of("rigid_body", notes=notes), model_error_probability=(0.0, 0.3))
    assert (found[0], len(found)) == (notes[0], 2)


def test_what_the_model_lacks_is_named_with_its_joint_where_another_one_has_it(log):
    requested, richer = (
        model_of("rigid_body", "gravity_spring 2"),
        model_of("rigid_body", "gravity_spring 2", "delay 7"),
    )
    more = model_of("rigid_body", "gravity_spring 2", "viscous_friction", "torque_offset")
    for rival, named in ((richer, "delay 7:"), (more, "viscous_friction, torque_offset:")):
        sign_solution = SimpleNamespace(signs=signs_with(), **vars(rival))
        (warning,) = warnings(log, requested=requested, sign_solution=sign_solution, by_requested=False)
        assert named in warning


def test_a_joint_that_is_hardly_ever_negative_is_named(log):
    """Signed by the rule, but no lower than 5 % of its largest effort below zero."""
    effort = log.effort.copy()
    effort[:, 1] = np.abs(effort[:, 1])
    for share, named in ((0.049, True), (0.051, False)):
        effort[7, 1] = -share * effort[:, 1].max()
        sentences = warnings(Log(log.t, log.q, effort, log.signed))
        assert ["--unsigned 2" in sentence for sentence in sentences] == [True] * named
