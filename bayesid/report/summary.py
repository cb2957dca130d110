"""The numbers of an identification, typed: the content of summary.json, from which pages and terminal output are made.

`summarise` takes each field from the result by its name or computes it. A page shows the fields marked `Shown`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_type_hints

import numpy as np

from bayesid.files.writing import plain
from bayesid.identification.misread import Misreading
from bayesid.identification.options import Provenance
from bayesid.number_text import percent
from bayesid.regression.selection.nuisance_scales import TooNarrow

Kind = TypeVar("Kind")
Number = float | None
"""None where it is not finite: JSON has no infinity."""
Numbers = tuple[Number, ...]
"""One a joint."""


@dataclass(frozen=True)
class Shown:
    """Marks a field that pages show: its label, and a format or a function for its text."""

    label: str
    text: str | Callable[[Any], str] = "{}"


def shown_rows(part: object) -> list[tuple[str, str]]:
    """Labels and texts of the fields that pages show, without empty ones."""
    rows = []
    for name, hint in get_type_hints(type(part), include_extras=True).items():
        value = getattr(part, name)
        for shown in getattr(hint, "__metadata__", ()) if value not in (None, ()) else ():
            rows.append((shown.label, shown.text.format(value) if isinstance(shown.text, str) else shown.text(value)))
    return rows


@dataclass(frozen=True)
class LogPart:
    """One of several joined logs, with the label of its payload."""

    source: str
    n_samples: int
    payload: str = ""


@dataclass(frozen=True)
class AmbiguousSegment:
    """A segment whose sign the proof does not determine."""

    joint: int  # from 1
    start: float  # s, on the clock of its log
    end: float  # s, last sample
    n_samples: int
    log: str = ""  # its log, if several were joined


def _percent(share: float) -> str:
    return percent(share, 1)


def _counts(nodes: Mapping[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')}: {count}" for name, count in nodes.items())


def _ways(ways: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{way['name']} ({way['starts']} starts)" if way["starts"] else way["name"] for way in ways)


@dataclass(frozen=True)
class SearchSummary:
    """The search for the signs, and what is proven; None where nothing is."""

    method: Annotated[str, Shown("Method")]
    beam_width: int | None  # w of T-PBPR
    cost: Annotated[Number, Shown("Cost of the best assignment", "{:.6g}")]
    cost_parts: Mapping[str, Number] | None  # data, Tikhonov term, prior; None for other costs
    noise_weights: Numbers  # (n,) sd by which rows were scaled, N m, for effective samples
    proofs: int  # number of proofs: repeated if the final noise weights change the signs
    uncertified_because: str  # why a finished search proves nothing: "tikhonov", "noise" or ""
    # grown, pruned by bound or cone, survivors, leaves, and segments undecided at the time limit
    beam_nodes: Annotated[Mapping[str, int] | None, Shown("Nodes of the beam", _counts)]
    certified: Annotated[bool, Shown("No assignment costs less", lambda proven: "proven" if proven else "not proven")]
    lower_bound: Annotated[Number, Shown("Lower bound on the cost of every assignment", "{:.6g}")]
    gap: Number  # cost less lower bound
    optimality_gap: Number  # of the best cost, all assignments are listed
    assignments: int | None  # number of these, the best among them
    missed_mass: Number  # upper bound of the posterior mass of unlisted assignments over that of the best one
    persistent_share: Annotated[Number, Shown("Samples with a determined sign", _percent)]
    ambiguous: tuple[AmbiguousSegment, ...] | None  # the segments of the other samples
    seconds: Annotated[float, Shown("Seconds", "{:.1f}")]
    sdp_solves: Annotated[int, Shown("Constrained least-squares problems")]  # over the feasible parameters
    nodes: Annotated[int, Shown("Nodes of the tree")]
    rounds: Annotated[int, Shown("Search rounds")]
    timed_out: bool = False  # whether the time limit ended a search: a faster machine may give other signs
    # of the last search: result of each method, nominal seconds, and starts
    ways: Annotated[tuple[Mapping[str, Any], ...], Shown("Methods of the last search", _ways)] = ()
    # probability that an assignment which no search has found is right; 0 with a proof
    unlisted_probability: Annotated[Number, Shown("Probability of a better assignment", _percent)] = None


@dataclass(frozen=True)
class SignsSummary:
    """The model under which signs were found."""

    model: tuple[str, ...]  # its terms
    weight: Number  # of it, against the model asked for
    model_error_probability: Numbers  # (n,) probability that signs are guesses because the model is not the robot's
    sure: Numbers = ()  # (n,) share of |effort| in motion with a certain sign; empty in results of earlier versions


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
    """Model selection: additional effects of the catalogue."""

    effects: tuple[EffectSummary, ...]  # that entered the model
    held_back_error: ErrorsSummary  # on held-back blocks of the log
    uncertain: tuple[str, ...]  # effects that did not enter, but widen the uncertainty
    may_enter: bool = True  # whether effects might enter
    too_narrow: tuple[TooNarrow, ...] = ()  # intervals that an undetectable effect would make too narrow


@dataclass(frozen=True)
class ModeSummary:
    """A mode of the posterior."""

    weight: Number  # its share of the mass
    log_evidence_se: Number  # standard error of its log evidence; None where there is but one
    turned_joints: tuple[int, ...]  # from 1, with other signs than the heaviest mode for over half of the |effort|
    coefficients: Mapping[str, Number] = field(default_factory=dict)  # whose mean differs most from that mode's


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled."""

    converged: bool  # by R-hat and effective sample size
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
    posterior_conflict: Number = None  # share of the worst joint's squared effort with signs that the search excludes
    active_bounds: Mapping[str, Number] = field(default_factory=dict)  # to the share of draws near their edges
    timed_out: bool = False  # whether the time limit ended sampling before convergence
    wanted_rhat: Number = None  # up to which the draws count as converged; None in results of earlier versions
    wanted_ess: Number = None  # from which on they do


