"""The choice of effects: on some of the data, each checked on the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid import terms
from bayesid.discrepancy.case import Case
from bayesid.discrepancy.compare import Floor, Trial
from bayesid.discrepancy.evidence import LN10, Data, Explanation
from bayesid.discrepancy.extension import Extension, extend, moved
from bayesid.discrepancy.hypotheses import Hypothesis, hypotheses
from bayesid.discrepancy.scores import THRESHOLD, WORTH, explain_with
from bayesid.discrepancy.selection import Selection, select
from bayesid.distortions.base import Distortion
from bayesid.motion import Array, Mask
from bayesid.signs import Progress
from bayesid.terms.base import Scene

_BETTER = 3.0
"""How many times more an effect must help on unseen data than harm."""
_STRETCHES = 24
"""Of the unseen data, in each of which it may do either."""
_VETOES = 4
"""Effects that fail on unseen data before the search for others is given up."""
_ABOVE, _ABOVE_BLUNT = 1.25, 1.6
"""Residual over floor from which on a joint is not explained: where the floor holds what lasts of the noise, or not."""
_OWED = 0.75
"""Share of a joint's excess that its effects must explain, where some of it stays unexplained."""
_ROUNDS = 3
_SETTLINGS = 2


@dataclass(frozen=True)
class Chosen:
    """Effects that explain a log and survive on unseen data.

    Attributes:
        selection: these effects and their explanation.
        data: that they were chosen on, signs settled under them.
        library: all hypotheses.
        extension: the extended model.
        vetoed: effect and joints that unseen data did not bear out.
    """

    selection: Selection
    data: Data
    library: list[list[Hypothesis]]
    extension: Extension
    vetoed: tuple[tuple[str, tuple[int, ...]], ...]


@dataclass
class Choice:
    """Chooses effects on some data and checks each on others."""

    case: Case
    progress: Progress | None
    vetoed: set[tuple[str, tuple[int, ...]]] = field(default_factory=set)
    closed: set[int] = field(default_factory=set)

    def run(self) -> Chosen:
        """Effects that explain the log and survive on unseen data."""
        data, library = self._begin()
        data, selection, first = self._borne_out(data, library)
        data, selection = self._without_makeshifts(data, selection)
        found, explanation = self._sharpened(data, selection.hypotheses)
        selection = replace(first, hypotheses=tuple(found), explanation=explanation)
        extension = extend(self.case.knowledge, self.case.coefficients, found, explanation)
        return Chosen(selection, data, library, extension, tuple(sorted(self.vetoed)))

    def _borne_out(self, data: Data, library: list[list[Hypothesis]]) -> tuple[Data, Selection, Selection]:
        """Effects chosen until unseen data bear all of them out; and the first choice."""
        first = selection = select(data, library, (), self._resettle, self._allowed)
        for done in range(_VETOES):
            self._tell(done)
            data = self._resettle(data, selection.hypotheses, selection.explanation)
            worse = self._fails(data, selection.hypotheses)
            if worse is None:
                return data, selection, first
            self.vetoed.add((worse.effect, worse.joints))
            self.closed |= worse.columns.joints & set(self._unexplained(selection))
            kept = [one for one in selection.hypotheses if one is not worse]
            if worse.columns.joints <= self.closed:
                kept = kept[: selection.hypotheses.index(worse)]
            selection = select(data, library, kept, self._resettle, self._allowed)
        while (worse := self._fails(data, selection.hypotheses)) is not None:  # no more is added, what fails goes
            self.vetoed.add((worse.effect, worse.joints))
            left = tuple(one for one in selection.hypotheses if one is not worse)
            selection = replace(selection, hypotheses=left, explanation=explain_with(data, left)[1])
        return data, selection, first

    def _without_makeshifts(self, data: Data, selection: Selection) -> tuple[Data, Selection]:
        """Leaves out effects of joints that stay unexplained, unless they explain most of what was to be explained."""
        for joint in self._unexplained(selection):
            here = [one for one in selection.hypotheses if one.columns.joints == {joint}]
            used = self.case.unseen.trial.used[:, joint]
            others = [one for one in selection.hypotheses if one not in here]
            _, without = explain_with(data, others, selection.explanation)
            before = np.mean(self._left(others, without)[used, joint] ** 2)
            after = np.mean(self._left(selection.hypotheses, selection.explanation)[used, joint] ** 2)
            if here and before - after < _OWED * (before - data.floor[joint] ** 2):
                self.vetoed |= {(one.effect, one.joints) for one in here}
                data = self._resettle(data, others, without)
                selection = replace(selection, hypotheses=tuple(others), explanation=explain_with(data, others)[1])
        return data, selection

    def _begin(self) -> tuple[Data, list[list[Hypothesis]]]:
        """Signs settled under the model, its parameters moved as far as the earlier log allows."""
        case, predicted = self.case, self.case.before
        for _ in range(_SETTLINGS):
            _, now = explain_with(case.data(predicted), ())
            predicted = case.predicted((), now)
        library = list(hypotheses(case.model, case.scene(predicted), case.trial.used))
        other = case.second_opinion
        return case.data(predicted, None if other is None else other.probability), library

    def _resettle(self, data: Data, found: Sequence[Hypothesis], now: Explanation) -> Data:
        return self.case.data(self.case.predicted(found, now))

    def _allowed(self, one: Hypothesis) -> bool:
        return (one.effect, one.joints) not in self.vetoed and not one.columns.joints <= self.closed

    def _unexplained(self, selection: Selection) -> list[int]:
        """(0-based) joints whose residual these effects leave above the floor."""
        predicted = self.case.predicted(selection.hypotheses, selection.explanation)
        floor = self.case.floor(predicted)
        return [joint - 1 for joint, _ in unexplained(self.case.trial, predicted, floor, selection.explanation)]

    def _fails(self, data: Data, found: Sequence[Hypothesis]) -> Hypothesis | None:
        """The first effect that does not help on unseen data, given those before it."""
        used = self.case.unseen.trial.used
        _, now = explain_with(data, ())
        left = self._left((), now)
        for count in range(1, len(found) + 1):
            _, now = explain_with(data, found[:count], now)
            after = self._left(found[:count], now)
            acts = sorted(found[count - 1].columns.joints)
            standard = found[count - 1].source.name in terms.DEFAULT
            if not _survives(left[:, acts], after[:, acts], used[:, acts], data.floor[acts], standard):
                return found[count - 1]
            left = after
        return None

    def _left(self, found: Sequence[Hypothesis], now: Explanation) -> Array:
        """(N, n) residuals on unseen data, N m."""
        case, trial = self.case, self.case.unseen.trial
        extension = extend(case.knowledge, case.coefficients, found, now)
        if any(isinstance(one.source, Distortion) and one.source.reveals for one in found):
            extension = case.refitted(extension, case.predicted(found, now))
        predicted = extension.model.effort(trial.signals.motion, extension.theta)
        return trial.nearest(predicted) - predicted

    def _sharpened(self, data: Data, found: Sequence[Hypothesis]) -> tuple[list[Hypothesis], Explanation]:
        """Distortions made exact about the numbers that were found."""
        found = list(found)
        _, now = explain_with(data, found)
        for _ in range(_ROUNDS if any(isinstance(one.source, Distortion) for one in found) else 0):
            shifted = moved(found, now)
            scene = self.case.scene(self.case.columns @ now.beta + self._terms_effort(found, now))
            found = [_relinearised(one, scene) for one in shifted]
            _, now = explain_with(data, found, now)
        return found, now

    def _terms_effort(self, found: Sequence[Hypothesis], now: Explanation) -> Array:
        """(N, n) efforts of the terms among the effects, N m."""
        effort = np.zeros(self.case.before.shape)
        for one, amplitude in zip(found, now.amplitudes, strict=True):
            if not isinstance(one.source, Distortion):
                for j, rows in one.columns.rows.items():
                    effort[:, j] += rows @ amplitude
        return effort

    def _tell(self, done: int) -> None:
        if self.progress is not None:
            self.progress("naming effects", done, _VETOES + 1)


