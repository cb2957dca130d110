"""The numbers of an identification: what summary.json holds, typed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from bayesid.files.tables import plain
from bayesid.identification.options import Provenance
from bayesid.identification.other_readings import BetterReading
from bayesid.regression.selection.unseen import TooNarrow

Number = float | None
"""None where it is not finite: JSON has no infinity."""
Numbers = tuple[Number, ...]
"""One a joint."""


@dataclass(frozen=True)
class LogPart:
    """One of the logs that a log was joined from, and the label of what the flange carried, if anything."""

    source: str
    n_samples: int
    payload: str = ""


@dataclass(frozen=True)
class AmbiguousSegment:
    """A segment whose sign the proof does not settle."""

    joint: int  # from 1
    start: float  # s, on the clock of its log
    end: float  # s, its last sample
    n_samples: int  # in it
    log: str = ""  # that it is of, where several were joined


@dataclass(frozen=True)
class SearchSummary:
    """How the signs were searched, and what is proven about them; None where nothing is."""

    method: str  # of the search
    beam_width: int | None  # w of T-PBPR
    cost: Number  # of the best assignment
    # of it: what the data ask, the pull to typical links, and a prior (none; the posterior has one); None where
    # nodes were priced otherwise
    cost_parts: Mapping[str, Number] | None
    # (n,) sd by which the rows of each joint were scaled, N m, as if only effective samples counted
    noise_weights: Numbers
    proofs: int  # how often the last word was said: again where the final noise weights change the signs
    withheld: str  # why nothing counts as proven although the search has ended: "pull" or "noise"; empty otherwise
    # grown, pruned by the bound or by the cone, survived a step, leaves, and segments undecided when time was up;
    # None without a beam
    beam_nodes: Mapping[str, int] | None
    certified: bool  # whether no assignment costs less
    lower_bound: Number  # that no assignment's cost falls below
    gap: Number  # cost less lower bound
    within: Number  # of the best cost, all assignments are listed
    assignments: int | None  # number of these, the best among them
    missed_mass: Number  # posterior mass that the list leaves out, at most, relative to the best one's
    settled_share: Number  # share of the samples whose sign is the same in all of them
    ambiguous: tuple[AmbiguousSegment, ...] | None  # the segments of the other samples
    seconds: float  # taken
    sdp_solves: int  # least-squares problems over the feasible parameters that were solved
    nodes: int  # partial assignments that were bounded
    rounds: int  # searches until no segment's predicted effort crossed zero
    timed_out: bool = False  # whether the time limit on the clock ended a search: a faster machine may give other signs
    # of the last search: what each way of searching has found, its nominal seconds, and its starts
    ways: tuple[Mapping[str, Any], ...] = ()
    # probability that an assignment which no search has met is the right one; 0 where a proof excludes it
    unseen: Number = None


@dataclass(frozen=True)
class SignsSummary:
    """The model under which signs were settled."""

    model: tuple[str, ...]  # its terms
    weight: Number  # of it, against the model asked for
    doubt: Numbers  # (n,) probability that signs are guesses because the model is not the robot's


@dataclass(frozen=True)
class EffectSummary:
    """An effect that entered the model."""

    effect: str  # name in the catalogue
    form: str  # of it; the effect's own name where it is the main one
    joints: tuple[int, ...]  # from 1; none named: the whole robot
    log10_bayes_factor: Number  # for it, given all others that entered
    equivalent: tuple[str, ...]  # effects that the log cannot tell from it
    parameters: Mapping[str, Mapping[str, Any]]  # name to value, sd (None where none is known) and unit


@dataclass(frozen=True)
class ErrorsSummary:
    """(n,) RMS errors on held-back blocks without and with the effects, and RMS effort, N m."""

    before: Numbers
    after: Numbers
    effort: Numbers


@dataclass(frozen=True)
class CompletionSummary:
    """What the catalogue had to say beyond the terms asked for."""

    effects: tuple[EffectSummary, ...]  # that entered the model
    held_back_error: ErrorsSummary  # on blocks of the log that had no say
    uncertain: tuple[str, ...]  # effects that did not enter, but widen the uncertainty
    may_enter: bool = True  # whether effects might enter
    too_narrow: tuple[TooNarrow, ...] = ()  # coefficients whose intervals do not allow for what may be there besides


@dataclass(frozen=True)
class ModeSummary:
    """A mode of the posterior."""

    weight: Number  # its share of the mass
    log_evidence_se: Number  # standard error of its log evidence; None where there is but one
    # from 1, of whose |effort| more than half has another sign than in the heaviest mode
    turned_joints: tuple[int, ...]
    # whose mean differs most from the heaviest mode's, in standard deviations within it, with it
    coefficients: Mapping[str, Number] = field(default_factory=dict)


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled."""

    converged: bool  # whether R-hat and the effective sample size are as they should be
    max_rhat: Number  # of the coefficients, at worst
    min_ess: Number  # effective sample size, at worst
    max_rhat_of_parameters: Number  # of the standard parameters, at worst
    draws: int  # number of them
    ensembles: int  # that were run
    walkers: int  # of each
    seed: int  # of all random numbers
    seconds: float  # taken
    prior: str  # in words
    prior_sd: Mapping[str, Number]  # parameter to its standard deviation
    noise_scale: Numbers  # (n,) posterior mean of noise over reference noise
    assignments: Numbers  # posterior probability of each assignment that the search lists
    assignments_elsewhere: Number  # and of all others
    mode: int = 1  # whose mean the model holds, from 1
    # share of a joint's squared effort, of the worst one, to which it gives signs that the search excludes
    excluded: Number = None
    # of the prior, that hold draws back, to the share of draws near their edges
    pressed_windows: Mapping[str, Number] = field(default_factory=dict)
    timed_out: bool = False  # whether the time limit on the clock ended the sampling before it converged


