"""What a posterior is of: a log's moments and noise, and what is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.posterior.blocks import SegmentBlocks
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.prior import make_prior
from bayesid.posterior.target import Target
from bayesid.regression.knowledge import Information, Links, Nominal
from bayesid.regression.moments import Moments
from bayesid.regression.noise import Noise
from bayesid.regression.solver import ConeLeastSquares

_LEAST_NOISE = 1e-3
"""Noise that no effort is free of, as a share of its RMS. A round number; not studied."""


@dataclass(frozen=True)
class PosteriorProblem:
    """All that decides a posterior but the signs.

    Attributes:
        blocks: of S segments, efforts in expected signs relative to their segment's.
        coefficients: the r base coefficients.
        cone: of the P parameters.
        noise: of the efforts; the reference of the noise scales.
        links: what is believed of any link.
        nominal: what is stated of the parameters.
        information: of the r coefficients, from an earlier log. Its c says what effort it explains: sizes are judged
            by it.
    """

    blocks: SegmentBlocks
    coefficients: BaseCoefficients
    cone: Cone
    noise: Noise
    links: Links
    nominal: Nominal | None = None
    information: Information | None = None

    def with_least_noise(self) -> PosteriorProblem:
        """The same problem with a thousandth of each effort added to its noise, and to what the residual shows."""
        floor = _LEAST_NOISE * self.moments.rms_effort(len(self.noise.sigma))
        noise = self.noise.scaled(np.hypot(self.noise.sigma, floor) / self.noise.sigma)
        energy = (1.0 + _LEAST_NOISE**2) * self.blocks.moments.energy
        return replace(
            self, noise=noise, blocks=replace(self.blocks, moments=replace(self.blocks.moments, energy=energy))
        )

    @cached_property
    def moments(self) -> Moments:
        """Of the segments, not scaled."""
        return self.blocks.of_segments

    @cached_property
    def target(self) -> Target:
        """What is sampled: all signs summed out that are not known."""
        unknown = np.zeros(len(self.moments), dtype=np.int64)
        likelihood = make_likelihood(
            self.moments, self.coefficients, self.noise.sigma, self.noise.autocorrelation, unknown
        )
        prior = make_prior(self.cone, likelihood, self.links, self.nominal, information=self.information)
        return Target(prior, likelihood, self.information)

    @cached_property
    def scaled_moments(self) -> Moments:
        """In units of the reference noise."""
        return self.moments.scaled(self.noise.sigma * np.sqrt(self.noise.autocorrelation))

    @cached_property
    def solver(self) -> ConeLeastSquares:
        """For the scaled moments and the information, added."""
        hessian, energy = self.scaled_moments.hessian.total(), float(self.scaled_moments.energy.sum())
        if self.information is not None:
            hessian, energy = hessian + self.information.hessian, energy + self.information.energy
        return ConeLeastSquares(self.cone, self.coefficients, hessian, energy)
