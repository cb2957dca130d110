"""The ten inertial parameters of a link, and their physical consistency.

A link's parameters, in its own frame, in this order everywhere in bayesid:

- Jxx, Jxy, Jxz, Jyy, Jyz, Jzz: inertia about the frame's origin, kg m^2
- mcx, mcy, mcz: first moments (mass times centre of mass), kg m
- m: mass, kg

They are those of a body of nonnegative density if and only if the pseudo-inertia

P(pi) = [[Sigma, h], [h', m]], Sigma = tr(J)/2 E - J, h = (mcx, mcy, mcz)

is positive semidefinite (Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018).
"""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array

NAMES = ("Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz", "mcx", "mcy", "mcz", "m")
UNITS = ("kg m^2",) * 6 + ("kg m",) * 3 + ("kg",)
_TRIANGLE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def inertia_matrix(parameters: Array) -> Array:
    """(..., 3, 3) inertia about the frame's origin, kg m^2, from (..., 10) parameters."""
    matrix = np.zeros((*parameters.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(_TRIANGLE):
        matrix[..., i, j] = matrix[..., j, i] = parameters[..., k]
    return matrix


def pseudo_inertia(parameters: Array) -> Array:
    """(..., 4, 4) pseudo-inertia of (..., 10) parameters (:eq:`pseudo-inertia`; Wensing, Kim, Slotine 2018, eq. 9)."""
    inertia = inertia_matrix(parameters)
    trace = np.trace(inertia, axis1=-2, axis2=-1)
    matrix = np.zeros((*parameters.shape[:-1], 4, 4))
    matrix[..., :3, :3] = trace[..., None, None] / 2 * np.eye(3) - inertia
    matrix[..., :3, 3] = matrix[..., 3, :3] = parameters[..., 6:9]
    matrix[..., 3, 3] = parameters[..., 9]
    return matrix


def from_pseudo_inertia(matrix: Array) -> Array:
    """(..., 10) parameters of a (..., 4, 4) pseudo-inertia; the inverse of `pseudo_inertia`."""
    second = matrix[..., :3, :3]
    inertia = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    triangle = np.stack([inertia[..., i, j] for i, j in _TRIANGLE], axis=-1)
    return np.concatenate([triangle, matrix[..., :3, 3], matrix[..., 3:, 3]], axis=-1)


PSEUDO_INERTIA_BASIS: Array = pseudo_inertia(np.eye(10))
"""(10, 4, 4): the pseudo-inertia is linear in the parameters, P(pi) = sum_k pi_k BASIS[k]."""


def about_centre_of_mass(parameters: Array) -> tuple[Array, Array]:
    """(..., 3) centre of mass, m, and (..., 3, 3) inertia about it, kg m^2, of (..., 10) parameters with a mass > 0."""
    mass = parameters[..., 9]
    centre = parameters[..., 6:9] / mass[..., None]
    square = np.sum(centre**2, axis=-1)[..., None, None] * np.eye(3) - centre[..., :, None] * centre[..., None, :]
    return centre, inertia_matrix(parameters) - mass[..., None, None] * square


def change_of_frame(rotation: Array, translation: Array) -> Array:
    """The (10, 10) matrix that takes a link's parameters from frame b to a, given b's rotation and origin in a.

    The pseudo-inertia is the second moment of the homogeneous points, so it changes by congruence: P_a = T P_b T'.
    """
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return from_pseudo_inertia(transform @ PSEUDO_INERTIA_BASIS @ transform.T).T
