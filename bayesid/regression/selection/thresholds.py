"""What the workflow decides by: every threshold that steers it, with its meaning and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Where the workflow draws its lines.

    All values are those of the blind cases of `bayesid study discrepancy` (docs/discrepancy.md, section 7); they judged
    them together; those over a blunt floor had to explain real friction too (`bayesid study real_discrepancy`).
    Where no other source is named a value was set by hand and not varied by itself. None has a unit: they are ratios,
    shares, counts, or log10 of Bayes factors.

    Attributes:
        min_samples: samples in motion that one joint at least must have.
        another_robot: RMS error of the predicted |effort| over the sd of the measured one, beyond which, in every
            joint, the model is taken for another robot's; 1 is what a constant reaches.
        clearly_moving: speed, in units of standstill (a hundredth of the highest), from which on a sample counts. With
            the smoothing tanh(u' / standstill) friction's direction is 99 % there at 2.5.
        good_fit: share of a joint's RMS effort below which the earlier model's residual is the noise floor.
        white_growth: factor by which the white noise may exceed the earlier log's; the rest is a finding.
        repeated_white: least share of white noise in what repeated periods leave.
        white_limit: factor on the floor's white part within which a fitted one is nothing but noise: sampling error.
        coloured_limit: the same for the coloured part, which has fewer independent samples.
        coloured_allowance: share of the white part that a coloured one may always have: the fit's own resolution.
        above_floor: residual over the noise floor from which on a joint is not explained.
        above_blunt_floor: the same over a floor that lacks what lasts of the noise, such as the residual's fast part.
        at_blunt_floor: residual over a blunt floor at which nothing but standard effects is looked for any more.
        log10_bayes_factor: that an effect needs to be added; 2 is "decisive" (Jeffreys 1961, appendix B).
        improvement: fall of a joint's mean squared residual, in units of the noise floor's, that it needs beside.
        improvement_of_rest: the same as a share of what is left.
        equivalent: log10 below which two effects are equivalent; "strong" begins at 1 (ib.).
        testable: log10 to be expected of a usual amplitude below which an effect cannot be tested: what it needs to be
            added.
        nothing_missing: prior probability that nothing is missing, by convention one half.
        something_else: prior probability that it is outside of the catalogue; the effects share the rest.
        max_effects: that are added; a bound against endless loops, some six a joint.
        short_list: effects among which one selection chooses, in their best forms; a round number.
        close_looks: effects with error models of their own when all are scored; a round number, more of them cost time.
        held_back_improvement: share of a joint's squared errors on held-back data by which a set of effects must
            predict them better than a smaller one. Effects may show less there than in the log they were found in.
        explained_share: of the excess in a joint that stays unexplained, that its effects must explain to be kept.

    Example:
        >>> strict = bayesid.Thresholds(log10_bayes_factor=4.0)  # bayesid.find_discrepancy(..., thresholds=strict)
        >>> strict.log10_bayes_factor, strict.max_effects
        (4.0, 40)
    """

    # the log
    min_samples: int = 200
    another_robot: float = 1.05
    clearly_moving: float = 2.5
    # the noise floor
    good_fit: float = 0.2
    white_growth: float = 1.5
    repeated_white: float = 0.3
    white_limit: float = 1.1
    coloured_limit: float = 1.25
    coloured_allowance: float = 0.1
    above_floor: float = 1.25
    above_blunt_floor: float = 1.6
    at_blunt_floor: float = 1.15
    # effects
    log10_bayes_factor: float = 2.0
    improvement: float = 0.05
    improvement_of_rest: float = 0.1
    equivalent: float = 1.0
    testable: float = 2.0
    nothing_missing: float = 0.5
    something_else: float = 0.1
    max_effects: int = 40
    short_list: int = 60
    close_looks: int = 10
    # held-back data
    held_back_improvement: float = 0.025
    explained_share: float = 0.75
