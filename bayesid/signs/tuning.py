"""Numbers that were chosen: how signs are searched and smoothed, and when effects and other models are asked."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package, with what each is for; `TUNING` holds those in use.

    Those of the certified search decide how long it takes and how much it can prove, never whether what it proves is
    true: whatever is left out counts as not excluded. They were set by hand on the logs of `studies.real` and on
    simulated ones (`python -m bayesid.studies.benchmarks.search` shows seconds and certificates).

    Many of them were halved and doubled (`python -m bayesid.studies.ablation signs`). Where that was seen to change a
    decision on logs of UR10e, KR300 and TIAGo, the number's sentence says so.
    """

    # Budgets: what work counts as, on one core; it changes how long a budget takes, never what a search gives
    seconds_a_step: float = 4.5e-4
    """Nominal seconds of a step of a loop."""
    seconds_a_choice: float = 5e-9
    """Of pricing a sign choice, by the number r of coefficients."""
    seconds_a_solve: float = 1e-6
    """Of a cone problem, by the square of the number P of parameters."""
    seconds_a_pair: float = 3e-8
    """Of a pair of segments that may turn."""
    budget_afterwards: float = 0.2
    """Share of a budget that all searches have together which follow once it is spent: under another model, say."""

    # Any search
    alike: float = 0.1
    """Cost, twice the nats, within which the data do not prefer one of two assignments: odds of 1.05."""
    near: float = 40.0
    """Cost beyond the best one's up to which an assignment is listed where nothing is proven: 20 nats."""
    strong: float = 0.1
    """Share of the energy of a joint's strongest segment from which on a branch without a proof decides a segment."""
    wider_beam: int = 4
    """A first beam that leaves a poor fit is repeated so many times as wide."""
    most_initial: int = 12
    """Segments that a beam may enumerate at the start: 2^12 nodes."""

    # Local search
    temperatures: tuple[float, ...] = (30.0, 100.0, 300.0)
    """T of the draws, in turn. By hand on two real logs: with 1000 hardly any start leads to the best assignment."""
    failures: int = 98
    """Starts without a better assignment after which a local search ends: the next one leads to a better one with a
    probability of 1 / (98 + 2) = 1 %, by Laplace's rule of succession."""
    failures_on_the_way: int = 20
    """The same in a round that fits poorly, from signs that another model has settled, and after the fallback."""
    most_starts: int = 2
    """Times the failures that are asked for: starts at most."""
    most_begun: int = 8
    """Assignments of a list from which a local search begins."""

    # Certified search
    proof_share: float = 0.4
    """Share of the budget that a proof may take. Proofs that end do so within 0.35 of the default budget on all logs of
    `studies.real_floor`."""
    fallback_share: float = 0.2
    """Share that the fallback may take at most, once a local search has had its turn."""
    unmoved: float = 1.0 / 3.0
    """Share of the proof's budget after which it is given up if its lower bound is still zero."""
    hidden_by_tikhonov: float = 3.0
    """Times its own pull by which a branch may cost the data less than its cost says."""
    allowance: float = 10.0
    """Cost beyond that of a single assignment of the allowed mass up to which a proof goes at first."""
    growth: float = 2.0
    """Cost beyond what would have sufficed before, by which a proof is widened."""
    candidate_patterns: int = 64
    """Patterns of each joint among which candidates are looked for."""
    candidate_combinations: int = 256
    """Combinations of all joints that are kept on the way."""
    candidate_share: float = 0.02
    """Of the energy of a joint's strongest segment, from which on a segment takes part."""
    candidates_solved: int = 64
    """Candidates solved in the cone, at most."""
    candidates_persistent: int = 3
    """Of those."""
    flipped: int = 20
    """Single segments of the best candidate that are turned on trial."""
    settling_rounds: int = 20
    """Of settling undecided segments and parameters in turn."""
    shares: tuple[float, ...] = (0.7, 0.4, 0.2, 0.1)
    """Of the energy of a joint's strongest segment from which its segments are decided, from coarse to fine."""
    longest_list: int = 20_000
    """Patterns that a joint's list may hold; it decides fewer segments otherwise."""
    few_combinations: int = 2_500
    """Up to which the finest lists are joined at once."""
    most_combinations: int = 50_000
    """That may be held on the way there."""
    least_width: int = 64
    """Patterns that a beam holds that looks for a joint's least cost."""
    listed: int = 300
    """Segments of a joint, the strongest, that patterns decide at most; bounds time and memory."""
    least_group: int = 500
    """Segments of a joint whose least cost is looked for at once; bounds time and memory."""
    least_list: int = 2_000
    """Patterns that the list may hold that proves it."""
    enumerated: int = 14
    """Segments left by persistency of which all sets of flips are tried (2^14 of them)."""
    many_flips: int = 8_000
    """Segments beyond which their interference is bounded without looking at pairs."""
    charged_flips: int = 400
    """Segments up to which charges are handed on between them."""
    sweeps: int = 4
    """How often they are."""
    rows_at_once: int = 1_000
    """Of K that are made together; bounds the memory."""
    pairs_at_once: int = 50_000
    """Of patterns that are priced together when two lists are joined; bounds the memory."""
    undecided_tikhonov: float = 1e-4
    """Share of the Tikhonov term in the bounds of undecided rows: keeps them well conditioned, and takes next to
    nothing from those of decided ones. A round number; any share keeps the bounds valid."""
    lighter_tikhonov: float = 1e-2
    """Share of the Tikhonov term with which costs by the data alone are had: less, and rounding spoils their bounds."""

    # Rounds of search
    first_noise: float = 0.05
    """Noise of each joint before any fit, as a share of its RMS effort: that of the paper's experiment."""
    least_noise: float = 1e-3
    """The least noise that a fit is believed to reach, as a share of the RMS effort."""
    clear_crossing: float = 2.0
    """Residual sd on both sides by which a predicted effort clearly crosses zero: by chance in one sample of twenty."""
    search_rounds: int = 4
    """Searches of one log. The segments that still cross zero then are reported."""
    most_individual: int = 5_000
    """Segments of each joint with an H_k of their own; some 6 kB each (docs/certified-search.md)."""
    most_repriced: int = 32
    """Of the listed assignments, cheapest first, that are priced by other weights."""
    different_signs: float = 0.01
    """Share of a joint's energy in which two assignments differ if both count: less, and smoothing says as much."""
    most_alternatives: int = 6
    """Alternatives that are kept."""

    # Smoothing and filtering: the model's error b, and what is smoothed at once (some 50 MB)
    grid: int = 101
    """Values of b: with `grid_reach` a spacing of 0.08 standard deviations, below what transitions can resolve."""
    grid_reach: float = 4.0
    """Half-width of the grid in standard deviations of b."""
    finest_step: float = 0.75
    """Spacings of the grid: a narrower transition would fall between its points. Halved, samples of UR10e and KR300
    get other signs."""
    finest_noise: float = 1e-6
    """Of the grid's half-width: finer white noise, as of a joint without efforts, is taken to be as wide. It would fall
    between the grid's values, and singles could not tell which of them is the nearest."""
    rest_time: float = 0.5
    """s; how fast static friction may build up. Halved or doubled, samples of UR10e and KR300 get other signs."""
    turns_at_rest: float = 0.5
    """Probability that friction turns round at once in a standstill, at any of its samples: nothing is known of it."""
    middle: float = 8.0
    """Half-width of the grid's middle, in standard deviations of b in motion: beyond it are 1e-15 of b."""
    middle_margin: int = 2
    """Spacings of the grid by which its middle is wider."""
    leaning: float = 1e-6
    """Share of a belief at the ends of the middle, or beyond them, from which on the whole grid is needed."""
    window_end: int = 2
    """Values at either end of the middle that count as its end."""
    smoothed: int = 10_000
    """Samples that are smoothed at once."""
    overlap: int = 1_000
    """Samples by which they look into their neighbours: many correlation times of the model's error."""
    piece: int = 24
    """Samples of the pieces that run side by side."""
    side_by_side: int = 24_000
    """Samples times draws that run side by side, if one draw has not more; of more, joints are smoothed in parallel."""
    fastest_filter: float = 125.0
    """Hz; steps of b in a filter: between them, at higher rates, b is constant."""

    # A low-pass after the rectifier
    crossing_reach: float = 0.06
    """s before and after a zero crossing that count as around it. Of 0.06, 0.08 and 0.12 the best on filtered dev logs
    and simulated ones."""
    low_pass_rest: float = 0.4
    """s before and after that, in which a low-pass comes to rest."""
    most_crossings: int = 240
    """Crossings that are looked at, evenly over log and joints: far more than what decides."""
    low_pass_false_alarm: float = 0.05
    """Bound on the probability of finding a low-pass where there is none. By the normal limit of the same sum it is
    0.007. At 0.01 the Panda's dev log behind 8 Hz was missed."""
    lowest_cutoff: float = 1.4
    """Hz; the first cut-off that is tried, where hardly a motion is left."""
    half_octaves: int = 9
    """Cut-offs that are tried: the last one, 22 Hz, rounds off a sample or two."""
    cutoff_of_nyquist: float = 0.5
    """Of half the rate: a cut-off above is not tried, since resampling does as much."""
    low_pass_shapes: tuple[tuple[int, bool], ...] = ((1, False), (2, False), (1, True), (2, True))
    """Order, and whether there is no delay: an RC element, a usual low-pass, and both run forwards and backwards."""
    crossing_bias: float = 4.0
    """Largest error of the model that is tried at a crossing, in standard deviations of the residual."""
    crossing_biases: int = 41
    """Errors that are tried."""
    longest_lag: float = 0.5
    """s; beyond this lag a residual's correlation is the motion's (`bayesid.regression.noise`)."""
    error_memories: tuple[float, ...] = (0.05, 0.1, 0.2, 0.5, 2.0)
    """s; correlation times of the model's error that are told apart."""
    least_noise_taken: float = 1.0
    """Least noise that a low-pass took, as a share of the residual's variance. A low-pass is known only so well, and
    slow noise looks like noise that has passed. Of 0.1 and 1 the one with fewer wrong signs on eight filtered logs."""
    low_pass_fits: int = 3
    """Fits behind a low-pass, each with the signs of the one before it."""

    # Other models, and doubt where none helps
    lasting: float = 0.5
    """Coloured over white noise of a residual from which on another model is asked."""
    largest_weight: float = 0.95
    """The model that was asked for keeps a say: neither is the truth, whatever their odds."""
    tolerated_error: float = 0.3
    """Model error, as a share of the effort, that casts no doubt on proven signs (study `misfit`)."""
    tolerated_error_unproven: float = 0.1
    """The same without a proof (study `misfit`)."""
    error_of_a_guess: float = 0.7
    """So much more, and a sign is a guess in half of the cases (study `misfit`)."""
    shared_error: float = 0.6
    """Share of the worst joint's model error that all joints are suspected of: parameters are common to them (study
    `misfit`)."""
    joints_in_all_sets: int = 7
    """Joints up to which all sets of them are turned, 127; of more, those of one or two, and all but one or none."""
    outlier: float = 6.0
    """Residual sd from which on a sample is an outlier. By hand: with 4, signs where friction turns round lose
    confidence too."""

    # Completing the model
    completion_rounds: int = 3
    """Selections, each under the signs that the one before it led to."""
    signs_changed: float = 1e-2
    """Share of the samples in motion whose sign must have changed for effects to be selected anew."""
    most_proposed: int = 2
    """Effects that are proposed for a joint in a round."""
    friction_odds: float = 100.0
    """Odds that friction decides the sign of a joint that the model explains poorly."""
    needed_of_robot: float = 7.4
    """Nats by which signs follow an effect of the whole robot: decisive (Jeffreys 1961) for any of 16 guesses, 4.6 and
    the log of 16. It enters the model as all others do."""
    explained_alike: float = 0.1
    """Relative change of what is left of a joint's effort below which effects are not proposed for it again."""
    most_rivals: int = 3
    """Proposals for a joint, the best of which may be taken: each costs a search."""
    sharpened_rounds: int = 4
    """Steps by Gauss-Newton from a guess, at most; it ends where one explains no more."""
    sign_starts: int = 64
    """Random signs from which segments are turned one by one; of ten segments they lead to the best signs of all
    (tests/signs/test_proposals.py)."""
    least_turn: float = 1e-9
    """Nats by which a turn must lower the cost: rounding."""
    proposal_rounds: int = 40
    """Of coefficients and signs in turn; a round number, a fit of 60 coefficients takes some ten."""
    proposal_gain: float = 3.0
    """Nats by which an effect must do better than none to be proposed: the search that follows takes its time."""


TUNING = Tuning()
