"""Limits of the checks, and how much is shown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Numbers of this package; `TUNING` holds those in use.

    Study: `python -m bayesid.studies.ablation report` halves and doubles many of them.
    """

    # Verdicts of an identification
    well_conditioned: float = 100.0
    """Condition number up to which a motion excites well, as usual in the field. Study `excitation`: 2 % error of the
    efforts of a new motion at 66."""
    ill_conditioned: float = 1000.0
    """Condition number above which a motion excites poorly. Study `excitation`: 20 % error at 6000."""
    mostly_sure: float = 0.95
    """Share of the |effort| that should have a certain sign: the usual 95 %."""
    unsure: float = 0.8
    """The same share below which the check is bad: a fifth of the |effort| has an uncertain sign."""
    ambiguous: float = 0.95
    """Confidence below which a segment is ambiguous: the usual 95 %."""
    decided: float = 0.9
    """Share of the coefficients that the data should decide; a choice for display."""
    half_decided: float = 0.5
    """The same share below which the check is bad: the prior decides most coefficients."""
    poorly_known: float = 1.0
    """Relative standard deviation from which on the sign of a coefficient is unknown."""
    covered: tuple[float, float] = (0.9, 0.99)
    """Share of another log's efforts inside the 95 % bands that is good: at most twice, or a fifth of, the expected
    share lies outside."""
    worse: float = 1.5
    """RMS residual of another log over that of the own log that is good: a choice; larger ones point to a missing
    effect."""
    larger: float = 4.0
    """Factor by which a remedy raises a budget that did not suffice."""
    another_robot: float = 10.0
    """Geometry error over its tolerance from which on the file is of another robot: 1 cm for a tolerance of 1 mm."""

    actions: int = 3
    """Actions that a verdict lists; the report has all."""

    # Verdicts of a discrepancy
    joints_named: int = 3
    """Joints whose gaps one line names."""
    effects_named: int = 3
    """Effects that the first line of a discrepancy names."""
    sure: float = 0.9
    """Probability of an effect below which it is stated."""
    set_listed: float = 0.01
    """Probability from which on a set of effects is listed."""

    # Whether separate runs agree
    level: float = 0.01
    """p-value below which a coefficient differs between the runs: a usual level; less than one of 60 does by chance."""
    chance: float = 1e-3
    """p-value below which the number of such coefficients is not chance: a tenth of the level, for one joint test."""
    alike: float = 1.3
    """Observed over expected difference of runs that still agree, and its inverse: with right standard deviations
    nine in ten pairs of runs of a UR10e (58 coefficients) are inside."""

    # What is shown
    samples: int = 40_000
    """Samples that are kept, at most: a report of seven joints stays below 5 MB."""
    lags: float = 0.5
    """s up to which the residual's autocorrelation is shown."""
    bins: int = 24
    """Means of a curve, at most: as many as a figure of 5 in separates."""
    most_different: int = 3
    """Coefficients of another mode that are named."""
    most_listed: int = 4
    """Items listed in one sentence of a time line."""
    worst_coefficients: int = 10
    """Coefficients in the printed table of an agreement."""
    next_coefficients: int = 12
    """Coefficients in the table of a next motion: those that improve most."""
    curve: int = 3000
    """Points of a curve over time, at most about: some four a pixel."""
    page_curve: int = 2400
    """The same on a page, which stays below 1 MB."""
    scatter: int = 1500
    """Dots of a scatter, at most."""
    page_scatter: int = 600
    """Dots of each of the many residuals on a page."""
    poses: int = 500
    """Instants at which extreme poses are searched, at most: tens in a period of the fastest harmonic."""
    bars: int = 12
    """Candidates or assignments in a figure: fits a telephone's screen."""
    moved: int = 11
    """Parameters with their own panel in a time line: with the last panel one screen."""
    histogram: int = 20
    """Bins: fifty of an ensemble's thousand draws in each, with a standard error of 14 %."""
    doubts: int = 20
    """Ambiguous segments that a page lists: one screen."""
    candidates: int = 25
    """Candidates that a page lists besides added ones: one screen."""
    assignments: int = 10
    """Other assignments that a page lists."""
    spans: int = 5
    """Linked segments of another assignment: as many as fit into a cell."""
    well_known: float = 0.1
    """Relative standard deviation of a well-known coefficient, as in the report's first lines."""
    soon: float = 0.05
    """s; shorter delays of an alarm are not printed."""


TUNING = Tuning()
