"""Efforts that were low-passed after the rectifier: detection and correction.

|effort| has a cusp at every zero crossing. A low-pass before the rectifier moves the cusp; one after it rounds it off
and lifts it above zero. So around every zero crossing of the model's effort p, |effort| is compared with both |h * p +
b| and h * |p + b|, each with the best h and, at each crossing, the best model error b. Each crossing is one
observation. Its sums of squares give a contrast between -1 and 1. Without a low-pass after the rectifier the contrast
is symmetric about zero or negative (:eq:`low-pass-contrast`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.effects.model import Model
from bayesid.log.low_pass import AfterRectifier, LowPass, mean_magnitude
from bayesid.log.segments import Segmentation, Segments, find_segments
from bayesid.log.signals import Signals, signed_effort
from bayesid.parallel import in_parallel
from bayesid.progress import SILENT, Progress
from bayesid.regression.noise import autocovariance
from bayesid.signs.search.protocol import Search
from bayesid.signs.sign_solution import Earlier, SignSolution, find_signs, solution_again
from bayesid.signs.tuning import TUNING


def find_unfiltered_signs(
    model: Model,
    signals: Signals,
    segments: Segments,
    search: Search,
    segmentation: Segmentation,
    progress: Progress = SILENT,
    earlier: Earlier | None = None,
) -> tuple[SignSolution, Segments]:
    """`find_signs`, repeated on corrected efforts if a low-pass after the rectifier is found.

    Returns:
        The signs, whose log data hold the corrected signals, and the segments before any search.

    Raises:
        SolverError: an optimisation failed.
    """
    sign_solution = find_signs(model, signals, segments, search, progress, earlier)
    if find_low_pass(sign_solution) is None:
        return sign_solution, segments
    fitted = partial(_fitted, sign_solution, sign_solution.log_data.columns)
    low_pass = min(_tried(signals.rate), key=lambda low_pass: fitted(low_pass)[1])
    eighths: Array = 2.0 ** (np.arange(-4, 5) / 8)  # fractions of an octave about the found cut-off
    finer = _low_passes(low_pass.cutoff * eighths, signals.rate)
    low_pass = min(finer, key=lambda low_pass: fitted(low_pass)[1])
    predicted = fitted(low_pass)[0]
    sign_solution = solution_again(sign_solution, freed(sign_solution, low_pass, predicted), predicted)
    signals = freed(sign_solution, low_pass, sign_solution.predicted)
    segments = find_segments(signals, model.robot.actuators(signals.motion), segmentation)
    return find_signs(model, signals, segments, search, progress.under("unfiltered"), earlier), segments


def freed(sign_solution: SignSolution, low_pass: LowPass, predicted: Array) -> Signals:
    """The log with the unsigned joints' efforts before the low-pass, corrected by its effect on `predicted`.

    The residual of the model, (N, n) N m, is kept, so noise is not amplified.
    """
    signals, used = sign_solution.log_data.signals, sign_solution.log_data.used
    read = _read(signals)
    residual = np.sign(predicted) * (read - low_pass.apply(np.abs(predicted), signals.rate))
    columns = zip(np.where(used, residual, 0.0).T, used.T, strict=True)
    noise = np.array([noise_taken(low_pass, column, which, signals.rate) for column, which in columns])
    after = AfterRectifier(low_pass, read, noise)
    expected = mean_magnitude(predicted, noise)
    raw = np.maximum(read + expected - after.readings(predicted, signals.rate), 0.0)
    raw = np.where(signals.signed, signals.raw_effort, raw)
    changed = replace(signals, raw_effort=raw, after_rectifier=after)
    return replace(changed, effort=signed_effort(changed, np.ones_like(raw)))


def noise_taken(low_pass: LowPass, residual: Array, used: Mask, rate: float) -> float:
    """Sd of the noise that a low-pass removed, N m, from the residual (N,) after it (:eq:`noise-taken`).

    The residual's autocovariance is that of sensor noise behind the low-pass plus white noise and exponentially
    correlated ones before it, of variances that are not negative (Lawson and Hanson 1974, chapter 23).
    """
    observed = autocovariance(residual, used, max(2, int(TUNING.longest_lag * rate)))
    memories = np.exp(-1.0 / (np.array(TUNING.error_memories) * rate))
    passed = np.stack([low_pass.autocovariance(memory, len(observed), rate) for memory in (0.0, *memories)], axis=1)
    behind = np.eye(len(observed), 1)
    variance = scipy.optimize.nnls(np.hstack([behind, passed]), observed)[0][1:]
    taken = float(variance @ (1.0 - passed[0]))
    return np.sqrt(max(taken, TUNING.least_noise_taken * observed[0], TINY))


def find_low_pass(sign_solution: SignSolution) -> LowPass | None:
    """The low-pass after the rectifier; None without evidence.

    If the crossings favour one, the test is repeated after a fit to corrected efforts, as delayed efforts shift the
    crossings.
    """
    tried = _tried(sign_solution.log_data.signals.rate)
    first = _Crossings.of(sign_solution)
    if (
        not tried
        or significance(np.ones(len(first.joint))) > TUNING.low_pass_false_alarm
        or first.contrast(tried).sum() <= 0.0
    ):
        return None
    signals = freed(sign_solution, first.best_after(tried), sign_solution.predicted)
    again = _Crossings.of(solution_again(sign_solution, signals, sign_solution.predicted))
    return again.best_after(tried) if significance(again.contrast(tried)) <= TUNING.low_pass_false_alarm else None


def significance(contrast: Array) -> float:
    """Bound on the probability of contrasts (C,) with such a sum, if signs are equally likely.

    exp(-S^2 / 2) for the self-normalised sum S, by Hoeffding's inequality (de la Pena, Lai and Shao 2009, section 2.1).
    1 if the sum is negative.
    """
    total = float(contrast.sum()) / np.sqrt(max(float(contrast @ contrast), TINY))
    return float(np.exp(-0.5 * max(total, 0.0) ** 2))


def _tried(rate: float) -> list[LowPass]:
    cutoffs = [TUNING.lowest_cutoff * 2.0 ** (0.5 * k) for k in range(TUNING.half_octaves)]
    return _low_passes(np.array(cutoffs), rate)


def _low_passes(cutoffs: Array, rate: float) -> list[LowPass]:
    """Low-passes of every shape with these cut-offs, Hz, up to the limit at this rate."""
    shown = cutoffs[cutoffs < 0.5 * TUNING.cutoff_of_nyquist * rate].tolist()
    return [LowPass(order, cutoff, both) for order, both in TUNING.low_pass_shapes for cutoff in shown]


def _read(signals: Signals) -> Array:
    return signals.magnitude if signals.after_rectifier is None else signals.after_rectifier.read


def _fitted(sign_solution: SignSolution, columns: Array, low_pass: LowPass) -> tuple[Array, float]:
    """(N, n) the model's effort, N m, fitted without the cone, and minus the residual's log-likelihood.

    Least squares on rows h * (s Y), which is exact for given signs s, and linear. A model fitted to delayed efforts
    includes part of the delay, so each low-pass gets its own fit.
    """
    signals, used, predicted = sign_solution.log_data.signals, sign_solution.log_data.used, sign_solution.predicted
    sigma = sign_solution.fit.residual.sigma
    read = np.where(signals.signed, signals.raw_effort, _read(signals))
    target = np.where(used, read, 0.0) / sigma
    for _ in range(TUNING.low_pass_fits):
        signs = np.where(predicted >= 0.0, 1.0, -1.0)
        filtered = low_pass.apply(signs[:, :, None] * columns, signals.rate)
        rows = np.where(signals.signed[:, None], columns, filtered)
        rows = (np.where(used[:, :, None], rows, 0.0) / sigma[:, None]).reshape(target.size, -1)
        predicted = columns @ _least_squares(rows, target.ravel())
    expected = np.where(signals.signed, predicted, low_pass.apply(np.abs(predicted), signals.rate))
    square = np.where(used, read - expected, 0.0) ** 2
    count = used.sum(axis=0)
    return predicted, 0.5 * float(count @ np.log(np.maximum(square.sum(axis=0) / np.maximum(count, 1), TINY)))


def _least_squares(rows: Array, target: Array) -> Array:
    """(r,) solution of least norm, columns scaled to unit length."""
    hessian = rows.T @ rows
    length = np.sqrt(np.maximum(np.diag(hessian), TINY))
    inverse = np.linalg.pinv(hessian / np.outer(length, length), rcond=1e-9, hermitian=True)
    solution: Array = inverse @ (rows.T @ target / length) / length
    return solution


@dataclass(frozen=True)
class _Crossings:
    """C zero crossings of the model's effort, with L samples about each and M more in which a low-pass settles."""

    joint: Integers  # (C,) 0-based
    predicted: Array  # (L + 2 M, C) the model's effort, N m
    read: Array  # (L, C) |effort|, N m
    sd: Array  # (C,) of the residual, N m
    white: Array  # (C,) of its white part
    rate: float  # Hz

    @classmethod
    def of(cls, sign_solution: SignSolution) -> _Crossings:
        """Crossings of the unsigned joints, mostly in motion and away from the ends of the log."""
        signals, predicted, noise = sign_solution.log_data.signals, sign_solution.predicted, sign_solution.fit.residual
        reach, settling = round(TUNING.crossing_reach * signals.rate), round(TUNING.low_pass_rest * signals.rate)
        usable = signals.measured & signals.inner & ~signals.signed
        places = _apart(predicted, usable, sign_solution.log_data.moving, reach, settling)
        if len(places) > TUNING.most_crossings:
            places = places[np.linspace(0, len(places) - 1, TUNING.most_crossings).astype(int)]
        joint, at = places.T
        around = at + np.arange(-reach, reach + 1)[:, None]
        wide = at + np.arange(-reach - settling, reach + settling + 1)[:, None]
        read = _read(signals)[around, joint]
        return cls(joint, predicted[wide, joint], read, noise.sigma[joint], noise.white[joint], signals.rate)

    @property
    def _bias(self) -> Array:
        return self.sd[:, None] * (TUNING.crossing_bias * np.linspace(-1.0, 1.0, TUNING.crossing_biases))

    @cached_property
    def _mean(self) -> Array:
        """(L + 2 M, C, G) mean |effort| after a rectifier, for every model error."""
        return mean_magnitude(self.predicted[..., None] + self._bias, self.white[:, None])

    def _inner(self, values: Array) -> Array:
        settling = (len(self.predicted) - len(self.read)) // 2
        return values[settling : settling + len(self.read)]

    def best_after(self, tried: list[LowPass]) -> LowPass:
        """The best low-pass after the rectifier."""
        _ = self._mean  # computed once before the processes fork
        return tried[_best([partial(self.after, low_pass) for low_pass in tried])]

    def best_before(self, tried: list[LowPass]) -> LowPass | None:
        """The best low-pass before the rectifier; None if none is better."""
        all_tried = [None, *tried]
        return all_tried[_best([partial(self.before, low_pass) for low_pass in all_tried])]

    def after(self, low_pass: LowPass) -> Array:
        """(C,) sums of squares for a low-pass after the rectifier, (N m)^2."""
        return self._left(self._inner(low_pass.apply(self._mean, self.rate)))

    def before(self, low_pass: LowPass | None) -> Array:
        """(C,) the same for a low-pass before the rectifier, or none."""
        predicted = self.predicted if low_pass is None else low_pass.apply(self.predicted, self.rate)
        return self._left(mean_magnitude(self._inner(predicted)[..., None] + self._bias, self.white[:, None]))

    def _left(self, expected: Array) -> Array:
        spacing = self._bias[:, 1] - self._bias[:, 0]
        squares = ((self.read[..., None] - expected) ** 2).sum(axis=0).min(axis=1)
        residuals: Array = squares + len(self.read) * spacing**2 / 12.0  # quantisation of the tried errors
        return residuals

    def contrast(self, tried: list[LowPass]) -> Array:
        """(C',) between -1 and 1: how much better the best low-pass after the rectifier fits than the best before it.

        Only crossings at which one of the two fits no worse than the model does elsewhere.
        """
        before, after = self.before(self.best_before(tried)), self.after(self.best_after(tried))
        explained = np.minimum(before, after) <= len(self.read) * self.sd**2
        contrast: Array = ((before - after) / np.maximum(before + after, TINY))[explained]
        return contrast


def _best(ways: Sequence[Callable[[], Array]]) -> int:
    """Index of the best alternative by the sum of logarithms, as each crossing has its own noise level."""
    misfits = [np.log(np.maximum(misfit, TINY)).sum() for misfit in in_parallel(ways)]
    return int(np.argmin(misfits))


def _apart(predicted: Array, usable: Mask, moving: Mask, reach: int, settling: int) -> Integers:
    """(C, 2) joint and sample of zero crossings that are farther apart than `reach`."""
    places = []
    for j in range(predicted.shape[1]):
        last = settling - 1
        for i in np.flatnonzero(np.diff(np.sign(predicted[:, j])) != 0.0).tolist():
            around = slice(i - reach, i + reach + 1)
            if around.start <= last or around.stop + settling > len(predicted):
                continue
            if usable[around, j].all() and moving[around, j].mean() > 0.5:
                places.append((j, i))
                last = around.stop - 1
    return np.array(places, dtype=np.int64).reshape(-1, 2)
