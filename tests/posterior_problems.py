"""Small posteriors whose answers are known by other means."""

from __future__ import annotations

import numpy as np

from bayesid.posterior.feasible_set import FeasibleSet
from bayesid.posterior.likelihood import Likelihood, SegmentBlocks
from bayesid.posterior.target import Target, TruncatedGaussian
from bayesid.regression.knowledge import InformationMatrix


class Rotated:
    """Directions root Q with Q a random rotation: conjugate for the covariance root root'."""

    def __init__(self, root):
        self.root = root

    def draw(self, random):
        size = self.root.shape[1]
        q, r = np.linalg.qr(random.standard_normal((size, size)))
        return self.root @ (q * np.sign(np.diag(r)))


def likelihood(columns, effort, joint, segment, fixed, n):
    """Rows (N, r) with |effort| (N,), their joints (N,) and segments (N,), in units of the noise."""
    segments = int(segment.max()) + 1
    hessian = np.array([columns[joint == j].T @ columns[joint == j] for j in range(n)])
    gradient = np.array([columns[segment == k].T @ effort[segment == k] for k in range(segments)])
    return Likelihood(
        projection=np.eye(columns.shape[1]),
        hessian=hessian,
        energy=np.array([np.sum(effort[joint == j] ** 2) for j in range(n)]),
        count=np.bincount(joint, minlength=n).astype(float),
        gradient=gradient,
        joint=np.array([joint[segment == k][0] for k in range(segments)]),
        fixed=fixed,
        sigma=np.ones(n),
    )


def one_each(normal_equations):
    """A block for each segment, one behind the other."""
    end = np.cumsum(normal_equations.count)
    return SegmentBlocks(normal_equations, np.arange(len(normal_equations)), end - normal_equations.count, end)


def whole_space(size):
    """No constraint at all."""
    return FeasibleSet(np.empty((0, size)), np.empty(0), np.empty((10, 0, size)), np.empty((10, 0)))


def disc():
    """Two parameters inside the unit disc and above y = -0.3, the disc as a matrix [[1+x, y], [y, 1-x]] (+) E."""
    entries, constant = np.zeros((10, 1, 2)), np.zeros((10, 1))
    constant[[0, 4, 7, 9], 0] = 1.0
    entries[0, 0, 0], entries[4, 0, 0], entries[1, 0, 1] = 1.0, -1.0, 1.0
    return FeasibleSet(np.array([[0.0, 1.0]]), np.array([0.3]), entries, constant)


def simulate(target_of, theta, log_scale, rng, rows=60, segments=12, known=0.5, noise=0.7, common=0.0):
    """A likelihood from data drawn from the model itself: in each segment all rows are turned by one random sign."""
    n = len(log_scale)
    columns = rng.standard_normal((rows, len(theta)))
    columns += common * rng.standard_normal((rows, 1))  # columns alike: parameters correlate
    segment = np.arange(rows) % segments
    joint = segment % n
    signs = rng.choice([-1, 1], segments)
    fixed = np.where(np.arange(segments) < known * segments, signs, 0)
    effort = columns @ theta + noise * np.exp(log_scale[joint]) * rng.standard_normal(rows)
    return target_of(likelihood(columns / noise, signs[segment] * effort / noise, joint, segment, fixed, n))


def target_in(region, inside, prior_sd=1.0, log_scale_sd=0.3):
    """What makes a target of a likelihood: a normal prior about zero inside the region."""

    def make(data):
        size = region.size
        sd = np.full(data.n_joints, log_scale_sd)
        return Target(TruncatedGaussian(region, np.zeros(size), np.full(size, prior_sd), sd, inside), data)

    return make


def quadrature(target, axes):
    """Log of the integral, means and sds of the coordinates on the product grid of axes (evenly spaced)."""
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    region = target.prior.region
    grid = np.concatenate([part[region.contains(part[:, : region.size].T)] for part in _parts(grid)])  # else no density
    logs = np.concatenate([target.log_density(part) for part in _parts(grid)])
    weight = np.exp(logs - logs.max())
    cell = np.prod([axis[1] - axis[0] for axis in axes])
    mean = weight @ grid / weight.sum()
    sd = np.sqrt(weight @ (grid - mean) ** 2 / weight.sum())
    return np.log(weight.sum() * cell) + logs.max(), mean, sd


def _parts(grid):
    """Points that fit a processor's cache."""
    return np.array_split(grid, 1 + len(grid) // 10_000)


def samples_of(moves, coordinates, sweeps, random, burn=50):
    """(sweeps W, d) coordinates after each of the sweeps."""
    kept = []
    for k in range(burn + sweeps):
        coordinates = moves.update(coordinates, random)
        if k >= burn:
            kept.append(coordinates)
    return np.array(kept)


def information_of(columns, effort):
    """The information of rows (N, r) with efforts (N,), in units of their noise, all signs known."""
    return InformationMatrix(columns.T @ columns, columns.T @ effort, float(effort @ effort))
