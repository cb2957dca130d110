"""Numeric choices of this package: gains, readings of a log, payloads, warnings, memory."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package; `TUNING` holds those in use.

    `python -m bayesid.studies.ablation identification` halves and doubles them.
    """

    # The pipeline
    quick_budget: float = 3.0
    """Nominal search time if an earlier log already determines most signs, s."""
    samples_per_coefficient: int = 3
    """Samples in motion per coefficient below which the log is refused."""
    pointwise_blocks: int = 150
    """Blocks of each joint whose likelihood is stored separately, for model comparison; weaker blocks share one."""
    smoothed_draws: int = 24
    """Draws of a mode over which sign probabilities are averaged: Monte Carlo error at most 0.1."""
    smoothed_draws_light: int = 8
    """The same for a mode of weight below one half: Monte Carlo error at most 0.18 times its weight."""
    band_draws: int = 256
    """Draws for a prediction's band: the Monte Carlo error of its width is 4 %."""

    # Memory
    memory_at_least: float = 0.4e9
    """Bytes, independent of the log, of libraries and of the smoothing of `signs.tuning.smoothed` samples; measured."""
    memory_per_value: float = 30.0
    """Bytes per value of |effort| on the log's even grid."""
    memory_per_kept_value: float = 800.0
    """Additional bytes per value that remains after thinning a long log: columns of all terms, and the fit. On a UR10e:
    0.6 GB in all for 100,000 rows, 1.0 GB for 360,000, 1.4 GB for 3,600,000."""
    kept_instants: int = 100_000
    """Approximate number of samples after thinning a long log."""
    memory_share: float = 0.8
    """Share of the machine's memory that an identification may use by default."""

    # Gains
    gain_step: float = 0.3
    """Change of the gains, in posterior standard deviations, above which signs are searched again."""
    gains_not_converged: float = 1.0
    """Remaining change of the gains, in posterior standard deviations, above which their intervals are wrong."""
    gain_moves: int = 4
    """Largest number of sign searches for changed gains; one or two are usual, each takes as long as an
    identification."""
    gain_beside_friction: float = 0.1
    """Least share of the information about a gain that remains if load-dependent friction is estimated too; equal to
    `decided_gain` of regression."""
    exact_gains_weight: float = 0.5
    """Weight of the exact gains in the common factor above which they decide it: more than all others."""

    # Other readings of a log
    suspicious: float = 0.1
    """Relative residual of a joint above which other readings are tried; models of real robots may leave as much."""
    early_suspicious: float = 0.05
    """The same before the search; half, as signs fitted to an excerpt leave a smaller residual."""
    clearly_better: float = 0.8
    """Largest ratio of a better reading's residual to the given one's. With right files the smallest ratio on the logs
    of study `real` is 0.95; 0.85 on the LWR4's with known signs."""
    better_in_one_joint: float = 0.5
    """The same in one joint, if other units of this joint alone are tried; they change the total residual little."""
    instants: int = 600
    """Samples that readings are fitted to: 3600 rows with six joints, for 60 to 80 coefficients."""
    random_tables: int = 20
    """Random robots tried; about one in ten resembles a usual arm."""
    longest_lag_share: int = 10
    """Samples of an excerpt per longest lag of a residual's autocorrelation."""
    reading_rounds: int = 12
    """Alternations of sign and coefficient fits; further ones change little."""
    reach: tuple[float, float] = (0.05, 20.0)
    """Plausible reach of an arm, m; outside, the robot's lengths have another unit."""
    early_instants: int = 300
    """Samples that readings are fitted to before the search; 600 samples give the same signs and take 1.5 times as
    long."""
    drawn_robots: int = 6
    """Random robots whose efforts start the sign fits; on ten real logs 6 give the same signs as 20."""
    shares_of_friction: tuple[float, ...] = (0.0, 0.5, 1.5)
    """Friction added to a random robot's effort, over the RMS effort. Chosen: none, less and more than the effort."""
    most_flipped: int = 10
    """Hidden joints up to which all combinations of flipped joints are compared, at most 1024; with more, joints are
    flipped one by one."""
    kept_flips: int = 2
    """Combinations that are kept; the residual of feasible parameters decides among them."""
    barely_feasible: float = 1.25
    """Ratio of the residuals of feasible parameters and of least squares above which other readings are tried."""
    early_fall: float = 0.8
    """Fall of the sum over joints of ln(relative residual) above which another reading is reported before the search.
    With right files it is at most 0.4 on the logs of study `real`, and 0.7 on the LWR4's."""
    early_rise: float = 0.15
    """Largest rise of ln(relative residual) of one joint for a better reading."""
    feasibly_better: float = 0.6
    """Largest ratio of feasible residuals for a reading that least squares do not prefer; below `clearly_better`, as
    there is less evidence."""
    sure_fall: float = 1.5
    """Fall above which the log is refused; twice `early_fall`, as a wrong refusal is worse than a wrong report."""
    weakly_related: float = 0.3
    """Relative residual above which the residual is compared with that of efforts shifted in time."""
    related: float = 0.85
    """Ratio of these residuals, over all joints, below which efforts depend on the motion."""
    joint_related: float = 0.6
    """The same for one joint. For joint 2 of the TIAGo the ratio is 0.15; for its last joints, with poor sensors,
    nearly 1."""
    factor_known: float = 0.05
    """Tolerance of ln(factor) of a joint's efforts within which the factor is that of a unit, such as 1000 for N mm."""
    another_size: float = 4.3
    """Median over joints of |ln(factor)| of the efforts, against an arm of this reach, above which their unit is
    reported as wrong: at most 2.8 on ten real robots, 6.9 for N mm."""
    another_size_of_one: float = 5.0
    """The same for one joint, against the median: at most 4.4 on ten real robots."""
    surely_another_size: float = 6.0
    """The same above which the log is refused: four times `size_sd`; 6.9 for N mm."""
    joints_compared: int = 4
    """Least number of joints of a robot whose joints are compared with each other."""
    size_sd: float = 1.5
    """Standard deviation of ln(factor) over the ten robots."""
    sure_nats: float = 13.8
    """Logarithm of the odds above which the log is refused: odds of 1e6."""
    finalists: int = 4
    """Number of best readings that are then fitted to all joints together."""

    # Payloads
    payload_false_alarm: float = 0.01
    """Probability that a robot without a payload is reported to carry one, by noise alone."""
    unstated_gains: float = 0.1
    """Relative standard deviation of the factor common to all torques of a log without stated gains. Torques of a UR10e
    are 9 % too large."""
    payload_budget: float = 10.0
    """Nominal sampling time of a payload's posterior, s: six joints converge after some 5 s on two cores."""
    unchanged_false_alarm: float = 0.01
    """Probability that any chi-square of `UnchangedCheck` exceeds its limit by chance, if covariances are right."""
    thin_body: float = 0.01
    """RMS size of a body along an axis below which sizes are not distinguished, m; thinner than any workpiece."""

    # Warnings
    warnings_shown: int = 3
    """Warnings shown in a short text."""
    undershoot: float = 0.05
    """Share of the largest |effort| by which a filter after the rectifier can make |effort| negative."""
    posterior_conflict: float = 0.01
    """Share of a joint's effort above which search and posterior disagree; as `other_mode`."""
    other_mode: float = 0.01
    """Weight above which another mode of the posterior is reported."""
    contradicts: float = 4.0
    """Standard deviations above which a stated parameter contradicts the log: once in 16,000 parameters by chance."""
    contradicted_constraint: float = 6.9
    """Cost of a constraint above which the log contradicts it, nats: odds of 1000."""
    wide_factor: float = 0.5
    """Standard deviation of a logarithm above which it is reported as a factor."""
    solver_gap: float = 1e-8
    """Relative gap of the solver above which there is a warning: 100 times the first tolerance."""
    shown_doubt: float = 0.01
    """Least probability with which a joint is named; smaller ones are zero in two digits."""
    min_samples: int = 200
    """Least number of samples in motion in at least one joint, of a payload's or a discrepancy's log."""


TUNING = Tuning()
