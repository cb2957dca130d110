"""The posterior as ArviZ's InferenceData, of what is kept of it: see `bayesid.posterior.kept`."""

from __future__ import annotations

import xarray

from bayesid.parallel import one_at_a_time
from bayesid.posterior.arviz_versions import InferenceData, joined
from bayesid.posterior.kept import Kept

__all__ = ["InferenceData", "as_inference_data"]


@one_at_a_time
def as_inference_data(kept: Kept) -> InferenceData:
    """All that is kept, as one object of ArviZ."""
    groups = {
        name: xarray.Dataset(group.variables, coords=group.coordinates, attrs=group.attributes)
        for name, group in kept.groups.items()
    }
    return joined(groups, kept.attributes)
