"""Small logs made row by row, their inference, and what enumeration of their signs and quadrature say of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from posterior_problems import one_each
from scipy.special import logsumexp
from sign_problems import moments_of

from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.posterior.inference import infer
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.modes import find_modes
from bayesid.posterior.sampler import Sampling
from bayesid.posterior.target import PosteriorProblem, Target, make_prior
from bayesid.progress import SILENT
from bayesid.regression.knowledge import InformationMatrix, LinkPrior, NominalParameters
from bayesid.regression.noise import Noise
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.search.certified import certified

LOG_SCALE_SD = 0.5  # of the stated prior
FEW = Sampling(walkers=16)
AVERAGED = 1024  # draws, at least, from which probabilities are averaged


@dataclass(frozen=True)
class Log:
    """Rows of segments, each turned by a sign that is known or not, and all that an inference wants of them."""

    rows: tuple  # of each segment: columns (m, r) and efforts (m,), N m
    joint: np.ndarray
    known: np.ndarray
    cone: Cone
    nominal: NominalParameters  # of all parameters, so that no default of the prior matters
    sigma: np.ndarray
    time: np.ndarray  # samples that count as one
    projection: np.ndarray
    earlier: InformationMatrix | None = None  # of an earlier log

    @property
    def normal_equations(self):
        return moments_of(self.rows, self.joint, self.known)

    @property
    def scaled(self):
        return self.normal_equations.scaled(self.sigma * np.sqrt(self.time))

    @property
    def noise(self):
        return Noise(0.6 * self.sigma, 0.8 * self.sigma, np.full(len(self.sigma), 0.1), self.time)

    @property
    def coefficients(self):
        names = tuple(f"b{k}" for k in range(len(self.projection)))
        return BaseCoefficients(names, names, names, np.arange(len(names)), self.projection)

    @property
    def solver(self):
        scaled, earlier = self.scaled, self.earlier or InformationMatrix.none(len(self.projection))
        hessian, energy = scaled.hessian.total() + earlier.hessian, float(scaled.energy.sum()) + earlier.energy
        return ConeLeastSquares(self.cone, self.coefficients, hessian, energy)

    @property
    def target(self):
        none = np.zeros(len(self.joint), dtype=np.int64)
        likelihood = make_likelihood(self.normal_equations, self.coefficients, self.sigma, self.time, none)
        return Target(make_prior(self.cone, likelihood, LinkPrior(), self.nominal), likelihood, self.earlier)

    def search(self):
        return certified(self.scaled, replace(self, earlier=None).solver, budget=20.0)

    def modes(self, search=None):
        return find_modes(self.target, self.scaled, self.solver, search or self.search())

    def segment_logs(self, theta, log_scale):
        """(2, S, M) log densities of each segment's efforts with sign + and -, at M points, by its rows."""
        values = np.empty((2, len(self.rows), len(theta)))
        for k, ((columns, effort), j) in enumerate(zip(self.rows, self.joint, strict=True)):
            predicted = columns @ self.projection @ theta.T
            weight = np.exp(-2.0 * log_scale[:, j]) / self.sigma[j] ** 2
            for row, sign in zip(values, (1.0, -1.0), strict=True):
                square = np.sum((sign * effort[:, None] - predicted) ** 2, axis=0)
                row[k] = -(0.5 * weight * square + len(effort) * log_scale[:, j]) / self.time[j]
        values[1, self.known > 0] = values[0, self.known < 0] = -np.inf
        return values

    def log_prior(self, theta, log_scale):
        """(M,) inside the cone; the earlier log included."""
        square = ((theta - self.nominal.mean) / self.nominal.sd) ** 2
        value = -0.5 * square.sum(axis=1) - 0.5 * np.sum((log_scale / LOG_SCALE_SD) ** 2, axis=1)
        if self.earlier is not None:
            beta, known = theta @ self.projection.T, self.earlier
            value -= 0.5 * np.einsum("mr,rs,ms->m", beta, known.hessian, beta) - beta @ known.gradient
        return value

    def log_density(self, theta, log_scale=None):
        """(M,) of the posterior, not normalised, all signs summed out."""
        log_scale = np.zeros((len(theta), len(self.sigma))) if log_scale is None else log_scale
        return self.log_prior(theta, log_scale) + logsumexp(self.segment_logs(theta, log_scale), axis=0).sum(axis=0)


