"""Draws at edges: active windows of the prior, and active constraints."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.effects.constraints import Constraints
from bayesid.posterior.target import TruncatedGaussian
from bayesid.posterior.tuning import TUNING


def active_bounds(prior: TruncatedGaussian, theta: Array) -> tuple[tuple[str, float], ...]:
    """Active windows: their names, and the share of draws (..., P) in the last tenth.

    With stated constraints, draws must be at the window's edge too, as a constraint may end before it.
    """
    active_bounds = []
    for window in prior.windows:
        share = float(np.mean(window.share(theta) > TUNING.near_edge))
        if share <= TUNING.active_bounds:
            continue
        if prior.stated is None or _share_at_edge(window.slack(theta).reshape(1, -1)) > TUNING.active_constraint:
            active_bounds.append((window.name, share))
    return tuple(active_bounds)


def at_edges(stated: Constraints | None, theta: Array) -> dict[str, float]:
    """Label of each constraint to the share of draws (N, P) at its edge, within a tenth of its slack's sd.

    For a constraint of several half spaces or matrices, at any of their edges.
    """
    if stated is None:
        return {}
    slack, least = stated.slack(theta.T), stated.least_eigenvalues(theta)
    edges = (
        np.concatenate([slack[stated.of_row == k], least[stated.of_matrix == k]]) for k in range(len(stated.labels))
    )
    return dict(zip(stated.labels, map(_share_at_edge, edges), strict=True))


def _share_at_edge(slack: Array) -> float:
    """Share of N draws at any of some edges, with slack (m, N)."""
    sd = np.maximum(slack.std(axis=1, keepdims=True), TINY)
    return float(np.mean(np.any(slack < TUNING.at_edge * sd, axis=0)))
