"""A log as a model is to explain it: what travels together from the search to the posterior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals, signed_effort
from bayesid.regression.knowledge import Information
from bayesid.regression.moments import Moments, moments
from bayesid.regression.noise import Noise, residual_noise
from bayesid.regression.nuisance import Nuisance


@dataclass(frozen=True)
class Evidence:
    """A model, a log, and which of its N samples count.

    Attributes:
        model: robot and terms.
        coefficients: its r base coefficients.
        signals: the log.
        moving: (N, n) samples in motion.
        fitted: (N, n) those of them that a fit rests on.
        information: of the coefficients, from earlier logs; None without one.
        nuisance: effects that the model may lack, to be summed out; None without any.
    """

    model: Model
    coefficients: BaseCoefficients
    signals: Signals
    moving: Mask
    fitted: Mask
    information: Information | None = None
    nuisance: Nuisance | None = None

    @classmethod
    def of(cls, model: Model, signals: Signals, moving: Mask) -> Evidence:
        """A fit may rest on all samples in motion (N, n), and nothing is known beforehand."""
        return cls(model, base_coefficients(model), signals, moving, moving)

    @cached_property
    def used(self) -> Mask:
        """(N, n) samples that a fit rests on, but for both ends of the log."""
        return self.fitted & self.signals.inner

    def residual_noise(self, predicted: Array) -> Noise:
        """Of the residual (N, n) of a prediction, N m, unknown signs as predicted, over the samples used."""
        residual = np.where(self.used, self.signals.nearest(predicted) - predicted, 0.0)
        return residual_noise(residual, self.used, self.signals.rate)

    @property
    def columns(self) -> Array:
        """(N, n, r) of the coefficients."""
        columns = np.empty((len(self.signals.motion), self.model.robot.n_joints, len(self.coefficients)))
        for place, rows in self.chunks():
            columns[place] = rows
        return columns

    def chunks(self) -> Iterator[tuple[slice, Array]]:
        """Rows and their columns (N', n, r) of the coefficients, some samples at a time."""
        kept = self.coefficients.kept
        return ((place, rows.chosen(kept).dense) for place, rows in self.model.felt_chunks(self.signals.motion))

    def moments(
        self,
        signs: Array,
        segments: Segments,
        most_individual: int | None = None,
        orientation: Array | None = None,
        *,
        summed_out: bool = True,
    ) -> Moments:
        """Moments of the unfiltered efforts (a filter would blur friction's steps, not the columns') in expected signs.

        Where a nuisance is summed out, the sign of a segment turns with it what the nuisance has explained there: that
        is exact at the expected signs, and elsewhere to the first order in the nuisance's share of the effort.

        Args:
            signs: (N, n) expected sign of every sample, -1 to +1.
            segments: where to sum.
            most_individual: segments of each joint with a Hessian of their own (see `regression.moments.moments`).
            orientation: (N, n) +1 or -1, the signs of the segments, by which efforts are multiplied in the end.
            summed_out: whether a nuisance is; it changes no estimate of least squares, only its covariance.
        """
        effort, square = signed_effort(self.signals, signs, filtered=False), self.signals.raw_effort**2
        correct = None
        if summed_out and self.nuisance is not None:
            whitened = self.nuisance.whiten(effort)
            correct = partial(self.nuisance.without, shared=self.nuisance.of_model)
            square, effort = square - effort**2 + whitened**2, whitened
        if orientation is not None:
            effort = effort * np.where(self.signals.signed, 1.0, orientation)
        return moments(
            self.model,
            self.coefficients,
            self.signals.motion,
            effort,
            segments,
            most_individual,
            square=square,
            correct=correct,
        )
