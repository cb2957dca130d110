"""From a raw log to evenly sampled, filtered signals.

The controller rectifies before any filter, so absolute values are filtered as they are, and lightly: a filter rounds
the cusp at which |effort| touches zero. Least squares averages noise of the efforts but needs smooth accelerations. So
the motion passes a zero-phase low-pass at the cut-off, efforts one at twice the cut-off.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import repeat
from typing import NamedTuple

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.errors import InputError
from bayesid.log.faults import Fault, find_faults, lost_rows, without
from bayesid.log.formats.table import distinct_rows
from bayesid.log.log import Log, RecordedMotion, motion_of_log
from bayesid.log.low_pass import AfterRectifier
from bayesid.log.tuning import TUNING
from bayesid.motion import Motion


@dataclass(frozen=True)
class Signals:
    """A log on an even time grid."""

    motion: Motion  #: filtered joint positions with their velocities and accelerations
    effort: Array  #: (N, n) lightly filtered efforts; of |effort| for unsigned joints, N m
    raw_effort: Array  #: (N, n) efforts, resampled but not filtered, N m
    signed: Mask  #: (n,) whether the effort's sign is known
    rate: float  #: Hz, of the grid
    cutoff: float  #: of the motion's low-pass, Hz
    processing: dict[str, object]  #: processing of the log, for summary.json
    #: (N, n) False in pauses, within half a period of the cut-off around them, and where a sensor is blind or faulty
    measured: Mask
    #: a detected low-pass of |effort| in the recording chain, which a model removes from the efforts here; else None
    after_rectifier: AfterRectifier | None = None
    #: faulty readings; they are interpolated and left out like a pause
    faults: tuple[Fault, ...] = ()

    def __repr__(self) -> str:
        n = self.motion.n_joints
        return f"Signals: {len(self.motion)} instants of {n} joints at {self.rate:.6g} Hz, cut-off {self.cutoff:.3g} Hz"

    @property
    def effort_cutoff(self) -> float:
        """Cut-off of the efforts' low-pass, Hz."""
        return _effort_cutoff(self.cutoff, self.rate)

    @property
    def magnitude(self) -> Array:
        """(N, n) absolute values of the unfiltered efforts, N m."""
        return np.abs(self.raw_effort)

    @property
    def inner(self) -> Mask:
        """(N, 1) samples at least half a cut-off period from both ends, whose accelerations are reliable."""
        margin, t = 0.5 / self.cutoff, self.motion.t
        return ((t >= t[0] + margin) & (t <= t[-1] - margin))[:, None]

    def nearest(self, predicted: Array) -> Array:
        """(N, n) unfiltered efforts, N m, with the known sign, else with that of the prediction (N, n)."""
        return np.where(self.signed, self.raw_effort, np.where(predicted >= 0.0, 1.0, -1.0) * self.magnitude)

    def with_known_signs(self, probability: Array) -> Array:
        """(N, n) P(sign = +): 0 or 1 where the sign is known, else as given."""
        return np.where(self.signed, (self.raw_effort >= 0.0).astype(float), probability)


