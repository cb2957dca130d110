"""Numeric choices of this package: comparison of logs and selection of effects."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package; `TUNING` holds those in use.

    Thresholds for adding effects are options (`bayesid.types.Thresholds`).
    `python -m bayesid.studies.ablation discrepancy` halves and doubles these numbers. Those without a reason are
    chosen, not measured.
    """

    # The log
    encoder_range: float = 1e-3
    """Range of a joint's positions below which it stands still, rad: above encoder noise."""
    longest: int = 10_000
    """Samples of a log that effects are selected on; computing time is proportional."""
    stretches: int = 8
    """Contiguous stretches of a longer log from which these samples are taken."""
    seam: int = 10
    """Samples left out at the ends of a stretch, where filters and hysteresis depend on samples outside."""
    blocks: int = 8
    """Equal blocks of a log, some of which are held back if there is no holdout log."""
    held_back_blocks: tuple[int, ...] = (2, 5)
    """Held-back blocks (from 0): a quarter of the log; more leaves less data for the selection."""
    mix_up_samples: int = 400
    """Evenly spread samples on which mixed-up columns are tested; bounds the time."""
    suspect_error: float = 0.25
    """Mean squared error of a joint over the variance of its efforts above which mixed-up columns are tested."""
    corrected_error: float = 0.1
    """Largest share of that error after correcting mixed-up columns; no missing effect lowers it that much."""
    remaining_length: float = 0.7e-3
    """Remaining length error of a table adapted to an earlier log, m; 1 mm is assumed before. With smaller values
    errors of the table count as new effects."""
    remaining_angle: float = 0.07
    """Remaining angle error likewise, degrees; 0.1 degrees are assumed before."""

    # The noise floor
    least_floor: float = 1e-3
    """Smallest noise floor over the earlier noise; only for residuals of exactly zero."""
    repeated: float = 1e-3
    """Tolerance of positions in a repeated motion, as a share of the joint's range."""
    repeated_still: float = 1e-4
    """The same for a joint that stands still, rad: encoder noise."""
    first_sample: float = 5.0
    """Factor on that tolerance for the first sample, which is compared before all others to save time."""
    same_motion: float = 0.05
    """Largest RMS difference of the positions of two recordings, as a share of the joint's range: 0.03 in repetitions
    of a KUKA KR 300, above 0.2 in other motions of the same robots."""
    aligned: int = 1000
    """Samples used to align the clocks of two recordings; the shift is then refined between samples."""
    shortest_period: float = 1.0
    """Shortest period of a repeated motion, s; shorter repetitions are pauses."""
    smooth: float = 1.5
    """Exponent of the lag in the growth of squared differences above which a residual was low-passed: 0 for white
    noise, 1 for a random walk, 2 after a low-pass."""
    longest_lag: float = 0.1
    """Longest lag of noise, s; slower residuals are model error, as friction reverses within a tenth of a second."""
    bins: int = 12
    """Bins with equally many samples in which a residual is displayed; affects only the display."""
    in_range: float = 0.25
    """Share of the largest bin above which a bin is in the displayed range; affects only the display."""

    # The search for effects
    alternations: int = 2
    """Alternations of signs and coefficients before effects are selected; bounds the time."""
    most_sets: int = 48
    """Sets of effects that are fitted fully; bounds the time, most logs need fewer."""
    sets_per_size: int = 2
    """Sets of one joint's effects that are fitted fully, per size; bounds the time."""
    searches_per_joint: int = 2
    """Searches for sets in one joint after effects elsewhere changed; bounds the time."""
    most_unconfirmed: int = 4
    """Effects that held-back data reject before the search stops; bounds the time."""
    rounds: int = 3
    """Searches for alternatives to a chosen set, which rarely changes more than once; bounds the time."""
    few_parameters: int = 2
    """Parameters of an effect above which it may replace several effects."""
    bases: int = 2
    """Distortions beside which other effects are searched, those with the largest gain; bounds the time."""
    alternatives: int = 2
    """Effects of several joints, or alternatives to an effect, that are fitted fully; bounds the time."""
    nearly: float = 3.0
    """log10 Bayes factor by which an alternative may be worse, in the quick score, to be fitted fully: the quick score
    keeps the signs."""
    noticed: float = 0.5
    """Nats by which other forms must be better for another iteration: far below the evidence that adds an effect."""
    equivalent_odds: float = 10.0
    """Odds up to which two sets count as equally probable: evidence is strong from there (Jeffreys 1961, appendix
    B)."""
    most_functions: int = 3
    """Learned functions that are added in one joint; bounds the time."""
    near_best: float = 0.5
    """Share of the best gain from which another function is fitted too: signs estimated without a function hide part of
    its gain."""

    # Several logs
    decisive: float = 2.0
    """log10 likelihood ratio from which a log decides for or against an effect of given size (Jeffreys 1961, appendix
    B)."""
    level: float = 0.05
    """Probability that any parameter is reported as changed by chance."""
    scatter: float = 1.3
    """Median change over its expected value above which there is a warning."""

    # Noise floor and thresholds, from the blind cases of `bayesid study discrepancy`
    another_robot: float = 1.05
    """RMS error of the predicted |effort| over the sd of the measured one. If all joints exceed it, the model belongs
    to another robot; a constant reaches 1."""
    clearly_moving: float = 2.5
    """Speed in units of standstill (1 % of the highest speed) above which a sample counts; at 2.5 friction's smoothed
    direction tanh(u' / standstill) reaches 99 %."""
    good_fit: float = 0.2
    """Relative residual of the earlier model below which it is the noise floor."""
    white_growth: float = 1.5
    """Largest ratio of white noise to the earlier log's; more is a finding."""
    repeated_white: float = 0.3
    """Least share of white noise in the residual of repeated periods."""
    white_limit: float = 1.1
    """Largest ratio of a fitted white part to the floor's that is noise, for sampling error."""
    coloured_limit: float = 1.25
    """Largest ratio of a fitted coloured part to the floor's that is noise; it has fewer independent samples."""
    coloured_allowance: float = 0.1
    """Coloured over white part that is always noise: the fit's resolution."""
    explained_share: float = 0.75
    """Least share of an unexplained joint's excess that its effects must explain to be kept."""


TUNING = Tuning()
