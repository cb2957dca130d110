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
"""One per joint."""


@dataclass(frozen=True)
class Shown:
    """Marks a field that pages show: its label, and a format or a function for its text; details are folded."""

    label: str
    text: str | Callable[[Any], str] = "{}"
    detail: bool = False


def shown_rows(part: object, *, detail: bool = False) -> list[tuple[str, str]]:
    """Labels and texts of the fields that pages show, without empty ones; of the details or of the others."""
    rows = []
    for name, hint in get_type_hints(type(part), include_extras=True).items():
        value = getattr(part, name)
        for shown in getattr(hint, "__metadata__", ()) if value not in (None, ()) else ():
            if shown.detail != detail:
                continue
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
    """The search for the signs, and its proof; None for numbers without a proof."""

    method: Annotated[str, Shown("Method")]
    beam_width: int | None  # w of T-PBPR
    cost: Annotated[Number, Shown("Cost of the best assignment", "{:.6g}", detail=True)]
    cost_parts: Mapping[str, Number] | None  # data, Tikhonov term, prior; None for other costs
    noise_weights: Numbers  # (n,) sd by which rows were scaled, N m, for effective samples
    proofs: int  # number of proofs: repeated if the final noise weights change the signs
    uncertified_because: str  # why a finished search proves nothing: "tikhonov", "noise" or ""
    # grown, pruned by bound or cone, survivors, leaves, and segments undecided at the time limit
    beam_nodes: Annotated[Mapping[str, int] | None, Shown("Nodes of the beam", _counts, detail=True)]
    certified: Annotated[bool, Shown("No assignment costs less", lambda proven: "proven" if proven else "not proven")]
    lower_bound: Annotated[Number, Shown("Lower bound on the cost of every assignment", "{:.6g}", detail=True)]
    gap: Number  # cost minus lower bound
    optimality_gap: Number  # Delta: assignments that cost up to this much more than the best are listed
    assignments: int | None  # number of listed assignments, including the best
    # upper bound of the posterior mass of all unlisted assignments over that of the best one
    missed_mass: Annotated[
        Number, Shown("Unlisted assignments: probability over the best", "at most {:.2g}", detail=True)
    ]
    persistent_share: Annotated[Number, Shown("Samples with a determined sign", _percent)]
    ambiguous: tuple[AmbiguousSegment, ...] | None  # segments whose sign the proof does not determine
    seconds: Annotated[float, Shown("Time of search and fit", "{:.1f} s", detail=True)]
    sdp_solves: Annotated[int, Shown("Constrained least-squares problems", detail=True)]  # cone problems solved
    nodes: Annotated[int, Shown("Nodes of the search tree", detail=True)]
    rounds: Annotated[int, Shown("Search rounds", detail=True)]
    timed_out: bool = False  # whether the time limit ended a search: a faster machine may give other signs
    # methods of the last search, each with its cost, nominal seconds and number of starts
    ways: Annotated[tuple[Mapping[str, Any], ...], Shown("Methods of the last search", _ways, detail=True)] = ()
    # probability that the right assignment was not found; 0 with a proof
    unlisted_probability: Annotated[
        Number, Shown("Probability that the search missed a better one", _percent, detail=True)
    ] = None


@dataclass(frozen=True)
class SignsSummary:
    """The model under which signs were found."""

    model: tuple[str, ...]  # its terms
    weight: Number  # its weight against the requested model
    model_error_probability: Numbers  # (n,) probability that the model is too wrong to determine the signs
    sure: Numbers = ()  # (n,) share of |effort| in motion with a certain sign; empty in results of earlier versions


@dataclass(frozen=True)
class EffectSummary:
    """An effect that was added to the model."""

    effect: str  # name in the catalogue
    form: str  # name of its form; that of the effect for the main form
    joints: tuple[int, ...]  # from 1; empty: the whole robot
    log10_bayes_factor: Number  # for the effect, given all other added effects
    equivalent: tuple[str, ...]  # effects that the log cannot distinguish from it
    parameters: Mapping[str, Mapping[str, Any]]  # name to value, sd (None if unknown) and unit


