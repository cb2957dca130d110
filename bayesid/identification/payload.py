"""Mass, centre of mass and inertia of a payload, from a log with it.

An earlier log without the payload separates it from the last link. Each draw of the posterior of both logs contains a
body: mass m, centre of mass h / m, and inertia about it. Means over draws are reported. The mean of inertias is
feasible, as they form a convex cone; medians of single numbers need not be.

The prior is almost flat in the ten parameters. For second moments S_xx, S_yy, S_zz about the centre the volume of
feasible products (|S_xy| <= sqrt(S_xx S_yy)) is proportional to S_xx S_yy S_zz, so a flat prior favours large bodies.
Draws are weighted by the inverse, which makes the second moments uniform (separation strategy of Barnard, McCulloch and
Meng, Modeling covariance matrices, Statistica Sinica 2000).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtri

from bayesid.arrays import Array
from bayesid.effects.bodies import Payload
from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST
from bayesid.identification.checks import on_edge
from bayesid.identification.gains import BY_PRIOR, IdentifiedGains
from bayesid.identification.identification import Identification, identified_of
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.options import Preprocessing, call_of, call_of_log
from bayesid.identification.pipeline import QUICK, identify_again
from bayesid.identification.tuning import TUNING
from bayesid.identification.unchanged import UnchangedCheck, check_unchanged, chi_square_of
from bayesid.log.gains import gains_of
from bayesid.log.log import Log
from bayesid.log.reading import LogSource, as_log
from bayesid.log.signals import still_joints
from bayesid.parallel import one_blas_thread
from bayesid.posterior.inference import Posterior
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, Progress, Show
from bayesid.robot import check_joints
from bayesid.robot.inertia import about_centre_of_mass
from bayesid.signs.search.protocol import Search

AXES = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Order of the six numbers of an inertia matrix."""
_PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Their indices in the matrix."""
STATED, BY_GAINS, ASSUMED = "stated", "gains", "assumed"
"""Sources of the standard deviation of the efforts' common factor."""
BRIEF = Sampling(budget=TUNING.payload_budget)
"""Sampling of a payload's posterior."""


@dataclass(frozen=True)
class Estimate:
    """A number and its uncertainty."""

    value: float  #: mean of the posterior
    sd: float  #: its standard deviation
    interval: tuple[float, float]  #: ends of its central 95 % interval

    @classmethod
    def of_draws(cls, draws: Array) -> Estimate:
        """From draws (K,)."""
        low, high = np.quantile(draws, [0.025, 0.975])
        return cls(float(draws.mean()), float(draws.std()), (float(low), float(high)))


@dataclass(frozen=True)
class InertialParameters:
    """A body on the last link, in that link's frame; mass and inertia in the scale of the efforts.

    Attributes:
        mass: kg; if no body is detected, the interval begins at zero.
        centre: centre of mass x, y, z, m; None if no body is detected.
        inertia: about the centre of mass, along the frame's axes, xx, yy, zz, xy, xz, yz, kg m^2; None alike.
    """

    mass: Estimate
    centre: tuple[Estimate, ...] | None
    inertia: tuple[Estimate, ...] | None

    @property
    def shown(self) -> bool:
        """Whether the mass differs significantly from zero."""
        return self.centre is not None

    @classmethod
    def of_draws(cls, draws: Array, shown: bool = True, common_sd: float = 0.0) -> InertialParameters:
        """From draws of its ten parameters.

        Args:
            draws: (K, 10) as in `bayesid.robot.inertia`, with masses > 0.
            shown: whether a body was detected; draws cannot show this, as their masses are positive.
            common_sd: relative sd of the efforts' common factor (see `with_common_factor`); it widens the intervals of
                mass and inertia.
        """
        draws = evenly_sized(draws)
        wide = with_common_factor(draws, common_sd)
        mass = _widened(draws[:, 9], wide[:, 9])
        if not shown:
            return cls(replace(mass, interval=(0.0, float(np.quantile(wide[:, 9], 0.95)))), None, None)
        (centre, inertia), (_, wide_inertia) = about_centre_of_mass(draws), about_centre_of_mass(wide)
        return cls(
            mass,
            tuple(Estimate.of_draws(axis) for axis in centre.T),
            tuple(_widened(inertia[:, i, j], wide_inertia[:, i, j]) for i, j in _PLACES),
        )


