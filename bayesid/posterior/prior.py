"""The prior: proper, physical, and wide where nothing is stated.

Parameters theta and logarithms u of the noise scales are independent before the data, :eq:`prior`::

    p(theta) ~ prod_p exp(-((theta_p - mean_p) / sd_p)^2 / 2)  inside the region,   u_j ~ N(0, log_scale_sd^2).

- The region is the cone (pseudo-inertias positive definite, friction and rotor inertia nonnegative), cut by windows:
  each body's radius of gyration about its frame, tr(Sigma) <= R^2 m, and the mass of all bodies together.
- A body's ten parameters are centred on a typical link, with sd M for the mass, M R for first moments, M R^2 for
  inertias, for M and R of `Links`. Where CAD values are known, they and their sd take the place of these.
- A parameter of an actuator (friction, rotor inertia, offset) is (half-)normal about zero; its sd is the size at which
  it would by itself explain the effort of its joints: it cannot well be larger. Where the log does not show it but an
  earlier one did, it is the size that explains that one's effort, and 1 is the least.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.motion import Motion
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.region import Region
from bayesid.posterior.tuning import TUNING
from bayesid.regression.knowledge import Information, Links, Nominal
from bayesid.regression.moments import Moments
from bayesid.robot import Robot

_SHOWS = 1e-9
"""Share of a parameter's curvature from which it counts as showing in a joint; less is rounding."""
_VISIBLE = 1e-12
"""Share of the largest curvature from which the log shows a parameter at all; less is rounding."""


@dataclass(frozen=True)
class Window:
    """A bound on what the cone leaves open: a quantity of the P parameters, of which 0 to 1 lies inside."""

    name: str  #: of the quantity, in words
    part: Array  #: (P,) row of its numerator
    constant: float  #: added to the numerator
    whole: Array  #: (P,) row of its denominator, which is positive inside the cone
    bound: float  #: added to the denominator

    def share(self, theta: Array) -> Array:
        """(...) of theta (..., P): from 0, far inside, to 1, on the edge."""
        share: Array = (theta @ self.part + self.constant) / (theta @ self.whole + self.bound)
        return share


@dataclass(frozen=True)
class Prior:
    """A normal distribution inside a region, and one of the noise scales."""

    region: Region  #: of the P parameters
    mean: Array  #: (P,)
    sd: Array  #: (P,)
    log_scale_sd: Array  #: (n,) sd of the logarithm of each joint's noise over the reference one
    inside: Array  #: (P,) some point well inside the region
    windows: tuple[Window, ...] = ()  #: that cut the cone; they are in the region

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
    links: Links,
    nominal: Nominal | None = None,
    information: Information | None = None,
) -> Prior:
    """The stated prior for the P parameters of a model.

    The likelihood's H_j and c_j set the sizes of friction, rotor inertia and offsets. The information of an earlier
    log, which is no part of the prior, sets those of what this log does not show.
    """
    mean, sd = np.zeros(cone.size), _sizes(likelihood, information)
    for body in cone.bodies:
        mean[body], sd[body] = links.centre, links.sd
    if nominal is not None:
        stated = np.isfinite(nominal.mean)
        mean, sd = np.where(stated, nominal.mean, mean), np.where(stated, nominal.sd, sd)
    windows = _windows(cone, links)
    rows = np.array([window.whole - window.part for window in windows]).reshape(-1, cone.size)
    region = Region.of(cone, rows, np.array([window.bound - window.constant for window in windows]))
    scales = np.full(likelihood.n_joints, TUNING.log_scale_sd)
    return Prior(region, mean, sd, scales, _inner_point(cone, links, sd), windows)


def _inner_point(cone: Cone, links: Links, sd: Array) -> Array:
    """(P,) typical links, in the middle of the window of the total mass if they would not lie in it; friction > 0."""
    point = np.zeros(cone.size)
    point[cone.nonnegative] = sd[cone.nonnegative]
    least, most = links.total_mass
    total = links.typical_mass * len(cone.bodies)
    factor = 1.0 if least < total < most else 0.5 * (least + most) / max(total, TINY)
    for body in cone.bodies:
        point[body] = factor * links.centre
    return point


