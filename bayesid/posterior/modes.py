"""The modes of the posterior: where walkers must start, for none finds its way from one to another.

All unknown signs are summed out, so a walker passes from an assignment of signs to its neighbours by itself. What it
does not cross is the valley between assignments that differ in much, above all between the two sides of a joint's
near-symmetry: all its signs turned, and the parameters of the rest bent to suit. The assignments to start from are
those that the search could not rule out, and the best one with each joint turned round. Information of an earlier log
pulls at all of them alike: it may rule one side out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.posterior.start import find_centre
from bayesid.posterior.target import Target
from bayesid.regression.knowledge import Information
from bayesid.regression.moments import Moments
from bayesid.regression.solver import ConeLeastSquares, PreparedLeastSquares
from bayesid.signs.search.result import SearchResult

_MOST_BRANCHES = 32
"""Assignments of the search's list, cheapest first, that are followed to their centres. A round number; not studied."""
_MOST_MODES = 6
"""Modes that are sampled: each takes its share of the budget. A round number; not studied."""
_DEPTH = 10.0
"""Nats below the best mode's centre under which a mode does not matter: exp(-10) is 5e-5."""
_HOPELESS = 50.0
"""Nats by which a start's best fit may lie below the best one of all. Five times the depth, for the centres inside the
region may differ less."""
_VALLEY = 3.0
"""Nats that a valley between two modes is deep, at least: walkers cross one of exp(-3) = 5 % of the density."""
_STEPS = 12
"""Into which the straight way between two modes is divided to look for the valley. A round number; not studied."""
_MOST_ROUNDS = 4
"""In which signs and parameters are made to agree; more change little. A round number; not studied."""


@dataclass(frozen=True)
class Mode:
    """Where walkers start.

    Attributes:
        theta: (P,) centre, strictly inside the region.
        signs: (S,) the signs that lead there.
        log_density: of the target at the centre, noise scales as in the reference.
    """

    theta: Array
    signs: Integers
    log_density: float


def find_modes(target: Target, moments: Moments, solver: ConeLeastSquares, search: SearchResult) -> tuple[Mode, ...]:
    """The modes that matter, the densest first.

    Args:
        target: the posterior.
        moments: in units of the target's reference noise.
        solver: for these moments and the target's information, added.
        search: the result of the search for signs.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    starts = starting_points(moments, target.information, solver, search)
    modes = sorted((_mode(target, signs, theta) for signs, theta in starts), key=lambda mode: -mode.log_density)
    kept: list[Mode] = []
    for mode in modes:
        relevant = mode.log_density >= modes[0].log_density - _DEPTH
        if relevant and all(_valley(target, mode, denser) >= _VALLEY for denser in kept):
            kept.append(mode)
    return tuple(kept[:_MOST_MODES])


def starting_points(
    moments: Moments, information: Information | None, solver: ConeLeastSquares, search: SearchResult
) -> list[tuple[Integers, Array]]:
    """Signs and best parameters of the search's branches, and of its best assignment with each joint turned round.

    What is left out is hopelessly worse by a lower bound of its cost. The cost itself is not to be relied on: efforts
    of little noise make it a small difference of large numbers.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    starts = [branch.signs for branch in search.branches[:_MOST_BRANCHES]] or [search.signs]
    prepared = solver.prepared()
    for joint in np.unique(moments.joint[moments.known == 0]):
        of_joint = (moments.joint == joint) & (moments.known == 0)
        starts.append(_settle(moments, information, prepared, np.where(of_joint, -search.signs, search.signs)))
    distinct = {signs.tobytes(): signs for signs in starts}.values()
    fits = [(signs, prepared.solve_precisely(_gradient(moments, information, signs))) for signs in distinct]
    most = min(fit.cost for _, fit in fits) + 2.0 * _HOPELESS
    return [(signs, fit.theta) for signs, fit in fits if fit.lower_bound <= most]


def _gradient(moments: Moments, information: Information | None, signs: Integers) -> Array:
    """(r,) of everything: the moments under these signs, and the information besides."""
    gradient: Array = signs @ moments.gradient
    return gradient if information is None else gradient + information.gradient


def _settle(
    moments: Moments, information: Information | None, prepared: PreparedLeastSquares, signs: Integers
) -> Integers:
    """Signs that their best parameters predict, after a few rounds of adapting one to the other."""
    for _ in range(_MOST_ROUNDS):
        theta = prepared.solve(_gradient(moments, information, signs)).theta
        predicted = np.where(moments.gradient @ prepared.project(theta) >= 0.0, 1, -1)
        settled = np.where(moments.known != 0, moments.known, predicted)
        if np.array_equal(settled, signs):
            break
        signs = settled
    return signs


def _mode(target: Target, signs: Integers, theta: Array) -> Mode:
    scale = np.zeros(target.likelihood.n_joints)
    centre = find_centre(target, theta, scale).theta
    return Mode(centre, signs, float(target.log_density(np.append(centre, scale))[0]))


def _valley(target: Target, mode: Mode, other: Mode) -> float:
    """Nats by which the density falls on the straight way between two modes, below the lower one of them.

    The region is convex: the way lies inside.
    """
    share = np.linspace(0.0, 1.0, _STEPS + 1)[1:-1, None]
    theta = (1.0 - share) * mode.theta + share * other.theta
    scale = np.zeros((len(theta), target.likelihood.n_joints))
    lowest = float(target.log_density(np.hstack([theta, scale])).min())
    return min(mode.log_density, other.log_density) - lowest
