"""The error of a model as a time series: white noise plus an exponentially correlated part, and its likelihood.

x_i = w_i + c_i with c_i = phi c_(i-1) + eta_i is an ARMA(1, 1) process, (1 - phi L) x = (1 - theta L) eps with
:eq:`arma`::

    theta / (1 + theta^2) = phi sw^2 / (sc^2 (1 - phi^2) + sw^2 (1 + phi^2)),   var eps = phi sw^2 / theta

(Box and Jenkins 1976, section 3.4). So one recursive filter whitens residuals and columns alike. The likelihood is that
of independent innovations, and no autocorrelation time is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.regression.tuning import TUNING

_FINEST = np.array([TUNING.error_logits[1], math.log(TUNING.longest_time)])
"""The lattice point of the largest share and correlation time."""
_SMALL = 1e-12
"""Lower limit of divisors."""


@dataclass(frozen=True)
class ErrorModel:
    """White noise and an Ornstein-Uhlenbeck process, in one joint."""

    white: float  #: sd of the uncorrelated part, N m
    coloured: float  #: sd of the correlated part, N m
    correlation: float  #: its correlation time, s
    rate: float  #: Hz

    @property
    def sigma(self) -> float:
        """Sd of the sum of both parts, N m."""
        return float(np.hypot(self.white, self.coloured))

    @property
    def shape(self) -> tuple[float, float, float]:
        """Rounded parameters of the filter: share of the coloured part, correlation time, s, and rate, Hz."""
        return round(self._share, 12), round(self.correlation, 12), self.rate

    @property
    def scale(self) -> float:
        """Sd of the innovations, N m."""
        return self.sigma * math.sqrt(_arma(self._share, self.correlation, self.rate)[2])

    @property
    def _share(self) -> float:
        return (self.coloured / self.sigma) ** 2

    def innovations(self, values: Array, used: Mask) -> Array:
        """(N, ...) innovations of values (N, ...) without gaps, N m; zero where not used (N,)."""
        memory, theta, _ = _arma(self._share, self.correlation, self.rate)
        found = scipy.signal.lfilter([1.0, -memory], [1.0, -theta], np.moveaxis(values, 0, -1))
        found *= used
        return np.moveaxis(found, -1, 0)

    def whiten(self, values: Array, used: Mask) -> Array:
        """(N, ...) innovations of values (N, ...), unused samples (N,) bridged, N m; zero where not used."""
        return self.innovations(bridged(values, used), used)

    def log_likelihood(self, residual: Array, used: Mask) -> float:
        """Log-likelihood of the used samples of residuals (N,)."""
        memory, theta, variance = _arma(self._share, self.correlation, self.rate)
        square, count = _innovations(bridged(residual, used), used, memory, theta)
        scale = self.sigma**2 * variance
        return -0.5 * (count * math.log(2.0 * math.pi * scale) + square / scale)


def alike(errors: Sequence[ErrorModel], others: Sequence[ErrorModel]) -> bool:
    """Whether error models give equal weights: equal filters, and sizes within `Tuning.unseen_size`."""
    pairs = zip(errors, others, strict=True)
    return all(a.shape == b.shape and abs(a.sigma - b.sigma) <= TUNING.equal_size * b.sigma for a, b in pairs)


def bridged(values: Array, used: Mask) -> Array:
    """Values (N, ...) with unused ones (N,) interpolated linearly between used neighbours, constant at both ends.

    Zeros in their place would be jumps, to which a filter for slow noise gives a large weight.
    """
    gaps, left, right, share = _gaps(used.tobytes())
    if not len(gaps):
        return values
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    filled = values.copy(order="K")
    filled[gaps] = (1.0 - share) * values[left] + share * values[right]
    return filled


def unbridged(values: Array, used: Mask) -> Array:
    """The transpose of `bridged`, applied to values (N, s)."""
    gaps, left, right, share = _gaps(used.tobytes())
    if not len(gaps):
        return values
    spread, share = values.copy(), share.reshape(-1, *(1,) * (values.ndim - 1))
    np.add.at(spread, left, (1.0 - share) * values[gaps])
    np.add.at(spread, right, share * values[gaps])
    spread[gaps] = 0.0
    return spread


@lru_cache(maxsize=64)
def _gaps(used: bytes) -> tuple[Integers, Integers, Integers, Array]:
    """Unused rows (g,), their used neighbours on both sides, and the weight of the right one."""
    mask = np.frombuffer(used, dtype=bool)
    rows, gaps = np.flatnonzero(mask), np.flatnonzero(~mask)
    if not len(rows):
        return rows, rows, rows, np.zeros(0)
    after = np.searchsorted(rows, gaps)
    left, right = rows[np.maximum(after - 1, 0)], rows[np.minimum(after, len(rows) - 1)]
    share = np.where(right > left, (gaps - left) / np.maximum(right - left, 1), 0.0)
    return gaps, left, right, share


def fit_error(
    residual: Array, used: Mask, rate: float, limits: tuple[float, float] | None = None
) -> tuple[ErrorModel, float]:
    """The error model of the largest likelihood for the used ones of residuals (N,), N m, and its log-likelihood.

    Without limits, share and correlation time are on a lattice as fine as the fit's resolution, so that similar
    residuals get equal filters. Limits are the largest white and coloured part, N m.
    """
    residuals = _Residuals(bridged(residual, used), used, rate)
    point = residuals.on_lattice() if limits is None else residuals.within(limits)
    (share, correlation), (sigma2, value) = _from_point(point), residuals.judged(point, limits)
    return ErrorModel(math.sqrt(sigma2 * (1.0 - share)), math.sqrt(sigma2 * share), correlation, rate), value


@dataclass(frozen=True)
class _Residuals:
    """Residuals (N,) of a joint, N m, without gaps, which of them are used, and their rate, Hz."""

    residual: Array
    used: Mask
    rate: float

    def judged(self, point: Array, limits: tuple[float, float] | None = None) -> tuple[float, float]:
        """Sigma^2 and log-likelihood at a point (logit of the share, logarithm of the correlation time)."""
        share, correlation = _from_point(point)
        memory, theta, variance = _arma(share, correlation, self.rate)
        square, count = _innovations(self.residual, self.used, memory, theta)
        sigma2 = square / (max(count, 1) * variance) + TINY
        if limits is not None:
            sigma2 = min(sigma2, *_most(share, limits))
        scale = sigma2 * variance
        return sigma2, -0.5 * (count * math.log(2.0 * math.pi * scale) + square / scale)

    def on_lattice(self) -> Array:
        """The lattice point nearest to the likeliest point, which has the least sum of squared innovations."""
        points, squares, _ = self._grid()
        found = [self._descended(self._arma(point)[:2]) for point in points[_valleys(squares)]]
        square, place = min(found, key=lambda at: at[0])
        point = self._within_shares(square, _point(*place, self.rate))
        nearest: Array = _FINEST - TUNING.error_resolution * np.round((_FINEST - point) / TUNING.error_resolution)
        return nearest

    def _within_shares(self, square: float, point: Array) -> Array:
        """The point moved along the largest share, if it is there and the lattice costs more than rounding."""
        most = TUNING.error_logits[1]

        def remainder(log_time: float) -> float:
            memory, theta, _ = self._arma(np.array([most, log_time]))
            return _innovations(self.residual, self.used, memory, theta)[0]

        if point[0] < most:
            return point
        lost = 0.5 * len(self.residual) * math.log((remainder(float(point[1])) + TINY) / (square + TINY))
        if lost < TUNING.error_enough:
            return point
        bounds = math.log(TUNING.shortest_time), math.log(TUNING.longest_time)
        options = {"xatol": 0.5 * TUNING.error_resolution}
        best = scipy.optimize.minimize_scalar(remainder, bounds=bounds, method="bounded", options=options)
        return np.array([most, best.x])

    def _arma(self, point: Array) -> tuple[float, float, float]:
        return _arma(*_from_point(point), self.rate)

    def _descended(self, start: tuple[float, float]) -> tuple[float, tuple[float, float]]:
        """Least sum of squares near phi and theta, and its place: damped Newton steps."""
        place, damping, at = start, 0.0, self._squares(start)
        for _ in range(TUNING.error_steps if at.square > TINY else 0):
            new = _stepped(place, at, damping, self.rate)
            promised = at.slope[0] * (place[0] - new[0]) + at.slope[1] * (place[1] - new[1])
            if len(self.residual) * abs(promised) < TUNING.error_enough * at.square:
                break
            tried = self._squares(new)
            if tried.square < at.square:
                place, at, damping = new, tried, 0.1 * damping if damping > TUNING.error_damping else 0.0
            else:
                damping = max(10.0 * damping, TUNING.error_damping)
        return at.square, place

    def within(self, limits: tuple[float, float]) -> Array:
        """The likeliest point within limits, by a search without derivatives, as limits make the likelihood kinked."""
        points, squares, variance = self._grid()
        count = max(int(self.used.sum()), 1)
        most = np.array([min(_most(_from_point(point)[0], limits)) for point in points])
        scale = np.minimum(squares / (count * variance) + TINY, most) * variance
        best = points[int(np.argmin(count * np.log(scale) + squares / scale))]
        simplex = best + TUNING.limited_step * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # scipy's is flat at 1/2
        options = {"maxfev": TUNING.limited_evaluations, "xatol": TUNING.error_resolution, "initial_simplex": simplex}
        found = scipy.optimize.minimize(
            lambda point: -self.judged(point, limits)[1], best, method="Nelder-Mead", options=options
        )
        return np.asarray(found.x, dtype=np.float64)

    def _grid(self) -> tuple[Array, Array, Array]:
        """(K, 2) points of a coarse grid, (K,) sums of squares there (bridged samples included), and variances."""
        count = len(self.residual)
        points, weights, variance = _grid_of(self.rate, min(TUNING.error_lags, count))
        spectrum = np.fft.rfft(self.residual, scipy.fft.next_fast_len(2 * count, real=True))
        squares = weights @ np.fft.irfft(np.abs(spectrum) ** 2)[: weights.shape[1]]
        return points, np.maximum(squares, 0.0), variance

    def _squares(self, place: tuple[float, float]) -> _Squares:
        memory, theta = place
        late = [0.0, 1.0], [1.0, -theta]
        rows = np.empty((5, len(self.residual)))  # innovations; derivatives by phi, theta, both, and theta twice
        np.negative(scipy.signal.lfilter(*late, self.residual), out=rows[1])
        np.add(self.residual, (memory - theta) * rows[1], out=rows[0])
        rows[2:4] = scipy.signal.lfilter(*late, rows[:2])
        rows[4] = scipy.signal.lfilter(*late, rows[2])
        rows *= self.used
        products = (rows[:3] @ rows.T).tolist()
        (square, by_memory, by_theta, bent, curved), (_, steep, across, *_), (_, _, level, *_) = products
        curvature = steep, across + bent, level + 2.0 * curved
        return _Squares(square, (by_memory, by_theta), curvature, (steep, across, level))


@dataclass(frozen=True)
class _Squares:
    """A sum of squares; half its gradient by phi and theta; half its Hessian (phi, both, theta); Gauss-Newton's."""

    square: float
    slope: tuple[float, float]
    curvature: tuple[float, float, float]
    plain: tuple[float, float, float]


