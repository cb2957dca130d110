import numpy as np
from oracles import cloud_parameters, random_clouds, turn

from bayesid.effects.parameters import Cone
from bayesid.robot import inertia

CLOUDS = random_clouds(5, seed=3)
PARAMETERS = np.array([cloud_parameters(*cloud) for cloud in CLOUDS])
CONE = Cone.rigid_bodies(1)
ROTATION = turn((0.6, 0.0, 0.8), 0.7) @ turn((0.0, 1.0, 0.0), -2.1)
SHIFT = np.array([0.3, -0.7, 1.1])


def test_pseudo_inertia_is_the_second_moment_of_the_mass():
    for (points, masses), parameters in zip(CLOUDS, PARAMETERS, strict=True):
        homogeneous = np.column_stack([points, np.ones(len(points))])
        moment = (homogeneous.T * masses) @ homogeneous
        np.testing.assert_allclose(inertia.pseudo_inertia(parameters), moment, rtol=0, atol=1e-14)
        np.testing.assert_allclose(inertia.from_pseudo_inertia(moment), parameters, rtol=0, atol=1e-14)


def test_inertia_about_the_centre_of_mass_is_that_of_the_points():
    for (points, masses), parameters in zip(CLOUDS, PARAMETERS, strict=True):
        centre, about = inertia.about_centre_of_mass(parameters)
        mean = masses @ points / masses.sum()
        arms = points - mean
        expected = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True))
        np.testing.assert_allclose(centre, mean, rtol=0, atol=1e-14)
        np.testing.assert_allclose(about, expected, rtol=0, atol=1e-13)


def test_change_of_frame_moves_the_points():
    change = inertia.change_of_frame(ROTATION, SHIFT)
    for (points, masses), parameters in zip(CLOUDS, PARAMETERS, strict=True):
        moved = cloud_parameters(points @ ROTATION.T + SHIFT, masses)
        np.testing.assert_allclose(change @ parameters, moved, rtol=0, atol=1e-13)
    back = inertia.change_of_frame(ROTATION.T, -ROTATION.T @ SHIFT)
    np.testing.assert_allclose(back @ change, np.eye(10), rtol=0, atol=1e-13)


def test_bodies_are_inside_the_cone():
    for points, masses in random_clouds(20, seed=0):
        assert CONE.contains(cloud_parameters(points, masses))
        assert CONE.contains(cloud_parameters(points[:1], masses[:1]), tolerance=1e-15), "one point is on the boundary"
        assert not CONE.contains(cloud_parameters(points[:1], masses[:1]) - 1e-3)


# a body of 2 kg about its centre, a block of 0.3 x 0.2 x 0.1 m, and what no body can be
BLOCK = np.array([0.05, 0.0, 0.0, 0.1, 0.0, 0.13, 0.0, 0.0, 0.0, 12.0]) / 6
UNPHYSICAL = {
    "negative mass": {"m": -2.0},
    "no mass but inertia and first moment": {"m": 0.0, "mcx": 0.01},
    "triangle inequality": {"Jzz": BLOCK[0] + BLOCK[3] + 1e-4},
    "negative inertia": {"Jxx": -0.001},
    "product of inertia": {"Jyz": 0.03},
    "centre of mass too far for the inertia": {"mcx": 2.0 * 0.2},
    "a mirror image through the origin": {"Jxx": -BLOCK[0], "Jyy": -BLOCK[3], "Jzz": -BLOCK[5], "m": -2.0},
}


def test_unphysical_parameters_are_refused():
    assert CONE.contains(BLOCK)
    for why, change in UNPHYSICAL.items():
        body = BLOCK.copy()
        body[[inertia.NAMES.index(name) for name in change]] = list(change.values())
        assert not CONE.contains(body), why
        assert CONE.smallest_eigenvalues(body)[0] < -1e-6, why
