"""The package's long description: README.md, with links that lead somewhere from any page. All else: pyproject.toml.

A repository's own pages need no address, an index of packages does. Once `[project.urls]` names `Source`, links and
pictures are of that place; until then pictures are left out, and links are their words.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
LINK = re.compile(r"(?P<picture>!?)\[(?P<words>[^\]]*)\]\((?P<target>[^)\s]+)\)")


def long_description(readme: str, source: str | None) -> str:
    """A README without links to files beside it."""

    def from_anywhere(link: re.Match[str]) -> str:
        picture, words, target = link["picture"], link["words"], link["target"]
        if "://" in target:
            return link[0]
        if source is None:
            return "" if picture else words
        return f"{picture}[{words}]({source.rstrip('/')}/{'raw' if picture else 'blob'}/HEAD/{target})"

    return re.sub(r"\n{3,}", "\n\n", LINK.sub(from_anywhere, readme))


if __name__ == "__main__":
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    text = long_description(readme, project.get("urls", {}).get("Source"))
    setup(long_description=text, long_description_content_type="text/markdown")
