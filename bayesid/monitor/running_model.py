"""An identified model at one instant after the other: efforts, how certain they are, and external torques.

External torques by the generalised momentum (De Luca and Mattone 2003; Haddadin, De Luca, Albu-Schaeffer 2017).
The momentum p = M(q) dq changes by what motors and surroundings do::

    p' = tau + C'dq - g - f + tau_ext,

f friction and the like. Its observer r' = K (p' - (tau + C'dq - g - f) - r) follows tau_ext with a lag of 1 / K, and
needs no acceleration.
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
class AtInstant:
    """The model at an instant."""

    effort: Array  # (n,) as it is read, N m
    momentum: Array  # (n,) of the joints, N m s
    driving: Array  # (n,) what changes the momentum beside the motors: C'dq - g - f, N m
    inertia: Array  # (n, n) of joints and rotors, kg m^2


@dataclass(frozen=True)
class RunningModel:
    """An identified model, made ready."""

    identified: IdentifiedModel  # model, parameters and their uncertainty
    payload: str = ""  # label of what the flange carries; empty where it carries nothing

    @property
    def model(self) -> Model:
        """Robot, terms and distortions."""
        return self.identified.model

    def instant(self, t: float, q: Array, dq: Array, ddq: Array) -> Instant:
        """One instant of a motion, each (n,), by itself: effects remember nothing of it."""
        return Instant(np.array([t]), q[None], dq[None], ddq[None], t, self.label)

    def at(self, instant: Instant) -> AtInstant:
        """The model at one instant."""
        effort, late = self.model.effort_at(instant, self.identified.theta)[0], instant.ago(self.model.lag)
        here = self.model.robot.dynamics(late, self._links)
        inertia = here.mass + self._rotors
        torque = effort if self.model.robot.transmission is None else self.to_joints @ effort
        friction = torque - here.torque - self._rotors @ late.ddq[0]
        return AtInstant(effort, inertia @ late.dq[0], here.drift - friction, inertia)

    @cached_property
    def standstill(self) -> Array:
        """(n,) speeds of the actuators below which friction's direction is not known, rad/s.

        Over which dry friction is smoothed; zero of one that has none.
        """
        n, speeds = self.model.robot.n_joints, np.zeros(self.model.robot.n_joints)
        for effect in self.model.effects:
            for j, speed in zip(effect.acting(n), getattr(effect, "smoothing", ()), strict=False):
                speeds[j] = max(speeds[j], speed)
        return speeds

    def resting_speeds(self, top: Array) -> Array:
        """(n,) speeds below which actuators stand still, rad/s, by their highest (n,) where one has no dry friction."""
        return np.where(self.standstill > 0.0, self.standstill, STANDSTILL * top)

    def actuator_speeds(self, dq: Array) -> Array:
        """(n,) of joint speeds dq (n,), rad/s."""
        return dq if self.model.robot.transmission is None else self.model.robot.coupling @ dq

    def doubt_near_rest(self, speeds: Array) -> Array:
        """(n,) between 0 and 1: how much the direction of friction is in doubt."""
        share = speeds / (TUNING.near_rest * np.maximum(self.standstill, 1e-12))
        return np.exp(-share * share)

    def dry_friction(self, q: Array) -> Array:
        """(n,) by how much friction's direction changes the efforts at positions q (n,), N m: half of a reversal."""
        still = np.zeros_like(q)
        slow = TUNING.slow * np.linalg.solve(self.model.robot.coupling, self.standstill).astype(float)
        forth, back = (self._effort(q, sign * slow, still) for sign in (1.0, -1.0))
        return np.asarray(0.5 * np.abs(forth - back))

    @cached_property
    def body(self) -> slice:
        """Columns of first moments and mass of the last link, and of what it carries."""
        pairs = zip(self.model.terms, self.model.places, strict=True)
        place = next(place for term, place in pairs if term.of_links)
        return slice(place.stop - 4, place.stop)

    @cached_property
    def label(self) -> Labels:
        """(1,) of what the flange carries."""
        return labels(self.payload, 1)

    @cached_property
    def to_joints(self) -> Array:
        """(n, n) from efforts of actuators to torques of joints."""
        return np.ascontiguousarray(self.model.robot.coupling.T)

    def _effort(self, q: Array, dq: Array, ddq: Array) -> Array:
        """(n,) before sensors read it, N m."""
        effort = self.model.before_sensors.effort_at(self.instant(0.0, q, dq, ddq), self.identified.theta)
        return np.asarray(effort[0])

    @cached_property
    def _links(self) -> Array:
        return self.model.links(self.identified.theta).ravel()

    @cached_property
    def _rotors(self) -> Array:
        """(n, n) inertia of the joints that is none of the links, kg m^2: the same in every pose."""
        n = self.model.robot.n_joints
        zero = np.zeros(n)
        resting = self._effort(zero, zero, zero)
        moved = [self._effort(zero, zero, one) - resting for one in np.eye(n)]
        here = self.model.robot.dynamics(self.instant(0.0, zero, zero, zero), self._links)
        return self.to_joints @ np.stack(moved, axis=1) - here.mass


@dataclass
class Observed:
    """State of the observer."""

    external: Array  # (n,) r, N m
    momentum: Array  # (n,) p at the last sample; nan before the first one
    lasting: Array  # (n,) sd of what lasts in r, N m: model error and what the motion leaves open
    fast: Array  # (n,) variance of what the readings' noise leaves in r, (N m)^2
    bounded: Array  # (n,) what friction of unknown direction leaves in r at most, N m

    @classmethod
    def begin(cls, n: int) -> Observed:
        """Before the first sample."""
        return cls(np.zeros(n), np.full(n, np.nan), *np.zeros((3, n)))

    def add(self, step: float, momentum: Array, driving: Array, doubt: tuple[Array, Array, Array]) -> None:
        """One more sample: implicit in r, so that no step is too long.

        Args:
            step: since the last sample, s.
            momentum: (n,) p, N m s.
            driving: (n,) tau + C'dq - g - f, N m.
            doubt: (n,) sd of what is wrong with that for a while, and from sample to sample, and the largest error of
                friction whose direction is not known, N m.
        """
        lasting, white, bounded = doubt
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
        """(n,) size of an external torque that is no error, N m: some standard deviations, and what friction may do."""
        return np.asarray(deviations * np.sqrt(self.lasting * self.lasting + self.fast) + self.bounded)
