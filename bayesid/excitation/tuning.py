"""Constants of this package."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Constants of this package; `TUNING` holds those in use.

    `python -m bayesid.studies.ablation excitation` halves and doubles them. Changing `robots`, `starts`, `ramp` or
    `reference_motion` changes the segments of a motion designed for a UR10e. Other effects are stated with the
    constant. A constant without a measurement is a choice.
    """

    # assessment of a motion
    independent_rate: float = 20.0
    """1/s, highest rate of independent samples, as residuals are correlated. It scales all predicted standard
    deviations. Halving or doubling it changes which coefficients of a designed motion are undetermined."""
    largest_group: int = 3
    """Most joints flipped together. For up to seven joints this covers all groups, as complements are equivalent."""
    robots: int = 3
    """Random robots for which a motion is designed and assessed; time is proportional to their number."""
    size_draws: int = 24
    """Random robots that give the usual size of a coefficient, with a relative error of 1 / sqrt(48), 15 %."""
    determined_sd: float = 0.5
    """Largest standard deviation of a determined coefficient over its usual size: zero is two deviations away."""
    assessed_samples: int = 2000
    """Most samples at which a finished motion is assessed; it limits time and memory."""

    # thresholds of the remarks on a log
    least_range: float = 0.2
    """rad (m), range below which a joint hardly moves."""
    least_speed: float = 0.1
    """rad/s (m/s), highest speed below which a joint hardly moves."""
    most_standstill: float = 0.5
    """Share of the time at standstill."""
    wrong_sign: float = 0.01
    """Probability of a wrong sign above which a joint counts as flippable."""
    most_undetermined: float = 0.25
    """Largest share of undetermined coefficients for good. Some always are: products of inertia are small."""
    doubtful_energy: float = 0.05
    """Expected share of a joint's energy with a wrong sign."""

    # splines
    spacing: float = 0.25
    """s between knots. A joint can reverse every 0.5 s, as fast as usual arms can. Halving or doubling it changes which
    coefficients the next motion of a UR10e leaves undetermined."""
    fewest_knots: int = 4
    """Least number of knots."""
    pieces_per_interval: int = 2
    """Pieces of a knot interval with Bernstein coefficients of their own; more give tighter bounds and take longer.
    With two, bounds exceed positions, velocities, accelerations and jerks by at most 4, 9, 15 and 14 % of the range
    (`tests/excitation/test_splines.py`)."""
    per_swing: int = 4
    """Knots per period of the highest harmonic of a designed motion; 2 gave higher condition numbers."""

    # limits
    effort_sds: float = 4.0
    """Standard deviations of the predicted effort inside the limit; a normal distribution exceeds them with 6e-5."""
    effort_step: float = 0.005
    """s between samples at which effort limits are checked; 10 ms missed up to 0.9 % of the effort, 5 ms nothing."""
    least_step: float = 1e-6
    """Smallest share of a step that is tried; at a limit, shorter steps are rounding."""

    # search
    search_rate: float = 20.0
    """1/s, samples at which information is summed during the search; time is proportional to it."""
    per_knot: int = 20
    """Most of these samples between two knots."""
    starts: int = 8
    """Random motions, the best of which starts the search."""
    halvings: int = 8
    """Most halvings of an infeasible random motion before it is discarded."""
    ramp: float = 1.0
    """s in which a random motion leaves its start pose, and returns to it."""
    searches: int = 2
    """Searches from different random motions, the best of which is used: one per core of a small machine."""
    change_probabilities: tuple[float, float, float] = (0.6, 0.25, 0.15)
    """Probabilities of trying a bump, a stretch of constant speed or a repetition."""
    several_joints: float = 0.3
    """Probability of a change in several joints at once."""
    slowest_speed: float = 1e-3
    """Lowest constant speed over the velocity limit: a tenth of standstill."""
    widest_change: float = 0.4
    """Largest share of the motion that a change may span."""
    smallest_bump: float = 1e-2
    """Smallest bump over the joint's range."""

    # the next motion
    coefficient_changes: int = 2500
    """Changes that a search for coefficients tries: about half a minute for six joints."""
    hypothesis_changes: int = 1000
    """Changes that a search for hypotheses tries; each takes longer."""
    whole_motion_factor: int = 4
    """Divisor of these numbers if rows depend on the whole motion: each change then takes 3 to 4 times as long."""
    most_recorded: int = 4000
    """Most samples of the earlier motion that are used; it limits time and memory."""
    reference_motion: tuple[float, float] = (20.0, 20.0)
    """s and Hz, duration and rate of the random reference motion."""
    chance: float = 1.1
    """Factor on the largest eigenvalue expected by chance, for its fluctuation with few draws (Johnstone 2001)."""
    sign_error: float = 1.0
    """Required error of a predicted effort over its noise, for its sign; model and noise then contribute equally."""

    # hypotheses
    decisive: float = 2.0
    """Log10 Bayes factor above which effects are distinguished: decisive (Jeffreys 1961, appendix B)."""
    earlier_sd: float = 10.0
    """Largest ratio of the standard deviations before and after the earlier recording."""
    most_forms: int = 4
    """Most forms of a hypothesis; time grows with them."""
    constant_sd: float = 1e-3
    """Standard deviation of the amplitude 1 of an effect's constant change. It is fixed; zero would be singular."""


TUNING = Tuning()
