"""Chosen constants of this package."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Constants of this package; `TUNING` holds those in use.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation excitation`). A motion designed for UR10e
    has other segments with another `robots`, `starts`, `rise` or `reference_motion`. Others that changed a decision
    say so.
    """

    # what a motion shows
    independent: float = 20.0
    """1/s, most independent samples per second, as residuals are correlated. Halved or doubled, a designed motion
    leaves other coefficients undetermined."""
    largest_group: int = 3
    """Most joints flipped together. For up to seven joints this covers all groups, as complements are equivalent."""
    robots: int = 3
    """Random robots for which a motion is designed and assessed; time is proportional to their number."""
    sized: int = 24
    """Random robots that give the usual size of a coefficient, with a relative error of 1 / sqrt(48), 15 %."""
    decided: float = 0.5
    """Standard deviation of a determined coefficient over its usual size, at most: two of them from zero."""
    judged: int = 2000
    """Most instants at which a finished motion is assessed."""

    # thresholds of the remarks on a log
    little: float = 0.2
    """rad (m), range below which a joint hardly moves."""
    slow: float = 0.1
    """rad/s (m/s), highest speed below which a joint hardly moves."""
    idle: float = 0.5
    """Share of the time at standstill."""
    mistaken: float = 0.01
    """Probability of a wrong sign."""
    open: float = 0.25
    """Largest share of undetermined coefficients for good; products of inertia are small in all robots."""
    doubtful: float = 0.05
    """Share of a joint's energy with the wrong sign."""

    # splines
    spacing: float = 0.25
    """s between knots. A joint can reverse every half second, as fast as usual arms can. Halved or doubled, the next
    motion of UR10e leaves other coefficients undetermined."""
    fewest_knots: int = 4
    """Least number of knots."""
    halves: int = 2
    """Pieces per knot interval with their own coefficients; more give tighter bounds. With two, bounds exceed
    positions, velocities, accelerations and jerks by at most 4, 9, 15 and 14 % of the range
    (`tests/excitation/test_splines.py`)."""
    per_swing: int = 4
    """Knots per period of the highest harmonic of a designed motion; 2 gave higher condition numbers."""

    # limits
    band: float = 4.0
    """Standard deviations of the predicted effort within the limit; a normal distribution exceeds them with 6e-5."""
    fine: float = 0.005
    """s between samples at which effort limits are checked; 10 ms missed up to 0.9 % of the effort, 5 ms nothing."""
    least_step: float = 1e-6
    """Smallest share of a step that is tried; at a limit, shorter steps are rounding."""

    # search
    instants: float = 20.0
    """1/s, rate at which information is summed during the search."""
    per_knot: int = 20
    """Most of these instants between two knots."""
    starts: int = 8
    """Random motions, the best of which starts the search."""
    halvings: int = 8
    """Most halvings of an infeasible random motion before it is discarded."""
    rise: float = 1.0
    """s in which a random motion leaves its start pose, and returns to it: as long as usual arms need."""
    searches: int = 2
    """Searches from different random motions, the best of which is used: one per core of a small machine."""
    kinds: tuple[float, float, float] = (0.6, 0.25, 0.15)
    """Probabilities of trying a bump, a stretch of constant speed or a repetition."""
    several: float = 0.3
    """Probability of a change in several joints at once."""
    slowest: float = 1e-3
    """Lowest constant speed over the velocity limit: a tenth of standstill."""
    widest: float = 0.4
    """Largest share of the motion that a change may span."""
    smallest: float = 1e-2
    """Smallest bump over the joint's range."""

    # the next motion
    changes: int = 2500
    """Changes that a search for coefficients tries."""
    telling_changes: int = 1000
    """Changes that a search for hypotheses tries; each costs more."""
    whole: int = 4
    """Divisor of these numbers if rows depend on the whole motion: each change then takes 3 to 4 times as long."""
    most_recorded: int = 4000
    """Most instants of the earlier motion that are used."""
    reference_motion: tuple[float, float] = (20.0, 20.0)
    """s and Hz, duration and rate of the random reference motion."""
    chance: float = 1.1
    """Factor on the largest eigenvalue expected by chance, for its fluctuation with few draws (Johnstone 2001)."""
    sign: float = 1.0
    """Required error of a predicted effort over its noise, for its sign; model and noise then contribute equally."""

    # hypotheses
    telling: float = 2.0
    """Log10 Bayes factor above which effects are distinguished: decisive (Jeffreys 1961, appendix B)."""
    wider: float = 10.0
    """Largest standard deviation before the earlier recording, over the present one."""
    most_forms: int = 4
    """Most forms of a hypothesis; time grows with them."""
    shift: float = 1e-3
    """Standard deviation of the amplitude 1 of an effect's constant change; small, as it is fixed."""


TUNING = Tuning()
