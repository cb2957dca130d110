"""Numbers of added effects: parameters and their change, readable quantities, and size of the effort."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.case import Case
from bayesid.discrepancy.selection import Selection
from bayesid.discrepancy.sets import form_of
from bayesid.effects.bodies import Payload
from bayesid.effects.distortion import Distortion
from bayesid.effects.formula import Description
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.identification.payload import AXES, InertialParameters, PayloadEstimate
from bayesid.motion import Motion
from bayesid.regression.selection.added_effect import LARGEST_READING, RATED, AddedEffect, EffortSize, Quantity
from bayesid.regression.selection.hypotheses import Hypothesis

CHANGE_OF = "change of "
"""Prefix of the names of changes of the earlier model's parameters."""


def with_numbers(
    case: Case, selection: Selection, again: Identification, body: PayloadEstimate | None = None
) -> tuple[AddedEffect, ...]:
    """The selected effects with their numbers; those of a payload are from `identify_payload`."""
    numbers = Numbers(case.model, case.knowledge.theta, again, body)
    return tuple(
        replace(
            effect,
            parameters={**numbers.parameters(effect.hypothesis), **_shape_numbers(case, effect.hypothesis, sd)},
            readable=numbers.readable(effect.hypothesis),
            description=numbers.description(effect.hypothesis),
            size=effort_size(case, effect.hypothesis, again.model, again.theta),
            cost=cost,
        )
        for effect, sd, cost in zip(selection.added, selection.chosen.fitted_effects.sd, selection.costs, strict=True)
    )


def _shape_numbers(case: Case, effect: Hypothesis, sd: Array) -> dict[str, Quantity]:
    numbers = effect.source.numbers(case.model.robot)
    fitted = not effect.source.linear and len(sd) >= len(numbers)
    deviations = sd[: len(numbers)] if fitted else np.full(len(numbers), np.nan)
    named = zip(numbers.items(), deviations, strict=True)
    return {name: (value, float(deviation), unit) for (name, (value, unit)), deviation in named}


class Numbers:
    """Parameters of the extended model, identified again, beside theta (P,) of the earlier model.

    Those of a payload are from `body`, if given: its estimate from the same log under the earlier model.
    """

    def __init__(self, model: Model, theta: Array, again: Identification, body: PayloadEstimate | None = None) -> None:
        self._body = body
        self._again, self._names = again, [parameter.name for parameter in again.model.parameters]
        self._earlier = {p.name: float(value) for p, value in zip(model.parameters, theta, strict=True)}
        self._sd, _ = again.parameter_sd
        draws = None if again.posterior is None else again.posterior.uncertain.theta
        self._draws = None if draws is None else draws.reshape(-1, draws.shape[-1])

    def parameters(self, effect: Hypothesis) -> dict[str, Quantity]:
        """Values of an added effect's parameters; of earlier parameters that it changes, also the change."""
        if self._body is not None and isinstance(effect.source, Payload):
            pairs = zip(effect.source.parameters(self._again.model.robot), self._body.parameters, strict=True)
            return {parameter.name: (number.value, number.sd, parameter.unit) for parameter, number in pairs}
        quantities: dict[str, Quantity] = {}
        for parameter in effect.source.parameters(self._again.model.robot):
            name, unit = parameter.name, parameter.unit
            quantities[name] = (*self._sum(name), unit)
            if name in effect.changes:
                quantities |= self._changed(name, quantities[name])
            for symbol, other in effect.source.adds_to.items():
                target = f"{other}{parameter.joint}"
                if name == f"{symbol}{parameter.joint}" and target in self._earlier:
                    quantities[target] = (*self._sum(target, name), unit)
                    quantities |= self._changed(target, quantities[target])
        return quantities

    def readable(self, effect: Hypothesis) -> dict[str, Quantity]:
        """Quantities that are easier to read than the parameters, such as a payload's centre of mass."""
        if self._body is not None and isinstance(effect.source, Payload):
            return _of_body(self._body.body)
        place = self._place(effect)
        values = effect.source.readable(self._again.theta[place])
        drawn = {} if self._draws is None else effect.source.readable(self._draws[:, place])
        sd = {name: float(np.std(draws)) for name, (draws, _) in drawn.items()}
        return {name: (float(value), sd.get(name, np.nan), unit) for name, (value, unit) in values.items()}

    def description(self, effect: Hypothesis) -> Description | None:
        """Description of a learned effect."""
        return effect.source.description(self._again.model.robot, self._again.theta[self._place(effect)])

    def _place(self, effect: Hypothesis) -> list[int]:
        return [self._names.index(p.name) for p in effect.source.parameters(self._again.model.robot)]

    def _sum(self, *names: str) -> tuple[float, float]:
        """Value and standard deviation of the sum of parameters; NaN if unknown."""
        place = [self._names.index(name) for name in names]
        if self._draws is not None and len(place) > 1:
            return float(self._again.theta[place].sum()), float(self._draws[:, place].sum(axis=1).std())
        return float(self._again.theta[place].sum()), float(self._sd[place[0]]) if len(place) == 1 else np.nan

    def _changed(self, name: str, now: Quantity) -> dict[str, Quantity]:
        value, sd, unit = now
        return {f"{CHANGE_OF}{name}": (value - self._earlier[name], sd, unit)}


def _of_body(body: InertialParameters) -> dict[str, Quantity]:
    """Names as in `Payload.readable`."""
    numbers = {"mass": (body.mass, "kg")}
    numbers |= {f"centre of mass {axis}": (value, "m") for axis, value in zip("xyz", body.centre or (), strict=True)}
    numbers |= {f"inertia {axes}": (value, "kg m^2") for axes, value in zip(AXES, body.inertia or (), strict=True)}
    return {name: (number.value, number.sd, unit) for name, (number, unit) in numbers.items()}


def effort_size(case: Case, effect: Hypothesis, extended: Model, theta: Array) -> EffortSize:
    """Size on held-back data of the effort of an effect, in an extended model with parameters theta (P,)."""
    trial = case.cross_validation.trial
    effort = np.where(trial.used, effort_of(case, effect, extended, theta, trial.signals.motion), 0.0)
    rms = trial.rms(effort)
    joint = int(np.argmax(rms))
    reference, of = case.model.robot.joints[joint].rated_effort, RATED
    if reference is None:  # the largest reading of the whole log
        logs = [case.trial.signals, *([] if case.cross_validation.another_log else [trial.signals])]
        readings = [signals.magnitude[signals.measured[:, joint], joint] for signals in logs]
        reference, of = np.concatenate(readings).max(initial=0.0), LARGEST_READING
    return EffortSize(joint + 1, float(rms[joint]), float(np.abs(effort[:, joint]).max()), float(reference), of)


def effort_of(case: Case, effect: Hypothesis, extended: Model, theta: Array, motion: Motion) -> Array:
    """(N, n) effort of an effect, N m: that of an extended model minus that without the effect or the change."""
    names = [parameter.name for parameter in extended.parameters]
    without, kept = extended, theta.copy()
    if effect.changes:
        earlier = dict(zip((p.name for p in case.model.parameters), case.knowledge.theta, strict=True))
        kept[[names.index(name) for name in effect.changes]] = [earlier[name] for name in effect.changes]
    elif isinstance(effect.source, Distortion):
        last = max(k for k, other in enumerate(extended.distortions) if (other.name, other.joints) == form_of(effect))
        without = replace(extended, distortions=extended.distortions[:last] + extended.distortions[last + 1 :])
    else:
        kept[[names.index(p.name) for p in effect.source.parameters(extended.robot)]] = 0.0
    return extended.effort(motion, theta) - without.effort(motion, kept)
