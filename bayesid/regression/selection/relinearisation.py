"""Distortions about the numbers that were found: they are linear in these near them alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Scene
from bayesid.regression.selection.explanation import Explanation, Observations
from bayesid.regression.selection.extension import moved
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.scores import explain_with

_RELINEARISATIONS = 3
"""Of distortions about their own numbers: Newton's method, whose error falls with the square each time."""
_STILL = 1e-4
"""Of an amplitude's prior standard deviation, up to which a number does not move: nobody would see it."""


def sharpened(
    data: Observations, effects: Sequence[Hypothesis], columns: Array, scene_of: Callable[[Array], Scene]
) -> tuple[list[Hypothesis], Explanation]:
    """The effects linearised about the numbers that were found, and the explanation by them.

    Args:
        data: what is to be explained.
        effects: some of them distortions, or none.
        columns: (N, n, r) of the model, at samples that are not used too.
        scene_of: what effects may look at, given the efforts (N, n) of model and terms, N m.
    """
    effects = list(effects)
    _, explanation = explain_with(data, effects)
    for _ in range(_RELINEARISATIONS):
        if not _moves(effects, explanation):
            break
        shifted = moved(effects, explanation)
        scene = scene_of(
            columns @ explanation.beta + effort_of_terms(effects, explanation.amplitudes, data.effort.shape)
        )
        effects = about(shifted, scene)
        _, explanation = explain_with(data, effects, explanation)
    return effects, explanation


def _moves(effects: Sequence[Hypothesis], explanation: Explanation) -> bool:
    """Whether a distortion is still on its way, by more than nobody would see, or what it does may be."""
    pairs = zip(effects, explanation.amplitudes, strict=True)
    distortions = [(effect, amplitude) for effect, amplitude in pairs if not effect.source.linear]
    if any(effect.source.of_effort for effect, _ in distortions):
        return True
    return any(np.any(np.abs(amplitude) > _STILL * effect.columns.sd) for effect, amplitude in distortions)


def about(effects: Sequence[Hypothesis], scene: Scene) -> list[Hypothesis]:
    """The effects linearised where a scene is, about their own numbers."""
    return [_relinearised(effect, scene) for effect in effects]


def effort_of_terms(effects: Sequence[Hypothesis], amplitudes: Sequence[Array], shape: tuple[int, ...]) -> Array:
    """(N, n) efforts of the terms among the effects, N m, of an amplitude (p,) each."""
    effort = np.zeros(shape)
    for effect, amplitude in zip(effects, amplitudes, strict=True):
        if effect.source.linear:
            for j, rows in effect.columns.rows.items():
                effort[:, j] += rows @ amplitude
    return effort


def _relinearised(effect: Hypothesis, scene: Scene) -> Hypothesis:
    if effect.source.linear:
        return effect
    shift, columns = effect.source.change(scene)
    acting = sorted(effect.columns.joints)
    rows = {j: columns[:, j] for j in acting} if columns.shape[2] else {}
    return replace(effect, columns=replace(effect.columns, rows=rows, shift={j: shift[:, j] for j in acting}))
