"""Findings made by hand, with different numbers everywhere: nothing is identified."""

from dataclasses import replace

import numpy as np

from bayesid.identification.options import Provenance
from bayesid.report.report_data import (
    Alternatives,
    CoefficientTable,
    Correlation,
    Prediction,
    ReportData,
    Samples,
    SegmentTable,
)
from bayesid.report.summary import (
    AmbiguousSegment,
    FitSummary,
    NoiseSummary,
    PosteriorSummary,
    SearchSummary,
    SignsSummary,
    Summary,
)
from bayesid.report.tuning import TUNING

RATE = 100.0
NAMES = ("J1zz", "mc2x", "mc2y", "fv1", "fc1", "Ia2", "m2", "off2")
UNITS = ("kg m^2", "kg m", "kg m", "N m s/rad", "N m", "kg m^2", "kg", "N m")


def make_samples(n, count, rate=RATE, seed=0):
    """Joint j swings with a frequency and a size of its own; 5 % of it stand still."""
    t, rng = np.arange(count) / rate, np.random.default_rng(seed)
    pace = 0.35 + 0.2 * np.arange(n)
    phase = 2.0 * np.pi * pace * t[:, None] + 0.3
    predicted = (6.0 - np.arange(n) / 2) * np.sin(phase) + 0.7 * np.cos(2.3 * phase)
    residual = 0.15 * rng.standard_normal((count, n)) + 0.05 * np.sin(3.0 * phase)
    signed = predicted + 0.5 * residual
    used = np.ones((count, n), dtype=bool)
    used[: count // 20] = False
    return Samples(
        t=t,
        position=np.sin(0.7 * phase),
        velocity=np.cos(0.6 * phase) - 0.2,
        recorded=np.abs(predicted + residual),
        signed=signed,
        predicted=predicted,
        residual=residual,
        used=used,
        every=1,
        probability=np.where(signed > 0.0, 0.999, 0.002),
    )


def make_segments(samples, per_joint, seed=0):
    """Cut evenly; of each joint the second segment is ambiguous and the first one stands still."""
    n, rng = samples.signed.shape[1], np.random.default_rng(seed)
    edges = np.linspace(0.0, samples.t[-1], per_joint + 1)
    joint = np.repeat(np.arange(n), per_joint)
    confidence = rng.uniform(0.96, 1.0, len(joint))
    confidence[1::per_joint] = 0.62 + 0.1 * np.arange(n) / n
    start = np.tile(edges[:-1], n)
    place = np.searchsorted(samples.t, start + 0.4 * (edges[1] - edges[0])).clip(max=len(samples.t) - 1)
    return SegmentTable(
        joint=joint,
        start=start,
        end=np.tile(edges[1:], n),
        sign=np.where(samples.signed[place, joint] > 0.0, 1, -1),
        confidence=confidence,
        moving=np.arange(len(joint)) % per_joint > 0,
        ambiguous=confidence < TUNING.ambiguous,
    )


def make_coefficients(count, nominal=True):
    mean = np.array([1.7961, -0.35, 0.012, 2.4, -0.9, 0.05, 15.0, 0.3])[:count]
    sd = np.array([0.02, 0.01, 0.03, 0.3, 0.1, 0.001, 4.0, 0.005])[:count]
    return CoefficientTable(
        name=NAMES[:count],
        expression=tuple(f"{name} + a2^2 m3" for name in NAMES[:count]),
        unit=UNITS[:count],
        mean=mean,
        sd=sd,
        low=mean - 1.9 * sd,
        high=mean + 2.1 * sd,
        prior_sd=np.linspace(3.0, 5.0, count),
        nominal=np.where(np.arange(count) % 3 == 1, np.nan, 1.01 * mean) if nominal else np.full(count, np.nan),
        by_data=np.arange(count) != 6,
    )


def make_prediction(samples):
    """Of a motion that the model has not seen, with a band that widens."""
    half = 0.4 + 0.01 * samples.t[:, None] * np.ones(samples.signed.shape[1])
    n = half.shape[1]
    return Prediction(
        source="another.csv",
        t=samples.t,
        measured=samples.signed,
        predicted=samples.predicted,
        lower=samples.predicted - half,
        upper=samples.predicted + half,
        rms_error=0.3 + 0.1 * np.arange(n),
        relative_residual=0.031 + 0.001 * np.arange(n),
        coverage=0.93 + 0.01 * np.arange(n) / n,
        band="noise alone",
    )


def make_summary(n, coefficients, signed_joints=()):
    each = np.arange(1, n + 1)
    return Summary(
        robot="arm",
        log="log.csv",
        terms=("rigid_body", "viscous_friction"),
        distortions=(),
        n_samples=300,
        n_segments=17,
        n_segments_searched=11,
        n_coefficients=coefficients,
        signed_joints=tuple(signed_joints),
        processing={"rate": RATE, "cutoff": 7.5},
        search=SearchSummary(
            method="certified",
            beam_width=5,
            cost=812.5,
            cost_parts={"data": 812.25, "pull": 0.25, "prior": 0.0},
            noise_weights=tuple((0.4 * each).tolist()),
            proofs=1,
            uncertified_because="",
            beam_nodes=None,
            certified=True,
            lower_bound=812.5,
            gap=0.0,
            optimality_gap=13.8,
            assignments=1,
            missed_mass=0.0009,
            persistent_share=0.987,
            ambiguous=(AmbiguousSegment(joint=2, start=0.5, end=0.74, n_samples=25),),
            seconds=1.25,
            sdp_solves=46,
            nodes=3417,
            rounds=2,
        ),
        signs=SignsSummary(model=("rigid_body",), weight=0.0, model_error_probability=(0.0,) * n),
        posterior=PosteriorSummary(
            converged=True,
            max_rhat=1.0042,
            min_ess=812.0,
            max_rhat_of_parameters=1.02,
            draws=6144,
            ensembles=2,
            walkers=64,
            seed=7,
            seconds=3.5,
            prior="normal",
            prior_sd={"m1": 3.5, "J1zz": 0.7},
            noise_scale=tuple((1.0 + 0.01 * each).tolist()),
            assignments=(1.0,),
            assignments_elsewhere=0.0005,
        ),
        noise=NoiseSummary(
            assumed="white and coloured",
            sd=tuple((0.2 * each).tolist()),
            white_sd=tuple((0.19 * each).tolist()),
            coloured_sd=tuple((0.02 * each).tolist()),
            correlation_time_s=tuple((0.1 * each).tolist()),
            samples_that_count_as_one=tuple((1.0 + 0.5 * each).tolist()),
            effective_samples=tuple((250.0 / each).tolist()),
            residual_sd=tuple((0.25 * each).tolist()),
        ),
        fit=FitSummary(
            relative_residual=tuple((0.02 + 0.003 * each).tolist()),
            condition_number=41.7,
            relative_gap=3e-11,
            parameters_moved_inside=False,
            smallest_eigenvalues=tuple((0.01 * each).tolist()),
            links_on_edge=(),
            standard_deviations="of the posterior",
        ),
        timings={"search": 1.25, "posterior": 3.5},
        warnings=(),
        provenance=Provenance(
            options={"seed": 7, "terms": ["rigid_body"], "cutoff": None},
            data="1e45" * 16,
            files={"log.csv": "ab12" * 16},
            versions={"python": "3.11.7", "numpy": "2.0"},
            machine="x86_64, Linux",
            date="2026-01-02T03:04:05+00:00",
            command="bayesid identify log.csv",
        ),
    )


def make_findings(n=2, count=300, per_joint=6, coefficients=8, draws=True, validated=False, **changes):
    """Of n joints, all without signs unless `signed_joints` says otherwise; the last one slides."""
    samples = make_samples(n, count)
    table = make_coefficients(coefficients)
    rng = np.random.default_rng(1)
    lag = np.arange(20) / RATE
    made = ReportData(
        summary=make_summary(n, coefficients, changes.pop("signed_joints", ())),
        effort_unit=("N m",) * (n - 1) + ("N",),
        position_unit=("rad",) * (n - 1) + ("m",),
        samples=samples,
        segments=make_segments(samples, per_joint),
        correlation=Correlation(lag, np.exp(-np.outer(20.0 * np.arange(1, n + 1), lag)), 0.1 + 0.01 * np.arange(n)),
        coefficients=table,
        prior_parameters=("m1", "mc1x", "J1xx"),
        alternatives=Alternatives(
            np.array([812.5]), np.array([1.0]), *(np.zeros(0, np.int64),) * 2, np.zeros(0), np.zeros(0)
        ),
        draws=table.mean + table.sd * rng.standard_normal((2, 256, coefficients)) if draws else None,
        prediction=make_prediction(make_samples(n, count, seed=5)) if validated else None,
    )
    return replace(made, **changes)


def with_summary(findings, part=None, **changes):
    """The same with entries of the summary, or of one of its parts, changed."""
    if part is not None:
        changes = {part: replace(getattr(findings.summary, part), **changes)}
    return replace(findings, summary=replace(findings.summary, **changes))


def with_alternatives(findings):
    """Two other assignments remain: one differs in one segment, the other in two of two joints."""
    others = Alternatives(
        cost=np.array([812.5, 815.25, 819.0]),
        mass=np.array([0.71, 0.27, 0.02]),
        branch=np.array([1, 2, 2]),
        joint=np.array([1, 0, 1]),
        start=np.array([0.5, 1.25, 2.0]),
        end=np.array([0.75, 1.5, 2.375]),
    )
    return with_summary(replace(findings, alternatives=others), "search", assignments=3)