def _sizes(likelihood: Likelihood, information: Information | None) -> Array:
    """(P,) the size of each parameter that would alone explain the effort of the joints in which it shows."""
    by_joint = np.einsum("rp,jrs,sp->jp", likelihood.projection, likelihood.hessian, likelihood.projection)
    curvature = by_joint.sum(axis=0)
    energy = likelihood.energy @ (by_joint > _SHOWS * curvature)
    visible = curvature > _VISIBLE * curvature.max(initial=TINY)
    sizes = np.sqrt(np.where(visible, energy, 1.0) / np.where(visible, curvature, 1.0))
    if information is None:
        return sizes
    earlier = np.einsum("rp,rs,sp->p", likelihood.projection, information.hessian, likelihood.projection)
    earlier_only = ~visible & (earlier > _VISIBLE * earlier.max(initial=TINY))
    sizes[earlier_only] = np.sqrt(np.maximum(information.energy / earlier[earlier_only], 1.0))
    return sizes


def _windows(cone: Cone, links: Links) -> tuple[Window, ...]:
    if not len(cone.bodies):
        return ()
    windows, total, none = [], np.zeros(cone.size), np.zeros(cone.size)
    for number, body in enumerate(cone.bodies, start=1):
        trace, mass = np.zeros(cone.size), np.zeros(cone.size)
        trace[body[[0, 3, 5]]] = 0.5  # tr(Sigma) = tr(J) / 2
        mass[body[9]] = links.largest_radius**2
        total[body[9]] = 1.0
        windows.append(Window(f"radius of gyration of link {number}", trace, 0.0, mass, 0.0))
    least, most = links.total_mass
    windows.append(Window("mass of all links, from above", total, 0.0, none, most))
    windows.append(Window("mass of all links, from below", none, least, total, 0.0))
    return tuple(windows)


def usual_links(robot: Robot, motion: Motion, coefficients: BaseCoefficients, cone: Cone, moments: Moments) -> Links:
    """The scales of a robot's links; the default of `Links` for what neither its lengths nor its efforts show.

    Lengths are the arm's: a link's mass lies within a quarter of the stretched arm of its frame, give or take. The mass
    is the one whose efforts are those of the log: under the prior N(mu, D^2) of the links alone, for masses of 1 kg,
    the efforts of the log's motion have the expected energy tr(D B' H B D) + mu' B' H B mu. It grows with the square of
    the mass, and so :eq:`link-mass`::

        mass = 3 sqrt(c / (tr(D B' H B D) + mu' B' H B mu)),

    with H and c of all joints, in N m: gravity's torques over lengths and, where there is no gravity, those of the
    accelerations. Friction is in c too, so that the prior is rather wider than narrower. Scale a robot's masses,
    lengths and efforts, and its prior scales with them. The moments of the log are not scaled, in N m and N.
    """
    sliding = np.array([joint.prismatic for joint in robot.joints])
    span = robot.stretched + float(np.ptp(motion.q, axis=0)[sliding].sum())
    usual = Links() if span <= 0.0 else Links(reach=TUNING.link_reach * span)
    arm = np.where(sliding, usual.reach, 1.0)  # by which the force of a sliding joint is a torque
    scaled = moments.scaled(1.0 / arm)
    hessian, energy = scaled.hessian.total(), float(scaled.energy.sum())
    sd, mean = np.zeros(cone.size), np.zeros(cone.size)
    for body in cone.bodies:
        sd[body], mean[body] = usual.sd, usual.centre
    spread, middle = coefficients.projection * sd, coefficients.projection @ mean
    expected = float(np.sum(spread * (hessian @ spread)) + middle @ hessian @ middle)
    if expected <= 1e-12 * energy or energy <= TINY:
        return usual
    return Links(mass=TUNING.link_mass * usual.mass * np.sqrt(energy / expected), reach=usual.reach)
