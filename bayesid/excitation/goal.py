"""Goals of the next motion: linear combinations of a result's quantities, with the standard deviations to reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, near_names
from bayesid.excitation.gaussian_posterior import GaussianPosterior, reference_motion, root_of
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import KNOWN

_ROUNDING_OF_SHARE = 1e-9
"""Rounding error of a parameter's weight in a coefficient."""


@dataclass(frozen=True)
class Goal:
    """m linear combinations of quantities, and the standard deviations to be reached."""

    names: tuple[str, ...]  # (m,)
    forms: Array  # (m, R) coefficients of the combinations
    required_sd: Array  # (m,) sufficient standard deviations
    remarks: tuple[str, ...] = ()  # on what is not identifiable

    def scaled_covariance(self, covariance: Array) -> Array:
        """(m, m) covariance of the combinations in units of the required sd, from that of the quantities (R, R)."""
        forms = self.forms / self.required_sd[:, None]
        return forms @ covariance @ forms.T

    def log_det(self, covariance: Array) -> float:
        """Log det(1 + W^-1 F C F' W^-1): twice the information still missing about the combinations F, in nats.

        See :eq:`next-information`. It is D-optimality, but a combination known to its required sd hardly counts
        (Chaloner and Verdinelli, Bayesian Experimental Design: A Review, 1995, section 2.2).
        """
        scaled_covariance = self.scaled_covariance(covariance)
        return float(np.linalg.slogdet(np.eye(len(scaled_covariance)) + scaled_covariance)[1])

    def mean_variance(self, covariance: Array) -> float:
        """Mean of variance over required variance: A-optimality (ibid., section 2.3)."""
        return float(np.trace(self.scaled_covariance(covariance)) / len(self.required_sd))

    def gain(self, before: Array, after: Array) -> float:
        """Information gain of a recording about the combinations, nats, from covariances (R, R) before and after it."""
        return 0.5 * (self.log_det(before) - self.log_det(after))


CRITERIA = {"D": Goal.log_det, "A": Goal.mean_variance}
"""Criteria by name; minimised."""


def undetermined_coefficients(posterior: GaussianPosterior) -> list[int]:
    """Indices of coefficients whose standard deviation exceeds `KNOWN` times their value."""
    return np.flatnonzero(
        posterior.undetermined(np.sqrt(np.diag(posterior.covariance_now)))[: len(posterior.coefficients)]
    ).tolist()


def goal_of(posterior: GaussianPosterior, about: Sequence[str] = (), payload: str = "") -> Goal:
    """The goal for names as in `bayesid.design_excitation`, with a payload on the flange.

    InputError if a name is unknown, or none of the quantities is identifiable.
    """
    parts = [_named(posterior, name, payload) for name in about]
    if not about:
        parts = [
            _of_places(posterior, undetermined_coefficients(posterior) or list(range(len(posterior.coefficients))))
        ]
        parts += [_gains(posterior)] * (len(posterior.gains) > 1)
    names = [name for part in parts for name in part.names]
    remarks = tuple(dict.fromkeys(sentence for part in parts for sentence in part.remarks))
    if not names:
        raise InputError("; ".join(remarks), field="about", remedy="name an identifiable quantity")
    first = [names.index(name) for name in dict.fromkeys(names)]
    forms, required_sd = (
        np.concatenate(each)[first] for each in zip(*((part.forms, part.required_sd) for part in parts), strict=True)
    )
    return Goal(tuple(names[k] for k in first), forms, required_sd, remarks)


def _of_places(posterior: GaussianPosterior, chosen: list[int], remarks: tuple[str, ...] = ()) -> Goal:
    sd = np.sqrt(np.diag(posterior.covariance_now))
    required_sd = np.maximum(KNOWN * np.abs(posterior.mean), 1e-6 * sd)  # positive for a quantity that is zero
    return Goal(tuple(posterior.names[k] for k in chosen), np.eye(len(posterior))[chosen], required_sd[chosen], remarks)


