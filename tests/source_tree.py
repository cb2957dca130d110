"""Importing this finds `bayesid.studies` where the source is run as it was unpacked: they lie beside the package."""

from importlib.util import find_spec
from pathlib import Path

import bayesid

if find_spec("bayesid.studies") is None:
    bayesid.__path__.append(str(Path(__file__).parents[1]))
