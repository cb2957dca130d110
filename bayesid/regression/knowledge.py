"""Information before a log: stated link masses and parameters, and results of earlier logs of the robot."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients, embedding
from bayesid.effects.model import Model
from bayesid.effects.parameters import Parameter
from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST, read_source
from bayesid.regression.tuning import TUNING
from bayesid.robot.inertia import from_pseudo_inertia

_ROUNDING_OF_DIAGONAL = 1e-12
"""Share of the largest diagonal entry below which an entry is rounding."""


RIDGE = 1e-12
"""Added to the diagonal of a matrix scaled to unit diagonal; about 100 times its rounding error."""


@dataclass(frozen=True)
class InformationMatrix:
    """A Gaussian of r coefficients, up to a constant: minus its logarithm is (beta' H beta - 2 g' beta + c) / 2.

    Attributes:
        hessian: (r, r) H.
        gradient: (r,) g.
        energy: c.
    """

    hessian: Array
    gradient: Array
    energy: float

    def misfit(self, beta: Array) -> float:
        """Quadratic form beta' H beta - 2 g' beta + c for coefficients (r,)."""
        return float(beta @ self.hessian @ beta - 2.0 * self.gradient @ beta + self.energy)

    @classmethod
    def none(cls, size: int) -> InformationMatrix:
        """No information."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0)


@dataclass(frozen=True)
class CoefficientPrior:
    """A normal distribution of a model's base coefficients, with the mean B theta, theta (P,).

    The precision (r, r) is singular in directions that the earlier log does not excite.
    """

    model: Model
    theta: Array
    precision: Array

    def coefficients(self, model: Model) -> BaseCoefficients:
        """Base coefficients of an extended model that a log and this prior determine together."""
        return base_coefficients(model, earlier=self.model)

    def information(self, model: Model, coefficients: BaseCoefficients) -> InformationMatrix:
        """The prior in the coefficients of an extended model (see `coefficients`)."""
        earlier = base_coefficients(self.model)
        turn = earlier.projection @ embedding(self.model, model) @ np.linalg.pinv(coefficients.projection)
        centre = earlier.project(self.theta)
        hessian = turn.T @ self.precision @ turn
        gradient = turn.T @ (self.precision @ centre)
        return InformationMatrix(0.5 * (hessian + hessian.T), gradient, float(centre @ self.precision @ centre))

    def widened(
        self, names: tuple[str, ...], sd: Array, coefficients: BaseCoefficients | None = None
    ) -> CoefficientPrior:
        """The prior after named parameters changed by a normal step of standard deviations sd (p,).

        (C + B D B')^-1 = L - L B (D^-1 + B' L B)^-1 B' L with L = C^-1 (Woodbury).
        """
        coefficients = base_coefficients(self.model) if coefficients is None else coefficients
        labels = [parameter.name for parameter in self.model.parameters]
        steps = coefficients.projection[:, [labels.index(name) for name in names]]
        weighted = self.precision @ steps
        middle = np.diag(1.0 / sd**2) + steps.T @ weighted
        return replace(self, precision=self.precision - weighted @ np.linalg.solve(middle, weighted.T))


def of_base(model: Model, coefficients: BaseCoefficients, precision: Array) -> Array:
    """(r, r) precision of a model's base coefficients, from that (R, R) of a larger set of coefficients.

    The other coefficients are integrated out, such as a payload that only an earlier log shows.
    """
    base = base_coefficients(model)
    if base.names == coefficients.names:
        return precision
    turn = base.projection @ np.linalg.pinv(coefficients.projection)
    across, more = np.linalg.pinv(turn), np.linalg.svd(turn)[2][len(turn) :].T
    scale = scale_of(more.T @ precision @ more)
    kept, mixed = across.T @ precision @ across, across.T @ precision @ more / scale
    inner = np.linalg.pinv(
        more.T @ precision @ more / scale[:, None] / scale, rcond=_ROUNDING_OF_DIAGONAL, hermitian=True
    )
    reduced: Array = kept - mixed @ inner @ mixed.T
    return 0.5 * (reduced + reduced.T)


def scale_of(precision: Array) -> Array:
    """(r,) square roots of the diagonal, with a floor for entries that are rounding."""
    diagonal = np.abs(np.diag(precision))
    scale: Array = np.sqrt(np.maximum(diagonal, _ROUNDING_OF_DIAGONAL * float(diagonal.max()))) + np.finfo(float).tiny
    return scale


