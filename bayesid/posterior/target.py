"""The sampled density: prior times likelihood over coordinates (theta, u), times the information of an earlier log.

That information is a normal distribution of the coefficients beta = B theta, exp(-(beta' H beta - 2 g' beta + c) / 2).
Its noise is fixed and does not scale with u of the new log.

The prior is proper, physical, and wide without stated values. Parameters theta and logarithms u of the noise scales are
independent, :eq:`prior`::

    p(theta) ~ prod_p exp(-((theta_p - mean_p) / sd_p)^2 / 2)  inside the region,   u_j ~ N(0, log_scale_sd^2).

- The region is the cone (pseudo-inertias positive definite, friction and rotor inertia nonnegative), cut by stated
  constraints (`bayesid.effects.constraints`) and by windows: each body's radius of gyration about its frame,
  tr(Sigma) <= R^2 m, and the mass of all bodies together.
- A body's ten parameters are centred on a typical link, with sd M for the mass, M R for first moments, M R^2 for
  inertias, for M and R of `LinkPrior`. Stated values and their sd replace these.
- A parameter of an actuator (friction, rotor inertia, offset) is (half-)normal about zero. Its sd is the size that
  alone explains the effort of its joints. If only an earlier log shows it, that log's effort counts; otherwise the sd
  is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.constraints import Constraints
from bayesid.effects.parameters import Cone
from bayesid.motion import Motion
from bayesid.posterior.feasible_set import Centre, FeasibleSet, barrier_minimum
from bayesid.posterior.likelihood import Likelihood, SegmentBlocks, make_likelihood
from bayesid.posterior.tuning import TUNING
from bayesid.regression.interior import deepest_point
from bayesid.regression.knowledge import InformationMatrix, LinkPrior, NominalParameters
from bayesid.regression.noise import Noise
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.regression.stated import contradiction_of
from bayesid.robot import Robot

_ROUNDING_IN_JOINT = 1e-9
"""Share of a parameter's curvature in a joint below which it is rounding."""
_ROUNDING_OF_CURVATURE = 1e-12
"""Share of the largest curvature below which the log does not show a parameter."""


@dataclass(frozen=True)
class Bound:
    """A bound beyond the cone: a ratio of linear functions of the P parameters, which lies between 0 and 1 inside."""

    name: str  #: of the ratio, in words
    part: Array  #: (P,) row of its numerator
    constant: float  #: added to the numerator
    whole: Array  #: (P,) row of its denominator, which is positive inside the cone
    bound: float  #: added to the denominator

    def share(self, theta: Array) -> Array:
        """(...) the ratio at theta (..., P): from 0, far inside, to 1, on the edge."""
        share: Array = (theta @ self.part + self.constant) / (theta @ self.whole + self.bound)
        return share

    def slack(self, theta: Array) -> Array:
        """(...) slack at theta (..., P): positive inside, 0 on the edge."""
        slack: Array = theta @ (self.whole - self.part) + self.bound - self.constant
        return slack


@dataclass(frozen=True)
class TruncatedGaussian:
    """A normal distribution inside a region, and the prior of the noise scales."""

    region: FeasibleSet  #: of the P parameters
    mean: Array  #: (P,)
    sd: Array  #: (P,)
    log_scale_sd: Array  #: (n,) sd of the logarithm of each joint's noise over the reference one
    inside: Array  #: a point well inside the region
    windows: tuple[Bound, ...] = ()  #: bounds that cut the cone; part of the region
    stated: Constraints | None = None  #: stated constraints, part of the region
    unstated: FeasibleSet | None = None  #: the region without stated constraints; None without any

    @cached_property
    def precision(self) -> Array:
        """(P,) inverse variances."""
        return 1.0 / self.sd**2

    def within(self, cone: Cone) -> TruncatedGaussian:
        """The same prior with the stated constraints of a cone; windows that contradict them are dropped.

        Raises:
            InputError: the constraints contradict each other.
        """
        windows, inside = _within_stated(cone, self.windows, self.inside, self.sd)
        rows = _half_spaces(windows, cone.size)
        unstated = FeasibleSet.of(replace(cone, stated=None), *rows)
        return replace(
            self,
            region=FeasibleSet.of(cone, *rows),
            inside=inside,
            windows=windows,
            stated=cone.stated,
            unstated=unstated,
        )

    def log_density(self, theta: Array, log_scale: Array) -> Array:
        """(W,) log density at theta (W, P) and log_scale (W, n), not normalised; -inf outside of the region."""
        square = np.sum(((theta - self.mean) / self.sd) ** 2, axis=1) + np.sum(
            (log_scale / self.log_scale_sd) ** 2, axis=1
        )
        return np.where(self.region.contains(theta.T), -0.5 * square, -np.inf)


