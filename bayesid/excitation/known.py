"""Posterior covariance of a result, and its prediction after one more recording.

The R quantities are the model's base coefficients and, where gains were unknowns, the logarithms of the gains. They are
normally distributed with the inverse covariance L of the result, which includes prior, cone and earlier logs. A
separate covariance M describes model error. After a recording of information H, the first covariance is

    P = (L + H)^-1.   (:eq:`next-covariance`)

M is zero if the model is right. All of it remains if the new recording is affected by the same model error. So there
are two predictions, P and P + M. A motion is designed by P, as no motion changes the model error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError, near_names
from bayesid.excitation.resolvability import expect, expected_segments, information_of, mistaken, resolvability
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import KNOWN, SURE
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.motion import Motion
from bayesid.regression.knowledge import inverse_of
from bayesid.robot import Robot
from bayesid.simulation.trajectories import INDUSTRIAL_ARM, MotionLimits, random_trajectory

_ROUNDING = 1e-12
"""Least eigenvalue of a scaled covariance, relative to the largest."""
_NONE = 1e-9
"""Share of a coefficient below which a parameter's is rounding."""


@dataclass(frozen=True)
class Known:
    """R quantities of a result, and what a motion shows of them."""

    model: Model  # robot and terms, without sensor distortions
    coefficients: BaseCoefficients  # its r base coefficients, the first of the quantities
    theta: Array  # (P,) its parameters
    names: tuple[str, ...]  # (R,) of the quantities; those of gains are log_gain1..n
    units: tuple[str, ...]  # (R,)
    mean: Array  # (R,) values
    precision: Array  # (R, R) L
    model_error_covariance: Array  # (R, R) M
    gains: Integers  # (g,) 0-based joints whose gains are among the quantities
    density: Array  # (n,) information of a second of efforts, 1/(N m)^2: independent samples over variance
    supposed: bool = False  # whether the prior of some coefficients is the spread over random plausible robots

    def __len__(self) -> int:
        return len(self.names)

    @property
    def memory(self) -> bool:
        """Whether a row of the model depends on other instants too."""
        return any(effect.memory for effect in self.model.effects)

    @property
    def undelayed(self) -> Known:
        """The same without the delay of logged efforts.

        A delay changes neither the information of a motion from rest to rest nor its limits, but it keeps state.
        """
        return replace(self, model=self.model.undelayed)

    def columns(self, motion: Motion) -> Array:
        """(N, n, R) N m per unit of each quantity, at the present gains."""
        every = self.model.columns(motion)
        columns = every[:, :, self.coefficients.selected]
        if not len(self.gains):
            return columns
        effort = every @ self.theta
        of_gains = np.zeros((*effort.shape, len(self.gains)))
        of_gains[:, self.gains, np.arange(len(self.gains))] = -effort[:, self.gains]
        return np.concatenate([columns, of_gains], axis=2)

    def weights(self, motion: Motion) -> Array:
        """(N, n) weight of each sample of an evenly sampled motion; zero where its actuator is at standstill."""
        actuators = self.model.robot.actuators(motion)
        moving: Mask = np.abs(actuators.dq) > actuators.standstill_speed
        return moving * (self.density * period_of(motion))

    def information(self, motion: Motion) -> Array:
        """(R, R) of a recording."""
        return information_of(self.columns(motion), self.weights(motion))

    def covariance(self, information: Array) -> Array:
        """(R, R) P after a recording of some information (R, R)."""
        return inverse_of(self.precision + information)

    @cached_property
    def now(self) -> Array:
        """(R, R) present covariance, including model error."""
        return inverse_of(self.precision) + self.model_error_covariance

    @cached_property
    def root(self) -> Array:
        """(R, R) of that covariance: it is root root'."""
        return root_of(self.now)

    def open(self, sd: Array) -> Mask:
        """(R,) whether standard deviations (R,) are more than `KNOWN` of the values; of logarithms, more than that."""
        relative = np.arange(len(self)) >= len(self.coefficients)
        return sd > KNOWN * np.where(relative, 1.0, np.abs(self.mean))


