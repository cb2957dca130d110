"""An identified model evaluated sample by sample: efforts, their uncertainty, and external torques.

External torques are estimated by a momentum observer (De Luca and Mattone 2003; Haddadin, De Luca, Albu-Schaeffer
2017). The generalised momentum p = M(q) dq obeys::

    p' = tau + C'dq - g - f + tau_ext,

f friction and similar terms. The observer r' = K (p' - (tau + C'dq - g - f) - r) follows tau_ext with a lag of 1 / K,
and needs no acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isnan

import numpy as np

from bayesid.arrays import Array, Labels
from bayesid.effects.model import Model
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.monitor.tuning import TUNING
from bayesid.motion import STANDSTILL, Instant, labels


@dataclass(frozen=True)
class ModelAtInstant:
    """The model at an instant."""

    effort: Array  # (n,) of the actuators, as sensors read it, N m
    momentum: Array  # (n,) of the joints, N m s
    driving: Array  # (n,) rate of the momentum without motors: C'dq - g - f, N m
    inertia: Array  # (n, n) of joints and rotors, kg m^2


@dataclass(frozen=True)
class RunningModel:
    """An identified model with cached constants."""

    identified: IdentifiedModel  # model, parameters and their uncertainty
    payload: str = ""  # label of the payload on the flange; empty without one

    @property
    def model(self) -> Model:
        """Robot, terms and distortions."""
        return self.identified.model

    def instant(self, t: float, q: Array, dq: Array, ddq: Array) -> Instant:
        """A single instant of a motion, each (n,), without a past for effects with a memory."""
        return Instant(np.array([t]), q[None], dq[None], ddq[None], t, self.label)

    def at(self, instant: Instant) -> ModelAtInstant:
        """The model at one instant."""
        effort, late = self.model.effort_at(instant, self.identified.theta)[0], instant.ago(self.model.lag)
        here = self.model.robot.dynamics(late, self._links)
        inertia = here.mass + self._rotors
        torque = effort if self.model.robot.transmission is None else self.to_joints @ effort
        friction = torque - here.torque - self._rotors @ late.ddq[0]
        return ModelAtInstant(effort, inertia @ late.dq[0], here.drift - friction, inertia)

    @cached_property
    def standstill(self) -> Array:
        """(n,) speeds of the actuators below which the direction of friction is unknown, rad/s.

        They are those over which dry friction is smoothed; zero for an actuator without dry friction.
        """
        n, speeds = self.model.robot.n_joints, np.zeros(self.model.robot.n_joints)
        for effect in self.model.effects:
            for j, speed in zip(effect.acting(n), getattr(effect, "smoothing", ()), strict=False):
                speeds[j] = max(speeds[j], speed)
        return speeds

    def resting_speeds(self, top: Array) -> Array:
        """(n,) speeds below which actuators stand still, rad/s; without dry friction a share of their highest (n,)."""
        return np.where(self.standstill > 0.0, self.standstill, STANDSTILL * top)

    def actuator_speeds(self, dq: Array) -> Array:
        """(n,) from joint speeds dq (n,), rad/s."""
        return dq if self.model.robot.transmission is None else self.model.robot.coupling @ dq

    def doubt_near_rest(self, speeds: Array) -> Array:
        """(n,) uncertainty of the direction of friction, 0 to 1."""
        share = speeds / (TUNING.near_rest * np.maximum(self.standstill, 1e-12))
        return np.exp(-share * share)

    def dry_friction(self, q: Array) -> Array:
        """(n,) half the change of the efforts when motion reverses slowly at positions q (n,), N m."""
        zero = np.zeros_like(q)
        slow = TUNING.slow * np.linalg.solve(self.model.robot.coupling, self.standstill).astype(float)
        forwards, backwards = (self._effort(q, sign * slow, zero) for sign in (1.0, -1.0))
        return np.asarray(0.5 * np.abs(forwards - backwards))

    @cached_property
    def body(self) -> slice:
        """Columns of first moments and mass of the last link, which are those of a payload too."""
        pairs = zip(self.model.terms, self.model.places, strict=True)
        place = next(place for term, place in pairs if term.of_links)
        return slice(place.stop - 4, place.stop)

    @cached_property
    def label(self) -> Labels:
        """(1,) label of the payload."""
        return labels(self.payload, 1)

    @cached_property
    def to_joints(self) -> Array:
        """(n, n) from efforts of actuators to torques of joints."""
        return np.ascontiguousarray(self.model.robot.coupling.T)

    def _effort(self, q: Array, dq: Array, ddq: Array) -> Array:
        """(n,) before the sensors, N m."""
        effort = self.model.before_sensors.effort_at(self.instant(0.0, q, dq, ddq), self.identified.theta)
        return np.asarray(effort[0])

    @cached_property
    def _links(self) -> Array:
        return self.model.links(self.identified.theta).ravel()

    @cached_property
    def _rotors(self) -> Array:
        """(n, n) inertia of the joints beside the links, kg m^2: the same in every pose."""
        n = self.model.robot.n_joints
        zero = np.zeros(n)
        at_rest = self._effort(zero, zero, zero)
        changes = [self._effort(zero, zero, unit) - at_rest for unit in np.eye(n)]
        here = self.model.robot.dynamics(self.instant(0.0, zero, zero, zero), self._links)
        return self.to_joints @ np.stack(changes, axis=1) - here.mass


@dataclass
class MomentumObserver:
    """State of the observer."""

    external: Array  # (n,) r, N m
    momentum: Array  # (n,) p at the last sample; nan before the first one
    lasting: Array  # (n,) sd of slow errors of r, from model and motion, N m
    fast: Array  # (n,) variance of r by the noise of the readings, (N m)^2
    bounded: Array  # (n,) largest error of r by friction of unknown direction, N m

    @classmethod
    def begin(cls, n: int) -> MomentumObserver:
        """Before the first sample."""
        return cls(np.zeros(n), np.full(n, np.nan), *np.zeros((3, n)))

    def add(self, step: float, momentum: Array, driving: Array, errors: tuple[Array, Array, Array]) -> None:
        """Adds a sample, implicitly in r, so that any step is stable.

        Args:
            step: since the last sample, s.
            momentum: (n,) p, N m s.
            driving: (n,) tau + C'dq - g - f, N m.
            errors: (n,) of `driving`: sd of slow errors, sd of white noise, and the largest error of friction of
                unknown direction, N m.
        """
        lasting, white, bounded = errors
        share = TUNING.observer * step / (1.0 + TUNING.observer * step)
        if isnan(self.momentum[0]):
            self.lasting, self.bounded = lasting, bounded
        else:
            change = momentum - self.momentum - step * driving
            self.external = (1.0 - share) * (self.external + TUNING.observer * change)
            self.lasting = self.lasting + share * (lasting - self.lasting)
            self.bounded = self.bounded + share * (bounded - self.bounded)
            white = share * white
            self.fast = (1.0 - share) ** 2 * self.fast + white * white
        self.momentum = momentum

    def threshold(self, deviations: float) -> Array:
        """(n,) size from which an external torque is a contact, N m: some sd, and the largest error by friction."""
        return np.asarray(deviations * np.sqrt(self.lasting * self.lasting + self.fast) + self.bounded)
