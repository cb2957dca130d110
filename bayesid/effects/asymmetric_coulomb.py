"""Coulomb friction that differs between the two directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.effect import Phrase
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class AsymmetricCoulomb(DryTerm):
    """Fp where u' > 0, -Fm where u' < 0; Fp, Fm >= 0."""

    name = "asymmetric_coulomb"
    physics = "Dry friction of different size in the two directions: a worm gear, a preloaded seal."
    reference = "Armstrong-Helouvry, Control of Machines with Friction, 1991"
    variable = "velocity"
    shown_by = "moving both ways at equal speeds through the same positions"
    phrase = Phrase(
        "{who} needs dry friction that depends on the direction: {Fp} forwards and {Fm} backwards.",
        "asymmetric Coulomb friction",
    )
    symbols = ("Fp", "Fm")
    units = (("N m", "N"), ("N m", "N"))
    nonnegative = True

    def unit_efforts(self, actuators: Motion) -> Array:
        """The direction of motion, forwards and backwards."""
        direction = self.direction(actuators)
        return np.stack([np.maximum(direction, 0.0), np.minimum(direction, 0.0)], axis=2)
