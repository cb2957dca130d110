"""The modes of the posterior: where walkers must start, for none finds its way from one to another.

All unknown signs are summed out, so a walker passes from an assignment of signs to its neighbours by itself. What it
does not cross is the valley between assignments that differ in much, above all between the two sides of a joint's
near-symmetry: all its signs turned, and the parameters of the rest bent to suit. The assignments to start from are
those that the search could not rule out, and the best ones with each joint turned round. What an earlier log has told
pulls at all of them alike: it may leave one side alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.knowledge import Information
from bayesid.moments import Moments
from bayesid.motion import Array, Integers
from bayesid.posterior.start import find_centre
from bayesid.posterior.target import Target
from bayesid.search.result import Branch, SearchResult
from bayesid.solver import ConeLeastSquares

_MOST_BRANCHES = 32
"""Of the search, cheapest first, that are looked at."""
_MOST_MODES = 6
_DEPTH = 10.0
"""Nats below the best mode's centre under which a mode does not matter: exp(-10) is 5e-5."""
_HOPELESS = 50.0
"""Nats by which a best fit may lie below the best one of all; the centres inside the region may differ less."""
_VALLEY = 3.0
"""Nats that a valley between two modes is deep, at least."""
_STEPS = 12
_SETTLED = 4
"""Rounds in which signs and parameters are made to agree."""


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
        solver: for these moments and what the target knows from an earlier log, added.
        search: what has been found about the signs.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    modes = sorted(
        (_mode(target, signs, theta) for signs, theta in _starts(moments, target.known, solver, search)),
        key=lambda mode: -mode.log_density,
    )
    kept: list[Mode] = []
    for mode in modes:
        deep = mode.log_density < modes[0].log_density - _DEPTH
        if not deep and all(_valley(target, mode, other) >= _VALLEY for other in kept):
            kept.append(mode)
    return tuple(kept[:_MOST_MODES])


def _starts(
    moments: Moments, known: Information | None, solver: ConeLeastSquares, search: SearchResult
) -> list[tuple[Integers, Array]]:
    """Signs and parameters of the search's branches and of its best assignment with each joint turned round."""
    listed = search.branches[:_MOST_BRANCHES] or (Branch(search.signs, search.theta, search.cost, -np.inf),)
    starts = [branch.signs for branch in listed]
    for joint in np.unique(moments.joint[moments.known == 0]):
        turned = (moments.joint == joint) & (moments.known == 0)
        starts.append(_settle(moments, known, solver, np.where(turned, -search.signs, search.signs)))
    distinct = {signs.tobytes(): signs for signs in starts}.values()
    solutions = [solver.solve(_gradient(moments, known, signs)) for signs in distinct]
    most = min(solution.cost for solution in solutions) + 2.0 * _HOPELESS
    return [(signs, found.theta) for signs, found in zip(distinct, solutions, strict=True) if found.cost <= most]


def _gradient(moments: Moments, known: Information | None, signs: Integers) -> Array:
    """(r,) of everything: the moments under these signs, and what is known besides."""
    gradient: Array = signs @ moments.gradient
    return gradient if known is None else gradient + known.gradient


def _settle(moments: Moments, known: Information | None, solver: ConeLeastSquares, signs: Integers) -> Integers:
    """Signs that their own best parameters predict, after a few rounds of adapting one to the other."""
    for _ in range(_SETTLED):
        theta = solver.solve(_gradient(moments, known, signs)).theta
        predicted = np.where(moments.gradient @ solver.project(theta) >= 0.0, 1, -1)
        settled = np.where(moments.known != 0, moments.known, predicted)
        if np.array_equal(settled, signs):
            break
        signs = settled
    return signs


def _mode(target: Target, signs: Integers, theta: Array) -> Mode:
    scale = np.zeros(target.likelihood.n_joints)
    centre = find_centre(target, theta, scale).theta
    return Mode(centre, signs, float(target.log_density(np.append(centre, scale))[0]))


def _valley(target: Target, one: Mode, other: Mode) -> float:
    """Nats by which the density falls on the straight way between two modes, below the lower one of them.

    The region is convex: the way lies inside.
    """
    share = np.linspace(0.0, 1.0, _STEPS + 1)[1:-1, None]
    theta = (1.0 - share) * one.theta + share * other.theta
    scale = np.zeros((len(theta), target.likelihood.n_joints))
    lowest = float(target.log_density(np.hstack([theta, scale])).min())
    return min(one.log_density, other.log_density) - lowest
