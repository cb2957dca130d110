"""Random plausible parameters of a model."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.robot.inertia import from_pseudo_inertia
from bayesid.simulation.tuning import TUNING


def random_parameters(model: Model, *, rng: np.random.Generator | int | None = 0) -> Array:
    """(P,) random plausible parameters of a model, strictly inside its cone and without symmetries.

    Bodies have the size of their link. The effort of every other parameter is a share of the bodies' effort (without
    bodies: of 1 N m): 5 to 25 % if it is nonnegative (friction, rotor inertia), 1 to 5 % otherwise (offsets).

    Args:
        model: with P parameters.
        rng: a seed, a generator, or None for a random seed.

    Example:
        >>> theta = bayesid.random_parameters(model, rng=0)
        >>> model.cone.contains(theta)
        True
    """
    rng = np.random.default_rng(rng)
    theta, cone = np.zeros(len(model.parameters)), model.cone
    reach = max(TUNING.shortest_reach, model.robot.stretched)
    ends, masses = model.robot.link_ends, _random_masses(model.robot.n_joints, reach, rng)
    radii = TUNING.slenderness * reach * np.cbrt(masses / masses[0])
    for body in cone.bodies:
        link = model.parameters[body[0]].joint - 1
        theta[body] = random_body(ends[link], masses[link], radii[link], rng)
    shape = (200, model.robot.n_joints)  # random samples at usual speeds of an industrial arm
    q, dq, ddq = (rng.uniform(-limit, limit, shape) for limit in (2.0, 2.0, 5.0))
    columns = model.columns(Motion(np.arange(200.0), q, dq, ddq))  # without payloads, which are all bodies
    others = np.setdiff1d(np.arange(cone.size), cone.bodies)
    shares = rng.uniform(*TUNING.of_either_sign, cone.size) * rng.choice([-1.0, 1.0], cone.size)
    shares[cone.nonnegative] = rng.uniform(*TUNING.of_one_sign, len(cone.nonnegative))
    effort, each = rms(columns @ theta), rms(columns[:, :, others])
    strongest = np.argmax(each, axis=0)  # joint with the largest effort of a parameter
    theta[others] = shares[others] * (or_one(effort)[strongest] / or_one(np.max(each, axis=0)))
    return theta


def or_one(size: Array) -> Array:
    """Divisors, with 1 in place of 0."""
    return np.where(size > 0.0, size, 1.0)


def rms(values: Array) -> Array:
    """Root mean square over the samples, the first axis."""
    size: Array = np.sqrt(np.mean(values**2, axis=0))
    return size


def _random_masses(n_joints: int, reach: float, rng: np.random.Generator) -> Array:
    """(n,) masses, kg, decreasing towards the tip."""
    total = TUNING.kg_per_m * reach * rng.uniform(*TUNING.weight)
    relative = np.cumprod(rng.uniform(*TUNING.taper, n_joints))
    masses: Array = total * relative / relative.sum()
    return masses


def random_body(ends: Array, mass: float, radius: float, rng: np.random.Generator) -> Array:
    """(10,) parameters of an asymmetric rod between `ends` (2, 3), with a positive definite pseudo-inertia."""
    along = ends[1] - ends[0]
    centre = ends[0] + rng.uniform(0.3, 0.7) * along + radius * rng.uniform(-0.5, 0.5, 3)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0] * (radius * rng.uniform(0.5, 1.0, 3))
    spread = axes @ axes.T + np.outer(along, along) / 12
    point = np.append(centre, 1.0)
    pseudo_inertia = np.outer(point, point)
    pseudo_inertia[:3, :3] += spread
    return from_pseudo_inertia(mass * pseudo_inertia)