def known_of(identified: IdentifiedModel, rate: float) -> Known:
    """Posterior of an identified model; the new recording, at a rate in Hz, has the noise of the result's log."""
    model, noise, draws = identified.model.before_sensors, identified.noise.with_time_of_model(rate), identified.draws
    base, density = base_coefficients(model), rate / (noise.sigma**2 * noise.autocorrelation)
    beta, precision, none = base.project(identified.theta), identified.precision, np.empty(0, dtype=np.int64)
    nothing = np.zeros_like(precision)
    known = Known(model, base, identified.theta, base.names, base.units, beta, precision, nothing, none, density)
    if draws is None:
        known = replace(known, model_error_covariance=identified.beyond_precision)
        values = scaled_spectrum(precision)[0]
        if values[0] > _ROUNDING * values[-1]:
            return known
        return replace(known, precision=precision + np.diag(expect(model).size ** -2.0), supposed=True)
    drawn = base.project(draws.theta)
    if draws.log_gain is not None and (gains := np.flatnonzero(np.ptp(draws.log_gain, axis=0) > 0.0)).size:
        both = np.cov(np.hstack([drawn, draws.log_gain[:, gains]]), rowvar=False)
        return replace(
            known,
            names=(*base.names, *(f"log_gain{j + 1}" for j in gains)),
            units=(*base.units, *("" for _ in gains)),
            mean=np.concatenate([beta, draws.log_gain[:, gains].mean(axis=0)]),
            precision=inverse_of(_at_least(both, _ROUNDING)),
            model_error_covariance=np.zeros_like(both),
            gains=gains,
        )
    covariance = np.atleast_2d(np.cov(drawn, rowvar=False))
    if not precision.any():
        return replace(known, precision=inverse_of(_at_least(covariance, _ROUNDING)))
    model_error_covariance = identified.model_error_covariance
    if model_error_covariance is None:
        model_error_covariance = _beyond_sampling(covariance, precision, len(drawn))
    return replace(known, model_error_covariance=_at_least(model_error_covariance, 0.0))


def scaled_spectrum(matrix: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues and eigenvectors of a symmetric matrix, scaled to a diagonal of ones; its scale."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), TINY))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return values, vectors, scale


def root_of(matrix: Array, least: float = 0.0) -> Array:
    """(R, R) whose product with its transpose is a matrix, but for eigenvalues below a share of the largest."""
    values, vectors, scale = scaled_spectrum(matrix)
    root: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, least * values[-1]))
    return root


def _at_least(matrix: Array, least: float) -> Array:
    """A symmetric matrix whose scaled eigenvalues are no less than a share of the largest."""
    root = root_of(matrix, least)
    return root @ root.T


def _beyond_sampling(covariance: Array, precision: Array, draws: int) -> Array:
    """(R, R) by which the covariance of some draws is more than an inverse covariance L says, but by chance.

    Of K draws that are as L says, the scaled covariance has eigenvalues up to (1 + sqrt(R / K))^2 (Marchenko and
    Pastur, 1967). A true l > 1 + sqrt(R / K) comes out as l + l (R / K) / (l - 1) (Baik and Silverstein, Eigenvalues of
    large sample covariance matrices of spiked population models, 2006), which is undone; a smaller one is not seen.
    """
    share, root = len(covariance) / draws, root_of(precision)
    found, turn = np.linalg.eigh(root.T @ covariance @ root)
    more = found > TUNING.chance * (1.0 + np.sqrt(share)) ** 2
    middle = 0.5 * (found[more] + 1.0 - share)
    true = middle + np.sqrt(middle**2 - found[more])
    across = inverse_of(precision) @ root @ turn[:, more]
    return (across * (true - 1.0)) @ across.T


def period_of(motion: Motion) -> float:
    """Seconds from one of its even samples to the next."""
    return float(motion.t[-1] - motion.t[0]) / max(len(motion) - 1, 1)


