"""The distortions: every one in a file of this folder."""

from __future__ import annotations

from collections.abc import Mapping

from bayesid.model.distortions.base import Distortion
from bayesid.model.effects import named_classes

__all__ = ["CATALOGUE", "Distortion"]

CATALOGUE: Mapping[str, type[Distortion]] = named_classes(__name__, __path__)
"""Name to class, of every form of every distortion."""
