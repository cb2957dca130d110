"""Constants of sign search, smoothing and model selection."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Constants of this package; `TUNING` holds those in use.

    Those of the certified search change its time and how much it proves, but never make a proof wrong: assignments that
    were not compared count as not excluded. They were chosen on the logs of `studies.real` and on simulated ones;
    `python -m bayesid.studies.benchmarks.search` shows seconds and certificates.

    "Ablation" means `python -m bayesid.studies.ablation signs`: each value was halved and doubled on logs of UR10e,
    KR300 and TIAGo. A field mentions it only if a decision changed.
    """

    # Budgets: nominal seconds on one core; they change a result only if a budget ends a search
    seconds_per_step: float = 4.5e-4
    """Nominal seconds of one step of a loop."""
    seconds_per_choice: float = 5e-9
    """Nominal seconds per sign choice and coefficient."""
    seconds_per_solve: float = 1e-6
    """Nominal seconds of a cone problem, over the squared number P of parameters."""
    seconds_per_pair: float = 3e-8
    """Nominal seconds per pair of segments that may flip."""
    budget_afterwards: float = 0.2
    """Share of a budget that is added once for all searches after it is spent, such as those under another model."""

    # Any search
    alike: float = 0.1
    """Cost difference (twice the nats) below which two assignments are equivalent: odds of 1.05."""
    near: float = 40.0
    """Cost above the best one up to which assignments are listed without a proof: 20 nats."""
    strong: float = 0.1
    """Share of the energy of a joint's strongest segment above which a branch without a proof decides a segment."""
    wider_beam: int = 4
    """Factor on the beam width in a second try, after a first beam with a poor fit."""
    most_initial: int = 12
    """Largest number of segments that a beam enumerates at the start: 2^12 nodes."""

    # Local search
    temperatures: tuple[float, ...] = (30.0, 100.0, 300.0)
    """Temperatures T of the draws, in turn. Chosen on two real logs; T = 1000 rarely finds the best assignment."""
    failures: int = 98
    """Starts without improvement after which a local search ends. By Laplace's rule of succession the next one improves
    with a probability of 1 / (98 + 2) = 1 %."""
    failures_on_the_way: int = 20
    """The same in a round with a poor fit, from signs of another model, and after the fallback; saves time."""
    most_starts: int = 2
    """Largest number of starts over `failures`."""
    local_starts: int = 8
    """Listed assignments from which a local search starts."""

    # Certified search
    proof_share: float = 0.4
    """Share of the budget for a proof. On the logs of `studies.real_floor`, successful proofs need at most 0.35 of the
    default budget."""
    fallback_share: float = 0.2
    """Largest share of the budget for the fallback; a local search has run before."""
    least_cost_share: float = 1.0 / 3.0
    """Share of the proof's budget for the joints' least costs; without them the proof ends, with a lower bound of
    zero."""
    hidden_by_tikhonov: float = 3.0
    """Largest difference of cost and data cost of an assignment, over its Tikhonov term (`certified`)."""
    allowance: float = 10.0
    """A proof's first Delta minus -2 ln(missed mass): room for the mass of many assignments."""
    growth: float = 2.0
    """Cost added to Delta, beside the missing part, when a proof is repeated with a larger Delta."""
    candidate_patterns: int = 64
    """Patterns of each joint among the candidates."""
    candidate_combinations: int = 256
    """Combinations of all joints that the search for candidates keeps."""
    candidate_share: float = 0.02
    """Share of the energy of a joint's strongest segment above which candidates decide a segment."""
    candidates_solved: int = 64
    """Largest number of candidates that are solved in the cone."""
    candidates_optimised: int = 3
    """Number of these from which signs and parameters are alternated to a local optimum."""
    flipped: int = 20
    """Largest number of trials in which one segment of the best candidate is flipped."""
    alternations: int = 20
    """Largest number of alternations of signs and parameters; they usually converge sooner."""
    shares: tuple[float, ...] = (0.7, 0.4, 0.2, 0.1)
    """Shares of the energy of a joint's strongest segment above which its segments are decided, from coarse to fine."""
    longest_list: int = 20_000
    """Longest list of a joint's patterns; if more patterns remain, the list decides fewer segments."""
    few_combinations: int = 2_500
    """Number of combinations up to which the finest lists are joined at once."""
    most_combinations: int = 50_000
    """Largest number of combinations in memory while lists are joined."""
    least_width: int = 64
    """Width of the beam that gives the limit for a joint's least cost."""
    listed: int = 300
    """Largest number of a joint's segments that patterns decide; limits time and memory."""
    least_group: int = 500
    """Segments of a joint whose least cost is bounded together; limits time and memory."""
    least_list: int = 2_000
    """Longest list of patterns for a lower bound of the least cost."""
    enumerated: int = 14
    """Number of segments without persistency up to which all sets of flips are compared (2^14)."""
    many_flips: int = 8_000
    """Number of segments above which the sums of K_kl are bounded by Cauchy-Schwarz, without pairs."""
    charged_flips: int = 400
    """Number of segments up to which the gains of pairs are shifted between them (roof duality)."""
    sweeps: int = 4
    """Sweeps of this shifting."""
    rows_at_once: int = 1_000
    """Rows of K that are computed together; limits the memory."""
    pairs_at_once: int = 50_000
    """Pairs of patterns that are priced together when two lists are joined; limits the memory."""
    undecided_tikhonov: float = 1e-4
    """Share of the Tikhonov term in the bounds of undecided rows: enough for their conditioning, negligible for the
    decided ones. Any share keeps the bounds valid."""
    lighter_tikhonov: float = 1e-2
    """Factor on the Tikhonov term for costs of the data alone; with a smaller one rounding makes bounds useless."""

    # Rounds of search
    first_noise: float = 0.05
    """Noise of each joint before any fit, over its RMS effort; the paper's experiment has the same."""
    least_noise: float = 1e-3
    """Least noise of a fit, over the RMS effort."""
    clear_crossing: float = 2.0
    """Predicted effort on both sides of a clear zero crossing, in residual sd; 1 of 20 samples exceeds it by chance."""
    search_rounds: int = 4
    """Largest number of searches of a log; segments that still cross zero after them are reported."""
    most_individual: int = 5_000
    """Segments of each joint with their own H_k; about 6 kB each (docs/certified-search.md)."""
    most_repriced: int = 32
    """Listed assignments, cheapest first, whose cost is computed with other noise weights."""
    different_signs: float = 0.01
    """Share of a joint's energy by which two listed assignments differ; smoothing covers smaller differences."""
    most_alternatives: int = 6
    """Largest number of alternatives."""

    # Smoothing and filtering: the model's error b, and the samples in memory (about 50 MB)
    grid: int = 101
    """Grid values of b; with `grid_reach` a spacing of 0.08 standard deviations, finer than the transitions."""
    grid_reach: float = 4.0
    """Half-width of the grid, in standard deviations of b."""
    finest_step: float = 0.75
    """Least sd of a step of b, in spacings of the grid; a narrower transition falls between its points. Ablation:
    halving changes signs of UR10e and KR300."""
    finest_noise: float = 1e-6
    """Least white noise over the grid's half-width, for joints without efforts; the resolution of single precision."""
    rest_time: float = 0.5
    """Time constant of static friction, s. Ablation: signs of UR10e and KR300 change."""
    turns_at_rest: float = 0.5
    """Probability that friction reverses within a standstill; one half, as the log does not show it."""
    middle: float = 8.0
    """Half-width of the grid's middle, in standard deviations of b in motion; b is outside with probability 1e-15."""
    middle_margin: int = 2
    """Margin of the middle, in spacings of the grid."""
    outside_share: float = 1e-6
    """Share of a distribution at or beyond the ends of the middle above which the whole grid is used."""
    window_end: int = 2
    """Values at either end of the middle that count as its end."""
    smoothed: int = 10_000
    """Samples that are smoothed together."""
    overlap: int = 1_000
    """Overlap of these stretches, samples: many correlation times of the model's error."""
    piece: int = 24
    """Samples of a piece; pieces run in parallel."""
    side_by_side: int = 24_000
    """Samples times draws that are smoothed in one call; if one draw has more samples, joints run in parallel."""
    fastest_filter: float = 125.0
    """Largest rate of a filter's steps of b, Hz; at higher sampling rates b is constant between them."""

    # A low-pass after the rectifier
    crossing_reach: float = 0.06
    """Time before and after a zero crossing that is compared, s. The best of 0.06, 0.08 and 0.12 on filtered real and
    simulated logs."""
    low_pass_rest: float = 0.4
    """Additional time before and after it, s, after which a low-pass has forgotten its initial state."""
    most_crossings: int = 240
    """Largest number of crossings, evenly spread over log and joints; the result needs far fewer."""
    low_pass_false_alarm: float = 0.05
    """Bound on the probability of a false low-pass; a normal approximation of the sum gives 0.007 at this bound. With
    0.01 a low-pass of 8 Hz in a Panda log is missed."""
    lowest_cutoff: float = 1.4
    """Lowest cut-off that is tried, Hz; little motion passes below it."""
    half_octaves: int = 9
    """Number of cut-offs, half an octave apart; the highest, 22 Hz, changes only one or two samples."""
    cutoff_of_nyquist: float = 0.5
    """Largest cut-off over half the rate; above it, resampling alone acts as a low-pass."""
    low_pass_shapes: tuple[tuple[int, bool], ...] = ((1, False), (2, False), (1, True), (2, True))
    """Order, and whether it has no delay: an RC element, a common low-pass, and both run forwards and backwards."""
    crossing_bias: float = 4.0
    """Largest model error at a crossing, in standard deviations of the residual."""
    crossing_biases: int = 41
    """Number of model errors that are tried at each crossing."""
    longest_lag: float = 0.5
    """Longest lag of the residual's autocorrelation, s; slower parts count as motion (`bayesid.regression.noise`)."""
    error_memories: tuple[float, ...] = (0.05, 0.1, 0.2, 0.5, 2.0)
    """Correlation times of the model's error that are tried, s."""
    least_noise_taken: float = 1.0
    """Least variance that a low-pass removed over the residual's variance; slow noise resembles noise that passed.
    Of 0.1 and 1 the value with fewer wrong signs on eight filtered logs."""
    low_pass_fits: int = 3
    """Fits after a low-pass was found, each with the signs of the fit before."""

    # Other models, and lower confidence if none fits
    coloured_ratio: float = 0.5
    """Ratio of a residual's coloured to its white noise above which another model is tried."""
    largest_weight: float = 0.95
    """Largest weight of a model; the other model has at least 0.05, as neither is exact."""
    tolerated_error: float = 0.3
    """Relative model error up to which proven signs keep their confidence (study `misfit`)."""
    tolerated_error_unproven: float = 0.1
    """The same without a proof (study `misfit`)."""
    error_of_a_guess: float = 0.7
    """Additional error at which a sign is arbitrary with a probability of one half (study `misfit`)."""
    shared_error: float = 0.6
    """Share of the worst joint's model error that counts for all joints, as they share parameters (study `misfit`)."""
    joints_in_all_sets: int = 7
    """Number of joints up to which all 127 sets are flipped; for more: one, two, all but one, or all joints."""
    outlier: float = 6.0
    """Residual of an outlier, in sd. Chosen; with 4, signs at friction reversals lose confidence too."""

    # Model selection
    completion_rounds: int = 3
    """Largest number of selections; each uses the signs under the model before."""
    signs_changed: float = 1e-2
    """Share of the samples in motion whose sign must change before effects are selected again."""
    most_proposed: int = 2
    """Effects proposed for a joint in a round."""
    friction_odds: float = 100.0
    """Prior odds that friction determines the sign of a poorly explained joint. Chosen; not measured."""
    needed_of_robot: float = 7.4
    """Gain in nats above which signs are searched under an effect of the whole robot: 4.6, decisive (Jeffreys 1961),
    plus ln 16 for 16 guesses. To enter the model the effect must pass the usual selection."""
    explained_alike: float = 0.1
    """Relative change of a joint's residual below which effects are not proposed again."""
    most_rivals: int = 3
    """Proposals for a joint under which signs are searched."""
    sharpened_rounds: int = 4
    """Largest number of Gauss-Newton steps from a guess; fewer if a step does not improve the fit."""
    sign_starts: int = 64
    """Random signs from which segments are flipped one by one. With ten segments they reach the global optimum
    (tests/signs/test_proposals.py)."""
    least_flip_gain: float = 1e-9
    """Nats by which a flip must lower the cost; above rounding errors."""
    proposal_rounds: int = 40
    """Largest number of alternations of coefficients and signs; a fit of 60 coefficients needs about ten."""
    proposal_gain: float = 3.0
    """Nats by which an effect must improve the fit before signs are searched under it; limits the time."""


TUNING = Tuning()
