"""Packets of KUKA's Robot Sensor Interface: XML elements `<Rob>`, one per cycle."""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar

import numpy as np

from bayesid.errors import InputError
from bayesid.files.bounded import MOST_UNPACKED
from bayesid.log.formats import Format
from bayesid.log.formats.memory import table_of_vectors
from bayesid.log.formats.table import Options, Table

_PACKET = re.compile(r"<Rob\b[^>]*>(.*?)</Rob\s*>", re.DOTALL)
_ELEMENT = re.compile(r"<(\w+)((?:\s+\w+\s*=\s*[\"'][^\"']*[\"'])*)\s*(?:/>|>([^<]*)</\1\s*>)")
_ATTRIBUTE = re.compile(r"(\w+)\s*=\s*[\"']([^\"']*)[\"']")


class RsiStream(Format):
    """Columns are named as in RSI's tables: AIPos.A1, MACur.A1, IPOC."""

    name = "a stream of RSI"
    options: ClassVar[frozenset[str]] = frozenset({"columns"})

    def recognises(self, path: Path, head: bytes) -> bool:
        return re.match(rb"(\xef\xbb\xbf)?\s*(<\?xml[^>]*>\s*)?<Rob\b", head) is not None

    def read(self, path: Path, options: Options) -> Table:
        if path.stat().st_size > MOST_UNPACKED:
            raise InputError(f"is longer than {MOST_UNPACKED >> 30} GiB", str(path), "cut it into shorter logs")
        packets = [_numbers(found[1]) for found in _PACKET.finditer(path.read_text("utf-8", "replace"))]
        if not packets:
            raise InputError("holds no complete RSI packet", str(path), "record <Rob> ... </Rob> with AIPos and MACur")
        names = list(dict.fromkeys(name for packet in packets for name in packet))
        table = {name: np.array([packet.get(name, np.nan) for packet in packets]) for name in names}
        return table_of_vectors(table, str(path), options)


def _numbers(packet: str) -> dict[str, float]:
    """Numbers of a packet by names such as AIPos.A1; other values are ignored."""
    found: dict[str, float] = {}
    for name, attributes, text in _ELEMENT.findall(packet):
        pairs = [(f"{name}.{key}", value) for key, value in _ATTRIBUTE.findall(attributes)]
        for key, value in [*pairs, *([(name, text)] if text.strip() else [])]:
            try:
                found[key] = float(value)
            except ValueError:
                continue
    return found