def make_prior(
    cone: Cone,
    likelihood: Likelihood,
    links: LinkPrior,
    nominal: NominalParameters | None = None,
    information: InformationMatrix | None = None,
) -> TruncatedGaussian:
    """The prior of a model's P parameters.

    The likelihood's H_j and c_j set the sizes of friction, rotor inertia and offsets. For parameters that this log does
    not show, the information of an earlier log sets them, although it is not part of the prior.
    """
    mean, sd = np.zeros(cone.size), _sizes(likelihood, information)
    for body in cone.bodies:
        mean[body], sd[body] = links.centre, links.sd
    if nominal is not None:
        stated = np.isfinite(nominal.mean)
        mean, sd = np.where(stated, nominal.mean, mean), np.where(stated, nominal.sd, sd)
    windows, inside = _windows(cone, links, likelihood.n_joints), _inner_point(cone, links, sd)
    scales = np.full(likelihood.n_joints, TUNING.log_scale_sd)
    region = FeasibleSet.of(replace(cone, stated=None), *_half_spaces(windows, cone.size))
    prior = TruncatedGaussian(region, mean, sd, scales, inside, windows)
    return prior if cone.stated is None else prior.within(cone)


def _half_spaces(windows: Sequence[Bound], size: int) -> tuple[Array, Array]:
    rows = np.array([window.whole - window.part for window in windows]).reshape(-1, size)
    return rows, np.array([window.bound - window.constant for window in windows])


def _within_stated(cone: Cone, windows: tuple[Bound, ...], near: Array, sd: Array) -> tuple[tuple[Bound, ...], Array]:
    """The windows that are compatible with the stated constraints, and a point deep inside all of them.

    Raises:
        InputError: the constraints contradict each other.
    """
    while True:
        found = deepest_point(cone, near, sd, *_half_spaces(windows, cone.size), [window.name for window in windows])
        if found.inside:
            return windows, found.theta
        compatible = tuple(window for window in windows if window.name not in found.labels)
        if len(compatible) == len(windows):
            raise contradiction_of(found.labels)
        windows = compatible


def _inner_point(cone: Cone, links: LinkPrior, sd: Array) -> Array:
    """(P,) typical links, scaled into the middle of the total mass window if outside of it; friction > 0."""
    point = np.zeros(cone.size)
    point[cone.nonnegative] = sd[cone.nonnegative]
    least, most = links.total_mass
    total = links.typical_mass * len(cone.bodies)
    factor = 1.0 if least < total < most else 0.5 * (least + most) / max(total, TINY)
    for body in cone.bodies:
        point[body] = factor * links.centre
    return point


def _sizes(likelihood: Likelihood, information: InformationMatrix | None) -> Array:
    """(P,) size at which each parameter alone would explain the effort of the joints that show it."""
    by_joint = np.einsum("rp,jrs,sp->jp", likelihood.projection, likelihood.hessian, likelihood.projection)
    curvature = by_joint.sum(axis=0)
    energy = likelihood.energy @ (by_joint > _ROUNDING_IN_JOINT * curvature)
    visible = curvature > _ROUNDING_OF_CURVATURE * curvature.max(initial=TINY)
    sizes = np.sqrt(np.where(visible, energy, 1.0) / np.where(visible, curvature, 1.0))
    if information is None:
        return sizes
    earlier = np.einsum("rp,rs,sp->p", likelihood.projection, information.hessian, likelihood.projection)
    earlier_only = ~visible & (earlier > _ROUNDING_OF_CURVATURE * earlier.max(initial=TINY))
    sizes[earlier_only] = np.sqrt(np.maximum(information.energy / earlier[earlier_only], 1.0))
    return sizes


