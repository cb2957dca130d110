"""A model on a log: its columns, the hypotheses of effects, and the model with effects added.

Distortions are nonlinear in their numbers, so they are linearised about the fitted values several times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.distortion import Distortion
from bayesid.effects.effect import Effect, Scene
from bayesid.effects.kinematic_errors import is_distal, shift, turn, with_joint, with_link
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.parallel import in_parallel
from bayesid.regression.knowledge import CoefficientPrior, InformationMatrix, KinematicTolerance
from bayesid.regression.selection.columns import Columns, Whitening
from bayesid.regression.selection.fitted_effects import FittedEffects, Observations, Thresholds
from bayesid.regression.selection.hypotheses import Hypothesis, maker
from bayesid.regression.selection.regression import Effects, Regression, explain
from bayesid.regression.tuning import TUNING
from bayesid.robot import Robot

KINEMATICS: tuple[str, tuple[int, ...]] = ("kinematics", ())
"""Key of the robot's geometry among effects."""


class Geometry(Effect):
    """Error of the robot's geometry; always present, and not in the catalogue."""

    name = KINEMATICS[0]


@dataclass(frozen=True, eq=False)
class ModelledLog:
    """A log and a model of its robot; the signs of the efforts are given separately."""

    knowledge: CoefficientPrior  #: of the model's parameters, from an earlier log; of precision zero without one
    coefficients: BaseCoefficients  #: the model's r base coefficients
    motion: Motion  #: N instants
    magnitude: Array  #: (N, n) absolute values of the unfiltered efforts, N m
    used: Mask  #: (N, n) samples that count
    rate: float  #: Hz

    @property
    def model(self) -> Model:
        """The model without added effects."""
        return self.knowledge.model

    @cached_property
    def columns(self) -> Array:
        """(N, n, r) regressor of the base coefficients, unused samples included."""
        return self.model.columns(self.motion)[:, :, self.coefficients.selected]

    @cached_property
    def information(self) -> InformationMatrix:
        """Information of the earlier log on the base coefficients."""
        return self.knowledge.information(self.model, self.coefficients)

    @cached_property
    def _whitening(self) -> Whitening:
        return Whitening(self.columns * self.used[:, :, None], self.used)

    def observed(
        self, effort: Array, *, floor: Array, reliable: Mask, limits: Array, thresholds: Thresholds = Thresholds()
    ) -> Observations:
        """The log with efforts (N, n) in their expected signs, N m; other arguments as in `Observations`."""
        return Observations(
            whitening=self._whitening,
            effort=effort * self.used,
            information=self.information,
            floor=floor,
            reliable=reliable,
            limits=limits,
            rate=self.rate,
            thresholds=thresholds,
        )

    def scene(self, effort: Array) -> Scene:
        """Input of effects, for efforts (N, n) of model and terms, N m."""
        return self.model.scene(self.motion, self.knowledge.theta, effort, self.magnitude)

    def maker(self, scene: Scene) -> Callable[[Effect], Hypothesis]:
        """A function that makes the hypothesis of an effect."""
        return maker(self.model, scene, self.used)

    def geometry(self, tolerance: KinematicTolerance, *, known: bool = False) -> Columns:
        """Columns of errors of the robot's geometry, in units of the tolerance (see `kinematic_columns`)."""
        links = self.model.links(self.knowledge.theta).ravel()
        return Columns.of_joints(kinematic_columns(self.model.robot, self.motion, links, tolerance, known=known))

    def effort(self, fitted_effects: FittedEffects, *, distorted: bool = True) -> Array:
        """(N, n) efforts of a fit, N m; undistorted: of model and terms only."""
        return self.effort_of(fitted_effects.beta, fitted_effects.parts, distorted=distorted)

    def effort_of(self, beta: Array, parts: Iterable[tuple[Hypothesis, Array]], *, distorted: bool) -> Array:
        """The same from coefficients (r,), and effects with their amplitudes."""
        effort: Array = self.columns @ beta
        for effect, amplitude in parts:
            if distorted or effect.source.linear:
                for j, rows in effect.columns.rows.items():
                    effort[:, j] += rows @ amplitude
                for j, change in effect.columns.shift.items():
                    effort[:, j] += change
        return effort

    def sharpened(self, data: Observations, effects: Sequence[Hypothesis]) -> FittedEffects:
        """A fit with the effects, distortions linearised about their fitted numbers."""
        fitted_effects = explain(data, effects)
        for _ in range(TUNING.relinearisations):
            if not _moves(fitted_effects):
                break
            scene, parts = self.scene(self.effort(fitted_effects, distorted=False)), fitted_effects.parts
            moved = [h if h.source.linear else replace(h, source=h.source.moved(a)) for h, a in parts]
            fitted_effects = explain(data, about(moved, scene), fitted_effects)
        return fitted_effects

    def sharper(self, regression: Regression, chosen: Effects) -> Mapping[int, Hypothesis]:
        """Chosen distortions linearised about the current fit, by the ids of their old forms."""
        if all(effect.source.linear for effect in chosen):
            return {}
        new = self.sharpened(regression.data, chosen).effects
        return {id(old): form for old, form in zip(chosen, new, strict=True)}

    def extended(self, fitted_effects: FittedEffects) -> Extension:
        """The model with the effects of a fit added."""
        knowledge, model, coefficients = self.knowledge, self.model, self.coefficients
        names = [parameter.name for parameter in model.parameters]
        without_trace = knowledge.theta - coefficients.lift(coefficients.project(knowledge.theta))
        theta = coefficients.lift(fitted_effects.beta) + without_trace
        added: list[Array] = []
        for hypothesis, amplitude in fitted_effects.parts:
            if hypothesis.changes:
                theta[[names.index(name) for name in hypothesis.changes]] += amplitude
                knowledge = knowledge.widened(hypothesis.changes, hypothesis.columns.sd, coefficients)
            else:
                model = model.extend(hypothesis.source.moved(amplitude))
                added.append(amplitude[: len(hypothesis.source.parameters(model.robot))])
        return Extension(model, knowledge, np.concatenate([theta, *added]))


