"""Coordinates of NUTS for the benchmark of samplers: smooth maps of R^d onto the region of a posterior."""

from __future__ import annotations

import importlib.util
import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia

if TYPE_CHECKING:
    from bayesid.studies.benchmarks.posterior import Problem

_LOG_2 = float(np.log(2.0))


def numpyro_installed() -> bool:
    """Whether NUTS can be run."""
    return importlib.util.find_spec("numpyro") is not None


@cache
def jax_module() -> Any:
    """The optional package jax, in double precision and on one thread."""
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax


class Coordinates(ABC):
    """A smooth map of R^d onto the region without the bounds of the total mass.

    Coordinates z: ten per body, one per nonnegative parameter, all other parameters, the noise scales u.

    Args:
        problem: with the region.
        starts: (W, P + n) points inside, from which some maps take their scales.
    """

    name: str

    def __init__(self, problem: Problem, starts: Array) -> None:
        cone = problem.cone
        self.n_parameters, self.bodies, self.nonnegative = cone.size, cone.bodies, cone.nonnegative
        self.free = np.setdiff1d(np.arange(cone.size), np.concatenate([cone.bodies.ravel(), cone.nonnegative]))
        self.square_radius = _square_radii(problem)
        self.of_matrix = np.linalg.pinv(PSEUDO_INERTIA_BASIS.reshape(10, 16).T)
        self._ends = np.cumsum([cone.bodies.size, len(cone.nonnegative), len(self.free)])

    @abstractmethod
    def matrices(self, z: Any) -> tuple[Any, Any]:
        """(b, 4, 4) pseudo-inertias from coordinates (b, 10), and the sum of log |d triangle / d z|."""

    @abstractmethod
    def positive(self, z: Any) -> tuple[Any, Any]:
        """(k,) nonnegative parameters, and the sum of the logs of the map's derivatives."""

    @abstractmethod
    def matrices_back(self, matrices: Array) -> Array:
        """(W, b, 10) coordinates of pseudo-inertias (W, b, 4, 4)."""

    @abstractmethod
    def positive_back(self, values: Array) -> Array:
        """(W, k) coordinates of nonnegative parameters (W, k)."""

    def forward(self, z: Any) -> tuple[Any, Any]:
        """(P + n,) theta and u of one z (P + n,), and log |Jacobian|."""
        jnp = jax_module().numpy
        of_bodies, of_positive, of_free, log_scale = jnp.split(z, self._ends)
        matrices, volume = self.matrices(of_bodies.reshape(-1, 10))
        positive, stretched = self.positive(of_positive)
        theta = jnp.zeros(self.n_parameters)
        theta = theta.at[self.bodies].set(matrices.reshape(-1, 16) @ self.of_matrix.T)
        theta = theta.at[self.nonnegative].set(positive).at[self.free].set(of_free)
        # the map from J to tr(J) / 2 E - J, the part of a pseudo-inertia that is not a parameter, has determinant 1 / 2
        return jnp.concatenate([theta, log_scale]), volume + stretched + len(self.bodies) * _LOG_2

    def back(self, coordinates: Array) -> Array:
        """(W, P + n) z of theta and u (W, P + n)."""
        theta = coordinates[:, : self.n_parameters]
        of_bodies = self.matrices_back(pseudo_inertia(theta[:, self.bodies])).reshape(len(theta), -1)
        of_positive = self.positive_back(theta[:, self.nonnegative])
        unchanged = theta[:, self.free], coordinates[:, self.n_parameters :]
        return np.concatenate([of_bodies, of_positive, *unchanged], axis=1)


def _windows(problem: Problem) -> tuple[Array, Array]:
    """(m, P) rows and (m,) offsets of the half spaces outside the cone, in the order of `FeasibleSet.of`."""
    region, cone = problem.target.prior.region, problem.cone
    inner = slice(len(cone.nonnegative), len(region.rows) - 4 * len(cone.bodies))
    return region.rows[inner], region.offset[inner]


def _square_radii(problem: Problem) -> Array:
    """(b,) R^2 of each body's bound tr(Sigma) <= R^2 m.

    Raises:
        ValueError: the first half spaces are of another form.
    """
    bodies = problem.cone.bodies
    rows, offset = _windows(problem)
    square = np.array([row[body[9]] for row, body in zip(rows, bodies, strict=False)])
    expected = np.zeros((len(bodies), problem.cone.size))
    for k, body in enumerate(bodies):
        expected[k, body[[0, 3, 5]]], expected[k, body[9]] = -0.5, square[k]
    if not np.array_equal(rows[: len(bodies)], expected) or np.any(offset[: len(bodies)] != 0.0):
        raise ValueError("the prior's bounds of the radii differ from those that these coordinates remove")
    return square


