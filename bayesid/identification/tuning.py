"""Numbers that were chosen: when gains move, readings are tried and warnings are given, and what a run may need."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package, with what each is for; `TUNING` holds those in use.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation identification`). Where that was seen to
    change a decision on logs of UR10e and TIAGo, the number's sentence says so.
    """

    # The pipeline
    quick_budget: float = 3.0
    """Nominal seconds of a search of signs that an earlier log helps to settle."""
    samples_a_coefficient: int = 3
    """Samples in motion that a coefficient needs at least."""
    pointwise_blocks: int = 150
    """Blocks of each joint whose likelihood is kept by itself, for comparisons of models; weaker ones share one."""
    smoothed_draws: int = 24
    """Draws of a mode over which the samples' probabilities are averaged: their Monte Carlo error is at most 0.1."""
    smoothed_draws_light: int = 8
    """The same of a mode that has less than half of the mass: the error is at most 0.18 times its weight."""
    band_draws: int = 256
    """Draws, evenly spread, that a prediction's band rests on: the Monte Carlo error of its width is 4 %."""

    # Memory
    memory_at_least: float = 0.4e9
    """Bytes, whatever the log: what is loaded, and what is smoothed at once. As measured."""
    memory_a_value: float = 30.0
    """Bytes for each value of |effort| on the log's even grid, which is read and filtered joint by joint."""
    memory_a_kept_value: float = 800.0
    """Bytes more for each that is left when a long log has been thinned: columns of all terms, and what a fit makes of
    them. On a UR10e's logs: 0.6 GB in all for 100,000 rows, 1.0 GB for 360,000, 1.4 GB for 3,600,000."""
    kept_instants: int = 100_000
    """To about so many instants a long log is thinned."""
    memory_share: float = 0.8
    """Of the machine's memory that an identification may have unless another limit is asked for."""

    # Gains
    still_gains: float = 0.3
    """Posterior standard deviations by which gains may still want to move when they are left where they are."""
    unsettled_gains: float = 1.0
    """The same from which on they are said not to have settled: as much as their sd says they may be off."""
    gain_moves: int = 4
    """Times that gains move and signs are searched again; one or two are usual, each takes as long as an identification
    of its own."""
    left_beside_friction: float = 0.1
    """Share of what a log says of a gain that must be left beside load-dependent friction: as for a gain."""
    exact_gains_weight: float = 0.5
    """Weight of the exact gains from which on the factor common to all is theirs: a half."""

    # Other readings of a log
    suspicious: float = 0.1
    """Share of a joint's effort that a fit leaves from which on other readings are tried, and the report has a look: a
    model may well leave as much."""
    early_suspicious: float = 0.05
    """The same before the search, where a fit to some instants, with the signs that suit it best, leaves less."""
    clearly_better: float = 0.8
    """Share of the given reading's residual that a better one may leave at most. Under right files the best of all
    others leaves 0.95 and more on the logs of study `real`, but 0.85 of the LWR4's with its signs."""
    one_joint_better: float = 0.5
    """Share of a joint's residual that other units of one joint may leave at most, where the others keep theirs: what
    is wrong with one joint hardly shows in all."""
    instants: int = 600
    """Of the log, that readings are fitted to: some 3600 rows for 60 to 80 coefficients."""
    random_tables: int = 20
    """Drawn at random: of tables with such twists one in some ten comes near to an arm of the usual make."""
    longest_lag_share: int = 10
    """Of an excerpt's instants one in so many is the longest lag of a residual's autocorrelation."""
    reading_rounds: int = 12
    """In which signs and coefficients are made to agree; more change little."""
    reach: tuple[float, float] = (0.05, 20.0)
    """m, that an arm reaches; lengths of one that would reach less or more are in another unit."""
    early_instants: int = 300
    """Of the log, that readings are fitted to before the search: signs are found as from 600, in two thirds of the
    time."""
    drawn_robots: int = 6
    """Drawn at random, whose efforts are starts of the signs: of ten real logs, 6 lead to the signs that 20 do."""
    shares_of_friction: tuple[float, ...] = (0.0, 0.5, 1.5)
    """Of the rest of a drawn robot's effort: none, less and more."""
    most_sides: int = 10
    """Hidden joints of which all sides are compared, 1024 at most; of more, one joint after the other is turned."""
    kept_sides: int = 2
    """Of them that go on: some differ by noise alone, and feasibility tells."""
    hardly_feasible: float = 1.25
    """Times what least squares leave that feasible parameters may leave before other readings are tried."""
    early_fall: float = 0.8
    """Fall of the logarithms of what is left of each joint, summed, from which on another reading is named before the
    search. Under right files it is at most 0.4 on the logs of study `real`, and 0.7 on the LWR4's."""
    early_rise: float = 0.15
    """Rise of one joint's that a better reading may have: it explains all joints better, or as well."""
    feasibly_better: float = 0.6
    """Share of what feasible parameters leave by the given reading that one may leave at most which is no better but
    for what is feasible: less than `clearly_better`, as least squares do not bear it out."""
    sure_fall: float = 1.5
    """Fall from which on no search is made: well above `early_fall`, for a refusal must not be wrong."""
    hardly_related: float = 0.3
    """Share of the effort that is left from which on efforts are compared with those of another time."""
    related: float = 0.85
    """Share of what is left of efforts of another time that the log's own leave at most, in all joints together."""
    joint_related: float = 0.6
    """The same in one joint, where no other tells: the TIAGo's second leaves 0.15, and its last ones, of which its
    sensors show little, nearly all."""
    factor_known: float = 0.05
    """Logarithm to which the factor of a joint's efforts is found: N m per N mm is told from what is near."""
    another_size: float = 4.3
    """Logarithm of the factor, in the median of the joints, by which efforts are off those of an arm of its reach from
    which on that is said: it is at most 2.8 for ten real robots, and N mm are off by 6.9."""
    another_size_of_one: float = 5.0
    """The same of one joint beside the median: at most 4.4 for ten real robots."""
    surely_another_size: float = 6.0
    """The same from which on no search is made: four of its standard deviations; N mm are off by 6.9."""
    joints_compared: int = 4
    """Joints that a robot needs for one to be compared with the others."""
    size_sd: float = 1.5
    """Its standard deviation over these robots."""
    sure_nats: float = 13.8
    """Logarithm of the odds, 1e6, from which on no search is made."""
    finalists: int = 4
    """Readings that are compared with all joints together, of those that suit each joint best by itself."""

    # Payloads
    payload_false_alarm: float = 0.01
    """Largest rate at which a robot that carries nothing is said to carry something, where noise alone differs."""
    unstated_gains: float = 0.1
    """Relative standard deviation of the factor common to all torques of a log, where nobody has stated gains: those of
    a UR10e are 9 % too large."""
    payload_budget: float = 10.0
    """Nominal seconds of a payload's sampling: one of six joints has converged after some 5 s of two processors."""
    unchanged_false_alarm: float = 0.01
    """Largest rate at which any chi-square of what has changed is too large by chance, where covariances are right."""
    thin_body: float = 0.01
    """m, of the root mean square along an axis, below which bodies are not told apart: thinner than any workpiece."""

    # Warnings
    warnings_shown: int = 3
    """Warnings that a short text shows."""
    undershoot: float = 0.05
    """A filter after the rectifier makes |effort| reach below zero, by less than this share of its maximum."""
    posterior_conflict: float = 0.01
    """Share of a joint's effort from which on search and posterior contradict each other: as for modes."""
    other_mode: float = 0.01
    """Weight beyond which another mode of the posterior is spoken of: one in a hundred."""
    contradicts: float = 4.0
    """Standard deviations from which on a stated parameter contradicts the log: by chance once in 16,000 parameters."""
    dear_constraint: float = 6.9
    """Nats that a constraint costs from which on the log contradicts it: odds of 1000."""
    wide_factor: float = 0.5
    """Standard deviation of a logarithm from which on it is told as a factor: symmetric about no value any more."""
    solver_gap: float = 1e-8
    """Relative gap of the solver above which there is a warning: a hundred times what is tried first."""
    shown_doubt: float = 0.01
    """Doubt from which on a joint is named: less does not show in two digits."""


TUNING = Tuning()
