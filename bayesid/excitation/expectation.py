"""What is expected of a robot before any log: plausible parameters, and what a motion would show of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.resolvability import JointFlips, expected_noise, turn_joints
from bayesid.motion import Motion
from bayesid.regression.knowledge import Beliefs
from bayesid.simulation.parameters import random_parameters

_ROBOTS = 3
"""For which a motion is designed and judged; each costs as much as the first. Not studied."""
_DECIDED = 0.5
"""Share of its usual size that a coefficient's standard deviation may have where the log decides it: it is two standard
deviations from zero then."""
_SIZED = 24
"""Robots from which a coefficient's usual size is taken: it is known to 1 / sqrt(48), 15 %."""
_LOUDEST = 10.0
"""Noise relative to the RMS effort, beyond which nothing is shown at all."""


@dataclass(frozen=True)
class Expectation:
    """K plausible robots with the same kinematics.

    Attributes:
        model: robot and terms.
        coefficients: its r base coefficients.
        thetas: (K, P) their parameters.
        size: (r,) RMS of each coefficient over many such robots: how uncertain it is beforehand.
    """

    model: Model
    coefficients: BaseCoefficients
    thetas: Array
    size: Array

    @property
    def betas(self) -> Array:
        """(K, r) their base coefficients."""
        return self.coefficients.project(self.thetas)

    def columns(self, motion: Motion) -> Array:
        """(N, n, r) base regressor."""
        return self.model.columns(motion)[:, :, self.coefficients.kept]

    def joint_flips(
        self, grams: Array, samples: int | Integers, noise: float, weight: float, groups: tuple[tuple[int, ...], ...]
    ) -> list[JointFlips]:
        """(K) what turning groups of joints weighs for each of the robots.

        Args:
            grams: (n, r, r) Gram matrices of the joints' rows.
            samples: that each of them holds.
            noise: relative to each joint's RMS effort.
            weight: independent samples that each sample stands for.
            groups: 0-based joints.
        """
        sigma = [expected_noise(grams, beta, samples, noise)[:, None, None] for beta in self.betas]
        pairs = zip(self.betas, sigma, strict=True)
        return [turn_joints(weight * grams / noise_sd**2, beta, groups) for beta, noise_sd in pairs]

    def uncertainty(self, grams: Array, samples: int | Integers, noise: float, weight: float) -> Array:
        """(r,) standard deviation of each coefficient after a log whose signs are known, over its size beforehand.

        It is that of the posterior (H + S^-2)^-1, S = diag(size), which has no singularity: 1 says that the log shows
        nothing. The noise is that of the robots on average.

        Args:
            grams: as above.
            samples: as above.
            noise: as above.
            weight: as above.
        """
        sigma = np.sqrt(np.mean([expected_noise(grams, beta, samples, noise) ** 2 for beta in self.betas], axis=0))
        hessian = np.einsum("j,jrs->rs", weight / sigma**2, grams)
        precision = self.size[:, None] * hessian * self.size + np.eye(len(self.size))
        return np.sqrt(np.diag(np.linalg.inv(precision)))


def expect(model: Model, seed: int = 0, beliefs: Beliefs = Beliefs()) -> Expectation:
    """Draws robots that are plausible for a model.

    Args:
        model: robot and terms.
        seed: of the draws.
        beliefs: parameters known beforehand take the place of drawn ones.

    Raises:
        InputError: the model has no such parameter.
    """
    rng, coefficients = np.random.default_rng(seed), base_coefficients(model)
    drawn = np.array([random_parameters(model, rng) for _ in range(_SIZED)])
    size = np.sqrt(np.mean(coefficients.project(drawn) ** 2, axis=0))
    stated = beliefs.of(model.parameters).mean
    return Expectation(model, coefficients, np.where(np.isnan(stated), drawn, stated)[:_ROBOTS], size)


def undecided(uncertainty: Array) -> tuple[int, ...]:
    """Coefficients of which more than half of the usual size is left open."""
    return tuple(np.flatnonzero(uncertainty > _DECIDED).tolist())


def check_noise(noise: float) -> None:
    """A noise relative to the RMS efforts can be used.

    Raises:
        InputError: it cannot.
    """
    if not 0.0 < noise <= _LOUDEST:
        raise InputError(
            f"a noise of {noise:g} cannot be used", field="noise", remedy="give a share of the RMS effort, as 0.05"
        )