def _widened(draws: Array, wide: Array) -> Estimate:
    """Mean of `draws` (K,), with sd and interval of `wide` (K,)."""
    return replace(Estimate.of_draws(wide), value=float(draws.mean()))


def evenly_sized(draws: Array) -> Array:
    """Draws (K, 10) under a flat prior, resampled to a uniform prior of the second moments about the centre of mass.

    Systematic resampling, deterministic; a draw may appear several times.
    """
    mass = draws[:, 9]
    _, inertia = about_centre_of_mass(draws)
    diagonal = np.diagonal(inertia, axis1=1, axis2=2)
    second_moments = 0.5 * diagonal.sum(axis=1, keepdims=True) - diagonal
    weights = 1.0 / np.prod(np.maximum(second_moments / mass[:, None], TUNING.thin_body**2) * mass[:, None], axis=1)
    shares = np.cumsum(weights) / weights.sum()
    resampled: Array = draws[np.searchsorted(shares, (np.arange(len(draws)) + 0.5) / len(draws))]
    return resampled


def with_common_factor(draws: Array, common_sd: float) -> Array:
    """Draws (K, ...) times random common factors of the efforts, with ln(factor) ~ N(0, common_sd^2).

    Gains that are 10 % too high make mass and inertia 10 % too large; the centre of mass is not affected.
    """
    if common_sd == 0.0:
        return draws
    factor = np.exp(common_sd * _normal(len(draws)))
    return draws * factor.reshape(-1, *(1,) * (draws.ndim - 1))


def common_factor(gains: IdentifiedGains | None, log: Log) -> tuple[float, str]:
    """Relative sd of the efforts' common factor, and its source.

    It is that of identified gains, or 0 for gains stated as exact, or `Tuning.unstated_gains` without stated gains, as
    for logged torques.
    """
    if gains is not None:
        return gains.factor_sd, BY_GAINS
    return (0.0, STATED) if log.read_with.get("gains") is not None else (TUNING.unstated_gains, ASSUMED)


def gain_factor(mass: Array, known: float, known_sd: float) -> Estimate:
    """Factor that corrects the efforts: known mass over drawn masses (K,), kg."""
    return Estimate.of_draws((known + known_sd * _normal(len(mass))) / mass)


def _normal(count: int) -> Array:
    """(count,) quantiles of the normal distribution at equal steps of probability, in a random order."""
    quantiles: Array = ndtri(np.random.default_rng(0).permutation((np.arange(count) + 0.5) / count))
    return quantiles


