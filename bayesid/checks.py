"""Traffic lights: what speaks for an identification, what against it, and what to do about it.

A check is `good`, to be `looked at`, `bad`, or `not done`. Its limits are stated where they stand; they rest on the
studies of docs/studies.md or on the field's customs, as said there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesid.findings import AMBIGUOUS, Findings
from bayesid.signs import POOR

State = Literal["good", "look", "bad", "not done"]
_WELL, _ILL = 100.0, 1000.0
"""Condition numbers: up to 100 is the field's custom for a good excitation; study `excitation`: efforts of a new motion
are 2 % off at 66 and some 20 % off at 6000."""
_SURE, _UNSURE = 0.95, 0.8
"""Shares of the |effort| whose sign is as good as certain."""
_CERTAIN = 0.99
_WHITE = 0.3
"""Share of the residual's variance that may last longer than sensor noise does."""
_SMALL = 0.1
"""Share of a joint's effort that a model may well leave."""
_MOSTLY = 0.9
"""Share of the coefficients that the data should decide, at least."""
_COVERED = (0.9, 0.99)
"""Share of a new log's efforts inside a band of 95 %: outside of this the standard deviations do not hold there."""
_WORSE = 1.5
"""Times the RMS residual of the log itself that a new log's may reach; shares of the effort depend on the motion."""


@dataclass(frozen=True)
class Check:
    """One traffic light.

    Attributes:
        name: of what was checked.
        state: how it stands.
        told: what was seen, one sentence.
        remedy: what to do about it; empty where nothing is to be done.
    """

    name: str
    state: State
    told: str
    remedy: str = ""


def check(findings: Findings) -> tuple[Check, ...]:
    """All checks of an identification, in the order of the pipeline."""
    return (
        _excitation(findings),
        _segments(findings),
        _certificate(findings),
        _convergence(findings),
        _fit(findings),
        _whiteness(findings),
        _decided(findings),
        _validation(findings),
        _warnings(findings),
    )


def worst(checks: Iterable[Check]) -> State:
    """The worst state among them; what was not done counts as to be looked at only."""
    states = {one.state for one in checks}
    return "bad" if "bad" in states else "look" if states & {"look", "not done"} else "good"


def _excitation(findings: Findings) -> Check:
    condition = findings.summary["fit"]["condition_number"]
    silent = int(np.isinf(findings.coefficients.sd).sum())
    if condition is None or silent:  # JSON has no infinity
        said = f"the motion does not show {silent or 'some'} of {len(findings.coefficients.mean)} coefficients"
        return Check("Excitation", "bad", said, f"record a motion that moves more joints at once: {_EXCITE}")
    said = f"the condition number of the regressor is {condition:.0f} (rows over their noise, columns of equal length)"
    if condition <= _WELL:
        return Check("Excitation", "good", said)
    state: State = "look" if condition <= _ILL else "bad"
    return Check("Excitation", state, said, f"some coefficients can hardly be told apart: {_EXCITE}")


_EXCITE = "`bayesid excite` designs one for your robot"


def _segments(findings: Findings) -> Check:
    name, share = "Signs of the segments", sure_share(findings)
    unknown = [j + 1 for j in range(findings.n_joints) if j + 1 not in findings.summary["signed_joints"]]
    if not unknown:
        return Check(name, "good", "all signs were known")
    told = findings.segments
    doubtful = int((told.ambiguous & told.moving).sum())
    said = (
        f"{share:.1%} of the |effort| has a sign that is sure to {_CERTAIN:.0%}; {doubtful} of "
        f"{int(told.moving.sum())} segments in motion are ambiguous (confidence below {AMBIGUOUS:g})"
    )
    doubt = np.array(findings.summary["signs"]["doubt"])
    if doubt.max(initial=0.0) > 0.0:
        joints = ", ".join(str(j + 1) for j in np.flatnonzero(doubt))
        said += f"; the model's own error casts doubt on joint {joints}"
    if share >= _SURE and not doubt.any():
        return Check(name, "good", said)
    remedy = "validate on a log with known signs, move these joints faster or loaded, or join several logs"
    return Check(name, "look" if share >= _UNSURE else "bad", said, remedy)


def sure_share(findings: Findings) -> float:
    """Share of the |effort| in motion, each joint alike, whose sign is as good as certain."""
    samples = findings.samples
    certain = np.maximum(samples.probability, 1.0 - samples.probability) >= _CERTAIN
    effort = np.abs(samples.recorded) * samples.used
    return float(np.mean((effort * certain).sum(axis=0) / np.maximum(effort.sum(axis=0), 1e-300)))


