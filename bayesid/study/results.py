"""What stands in a study's folder once it has ended: report.txt and figure.svg, beside its rows."""

from __future__ import annotations

from pathlib import Path

from bayesid.errors import InputError
from bayesid.files.writing import check_place, replace_file
from bayesid.study.study import Finished

_FILES = {"rows.parquet", "timings.parquet", "report.txt", "figure.svg"}


def check_results(folder: Path) -> None:
    """Checks that a study may write there: nothing else is there.

    Raises:
        InputError: something else is, or nothing can be written.
    """
    remedy = "give `folder` a new folder"
    if folder.exists() and not folder.is_dir():
        raise InputError("is not a folder", str(folder), remedy)
    foreign = {path.name for path in folder.iterdir()} - _FILES if folder.is_dir() else set()
    visible = sorted(name for name in foreign if not name.startswith("."))
    if visible:
        raise InputError(f"holds other files ({visible[0]})", str(folder), remedy)
    check_place(folder)


def save_results(finished: Finished, folder: Path) -> str:
    """Writes report and figure, and returns the report."""
    from bayesid.report.plot.trials import save_figure  # matplotlib takes a second to import

    text = finished.report
    replace_file(folder / "report.txt", lambda aside: aside.write_text(f"{text}\n", encoding="utf-8"))
    if finished.good:
        save_figure(lambda figure: finished.study.draw(finished.good, figure), folder / "figure.svg")
    return text
