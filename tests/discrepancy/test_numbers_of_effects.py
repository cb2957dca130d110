"""Numbers of added effects, from a made-up posterior."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import small_robot

from bayesid.discrepancy.numbers import Numbers
from bayesid.effects.bodies import Payload
from bayesid.effects.friction import CoulombFriction, ThermalDrift
from bayesid.effects.model import Model
from bayesid.regression.selection.columns import NO_COLUMNS
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.robot.inertia import NAMES

FRICTION = CoulombFriction(smoothing=(0.1, 0.1))
DRIFT = ThermalDrift(joints=(2,), smoothing=(0.1,), time=(60.0,))
EARLIER = Model(small_robot(2), (FRICTION,))
BEFORE = np.array([3.0, 9.1])
THETA = np.array([3.5, 8.0, -0.7, 0.4])
"""Fc1, Fc2, Fcold2, Fwarm2 of the extended model."""


def hypothesis(source, changes=()):
    return Hypothesis(source, NO_COLUMNS, hypothesis, changes)


def extended(model, theta, draws=None):
    """The used members of an identification; draws (D, E, W, P)."""
    posterior = None if draws is None else SimpleNamespace(uncertain=SimpleNamespace(theta=draws))
    sd = np.full(len(theta), 0.25)
    return SimpleNamespace(model=model, theta=theta, posterior=posterior, parameter_sd=(sd, sd > 0.0))


def test_additions_to_earlier_parameters_are_summed_with_their_sd():
    """Coulomb friction and the cold part of the drift are anticorrelated: their sum has a smaller sd."""
    rng = np.random.default_rng(2)
    draws = THETA + rng.normal(size=(40, 2, 5, 4)) * [0.1, 0.5, 0.0, 0.2]
    draws[..., 2] = -0.7 - (draws[..., 1] - 8.0) + 0.05 * rng.normal(size=(40, 2, 5))
    numbers = Numbers(EARLIER, BEFORE, extended(EARLIER.extend(DRIFT), THETA, draws))
    parameters = numbers.parameters(hypothesis(DRIFT))
    assert parameters["Fcold2"][0] == -0.7
    assert parameters["Fc2"][0] == pytest.approx(7.3)
    assert parameters["Fc2"][1] == pytest.approx(0.05, rel=0.15)
    assert parameters["change of Fc2"][0] == pytest.approx(-1.8)
    without = Numbers(EARLIER, BEFORE, extended(EARLIER.extend(DRIFT), THETA)).parameters(hypothesis(DRIFT))
    assert np.isnan(without["Fc2"][1])
    assert "Fc1" not in parameters


def test_a_payload_is_a_mass_its_centre_and_the_inertia_about_it():
    """2.5 kg at (0.1, -0.2, 0.3) m, a box's inertia about that; the deviation of the mass is that of its draws."""
    centre, about = np.array([0.1, -0.2, 0.3]), np.diag([0.02, 0.03, 0.04])
    moment = about + 2.5 * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    body = np.array([*moment[np.triu_indices(3)], *2.5 * centre, 2.5])
    draws = body * np.linspace(0.98, 1.02, 11)[:, None, None, None]
    readable = Numbers(EARLIER, BEFORE, extended(Model(small_robot(2), (Payload(),)), body, draws)).readable(
        hypothesis(Payload())
    )
    assert {name: value for name, (value, _, _) in readable.items()} == {
        "mass": pytest.approx(2.5),
        **{f"centre of mass {axis}": pytest.approx(x) for axis, x in zip("xyz", centre, strict=True)},
        **{f"inertia {2 * axis}": pytest.approx(x) for axis, x in zip("xyz", (0.02, 0.03, 0.04), strict=True)},
        **{f"inertia {axes}": pytest.approx(0.0, abs=1e-12) for axes in ("xy", "xz", "yz")},
    }
    assert readable["mass"][1] == pytest.approx(2.5 * np.std(np.linspace(0.98, 1.02, 11)))
    assert readable["centre of mass y"][1] == pytest.approx(0.0, abs=1e-12)  # all scale alike
    assert [unit for _, _, unit in readable.values()] == ["kg", *["m"] * 3, *["kg m^2"] * 6]
    assert len(readable) == len(NAMES)
