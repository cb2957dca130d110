"""What a link is before the data, by what the robot file and the efforts show: their scales, not their parameters.

Lengths are the arm's: a link's mass lies within a quarter of the stretched arm of its frame, give or take. The mass is
the one whose efforts are those of the log: under the prior N(mu, D^2) of the links alone, for masses of 1 kg, the
efforts of the log's motion have the expected energy tr(D B' H B D) + mu' B' H B mu. It grows with the square of the
mass, and so :eq:`link-mass`::

    mass = 3 sqrt(c / (tr(D B' H B D) + mu' B' H B mu)),

with H and c of all joints, in N m: gravity's torques over lengths and, where there is no gravity, those of the
accelerations. Friction is in c too, so that the prior is rather wider than narrower. Scale a robot's masses, lengths
and efforts, and its prior scales with them.
"""

from __future__ import annotations

import numpy as np

from bayesid.arrays import TINY
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.motion import Motion
from bayesid.regression.knowledge import Links
from bayesid.regression.moments import Moments
from bayesid.robot import Robot

_OF_SPAN = 0.25
"""Scale of distances over the stretched arm: most of an arm's length is that of two or three links. A round number."""
_WIDER = 3.0
"""Times the mass that would make the log's efforts: as the mean of the typical link, 0.3 of the scale, is that mass."""
_BLIND = 1e-12
"""Expected energy over the efforts' own, for links of the usual scales, below which no effort is a link's. Rounding."""


def usual_links(robot: Robot, motion: Motion, coefficients: BaseCoefficients, cone: Cone, moments: Moments) -> Links:
    """The scales of a robot's links; the default of `Links` for what neither its lengths nor its efforts show.

    Args:
        robot: whose lengths count, and of its sliding joints the way they went.
        motion: of the log.
        coefficients: the r base coefficients.
        cone: of the P parameters.
        moments: of the log, in N m and N, not scaled.
    """
    sliding = np.array([joint.prismatic for joint in robot.joints])
    span = robot.stretched + float(np.ptp(motion.q, axis=0)[sliding].sum())
    usual = Links() if span <= 0.0 else Links(reach=_OF_SPAN * span)
    arm = np.where(sliding, usual.reach, 1.0)  # by which the force of a sliding joint is a torque
    scaled = moments.scaled(1.0 / arm)
    hessian, energy = scaled.hessian.total(), float(scaled.energy.sum())
    sd, mean = np.zeros(cone.size), np.zeros(cone.size)
    for body in cone.bodies:
        sd[body], mean[body] = usual.sd, usual.centre
    spread, middle = coefficients.projection * sd, coefficients.projection @ mean
    expected = float(np.sum(spread * (hessian @ spread)) + middle @ hessian @ middle)
    if expected <= _BLIND * energy or energy <= TINY:
        return usual
    return Links(mass=_WIDER * usual.mass * np.sqrt(energy / expected), reach=usual.reach)