@dataclass(frozen=True)
class NoiseSummary:
    """The noise of the efforts, (n,) each, N m."""

    assumed: str  # in words
    sd: Numbers  # of all of it
    white_sd: Numbers  # of the sensor's
    coloured_sd: Numbers  # of what lasts longer
    correlation_time_s: Numbers  # of that, s
    samples_that_count_as_one: Numbers  # integrated autocorrelation time, samples
    effective_samples: Numbers  # samples in motion over it
    residual_sd: Numbers  # of what the fit leaves


@dataclass(frozen=True)
class FitSummary:
    """The least-squares fit."""

    relative_residual: Numbers  # (n,) RMS of what it leaves over that of the effort
    # of the regressor, rows over their noise and columns of equal length; None if it is singular
    condition_number: Number
    relative_gap: Number  # that the solver reached
    parameters_moved_inside: bool  # whether the solution was moved into the cone
    smallest_eigenvalues: Numbers  # of each link's pseudo-inertia
    links_on_edge: tuple[int, ...]  # links, from 1, on the edge of what is physically feasible
    standard_deviations: str  # what those of the coefficients are, in words


@dataclass(frozen=True)
class GainsSummary:
    """The gains by which readings were made efforts, where they were unknowns."""

    mean: Numbers  # (n,) the likeliest, in `unit`; those by which the result's efforts were made
    sd: Numbers  # (n,) their standard deviations
    lower: Numbers  # (n,) lower ends of their 95 % intervals
    upper: Numbers  # (n,) upper ends
    decided_by: tuple[str, ...]  # (n,) what decides the ratio of each to the others: "data", "prior", or it is "given"
    ratio_sd: Numbers  # (n,) relative sd of that ratio
    factor: Number  # common to all, over that of the gains stated; None where none was stated
    factor_sd: Number  # its relative sd
    factor_decided_by: str  # "data", with what is stated of masses or gains, or "prior"
    unit: str  # of them
    stated: str  # as on the command line
    settled: bool  # whether signs and gains had come to agree
    like_friction: tuple[int, ...] = ()  # joints, from 1, whose gain the log does not tell from load-dependent friction


@dataclass(frozen=True)
class LowPassSummary:
    """A low-pass that |effort| has passed after the rectifier."""

    cutoff_hz: float  # of a Butterworth low-pass
    order: int  # of it
    zero_phase: bool  # whether it was run forwards and backwards
    noise_before_sd: Numbers  # (n,) sd of the noise that it took away, N m
    words: str  # all that, as people say it


@dataclass(frozen=True)
class Summary:
    """The numbers of an identification."""

    robot: str  # its name
    log: str  # its source
    logs: tuple[LogPart, ...] = field(default=(), kw_only=True)  # that it was joined from; empty where it is one
    terms: tuple[str, ...]  # of the model
    distortions: tuple[str, ...]  # of the model
    n_samples: int  # rows of the log
    n_segments: int  # of what was recorded
    n_segments_searched: int  # of these, whose signs were searched
    n_coefficients: int  # r
    signed_joints: tuple[int, ...]  # from 1, whose signs were known
    processing: Mapping[str, Any]  # of the signals
    search: SearchSummary  # of the signs
    signs: SignsSummary  # the model under which they were settled
    posterior: PosteriorSummary | None  # None if it was not sampled
    noise: NoiseSummary  # of the efforts
    fit: FitSummary  # by least squares
    timings: Mapping[str, float]  # stage to seconds
    warnings: tuple[str, ...]  # what the user should know
    provenance: Provenance  # what was run on which data
    complete: CompletionSummary | None = None  # what the catalogue had to say; None where it was not asked
    modes: tuple[ModeSummary, ...] = ()  # of the posterior, the heaviest first; empty where it was not sampled
    better_reading: BetterReading | None = None  # of the log, than the one given; None where there is none
    low_pass_after_rectifier: LowPassSummary | None = None  # that |effort| has passed; None where none was found
    gains: GainsSummary | None = None  # that were unknowns; None where all were exact
    # label of each payload that logs carry to its `mass`, kg, `com`, centre of mass in the last link's frame, m,
    # and `inertia` about it, xx, yy, zz, xy, xz, yz, kg m^2, each with `value`, `sd`, `interval`; None where none
    # is carried
    payloads: Mapping[str, Mapping[str, Any]] | None = None

    @property
    def hidden_joints(self) -> int:
        """Number of joints whose signs were hidden."""
        return len(self.noise.sd) - len(self.signed_joints)


def as_json(part: Any) -> dict[str, Any]:
    """A summary, or a part of one, as JSON has it: a field that may be empty is left out where it is."""
    values = {one.name: getattr(part, one.name) for one in fields(part)}
    optional = {one.name for one in fields(part) if one.default in ("", ())}
    return {name: _json(value) for name, value in values.items() if value or name not in optional}


def _json(value: Any) -> Any:
    if is_dataclass(value):
        return as_json(value)
    return [_json(item) for item in value] if isinstance(value, tuple) else plain(value)