def _named(posterior: GaussianPosterior, name: str, payload: str) -> Goal:
    special: dict[str, Callable[[GaussianPosterior], Goal]]
    special = {"gains": _gains, "payload": partial(_payload, payload=payload), "signs": _signs}
    if name in special:
        return special[name](posterior)
    coefficients, parameters = posterior.coefficients, [parameter.name for parameter in posterior.model.parameters]
    if name in coefficients.names:
        place = coefficients.names.index(name)
        combination = coefficients.expressions[place]
        remark = f"{name} is not identifiable alone, only the combination {combination}; this is the goal"
        return _of_places(posterior, [place], () if combination == name else (remark,))
    if name in parameters:
        depending = _depending(posterior, [parameters.index(name)])
        if not depending:
            return _of_places(posterior, [], (f"{name} is not identifiable: efforts do not depend on it",))
        names = ", ".join(posterior.names[k] for k in depending)
        remark = f"{name} is not identifiable alone, only the combinations {names}; these are the goal"
        return _of_places(posterior, depending, (remark,))
    for term, places in zip(posterior.model.terms, posterior.model.places, strict=True):
        if name in (term.name, term.effect):
            return _of_places(posterior, _depending(posterior, places))
    near = near_names(name, [*coefficients.names, *parameters, *(t.effect for t in posterior.model.terms), *special])
    similar = [other for other in coefficients.names if other[:2] == name[:2]][:6] or coefficients.names[:6]
    remedy = f"give coefficients ({', '.join(similar)}, ..), effects, gains, payload or signs"
    raise InputError(f"{name!r} is not a quantity of the model", field="about", remedy=f"{near} {remedy}".strip())


def _depending(posterior: GaussianPosterior, places: slice | list[int]) -> list[int]:
    """Indices of coefficients that depend on parameters at some places."""
    shares = np.abs(posterior.coefficients.projection[:, places])
    return np.flatnonzero(shares.max(axis=1, initial=0.0) > _ROUNDING_OF_SHARE).tolist()


def _gains(posterior: GaussianPosterior) -> Goal:
    """Ratios of gains to the first unknown one; a motion does not determine their common factor."""
    count, r = len(posterior.gains), len(posterior.coefficients)
    if not count:
        return _of_places(posterior, [], ("the result's gains are exact: nothing to estimate",))
    forms = np.zeros((count - 1, len(posterior)))
    forms[:, r] = -1.0
    forms[np.arange(count - 1), r + 1 + np.arange(count - 1)] = 1.0
    first = int(posterior.gains[0]) + 1
    names = tuple(f"gain{j + 1}/gain{first}" for j in posterior.gains[1:])
    remarks = (
        "no motion determines the common factor of the gains; a payload of known mass does (--payload KG~SD@LOG), or "
        "one exact gain",
    )
    return Goal(names, forms, np.full(count - 1, KNOWN), remarks)


def _payload(posterior: GaussianPosterior, payload: str) -> Goal:
    labels = posterior.model.payloads
    if labels and not payload:
        problem = f"the result has payloads {', '.join(labels)}, the motion has none"
        remedy = f"give the payload of the recording, as {labels[0]}"
        raise InputError(problem, "payload", remedy, field="about")
    terms, n = zip(posterior.model.terms, posterior.model.places, strict=True), posterior.model.robot.n_joints
    places = [place for term, place in terms if payload in term.payloads or term.needs_earlier]
    if places:
        return _of_places(
            posterior, _depending(posterior, [k for place in places for k in range(place.start, place.stop)])
        )
    remarks = (
        "one recording does not distinguish a payload from the last link: record once without and once with it "
        "(--payload LABEL@LOG, or `bayesid payload`)",
    )
    last = [
        k
        for k, parameter in enumerate(posterior.model.parameters)
        if parameter.joint == n and parameter.name[:1] in "mJ"
    ]
    return _of_places(posterior, _depending(posterior, last), remarks)


def _signs(posterior: GaussianPosterior) -> Goal:
    """Efforts of a random motion, as combinations of coefficients in units of the noise.

    A sign is certain if the error of the predicted effort is small compared with the effort.
    """
    motion = reference_motion(posterior.model.robot)
    forms = root_of(posterior.information(motion) / (motion.t[-1] - motion.t[0])).T
    names = tuple(f"effort{k + 1}" for k in range(len(forms)))
    remarks = ("no design criterion is known to improve signs (docs/excitation.md)",)
    return Goal(names, forms, np.full(len(forms), TUNING.sign_error), remarks)