def prepare(log: Log, cutoff: float | None = None) -> Signals:
    """Drops repeated rows, excludes faults, resamples, filters and differentiates a log.

    A joint that never moves gets its mean position. Without a cut-off, Hz, of the zero-phase low-pass, `choose_cutoff`
    chooses it.

    Raises:
        InputError: too few distinct rows, or a cut-off beyond the log's Nyquist frequency.
    """
    clean = _clean(log)
    even = _on_even_grid(clean.motion)
    t, grid, rate = even.t, even.grid, even.rate
    periods, chosen = np.diff(t), cutoff is None
    cutoff = even.cutoff(cutoff)
    processing: dict[str, object] = {
        "rows": len(log),
        "repeated_rows_dropped": len(log) - len(t),
        "time_stamps": "as logged" if np.array_equal(t, clean.motion.t) else "evened out",
        "rate_hz": rate,
        "period_ms": {"min": round(1e3 * float(periods.min()), 6), "max": round(1e3 * float(periods.max()), 6)},
        "cutoff_hz": cutoff,
        "cutoff_chosen_from": "data" if chosen else "user",
        "effort_cutoff_hz": _effort_cutoff(cutoff, rate),
        "filter": f"zero-phase Butterworth, order {TUNING.filter_order} each way",
        "velocity": "measured" if clean.motion.dq is not None else "differentiated",
    }
    every = max(1, min(-(-len(grid) // TUNING.thinned_from), int(rate / (TUNING.least_over_cutoff * cutoff))))
    kept = slice(None, None, every)  # a long log is thinned as far as its cut-off allows
    if every > 1:
        processing |= {"rate_hz": rate / every, "thinned": f"one sample in {every} of {rate:.6g} Hz"}
    raw_effort, effort = _efforts(even, clean.effort, log.signed, cutoff, kept)
    return Signals(
        motion=even.smooth(cutoff, kept),
        effort=effort,
        raw_effort=raw_effort,
        signed=log.signed,
        rate=rate / every,
        cutoff=cutoff,
        processing=processing,
        measured=_known(grid, t, clean, margin=0.5 / cutoff)[kept],
        faults=clean.faults,
    )


def _efforts(even: _EvenMotion, recorded: Array, signed: Mask, cutoff: float, kept: slice) -> tuple[Array, Array]:
    """(N, n) kept efforts on the even grid, N m, unfiltered and lightly filtered, from those of K rows."""
    raw, filtered = [], []
    for reading, has_sign in zip(recorded.T, signed, strict=True):  # one joint at a time, for memory
        effort = scipy.interpolate.PchipInterpolator(even.t, reading)(even.grid)
        effort = effort if has_sign else np.maximum(effort, 0.0)
        raw.append(effort[kept].copy())
        filtered.append(lowpass(effort, _effort_cutoff(cutoff, even.rate), even.rate)[kept].copy())
    return np.stack(raw, axis=1), np.stack(filtered, axis=1)


def still_joints(q: Array) -> Mask:
    """(n,) joints whose positions (N, n) stay within an encoder's noise; () for one joint's positions (N,)."""
    still: Mask = np.ptp(q, axis=0) <= TUNING.encoder
    return still


def filtered_motion(recorded: RecordedMotion, cutoff: float | None = None) -> Motion:
    """A motion at its own N instants, processed as `prepare` does: low-passed on an even grid, differentiated.

    Of rows with equal times the first counts.
    """
    recorded = recorded.rows(np.flatnonzero(np.diff(recorded.t, prepend=-np.inf) > 0.0))
    even = _on_even_grid(_distinct(recorded)[0])
    smooth = even.smooth(even.cutoff(cutoff))
    q, velocity = scipy.interpolate.CubicSpline(smooth.t, smooth.q), scipy.interpolate.CubicSpline(smooth.t, smooth.dq)
    t = recorded.t
    return Motion(t, q(t), velocity(t), velocity(t, 1), payload=recorded.payload)


def _effort_cutoff(cutoff: float, rate: float) -> float:
    return min(2.0 * cutoff, 0.45 * rate)


class _CleanLog(NamedTuple):
    """The K distinct rows of a log, with faults interpolated."""

    motion: RecordedMotion
    effort: Array
    faults: tuple[Fault, ...]
    known: dict[tuple[str, int], Mask]  # (K,) valid rows, for each faulty reading and joint


def _distinct(recorded: RecordedMotion, effort: Array | None = None) -> tuple[RecordedMotion, Integers]:
    """A motion without repeated rows, and the kept rows; efforts (M, n) distinguish rows too."""
    dq = recorded.dq
    keep = distinct_rows(recorded.t, [part for part in (recorded.q, effort, dq) if part is not None])
    return recorded.rows(keep), keep


def _rows(values: Array, kept: Integers) -> Array:
    """Some rows, in ascending order; without a copy if these are all rows."""
    return values if len(kept) == len(values) else values[kept]


def _clean(log: Log) -> _CleanLog:
    lost, lost_faults = lost_rows(log.t, log.q, log.effort, log.dq)
    remaining = np.delete(np.arange(len(log)), lost)
    effort = _rows(log.effort, remaining)
    recorded, keep = _distinct(motion_of_log(log).rows(remaining), effort)
    t, effort = recorded.t, _rows(effort, keep)
    starts = np.unique([0, *np.searchsorted(t, log.t[[piece.start_row for piece in log.pieces]])]).tolist()
    faults = (*lost_faults, *find_faults(t, recorded.q, effort, recorded.dq, [k for k in starts if k < len(t)]))
    known: dict[tuple[str, int], Mask] = {}
    for fault in (fault for fault in faults if fault.rows.size):
        known.setdefault((fault.reading, fault.joint), np.ones(len(t), dtype=bool))[fault.rows] = False
    parts = {"position": recorded.q, "effort": effort}
    if recorded.dq is not None:
        parts["velocity"] = recorded.dq
    parts |= {name: np.array(parts[name]) for name, _ in known}
    for (name, j), valid in known.items():
        parts[name][:, j] = without(t, parts[name][:, j], valid, smooth=name == "position")
    for fault in (fault for fault in faults if fault.reading == "velocity" and fault.kind != "outlier"):
        change = np.gradient(parts["position"][:, fault.joint], t)
        parts["velocity"][fault.rows, fault.joint] = change[fault.rows]
    if (still := still_joints(parts["position"])).any():
        parts["position"] = np.where(still, parts["position"].mean(axis=0), parts["position"])
        if recorded.dq is not None:
            parts["velocity"] = np.where(still, 0.0, parts["velocity"])
    motion = replace(recorded, q=parts["position"], dq=parts.get("velocity"))
    return _CleanLog(motion, parts["effort"], faults, known)


def _known(grid: Array, t: Array, clean: _CleanLog, margin: float) -> Mask:
    """(N, n) whether an instant is farther than `margin`, s, from every pause and its effort has no fault.

    A position missing for as long as a pause is a pause of all joints. Shorter gaps are interpolated.
    """
    pauses = np.diff(t) > 2 * TUNING.held_periods * np.median(np.diff(t))
    unknown = [(t[k], t[k + 1] + margin) for k in np.flatnonzero(pauses)]
    known = np.ones((len(grid), clean.effort.shape[1]), dtype=bool)
    for (reading, j), rows in clean.known.items():
        if reading == "effort":
            known[:, j] &= rows[_nearest(grid, t)]
        elif reading == "position":
            ends = np.flatnonzero(np.diff(np.concatenate([[True], rows, [True]])))
            for first, stop in ends.reshape(-1, 2):
                if stop - first > 2 * TUNING.held_periods:
                    unknown.append((t[first], t[min(stop, len(t) - 1)] + margin * (stop < len(t))))
    measured = np.ones(len(grid), dtype=bool)
    for start, end in unknown:
        measured &= (grid < start - margin) | (grid > end)
    return known & measured[:, None]


def _nearest(grid: Array, t: Array) -> Integers:
    """(N,) nearest row, among instants t (K,), s, to each grid instant, s; in a pause the next row."""
    return np.clip(np.searchsorted(t, grid - 0.5 * np.median(np.diff(t))), 0, len(t) - 1)


@dataclass(frozen=True)
class _EvenMotion:
    """A motion of K instants t on an even grid (N,), s, one joint at a time to save memory."""

    recorded: RecordedMotion
    t: Array
    grid: Array
    rate: float

    def joints(self) -> Iterator[tuple[Array, Array | None]]:
        """(N,) positions of each joint, rad, and its measured velocities (N,), rad/s, or None; unfiltered."""
        measured = repeat(None) if self.recorded.dq is None else self.recorded.dq.T
        for q, dq in zip(self.recorded.q.T, measured, strict=False):
            even = None if dq is None else scipy.interpolate.PchipInterpolator(self.t, dq)(self.grid)
            yield scipy.interpolate.CubicSpline(self.t, q)(self.grid), even

    def cutoff(self, stated: float | None) -> float:
        """The requested cut-off or a chosen one; InputError beyond the Nyquist frequency."""
        cutoff = choose_cutoff(self.joints(), self.rate) if stated is None else stated
        least = TUNING.fewest_cutoff_periods * self.rate / len(self.grid)
        if not least <= cutoff < self.rate / 2:
            remedy = f"give a value between {least:.2g} and {self.rate / 2:g} Hz, half the log's rate"
            log = f"a log of {self.t[-1] - self.t[0]:.3g} s at {self.rate:g} Hz"
            raise InputError(f"a cut-off of {cutoff:g} Hz is out of range for {log}", field="cutoff", remedy=remedy)
        return cutoff

    def smooth(self, cutoff: float, kept: slice = slice(None)) -> Motion:
        """The low-passed motion at the kept instants.

        Derivatives are those of a cubic spline, whose error is of fourth order. A central difference loses 10 % at rate
        / 8.
        """
        spline, columns = scipy.interpolate.CubicSpline, []
        for q, dq in self.joints():
            smooth = _lowpass_motion(q, cutoff, self.rate)
            velocity = spline(self.grid, smooth)(self.grid, 1) if dq is None else _lowpass_motion(dq, cutoff, self.rate)
            acceleration = spline(self.grid, velocity)(self.grid, 1)
            columns.append([part[kept].copy() for part in (smooth, velocity, acceleration)])
        q, dq, ddq = (np.stack(part, axis=1) for part in zip(*columns, strict=True))
        payload = self.recorded.payload[_nearest(self.grid[kept], self.t)]
        return Motion(self.grid[kept], q, dq, ddq, payload=payload)


def _on_even_grid(recorded: RecordedMotion) -> _EvenMotion:
    t, source = _instants(recorded.t, recorded.q), recorded.source
    rate = 1.0 / float(f"{np.median(np.diff(t)):.10g}")  # stamps give 0.010000000000001563
    size = (t[-1] - t[0]) * rate * (1 + 1e-9) + 1.0
    if size > max(TUNING.grid_always, TUNING.grid_per_row * len(t)):
        apart = f"{len(t)} instants over {t[-1] - t[0]:.6g} s, typically {1.0 / rate:.3g} s apart"
        remedy = "give each row its own time, or cut the log at its pauses and give the parts as several logs"
        raise InputError(f"{apart}, would need an even grid of {size:.3g} samples", source, remedy)
    grid = t[0] + np.arange(int(size)) / rate
    if len(grid) < TUNING.fewest_rows:
        raise InputError(f"only {len(grid)} distinct instants", source, "record a longer log")
    return _EvenMotion(recorded, t, grid, rate)


def signed_effort(signals: Signals, signs: Array, filtered: bool = True) -> Array:
    """(N, n) signed efforts, N m, with or without the light low-pass.

    The signs are applied before the filter, so no cusps of |effort| are rounded.
    """
    signed = np.where(signals.signed, signals.raw_effort, signs * signals.raw_effort)
    return lowpass(signed, signals.effort_cutoff, signals.rate) if filtered else signed


def lowpass(values: Array, cutoff: float, rate: float) -> Array:
    """Zero-phase low-pass of (N, ...) even values along the first axis; the ends are extended by point reflection."""
    if cutoff >= 0.45 * rate:
        return values
    padding = min(len(values) - 1, int(3 * rate / cutoff))
    return scipy.signal.sosfiltfilt(_sections(cutoff, rate), values, axis=0, padlen=padding)


def _lowpass_motion(values: Array, cutoff: float, rate: float) -> Array:
    """`lowpass` of (N,) values with both ends extended by a cubic.

    A point reflection reverses the curvature, so a log that ends in motion would lose its accelerations at the ends. A
    least-squares cubic through the last cut-off period continues the motion.
    """
    if cutoff >= 0.45 * rate:
        return values
    window, padding = min(len(values), max(8, round(rate / cutoff))), round(1.5 * rate / cutoff)
    places, fit = np.arange(window), np.polynomial.Polynomial.fit
    before = fit(places, values[:window], 3)(np.arange(-padding, 0))
    after = fit(places, values[-window:], 3)(window + np.arange(padding))
    extended = np.concatenate([before, values, after])
    return scipy.signal.sosfiltfilt(_sections(cutoff, rate), extended)[padding : padding + len(values)]


def _sections(cutoff: float, rate: float) -> Array:
    return scipy.signal.butter(TUNING.filter_order, cutoff, fs=rate, output="sos")


def choose_cutoff(joints: Iterable[tuple[Array, Array | None]], rate: float) -> float:
    """Cut-off that keeps the motion's dynamics: ten times the frequency below which 95 % of the speed's energy lies.

    See :eq:`motion-cutoff`. Torques hold harmonics of the motion (products of velocities), so the cut-off is well above
    the motion's bandwidth; Gautier and Khalil, "Exciting trajectories", 1992, take five to ten times. Each joint has
    positions (N,), rad, and velocities (N,), rad/s, or None, at a rate, Hz.
    """
    bandwidth = 0.0
    for q, dq in (joint for joint in joints if not still_joints(joint[0])):
        velocity = np.gradient(q, 1.0 / rate) if dq is None else dq
        frequency, power = scipy.signal.periodogram(velocity - velocity.mean(), fs=rate)
        share = np.cumsum(power) / max(power.sum(), 1e-300)
        bandwidth = max(bandwidth, float(frequency[np.searchsorted(share, 0.95)]))
    return float(np.clip(10.0 * bandwidth, min(TUNING.slowest_cutoff, 0.4 * rate), 0.4 * rate))


def _instants(t: Array, q: Array) -> Array:
    """(N,) times of the positions: the stamps, or evened ones if positions are much smoother in these.

    A logger's stamps may jitter while the controller samples evenly. Each position is predicted from its two neighbours
    by either times; jitter of the stamps alone makes the prediction worse.
    """
    window = min(TUNING.evened_rows, (len(t) - 1) // 2 * 2 + 1)
    if np.diff(t).max() > TUNING.held_periods * np.median(np.diff(t)):
        return t
    even = t[0] + scipy.signal.savgol_filter(t - t[0], window, 1)
    if np.diff(even).min() <= 0.0 or _roughness(even, q) > TUNING.smoother * _roughness(t, q):
        return t
    return even


def _roughness(t: Array, q: Array) -> float:
    """Mean squared error of linear prediction of every position from its neighbours, over the joint's variance."""
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    errors = [np.mean((x[1:-1] - (1.0 - share) * x[:-2] - share * x[2:]) ** 2) / max(x.var(), 1e-300) for x in q.T]
    return float(np.mean(errors))