@dataclass(frozen=True)
class NoiseSummary:
    """The noise of the efforts, (n,) each, N m."""

    assumed: str  # in words
    sd: Numbers  # total
    white_sd: Numbers  # white sensor noise
    coloured_sd: Numbers  # correlated model error
    correlation_time_s: Numbers  # of the latter, s
    samples_that_count_as_one: Numbers  # integrated autocorrelation time, samples
    effective_samples: Numbers  # samples in motion over it
    residual_sd: Numbers  # of the fit


@dataclass(frozen=True)
class FitSummary:
    """The least-squares fit."""

    relative_residual: Numbers  # (n,) RMS residual over RMS effort
    condition_number: Number  # of the regressor, rows over their noise, columns of equal length; None if singular
    relative_gap: Number  # that the solver reached
    parameters_moved_inside: bool  # whether the solution was moved into the cone
    smallest_eigenvalues: Numbers  # of each link's pseudo-inertia
    links_on_edge: tuple[int, ...]  # links, from 1, on the edge of what is physically feasible
    standard_deviations: str  # what those of the coefficients are, in words


@dataclass(frozen=True)
class GainsSummary:
    """Estimated gains."""

    mean: Numbers  # (n,) most likely values, in `unit`; the result's efforts use them
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
    converged: bool  # whether signs and gains agree
    like_friction: tuple[int, ...] = ()  # joints, from 1, whose gain is confounded with load-dependent friction
    sd_of_coefficients: Numbers = ()  # (r,) apart from the factor common to all; empty in results of earlier versions


@dataclass(frozen=True)
class ConstraintSummary:
    """A constraint that was stated."""

    label: str  # how it was stated
    nats: float  # gain in log-likelihood without it; 0 if not active in the fit
    at_edge: Number = None  # share of draws at its edge, a tenth of its slack's sd from it; None without a posterior
    presses: bool = False  # whether it limits the draws


@dataclass(frozen=True)
class LowPassSummary:
    """A low-pass of |effort| after the rectifier."""

    cutoff_hz: float  # of a Butterworth low-pass
    order: int  # of it
    zero_phase: bool  # whether it was run forwards and backwards
    noise_before_sd: Numbers  # (n,) sd of the removed noise, N m
    words: str  # in a sentence


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
    warnings: tuple[str, ...]
    provenance: Provenance  # what was run on which data
    complete: CompletionSummary | None = None  # None with `--complete off`
    modes: tuple[ModeSummary, ...] = ()  # of the posterior, the heaviest first; empty where it was not sampled
    better_reading: Misreading | None = None  # of the log, than the one given; None where there is none
    low_pass_after_rectifier: LowPassSummary | None = None  # that |effort| has passed; None where none was found
    gains: GainsSummary | None = None  # that were unknowns; None where all were exact
    # label of each payload to its `mass`, kg, `com`, centre of mass in the last link's frame, m, and `inertia` about
    # it, xx, yy, zz, xy, xz, yz, kg m^2, each with `value`, `sd`, `interval`; None where none is carried
    payloads: Mapping[str, Mapping[str, Any]] | None = None
    constraints: tuple[ConstraintSummary, ...] = ()  # that were stated, each with what it costs and holds back
    corrected: tuple[str, ...] = ()  # warnings about corrected or dropped data

    @property
    def hidden_joints(self) -> int:
        """Number of joints whose signs were hidden."""
        return len(self.noise.sd) - len(self.signed_joints)


def as_json(value: Any) -> Any:
    """A structure for JSON, without optional fields of dataclasses that are empty."""
    if is_dataclass(value):
        values = [(getattr(value, one.name), one) for one in fields(value)]
        return {one.name: as_json(item) for item, one in values if one.default not in ("", ()) or len(item)}
    if isinstance(value, Mapping):
        return as_object(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    return [as_json(item) for item in value] if isinstance(value, list | tuple) else plain(value)


def as_object(content: Mapping[str, Any]) -> dict[str, Any]:
    """A dictionary for JSON."""
    return {name: as_json(item) for name, item in content.items()}


def taken(source: object, /, *names: str, **more: Any) -> dict[str, Any]:
    """Attributes by name, and further entries."""
    return {name: getattr(source, name) for name in names} | more


def filled(kind: type[Kind], source: object, /, **given: Any) -> Kind:
    """A dataclass whose fields are taken from a source by name, unless they are given."""
    names: Any = kind
    return kind(**(taken(source, *(one.name for one in fields(names) if one.name not in given)) | given))
