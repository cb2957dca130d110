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

_NONE = 1e-9
"""Share of a coefficient below which a parameter's is rounding."""


@dataclass(frozen=True)
class Goal:
    """m linear combinations of quantities to be determined."""

    names: tuple[str, ...]  # (m,)
    forms: Array  # (m, R) coefficients of the combinations
    required_sd: Array  # (m,) sufficient standard deviations
    remarks: tuple[str, ...] = ()  # sentences on what is not identifiable

    def scaled_covariance(self, covariance: Array) -> Array:
        """(m, m) covariance of the combinations over the required sd, from that of the quantities (R, R)."""
        forms = self.forms / self.required_sd[:, None]
        return forms @ covariance @ forms.T

    def log_det(self, covariance: Array) -> float:
        """Log det(1 + W^-1 F C F' W^-1): twice the remaining information about the combinations F, in nats.

        See :eq:`next-information`. D-optimality, except that a combination known to its required sd hardly counts
        (Chaloner and Verdinelli, Bayesian Experimental Design: A Review, 1995, section 2.2).
        """
        scaled_covariance = self.scaled_covariance(covariance)
        return float(np.linalg.slogdet(np.eye(len(scaled_covariance)) + scaled_covariance)[1])

    def mean_variance(self, covariance: Array) -> float:
        """Mean variance of the combinations over the required variance: A-optimality (ibid., section 2.3)."""
        return float(np.trace(self.scaled_covariance(covariance)) / len(self.required_sd))

    def gain(self, before: Array, after: Array) -> float:
        """Information gain of a recording about the combinations, nats, from covariances (R, R) before and after it."""
        return 0.5 * (self.log_det(before) - self.log_det(after))


CRITERIA = {"D": Goal.log_det, "A": Goal.mean_variance}
"""By name; the less, the better."""


def undetermined_coefficients(posterior: GaussianPosterior) -> list[int]:
    """Coefficients whose standard deviation is more than `KNOWN` of their value."""
    return np.flatnonzero(
        posterior.undetermined(np.sqrt(np.diag(posterior.covariance_now)))[: len(posterior.coefficients)]
    ).tolist()


def goal_of(posterior: GaussianPosterior, about: Sequence[str] = (), payload: str = "") -> Goal:
    """The goal for some names.

    Args:
        posterior: of the result.
        about: names of coefficients, parameters, effects, or `gains`, `payload`, `signs`; by default all
            that are undetermined.
        payload: label of what the flange carries.

    Raises:
        InputError: a name is unknown, or none of the quantities is identifiable.
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
    required_sd = np.maximum(KNOWN * np.abs(posterior.mean), 1e-6 * sd)  # of a quantity that is zero, below every gain
    return Goal(tuple(posterior.names[k] for k in chosen), np.eye(len(posterior))[chosen], required_sd[chosen], remarks)


def _named(posterior: GaussianPosterior, name: str, payload: str) -> Goal:
    special: dict[str, Callable[[GaussianPosterior], Goal]]
    special = {"gains": _gains, "payload": partial(_payload, payload=payload), "signs": _signs}
    if name in special:
        return special[name](posterior)
    coefficients, parameters = posterior.coefficients, [parameter.name for parameter in posterior.model.parameters]
    if name in coefficients.names:
        place = coefficients.names.index(name)
        behind = coefficients.expressions[place]
        said = f"{name} is not identifiable alone, only the combination {behind}; this is the goal"
        return _of_places(posterior, [place], () if behind == name else (said,))
    if name in parameters:
        holding = _holding(posterior, [parameters.index(name)])
        if not holding:
            return _of_places(posterior, [], (f"{name} is not identifiable: efforts do not depend on it",))
        names = ", ".join(posterior.names[k] for k in holding)
        said = f"{name} is not identifiable alone, only the combinations {names}; these are the goal"
        return _of_places(posterior, holding, (said,))
    for term, places in zip(posterior.model.terms, posterior.model.places, strict=True):
        if name in (term.name, term.effect):
            return _of_places(posterior, _holding(posterior, places))
    near = near_names(name, [*coefficients.names, *parameters, *(t.effect for t in posterior.model.terms), *special])
    alike = [one for one in coefficients.names if one[:2] == name[:2]][:6] or coefficients.names[:6]
    remedy = f"name coefficients ({', '.join(alike)}, ..), effects, gains, payload or signs"
    raise InputError(f"{name!r} is not a quantity of the model", field="about", remedy=f"{near} {remedy}".strip())


def _holding(posterior: GaussianPosterior, places: slice | list[int]) -> list[int]:
    """Coefficients that hold parameters of some places."""
    shares = np.abs(posterior.coefficients.projection[:, places])
    return np.flatnonzero(shares.max(axis=1, initial=0.0) > _NONE).tolist()


def _gains(posterior: GaussianPosterior) -> Goal:
    """Ratios of gains to the first unknown one; their common factor is not identifiable from a motion."""
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
        said = f"the result has payloads {', '.join(labels)}, the motion has none"
        remedy = f"give the payload that is recorded with it, as {labels[0]}"
        raise InputError(said, "payload", remedy, field="about")
    terms, n = zip(posterior.model.terms, posterior.model.places, strict=True), posterior.model.robot.n_joints
    own = [place for term, place in terms if payload in term.payloads or term.needs_earlier]
    if own:
        return _of_places(posterior, _holding(posterior, [k for place in own for k in range(place.start, place.stop)]))
    remarks = (
        "a payload is not distinguishable from the last link in one recording: record once without and once with it "
        "(--payload LABEL@LOG, or `bayesid payload`)",
    )
    last = [k for k, one in enumerate(posterior.model.parameters) if one.joint == n and one.name[:1] in "mJ"]
    return _of_places(posterior, _holding(posterior, last), remarks)


def _signs(posterior: GaussianPosterior) -> Goal:
    """Efforts of a random motion, as combinations of coefficients in units of the noise.

    A sign is certain where the error of the predicted effort is small compared with the effort.
    """
    motion = reference_motion(posterior.model.robot)
    forms = root_of(posterior.information(motion) / (motion.t[-1] - motion.t[0])).T
    names = tuple(f"effort{k + 1}" for k in range(len(forms)))
    remarks = ("motion design did not improve signs in 291 simulated logs",)
    return Goal(names, forms, np.full(len(forms), TUNING.sign_error), remarks)
