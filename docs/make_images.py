"""The pictures of the documentation.

    python docs/make_images.py              all, some minutes
    python docs/make_images.py payload ..   those of the gallery with these names

Those of docs/images show the logs that the first Python block of the tutorial writes. Those of docs/gallery are made by
the scripts of docs/examples.
"""

from __future__ import annotations

import os
import re
import runpy
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

import bayesid
from bayesid.report import plot
from bayesid.report.report_data import report_data

DOCS = Path(__file__).resolve().parent
GAINS = [35.0, 42.0, 30.0, 12.0, 16.0, 7.5]
"""N m/A, as in the tutorial."""
DPI = 110
WHITE = "white"
"""Behind the figures, which have no colour of their own."""
COLOURS = 64
"""In a palette, which makes files a third as large."""
GALLERY = ("signs", "coefficients", "missing_effect", "payload", "next_motion")
"""Scripts of docs/examples that write a picture of the same name to the working folder."""


def record_logs() -> None:
    """Runs the tutorial's first Python block, which writes monday.csv and tuesday.csv to the current folder."""
    block = re.search(r"^```python\n(.*?)^```$", (DOCS / "tutorial.md").read_text(encoding="utf-8"), re.M | re.S)
    assert block is not None
    exec(compile(block[1], "tutorial.md", "exec"), {"__name__": "__main__"})


def shrink(path: Path) -> None:
    """Stores a picture with a palette."""
    Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)


def make_gallery(names: Sequence[str]) -> None:
    """Writes NAME.png to docs/gallery for each name."""
    os.chdir(DOCS / "gallery")
    for name in names:
        runpy.run_path(str(DOCS / "examples" / f"{name}.py"))
        shrink(DOCS / "gallery" / f"{name}.png")


def make_images() -> None:
    """Writes signs.png, coefficients.png, validation.png and skeleton.png to docs/images."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        record_logs()
        monday, tuesday = (bayesid.read_log(f"{day}.csv", gains=GAINS) for day in ("monday", "tuesday"))
        os.chdir(DOCS)
    search, sampling = bayesid.Certified(), bayesid.Sampling()
    result = bayesid.identify("kr5r650", monday, search=search, posterior=sampling)
    found = report_data(result).with_validation(result.validate(tuesday))
    pictures = {
        "signs": plot.torques(found, joints=[2, 6]),
        "coefficients": [plot.coefficients(found)],
        "validation": plot.validation(found, joints=[5]),
        "skeleton": plot.skeleton("ur5e", np.radians([30.0, -60.0, 45.0, -20.0, 70.0, 10.0])),
    }
    for name, axes in pictures.items():
        path = DOCS / "images" / f"{name}.png"
        axes[0].figure.savefig(path, dpi=DPI, facecolor=WHITE)
        shrink(path)


if __name__ == "__main__":
    if not sys.argv[1:]:
        make_images()
    make_gallery(sys.argv[1:] or GALLERY)
