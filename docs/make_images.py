"""The pictures of the documentation: `python docs/make_images.py`, some twenty seconds.

They are those of the tutorial's own logs, which its first Python block writes.
"""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

import numpy as np

import bayesid
from bayesid.report import findings, plot

DOCS = Path(__file__).resolve().parent
GAINS = [35.0, 42.0, 30.0, 12.0, 16.0, 7.5]
"""N m/A, as in the tutorial."""
DPI = 110
WHITE = "white"
"""Behind the figures, which have no colour of their own."""


def record_logs() -> None:
    """Runs the tutorial's first Python block, which writes monday.csv and tuesday.csv to the current folder."""
    block = re.search(r"^```python\n(.*?)^```$", (DOCS / "tutorial.md").read_text(encoding="utf-8"), re.M | re.S)
    assert block is not None
    exec(compile(block[1], "tutorial.md", "exec"), {"__name__": "__main__"})


def main() -> None:
    """Writes signs.png, coefficients.png, validation.png and skeleton.png to docs/images."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        record_logs()
        monday, tuesday = (bayesid.read_log(f"{day}.csv", gains=GAINS) for day in ("monday", "tuesday"))
        os.chdir(DOCS)
    search, sampling = bayesid.Certified(), bayesid.Sampling()
    result = bayesid.identify("kr5r650", monday, search=search, posterior=sampling)
    found = findings.report_data(result).with_validation(result.validate(tuesday))
    pictures = {
        "signs": plot.torques(found, joints=[2, 6]),
        "coefficients": [plot.coefficients(found)],
        "validation": plot.validation(found, joints=[5]),
        "skeleton": plot.skeleton("ur5e", np.radians([30.0, -60.0, 45.0, -20.0, 70.0, 10.0])),
    }
    for name, axes in pictures.items():
        axes[0].figure.savefig(DOCS / "images" / f"{name}.png", dpi=DPI, facecolor=WHITE)


if __name__ == "__main__":
    main()