def _most(share: float, limits: tuple[float, float]) -> tuple[float, float]:
    return limits[0] ** 2 / max(1.0 - share, _SMALL), limits[1] ** 2 / max(share, _SMALL)


def _valleys(squares: Array) -> Integers:
    """Local minima of sums of squares (K,) on the grid that may be the global one."""
    grid = squares.reshape(len(TUNING.error_shares), len(TUNING.error_times))
    around = scipy.ndimage.minimum_filter(grid, size=3, mode="nearest").ravel()
    lowest = squares <= np.minimum(around, (1.0 + TUNING.grid_error) * squares.min())
    return np.asarray(np.flatnonzero(lowest), dtype=np.int64)


def _stepped(place: tuple[float, float], at: _Squares, damping: float, rate: float) -> tuple[float, float]:
    """Phi and theta after a Newton step, projected to 0 <= theta < phi."""
    (memory, theta), (by_memory, by_theta) = place, at.slope
    steep, across, level = at.curvature
    if not (level > 0.0 and steep * level > across**2):
        steep, across, level = at.plain
    steep, level = (1.0 + damping) * steep + TINY, (1.0 + damping) * level + TINY
    determinant = max(steep * level - across**2, _SMALL * steep * level)
    lowest, highest = (math.exp(-1.0 / (time * rate)) for time in (TUNING.shortest_time, TUNING.longest_time))
    least, most = -theta, max(memory, lowest) - theta - _SMALL
    along = min(max((across * by_memory - steep * by_theta) / determinant, least), most)
    new = min(max(memory - (by_memory + across * along) / steep, lowest), highest)
    along = min(max(-(by_theta + across * (new - memory)) / level, least), most)
    return new, max(min(theta + along, new - _SMALL), 0.0)