def _windows(cone: Cone, links: LinkPrior, n_links: int) -> tuple[Bound, ...]:
    """Windows of the bodies; those beyond the links are payloads."""
    if not len(cone.bodies):
        return ()
    windows, total, none = [], np.zeros(cone.size), np.zeros(cone.size)
    for number, body in enumerate(cone.bodies, start=1):
        trace, mass = np.zeros(cone.size), np.zeros(cone.size)
        trace[body[[0, 3, 5]]] = 0.5  # tr(Sigma) = tr(J) / 2
        mass[body[9]] = links.largest_radius**2
        total[body[9]] = 1.0
        payload = "the payload" if len(cone.bodies) == n_links + 1 else f"payload {number - n_links}"
        whose = f"link {number}" if number <= n_links else payload
        windows.append(Bound(f"radius of gyration of {whose}", trace, 0.0, mass, 0.0))
    least, most = links.total_mass
    windows.append(Bound("mass of all links, from above", total, 0.0, none, most))
    windows.append(Bound("mass of all links, from below", none, least, total, 0.0))
    return tuple(windows)


def usual_links(
    robot: Robot,
    motion: Motion,
    coefficients: BaseCoefficients,
    cone: Cone,
    normal_equations: NormalEquations,
    *,
    reach: float | None = None,
) -> LinkPrior:
    """The scales of a robot's links; defaults of `LinkPrior` where neither lengths nor efforts determine them.

    The distance scale is a quarter of the stretched arm, or `reach` (m) if stated. The mass scale explains the log's
    efforts. Under the prior N(mu, D^2) of the links alone, for masses of 1 kg, the log's motion has the expected energy
    tr(D B' H B D) + mu' B' H B mu. It grows with the square of the mass, and so :eq:`link-mass`::

        mass = 3 sqrt(c / (tr(D B' H B D) + mu' B' H B mu)),

    with H and c of all joints, in N m: from gravity, or without gravity from the accelerations. Friction is included in
    c, which makes the prior wider. The prior scales with the robot's masses, lengths and efforts. The normal equations
    are not scaled, in N m and N.
    """
    sliding = np.array([joint.prismatic for joint in robot.joints])
    span = robot.stretched + float(np.ptp(motion.q, axis=0)[sliding].sum())
    reach = TUNING.link_reach * span if reach is None and span > 0.0 else reach
    usual = LinkPrior() if reach is None else LinkPrior(reach=reach)
    arm = np.where(sliding, usual.reach, 1.0)  # lever arm that turns the force of a sliding joint into a torque
    scaled = normal_equations.scaled(1.0 / arm)
    hessian, energy = scaled.hessian.total(), float(scaled.energy.sum())
    sd, mean = np.zeros(cone.size), np.zeros(cone.size)
    for body in cone.bodies:
        sd[body], mean[body] = usual.sd, usual.centre
    spread, middle = coefficients.projection * sd, coefficients.projection @ mean
    expected = float(np.sum(spread * (hessian @ spread)) + middle @ hessian @ middle)
    if expected <= 1e-12 * energy or energy <= TINY:
        return usual
    return LinkPrior(mass=TUNING.link_mass * usual.mass * np.sqrt(energy / expected), reach=usual.reach)


