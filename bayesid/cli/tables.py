"""The tables that end a command."""

from __future__ import annotations

import numpy as np

import bayesid
from bayesid.agreement import text as agreement_text
from bayesid.report.words import paragraph
from bayesid.tables import recorded_segments


def identification_table(result: bayesid.Identification) -> str:
    """The table that ends `bayesid identify`."""
    fit, search = result.fit, result.search
    segments, _, confidence = recorded_segments(result)
    recorded = result.log.clock(result.signals.motion.t)[0] >= 0  # the pause between joined logs is not
    lines = [
        f"{result.model.robot.name}: {len(result.log)} rows, {len(segments)} segments "
        f"({len(search.signs)} searched), {len(result.coefficients)} coefficients "
        f"({int((result.sd < 0.1 * np.abs(result.beta)).sum())} known to 10 %), "
        f"condition number {fit.condition:.0f}",
        f"search: {search.method}, {search.solves} cone problems, {result.timings['search']:.1f} s; {_proven(result)}",
        _sampled(result),
        "joint   segments   least sure   |effort| sure to 99 %   relative residual",
    ]
    sure = np.maximum(result.probability, 1.0 - result.probability)[recorded] >= 0.99
    effort = np.abs(result.signals.raw_effort)[recorded]
    share = (effort * sure).sum(axis=0) / np.maximum(effort.sum(axis=0), 1e-300)
    for j in range(result.model.robot.n_joints):
        here = segments.joint == j
        lines.append(
            f"{j + 1:>5}   {here.sum():>8}   {confidence[here].min():>10.2f}   {share[j]:>21.1%}"
            f"   {fit.relative_residual[j]:>17.1%}"
        )
    return "\n".join(lines)


def separate_table(found: bayesid.Separate) -> str:
    """The tables that end `bayesid identify --each`."""
    width = max(len("log"), *(len(str(one.log)) for one in found.runs))
    lines = [f"{'log':<{width}}   samples   segments   certified   converged   worst relative residual"]
    for one in found.runs:
        told = one.figures
        if told:
            proven, sampled = (_yes_or_no(told[key]) for key in ("certified", "converged"))
            lines.append(
                f"{one.log!s:<{width}}   {told['n_samples']:>7}   {told['n_segments']:>8}   {proven:>9}"
                f"   {sampled:>9}   {told['worst_relative_residual']:>23.1%}"
            )
    few = "fewer than two results: nothing to compare"
    return "\n".join([*lines, "", few if found.agreement is None else agreement_text(found.agreement)])


def _yes_or_no(value: object) -> str:
    return "-" if value == "" else "yes" if value else "NO"


def _proven(result: bayesid.Identification) -> str:
    search = result.search
    if search.certified:
        others = len(search.branches) - 1
        named = f"{others or 'no'} other assignment{'s' * (others != 1)} within {search.within:.0f}"
        return f"certified: none costs less, {named}, {result.settled_share:.1%} of samples settled"
    if search.lower_bound is None:
        return "not certified"
    return f"not certified: cost {search.cost:.1f}, proven lower bound {search.lower_bound:.1f}"


def _sampled(result: bayesid.Identification) -> str:
    posterior = result.posterior
    if posterior is None:
        return "posterior: not sampled"
    state = "converged" if posterior.converged else "NOT CONVERGED"
    modes = "" if len(posterior.modes) == 1 else f", {len(posterior.modes)} modes"
    return (
        f"posterior: {state}, R-hat {posterior.max_rhat:.3f}, effective sample size {posterior.min_ess:.0f}{modes}, "
        f"{posterior.seconds:.1f} s"
    )


def validation_table(result: bayesid.Validation) -> str:
    """The table that ends `bayesid validate`."""
    lines = ["joint   RMS error, N m   relative residual   in the 95 % band"]
    figures = zip(result.rms_error, result.relative_residual, result.coverage, strict=True)
    for j, (error, relative, inside) in enumerate(figures, start=1):
        lines.append(f"{j:>5}   {error:>14.4g}   {relative:>17.1%}   {inside:>16.1%}")
    return "\n".join([*lines, f"the band holds {result.band}"])


def discrepancy_table(result: bayesid.Discrepancy) -> str:
    """The tables that end `bayesid discrepancy`."""
    lines = [paragraph(result), "", f"gap on {result.holdout}, RMS in N m:", "joint     before      after      floor"]
    gaps = zip(result.before, result.after, result.floor.rms, strict=True)
    lines += [f"{j:>5}   {b:>8.4g}   {a:>8.4g}   {f:>8.4g}" for j, (b, a, f) in enumerate(gaps, start=1)]
    if result.found:
        lines += ["", f"{'effect':<24} {'joints':<8} log10 Bayes factor   probability   not told from"]
    for one in result.found:
        joints = ",".join(map(str, one.joints)) or "all"
        figures = f"{one.verdict.gain / np.log(10.0):>18.1f}   {one.verdict.probability:>11.3f}"
        lines.append(f"{one.effect:<24} {joints:<8} {figures}   {', '.join(one.verdict.equivalent)}".rstrip())
    return "\n".join(lines)
