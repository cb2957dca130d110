import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from bayesid.effects.parameters import Cone
from bayesid.regression.feasibility import MOST, FeasibilityCheck
from bayesid.robot.inertia import from_pseudo_inertia, pseudo_inertia

BODY = Cone.rigid_bodies(1)


def body(rng, lowest):
    """Ten parameters whose pseudo-inertia has this smallest eigenvalue."""
    vectors = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    return from_pseudo_inertia(vectors @ np.diag([lowest, *rng.uniform(0.2, 3.0, 3)]) @ vectors.T)


def curvature(rng, size):
    root = rng.normal(size=(3 * size, size)) * 10.0 ** rng.uniform(-1, 1, size)
    return root.T @ root


@pytest.mark.parametrize("lowest", [0.1, 1e-4, -1e-4, -0.3])
def test_where_everything_is_decided_the_margin_is_the_smallest_eigenvalue(lowest):
    rng = np.random.default_rng(1)
    check = FeasibilityCheck(BODY, np.eye(10))
    for _ in range(3):
        theta, hessian = body(rng, lowest), curvature(rng, 10)
        assert check.margins(hessian, (hessian @ theta)[None])[0] == pytest.approx(lowest, abs=1e-5)


@pytest.mark.parametrize("lowest", [0.05, -0.2])
def test_what_nothing_decides_is_chosen_as_well_as_it_can_be(lowest):
    """Of an unknown mass the best has no end; of an unknown inertia about z a line search finds it."""
    rng = np.random.default_rng(2)
    theta, hessian = body(rng, lowest), curvature(rng, 9)

    def found(hidden):
        projection = np.delete(np.eye(10), hidden, axis=0)
        check = FeasibilityCheck(BODY, projection)
        return check.margins(hessian, (hessian @ projection @ theta)[None])[0]

    def least(inertia):
        return -np.linalg.eigvalsh(pseudo_inertia(np.append(np.insert(theta[[*range(5)]], 5, inertia), theta[6:])))[0]

    heavy = np.linalg.eigvalsh(pseudo_inertia(theta)[:3, :3])[0]
    assert found(9) == pytest.approx(heavy, abs=1e-4)
    best = -minimize_scalar(least, bounds=(-50.0, 50.0), method="bounded", options={"xatol": 1e-9}).fun
    assert found(5) == pytest.approx(best, abs=2e-5)


def test_of_bodies_and_friction_the_worst_counts_and_a_margin_has_an_end():
    rng = np.random.default_rng(3)
    cone, good, bad = Cone.orthant(1) + Cone.rigid_bodies(2), body(rng, 0.1), body(rng, -0.2)
    check, hessian = FeasibilityCheck(cone, np.eye(21)), curvature(rng, 21)
    cases = [([0.3, *good, *good], 0.1), ([-0.4, *good, *bad], -0.4), ([0.3, *good, *bad], -0.2)]
    found = check.margins(hessian, np.array([hessian @ np.array(theta) for theta, _ in cases]))
    np.testing.assert_allclose(found, [margin for _, margin in cases], atol=1e-5)
    first = np.diag(np.eye(21)[0])  # only friction is decided
    assert check.margins(first, 3.0 * np.eye(21)[:1])[0] == pytest.approx(MOST, abs=1e-5)
    assert check.margins(first, -3.0 * np.eye(21)[:1])[0] == pytest.approx(-3.0, abs=1e-5)
