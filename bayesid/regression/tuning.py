"""Every number by which regression and selection decide, with its meaning and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Thresholds, counts, widths and budgets of this package and of `selection`.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation regression`). Where that was seen to
    change a decision on UR10e's log, the number's sentence says so.
    """

    # noise
    white_lag: float = 0.02
    """s; sensor noise is forgotten after this long, model error is not. Halved or doubled, UR10e's model gets other
    effects."""
    coloured_share: tuple[float, float] = (0.05, 0.98)
    """Least and largest share of the coloured part in a residual's variance, so that logarithms exist. Halved, samples
    of UR10e get other signs."""
    longest_lag: float = 0.5
    """s; beyond it a residual's correlation is not followed, and taken for the motion's. Halved, UR10e's model gets
    other effects."""
    sokal: float = 5.0
    """Autocorrelation times that the window of the integrated time spans: Sokal 1997, section 3, gives 4 to 10."""
    noise_replicates: int = 12
    """Draws of the noise that pass the fit at a time: sqrt(1 / 12) = 0.29 of one log's spread remains in their mean."""
    noise_iterations: int = 4
    """Of the indirect inference: `bayesid study calibration` was run with as many."""
    most_change: float = 3.0
    """Factor by which one such iteration may change a figure, up or down."""

    # least squares
    poor_fit: float = 0.25
    """A fit that leaves more than this share of a joint's effort is poor."""
    most_corrected: int = 30_000
    """Samples up to which the noise is corrected for what the fit took of it: time grows with them."""
    involved: float = 1e-3
    """Component in a direction without curvature from which on a coefficient is unexcited."""
    near_edge: float = 10.0
    """Margins of the solver at which a pseudo-inertia counts as on the edge of the feasible set."""

    # the cone's solver
    pull_reach: float = 100.0
    """Distance from typical links, in sizes, at which the Tikhonov term costs half a nat: far beyond any robot."""
    least_tikhonov: float = 1e-11
    """Least weight of the Tikhonov term as a share of the efforts' energy, for rounding: rho stays below 1e-8 of the
    energy up to 30 sizes away."""
    completing_tikhonov: float = 1e-9
    """The same where parameters without trace are asked for too: Clarabel resolves 1e-10."""
    most_pull: float = 1e-7
    """Largest weight as such a share, where efforts are so few or weak that nothing is decided."""
    inside_nearness: float = 1e-4
    """Weight of the distance to typical links, in sizes squared, where parameters move inside the cone."""
    inside_tolerance: float = 1e-6
    """Relative gap to which parameters are moved inside: no data depend on where they end."""
    feasibility_tolerances: tuple[float, ...] = (1e-8, 1e-7, 1e-6, 1e-5)
    """Of the check whether coefficients are feasible: tried one after the other until Clarabel reaches one."""
    undecided: float = 1e-9
    """Curvature of columns of unit length, relative to the largest, below which data decide nothing."""
    no_room: float = 1e-7
    """Depth, in sizes, up to which constraints leave no room: a hundred times the tolerance to which it is found."""
    ends_room: float = 1e-3
    """Share of the multipliers from which on a constraint is one of those that leave no room."""
    depth_nearness: float = 1e-7
    """Weight of the distance to typical parameters, in sizes squared, against a size of depth."""
    precise_tolerances: tuple[float, ...] = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
    """Tried one after the other where precision is asked for."""
    dual_rounds: int = 6
    """Of the improvement of multipliers where constraints cut the cone: beyond as many, the bound hardly rises
    (`bayesid study constraints`)."""

    # what is stated of parameters
    most_half_spaces: int = 200
    """Of one constraint: a hull of as many faces is finer than anybody knows a centre of mass."""
    pushes: float = 1e-6
    """Share of the largest multiplier from which on a constraint ends a fit: less is rounding."""
    longest_label: int = 90
    """Characters of a constraint as it was written, above which its number stands for it."""

    # drive gains
    decided_gain: float = 0.1
    """Share of the prior's variance that data leave at most where they decide a gain (docs/posterior.md, section 3)."""
    lost_gain: float = 1.0
    """Sd of the logarithm of an unknown gain about what the robot's masses make likely: a factor of 2.7."""
    lost_gains_together: float = 1.3
    """Sd of the logarithm of the factor common to unknown gains: 3.7; arms of one reach differ as much in mass."""
    arm_mass: float = 40.0
    """kg m^-2: mass of an arm over the square of its stretched length; data sheets: 10 (UR10e) to 133 (TX40)."""
    taper: float = 0.6
    """Mass of a link over that of the one before it."""
    gain_reach: float = 0.25
    """Scale of distances over the stretched arm, as in `bayesid.posterior.target`."""
    gains_converged: float = 1e-3
    """Newton decrement, nats, at which the gains' minimum counts as reached: 3 % of a standard deviation."""

    # beliefs
    typical_mass: float = 0.3
    """Mass of the typical link over the scale of masses. Set by hand, as the two below (study `prior`)."""
    typical_spread: float = 0.25
    """Rms distance of its mass along each axis over the scale of distances."""
    widest_radius: float = 3.75
    """Largest radius of gyration about the frame over the scale of distances."""
    total_masses: tuple[float, float] = (0.01, 30.0)
    """Least and largest mass of all bodies over the scale of a link's: no arm of some ten links comes near."""

    # nuisance
    faint: float = 1e-3
    """D below which a direction changes nothing: the spread grows by D^2 / 2."""
    long_log: int = 20_000
    """Samples from which on directions are kept in single precision."""

    # error models
    error_shares: tuple[float, ...] = (1e-4, 0.01, 0.03, 0.1, 0.25, 0.5, 0.7, 0.85, 0.93, 0.97, 0.99, 0.998)
    """Of the coloured part in the variance, a coarse grid from which the fit starts."""
    error_times: tuple[float, ...] = (0.006, 0.01, 0.02, 0.035, 0.06, 0.11, 0.2, 0.4, 0.8, 1.6, 3.0)
    """s, the grid of correlation times: a factor of about 2 from one to the next."""
    error_lags: int = 1_000
    """Of the sample autocovariances that the grid is judged by."""
    shortest_time: float = 0.005
    """s; a shorter correlation is white at usual rates."""
    longest_time: float = 3.0
    """s; a longer correlation is a constant."""
    error_logits: tuple[float, float] = (-12.0, 7.0)
    """Least and largest logarithm of the shares' ratio: shares of 6e-6 to 0.999."""
    error_resolution: float = 0.02
    """Of the lattice of that logarithm and of the time's: below the sampling error of a thousand samples."""
    error_steps: int = 20
    """Of the local search, at most; it takes some three."""
    error_enough: float = 1e-3
    """Nats that the next step promises, below which the search ends."""
    error_damping: float = 1e-2
    """Share of the curvature that is added to it after a step that has overshot; ten times as much after each more."""
    grid_error: float = 0.005
    """Share of the sum of squares by which the grid may be off: it sees what is bridged as well. Set by hand."""
    limited_evaluations: int = 40
    """Of the search for an error model within limits."""
    limited_step: float = 0.5
    """First step of that search."""
    unseen_size: float = 1e-3
    """Change of an error's size that weighs samples as before: below its sampling error of some 1e-2."""
    whitened_at_once: int = 100_000
    """Numbers of columns that are whitened together: 1 MB, which a processor's cache holds."""
    kept_bytes: int = 128_000_000
    """Of whitened columns that are kept; what was asked for longest ago goes."""

    # scores
    usual_effort: float = 0.3
    """Prior sd of an effect's largest effort as a share of the joint's RMS effort. Halved, UR10e's model gets other
    effects."""
    sharper_turn: float = 4.0
    """Factor by which friction turns round faster where it turns at once: a shorter turn shows no more."""
    settlings: int = 2
    """Times that an explanation is found again with the error models it has left."""
    initial_coloured: float = 0.05
    """Coloured part over the white one in the error model to begin with; it weighs the first fit alone."""
    initial_time: float = 0.1
    """s, its correlation time."""
    proposed_sets: tuple[int, int, int] = (3, 5, 4)
    """Sets of one, two and three effects of a joint that are proposed."""
    set_beam: int = 24
    """Sets of different effects that larger ones are made of."""
    forms_in_sets: int = 12
    """Forms of one effect that take part in sets: half the best by themselves, half spread over the grid."""
    forms_at_once: int = 16
    """Forms that are multiplied together where each is scored alone."""
    sets_at_once: int = 4096
    """Sets whose products are in memory at once."""
    number_evaluations: int = 12
    """In the search for a nonlinear number: golden sections narrow its bracket to a hundredth or better."""
    noticed: float = 0.01
    """Nats by which another number must be likelier to be taken: less is the search's resolution."""
    relinearisations: int = 3
    """Of distortions about their own numbers: Newton's method, whose error falls with the square each time."""
    still: float = 1e-4
    """Of an amplitude's prior sd, up to which a number does not move."""

    # forward selection
    blocks: int = 16
    """Equal stretches of a log that are held back: they give a standard error to 18 %. Halved or doubled, UR10e's model
    gets other effects."""
    folds: int = 4
    """Groups of them, each with data from all of the log. Halved or doubled, UR10e's model gets other effects."""
    shortest_block: float = 1.0
    """s, that a block lasts at least: halves of 10 s of Panda's log (study `complete`). Doubled, UR10e's model gets
    other effects."""
    harm: float = 0.04
    """Share of a joint's mean squared error by which it may rise in any case, 2 % of the error."""
    help: float = 0.1
    """Share of the joints' mean squared errors, added up, by which an effect lowers them at least."""
    sure: float = 1.5
    """Standard errors over the blocks by which it does: two keep effects out of half of TX40's log that hold in the
    other half, one lets effects enter that do not."""
    sets_predicted_at_once: int = 16
    """Candidates at most whose predictions of held-back blocks are made together."""
    needed: float = 12.0
    """Nats by which an effect enters: e^-12 times some 150 places a log leave 1e-3 false ones, even if the noise model
    is off by a factor of two in nats (DESIGN.md 4)."""
    most_effects: int = 16
    """That are added; a bound against endless loops."""
    significant: float = 3.0
    """Standard deviations that one number of an effect must be from zero under the final fit: one in 370 by chance."""
    short_list: int = 60
    """Effects that are looked at again after the first look, in their best form."""
    thinned_samples: int = 2_500
    """Samples on which effects are selected, thinned evenly: time grows with them. Halved, UR10e's model gets other
    effects."""
    slowest_rate: float = 25.0
    """Hz; a log is not thinned below it, as friction turns round within 0.1 s: of longer ones stretches are taken."""
    stretches: int = 8
    """Of a log that is too long."""
    moved_effort: float = 0.1
    """Share of a joint's effort by which the model's changes before distortions are linearised anew."""

    # unseen effects
    relevance_rounds: int = 60
    """Of the scales' fixed point; it has settled to a few per cent by then."""
    relevance_start: float = 0.3
    """Of s, in units of what was believed before: the fixed point leaves large values slowly."""
    absent: float = 0.5
    """h: half an observation of nothing, as of Jeffreys's prior of a variance."""
    own_share: float = 1e-2
    """Share of a direction's square that the model's columns must not explain."""
    gone: float = 1e-3
    """Of s, below which a group is left out."""
    moved_coefficient: float = 2.0
    """Standard deviations, half an interval of 95 %, by which an effect moves a coefficient."""
    far_off: float = 2.0
    """Times the tolerance from which on the geometry is not what it was believed to be."""

    # learned functions
    lengths: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8)
    """Of the kernel, as shares of the range seen."""
    sizes: tuple[float, ...] = (0.02, 0.06, 0.2, 0.6)
    """Prior sd of a function as a share of the joint's RMS effort."""
    cosines_screened: int = 6
    """Of a variable while pairs are screened. Set by hand."""
    cosines_coarse: int = 8
    """In the forms that are tried then."""
    cosines_fine: int = 14
    """In the finest of them: they resolve a kernel of a tenth of the range."""
    variables_tried: int = 10
    """Sets of variables whose forms are all tried at first."""
    variables_tried_again: int = 4
    """The same by what a function has left."""
    variables_looked_at: int = 6
    """Sets of variables that get error models of their own."""
    harmonics: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    """Of a turn of a joint, tried by themselves; the first three with their multiples too."""
    fadings: tuple[float, ...] = (0.2, 0.5, 1.2)
    """Time constants tried, as shares of the log's length."""
    fastest_oscillation: float = 0.125
    """Highest frequency over time that is tried, as a share of the sampling rate."""
    oscillations_apart: float = 0.5
    """Distance of frequencies, in half turns over the whole log."""
    oscillations_refined: int = 10
    """Times as close are frequencies about the best."""
    numbers_at_once: int = 4_000_000
    """Of columns that are in memory at once."""
    changes: float = 1e-3
    """Range of a variable, rad, rad/s, rad/s^2, N m or s, below which it does not change."""
    law_columns: int = 4
    """Columns up to which a form is a law, such as the product of two sines: its amplitudes stay free in the model."""


TUNING = Tuning()