@dataclass(frozen=True)
class ErrorsSummary:
    """(n,) RMS errors on held-back blocks without and with the effects, and RMS effort, N m."""

    before: Numbers
    after: Numbers
    effort: Numbers


@dataclass(frozen=True)
class CompletionSummary:
    """Model selection: additional effects of the catalogue."""

    effects: tuple[EffectSummary, ...]  # effects that were added to the model
    held_back_error: ErrorsSummary  # errors on held-back blocks of the log
    uncertain: tuple[str, ...]  # effects that were not added, but widen the uncertainty
    may_enter: bool = True  # whether effects may be added
    too_narrow: tuple[TooNarrow, ...] = ()  # intervals that are too narrow if an undetectable effect is present


@dataclass(frozen=True)
class ModeSummary:
    """A mode of the posterior."""

    weight: Number  # its share of the posterior mass
    log_evidence_se: Number  # standard error of its log evidence; None for a single mode
    turned_joints: tuple[int, ...]  # joints, from 1, with over half of the |effort| flipped against mode 1
    coefficients: Mapping[str, Number] = field(default_factory=dict)  # mean of those that differ most from mode 1


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled."""

    converged: bool  # by R-hat and effective sample size
    max_rhat: Number  # largest R-hat of the coefficients
    min_ess: Number  # smallest effective sample size
    max_rhat_of_parameters: Number  # largest R-hat of the standard parameters
    draws: int  # number of draws
    ensembles: int  # number of ensembles
    walkers: int  # walkers per ensemble
    seed: int  # of all random numbers
    seconds: float  # wall-clock time
    prior: str  # description
    prior_sd: Mapping[str, Number]  # prior standard deviation of each parameter
    noise_scale: Numbers  # (n,) posterior mean of noise over reference noise
    assignments: Numbers  # posterior probability of each assignment that the search lists
    assignments_elsewhere: Number  # posterior probability of all other assignments
    mode: int = 1  # mode, from 1, whose mean gives the parameters
    posterior_conflict: Number = None  # share of the worst joint's squared effort with signs that the search excludes
    active_bounds: Mapping[str, Number] = field(default_factory=dict)  # bound to share of draws near it
    timed_out: bool = False  # whether the time limit ended sampling before convergence
    wanted_rhat: Number = None  # largest R-hat of converged draws; None in results of earlier versions
    wanted_ess: Number = None  # smallest effective sample size of converged draws


@dataclass(frozen=True)
class NoiseSummary:
    """The noise of the efforts, (n,) each, N m."""

    assumed: str  # description
    sd: Numbers  # total
    white_sd: Numbers  # white sensor noise
    coloured_sd: Numbers  # correlated model error
    correlation_time_s: Numbers  # correlation time of the model error, s
    samples_that_count_as_one: Numbers  # integrated autocorrelation time, samples
    effective_samples: Numbers  # samples in motion over the autocorrelation time
    residual_sd: Numbers  # sd of the fit's residual


@dataclass(frozen=True)
class FitSummary:
    """The least-squares fit."""

    relative_residual: Numbers  # (n,) RMS residual over RMS effort
    condition_number: Number  # of the regressor, rows over their noise, columns of unit length; None if singular
    relative_gap: Number  # duality gap that the solver reached
    parameters_moved_inside: bool  # whether parameters without effect were moved inside the cone
    smallest_eigenvalues: Numbers  # smallest eigenvalue of each link's pseudo-inertia
    links_on_edge: tuple[int, ...]  # links, from 1, at the edge of physical feasibility
    standard_deviations: str  # method for the standard deviations of the coefficients


@dataclass(frozen=True)
class GainsSummary:
    """Estimated gains."""

    mean: Numbers  # (n,) most likely values, in `unit`; the result's efforts use them
    sd: Numbers  # (n,) standard deviations
    lower: Numbers  # (n,) lower ends of the 95 % intervals
    upper: Numbers  # (n,) upper ends of the 95 % intervals
    decided_by: tuple[str, ...]  # (n,) what decides the ratio of a gain to the others: "data", "prior" or "given"
    ratio_sd: Numbers  # (n,) relative sd of that ratio
    factor: Number  # common factor of the gains over the stated ones; None if any gain is unknown
    factor_sd: Number  # relative sd of this factor
    factor_decided_by: str  # "data" (with stated masses or gains), "prior" or "given"
    unit: str  # unit of the gains
    stated: str  # stated gains, as on the command line
    converged: bool  # whether signs and gains converged
    like_friction: tuple[int, ...] = ()  # joints, from 1, whose gain is confounded with load-dependent friction
    sd_of_coefficients: Numbers = ()  # (r,) without the common factor's; empty in results of earlier versions


@dataclass(frozen=True)
class ConstraintSummary:
    """A stated constraint."""

    label: str  # as it was stated
    nats: float  # gain in log-likelihood without the constraint; 0 if the best fit satisfies it
    at_edge: Number = None  # share of draws within a tenth of the slack's sd; None without a posterior
    presses: bool = False  # whether it limits the draws


@dataclass(frozen=True)
class LowPassSummary:
    """A low-pass of |effort| after the rectifier."""

    cutoff_hz: float  # cut-off of a Butterworth low-pass, Hz
    order: int  # order of the low-pass
    zero_phase: bool  # whether it was run forwards and backwards
    noise_before_sd: Numbers  # (n,) sd of the removed noise, N m
    words: str  # description


@dataclass(frozen=True)
class Summary:
    """The numbers of an identification."""

    robot: str  # name of the robot
    log: str  # source of the log
    logs: tuple[LogPart, ...] = field(default=(), kw_only=True)  # logs that it was joined from; empty for a single log
    terms: tuple[str, ...]  # of the model
    distortions: tuple[str, ...]  # of the model
    n_samples: int  # rows of the log
    n_segments: int  # segments of the recorded samples
    n_segments_searched: int  # segments whose signs were searched
    n_coefficients: int  # number r of base coefficients
    signed_joints: tuple[int, ...]  # joints, from 1, with known signs
    processing: Mapping[str, Any]  # filter of the signals
    search: SearchSummary  # sign search
    signs: SignsSummary  # model that the signs were found with
    posterior: PosteriorSummary | None  # None without sampling
    noise: NoiseSummary  # noise of the efforts
    fit: FitSummary  # least-squares fit
    timings: Mapping[str, float]  # seconds per stage
    warnings: tuple[str, ...]
    provenance: Provenance  # options, data and versions
    complete: CompletionSummary | None = None  # None with `--complete off`
    modes: tuple[ModeSummary, ...] = ()  # modes of the posterior, heaviest first; empty without sampling
    better_reading: Misreading | None = None  # reading that explains the log better than the given one
    low_pass_after_rectifier: LowPassSummary | None = None  # low-pass of |effort|; None if none was found
    gains: GainsSummary | None = None  # estimated gains; None if all were exact
    # payload's label to `mass` (kg), `com` (centre of mass in the last link's frame, m) and `inertia` about it (xx, yy,
    # zz, xy, xz, yz, kg m^2), each number with `value`, `sd` and `interval`; None without a payload
    payloads: Mapping[str, Mapping[str, Any]] | None = None
    constraints: tuple[ConstraintSummary, ...] = ()  # stated constraints
    corrected: tuple[str, ...] = ()  # warnings about corrected or dropped data

    @property
    def hidden_joints(self) -> int:
        """Number of joints whose signs were hidden."""
        return len(self.noise.sd) - len(self.signed_joints)


def as_json(value: Any) -> Any:
    """A structure for JSON, without empty optional fields of dataclasses."""
    if is_dataclass(value):
        values = [(getattr(value, entry.name), entry) for entry in fields(value)]
        return {entry.name: as_json(item) for item, entry in values if entry.default not in ("", ()) or len(item)}
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
    return kind(**(taken(source, *(entry.name for entry in fields(names) if entry.name not in given)) | given))