def inverse_of(matrix: Array) -> Array:
    """Inverse of a positive matrix in mixed units; rows with a zero diagonal stay zero."""
    root = inverse_root(matrix)[0]
    inverse: Array = root.T @ root
    return inverse


def inverse_root(matrix: Array) -> tuple[Array, float]:
    """R with R'R = H^-1 of a positive matrix H in mixed units, and log det(H) / 2; R is zero where H's diagonal is."""
    diagonal = np.diag(matrix)
    seen = diagonal > np.finfo(float).tiny
    scale = np.where(seen, 1.0 / np.sqrt(np.where(seen, diagonal, 1.0)), 0.0)
    scaled = matrix * np.outer(scale, scale) + np.diag(np.where(seen, RIDGE, 1.0))
    factor, failed = dpotrf(scaled, lower=True)
    if failed:  # indefinite by rounding: drop directions without information
        values, vectors = np.linalg.eigh(scaled)
        kept = values > RIDGE
        root = (vectors[:, kept] / np.sqrt(values[kept])).T * scale
        return root, 0.5 * float(np.log(values[kept]).sum()) - float(np.log(scale[seen]).sum())
    root = dtrtri(factor, lower=True)[0] * scale
    return root, float(np.log(np.diag(factor)).sum() - np.log(scale[seen]).sum())


@dataclass(frozen=True)
class LinkPrior:
    """Prior of any link, given by two scales; all other numbers are proportional to them.

    Raises:
        InputError: a scale is not a positive number.
    """

    mass: float = 10.0  #: kg, scale of a link's mass
    reach: float = 0.4  #: m, scale of the distances of a link's mass from its frame

    def __post_init__(self) -> None:
        for name, unit in (("mass", "kg"), ("reach", "m")):
            value = getattr(self, name)
            if not 1.0 / LARGEST <= value <= LARGEST:
                remedy = f"give a number from {1.0 / LARGEST:g} to {LARGEST:g}"
                raise InputError(f"{value:g} {unit} cannot be used", field=f"ParameterPrior.link_{name}", remedy=remedy)

    @property
    def typical_mass(self) -> float:
        """Prior mean of a link's mass, kg."""
        return TUNING.typical_mass * self.mass

    @property
    def largest_radius(self) -> float:
        """Largest radius of gyration about the frame, m."""
        return TUNING.widest_radius * self.reach

    @property
    def total_mass(self) -> tuple[float, float]:
        """Least and largest mass of all bodies, kg."""
        least, most = TUNING.total_masses
        return least * self.mass, most * self.mass

    @property
    def centre(self) -> Array:
        """(10,) parameters of the typical link."""
        spread = self.typical_mass * (TUNING.typical_spread * self.reach) ** 2
        return from_pseudo_inertia(np.diag([spread, spread, spread, self.typical_mass]))

    @property
    def sd(self) -> Array:
        """(10,) standard deviations."""
        return self.mass * np.repeat([self.reach**2, self.reach, 1.0], [6, 3, 1])


@dataclass(frozen=True)
class NominalParameters:
    """Stated means (P,) and sd (P,) of a model's parameters; NaN where nothing is stated."""

    mean: Array
    sd: Array


@dataclass(frozen=True, kw_only=True)
class KinematicTolerance:
    """Standard deviations of a robot's geometry about its file.

    Raises:
        InputError: a value is not a number or is negative.
    """

    length: float = 1e-3  #: m, of each joint's position
    angle: float = float(np.deg2rad(0.1))  #: rad, of each joint's direction
    stated: bool = True  #: whether a user stated it; a log may raise a stated value, but not lower it

    def __post_init__(self) -> None:
        for name, unit in (("length", "m"), ("angle", "rad")):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                message = f"{value:g} {unit} cannot be used"
                raise InputError(message, field=f"ParameterPrior.{name}_sd", remedy="give 0 or more")