@dataclass(frozen=True)
class PayloadEstimate:
    """An identified payload.

    Attributes:
        body: mass, centre of mass and inertia, in the frame of the last link.
        check: whether anything except the payload has changed since the earlier log.
        gain_factor: factor that corrects the efforts, from a known mass; None without one or without a payload.
        known_mass: kg, with its sd; None if not given.
        identification: identification of the model with the payload.
        warnings: checks that are not good, in words.
        seconds: wall time.
        common_sd: relative sd of the efforts' common factor, included in mass and inertia.
        common_sd_from: `stated` (by the user, or by exact gains), `gains` (of the earlier result) or `assumed`.
        mass_sd_by_log: sd of the mass without that of the common factor, kg.
        read_with: reading options that differ from those of the earlier log.

    Example:
        >>> reading.body.shown, reading.check.joints  # nothing else has changed in any joint
        (True, ())
    """

    body: InertialParameters
    check: UnchangedCheck
    gain_factor: Estimate | None
    known_mass: tuple[float, float] | None
    identification: Identification
    warnings: tuple[str, ...]
    seconds: float
    common_sd: float = 0.0
    common_sd_from: str = STATED
    mass_sd_by_log: float = np.nan
    read_with: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        mass, changed = self.body.mass, ", ".join(map(str, self.check.joints)) or "the links"
        lines = [
            f"Payload from {self.identification.log.source}: {mass.value:.4g} +- {mass.sd:.2g} kg on {self.frame}"
            f"{'' if self.body.shown else ', no payload detected'}",
            f"otherwise    {'no change' if self.check.passed else f'CHANGED: joint {changed}'}",
            "next         .body.mass, .body.centre, .body.inertia, .check, bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def frame(self) -> str:
        """The frame of the body: that of the last link.

        In a Denavit-Hartenberg table this is the frame of the last row, which the standard convention puts at the
        flange. In a URDF it is that of the last moving joint, without frames fixed to its link.
        """
        return f"link {self.identification.model.robot.n_joints}"

    @property
    def posterior(self) -> Posterior:
        """Draws of robot and payload."""
        return _posterior_of(self.identification)

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """The body's ten parameters about the frame's origin, in the order of `bayesid.robot.inertia.NAMES`."""
        draws = evenly_sized(_body_draws(self.identification))
        wide = with_common_factor(draws, self.common_sd)
        return tuple(_widened(narrow, widened) for narrow, widened in zip(draws.T, wide.T, strict=True))

    @property
    def gains(self) -> tuple[Array, Array] | None:
        """(n,) gains that the log was read with, N m/A, and the same times the factor; None without gains or factor."""
        read_with = self.identification.log.read_with.get("gains")
        if self.gain_factor is None or read_with is None:
            return None
        gains = gains_of(read_with, self.identification.log.n_joints).value  # type: ignore[arg-type]
        return gains, self.gain_factor.value * gains


@one_blas_thread
def identify_payload(
    earlier: IdentifiedModel | Identification,
    log: LogSource,
    *,
    known_mass: float | tuple[float, float] | None = None,
    common_sd: float | None = None,
    search: Search = QUICK,
    posterior: Sampling = BRIEF,
    preprocessing: Preprocessing = Preprocessing(),
    progress: Progress | Show = SILENT,
) -> PayloadEstimate:
    """Identifies mass, centre of mass and inertia of a payload from a log.

    Args:
        earlier: an identification of the robot without the payload, or a stored one.
        log: a log of the robot with the payload, or anything that `bayesid.read_log` reads.
        known_mass: mass of the payload, kg, or (mass, sd); it shows the efforts' common factor.
        common_sd: relative sd of the efforts' common factor; by default that of `common_factor`.
        search: sign search.
        posterior: sampling of the posterior.
        preprocessing: filtering and segmentation.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Raises:
        InputError: the log belongs to another robot or to the model's own identification, or does not show a mass; the
            model has no uncertainty or has a payload; the known mass is invalid.
        SolverError: an optimisation failed.

    Example:
        >>> empty = bayesid.identify_payload(result, other_log)  # nothing on the flange
        >>> empty.body.shown, empty.body.centre
        (False, None)
    """
    progress = Progress.of(progress)
    began = time.perf_counter()
    known = identified_of(earlier, "earlier")
    stated = None if known_mass is None else _stated(known_mass)
    log = as_log(log, known.model.robot, known.reading)
    _check(known, log)
    factor_sd, factor_from = common_factor(known.gains, log) if common_sd is None else (common_sd, STATED)
    if not factor_sd >= 0.0:
        remedy = "give a relative standard deviation of 0 or more, as in 0.1 for 10 %"
        raise InputError(f"{factor_sd:g} is not a relative standard deviation", field="common_sd", remedy=remedy)
    again = identify_again(
        known.model.extend(Payload()),
        log,
        known.knowledge,
        np.concatenate([known.theta, np.zeros(10)]),
        search=search,
        posterior=posterior,
        preprocessing=preprocessing,
        progress=progress,
    )
    _check_shown(again)
    call = call_of("identify_payload", "earlier", call_of_log(log), known_mass=(known_mass, None))
    again = replace(
        again, logs=again.logs | known.logs, gains=known.gains, provenance=replace(again.provenance, call=call)
    )
    draws = _body_draws(again)
    of_payload = again.coefficients.selected >= len(again.model.before_sensors.parameters) - 10
    # the minimum of a quadratic form over a cone is below its value at the tip by the estimate's length (Moreau 1962)
    squared_length, _ = chi_square_of(again.fit.information, again.fit.beta, of_payload)
    shown = squared_length > float(chdtri(10, TUNING.payload_false_alarm))
    return PayloadEstimate(
        body=InertialParameters.of_draws(draws, shown, factor_sd),
        check=check_unchanged(known.knowledge, known.noise, again),
        gain_factor=gain_factor(evenly_sized(draws)[:, 9], *stated) if stated is not None and shown else None,
        known_mass=stated,
        identification=again,
        warnings=(
            *(warning for warning in again.warnings if warning not in map(str, on_edge(again.fit, log.n_joints))),
            *_ratios_warning(known.gains),
        ),
        seconds=time.perf_counter() - began,
        common_sd=factor_sd,
        common_sd_from=factor_from,
        read_with=known.beyond_reading(log),
        mass_sd_by_log=Estimate.of_draws(evenly_sized(draws)[:, 9]).sd,
    )


def _body_draws(again: Identification) -> Array:
    """(K, 10) draws of the payload, the last term of the model, of all modes together."""
    theta = _posterior_of(again).uncertain.theta
    draws: Array = theta.reshape(-1, theta.shape[-1])[:, -10:]
    return draws


def _ratios_warning(gains: IdentifiedGains | None) -> list[str]:
    """Warning that the earlier log did not show some ratios of gains, whose uncertainty the intervals leave out."""
    open_joints = [str(j) for j, by in enumerate(gains.decided_by, start=1) if by == BY_PRIOR] if gains else []
    if not open_joints:
        return []
    return [
        f"the earlier log does not show the gains of joint {', '.join(open_joints)}; their uncertainty is not in "
        "these intervals; identify both logs together, with --payload"
    ]


def _posterior_of(again: Identification) -> Posterior:
    if again.posterior is None:
        raise ValueError("a payload's posterior is always sampled")
    return again.posterior


def _stated(known_mass: float | tuple[float, float]) -> tuple[float, float]:
    try:
        mass, sd = (float(known_mass), 0.0) if np.ndim(known_mass) == 0 else map(float, known_mass)  # type: ignore
    except (TypeError, ValueError):
        raise InputError(f"{known_mass!r} is not a mass", field="known_mass", remedy=_REMEDY_OF_MASS) from None
    if not (0.0 < mass <= LARGEST and 0.0 <= sd < mass / 3.0):
        raise InputError(f"mass {mass:g} kg, sd {sd:g} kg", field="known_mass", remedy=_REMEDY_OF_MASS)
    return mass, sd


_REMEDY_OF_MASS = "give a mass above 0 kg, without sd or with one below a third of it, as in 2.805~0.005"


def _check(known: IdentifiedModel, log: Log) -> None:
    where, remedy = "model.toml", "give a result of `bayesid identify` from a log without the payload"
    if any(term.name == Payload.name for term in known.model.terms):
        raise InputError("the model already has a payload", where, remedy)
    if not known.precision.any():
        raise InputError("the uncertainty of the model's parameters is unknown", where, remedy)
    check_joints(known.model.robot, log.n_joints, log.source)
    if known.seen(log):
        remedy = "give a log with the payload"
        raise InputError("the model was identified from this log", log.source, remedy)
    if still_joints(log.q).all():
        raise InputError("no joint moves", log.source, "record a motion in which joints move")


def _check_shown(again: Identification) -> None:
    """Checks that the log shows the payload's mass and belongs to the robot."""
    log, effort = again.log.source, again.signals.magnitude
    moving = again.segments.per_sample(again.segments.moving, *effort.shape) > 0
    count = moving.sum(axis=0)
    least = TUNING.min_samples
    if count.max() < least:
        message = f"only {int(count.max())} samples in motion"
        raise InputError(message, log, f"record at least {least} samples in which joints move")
    spread = np.array([e[used].std() if used.any() else 0.0 for e, used in zip(effort.T, moving.T, strict=True)])
    if np.all(again.fit.residual.sigma > spread):
        message = "the model with a payload explains no joint's efforts better than a constant"
        raise InputError(message, log, "give a log of the robot that the model was identified from")
    if not _posterior_of(again).decided_by_data[-1]:
        remedy = "record a motion that turns the payload against gravity, with all joints"
        raise InputError("does not show the mass of a payload", log, remedy)
