"""Model selection: one hidden effect is found from |effort| alone; other effects widen the uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from completion_problems import BASE, LAG, LOAD, STRIBECK, THETA, identified, identify, log_with, true_signs

from bayesid.errors import InputError
from bayesid.identification import sampling
from bayesid.log.segments import Segmentation, find_segments
from bayesid.log.signals import prepare
from bayesid.posterior.inference import widened
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import KinematicTolerance, ParameterPrior
from bayesid.signs.averaging import AveragedSigns
from bayesid.signs.model_selection import Completing, complete
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import find_signs

HIDDEN = {"stribeck_friction": (2,), "load_dependent_friction": (2,), "delay": ()}


def found(result):
    return {(entered.effect, entered.joints) for entered in result.model_selection.effects}


@pytest.mark.parametrize("name", HIDDEN)
def test_one_hidden_effect_is_found_and_no_other(name):
    result = identified(name)
    assert found(result) == {(name, HIDDEN[name])}
    (entered,) = result.model_selection.effects
    assert entered.log10_bayes_factor > 12.0 / np.log(10.0)
    names = [effect.name for effect in (*result.model.terms, *result.model.distortions)]
    assert names == [*(term.name for term in BASE.terms), entered.source.name]
    signs, strong = true_signs(name)
    assert np.mean((result.sample_signs == signs)[strong]) > 0.995
    # Held-back error falls to the noise and what a number from a list, or links that are but estimated, leave.
    model_selection, noise = result.model_selection, 0.03 * np.sqrt(np.mean(log_with(name).effort ** 2, axis=0))
    assert np.all(model_selection.after < 1.8 * noise)
    worst = np.argmax(model_selection.before / model_selection.effort)
    assert model_selection.before[worst] > 1.6 * model_selection.after[worst]
    np.testing.assert_allclose(model_selection.effort, noise / 0.03, rtol=0.15)


def test_the_shape_of_friction_reversals_gives_no_effect():
    """The truth turns round at once, the model does not, and there is next to no noise."""
    assert found(identified("turns_at_once")) == set()


def test_numbers_are_those_of_the_truth():
    """The Stribeck speed from a list of speeds 1.7 times apart."""
    stribeck, load, delay = (identified(name) for name in HIDDEN)
    values = dict(zip([p.name for p in stribeck.model.parameters], stribeck.theta.tolist(), strict=True))
    assert values["Fs2"] == pytest.approx(STRIBECK["Fs2"], rel=0.25)
    (entered,) = stribeck.model_selection.effects
    assert 1.0 / 1.7 < entered.source.speed[0] / STRIBECK["speed2"] < 1.7
    assert entered.number_sd == ()
    values = dict(zip([p.name for p in load.model.parameters], load.theta.tolist(), strict=True))
    assert values["Fl2"] == pytest.approx(LOAD, rel=0.5)
    (entered,) = delay.model_selection.effects
    (sd,) = entered.number_sd
    assert 1e-5 < sd < 2e-3
    assert entered.source.lag[0] == pytest.approx(LAG, abs=4.5 * sd)
    assert delay.model.distortions[0].lag == entered.source.lag


def test_nothing_is_found_where_nothing_is_missing():
    result = identified()
    assert result.model_selection.effects == ()
    np.testing.assert_array_equal(result.model_selection.before, result.model_selection.after)
    assert [term.name for term in result.model.terms] == [term.name for term in BASE.terms]
    assert result.model.distortions == ()
    off = result.fit.beta - result.coefficients.project(THETA)
    assert np.all(np.abs(off) < 5.0 * result.fit.sd)


def test_only_uncertainty_moves_nothing_but_the_uncertainty():
    """The Stribeck friction itself is among what is summed out: in units of what is left otherwise."""
    off, only = (identified("stribeck_friction", complete=how) for how in ("off", "only-uncertainty"))
    assert off.model_selection is None
    assert only.model_selection.effects == ()
    assert "kinematics" in only.model_selection.uncertain
    assert any(name.startswith("stribeck_friction 2") for name in only.model_selection.uncertain)
    auto = identified("stribeck_friction").model_selection
    assert not any(name.startswith("stribeck_friction 2") for name in auto.uncertain)
    assert only.model.terms == off.model.terms
    np.testing.assert_array_equal(only.fit.theta, off.fit.theta)
    np.testing.assert_array_equal(only.sample_signs, off.sample_signs)
    assert np.all(only.fit.sd >= off.fit.sd * (1.0 - 1e-9))
    assert (only.fit.sd / off.fit.sd).max() > 1.02


def test_an_unknown_way_to_complete_is_refused():
    with pytest.raises(InputError, match="nonsense"):
        identify(complete="nonsense")


def test_marginalised_effects_do_not_change_confidences():
    """A geometry that may be far off makes coefficients uncertain, not the efforts of the log they were fitted to."""
    few, wide = Sampling(budget=0.0), ParameterPrior(length_sd=0.02, angle_sd=0.03)
    off = identify(posterior=few, complete="off")
    only = identify(posterior=few, complete="only-uncertainty", prior=wide)
    assert (only.sd / off.sd).max() > 2.0
    np.testing.assert_array_equal(only.theta, off.theta)  # no estimate moves
    np.testing.assert_allclose(only.validate(log_with("")).rms_error, off.validate(log_with("")).rms_error)
    sure = [np.mean(np.maximum(result.probability, 1.0 - result.probability) > 0.99) for result in (off, only)]
    assert sure[1] > sure[0] - 0.01
    signs, strong = true_signs("")
    assert np.mean((only.sample_signs == signs)[strong]) >= np.mean((off.sample_signs == signs)[strong]) - 0.002


def test_an_effect_enters_only_if_every_possible_assignment_confirms_it():
    """The same log and search, but one of two has the second joint's other side on its list."""
    signals = prepare(log_with("stribeck_friction"))
    segments = find_segments(signals, BASE.robot.actuators(signals.motion), Segmentation())
    search, how = Certified(budget=2.0), Completing(True, KinematicTolerance(), Segmentation())
    sign_solution = find_signs(BASE, signals, segments, search)
    plain = complete(AveragedSigns.alone(sign_solution), segments, search, how)
    assert found(plain) == {("stribeck_friction", (2,))}
    left = plain.without(found(plain))
    assert found(left) == set()
    assert found(plain) == {("stribeck_friction", (2,))}
    np.testing.assert_array_equal(left.averaged.fit.theta, sign_solution.fit.theta)
    (best,) = [
        branch for branch in sign_solution.signs.near if np.array_equal(branch.signs, sign_solution.signs.search.signs)
    ]
    of_second = sign_solution.signs.segments[sign_solution.signs.segments.fitted].joint == 1
    other = replace(best, signs=np.where(of_second, -best.signs, best.signs), theta=-best.theta, cost=best.cost + 30.0)
    doubtful = replace(sign_solution, signs=replace(sign_solution.signs, near=(best, other)))
    assert len(doubtful.alternatives) == 1
    assert found(complete(AveragedSigns.alone(doubtful), segments, search, how)) == set()


def test_an_effect_is_removed_if_the_posterior_includes_zero(monkeypatch):
    """The posterior is made wide in the effect's parameters, which least squares know to be far from zero."""
    name, seen, asked = "stribeck_friction", [], len(BASE.parameters)

    def wide(posterior, *args):
        posterior = widened(posterior, *args)
        seen.append(posterior.theta.shape[-1])
        shift = posterior.shift.copy()
        spread = np.linspace(-1.0, 1.0, shift[..., 0].size).reshape(*shift.shape[:-1], 1)
        shift[..., asked:] = spread * posterior.theta[asked:]
        return replace(posterior, shift=shift)

    monkeypatch.setattr(sampling, "widened", wide)
    result = identify(name, posterior=Sampling(budget=0.0))
    assert len(seen) == 2
    assert seen[0] > seen[1] == asked
    assert found(result) == set()