def certain_share(known: Known, motion: Motion) -> float:
    """Share of the |effort| in motion, each joint alike, in segments whose sign will be sure to 99 %.

    A segment's sign is doubtful where flipping it costs little (:eq:`resolvability`); prior information counts as data.
    Segments end where effort or speed change their sign. They are flipped one by one.
    """
    columns, weights, r = known.columns(motion), known.weights(motion), len(known.coefficients)
    effort, speed = columns[:, :, :r] @ known.mean[:r], known.model.robot.actuators(motion).dq
    joint, start, _, gradient, energy = expected_segments(columns, effort, speed, weights)
    left = known.covariance(information_of(columns, weights))
    certain = mistaken(resolvability(left, gradient, energy)) <= 1.0 - SURE
    n_samples, n = effort.shape
    size = np.add.reduceat((np.abs(effort) * (weights > 0.0)).T.ravel(), joint * n_samples + start)
    whole, sure = np.bincount(joint, size, n), np.bincount(joint, size * certain, n)
    moving = whole > 0.0
    return float((sure[moving] / np.maximum(whole[moving], TINY)).mean()) if moving.any() else 0.0


# ---- Goal of the next motion ----
@dataclass(frozen=True)
class Goal:
    """m linear combinations of quantities to be determined."""

    names: tuple[str, ...]  # (m,)
    forms: Array  # (m, R) coefficients of the combinations
    required_sd: Array  # (m,) sufficient standard deviations
    never: tuple[str, ...] = ()  # sentences on what is not identifiable

    def left(self, covariance: Array) -> Array:
        """(m, m) covariance of the combinations over the required sd, from that of the quantities (R, R)."""
        forms = self.forms / self.required_sd[:, None]
        return forms @ covariance @ forms.T

    def spread(self, covariance: Array) -> float:
        """Log det(1 + W^-1 F C F' W^-1): twice the remaining information about the combinations F, in nats.

        See :eq:`next-information`. D-optimality, except that a combination known to its required sd hardly counts
        (Chaloner and Verdinelli, Bayesian Experimental Design: A Review, 1995, section 2.2).
        """
        left = self.left(covariance)
        return float(np.linalg.slogdet(np.eye(len(left)) + left)[1])

    def mean_variance(self, covariance: Array) -> float:
        """Mean variance of the combinations over the required variance: A-optimality (ibid., section 2.3)."""
        return float(np.trace(self.left(covariance)) / len(self.required_sd))

    def gain(self, before: Array, after: Array) -> float:
        """Information gain of a recording about the combinations, nats, from covariances (R, R) before and after it."""
        return 0.5 * (self.spread(before) - self.spread(after))


CRITERIA = {"D": Goal.spread, "A": Goal.mean_variance}
"""By name; the less, the better."""


def open_coefficients(known: Known) -> list[int]:
    """Coefficients whose standard deviation is more than `KNOWN` of their value."""
    return np.flatnonzero(known.open(np.sqrt(np.diag(known.now)))[: len(known.coefficients)]).tolist()


def goal_of(known: Known, about: Sequence[str] = (), payload: str = "") -> Goal:
    """The goal for some names.

    Args:
        known: the result.
        about: names of coefficients, parameters, effects, or `gains`, `payload`, `signs`; by default all
            that are undetermined.
        payload: label of what the flange carries.

    Raises:
        InputError: a name is unknown, or none of the quantities is identifiable.
    """
    parts = [_named(known, name, payload) for name in about]
    if not about:
        parts = [_of_places(known, open_coefficients(known) or list(range(len(known.coefficients))))]
        parts += [_gains(known)] * (len(known.gains) > 1)
    names = [name for part in parts for name in part.names]
    never = tuple(dict.fromkeys(sentence for part in parts for sentence in part.never))
    if not names:
        raise InputError("; ".join(never), field="about", remedy="name an identifiable quantity")
    first = [names.index(name) for name in dict.fromkeys(names)]
    forms, required_sd = (
        np.concatenate(each)[first] for each in zip(*((part.forms, part.required_sd) for part in parts), strict=True)
    )
    return Goal(tuple(names[k] for k in first), forms, required_sd, never)


def _of_places(known: Known, chosen: list[int], never: tuple[str, ...] = ()) -> Goal:
    sd = np.sqrt(np.diag(known.now))
    required_sd = np.maximum(KNOWN * np.abs(known.mean), 1e-6 * sd)  # of a quantity that is zero, below every gain
    return Goal(tuple(known.names[k] for k in chosen), np.eye(len(known))[chosen], required_sd[chosen], never)


