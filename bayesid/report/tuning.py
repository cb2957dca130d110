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
    """Share of the coefficients that the data should decide. Chosen; not measured."""
    half_decided: float = 0.5
    """The same share below which the check is bad: the prior decides most coefficients."""
    poorly_known: float = 1.0
    """Relative standard deviation above which the sign of a coefficient is unknown."""
    covered: tuple[float, float] = (0.9, 0.99)
    """Good shares of another log's efforts inside the 95 % bands: 1 to 10 % are outside, 5 % is expected."""
    worse: float = 1.5
    """Largest good ratio of the RMS residual on another log to that on the identified log. Chosen; larger ratios
    indicate a missing effect."""
    larger: float = 4.0
    """Factor by which a remedy raises a budget that did not suffice."""
    another_robot: float = 10.0
    """Geometry error over its tolerance above which the file is of another robot: 1 cm for a tolerance of 1 mm."""

    actions: int = 3
    """Remedies that a verdict lists; the report has all."""

    # Verdicts of a discrepancy
    joints_named: int = 3
    """Joints whose gaps are named in one line."""
    sure: float = 0.9
    """Probability of an effect below which the probability is stated."""
    set_listed: float = 0.01
    """Least probability of a listed set of effects."""

    # Whether separate runs agree
    level: float = 0.01
    """p-value below which a coefficient differs between runs; by chance 0.6 of 60 coefficients do."""
    chance: float = 1e-3
    """p-value below which the number of such coefficients is not by chance: a tenth of `level`, for one joint test."""
    alike: float = 1.3
    """Observed over expected difference up to which runs agree; also its inverse. With right standard deviations, nine
    of ten pairs of runs of a UR10e (58 coefficients) are inside."""

    # What is shown
    samples: int = 40_000
    """Largest number of stored samples: a report of seven joints stays below 5 MB."""
    lags: float = 0.5
    """Longest lag of the shown autocorrelation, s."""
    bins: int = 24
    """Largest number of means of a curve: as many as a figure of 5 inches resolves."""
    most_different: int = 3
    """Coefficients of another mode that are named."""
    most_listed: int = 4
    """Items listed in one sentence of a time line."""
    worst_coefficients: int = 10
    """Coefficients in the printed table of an agreement."""
    next_coefficients: int = 12
    """Coefficients in the table of a next motion: those that improve most."""
    curve: int = 3000
    """Approximate largest number of points of a curve over time: about four per pixel."""
    page_curve: int = 2400
    """The same on a page, which stays below 1 MB."""
    scatter: int = 1500
    """Largest number of dots of a scatter plot."""
    page_scatter: int = 600
    """Dots of each of the many residuals on a page."""
    poses: int = 500
    """Largest number of samples among which extreme poses are searched: tens per period of the fastest harmonic."""
    bars: int = 12
    """Candidates or assignments in a figure; they fit on the screen of a telephone."""
    moved: int = 11
    """Parameters with their own panel in a time line; with the last panel they fill one screen."""
    histogram: int = 20
    """Bins of a histogram of ranks: fifty of an ensemble's thousand draws per bin, a standard error of 14 %."""
    doubts: int = 20
    """Ambiguous segments listed on a page: one screen."""
    candidates: int = 25
    """Candidates listed on a page besides added ones: one screen."""
    assignments: int = 10
    """Alternative assignments listed on a page."""
    spans: int = 5
    """Linked segments of an alternative assignment: as many as fit into a cell."""
    well_known: float = 0.1
    """Relative standard deviation of a well-known coefficient, as in the report's first lines."""
    soon: float = 0.05
    """Least printed delay of an alarm, s."""


TUNING = Tuning()
