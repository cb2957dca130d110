"""The numbers of added effects: parameters of the extended model, beside those of the model as it was."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.formula import Description
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.regression.selection.added_effect import Quantity
from bayesid.regression.selection.hypotheses import Hypothesis

CHANGE_OF = "change of "
"""How names of numbers begin that are changes of what the model had."""


class Numbers:
    """Parameters of the extended model, beside those of the model as it was.

    Args:
        model: as it was.
        theta: (P,) its parameters.
        again: the identification of the extended model.
    """

    def __init__(self, model: Model, theta: Array, again: Identification) -> None:
        self._again, self._names = again, [parameter.name for parameter in again.model.parameters]
        self._earlier = {p.name: float(value) for p, value in zip(model.parameters, theta, strict=True)}
        self._sd, _ = again.parameter_sd
        draws = None if again.posterior is None else again.posterior.uncertain.theta
        self._draws = None if draws is None else draws.reshape(-1, draws.shape[-1])

    def parameters(self, effect: Hypothesis) -> dict[str, Quantity]:
        """Of an added effect, and of what it adds to that the model had: the new value and the change."""
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
        """What people read in place of these."""
        place = [self._names.index(p.name) for p in effect.source.parameters(self._again.model.robot)]
        values = effect.source.readable(self._again.theta[place])
        drawn = {} if self._draws is None else effect.source.readable(self._draws[:, place])
        sd = {name: float(np.std(draws)) for name, (draws, _) in drawn.items()}
        return {name: (float(value), sd.get(name, np.nan), unit) for name, (value, unit) in values.items()}

    def description(self, effect: Hypothesis) -> Description | None:
        """Of an effect without a name, in words."""
        robot = self._again.model.robot
        place = [self._names.index(p.name) for p in effect.source.parameters(robot)]
        return effect.source.description(robot, self._again.theta[place])

    def _sum(self, *names: str) -> tuple[float, float]:
        """Value and standard deviation of the sum of parameters; NaN where that is not known."""
        place = [self._names.index(name) for name in names]
        if self._draws is not None and len(place) > 1:
            return float(self._again.theta[place].sum()), float(self._draws[:, place].sum(axis=1).std())
        return float(self._again.theta[place].sum()), float(self._sd[place[0]]) if len(place) == 1 else np.nan

    def _changed(self, name: str, now: Quantity) -> dict[str, Quantity]:
        value, sd, unit = now
        return {f"{CHANGE_OF}{name}": (value - self._earlier[name], sd, unit)}
