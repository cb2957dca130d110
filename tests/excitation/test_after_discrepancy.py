"""The next motion after a discrepancy: by default it distinguishes the equivalent effects."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import smooth_motion
from open_results import TERMS, earlier_motion, open_result

from bayesid.discrepancy.workflow import explain_log
from bayesid.effects.friction import StribeckFriction
from bayesid.excitation.hypotheses import equivalent_classes
from bayesid.excitation.next_motion import design_next
from bayesid.excitation.settings import MotionSettings
from bayesid.identification.pipeline import identify
from bayesid.simulation.logs import simulate

RUN = MotionSettings(duration=3.0, rate=50.0)


@pytest.fixture(scope="module")
def found():
    """Stribeck friction in joint 3 that an earlier result of the arm lacks."""
    truth = open_result()
    log = simulate(truth.model, truth.theta, earlier_motion(), rng=np.random.default_rng(7), signed=True, noise=0.03)
    earlier = identify(truth.model.robot, log, TERMS, complete="off", posterior=False)
    model = truth.model.extend(StribeckFriction(joints=(3,), smoothing=(0.02,), speed=(0.3,)))
    motion, theta = smooth_motion(3, 8.0, 50.0, seed=9), np.append(truth.theta, [0.0, 0.6])
    log = simulate(model, theta, motion, rng=np.random.default_rng(8), signed=True, noise=0.03)
    return explain_log(earlier, log, posterior=False)


def with_equivalents(found, *names):
    (added,) = found.added
    return replace(found, added=(replace(added, equivalent=names),))


def test_without_equivalents_the_goal_is_all_undetermined_coefficients(found):
    assert [(one.effect, one.joints, one.equivalent) for one in found.added] == [("stribeck_friction", (3,), ())]
    design = design_next(found, settings=replace(RUN, changes=5))
    assert design.competing == ()
    assert len(design.goal.names) == design.predicted.open_now
    np.testing.assert_allclose(design.motion.q[0], found.identification.signals.motion.q[0], atol=1e-12)


def test_equivalent_effects_compete_in_their_joints(found):
    """An effect of the whole robot has no joints: by its score, or by the catalogue."""
    design = design_next(with_equivalents(found, "thermal_drift", "payload"), settings=replace(RUN, changes=5))
    (competing,) = design.competing
    assert [rival.key for rival in competing.competing] == [
        ("stribeck_friction", (3,)),
        ("thermal_drift", (3,)),
        ("payload", ()),
    ]
    place = found.identification.model.places[-1]
    np.testing.assert_array_equal(competing.competing[0].amplitudes, found.identification.theta[place])
    assert design.goal is None
    assert len(design.predicted.log10_bayes_factors) == 6
    assert "stribeck_friction" not in {term.name for term in competing.posterior.model.terms}
    assert (
        design_next(with_equivalents(found, "thermal_drift"), ["Fs3"], settings=replace(RUN, changes=5)).competing == ()
    )
    of_no_score = [("stribeck_friction", (3,), {"thermal_drift": None, "payload": None})]
    assert equivalent_classes(of_no_score) == (tuple(rival.key for rival in competing.competing),)
