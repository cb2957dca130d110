"""How large the effects that were added are on held-back data, and what each of them costs if it is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.case import Case
from bayesid.discrepancy.sets import EffectSet, EffectSets
from bayesid.effects.distortion import Distortion
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.regression.selection.added_effect import LARGEST_READING, RATED, Cost, EffortSize
from bayesid.regression.selection.hypotheses import Hypothesis

_TINY = 1e-300
"""Guard of a division."""


def costs(sets: EffectSets, chosen: EffectSet) -> tuple[Cost, ...]:
    """Of each effect of a chosen set: of the set without it, numbers and signs found anew, and of the set itself."""
    return tuple(_cost(sets, chosen, effect) for effect in chosen.effects)


def _cost(sets: EffectSets, chosen: EffectSet, effect: Hypothesis) -> Cost:
    trial = sets.case.held_back.trial
    without = sets.settled(chosen.without(effect), chosen.data, effect.columns.joints)
    before, after = trial.rms(without.held_back), trial.rms(chosen.held_back)
    effort = trial.rms(np.where(trial.used, trial.magnitude, 0.0))
    rise = (before**2 - after**2) / np.maximum(effort**2, _TINY)
    joint = max(sorted(effect.columns.joints), key=lambda j: float(rise[j]))
    return Cost(joint + 1, float(before[joint]), float(after[joint]), float(effort[joint]))


def effort_size(case: Case, effect: Hypothesis, extended: Model, theta: Array) -> EffortSize:
    """How large an effect's own effort is on held-back data.

    Args:
        case: the data.
        effect: that was added to a model.
        extended: that model.
        theta: (P,) its parameters.
    """
    trial = case.held_back.trial
    own = np.where(trial.used, own_effort(case, effect, extended, theta, trial.signals.motion), 0.0)
    rms = trial.rms(own)
    joint = int(np.argmax(rms))
    rated = case.model.robot.joints[joint].rated_effort
    reference = _largest_readings(case)[joint] if rated is None else rated
    largest, of = np.abs(own[:, joint]).max(), LARGEST_READING if rated is None else RATED
    return EffortSize(joint + 1, float(rms[joint]), float(largest), float(reference), of)


def own_effort(case: Case, effect: Hypothesis, extended: Model, theta: Array, motion: Motion) -> Array:
    """(N, n) effort of an extended model less that without the effect, all other parameters kept, N m.

    Of a change of what the model had it is what the change makes.
    """
    names = [parameter.name for parameter in extended.parameters]
    without, kept = extended, theta.copy()
    if effect.changes:
        earlier = dict(zip((p.name for p in case.model.parameters), case.knowledge.theta, strict=True))
        kept[[names.index(name) for name in effect.changes]] = [earlier[name] for name in effect.changes]
    elif isinstance(effect.source, Distortion):
        key = effect.source.name, effect.source.joints
        last = max(k for k, one in enumerate(extended.distortions) if (one.name, one.joints) == key)
        without = replace(extended, distortions=extended.distortions[:last] + extended.distortions[last + 1 :])
    else:
        kept[[names.index(p.name) for p in effect.source.parameters(extended.robot)]] = 0.0
    return extended.effort(motion, theta) - without.effort(motion, kept)


def _largest_readings(case: Case) -> Array:
    """(n,) largest |effort| of the log, what is held back of it included, N m."""
    signals = [case.trial.signals, *([] if case.held_back.another_log else [case.held_back.trial.signals])]
    return np.max([np.where(one.measured, one.magnitude, 0.0).max(axis=0) for one in signals], axis=0)
