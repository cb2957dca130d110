"""A log whose signs are settled, as effects are looked for in it: on thinned rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.effect import Effect, Scene
from bayesid.log.signals import Signals
from bayesid.parallel import in_parallel
from bayesid.regression.evidence import Evidence
from bayesid.regression.knowledge import Information
from bayesid.regression.least_squares import Fit
from bayesid.regression.selection.explanation import Observations
from bayesid.regression.selection.forward import Candidate, Products
from bayesid.regression.selection.hypotheses import Hypothesis, hypotheses_of, kinds_of_forms, maker
from bayesid.regression.selection.relinearisation import about, effort_of_terms, sharpened
from bayesid.regression.selection.scores import BestOfGroup, best_groups
from bayesid.regression.selection.screening import Screening

_SAMPLES = 2_500
"""Samples on which effects are selected, thinned evenly: time grows with them. A round number."""
_SLOWEST = 25.0
"""Hz; a log is not thinned below it, for friction turns round within a tenth of a second: of a longer one stretches are
taken."""
_MOVED = 0.1
"""Share of a joint's effort by which the model's effort may change with what has entered before it shows in what a
distortion would do. A round number; not studied."""
_STRETCHES = 8
"""Of a log that is too long. A round number."""


@dataclass(frozen=True)
class SignedLog:
    """A log with its signs settled, as effects are looked for in it.

    Attributes:
        evidence: the model, the log, and which samples count.
        fit: of the model to the log.
        rows: of the log, thinned.
        data: the log on these rows.
        columns: (N, n, r) of the model there, at samples that are not used too.
    """

    evidence: Evidence
    fit: Fit
    rows: Integers
    data: Observations
    columns: Array

    @classmethod
    def of(cls, evidence: Evidence, fit: Fit, probability: Array) -> SignedLog:
        """With efforts in their expected signs, of (N, n) P(sign = +)."""
        residual = fit.residual
        signals, (rows, rate) = evidence.signals, thinned(evidence.signals)
        used = evidence.used[rows]
        columns = evidence.model.columns(signals.motion[rows])[:, :, evidence.coefficients.kept]
        effort = np.where(signals.signed, signals.raw_effort, (2.0 * probability - 1.0) * signals.magnitude)[rows]
        data = Observations(
            columns=columns * used[:, :, None],
            effort=effort * used,
            used=used,
            information=Information.none(columns.shape[2]),
            floor=residual.sigma,
            sharp=np.ones(len(residual.sigma), dtype=bool),
            limits=np.stack([residual.white, residual.coloured], axis=1),
            rate=rate,
        )
        return cls(evidence, fit, rows, data, columns)

    @property
    def rms_effort(self) -> Array:
        """(n,) N m."""
        used = self.data.used
        return np.sqrt((self.data.effort**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1))

    def sharpened(
        self, products: Products[Hypothesis], chosen: Sequence[Candidate[Hypothesis]]
    ) -> Mapping[int, Hypothesis]:
        """Distortions as they are near what has been found, by the ids of their old forms.

        Those that were chosen are linearised about their own numbers; where the effort of the model with the chosen
        effects is another one by now, all others are linearised anew for it.
        """
        effects = [candidate.hypothesis for candidate in chosen]
        best = products.best(chosen)
        beta, amplitudes = best[: self.columns.shape[2]], [best[candidate.place] for candidate in chosen]
        forms: dict[int, Hypothesis] = {}
        if not all(effect.source.linear for effect in effects):
            sharp, explanation = sharpened(self.data, effects, self.columns, self.scene)
            forms = {id(old): new for old, new in zip(effects, sharp, strict=True)}
            beta, amplitudes = explanation.beta, list(explanation.amplitudes)
        effort = self.columns @ beta + effort_of_terms(effects, amplitudes, self.data.effort.shape)
        change = np.where(self.data.used, effort - self.fit.predicted[self.rows], 0.0)
        moved = np.sqrt((change**2).sum(axis=0) / np.maximum(self.data.used.sum(axis=0), 1)) > _MOVED * self.rms_effort
        if moved.any():
            others = [h for h in products.hypotheses if not h.source.linear and all(h is not e for e in effects)]
            forms |= {id(old): new for old, new in zip(others, about(others, self.scene(effort)), strict=True)}
        return forms

    def scene(self, effort: Array) -> Scene:
        """What effects may look at."""
        signals, model = self.evidence.signals, self.evidence.model
        return model.scene(signals.motion[self.rows], self.fit.theta, effort, signals.magnitude[self.rows])

    def made(self, effects: Sequence[Effect]) -> list[Hypothesis]:
        """Effects as what they would do to the log; distortions last, what leaves no trace left out."""
        made = (self._make(effect) for effect in effects)
        return sorted((h for h in made if h.columns.joints), key=lambda hypothesis: not hypothesis.source.linear)

    def library(self, joint: int) -> list[list[Hypothesis]]:
        """All forms in a (0-based) joint that a first log can tell from the model's own parameters and can resolve."""
        kinds = kinds_of_forms(refinements=True)
        return [group for kind in kinds for group in self._tellable(kind, (joint + 1,))]

    def screened(self, screening: Screening, most: int) -> list[Hypothesis]:
        """The most promising effects of the library, each in its best form, best first."""
        kinds = kinds_of_forms(refinements=True)
        groups = [one for some in in_parallel([partial(self._best, screening, kind) for kind in kinds]) for one in some]
        best = [groups[k] for k, _ in best_groups(groups)[:most]]
        made = [(self._make(one.source), one.sd) for one in best]
        return [replace(one, columns=replace(one.columns, sd=sd)) for one, sd in made]

    def _best(self, screening: Screening, kind: type[Effect]) -> list[BestOfGroup]:
        return [BestOfGroup.of(screening, group) for group in self._tellable(kind)]

    def _tellable(self, kind: type[Effect], joints: tuple[int, ...] | None = None) -> list[list[Hypothesis]]:
        """The forms of one kind; in some joints (from 1) alone, if they are given."""
        groups = hypotheses_of(kind, self._make, self._scene, joints)
        testable = ([h for h in group if _testable(h, self._scene)] for group in groups)
        return [group for group in testable if group]

    @cached_property
    def _scene(self) -> Scene:
        return self.scene(self.fit.predicted[self.rows])

    @cached_property
    def _make(self) -> Callable[[Effect], Hypothesis]:
        return maker(self.evidence.model, self._scene, self.data.used)


def _testable(hypothesis: Hypothesis, scene: Scene) -> bool:
    new = not hypothesis.changes and not hypothesis.source.needs_earlier
    return new and hypothesis.source.resolved(scene)


def thinned(signals: Signals) -> tuple[Integers, float]:
    """Evenly spread rows of a log, stretches of it if it is very long, and their rate, Hz."""
    count = len(signals.motion)
    step = min(-(-count // _SAMPLES), max(1, int(signals.rate / _SLOWEST)))
    rows = np.arange(0, count, step)
    if len(rows) > 2 * _SAMPLES:
        length = _SAMPLES // _STRETCHES
        starts = np.linspace(0, len(rows) - length, _STRETCHES).astype(int)
        rows = np.concatenate([rows[start : start + length] for start in starts])
    return rows, signals.rate / step
