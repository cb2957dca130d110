"""What is expected of a robot before any log: plausible parameters, and what a motion would tell of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesid.coefficients import BaseCoefficients, base_coefficients
from bayesid.excitation.resolvability import JointFlips, expected_noise, turn_joints
from bayesid.model import Model
from bayesid.motion import Array, Integers, Motion
from bayesid.nominal import nominal_of
from bayesid.simulation import random_parameters

_ROBOTS = 3
"""For which a motion is designed and judged."""
_HALF = 0.5
"""Share of its usual size that a coefficient's standard deviation may have where the log decides it."""
_SIZED = 24
"""From which a coefficient's usual size is taken."""


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
        found = []
        for beta in self.betas:
            sigma = expected_noise(grams, beta, samples, noise)
            found.append(turn_joints(weight * grams / sigma[:, None, None] ** 2, beta, groups))
        return found

    def left(self, grams: Array, samples: int | Integers, noise: float, weight: float) -> Array:
        """(r,) standard deviation of each coefficient after a log whose signs are known, over its size beforehand.

        It is that of the posterior (H + S^-2)^-1, S = diag(size), which has no singularity: 1 says that the log tells
        nothing. The noise is that of the robots on average.

        Args:
            grams: as above.
            samples: as above.
            noise: as above.
            weight: as above.
        """
        sigma = np.sqrt(np.mean([expected_noise(grams, beta, samples, noise) ** 2 for beta in self.betas], axis=0))
        hessian = np.einsum("j,jrs->rs", weight / sigma**2, grams)
        told = self.size[:, None] * hessian * self.size + np.eye(len(self.size))
        return np.sqrt(np.diag(np.linalg.inv(told)))


def expect(model: Model, seed: int = 0, nominal: Mapping[str, tuple[float, float]] | None = None) -> Expectation:
    """Draws robots that are plausible for a model.

    Args:
        model: robot and terms.
        seed: of the draws.
        nominal: parameters known beforehand, name to mean and standard deviation; they take the place of drawn ones.

    Raises:
        InputError: the model has no such parameter.
    """
    rng, coefficients = np.random.default_rng(seed), base_coefficients(model)
    drawn = np.array([random_parameters(model, rng) for _ in range(_SIZED)])
    size = np.sqrt(np.mean(coefficients.project(drawn) ** 2, axis=0))
    known = np.full(drawn.shape[1], np.nan) if nominal is None else nominal_of(model, nominal).mean
    return Expectation(model, coefficients, np.where(np.isnan(known), drawn, known)[:_ROBOTS], size)


def undecided(left: Array) -> tuple[int, ...]:
    """Coefficients of which more than half of the usual size is left open."""
    return tuple(np.flatnonzero(left > _HALF).tolist())
