"""What is open in a result and a next motion is to settle; and what no motion can tell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, near_names
from bayesid.excitation.known import Known
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import KNOWN
from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.simulation.trajectories import INDUSTRIAL_ARM, MotionLimits, random_trajectory

GAINS, PAYLOAD, SIGNS = "gains", "payload", "signs"
"""Names of the goals that are no coefficients."""
_NONE = 1e-9
"""Share of a coefficient below which a parameter's is rounding."""


@dataclass(frozen=True)
class Goal:
    """m sums of quantities that are to become known."""

    names: tuple[str, ...]  # (m,)
    forms: Array  # (m, R) sums of the quantities
    wanted: Array  # (m,) standard deviations that are enough
    never: tuple[str, ...] = ()  # sentences on what no motion can tell

    def left(self, covariance: Array) -> Array:
        """(m, m) covariance of the sums over what is wanted of them, of the quantities' (R, R)."""
        forms = self.forms / self.wanted[:, None]
        return forms @ covariance @ forms.T


def information_gain(goal: Goal, before: Array, after: Array) -> float:
    """Nats that a recording tells of the sums, seen as well as they are wanted, from covariances (R, R) of it."""
    return 0.5 * (log_spread(goal, before) - log_spread(goal, after))


def log_spread(goal: Goal, covariance: Array) -> float:
    """The logarithm of det(1 + W^-1 F C F' W^-1): twice what is left to be told of the sums F (:eq:`next-information`).

    D-optimal, but that a sum which is known as well as it is wanted counts no more (Chaloner and Verdinelli, Bayesian
    Experimental Design: A Review, 1995, section 2.2).
    """
    left = goal.left(covariance)
    return float(np.linalg.slogdet(np.eye(len(left)) + left)[1])


def mean_variance(goal: Goal, covariance: Array) -> float:
    """Mean variance of the sums over what is wanted: A-optimal (ibid., section 2.3)."""
    return float(np.trace(goal.left(covariance)) / len(goal.wanted))


CRITERIA = {"D": log_spread, "A": mean_variance}
"""By name; the less, the better."""


def open_coefficients(known: Known) -> list[int]:
    """Coefficients whose standard deviation is more than `KNOWN` of their value."""
    sd = np.sqrt(np.diag(known.now))
    count = len(known.coefficients)
    return np.flatnonzero(sd[:count] > KNOWN * np.abs(known.mean[:count])).tolist()


def goal_of(known: Known, about: Sequence[str] = (), payload: str = "") -> Goal:
    """What is asked for.

    Args:
        known: the result.
        about: names of coefficients, parameters, effects, or `gains`, `payload`, `signs`; without any all that is open.
        payload: label of what the flange carries.

    Raises:
        InputError: there is none of a name.
    """
    if not about:
        places = open_coefficients(known) or list(range(len(known.coefficients)))
        parts = [_of_places(known, places), *([_gains(known)] if len(known.gains) > 1 else [])]
        return _joined(parts)
    return _joined([_named(known, name, payload) for name in about])


def _joined(parts: Sequence[Goal]) -> Goal:
    sums: dict[str, tuple[Array, float]] = {}
    for part in parts:
        for name, form, size in zip(part.names, part.forms, part.wanted.tolist(), strict=True):
            sums.setdefault(name, (form, size))
    never = tuple(dict.fromkeys(sentence for part in parts for sentence in part.never))
    if not sums:
        raise InputError("; ".join(never), field="about", remedy="name something that a motion can tell")
    forms, wanted = zip(*sums.values(), strict=True)
    return Goal(tuple(sums), np.array(forms), np.array(wanted), never)


def _of_places(known: Known, places: Iterable[int], never: tuple[str, ...] = ()) -> Goal:
    chosen = list(places)
    sd = np.sqrt(np.diag(known.now))
    wanted = np.maximum(KNOWN * np.abs(known.mean), 1e-6 * sd)  # of a quantity that is zero, below every gain
    return Goal(tuple(known.names[k] for k in chosen), np.eye(len(known))[chosen], wanted[chosen], never)


