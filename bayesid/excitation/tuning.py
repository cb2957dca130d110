"""Numbers of this package that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Choices; `TUNING` holds those in use.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation excitation`). A motion designed for UR10e
    has other segments with another `robots`, `starts`, `rise` or `usual_motion`; what else changed a decision says so.
    """

    # what a motion shows
    independent: float = 20.0
    """1/s, samples that count as independent, at most: what a model leaves of efforts lasts so long. Halved or doubled,
    a designed motion leaves other coefficients undecided."""
    largest_group: int = 3
    """Joints turned at once: for up to seven joints all groups, as a group and its complement are the same."""
    robots: int = 3
    """For which a motion is designed and judged; each costs as much as the first."""
    sized: int = 24
    """Robots from which a coefficient's usual size is taken: it is known to 1 / sqrt(48), 15 %."""
    decided: float = 0.5
    """Of its usual size, a coefficient's standard deviation where the log decides it: two of them from zero."""
    judged: int = 2000
    """Instants, at most, at which a finished motion is judged."""

    # judgement of a log, from which on something is worth a word
    little: float = 0.2
    """rad (m): a joint that covers less hardly moves."""
    slow: float = 0.1
    """rad/s (m/s): a joint that is never faster hardly moves."""
    idle: float = 0.5
    """Share of the time at standstill."""
    mistaken: float = 0.01
    """Probability of a wrong sign."""
    open: float = 0.25
    """Share of undecided coefficients under a green light: products of inertia are small everywhere."""
    doubtful: float = 0.05
    """Share of a joint's energy with the wrong sign."""

    # splines
    spacing: float = 0.25
    """s between knots: a joint may turn round every half second, as fast as usual arms may. Halved or doubled, the
    next motion of UR10e leaves other questions open."""
    fewest_knots: int = 4
    """Of the shortest motion."""
    halves: int = 2
    """Parts between two knots with coefficients of their own: bounds are too wide by 4, 9, 15 and 14 % of the range of
    positions, velocities, accelerations and jerks at most then (`tests/excitation/test_splines.py`)."""
    per_swing: int = 4
    """Knots of a designed motion in the period of its highest harmonic; with 2 condition numbers were higher."""

    # limits
    band: float = 4.0
    """Standard deviations of the predicted effort within the limit: beyond lie 6e-5 of a normal distribution."""
    fine: float = 0.005
    """s between samples at which efforts are judged: with 10 ms bounds missed up to 0.9 % of them, with these none."""
    least_step: float = 1e-6
    """Share of a step that is worth a try: a shorter one leads beyond a limit where the motion is, but for rounding."""

    # search
    instants: float = 20.0
    """1/s at which information is summed while searching: five a period of what the fastest spline does."""
    per_knot: int = 20
    """Of these instants, at most, between two knots."""
    starts: int = 8
    """Random motions of which the best is the start."""
    halvings: int = 8
    """Of a random motion that is not possible, until it is given up."""
    rise: float = 1.0
    """s in which a start leaves its pose, and comes back: as long as usual arms need."""
    searches: int = 2
    """From different random motions, the better of which counts: one a processor of a small machine."""
    kinds: tuple[float, float, float] = (0.6, 0.25, 0.15)
    """How often a bump, a stretch of constant speed or a repetition is tried."""
    several: float = 0.3
    """How often in several joints at once."""
    slowest: float = 1e-3
    """Of the velocity limit, the slowest constant speed: a tenth of what counts as standing still."""
    widest: float = 0.4
    """Of the motion, what a change may span."""
    smallest: float = 1e-2
    """Of the joint's range, the smallest bump."""

    # the next motion
    changes: int = 2500
    """That a search tries for coefficients."""
    telling_changes: int = 1000
    """That a search tries for hypotheses, where a change costs more."""
    whole: int = 4
    """Of these one in so many where a row depends on the whole motion: each takes three to four times as long then."""
    most_recorded: int = 4000
    """Instants of the earlier motion that are looked at."""
    usual_motion: tuple[float, float] = (20.0, 20.0)
    """s and Hz of the random motion that stands for any."""
    chance: float = 1.1
    """Times the largest eigenvalue of many draws by chance: what few have beyond it (Johnstone 2001)."""
    sign: float = 1.0
    """Error of an effort, over its noise, that is wanted for its sign: noise says as much as the model then."""

    # hypotheses
    telling: float = 2.0
    """Log10 Bayes factor from which on effects count as told apart: decisive (Jeffreys 1961, appendix B)."""
    wider: float = 10.0
    """Times the standard deviation now, the largest before the earlier recording."""
    most_forms: int = 4
    """Of a hypothesis that are looked at: time grows with them."""
    shift: float = 1e-3
    """Standard deviation of an effect's change without amplitude, which is as it is."""


TUNING = Tuning()
