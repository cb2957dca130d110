"""The catalogue of distortions: every one in a file of this folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayesid.catalogue import named_classes
from bayesid.distortions.base import Distortion

__all__ = ["CATALOGUE", "Distortion", "make_distortion"]


CATALOGUE: Mapping[str, type[Distortion]] = named_classes(__name__)


def make_distortion(name: str, shape: Mapping[str, Iterable[float]]) -> Distortion:
    """A distortion from its catalogue name and numbers, as model.toml keeps them."""
    numbers: dict[str, Any] = {key: tuple(values) for key, values in shape.items()}
    return CATALOGUE[name](**numbers)
