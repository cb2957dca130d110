"""What stands in a study's folder once it has ended: report.txt and figure.svg, beside its rows."""

from __future__ import annotations

from pathlib import Path

from bayesid.errors import InputError
from bayesid.results import check_place
from studies.figures import save_figure
from studies.study import Finished

_FILES = {"rows.parquet", "timings.parquet", "report.txt", "figure.svg"}


def check_results(folder: Path) -> None:
    """Checks that a study may write there: nothing else is there.

    Raises:
        InputError: something else is, or nothing can be written.
    """
    remedy = "give --out a new folder"
    if folder.exists() and not folder.is_dir():
        raise InputError("is not a folder", str(folder), remedy)
    others = {path.name for path in folder.iterdir()} - _FILES if folder.is_dir() else set()
    visible = sorted(name for name in others if not name.startswith("."))
    if visible:
        raise InputError(f"holds other files ({visible[0]})", str(folder), remedy)
    check_place(folder)


def save_results(finished: Finished, folder: Path) -> str:
    """Writes report and figure, and returns the report."""
    text = finished.report
    aside = folder / ".report.txt"
    aside.write_text(f"{text}\n")
    aside.replace(folder / "report.txt")
    if finished.good:
        save_figure(lambda figure: finished.study.draw(finished.good, figure), folder / "figure.svg")
    return text