def _point(memory: float, theta: float, rate: float) -> Array:
    """Logit of the share and logarithm of the correlation time nearest to phi and theta."""
    odds = (memory * (1.0 + theta**2) / max(theta, _SMALL) - 1.0 - memory**2) / (1.0 - memory**2)
    logit = min(max(math.log(max(odds, _SMALL)), TUNING.error_logits[0]), TUNING.error_logits[1])
    return np.array([logit, -math.log(-rate * math.log(max(memory, TINY)))])


@lru_cache(maxsize=8)
def _grid_of(rate: float, lags: int) -> tuple[Array, Array, Array]:
    """(K, 2) points, (K, lags) weights of the autocovariances in the sum of squared innovations, and (K,) variances.

    With g_k = theta^k / (1 - theta^2), the autocovariances of 1 / (1 - theta L), the weight is
    (1 + phi^2) g_0 - 2 phi g_1 at lag 0, and 2 (1 + phi^2) g_k - 2 phi (g_(k-1) + g_(k+1)) at other lags.
    """
    points = np.array([[math.log(s / (1.0 - s)), math.log(t)] for s in TUNING.error_shares for t in TUNING.error_times])
    memory, theta, variance = np.array([_arma(*_from_point(point), rate) for point in points]).T[:, :, None]
    powers = theta ** np.abs(np.arange(-1, lags + 1)) / (1.0 - theta**2)
    weights = (1.0 + memory**2) * powers[:, 1:-1] - memory * (powers[:, :-2] + powers[:, 2:])
    weights[:, 1:] *= 2.0
    return points, weights, variance[:, 0]


def _from_point(point: Array) -> tuple[float, float]:
    logit, log_time = point.tolist()
    share = 1.0 / (1.0 + math.exp(-min(max(logit, TUNING.error_logits[0]), TUNING.error_logits[1])))
    return share, math.exp(min(max(log_time, math.log(TUNING.shortest_time)), math.log(TUNING.longest_time)))


def _arma(share: float, correlation: float, rate: float) -> tuple[float, float, float]:
    """Phi, theta and the innovations' variance for a total variance of one."""
    memory = math.exp(-1.0 / (correlation * rate))
    white = 1.0 - share
    total = share * (1.0 - memory**2) + white * (1.0 + memory**2)
    ratio = memory * white / total  # theta / (1 + theta^2)
    theta = 2.0 * ratio / (1.0 + math.sqrt(max(1.0 - 4.0 * ratio**2, 0.0)))
    return memory, theta, total / (1.0 + theta**2)


def _innovations(residual: Array, used: Mask, memory: float, theta: float) -> tuple[float, int]:
    innovation = scipy.signal.lfilter([1.0, -memory], [1.0, -theta], residual)[used]
    return float(innovation @ innovation), len(innovation)
