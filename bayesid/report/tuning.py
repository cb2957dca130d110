"""Numbers that were chosen: from which values on a check is good, to be looked at or bad, and how much is shown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package, with what each is for; `TUNING` holds those in use.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation report`). Where that was seen to change a
    decision on UR10e's page, the number's sentence says so.
    """

    # Verdicts of an identification
    well_conditioned: float = 100.0
    """Condition number up to which a motion excites well: the field's custom. Study `excitation`: efforts of a new
    motion are 2 % off at 66."""
    ill_conditioned: float = 1000.0
    """Condition number beyond which it does not: a round number between 66 and 6000, where efforts of a new motion are
    some 20 % off in study `excitation`."""
    mostly_sure: float = 0.95
    """Share of the |effort| that should have a sign which is as good as certain: the custom of 95 %."""
    unsure: float = 0.8
    """Such a share below which too much is guessed."""
    ambiguous: float = 0.95
    """Confidence below which a segment's sign is called ambiguous: the custom of 95 %."""
    decided: float = 0.9
    """Share of the coefficients that the data should decide."""
    half_decided: float = 0.5
    """Such a share below which the prior decides most."""
    poorly_known: float = 1.0
    """Standard deviation over value from which on not even the sign of a coefficient is known."""
    covered: tuple[float, float] = (0.9, 0.99)
    """Share of a new log's efforts inside a band of 95 %: outside of this the standard deviations do not hold there;
    round numbers about 95 %."""
    worse: float = 1.5
    """Times the RMS residual of the log itself that a new log's may reach, as shares of the effort depend on the
    motion."""
    larger: float = 4.0
    """Times a budget in seconds that did not suffice: enough to be worth another run."""
    another_robot: float = 10.0
    """Times as far off as believed from which on a geometry is another robot's: a centimetre where a millimetre was
    stated."""

    actions: int = 3
    """Things to do that a verdict names: more are not read at once; the report has all."""

    # Verdicts of a discrepancy
    joints_named: int = 3
    """Joints whose gaps are named one by one: more make a sentence that nobody reads."""
    effects_named: int = 3
    """Effects that the line on top of a discrepancy names: more make one that nobody reads."""
    sure: float = 0.9
    """Probability below which it is mentioned."""
    set_listed: float = 0.01
    """Probability from which on a set of effects is listed; for display."""

    # Whether separate runs agree
    level: float = 0.01
    """p-value below which a coefficient is said to differ between the runs: a usual level; of 60 coefficients less than
    one does by chance."""
    chance: float = 1e-3
    """Probability below which a number of such coefficients is more than chance: a round number, a tenth of the level,
    for all coefficients together are tested once."""
    alike: float = 1.3
    """Runs that differ up to so many times as much as they should, and down to its inverse, agree as they should: with
    right standard deviations nine in ten pairs of runs of a UR10e do (58 coefficients, correlated as in its
    posterior)."""

    # What is shown
    samples: int = 40_000
    """Samples that are kept, evenly spread ones of a longer log: a minute of seven joints then makes a report of under
    5 MB (tests/report/test_identification_page.py)."""
    lags: float = 0.5
    """s up to which the residual's autocorrelation is shown."""
    bins: int = 24
    """Means of a curve, at most: points that can be kept from each other on a figure of 5 in."""
    most_different: int = 3
    """Coefficients of another mode that are named."""
    most_listed: int = 4
    """Of what is listed in one sentence of a time line: more make one that nobody reads."""
    worst_coefficients: int = 10
    """Coefficients in the printed table of an agreement: as many as a terminal shows with the sentence above."""
    next_coefficients: int = 12
    """Coefficients in the table of a next motion: those of which most is learned."""
    curve: int = 3000
    """Points of a curve over time, at most about: some four a pixel."""
    page_curve: int = 2400
    """The same on a page, which stays below 1 MB."""
    scatter: int = 1500
    """Dots of a scatter, at most: more would hide each other."""
    page_scatter: int = 600
    """Dots of each of the many residuals on a page."""
    poses: int = 500
    """Instants at which extreme poses are looked for, at most: a period of the fastest harmonic has tens of them."""
    bars: int = 12
    """Candidates, or assignments of signs, that are drawn: as many as a figure on a telephone has room for."""
    moved: int = 11
    """Parameters with a panel of their own in a time line: with that of all others a screen full."""
    histogram: int = 20
    """Bins: of the thousand draws that an ensemble keeps fifty a bin, which chance moves by 14 %."""
    doubts: int = 20
    """Ambiguous segments that a page lists: a screen full."""
    candidates: int = 25
    """Candidates that a page lists beside those that were added: a screen full."""
    assignments: int = 10
    """Other assignments of signs that a page lists: half a screen, as each is a long row."""
    spans: int = 5
    """Segments of another assignment that are linked: what fits into a cell."""
    well_known: float = 0.1
    """Relative standard deviation of a coefficient that is known well, as the terminal counts them."""
    soon: float = 0.05
    """s after which an alarm is not said to have come later."""


TUNING = Tuning()