def _relinearised(one: Hypothesis, scene: Scene) -> Hypothesis:
    if not isinstance(one.source, Distortion):
        return one
    shift, columns = one.source.change(scene)
    acting = sorted(one.columns.joints)
    rows = {j: columns[:, j] for j in acting} if columns.shape[2] else {}
    return replace(one, columns=replace(one.columns, rows=rows, shift={j: shift[:, j] for j in acting}))


def _survives(before: Array, after: Array, used: Mask, floor: Array, standard: bool) -> bool:
    """Whether unseen data bear an effect out, by the fall of their squared residuals in units of the noise floor's.

    Over stretches of the log it must help three times as much as it harms (for a normal distribution of the stretches'
    means that is two standard errors), and in one of its joints it must be half of what an effect must be worth to be
    chosen at all. What every robot has need only do no harm.
    """
    fall = (before**2 - after**2) * used / floor**2
    seen = used.any(axis=1)
    blocks = np.array([block.sum() for block in np.array_split(fall[seen].sum(axis=1), _STRETCHES)])
    helps, harms = float(np.maximum(blocks, 0.0).sum()), float(np.maximum(-blocks, 0.0).sum())
    if standard:
        return helps - harms > -float(blocks.std()) * np.sqrt(len(blocks))
    worth = fall.sum(axis=0) / np.maximum(used.sum(axis=0), 1)
    return helps > _BETTER * harms and bool(worth.max() > 0.5 * WORTH)


def exceeds(gap: float, floor: Floor, joint: int) -> bool:
    """Whether a gap, N m, is too large for the noise of a (0-based) joint."""
    return bool(gap > (_ABOVE if floor.sharp[joint] else _ABOVE_BLUNT) * floor.rms[joint])


def unexplained(trial: Trial, predicted: Array, floor: Floor, now: Explanation) -> tuple[tuple[int, float], ...]:
    """Joint (from 1) and ratio to the floor, of those whose residual is surely above it."""
    gap = trial.gap(predicted)
    sure = now.anything - now.noise > THRESHOLD * LN10
    return tuple(
        (j + 1, float(gap[j] / floor.rms[j])) for j in range(len(gap)) if sure[j] and exceeds(gap[j], floor, j)
    )
