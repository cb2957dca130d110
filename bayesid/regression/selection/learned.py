"""Learned effects: functions of some variables that explain a joint's residual, chosen by evidence.

A candidate is a product of functions of one, two or three variables (`effects.axes`), with normal amplitudes about
zero. All pairs of variables are screened as smooth functions. For the best ones every family of functions is tried,
over a grid of prior sizes and lengths. The best sets of variables get their own error models. Laws that extrapolate,
such as a sine or a square, have fewer columns than a smooth function, so evidence prefers them where they hold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, combinations, groupby, product

import numpy as np
from scipy.special import logsumexp

from bayesid.arrays import Array, Mask
from bayesid.effects.axes import Axis, Component, Family, Quantity, products, scaled_to_one
from bayesid.effects.effect import Effect, Scene
from bayesid.effects.formula import symbol
from bayesid.effects.learned_effect import LearnedEffect, values_of
from bayesid.parallel import in_parallel
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.error_model import ErrorModel
from bayesid.regression.selection.fitted_effects import LN10, FittedEffects
from bayesid.regression.selection.hypotheses import Curve, Hypothesis
from bayesid.regression.selection.regression import Regression, integrated
from bayesid.regression.tuning import TUNING

Variable = tuple[Quantity, int]
"""A quantity and its joint (from 1); 0 for the time."""

DECISIVE = 2.0 * LN10
"""Log Bayes factor that a function needs over one of fewer variables (Jeffreys 1961)."""
_POINTS, _LEVELS = 301, (0.15, 0.5, 0.85)
"""Points of a curve for a figure, and quantiles of the range for the second variable."""


@dataclass(frozen=True)
class Form:
    """A product of functions of some variables.

    A smooth function has a kernel with a length relative to the range; the size is the function's prior sd, N m.
    """

    axes: tuple[Axis, ...]
    length: float = 1.0
    size: float = 1.0

    @property
    def variables(self) -> frozenset[Variable]:
        """The variables only."""
        return frozenset(axis.variable for axis in self.axes)

    @property
    def smooth(self) -> bool:
        """Whether one of the functions is smooth and not a law."""
        return any(axis.family is Family.SMOOTH for axis in self.axes)

    @property
    def bounded(self) -> bool:
        """Whether it is constant beyond the observed range."""
        return all(axis.family in (Family.SMOOTH, Family.DIRECTION) for axis in self.axes)

    @property
    def plain(self) -> bool:
        """Whether it has few columns, as a law has."""
        return not self.smooth and self.counts <= TUNING.law_columns

    @property
    def counts(self) -> int:
        """Number of columns."""
        return int(np.prod([axis.count for axis in self.axes]))


@dataclass(frozen=True)
class Learned:
    """A function that may explain the residual of a joint.

    The gain is the log Bayes factor for adding it, averaged over its forms, minus the penalty for multiple comparisons.
    """

    form: Form
    hypothesis: Hypothesis
    gain: float
    price: float


@dataclass(frozen=True, eq=False)
class Finder:
    """Searches the residual of a joint (from 1) of a log with used samples (N, n); `make` makes hypotheses."""

    scene: Scene
    used: Mask
    joint: int
    make: Callable[[Effect], Hypothesis]
    _values: dict[Variable, Array] = field(default_factory=dict)
    _columns: dict[Axis, Array] = field(default_factory=dict)
    _variances: dict[tuple[Axis, float], Array] = field(default_factory=dict)

    def variables(self) -> list[Variable]:
        """All that vary: positions, speeds and accelerations of all joints, the joint's load, and the time."""
        joints = range(1, self.scene.robot.n_joints + 1)
        kinds = (Quantity.POSITION, Quantity.VELOCITY, Quantity.ACCELERATION)
        specific: list[Variable] = [(Quantity.LOAD, self.joint), (Quantity.TIME, 0)]
        everything = [(kind, j) for kind in kinds for j in joints] + specific
        return [variable for variable in everything if np.ptp(self._range(variable)) > TUNING.changes]

    def screened(self) -> Iterator[Form]:
        """Smooth functions of one and two variables, and products with the direction of a joint's motion."""
        variables = self.variables()
        for first in variables:
            yield Form((self._smooth(first, TUNING.cosines_fine),))
        for first, second in combinations(variables, 2):
            yield Form((self._smooth(first, TUNING.cosines_screened), self._smooth(second, TUNING.cosines_screened)))
        for turning, first in product([v for v in variables if v[0] is Quantity.VELOCITY], variables):
            if turning != first:
                yield Form((self._direction(turning), self._smooth(first, TUNING.cosines_coarse)))
        yield from (Form((axis,)) for axis in self._oscillations())

    def forms(self, variables: Iterable[Variable], *, fine: bool) -> Iterator[Form]:
        """All products of families of functions of these variables; `fine` selects those with many columns."""
        chosen = sorted(variables)
        if chosen == [(Quantity.TIME, 0)]:
            yield from (Form((axis,)) for axis in self._oscillations())
        for axes in product(*(list(self._families(variable, fine=fine)) for variable in chosen)):
            yield Form(axes)

    def _oscillations(self) -> Iterator[Axis]:
        time: Variable = (Quantity.TIME, 0)
        low, high = self._range(time)
        rate = (len(self._value(time)) - 1) / (high - low)
        apart = TUNING.oscillations_apart
        count = int(TUNING.fastest_oscillation * rate * 2.0 * high / apart)
        yield from (Axis(*time, Family.PERIODIC, low, high, np.pi * apart * k / high, 2) for k in range(1, count + 1))

    def _tuned(self, forms: Iterable[Form]) -> Iterator[Form]:
        """For oscillations over time, the same form at neighbouring frequencies."""
        for form in forms:
            axis = form.axes[0]
            if len(form.axes) == 1 and axis.quantity is Quantity.TIME and axis.family is Family.PERIODIC:
                count = TUNING.oscillations_refined
                steps = np.arange(-count, count + 1) * (np.pi * TUNING.oscillations_apart / axis.high / count)
                for step in steps[steps > -axis.order]:
                    yield Form((replace(axis, order=float(axis.order + step)),))

    def _smooth(self, variable: Variable, count: int) -> Axis:
        return Axis(*variable, Family.SMOOTH, *self._range(variable), 0.0, count)

    def _direction(self, variable: Variable) -> Axis:
        slowest = float(self.scene.actuators.standstill_speed[variable[1] - 1])
        return Axis(*variable, Family.DIRECTION, *self._range(variable), slowest, 1)

    def _families(self, variable: Variable, *, fine: bool) -> Iterator[Axis]:
        low, high = self._range(variable)
        yield self._smooth(variable, TUNING.cosines_coarse)
        if fine:
            yield self._smooth(variable, TUNING.cosines_fine)
        if self._turns(variable):
            yield from (Axis(*variable, Family.PERIODIC, low, high, h, 2) for h in TUNING.harmonics)
        if variable[0] is Quantity.VELOCITY:
            yield self._direction(variable)
            yield Axis(*variable, Family.ODD, low, high, 2.0, 1)
        if variable[0] is Quantity.TIME:
            yield from (Axis(*variable, Family.FADING, low, high, share * high, 2) for share in TUNING.fadings)
        yield Axis(*variable, Family.POWER, low, high, 1.0, 1)
        if self._turns(variable):
            counts = (7, 13) if fine else (7,)
            yield from (Axis(*variable, Family.PERIODIC, low, high, h, n) for h in TUNING.harmonics[:3] for n in counts)
            yield from (Axis(*variable, Family.PERIODIC, low, high, h, 3) for h in TUNING.harmonics)
        elif variable[0] is not Quantity.POSITION:
            yield Axis(*variable, Family.EVEN, low, high, 1.0, 1)
        if variable[0] is not Quantity.TIME:
            yield from (Axis(*variable, Family.POWER, low, high, power, 1) for power in (2.0, 3.0))
            yield from (Axis(*variable, Family.POWER, low, high, 0.0, count) for count in (2, 3, 4))

    def _turns(self, variable: Variable) -> bool:
        return variable[0] is Quantity.POSITION and not self.scene.robot.joints[variable[1] - 1].prismatic

    def _range(self, variable: Variable) -> tuple[float, float]:
        seen = self._value(variable)
        return float(seen.min()), float(seen.max())

    def _value(self, variable: Variable) -> Array:
        if variable not in self._values:
            axis = Axis(*variable, Family.POWER, 0.0, 1.0, 1.0, 1)
            self._values[variable] = values_of(self.scene.robot, self.scene.motion, self.scene.links)(axis)
        return self._values[variable]

    def _of_axis(self, axis: Axis) -> Array:
        if axis not in self._columns:
            self._columns[axis] = axis.columns(self._value(axis.variable))
        return self._columns[axis]

    def rows(self, form: Form) -> Array:
        """(N, p) columns."""
        return products([self._of_axis(axis) for axis in form.axes])

    def sd(self, form: Form) -> Array:
        """(p,) prior standard deviations of the amplitudes."""
        variance = np.full(1, form.size**2)
        for axis in form.axes:
            variance = np.outer(variance, self._variance(axis, form.length)).ravel()
        return np.sqrt(variance)

    def _variance(self, axis: Axis, length: float) -> Array:
        """(count,) variances of an axis' functions; those other than cosines are scaled to their RMS."""
        if (axis, length) not in self._variances:
            variance = axis.density(length)
            if axis.family is not Family.SMOOTH:
                variance = variance / scaled_to_one(self._of_axis(axis), self.used[:, self.joint - 1]) ** 2
            self._variances[axis, length] = variance
        return self._variances[axis, length]

    def hypothesis(self, form: Form) -> Hypothesis:
        """The effect of a single form."""
        weights = np.eye(form.counts)
        source = LearnedEffect.of(self.joint, [Component(form.axes, weights)], self.scene.links.tolist())
        return self._hypothesis(source, self.rows(form), self.sd(form))

    def _hypothesis(self, source: LearnedEffect, rows: Array, sd: Array) -> Hypothesis:
        columns = Columns({self.joint - 1: rows}, {}, sd, np.zeros(len(sd), dtype=bool))
        return Hypothesis(source, columns, self.make)

    def ranked(
        self, fitted_effects: FittedEffects, errors: Sequence[ErrorModel] | None = None, *, bounded: bool = False
    ) -> list[Learned]:
        """The most promising functions on top of a fit, one for each set of variables, best first.

        The first residual resembles slow noise, which hides slow functions. So functions are scored again with the
        error model after the best one. `bounded` functions are constant beyond the observed range.
        """
        again, regression = errors is not None, Regression.of(fitted_effects)
        regression = regression if errors is None else regression.weighed(errors)
        screened = self._best(regression, self.screened())
        promising = sorted(screened, key=lambda variables: -screened[variables][1])[
            : TUNING.variables_tried_again if again else TUNING.variables_tried
        ]
        forms = (form for variables in promising for form in self.forms(variables, fine=again))
        best = self._best(regression, (form for form in forms if form.bounded or not bounded))
        best |= self._best(regression, self._tuned([form for form, *_ in best.values()]))
        return self._looked_at(fitted_effects, regression.errors, best, float(np.log(len(screened))))

    def _looked_at(
        self,
        fitted_effects: FittedEffects,
        errors: Sequence[ErrorModel],
        best: Mapping[frozenset[Variable], tuple[Form, float, float]],
        price: float,
    ) -> list[Learned]:
        """The best functions with their own error models."""
        closer = []
        for chosen in sorted(best, key=lambda variables: -best[variables][1])[: TUNING.variables_rescored]:
            form, gain, best_gain = best[chosen]
            hypothesis = self.hypothesis(form)
            effects = (*fitted_effects.effects, hypothesis)
            extended = Regression(fitted_effects.data, effects, errors, fitted_effects.uncertain)
            extended = extended.weighed(extended.fitted_effects.errors)
            log_data, off = extended.fitted_effects.log_evidence - fitted_effects.log_evidence, best_gain - gain + price
            closer.append(Learned(form, hypothesis, log_data - off, off))
        return _fewest_variables_first(closer)

    def _best(
        self, regression: Regression, forms: Iterable[Form]
    ) -> dict[frozenset[Variable], tuple[Form, float, float]]:
        """For each set of variables: its best form, the gain averaged over its forms, and the best form's gain.

        Among equivalent forms, a law is preferred to a smooth function, and fewer columns to more.
        """
        gains: dict[frozenset[Variable], list[tuple[float, Form]]] = {}
        for form, gain in self._gains(regression, forms):
            gains.setdefault(form.variables, []).append((gain, form))
        found = {}
        for variables, tried in gains.items():
            most = max(gain for gain, _ in tried)
            near = ((gain, form) for gain, form in tried if gain > most - DECISIVE)
            best_gain, best = min(near, key=lambda scored: (scored[1].smooth, scored[1].counts, -scored[0]))
            found[variables] = (
                best,
                float(logsumexp([gain for gain, _ in tried])) - float(np.log(len(tried))),
                best_gain,
            )
        return found

    def _gains(self, regression: Regression, forms: Iterable[Form]) -> Iterator[tuple[Form, float]]:
        """Log Bayes factors of forms, over the grid of sizes and lengths."""
        by_size = sorted(forms, key=lambda form: form.counts)
        parts = list[list[Form]]()
        for count, group in groupby(by_size, key=lambda form: form.counts):
            together, most = list(group), max(1, TUNING.numbers_at_once // (count * len(self.used)))
            parts += [together[k : k + most] for k in range(0, len(together), most)]
        found = in_parallel([partial(self._gains_of, regression, part) for part in reversed(parts)])  # largest first
        return chain.from_iterable(reversed(found))

    def _gains_of(self, regression: Regression, forms: list[Form]) -> list[tuple[Form, float]]:
        found = list[tuple[Form, float]]()
        free = np.zeros(forms[0].counts, dtype=bool)
        columns = [Columns({self.joint - 1: self.rows(form)}, {}, np.ones(len(free)), free) for form in forms]
        gram, slope = regression.curvature(columns)
        for size, length in product(TUNING.sizes, TUNING.lengths):
            tried = [k for k, form in enumerate(forms) if form.smooth or length == TUNING.lengths[0]]
            if not tried:
                continue
            sized = [replace(forms[k], size=size * self._effort, length=length) for k in tried]
            scaled = [replace(columns[k], sd=self.sd(form)) for k, form in zip(tried, sized, strict=True)]
            gains, _ = integrated(gram[tried], slope[tried], scaled)
            found += zip(sized, gains.tolist(), strict=True)
        return found

    def merged(self, found: Sequence[Learned], amplitudes: Sequence[tuple[Array, Array]], number: int) -> Hypothesis:
        """One effect of several functions; smooth ones keep their fitted shape, scaled to an RMS of one.

        A new sign search must not change the shape. Each function has amplitudes (p,) with a covariance (p, p).
        `number` counts the learned effects of this joint.
        """
        used, components, parts = self.used[:, self.joint - 1], [], []
        for function, (amplitude, _) in zip(found, amplitudes, strict=True):
            weights = np.eye(len(amplitude)) if function.form.plain else amplitude[:, None]
            weights = weights / scaled_to_one(self.rows(function.form) @ weights, used)
            components.append(Component(function.form.axes, weights))
            parts.append(self.rows(function.form) @ weights)
        rows = np.column_stack(parts)
        source = LearnedEffect.of(self.joint, components, self.scene.links.tolist(), number)
        curves = tuple(_curve(function.form, *known) for function, known in zip(found, amplitudes, strict=True))
        return replace(self._hypothesis(source, rows, np.full(rows.shape[1], self._effort)), curves=curves)

    @cached_property
    def _effort(self) -> float:
        used = self.used[:, self.joint - 1]
        return float(np.sqrt(np.mean(self.scene.measured[used, self.joint - 1] ** 2)))


def _curve(form: Form, amplitude: Array, covariance: Array) -> Curve:
    """A function over its first variable, at some values of the second; forward motion."""
    free = [axis for axis in form.axes if axis.family is not Family.DIRECTION] or list(form.axes)
    turning = [axis for axis in form.axes if all(axis is not fixed for fixed in free)]
    x = np.linspace(free[0].low, free[0].high, _POINTS)
    levels = np.quantile([free[-1].low, free[-1].high], _LEVELS) if len(free) > 1 else np.zeros(1)
    mean, sd = [], []
    for level in levels:
        values = {id(free[-1]): np.full(_POINTS, level), id(free[0]): x}
        forwards = np.full(_POINTS, np.inf)
        columns = products([axis.columns(values.get(id(axis), forwards)) for axis in form.axes])
        mean.append(columns @ amplitude)
        sd.append(np.sqrt(np.maximum(np.sum((columns @ covariance) * columns, axis=1), 0.0)))
    named = [[symbol(*axis.variable) for axis in axes] for axes in (free[:1], free[1:], turning)]
    variable, other, turns = (" ".join(names) for names in named)
    return Curve(variable, other, turns, x, levels, np.array(mean), np.array(sd))


def _fewest_variables_first(found: Sequence[Learned]) -> list[Learned]:
    """Best first, without those that need more variables for less than a decisive gain."""
    return sorted(
        (candidate for candidate in found if not any(_needless(candidate, other) for other in found)),
        key=lambda candidate: -candidate.gain,
    )


def _needless(candidate: Learned, other: Learned) -> bool:
    return other.form.variables < candidate.form.variables and candidate.gain < other.gain + DECISIVE