def _joined(second: Any, first: Any, mass: Any) -> Any:
    """(b, 4, 4) [[second, first], [first', mass]] of (b, 3, 3), (b, 3) and (b,)."""
    jnp = jax_module().numpy
    top = jnp.concatenate([second, first[:, :, None]], axis=2)
    return jnp.concatenate([top, jnp.concatenate([first, mass[:, None]], axis=1)[:, None]], axis=1)


class LogCholesky(Coordinates):
    """P = U U' with U upper triangular, logarithms of its diagonal as coordinates.

    Bound of the radius: with r = tr(Sigma) / (R^2 m) of such a P, lengths are multiplied by sqrt(f), f = 1 / (1 + r),
    so that f r < 1. The determinant of this map is f^8.5.
    """

    name = "log-Cholesky"
    _upper = ((0, 0, 1, 0, 1, 2), (1, 2, 2, 3, 3, 3))

    def matrices(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        jnp = jax_module().numpy
        root = jnp.zeros((len(z), 4, 4)).at[:, np.arange(4), np.arange(4)].set(jnp.exp(z[:, :4]))
        root = root.at[:, self._upper[0], self._upper[1]].set(z[:, 4:])
        wide = root @ root.swapaxes(1, 2)
        trace = wide[:, 0, 0] + wide[:, 1, 1] + wide[:, 2, 2]
        log_f = -jnp.log1p(trace / (self.square_radius * wide[:, 3, 3]))
        length = jnp.exp(0.5 * log_f)[:, None] ** np.array([1.0, 1.0, 1.0, 0.0])
        volume = jnp.sum(z[:, :4] @ np.array([2.0, 3.0, 4.0, 5.0]) + 8.5 * log_f + 4.0 * _LOG_2)
        return length[:, :, None] * wide * length[:, None, :], volume

    def positive(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        jnp = jax_module().numpy
        return jnp.exp(z), jnp.sum(z)

    def matrices_back(self, matrices: Array) -> Array:
        """See Coordinates."""
        ratio = np.trace(matrices[..., :3, :3], axis1=-2, axis2=-1) / (self.square_radius * matrices[..., 3, 3])
        length = (1.0 - ratio)[..., None] ** np.array([-0.5, -0.5, -0.5, 0.0])
        wide = length[..., :, None] * matrices * length[..., None, :]
        root = np.linalg.cholesky(wide[..., ::-1, ::-1])[..., ::-1, ::-1]
        diagonal = np.log(np.diagonal(root, axis1=-2, axis2=-1))
        return np.concatenate([diagonal, root[..., self._upper[0], self._upper[1]]], axis=-1)

    def positive_back(self, values: Array) -> Array:
        """See Coordinates."""
        return np.log(values)


class Linear(Coordinates):
    """Coordinates in which parameters are as linear as the region allows.

    A body is h, its first moments; mu > 0 with mass m, R^2 m - |h|^2 / m = R^2 mu; and C = Sigma - h h' / m, positive
    definite with tr(C) < R^2 mu. With some positive definite W and t = tr(W) / (R^2 mu) it is C = W (1 - exp(-t)) / t;
    W is given by its pivots and the columns of its Schur complements. mu, pivots and nonnegative parameters are
    s softplus(z / s) of coordinates z, with s a tenth of the size at the starting points.
    """

    name = "linear"
    _softness = 0.1

    def __init__(self, problem: Problem, starts: Array) -> None:
        super().__init__(problem, starts)
        theta = starts[:, : self.n_parameters]
        pivots = self._eliminated(pseudo_inertia(theta[:, self.bodies]))[0]
        self._of_pivots = self._softness * np.median(pivots, axis=0)
        self._of_positive = self._softness * np.median(theta[:, self.nonnegative], axis=0)

    def matrices(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        jnp = jax_module().numpy
        pivots, stretched = _softplus(z[:, :4], self._of_pivots)
        mu, first = pivots[:, 0], z[:, 4:7]
        root = jnp.sqrt(mu**2 + 4.0 * jnp.sum(first**2, axis=1) / self.square_radius)
        mass = 0.5 * (mu + root)
        wide = pivots[:, 3][:, None, None]
        for pivot, column in ((pivots[:, 2], z[:, 9:10]), (pivots[:, 1], z[:, 7:9])):
            wide = wide + column[:, :, None] * column[:, None, :] / pivot[:, None, None]
            border = jnp.concatenate([pivot[:, None], column], axis=1)[:, :, None]
            wide = jnp.concatenate([border, jnp.concatenate([column[:, None], wide], axis=1)], axis=2)
        t = (wide[:, 0, 0] + wide[:, 1, 1] + wide[:, 2, 2]) / (self.square_radius * mu)
        f = -jnp.expm1(-t) / t
        second = f[:, None, None] * wide + first[:, :, None] * first[:, None, :] / mass[:, None, None]
        volume = jnp.sum(5.0 * jnp.log(f) - t + jnp.log(mass / root))
        return _joined(second, first, mass), stretched + volume

    def positive(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        return _softplus(z, self._of_positive)

    def matrices_back(self, matrices: Array) -> Array:
        """See Coordinates."""
        pivots, columns = self._eliminated(matrices)
        return np.concatenate([_softplus_back(pivots, self._of_pivots), columns], axis=-1)

    def positive_back(self, values: Array) -> Array:
        """See Coordinates."""
        return _softplus_back(values, self._of_positive)

    def _eliminated(self, matrices: Array) -> tuple[Array, Array]:
        """(W, b, 4) mu and pivots, (W, b, 6) h and columns."""
        first, mass = matrices[..., :3, 3], matrices[..., 3, 3]
        mu = mass - np.sum(first**2, axis=-1) / (self.square_radius * mass)
        schur = matrices[..., :3, :3] - first[..., :, None] * first[..., None, :] / mass[..., None, None]
        ratio = np.trace(schur, axis1=-2, axis2=-1) / (self.square_radius * mu)
        schur = schur * (-np.log1p(-ratio) / ratio)[..., None, None]
        pivots, columns = [mu], [first]
        for _ in range(3):
            pivot, column = schur[..., 0, 0], schur[..., 1:, 0]
            pivots.append(pivot)
            columns.append(column)
            schur = schur[..., 1:, 1:] - column[..., :, None] * column[..., None, :] / pivot[..., None, None]
        return np.stack(pivots, axis=-1), np.concatenate(columns, axis=-1)


def _softplus(z: Any, scale: Array) -> tuple[Any, Any]:
    """Values s log(1 + exp(z / s)), and the sum of the logs of the derivatives."""
    jax = jax_module()
    return scale * jax.nn.softplus(z / scale), jax.numpy.sum(jax.nn.log_sigmoid(z / scale))


def _softplus_back(values: Array, scale: Array) -> Array:
    back: Array = values + scale * np.log(-np.expm1(-values / scale))
    return back


def make_log_density(problem: Problem, coordinates: Coordinates) -> Callable[[Any], Any]:
    """Log density of z (P + n,), in jax: `Target.log_density` plus log |Jacobian|."""
    jnp = jax_module().numpy
    likelihood, prior = problem.target.likelihood, problem.target.prior
    n, r, _ = likelihood.hessian.shape
    hessian, joint = jnp.asarray(likelihood.hessian.reshape(n * r, r)), likelihood.joint[likelihood.unknown]
    rows, offset = (part[len(problem.cone.bodies) :] for part in _windows(problem))

    def log_density(z: Any) -> Any:
        inner, volume = coordinates.forward(z)
        theta, log_scale = inner[: len(prior.mean)], inner[len(prior.mean) :]
        beta, weight = likelihood.projection @ theta, jnp.exp(-2.0 * log_scale)
        push = jnp.abs(likelihood.open_gradient @ beta * weight[joint])
        marginal = jnp.sum(push + jnp.log1p(jnp.exp(-2.0 * push)))
        squares = (hessian @ beta).reshape(n, r) @ beta + likelihood.energy
        data = marginal - likelihood.count @ log_scale - weight @ (0.5 * squares - likelihood.fixed_gradient @ beta)
        square = jnp.sum(((theta - prior.mean) / prior.sd) ** 2) + jnp.sum((log_scale / prior.log_scale_sd) ** 2)
        inside = jnp.all(rows @ theta + offset > 0.0)
        return jnp.where(inside, data - 0.5 * square + volume, -jnp.inf)

    return log_density