def _moves(fitted_effects: FittedEffects) -> bool:
    """Whether a distortion's numbers or columns still change by more than the tolerance."""
    distortions = [(effect, amplitude) for effect, amplitude in fitted_effects.parts if not effect.source.linear]
    if any(isinstance(effect.source, Distortion) and effect.source.of_effort for effect, _ in distortions):
        return True
    return any(np.any(np.abs(amplitude) > TUNING.unchanged * effect.columns.sd) for effect, amplitude in distortions)


def about(effects: Sequence[Hypothesis], scene: Scene) -> list[Hypothesis]:
    """The effects linearised about a scene and their own numbers."""
    return [_relinearised(effect, scene) for effect in effects]


def _relinearised(effect: Hypothesis, scene: Scene) -> Hypothesis:
    if effect.source.linear:
        return effect
    change, columns = effect.source.change(scene)
    acting = sorted(effect.columns.joints)
    rows = {j: columns[:, j] for j in acting} if columns.shape[2] else {}
    return replace(effect, columns=replace(effect.columns, rows=rows, shift={j: change[:, j] for j in acting}))


@dataclass(frozen=True)
class Extension:
    """A model with effects added.

    The prior from the earlier log is wider where an effect changes existing parameters. The parameters theta (P,) give
    the efforts of the fit, but need not be feasible.
    """

    model: Model
    knowledge: CoefficientPrior
    theta: Array


_STEP = 1e-5
"""Step of the central differences, m and rad: their relative error is its square; rounding is 1e-10 of the effort."""
_Move = Callable[[Array, float], Array]
"""A step along or about an axis (3,), as a matrix (4, 4)."""


def kinematic_columns(
    robot: Robot, motion: Motion, links: Array, tolerance: KinematicTolerance, *, known: bool = False
) -> Array:
    """(N, n, k) efforts per standard deviation of each position and direction of the robot's geometry, N m.

    Each joint moves along and about the axes of its frame. The standard convention has link frames at the next joint;
    so the base moves too, and each row's d, theta, a and alpha, with the parameters (10 n,) about these frames.
    `known`: base and parameters stay, as another log determines them.
    """

    def column(move: _Move, axis: Array, moved: Callable[[Array], Robot], sd: float) -> Array:
        there, back = (moved(move(axis, step)).inverse_dynamics(motion, links) for step in (_STEP, -_STEP))
        return sd * (there - back) / (2.0 * _STEP)

    sds: dict[_Move, float] = {shift: tolerance.length, turn: tolerance.angle}
    places = [place for place in _displacements(robot, known=known) if sds[place[0]] > 0.0]
    columns = in_parallel([partial(column, *place, sds[place[0]]) for place in places])
    return np.stack(columns, axis=2) if columns else np.zeros((len(motion), robot.n_joints, 0))


def _displacements(robot: Robot, *, known: bool) -> Iterator[tuple[_Move, Array, Callable[[Array], Robot]]]:
    """Shifts and rotations, their axes, and the robot with one part moved."""
    distal = not known and is_distal(robot)
    for i in range(1 if known else 0, 1 if distal else robot.n_joints):
        for move in (shift, turn):
            for axis in np.eye(3):
                yield move, axis, partial(with_joint, robot, i)
    for i in range(robot.n_joints if distal else 0):
        for axis, first in ((robot.joints[i].axis, True), (np.array([1.0, 0.0, 0.0]), False)):
            for move in (shift, turn):
                yield move, axis, partial(with_link, robot, i, first=first)
