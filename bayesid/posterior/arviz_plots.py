"""ArviZ's plots of draws, into Axes that are given: nothing else of the package draws with ArviZ.

Draws are (E, D, K), K named quantities of E ensembles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayesid.arrays import Array
from bayesid.process import one_at_a_time, quiet

with quiet(FutureWarning):  # ArviZ announces its next version on import
    import arviz


@one_at_a_time
def draw_forest(draws: Array, names: Sequence[str], ax: Any, look: Mapping[str, Any]) -> None:
    """Intervals of 95 %, one an ensemble."""
    arviz.plot_forest(_data(draws, names), ax=ax, combined=False, show=False, hdi_prob=0.95, **look)  # type: ignore[no-untyped-call]


@one_at_a_time
def draw_pair(draws: Array, names: Sequence[str], axes: Any, look: Mapping[str, Any]) -> None:
    """Points of each quantity over each other one."""
    arviz.plot_pair(_data(draws, names), ax=axes, kind="scatter", show=False, **look)


@one_at_a_time
def draw_trace(draws: Array, names: Sequence[str], axes: Any, look: Mapping[str, Any]) -> None:
    """Density and draws in their order, a row a quantity."""
    arviz.plot_trace(_data(draws, names), axes=axes, compact=False, show=False, **look)


@one_at_a_time
def draw_rank(draws: Array, name: str, ax: Any, look: Mapping[str, Any]) -> None:
    """Histograms of the ranks of each ensemble's draws (E, D, 1) among all."""
    arviz.plot_rank(_data(draws, [name]), ax=ax, kind="bars", labels=False, show=False, **look)  # type: ignore[no-untyped-call]


def _data(draws: Array, names: Sequence[str]) -> Any:
    coords = {"name": list(names)}
    return arviz.from_dict(posterior={"coefficient": draws}, dims={"coefficient": ["name"]}, coords=coords)
