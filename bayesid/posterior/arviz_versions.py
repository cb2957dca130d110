"""What ArviZ 0.x and 1.x do differently: the object that holds the groups. No other module knows which one is there.

Before 1.0 that is an `arviz.InferenceData`, since then an `xarray.DataTree`. Both are read alike: `data.posterior` or
`data["posterior"]` is a group, `sorted(data)` their names, `data.attrs` what is said of all. R-hat and effective sample
sizes of arrays are the same numbers by the same calls, see `bayesid.posterior.diagnostics`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import xarray

from bayesid.parallel import quiet

with quiet(FutureWarning):  # ArviZ 0.x announces its next version on import
    import arviz

__all__ = ["InferenceData", "joined"]

_TREES = int(arviz.__version__.partition(".")[0]) >= 1
"""Whether groups are held by a tree of xarray."""


class InferenceData(Protocol):
    """Groups of one inference: an `arviz.InferenceData` or an `xarray.DataTree`, whichever ArviZ takes."""

    attrs: Any

    def __getitem__(self, key: str, /) -> Any:
        """A group."""

    def __iter__(self) -> Iterator[Any]:
        """Names of groups."""

    def __getattr__(self, name: str, /) -> Any:
        """A group."""


def joined(groups: Mapping[str, xarray.Dataset], attributes: Mapping[str, Any]) -> InferenceData:
    """What ArviZ takes for one inference.

    Args:
        groups: by ArviZ's names (`posterior`, `log_likelihood`, ..) or others.
        attributes: of the whole.
    """
    if _TREES:
        data: InferenceData = xarray.DataTree.from_dict(dict(groups))
        data.attrs.update(attributes)
        return data
    with quiet(UserWarning):  # said of groups that ArviZ has no name for
        return arviz.InferenceData(attrs=dict(attributes), **groups)
