"""The prior: proper, physical, and wide where nothing is stated.

Parameters theta and logarithms u of the noise scales are independent before the data, :eq:`prior`::

    p(theta) ~ prod_p exp(-((theta_p - mean_p) / sd_p)^2 / 2)  inside the region,   u_j ~ N(0, log_scale_sd^2).

- The region is the cone (pseudo-inertias positive definite, friction and rotor inertia nonnegative), cut by windows:
  each body's radius of gyration about its frame, tr(Sigma) <= R^2 m, and the mass of all bodies together.
- A body's ten parameters are centred on a typical link, with sd M for the mass, M R for first moments, M R^2 for
  inertias, for M and R of `Links`. Where CAD values are known, they and their sd take the place of these.
- A parameter of an actuator (friction, rotor inertia, offset) is (half-)normal about zero; its sd is the size at which
  it would by itself explain the effort of its joints: it cannot well be larger. Where the log does not show it but an
  earlier one did, the same holds for what that one has told, and 1 is the least.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.inertia import from_pseudo_inertia
from bayesid.knowledge import Information
from bayesid.motion import Array
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.region import Region
from bayesid.terms.base import Cone


@dataclass(frozen=True)
class Links:
    """What is believed of any link before the data.

    Attributes:
        mass: kg, scale of a link's mass.
        reach: m, scale of the distances of a link's mass from its frame.
        typical_mass: kg, where the prior is centred.
        typical_spread: m, rms distance along each axis there.
        largest_radius: m, bound on the radius of gyration about the frame.
        total_mass: kg, window on the mass of all bodies.
    """

    mass: float = 10.0
    reach: float = 0.4
    typical_mass: float = 3.0
    typical_spread: float = 0.1
    largest_radius: float = 1.5
    total_mass: tuple[float, float] = (0.1, 300.0)

    @property
    def centre(self) -> Array:
        """(10,) the typical link."""
        spread = self.typical_mass * self.typical_spread**2
        return from_pseudo_inertia(np.diag([spread, spread, spread, self.typical_mass]))

    @property
    def sd(self) -> Array:
        """(10,) standard deviations."""
        return self.mass * np.repeat([self.reach**2, self.reach, 1.0], [6, 3, 1])


@dataclass(frozen=True)
class Nominal:
    """Parameters known beforehand (CAD, data sheet).

    Attributes:
        mean: (P,) NaN where nothing is known.
        sd: (P,) their standard deviations.
    """

    mean: Array
    sd: Array


@dataclass(frozen=True)
class Prior:
    """A normal distribution inside a region, and one of the noise scales.

    Attributes:
        region: of the P parameters.
        mean: (P,).
        sd: (P,).
        log_scale_sd: (n,) sd of the logarithm of each joint's noise over the reference one.
        inside: (P,) some point well inside the region.
    """

    region: Region
    mean: Array
    sd: Array
    log_scale_sd: Array
    inside: Array

    def __post_init__(self) -> None:
        if not self.region.contains(self.inside[:, None]).all():
            raise ValueError("the prior's inner point lies outside of its region")

    @cached_property
    def precision(self) -> Array:
        """(P,) inverse variances."""
        return 1.0 / self.sd**2

    def log_density(self, theta: Array, log_scale: Array) -> Array:
        """(W,) of theta (W, P) and log_scale (W, n), not normalised; -inf outside of the region."""
        square = np.sum(((theta - self.mean) / self.sd) ** 2, axis=1) + np.sum(
            (log_scale / self.log_scale_sd) ** 2, axis=1
        )
        return np.where(self.region.contains(theta.T), -0.5 * square, -np.inf)


def make_prior(
    cone: Cone,
    likelihood: Likelihood,
    links: Links = Links(),
    nominal: Nominal | None = None,
    log_scale_sd: float = 0.5,
    known: Information | None = None,
) -> Prior:
    """The stated prior for a model.

    Args:
        cone: of the model's P parameters.
        likelihood: what sets the sizes of friction, rotor inertia and offsets; only its H_j and c_j are used.
        links: what is believed of any link.
        nominal: parameters known beforehand.
        log_scale_sd: of the logarithm of each joint's noise.
        known: from an earlier log; it sets the sizes of what this one does not show, and is no part of the prior.
    """
    mean, sd = np.zeros(cone.size), _sizes(likelihood, known)
    for body in cone.bodies:
        mean[body], sd[body] = links.centre, links.sd
    if nominal is not None:
        stated = np.isfinite(nominal.mean)
        mean, sd = np.where(stated, nominal.mean, mean), np.where(stated, nominal.sd, sd)
    region = Region.of(cone, *_windows(cone, links))
    return Prior(region, mean, sd, np.full(likelihood.n_joints, log_scale_sd), _inner_point(cone, links, sd))


def _inner_point(cone: Cone, links: Links, sd: Array) -> Array:
    """(P,) typical links, in the middle of the window of the total mass if they would not lie in it; friction > 0."""
    point = np.zeros(cone.size)
    point[cone.nonnegative] = sd[cone.nonnegative]
    least, most = links.total_mass
    total = links.typical_mass * len(cone.bodies)
    factor = 1.0 if least < total < most else 0.5 * (least + most) / max(total, 1e-300)
    for body in cone.bodies:
        point[body] = factor * links.centre
    return point


def _sizes(likelihood: Likelihood, known: Information | None) -> Array:
    """(P,) the size of each parameter that would alone explain the effort of the joints in which it shows."""
    shows = np.einsum("rp,jrs,sp->jp", likelihood.projection, likelihood.hessian, likelihood.projection)
    curvature = shows.sum(axis=0)
    energy = likelihood.energy @ (shows > 1e-9 * curvature)
    visible = curvature > 1e-12 * curvature.max(initial=1e-300)
    sizes = np.sqrt(np.where(visible, energy, 1.0) / np.where(visible, curvature, 1.0))
    if known is None:
        return sizes
    earlier = np.einsum("rp,rs,sp->p", likelihood.projection, known.hessian, likelihood.projection)
    shown = ~visible & (earlier > 1e-12 * earlier.max(initial=1e-300))
    sizes[shown] = np.sqrt(np.maximum(known.energy / earlier[shown], 1.0))
    return sizes


def _windows(cone: Cone, links: Links) -> tuple[Array, Array]:
    """(m, P) rows and (m,) offsets of the windows on radii and total mass."""
    count = len(cone.bodies)
    if count == 0:
        return np.empty((0, cone.size)), np.empty(0)
    radius, total = np.zeros((count, cone.size)), np.zeros(cone.size)
    for row, body in zip(radius, cone.bodies, strict=True):
        row[body[[0, 3, 5]]] = -0.5  # tr(Sigma) = tr(J) / 2
        row[body[9]] = links.largest_radius**2
        total[body[9]] = 1.0
    least, most = links.total_mass
    return np.vstack([radius, total, -total]), np.concatenate([np.zeros(count), [-least, most]])
