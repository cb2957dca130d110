"""Numbers that were chosen: how a model is compared with a log, and how the effects that it lacks are selected."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package, with what each is for; `TUNING` holds those in use.

    What decides which effects are named is an option: `bayesid.types.Thresholds`.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation discrepancy`). Where that was seen to
    change a decision on simulated pairs of logs, the number's sentence says so.
    """

    # The log
    encoder_range: float = 1e-3
    """rad; a joint that never leaves this range stands still but for its encoder's noise."""
    longest: int = 10_000
    """Samples of a log that effects are selected on: time grows with them."""
    stretches: int = 8
    """Stretches that these samples are taken from."""
    seam: int = 10
    """Samples at the ends of a stretch that do not count: filters and hysteresis see across."""
    blocks: int = 8
    """Equal blocks of a log that some are held back of, where there is no holdout log."""
    held_back_blocks: tuple[int, ...] = (2, 5)
    """Those that are held back (0-based): a quarter of the log."""
    mix_up_samples: int = 400
    """On which every mix-up of columns is tried, spread evenly."""
    suspect: float = 0.25
    """Mean squared error of a joint over the variance of its efforts, from which on mix-ups are tried."""
    mended: float = 0.1
    """Share of that error that a mended mix-up may leave at most: no effect is undone by exchanging columns."""
    left_length: float = 0.7e-3
    """m, by which a table may still be off once the model is bent to an earlier log, of 1 mm. Set by hand: with less an
    error of the table since then need not be as large."""
    left_angle: float = 0.07
    """Degrees, of 0.1 degrees; likewise."""

    # The noise floor
    least_floor: float = 1e-3
    """Share of the earlier noise below which no floor is: a guard against residuals that are nothing but zeros."""
    repeated: float = 1e-3
    """Share of a joint's range within which a repeated motion comes back."""
    repeated_still: float = 1e-4
    """rad; a joint that stands still comes back within its encoder's noise."""
    probed: float = 5.0
    """Times that tolerance within which the first sample must come back before all others are compared: saves time."""
    same_motion: float = 0.05
    """Share of a joint's range up to which positions of two recordings may differ, RMS: 0.03 in repetitions of a KUKA
    KR 300, above 0.2 in other motions of the same robots."""
    aligned: int = 1000
    """Samples by which the clocks of two recordings are compared; the shift is then refined between two of them."""
    shortest_period: float = 1.0
    """s; a repeated motion lasts longer than this: whatever is shorter is a pause."""
    smooth: float = 1.5
    """Exponent of the lag by which squared differences grow, from which on something is smoother than model errors are:
    0 for white noise, 1 for a random walk, 2 for what has passed a low-pass."""
    longest_lag: float = 0.1
    """s; what changes more slowly is model error: friction turns round within a tenth of a second."""
    bins: int = 12
    """Of a variable that a residual is shown over, with equally many samples each. A round number, for display."""
    in_range: float = 0.25
    """Of the largest bin's share, from which on a bin belongs to the range that is shown. For display."""

    # The search for effects
    settlings: int = 2
    """Times that signs and coefficients take turns before effects are looked for."""
    most_sets: int = 48
    """Sets of effects that are looked at closely; most logs need fewer. A round number: bounds the time."""
    polished: int = 2
    """Sets of one joint's effects, of each size, that are looked at closely."""
    looks: int = 2
    """Times that sets of one joint's effects are looked for, others having changed meanwhile. Bounds the time."""
    most_idle: int = 4
    """Effects that do not help before no more are added."""
    rounds: int = 3
    """Times that the sets around a chosen one are looked at; it rarely changes more than once. Bounds the time."""
    few: int = 2
    """Numbers up to which one effect in a joint is plain: more may stand for several effects."""
    bases: int = 2
    """Distortions that other effects are looked for beside, those that explain most first."""
    whole: int = 2
    """Effects of several joints, or rivals of an effect, that are looked at closely."""
    nearly: float = 3.0
    """log10 Bayes factor by which a rival may be behind, in the quick look, to be looked at closely."""
    noticed: float = 0.5
    """Nats by which other forms must be likelier to be worth another turn."""
    equivalent_odds: float = 10.0
    """Odds up to which one set is about as likely as another: "strong" begins there (Jeffreys 1961, appendix B)."""
    most_functions: int = 3
    """Functions without a name that are added in one joint."""
    near_best: float = 0.5
    """Share of the best gain, of a function or of a joint's effects together, from which on another function may turn
    out better: signs settled without it hide what it explains. Set by hand."""

    # Several logs
    decisive: float = 2.0
    """log10 of a likelihood ratio from which on a log speaks for or against an effect of a given size (Jeffreys 1961,
    appendix B)."""
    level: float = 0.05
    """Probability that any parameter at all is said to have moved where none has: a usual level."""
    scatter: float = 1.3
    """Typical change over its standard deviation from which on a warning says so, as of separate runs."""


TUNING = Tuning()