@dataclass(frozen=True, kw_only=True)
class ParameterPrior:
    """Prior knowledge of parameters and geometry.

    Attributes:
        link_mass: kg, scale of a link's mass; None to derive it from the efforts (`bayesid.posterior.target`).
        link_reach: m, scale of the distances of a link's mass from its frame; None to derive it from the robot.
        nominal: single parameters from CAD or a data sheet: name to mean and standard deviation, or a CSV file with
            the columns name, mean and sd, such as parameters.csv of an earlier result. Rows without sd are skipped.
        length_sd: m, standard deviation of each joint's position about the robot file; None for 1 mm, which a log may
            lower.
        angle_sd: rad, the same for each joint's direction; None for 0.1 degrees.

    Raises:
        InputError: a number or the file cannot be used.

    Example:
        >>> prior = bayesid.ParameterPrior(nominal={"Fc2": (1.4, 0.1)}, link_mass=3.0, link_reach=0.2)
        >>> result = bayesid.identify(robot, log, terms, prior=prior, posterior=False)
        >>> round(result.coefficient("Fc2").nominal, 2)
        1.4
        >>> bayesid.ParameterPrior(nominal="nominal.csv").nominal
        {'m3': (1.2, 0.1)}
    """

    link_mass: float | None = None
    link_reach: float | None = None
    nominal: Mapping[str, tuple[float, float]] | str | Path = field(default_factory=dict)
    length_sd: float | None = None
    angle_sd: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.nominal, str | Path):
            object.__setattr__(self, "nominal", read_nominal(self.nominal))
        link_prior(self, LinkPrior())
        kinematic_tolerance(self)  # both check their values


def link_prior(prior: ParameterPrior, usual: LinkPrior) -> LinkPrior:
    """Scales of any link: the stated ones, `usual` for the others."""
    mass, reach = prior.link_mass, prior.link_reach
    return LinkPrior(usual.mass if mass is None else mass, usual.reach if reach is None else reach)


def kinematic_tolerance(prior: ParameterPrior) -> KinematicTolerance:
    """Tolerance of the geometry."""
    stated = {"length": prior.length_sd, "angle": prior.angle_sd}
    given = {name: value for name, value in stated.items() if value is not None}
    return KinematicTolerance(**given, stated=bool(given))


def nominal_values(prior: ParameterPrior) -> Mapping[str, tuple[float, float]]:
    """Name to mean and standard deviation of single parameters."""
    assert not isinstance(prior.nominal, str | Path)
    return prior.nominal


def nominal_parameters(prior: ParameterPrior, parameters: Sequence[Parameter]) -> NominalParameters:
    """Stated means and standard deviations, in the order of a model's parameters.

    Raises:
        InputError: the model has no such parameter, or a value cannot be used.
    """
    places = {parameter.name: k for k, parameter in enumerate(parameters)}
    mean, sd = np.full(len(places), np.nan), np.full(len(places), np.nan)
    for name, stated in nominal_values(prior).items():
        if name not in places:
            raise InputError(f"the model has no parameter {name!r}", field="ParameterPrior.nominal", remedy=_REMEDY)
        value, spread = _pair(name, stated)
        if not (abs(value) <= LARGEST and 1.0 / LARGEST**2 <= spread <= LARGEST**2):
            raise InputError(
                f"{name} = {value:g} +- {spread:g} cannot be used", field="ParameterPrior.nominal", remedy=_REMEDY
            )
        mean[places[name]], sd[places[name]] = value, spread
    return NominalParameters(mean, sd)


def _pair(name: str, stated: object) -> tuple[float, float]:
    try:
        mean, sd = (float(value) for value in stated)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        message, remedy = (
            f"{name} = {stated!r} is not a mean with its sd",
            f"give two numbers, as in {{{name!r}: (0.7, 0.1)}}",
        )
        raise InputError(message, field="ParameterPrior.nominal", remedy=remedy) from None
    return mean, sd


_REMEDY = "give lines name,mean,sd, with names as in parameters.csv"


def read_nominal(path: str | Path) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of named parameters from a CSV file with the columns name, mean and sd.

    Lines without an sd are skipped, so that parameters.csv of an earlier result can be used unchanged.

    Raises:
        InputError: the file cannot be read or holds unexpected content.
    """
    text = read_source(path, _REMEDY)
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except csv.Error as error:
        raise InputError(f"cannot be read ({error})", str(path), _REMEDY) from None
    if not rows or not {"name", "mean", "sd"} <= set(rows[0]):
        raise InputError("has no columns name, mean, sd", str(path), _REMEDY)
    stated: dict[str, tuple[float, float]] = {}
    for line, row in enumerate(rows, start=2):
        if not row["sd"]:
            continue
        try:
            mean, sd = float(row["mean"]), float(row["sd"])
        except (TypeError, ValueError):
            seen = f"{row['mean']!r}, {row['sd']!r} are not numbers"
            raise InputError(seen, f"{path}, line {line}", _REMEDY) from None
        if row["name"] in stated:
            raise InputError(f"{row['name']} appears twice", f"{path}, line {line}", _REMEDY)
        stated[row["name"]] = mean, sd
    return stated
