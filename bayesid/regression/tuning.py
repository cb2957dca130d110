"""Constants of regression and effect selection: meaning, unit, and where each was measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Thresholds, counts, widths and budgets of this package and of `selection`.

    "Ablation" means `python -m bayesid.studies.ablation regression`: each value was halved and doubled on a UR10e log.
    A field mentions it only if the detected effects or the signs changed.
    """

    # noise
    white_lag: float = 0.02
    """Lag, s, above which sensor noise is uncorrelated; model error lasts longer. Ablation: changes the effects."""
    coloured_share: tuple[float, float] = (0.05, 0.98)
    """Least and largest share of the coloured part in a residual's variance; both logarithms stay finite. Ablation:
    halving changes signs."""
    longest_lag: float = 0.5
    """Longest lag, s, of the residual's autocorrelation; slower parts count as motion. Ablation: halving changes
    effects."""
    sokal: float = 5.0
    """Window for the integrated autocorrelation time, in autocorrelation times; Sokal (1997, section 3): 4 to 10."""
    noise_replicates: int = 12
    """Noise draws that are refitted together; their mean has sqrt(1 / 12) = 0.29 of the standard deviation of one
    draw."""
    noise_iterations: int = 4
    """Iterations of the indirect inference, as in `bayesid study calibration`."""
    most_change: float = 3.0
    """Largest factor by which one such iteration changes a figure, up or down; it damps the first steps."""

    # least squares
    poor_fit: float = 0.25
    """Relative residual of a joint above which its fit is called poor."""
    most_corrected: int = 30_000
    """Largest number of samples for which the noise is corrected for the fit's degrees of freedom; limits the time."""
    not_excited: float = 1e-3
    """Component of a coefficient in directions without information above which it counts as not excited."""
    near_edge: float = 10.0
    """A pseudo-inertia is on the edge if its smallest eigenvalue is below this many solver margins."""

    # the cone's solver
    pull_reach: float = 100.0
    """Distance of a parameter from the typical link, in sizes, at which the Tikhonov term costs 0.5 nat; no real link
    is that far."""
    least_tikhonov: float = 1e-11
    """Least weight of the Tikhonov term over the efforts' energy. rho stays below 1e-8 of the energy up to 30 sizes."""
    completing_tikhonov: float = 1e-9
    """The same weight where parameters without effect are needed too; Clarabel resolves 1e-10."""
    most_pull: float = 1e-7
    """Largest weight over the energy; it is reached if the efforts determine no parameter."""
    interior_nearness: float = 1e-4
    """Weight of the squared distance to typical links, in sizes, when parameters are moved inside the cone."""
    interior_tolerance: float = 1e-6
    """Relative gap when parameters are moved inside the cone; predictions do not depend on the exact point."""
    feasibility_tolerances: tuple[float, ...] = (1e-8, 1e-7, 1e-6, 1e-5)
    """Tolerances of the feasibility check, tried in this order until Clarabel reaches one."""
    undecided: float = 1e-9
    """Least curvature of columns of unit length, relative to the largest, that determines a direction."""
    least_depth: float = 1e-7
    """Least depth, in sizes, of a feasible set with interior: 100 times the solver's tolerance."""
    contradicting_share: float = 1e-3
    """Share of the multipliers above which a constraint belongs to a contradiction."""
    depth_nearness: float = 1e-7
    """Weight of the squared distance to typical parameters, in sizes, against a depth of one size."""
    precise_tolerances: tuple[float, ...] = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
    """Tolerances of precise solves, tried in this order until Clarabel reaches one."""
    finest_of_stated: float = 1e-9
    """Relative gap requested of the solver when constraints cut the cone; the usual gap suffices if rounding ends it.
    Where only the Tikhonov term determines parameters, errors of the multipliers have a large effect on the lower bound
    (`bayesid study constraints`)."""

    # what is stated of parameters
    most_half_spaces: int = 200
    """Largest number of half spaces of one constraint; no centre of mass is known finer than a hull of 200 faces."""
    active_multiplier: float = 1e-6
    """Share of the largest multiplier below which a multiplier is rounding error, so its constraint is inactive."""
    longest_label: int = 90
    """Longest label, characters; a longer constraint is called by its number."""

    # drive gains
    decided_gain: float = 0.1
    """Largest posterior over prior variance of a gain that counts as decided by the data (docs/posterior.md, section
    3)."""
    unknown_gain: float = 1.0
    """Prior sd of the logarithm of an unknown gain about the value that the robot's size suggests: a factor of 2.7."""
    unknown_gains_together: float = 1.3
    """Prior sd of the logarithm of the factor common to unknown gains: 3.7, the spread of mass among arms of one
    reach."""
    arm_mass: float = 40.0
    """Mass of an arm over its squared stretched length, kg m^-2; data sheets give 10 (UR10e) to 133 (TX40)."""
    taper: float = 0.6
    """Mass of a link over the mass of the link before it."""
    gain_reach: float = 0.25
    """Scale of distances over the stretched length, as in `bayesid.posterior.target`."""
    gains_converged: float = 1e-3
    """Newton decrement, nats, at which the gains have converged: 3 % of a standard deviation."""

    # prior of links
    typical_mass: float = 0.3
    """Mass of the typical link over the scale of masses. Chosen with the next two; study `prior` varies the scale."""
    typical_spread: float = 0.25
    """RMS distance of the typical link's mass along each axis over the scale of distances."""
    widest_radius: float = 3.75
    """Largest radius of gyration about a link's frame over the scale of distances."""
    total_masses: tuple[float, float] = (0.01, 30.0)
    """Least and largest mass of all bodies over the scale of a link's mass; real arms are far from both."""

    # unmodelled effects that are marginalised
    negligible_spread: float = 1e-3
    """D (:eq:`nuisance-root`) below which a direction is dropped: its variance grows by a factor of 1 + D^2 only."""
    long_log: int = 20_000
    """Number of samples from which directions are stored in single precision."""

    # error models
    error_shares: tuple[float, ...] = (1e-4, 0.01, 0.03, 0.1, 0.25, 0.5, 0.7, 0.85, 0.93, 0.97, 0.99, 0.998)
    """Share of the coloured part in the variance: the coarse grid from which the fit starts."""
    error_times: tuple[float, ...] = (0.006, 0.01, 0.02, 0.035, 0.06, 0.11, 0.2, 0.4, 0.8, 1.6, 3.0)
    """Correlation times, s, of that grid, with a ratio of about 2."""
    error_lags: int = 1_000
    """Lags of the sample autocovariance with which the grid is compared."""
    shortest_time: float = 0.005
    """Shortest correlation time, s; a shorter one is white at usual rates."""
    longest_time: float = 3.0
    """Longest correlation time, s; a longer one acts as a constant."""
    error_logits: tuple[float, float] = (-12.0, 7.0)
    """Least and largest logit of the share: shares of 6e-6 to 0.999."""
    error_resolution: float = 0.02
    """Resolution of that logit and of the logarithm of the time; the sampling error of 1000 samples is larger."""
    error_steps: int = 20
    """Largest number of local search steps; about three are needed."""
    error_enough: float = 1e-3
    """Expected gain of the next step, nats, below which the search ends."""
    error_damping: float = 1e-2
    """Share of the curvature added after a step that raised the cost; each further failure multiplies it by 10."""
    grid_error: float = 0.005
    """Assumed relative error of the grid's sum of squares, which includes interpolated samples: minima within it are
    refined. Chosen; not measured."""
    limited_evaluations: int = 40
    """Evaluations of the bounded search for an error model."""
    limited_step: float = 0.5
    """First step of that search."""
    equal_size: float = 1e-3
    """Relative difference of two errors' sizes below which they are equal; their sampling error is about 1e-2."""
    whitened_at_once: int = 100_000
    """Column entries that are whitened together: 1 MB, the size of a processor's cache."""
    kept_bytes: int = 128_000_000
    """Memory of stored whitened columns, bytes; the least recently used are dropped."""

    # scores
    usual_effort: float = 0.3
    """Prior sd of an effect's largest effort over the joint's RMS effort. Ablation: halving changes the effects."""
    sharper_turn: float = 4.0
    """Slope of a sharp friction reversal over that of the model's tanh; a steeper one has the same effect in a log."""
    refits: int = 2
    """Largest number of fits of the effects, each with the error models of the fit before."""
    initial_coloured: float = 0.05
    """Ratio of coloured to white part in the first error model; it weights the first fit only."""
    initial_time: float = 0.1
    """Correlation time, s, of the first error model."""
    proposed_sets: tuple[int, int, int] = (3, 5, 4)
    """Proposed sets of one, two and three effects of a joint."""
    set_beam: int = 24
    """Sets of different effects that are extended to larger sets."""
    forms_in_sets: int = 12
    """Forms of one effect that enter sets: half the best single ones, half spread over the grid."""
    forms_at_once: int = 16
    """Forms that are scored in one product; limits the memory."""
    sets_at_once: int = 4096
    """Sets that are scored in one product; limits the memory."""
    number_evaluations: int = 12
    """Evaluations of the search for a nonlinear number: golden sections narrow its bracket to 1 % or better."""
    number_gain: float = 0.01
    """Gain, nats, below which a nonlinear number keeps its value: the resolution of the search."""
    relinearisations: int = 3
    """Linearisations of distortions about their own numbers: Newton's method, with quadratic convergence."""
    unchanged: float = 1e-4
    """Change of an amplitude, in prior sd, below which it counts as unchanged."""

    # forward selection
    blocks: int = 16
    """Equal stretches of a log for cross-validation; they give a standard error to 18 %. Ablation: changes the
    effects."""
    folds: int = 4
    """Folds of these blocks, each spread over the whole log. Ablation: changes the effects."""
    shortest_block: float = 1.0
    """Shortest block, s; so that 5 s of the Panda log have enough blocks (study `complete`). Ablation: doubling changes
    the effects."""
    harm: float = 0.04
    """Largest tolerated rise of a joint's mean squared error, relative: 2 % of the RMS error."""
    help: float = 0.1
    """Least drop of the sum of the joints' relative mean squared errors that an effect must reach."""
    sure: float = 1.5
    """The same drop in standard errors over the blocks. With 2, effects found in one half of the TX40 log are missed in
    the other half; with 1, false effects are added."""
    sets_predicted_at_once: int = 16
    """Largest number of candidates whose predictions of held-out blocks are computed together."""
    needed: float = 12.0
    """Nats that an effect must gain: 150 candidates per log times e^-12 are 1e-3 false ones; with a noise model that
    doubles the nats, 150 e^-6 = 0.4."""
    most_effects: int = 16
    """Largest number of added effects; ends a loop that does not converge."""
    significant: float = 3.0
    """Standard deviations from zero that one number of an effect must have in the final fit: 1 in 370 by chance."""
    short_list: int = 60
    """Number of effects that are scored a second time, each in its best form."""
    thinned_samples: int = 2_500
    """Samples on which effects are selected, thinned evenly; trades time. Ablation: halving changes the effects."""
    slowest_rate: float = 25.0
    """Least rate, Hz, of a thinned log, as friction reverses within 0.1 s; longer logs are cut into stretches."""
    stretches: int = 8
    """Number of stretches of a log that is too long."""
    moved_effort: float = 0.1
    """Change of the model's effort, over a joint's effort, above which distortions are linearised again."""

    # effects that cannot be excluded
    relevance_rounds: int = 60
    """Iterations of the fixed point of the scales; the scales are then accurate to a few per cent."""
    relevance_start: float = 0.3
    """First value of s in units of its prior; the fixed point converges slowly from large values."""
    absent: float = 0.5
    """h in :eq:`relevance`, a prior count of observations of zero; one half is Jeffreys's prior of a variance."""
    own_share: float = 1e-2
    """Least share of a direction's squared length outside the span of the model's columns."""
    dropped_scale: float = 1e-3
    """Value of s below which a group is dropped."""
    moved_coefficient: float = 2.0
    """Shift of a coefficient by an effect that is reported, in standard deviations: half of a 95 % interval."""
    far_off: float = 2.0
    """Multiple of the stated tolerance above which the geometry contradicts it."""

    # learned functions
    lengths: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8)
    """Length scales of the kernel over the observed range."""
    sizes: tuple[float, ...] = (0.02, 0.06, 0.2, 0.6)
    """Prior sd of a function over the joint's RMS effort."""
    cosines_screened: int = 6
    """Cosines per variable while pairs of variables are screened. Chosen; not measured."""
    cosines_coarse: int = 8
    """Cosines of the coarse forms of the screened variables."""
    cosines_fine: int = 14
    """Cosines of the finest form: they resolve a kernel of a tenth of the range."""
    variables_tried: int = 10
    """Sets of variables of which all forms are tried first."""
    variables_tried_again: int = 4
    """The same number for the residual of the first function."""
    variables_rescored: int = 6
    """Sets of variables that get their own error models."""
    harmonics: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    """Harmonics of a joint's revolution, each tried alone; the first three also with their multiples."""
    fadings: tuple[float, ...] = (0.2, 0.5, 1.2)
    """Time constants that are tried, over the log's length."""
    fastest_oscillation: float = 0.125
    """Highest frequency over time that is tried, over the sampling rate."""
    oscillations_apart: float = 0.5
    """Distance of the frequencies on the grid, in half turns over the whole log."""
    oscillations_refined: int = 10
    """Factor by which the grid about the best frequency is finer."""
    numbers_at_once: int = 4_000_000
    """Entries of columns that are in memory together."""
    changes: float = 1e-3
    """Range of a variable (rad, rad/s, rad/s^2, N m or s) below which it counts as constant."""
    law_columns: int = 4
    """Largest number of columns of a form that enters the model with free amplitudes, such as a product of two
    sines; smooth functions enter with a fixed shape."""

    # Discrepancy of a log from a model; measured on the blind cases of `bayesid study discrepancy`
    above_floor: float = 1.25
    """Residual over the noise floor above which a joint is unexplained."""
    above_unreliable_floor: float = 1.6
    """The same over an incomplete floor, which lacks slow noise; lower values report real friction as unexplained."""
    at_unreliable_floor: float = 1.15
    """Residual over an incomplete floor below which only standard effects are searched."""
    improvement_of_rest: float = 0.1
    """Least relative fall of a joint's mean squared residual, in addition to `Thresholds.improvement`."""
    testable: float = 2.0
    """Expected log10 of the Bayes factor of an effect of usual amplitude above which it is testable."""
    rescored: int = 10
    """Effects that get their own error models when all are scored; trades time."""


TUNING = Tuning()