def make_log(
    theta,
    rows=(8,) * 6,
    joint=None,
    known=None,
    mean=None,
    sd=None,
    cone=None,
    sigma=(1.0,),
    time=(1.0,),
    seed=0,
    projection=None,
    sees=None,
):
    """A log of the model itself: rows normal with sds `sees` (n, r) of each joint, signs drawn, some known."""
    rng = np.random.default_rng(seed)
    theta, sigma, time = (np.array(values, dtype=float) for values in (theta, sigma, time))
    joint = np.zeros(len(rows), dtype=np.int64) if joint is None else np.array(joint)
    known = np.zeros(len(rows), dtype=bool) if known is None else np.array(known, dtype=bool)
    projection = np.eye(len(theta)) if projection is None else np.array(projection)
    sees = np.ones((len(sigma), len(projection))) if sees is None else np.array(sees)
    signs, pieces = rng.choice([-1, 1], len(rows)), []
    for sign, m, j in zip(signs, rows, joint, strict=True):
        columns = rng.standard_normal((m, len(projection))) * sees[j]
        effort = columns @ projection @ theta + sigma[j] * rng.standard_normal(m)
        pieces.append((columns, sign * effort))
    nominal = NominalParameters(
        np.zeros(len(theta)) if mean is None else np.array(mean), np.ones(len(theta)) if sd is None else np.array(sd)
    )
    cone = Cone.free(len(theta)) if cone is None else cone
    return Log(tuple(pieces), joint, np.where(known, signs, 0), cone, nominal, sigma, time, projection)


def unproven(search):
    """The same without any list of assignments."""
    return replace(search, branches=(), persistent=None, certified=False, missed=np.inf)


def near_symmetric(lean=1.0, seed=3):
    """The unknown signs of joint 0 may all be turned with its free parameter; what decides is `lean` of the prior."""
    return make_log(
        (1.5, 0.4),
        rows=(8, 9, 10, 8, 12),
        joint=(0, 0, 0, 1, 1),
        known=(0, 0, 0, 1, 1),
        sd=(2.0, 1.0),
        mean=(lean, 0.2),
        cone=Cone.free(1) + Cone.orthant(1),
        sigma=(1.0, 0.5),
        time=(1.0, 1.5),
        sees=((1.0, 0.3), (0.0, 1.0)),
        seed=seed,
    )


def nonnegative():
    """Two joints and one parameter that is nonnegative and presses against zero; all signs of joint 1 in doubt."""
    return make_log(
        (0.2,),
        rows=(4, 5, 3, 6, 5),
        joint=(0, 1, 1, 1, 0),
        known=(1, 0, 0, 0, 0),
        cone=Cone.orthant(1),
        mean=(-0.3,),
        sd=(0.7,),
        sigma=(0.5, 0.8),
        time=(2.0, 1.2),
        seed=6,
    )


def problem_of(log):
    return PosteriorProblem(
        one_each(log.normal_equations), log.coefficients, log.cone, log.noise, LinkPrior(), log.nominal, log.earlier
    )


def infer_from(log, search=None, options=FEW, progress=SILENT):
    search = search or log.search()
    return infer(problem_of(log), search, options, progress)


class Enumerated:
    """Every assignment of the unknown signs, and the integral of its posterior over a product grid of axes."""

    def __init__(self, log, *axes):
        size = log.cone.size
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        self.theta, log_scale = points[:, :size], points[:, size:]
        unknown = np.flatnonzero(log.known == 0)
        choices = np.stack(np.meshgrid(*[[1, -1]] * len(unknown), indexing="ij"), axis=-1).reshape(-1, len(unknown))
        self.signs = np.tile(log.known, (len(choices), 1))
        self.signs[:, unknown] = choices
        of_segments, prior = log.segment_logs(self.theta, log_scale), log.log_prior(self.theta, log_scale)
        index = np.arange(len(log.known))
        logs = np.array([prior + of_segments[(1 - signs) // 2, index].sum(axis=0) for signs in self.signs])
        density = np.exp(logs - logs.max())
        self.weight = density.sum(axis=0) / density.sum()  # of the points
        self.mass = density.sum(axis=1) / density.sum()  # of the assignments
        edge = self.weight.reshape([len(axis) for axis in axes])
        ends = [np.take(edge, -1, axis=k).sum() for k in range(len(axes))]
        ends += [np.take(edge, 0, axis=k).sum() for k in range(len(axes)) if axes[k][0] < 0.0]
        assert max(ends) < 1e-4, "the grid is too small"

    @property
    def plus(self):
        return self.mass @ (self.signs > 0)

    def mass_of(self, signs, where):
        """Of all assignments with these signs in some of the segments."""
        return float(self.mass[np.all(self.signs[:, where] == signs[where], axis=1)].sum())

    def moments_where(self, where):
        """Mass, means and sds of the parameters over a part of the grid."""
        weight, theta = self.weight[where], self.theta[where]
        mean = weight @ theta / weight.sum()
        return weight.sum(), mean, np.sqrt(weight @ (theta - mean) ** 2 / weight.sum())


def errors(posterior, values):
    """Standard errors of averages over part of the draws of values (D, E, W, ...): walkers are independent."""
    sweeps = len(values)
    walkers = values.reshape(sweeps, -1, *values.shape[3:]).mean(axis=0)
    share = max(1.0, sweeps * len(walkers) / AVERAGED)
    return walkers.std(axis=0, ddof=1) / np.sqrt(len(walkers)) * np.sqrt(share)


def cells(low, high, count):
    """Midpoints of equal cells."""
    return low + (high - low) * (np.arange(count) + 0.5) / count