def _named(known: Known, name: str, payload: str) -> Goal:
    special: dict[str, Callable[[Known], Goal]]
    special = {GAINS: _gains, PAYLOAD: partial(_payload, payload=payload), SIGNS: _signs}
    if name in special:
        return special[name](known)
    coefficients, parameters = known.coefficients, [parameter.name for parameter in known.model.parameters]
    if name in coefficients.names:
        place = coefficients.names.index(name)
        behind = coefficients.expressions[place]
        said = f"no motion can tell {name} by itself: efforts show {behind}, which is aimed at"
        return _of_places(known, [place], () if behind == name else (said,))
    if name in parameters:
        holding = _holding(known, [parameters.index(name)])
        if not holding:
            return _of_places(known, [], (f"no motion can tell {name}: efforts do not depend on it",))
        names = ", ".join(known.names[k] for k in holding)
        said = f"no motion can tell {name} by itself: efforts show it in {names}, which are aimed at"
        return _of_places(known, holding, (said,))
    for term, places in zip(known.model.terms, known.model.places, strict=True):
        if name in (term.name, term.effect):
            return _of_places(known, _holding(known, places))
    near = near_names(name, [*coefficients.names, *parameters, *(t.effect for t in known.model.terms), *special])
    alike = [one for one in coefficients.names if one[:2] == name[:2]][:6] or coefficients.names[:6]
    remedy = f"name coefficients ({', '.join(alike)}, ..), effects, {GAINS}, {PAYLOAD} or {SIGNS}"
    raise InputError(f"{name!r} is nothing of the model", field="about", remedy=f"{near} {remedy}".strip())


def _holding(known: Known, places: slice | list[int]) -> list[int]:
    """Coefficients that hold parameters of some places."""
    shares = np.abs(known.coefficients.projection[:, places])
    return np.flatnonzero(shares.max(axis=1, initial=0.0) > _NONE).tolist()


def _gains(known: Known) -> Goal:
    """Ratios of gains to the first that is unknown; their common factor is no motion's."""
    count, r = len(known.gains), len(known.coefficients)
    if not count:
        never = ("the result's gains are exact: nothing is open of them",)
        return Goal((), np.zeros((0, len(known))), np.zeros(0), never)
    forms = np.zeros((count - 1, len(known)))
    forms[:, r] = -1.0
    forms[np.arange(count - 1), r + 1 + np.arange(count - 1)] = 1.0
    first = int(known.gains[0]) + 1
    names = tuple(f"gain{j + 1}/gain{first}" for j in known.gains[1:])
    never = (
        "no motion can tell the common factor of the gains: a payload of known mass does (--payload KG~SD@LOG), or one "
        "exact gain",
    )
    return Goal(names, forms, np.full(count - 1, KNOWN), never)


def _payload(known: Known, payload: str) -> Goal:
    labels = known.model.payloads
    if labels and not payload:
        said = f"is known as {', '.join(labels)}, and the motion carries nothing"
        remedy = f"give the payload that is recorded with it, as {labels[0]}"
        raise InputError(said, "payload", remedy, field="about")
    places = [
        k
        for term, place in zip(known.model.terms, known.model.places, strict=True)
        if payload in term.payloads or term.needs_earlier
        for k in range(place.start, place.stop)
    ]
    if not places:
        never = (
            "no motion can tell a payload from the last link: record once without it and once with it (--log "
            "FILE:payload=LABEL, or `bayesid payload`)",
        )
        n, parameters = known.model.robot.n_joints, known.model.parameters
        last = [k for k, parameter in enumerate(parameters) if parameter.joint == n and parameter.name[:1] in "mJ"]
        return _of_places(known, _holding(known, last), never)
    return _of_places(known, _holding(known, places))


def _signs(known: Known) -> Goal:
    """The efforts of any motion, by the directions in which the coefficients are most uncertain of what noise shows.

    A sign is certain where the model's error of the effort is small beside it. The motions are random ones.
    """
    motion = usual_motion(known.model.robot)
    information = known.information(motion, float(np.median(np.diff(motion.t)))) / (motion.t[-1] - motion.t[0])
    values, vectors = np.linalg.eigh(information)
    seen = values > _NONE * values[-1]
    forms = (vectors[:, seen] * np.sqrt(values[seen])).T
    names = tuple(f"effort{k + 1}" for k in range(int(seen.sum())))
    never = ("what is learned of efforts hardly helps signs: over 291 simulated logs no design of motion has",)
    return Goal(names, forms, np.full(int(seen.sum()), TUNING.sign), never)


def usual_motion(robot: Robot, limits: MotionLimits = INDUSTRIAL_ARM, duration: float | None = None) -> Motion:
    """A random motion that uses the limits, over a duration, s, and stands for any motion."""
    usual, rate = TUNING.usual_motion
    duration = usual if duration is None else duration
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    return random_trajectory(robot.n_joints, duration, limits=limits).motion(t)
