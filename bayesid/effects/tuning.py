"""Chosen constants of the effects."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Grids of nonlinear numbers, and limits of memory.

    `python -m bayesid.studies.ablation effects` halves and doubles them; constants that changed a decision on UR10e's
    or KR300's log are marked. Without a study or a reason, a value is chosen, not measured.
    """

    # columns of a model
    chunk: int = 4096
    """Samples whose columns are in memory at once: memory against the overhead of a call."""
    look_back: int = 4096
    """Samples before a chunk for effects with a memory, 4 s at 1 kHz: presliding needs a few strokes."""
    look_ahead: int = 16
    """Samples after a chunk: the end effect of a cubic spline falls by 0.27 per sample, to 1e-9."""
    cached_bytes: int = 256_000_000
    """Bytes of cached columns of one motion, which is used about ten times: 150,000 samples of six joints and 84
    parameters."""
    chunks_together: int = 8
    """Chunks computed in parallel at a time, to bound the memory."""

    # base coefficients
    dependent: float = 1e-4
    """Residual of a dependent column relative to its length. On a random motion dependent columns leave 1e-13 (1e-9 to
    1e-5 if an angle is a rounded pi/2, or calibrated), independent ones 1e-3."""
    random_samples: int = 400
    """Samples of the random motion: 400 n rows for the 14 n parameters of the standard terms."""

    # numbers tried
    hysteresis_widths: tuple[float, ...] = (0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35)
    """rad (m), displacement from rest to slipping, each about 1.8 times the last; refined in between."""
    fewest_samples_of_width: float = 2.0
    """Fewest samples within a width; a shorter one looks like a step."""
    usual_speed: float = 80.0
    """Percentile of the speeds that counts as usual. Halving it changes the effects found on UR10e (`ablation`)."""
    stribeck_slow: float = 10.0
    """Stribeck speed over standstill speed if it is not fitted to a log; standstill is 1 % of the highest speed."""
    stribeck_speeds: tuple[float, ...] = (0.035, 0.06, 0.1, 0.17, 0.3)
    """Stribeck speeds, as shares of the joint's highest speed, each 1.7 times the last; refined in between."""
    knees: tuple[float, ...] = (0.1, 0.2, 0.4, 0.7)
    """Speeds at which drag saturates, as shares of the joint's highest: lower is dry friction, higher viscous."""
    warming_times: tuple[float, ...] = (0.2, 0.5, 1.2)
    """Time constants of warming, as shares of the log's length; much longer ones are linear within the log."""
    cable_starts: int = 11
    """Positions at which a cable begins to pull; refined in between."""
    cable_centres: int = 9
    """Positions at which a cable or pack is relaxed; refined in between."""
    cable_middle: tuple[float, float] = (10.0, 90.0)
    """Percentiles of the positions that bound these, so that both sides of each are visited."""
    ripple_lowest: float = 3.0
    """1/rad; waves longer than 2 rad look like springs and gravity."""
    ripple_step: float = 0.35
    """Step of the harmonic, in units of pi over the joint's range: neighbours differ by less than half a wave."""
    ripple_fastest: float = 0.7
    """Share of the log's Nyquist frequency that ripple may reach at the usual speed: filters cut what is faster."""
    most_harmonics: int = 400
    """Harmonics tried at most: bounds the time of a comparison."""
    lags: tuple[float, ...] = (0.0, 0.05, 0.12, 0.25, 0.4)
    """s; the effort is about linear in the lag between them. Denser at the delays of bus cycles and filters."""
    clipping_limits: int = 16
    """Limits tried, from 0.8 to 1 times the highest reading: steps of 1.3 %, then refined around the best."""
    near_limit: float = 0.94
    """Readings above this share of the limit may be clipped; the margin allows noise of a few percent."""
    clipping_top: float = 99.8
    """Percentile of the readings that counts as the highest, so that single spikes do not."""
    dead_zone_top: float = 99.0
    """The same for dead zones."""
    dead_zone_growth: float = 1.3
    """Thresholds grow by this factor from 0.005 of the highest readings to 0.43 of them; refined in between."""
    blurs: tuple[float, ...] = (1.0, 1.05, 1.1, 1.2)
    """Thresholds above a gap between readings, relative to it: noise may blur the edge."""
    gaps: int = 3
    """Gaps between readings that are tried, the widest."""
    gaps_below: float = 0.6
    """Gaps are searched below this share of the highest reading; higher readings are sparse."""
    clearly_above: float = 0.5
    """Readings above this share of the threshold do not count as zero: midway between zero and the threshold."""
    clearly_read: float = 0.3
    """The same for a dead zone with offset, where only noise raises zeros."""
    payload_inertia: float = 0.03
    """kg m^2, prior sd of a payload's inertia: 1 kg (0.17 m)^2."""
    payload_moment: float = 0.15
    """kg m, prior sd of its first moments: 1 kg at 0.15 m from the flange."""
    parallel: float = 0.1
    """m/s^2, gravity across the first axis (a tilt of 0.6 degrees); below it link 1's weight is not identifiable."""

    # learned effects
    margin: float = 0.15
    """Extension of the cosines' interval at either end, as a share of the range; their slope is zero at its ends."""
    beyond: float = 0.5
    """Extrapolation of one power, or a straight line, as a share of the range; beyond it the function is constant."""
    explained: float = 0.95
    """Share of a function's mean square that a simpler one must explain to replace it in the text."""
    grid: int = 41
    """Values of a variable at which functions are compared; chosen, not measured."""
    most_products: int = 2
    """Most products whose sum a function of two variables is written as."""
    most_terms: int = 3
    """Most terms of a formula; a longer one is written as f of its variables."""
    few_waves: int = 3
    """Most waves, constant included, that are written as a sine."""
    odd: float = 0.05
    """A function counts as odd if its even part has at most this share of its mean square."""
    tilts: tuple[float, ...] = (0.0175, 0.035)
    """rad, base tilts tried while signs are unknown: 1 and 2 degrees."""
    tilt_axes: int = 8
    """Number of axes of these tilts."""


TUNING = Tuning()