def _named(known: Known, name: str, payload: str) -> Goal:
    special: dict[str, Callable[[Known], Goal]]
    special = {"gains": _gains, "payload": partial(_payload, payload=payload), "signs": _signs}
    if name in special:
        return special[name](known)
    coefficients, parameters = known.coefficients, [parameter.name for parameter in known.model.parameters]
    if name in coefficients.names:
        place = coefficients.names.index(name)
        behind = coefficients.expressions[place]
        said = f"{name} is not identifiable alone, only the combination {behind}; this is the goal"
        return _of_places(known, [place], () if behind == name else (said,))
    if name in parameters:
        holding = _holding(known, [parameters.index(name)])
        if not holding:
            return _of_places(known, [], (f"{name} is not identifiable: efforts do not depend on it",))
        names = ", ".join(known.names[k] for k in holding)
        said = f"{name} is not identifiable alone, only the combinations {names}; these are the goal"
        return _of_places(known, holding, (said,))
    for term, places in zip(known.model.terms, known.model.places, strict=True):
        if name in (term.name, term.effect):
            return _of_places(known, _holding(known, places))
    near = near_names(name, [*coefficients.names, *parameters, *(t.effect for t in known.model.terms), *special])
    alike = [one for one in coefficients.names if one[:2] == name[:2]][:6] or coefficients.names[:6]
    remedy = f"name coefficients ({', '.join(alike)}, ..), effects, gains, payload or signs"
    raise InputError(f"{name!r} is not a quantity of the model", field="about", remedy=f"{near} {remedy}".strip())


def _holding(known: Known, places: slice | list[int]) -> list[int]:
    """Coefficients that hold parameters of some places."""
    shares = np.abs(known.coefficients.projection[:, places])
    return np.flatnonzero(shares.max(axis=1, initial=0.0) > _NONE).tolist()


def _gains(known: Known) -> Goal:
    """Ratios of gains to the first unknown one; their common factor is not identifiable from a motion."""
    count, r = len(known.gains), len(known.coefficients)
    if not count:
        return _of_places(known, [], ("the result's gains are exact: nothing to estimate",))
    forms = np.zeros((count - 1, len(known)))
    forms[:, r] = -1.0
    forms[np.arange(count - 1), r + 1 + np.arange(count - 1)] = 1.0
    first = int(known.gains[0]) + 1
    names = tuple(f"gain{j + 1}/gain{first}" for j in known.gains[1:])
    never = (
        "no motion determines the common factor of the gains; a payload of known mass does (--payload KG~SD@LOG), or "
        "one exact gain",
    )
    return Goal(names, forms, np.full(count - 1, KNOWN), never)


def _payload(known: Known, payload: str) -> Goal:
    labels = known.model.payloads
    if labels and not payload:
        said = f"the result has payloads {', '.join(labels)}, the motion has none"
        remedy = f"give the payload that is recorded with it, as {labels[0]}"
        raise InputError(said, "payload", remedy, field="about")
    terms, n = zip(known.model.terms, known.model.places, strict=True), known.model.robot.n_joints
    own = [place for term, place in terms if payload in term.payloads or term.needs_earlier]
    if own:
        return _of_places(known, _holding(known, [k for place in own for k in range(place.start, place.stop)]))
    never = (
        "a payload is not distinguishable from the last link in one recording: record once without and once with it "
        "(--payload LABEL@LOG, or `bayesid payload`)",
    )
    last = [k for k, one in enumerate(known.model.parameters) if one.joint == n and one.name[:1] in "mJ"]
    return _of_places(known, _holding(known, last), never)


def _signs(known: Known) -> Goal:
    """Efforts of a random motion, as combinations of coefficients in units of the noise.

    A sign is certain where the error of the predicted effort is small compared with the effort.
    """
    motion = usual_motion(known.model.robot)
    forms = root_of(known.information(motion) / (motion.t[-1] - motion.t[0])).T
    names = tuple(f"effort{k + 1}" for k in range(len(forms)))
    never = ("motion design did not improve signs in 291 simulated logs",)
    return Goal(names, forms, np.full(len(forms), TUNING.sign), never)


def usual_motion(robot: Robot, limits: MotionLimits = INDUSTRIAL_ARM, duration: float | None = None) -> Motion:
    """A random motion within the limits, over a duration in s, used as the reference."""
    usual, rate = TUNING.usual_motion
    duration = usual if duration is None else duration
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    return random_trajectory(robot.n_joints, duration, limits=limits).motion(t)