@dataclass(frozen=True)
class Target:
    """The posterior of one branch, over P parameters and n logarithms of noise scales."""

    prior: TruncatedGaussian
    likelihood: Likelihood
    information: InformationMatrix | None = (
        None  #: of the coefficients, from an earlier log; its H is positive semidefinite
    )

    @property
    def n_parameters(self) -> int:
        """P."""
        return len(self.prior.mean)

    @property
    def dimension(self) -> int:
        """P + n."""
        return self.n_parameters + self.likelihood.n_joints

    def split(self, coordinates: Array) -> tuple[Array, Array]:
        """Parameters theta (..., P) and u (..., n) from coordinates (..., P + n)."""
        return coordinates[..., : self.n_parameters], coordinates[..., self.n_parameters :]

    def log_density(self, coordinates: Array) -> Array:
        """(W,) log posterior of (W, P + n), not normalised; -inf outside of the region."""
        theta, log_scale = self.split(np.atleast_2d(coordinates))
        value = self.prior.log_density(theta, log_scale)
        inside = np.isfinite(value)
        value[inside] += self.likelihood.log_likelihood(theta[inside], log_scale[inside])
        if self.information is not None:
            beta = theta[inside] @ self.likelihood.projection.T
            pulled = beta @ self.information.hessian - 2.0 * self.information.gradient
            value[inside] -= 0.5 * (np.sum(pulled * beta, axis=1) + self.information.energy)
        return value

    def quadratic(
        self, theta: Array, log_scale: Array, model_error_covariance: Array | None = None
    ) -> tuple[Array, Array]:
        """A (P, P) and b (P,) of log p = -theta' A theta / 2 + b' theta + const (:eq:`posterior-precision`).

        Noise scales u (n,) are given, and unknown segments have the signs that theta (P,) predicts. A covariance (r, r)
        of model error widens the likelihood: H becomes (H^-1 + L L')^-1 = H - H L (1 + L' H L)^-1 L' H (Woodbury), with
        the same centre.
        """
        likelihood, prior = self.likelihood, self.prior
        scale = log_scale[None]
        signs = likelihood.likelier_signs(theta[None], scale)
        data = likelihood.conditional_gradient(np.zeros((1, likelihood.hessian.shape[1])), scale, signs)[0]
        hessian = np.einsum("j,jrs->rs", np.exp(-2.0 * log_scale), likelihood.hessian)
        if self.information is not None:
            data, hessian = data + self.information.gradient, hessian + self.information.hessian
        if model_error_covariance is not None:
            sizes, turn = np.linalg.eigh(model_error_covariance)
            root = turn * np.sqrt(np.maximum(sizes, 0.0))
            pulled = hessian @ root
            middle = np.linalg.solve(np.eye(len(root)) + root.T @ pulled, np.column_stack([pulled.T, root.T @ data]))
            hessian, data = hessian - pulled @ middle[:, :-1], data - pulled @ middle[:, -1]
        precision = likelihood.projection.T @ hessian @ likelihood.projection + np.diag(prior.precision)
        return 0.5 * (precision + precision.T), likelihood.projection.T @ data + prior.precision * prior.mean

    def centre(self, theta: Array, log_scale: Array) -> Centre:
        """The region's centre for the same signs and noise scales; theta need not be feasible.

        Raises:
            LinAlgError: the Hessian is numerically singular.
        """
        return barrier_minimum(self.prior.region, *self.quadratic(theta, log_scale), self.prior.inside)


@dataclass(frozen=True)
class PosteriorProblem:
    """All inputs of a posterior except the signs."""

    blocks: SegmentBlocks  #: of S segments, with efforts in expected signs relative to their segment's
    coefficients: BaseCoefficients  #: the r base coefficients
    cone: Cone  #: of the P parameters
    noise: Noise  #: of the efforts; the reference of the noise scales
    links: LinkPrior  #: prior of any link
    nominal: NominalParameters | None = None  #: stated parameters
    #: of the r coefficients, from an earlier log; its c is the effort that it explains, which sets sizes
    information: InformationMatrix | None = None

    def with_least_noise(self) -> PosteriorProblem:
        """The same problem with 0.1 % of each effort added to its noise and its residual."""
        floor = TUNING.least_noise * self.normal_equations.rms_effort(len(self.noise.sigma))
        noise = self.noise.scaled(np.hypot(self.noise.sigma, floor) / self.noise.sigma)
        energy = (1.0 + TUNING.least_noise**2) * self.blocks.normal_equations.energy
        return replace(
            self,
            noise=noise,
            blocks=replace(self.blocks, normal_equations=replace(self.blocks.normal_equations, energy=energy)),
        )

    @cached_property
    def normal_equations(self) -> NormalEquations:
        """Normal equations of the segments, not scaled."""
        return self.blocks.of_segments

    @cached_property
    def target(self) -> Target:
        """The density with all unknown signs summed out."""
        unknown = np.zeros(len(self.normal_equations), dtype=np.int64)
        likelihood = make_likelihood(
            self.normal_equations, self.coefficients, self.noise.sigma, self.noise.autocorrelation, unknown
        )
        prior = make_prior(self.cone, likelihood, self.links, self.nominal, information=self.information)
        return Target(prior, likelihood, self.information)

    @cached_property
    def scaled_moments(self) -> NormalEquations:
        """Normal equations in units of the reference noise."""
        return self.normal_equations.scaled(self.noise.sigma * np.sqrt(self.noise.autocorrelation))

    @cached_property
    def solver(self) -> ConeLeastSquares:
        """Solver for the sum of the scaled normal equations and the information."""
        hessian, energy = self.scaled_moments.hessian.total(), float(self.scaled_moments.energy.sum())
        if self.information is not None:
            hessian, energy = hessian + self.information.hessian, energy + self.information.energy
        return ConeLeastSquares(self.cone, self.coefficients, hessian, energy)
