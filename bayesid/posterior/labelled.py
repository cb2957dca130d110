"""Arrays and tables with names, for those who go on with them elsewhere: datasets of xarray, frames of pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import xarray
from pandas import DataFrame
from xarray import Dataset

__all__ = ["DataFrame", "Dataset", "data_frame", "dataset"]


def dataset(
    variables: Mapping[str, tuple[Sequence[str], Any, Mapping[str, object]]],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, object],
) -> Dataset:
    """A dataset.

    Args:
        variables: name to dimensions, values, and what there is to say of them (`units`, `long_name`).
        coordinates: of the dimensions, as xarray takes them.
        attributes: of the whole.
    """
    named = {name: (tuple(dims), values, dict(about)) for name, (dims, values, about) in variables.items()}
    return xarray.Dataset(named, coords=dict(coordinates), attrs=dict(attributes))


def data_frame(columns: Mapping[str, Any]) -> DataFrame:
    """A frame of columns of one length, in their order."""
    return DataFrame(dict(columns))