def _certificate(findings: Findings) -> Check:
    name, told = "Proof", findings.summary["search"]
    if len(findings.summary["signed_joints"]) == findings.n_joints:
        return Check(name, "good", "there was nothing to prove: all signs were known")
    if told["certified"]:
        others = (told["assignments"] or 1) - 1
        also = "no other comes" if not others else "one other comes" if others == 1 else f"{others} others come"
        said = f"no assignment of signs costs less, and {also} within {told['within'] or 0.0:.1f} of its cost"
        return Check(name, "good" if not others else "look", said, _ALTERNATIVES if others else "")
    if told["lower_bound"] is None:
        said = "nothing is proven: the signs were found by a beam, which may miss the best ones"
        return Check(name, "look", said, "leave out --search beam")
    said = f"not proven: others may cost up to {told['gap']:.3g} less than {told['cost']:.4g}"
    return Check(name, "look", said, "give more --search-budget, or a longer log")


_ALTERNATIVES = "see below where they differ; the posterior weighs them"


def _convergence(findings: Findings) -> Check:
    name, told = "Sampling", findings.summary["posterior"]
    if told is None:
        said = "no posterior was sampled: standard deviations leave physical feasibility out"
        return Check(name, "not done", said, "leave out --no-posterior")
    rhat, size = number_told(told["max_rhat"], 3), number_told(told["min_ess"])
    said = f"R-hat is {rhat} and the effective sample size {size}, at worst"
    if told["converged"]:
        return Check(name, "good", f"converged: {said}")
    return Check(name, "bad", f"not converged: {said}", "give more --posterior-budget")


def number_told(value: float | None, decimals: int = 0) -> str:
    """A number of summary.json, where null stands for what is not finite."""
    return "unknown" if value is None else f"{value:.{decimals}f}"


def _fit(findings: Findings) -> Check:
    share = np.array(findings.summary["fit"]["relative_residual"])
    joint = int(share.argmax())
    said = f"the model leaves {share.min():.1%} to {share.max():.1%} of a joint's effort, most in joint {joint + 1}"
    edge = findings.summary["fit"]["links_on_edge"]
    if edge:
        said += f"; the parameters of link {', '.join(map(str, edge))} sit on the edge of what is physically feasible"
    if share.max() > POOR:
        return Check("Fit", "bad", said, f"a term is missing, or signs are wrong: {_DISCREPANCY}")
    if share.max() > _SMALL or edge:
        return Check("Fit", "look", said, _DISCREPANCY)
    return Check("Fit", "good", said)


_DISCREPANCY = "`bayesid discrepancy` names what the model lacks"


def _whiteness(findings: Findings) -> Check:
    noise = findings.summary["noise"]
    lasting = (np.array(noise["coloured_sd"]) / np.array(noise["sd"])) ** 2
    joint = int(lasting.argmax())
    count = np.array(noise["samples_that_count_as_one"]).max()
    said = (
        f"up to {lasting.max():.0%} of the residual's variance lasts longer than sensor noise (joint {joint + 1}), so "
        f"that up to {count:.0f} samples count as one"
    )
    if lasting.max() <= _WHITE:
        return Check("Whiteness of the residual", "good", said)
    remedy = f"the standard deviations allow for it, but something is missing from the model: {_DISCREPANCY}"
    return Check("Whiteness of the residual", "look", said, remedy)  # how large it is, the fit tells


def _decided(findings: Findings) -> Check:
    told, prior = findings.coefficients, len(findings.prior_parameters)
    count, by_data = len(told.mean), int(told.by_data.sum())
    poor = int((told.relative_sd > 1.0).sum())
    said = (
        f"the data decide {by_data} of {count} coefficients; {poor} are smaller than their standard deviation; {prior} "
        "single parameters rest on the prior, as efforts show them only in sums"
    )
    remedy = f"{_EXCITE}; or give what you know by --nominal"
    if by_data >= _MOSTLY * count:
        return Check("Data or prior", "good", said)
    return Check("Data or prior", "look" if by_data >= 0.5 * count else "bad", said, remedy)


def _validation(findings: Findings) -> Check:
    seen = findings.prediction
    if seen is None:
        said = "the model has not been tried on a log that it has not seen"
        return Check("Validation", "not done", said, "run `bayesid report RESULT --validation ANOTHER_LOG`")
    share, own = seen.relative_residual, np.array(findings.summary["noise"]["residual_sd"])
    said = (
        f"on {seen.source} it leaves {share.min():.1%} to {share.max():.1%} of a joint's effort, and "
        f"{seen.coverage.min():.0%} to {seen.coverage.max():.0%} of the efforts lie in the bands of 95 %"
    )
    if share.max() > POOR:
        return Check("Validation", "bad", said, f"do not use the model for this motion; {_DISCREPANCY}")
    covered = _COVERED[0] <= seen.coverage.min() and seen.coverage.max() <= _COVERED[1]
    if covered and np.all(seen.rms_error <= _WORSE * own):
        return Check("Validation", "good", said)
    return Check("Validation", "look", said, f"other loads, speeds or temperatures than in the log? {_DISCREPANCY}")


def _warnings(findings: Findings) -> Check:
    count = len(findings.summary["warnings"])
    if not count:
        return Check("Warnings", "good", "none")
    told = f"{count}, listed above" if count > 1 else "one, above"
    return Check("Warnings", "look", told, "read them: some say what to do")
