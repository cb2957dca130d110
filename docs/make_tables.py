"""The tables of README and docs/, and the pages and figures of docs/studies/, from the rows of studies.

    python docs/make_tables.py FOLDER

FOLDER holds results of studies under their names, as `bayesid study NAME --out FOLDER/NAME` leaves them, and the output
of `python -m bayesid.studies.benchmarks.peers` as `peers.txt`. What FOLDER does not hold stays as it is. A table stands
between `<!-- table: NAME -->` and `<!-- end of table -->`. A study's report is the page docs/studies/NAME.md.
The tables of `OF_CODE` are made from the code.
"""

from __future__ import annotations

import inspect
import re
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import DISTORTIONS, TERMS
from bayesid.log.formats.labels import WORDS
from bayesid.log.formats.stated import CONVENTIONS
from bayesid.number_text import percent
from bayesid.robot.load import BUILT_IN, built_in_table
from bayesid.studies.algorithm1 import exact, right
from bayesid.studies.discrepancy import CLEAR, by_kind, count, decoded, outside_right, share
from bayesid.studies.paper import covered
from bayesid.studies.real import SURE
from bayesid.studies.record import Row, read_rows
from bayesid.study import STUDIES

ROOT = Path(__file__).resolve().parents[1]
STUDY_PAGES = ROOT / "docs" / "studies"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted(STUDY_PAGES.glob("*.md")))
NAMES = {
    "ur10e/a_50s": "UR10e, 50 s",
    "ur10e/b_20s": "UR10e, 20 s",
    "ur10e/c_unloaded": "UR10e, 50 s, unloaded",
    "ur10e/c_loaded": "UR10e, 50 s, 2.8 kg",
    "panda/a": "Panda, 10 s",
    "tx40/a": "TX40, 5 s, coupled wrist",
}
"""What the real logs are called."""
_KNOWN = 0.1
"""Relative standard deviation up to which a coefficient is known, as in the studies."""
_TABLE = r"(<!-- table: {} -->\n)(.*?)(?=<!-- end of table -->)"
_PEERS = {
    "peers by robot": "torque error on another log",
    "peers by log": "log -> predicted",
    "peers where the truth is known": "simulated",
    "peers without signs": "log without signs",
}
"""Tables of the peers' benchmark, and how their first lines begin."""


# ---------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------
def signs(rows: Sequence[Row]) -> str:
    """Real logs: shares of right signs."""
    head = ["log", "segments", "right, all samples", "right signs", "the same, smooth truth", "sign(velocity) instead"]
    lines = []
    for row in _with_friction(rows):
        shares = [percent(row[key], 2) for key in ("all", "motion", "smooth")]
        cells = [NAMES[row["log"]], row["segments"], *shares, percent(row["velocity"], 1)]
        lines.append([*cells, "yes" if row["certified"] else "no", percent(row["determined"], 1)])
    return markdown([*head, "proven best", "determined"], lines)


def signs_in_short(rows: Sequence[Row]) -> str:
    """Real logs: the shares that matter, beside what needs no model."""
    head = ["log", "right signs", "sign(velocity) instead", "proven best", "verdict"]
    lines = []
    for row in _with_friction(rows):
        name, proven = NAMES[row["log"]], "yes" if row["certified"] else "no"
        lines.append([name, percent(row["motion"], 2), percent(row["velocity"], 1), proven, row["verdict"]])
    return markdown(head, lines)


def verdicts(rows: Sequence[Row]) -> str:
    """Real logs whose verdict is not good, and why."""
    rows = [row for row in _with_friction(rows) if row["why"]]
    lines = [[NAMES[row["log"]], row["verdict"], row["why"].replace("|", r"\|")] for row in rows]
    return markdown(["log", "verdict", "reasons"], lines)


def confidences(rows: Sequence[Row]) -> str:
    """Real logs: what the confidences are worth, also with a model that lacks friction."""
    poor = {row["log"]: row for row in rows if not row["predicts"] and tuple(row["terms"]) != STANDARD}
    areas = "wrong segments are the least confident (AUC), all / in motion"
    without = f"without friction in the model: {SURE:g} and more, wrong, AUC"
    lines = []
    for row in _with_friction(rows):
        other = poor.get(row["log"])
        cells = [NAMES[row["log"]], percent(row["every_sure"], 1), percent(row["every_sure_wrong"], 3)]
        wrong = f"{percent(other['every_sure'], 1)}, {percent(other['every_sure_wrong'], 3)}" if other else ""
        last = f"{wrong}, {other['auc']:.2f}" if other else ""
        lines.append([*cells, f"{row['auc']:.2f} / {row['auc_moving']:.2f}", last])
    return markdown(["log", f"confidence {SURE:g} and more", "of these wrong", areas, without], lines)


def paper(rows: Sequence[Row]) -> str:
    """The paper's experiment, its numbers beside ours."""
    known = int(np.sum(np.median([row["rsd"] for row in rows], axis=0) < _KNOWN))
    torque = ", ".join(percent(error, 1) for error in np.median([row["torque_error"] for row in rows], axis=0))
    lines = [
        ["runs in which every segment above 5 % has the right sign", f"{right(rows)} of {len(rows)}", "1 of 1"],
        ["coefficients", rows[0]["coefficients"], "36"],
        ["of the 26 of Table II that are not zero: known to 10 % (median run)", known, ""],
        ["torque error on a new trajectory, joints 1 to 6 (median)", torque, ""],
        ["95 % intervals that hold the nominal value", percent(covered(rows), 1), ""],
    ]
    return markdown(["", "ours", "paper (one run)"], lines)


def algorithm1(rows: Sequence[Row]) -> str:
    """The paper's experiment to the letter."""
    low, middle, high = (np.percentile([row["segments"] for row in rows], share) for share in (0, 50, 100))
    known = [row["known"] for row in rows]
    infeasible = sum(row["infeasible"] > 0 for row in rows)
    lines = [
        ["runs in which all signs are right", f"{right(rows)} of {len(rows)}", "1 of 1"],
        ["segments, median (least to most)", f"{middle:.0f} ({low:.0f} to {high:.0f})", "39"],
        ["runs with 32 + 10 (segments - 5) nodes", f"{exact(rows)} of {len(rows)}", "1 of 1"],
        ["coefficients of Table II known to 25 %, median (least)", f"{np.median(known):.0f} ({min(known)})", "27"],
        ["runs in which the right signs are infeasible by OLS at some depth", f"{infeasible} of {len(rows)}", ""],
    ]
    return markdown(["", "ours", "paper (one run)"], lines)


def effects(rows: Sequence[Row]) -> str:
    """Blind cases: which effects are named."""
    rows = decoded(rows)
    kinds = by_kind(rows)
    clear = [row for row in kinds["single"] if row["size"] >= CLEAR]
    known = [row for row in rows if row["hidden"] and row["hidden"][0][0] != "outside"]
    seconds = [row["timings"]["discrepancy"] for row in rows]
    signs_right = [row["signs"] for row in rows]
    average, worst = percent(np.mean(signs_right), 2), percent(min(signs_right), 2)
    lines = [
        [f"named first (or equivalent), size >= {CLEAR:g}", share(clear, "first")],
        ["joint right", share([row for row in clear if row["hidden"][0][1] and row["first"]], "joint")],
        ["none hidden, one named", count(kinds["none"], lambda row: bool(row["named"]))],
        ["outside of the catalogue: unexplained, right joint", count(kinds["outside"], outside_right)],
        ["two effects, both found in their joints", share(kinds["pairs"], "all")],
        ["holdout gap over the noise floor, median before and after", _gaps(known)],
        [f"the same, size >= {CLEAR:g}", _gaps([row for row in known if row["size"] >= CLEAR])],
        ["signs right (strong samples), mean and minimum", f"{average}, {worst}"],
        ["seconds per log without identification, median and maximum", f"{np.median(seconds):.1f}, {max(seconds):.0f}"],
    ]
    return markdown([f"{len(rows)} cases", ""], lines)


def _gaps(rows: Sequence[Row]) -> str:
    before, after = (np.median([row[key] for row in rows]) for key in ("before", "after"))
    return f"{before:.2f}, {after:.3f}"


def catalogue() -> str:
    """Every effect: its docstring up to its arguments, and the motion that shows it."""
    lines = []
    for name, kind in sorted({**TERMS, **DISTORTIONS}.items()):
        said = (inspect.getdoc(kind) or "").partition("Args:")[0]
        text = " ".join(said.split()).replace("|", "\\|").replace("`", "")
        lines.append([f"`{name}`", text, kind.shown_by])
    return markdown(["name", "effect", "shown by"], lines)


def robots() -> str:
    """The built-in robots: whose they are, and where their lengths are published."""
    tables = [(built_in_table(name), name) for name in BUILT_IN]
    maker = sorted(tables, key=lambda entry: (entry[0]["description"].split()[0], entry[1]))
    lines = [[f"`{name}`", table["description"], table["source"]] for table, name in maker]
    return markdown(["built-in", "robot", "lengths published in"], lines)


def column_names() -> str:
    """What columns of logs are called."""
    lines = [[f"`{kind}`", ", ".join(f"`{word}`" for word in words.split())] for kind, words in WORDS.items()]
    return markdown(["column", "names"], lines)


def recorders() -> str:
    """The recorders whose columns are known."""
    return markdown(["recorder", "columns"], [[one.name, f"`{one.columns}`"] for one in CONVENTIONS])


def _with_friction(rows: Sequence[Row]) -> list[Row]:
    """The ordinary rows of `real`."""
    return [row for row in rows if not row["predicts"] and tuple(row["terms"]) == STANDARD]


def markdown(head: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    """A table of Markdown."""
    rows = [head, ["---"] * len(head), *lines]
    return "".join(f"| {' | '.join(map(str, row))} |\n" for row in rows)


TABLES: dict[str, tuple[str, Callable[[Sequence[Row]], str]]] = {
    "signs": ("real", signs),
    "signs in short": ("real", signs_in_short),
    "verdicts": ("real", verdicts),
    "confidences": ("real", confidences),
    "paper": ("paper", paper),
    "algorithm1": ("algorithm1", algorithm1),
    "effects": ("discrepancy", effects),
}
"""A table to the study whose rows it shows, and what makes it."""
OF_CODE: dict[str, Callable[[], str]] = {
    "catalogue": catalogue,
    "robots": robots,
    "column names": column_names,
    "recorders": recorders,
}
"""A table to what makes it from the code."""


# ---------------------------------------------------------------------------------------------------------------
# Pages
# ---------------------------------------------------------------------------------------------------------------
def with_tables(page: str, rows: Mapping[str, Sequence[Row]]) -> str:
    """A page with the tables of the studies whose rows are given, by name, and of the code."""
    for name, (study, table) in TABLES.items():
        if study in rows:
            page = _replaced(_TABLE.format(name), page, table(rows[study]))
    for name, of_code in OF_CODE.items():
        page = _replaced(_TABLE.format(name), page, of_code())
    return page


def study_page(name: str, trials: int, report: str) -> str:
    """A study's report and figure as a page."""
    figure = f"![{name}]({name}.svg)\n\n" if (STUDY_PAGES / f"{name}.svg").exists() else ""
    return (
        f"# {name}\n\n<!-- table: report of {name} -->\nStudy `{name}`: {STUDIES[name]} Report of {trials} trials of "
        f"`bayesid study {name}`. Answer: [studies](../studies.md#{name}).\n\n"
        f"{figure}```text\n{report}```\n<!-- end of table -->\n"
    )


def with_peers(page: str, printed: str) -> str:
    """A page with the tables that the peers' benchmark has printed."""
    for name, head in _PEERS.items():
        found = re.search(rf"^\| {re.escape(head)}.*?\n(?=\n|\Z)", printed, flags=re.S | re.M)
        if found:
            page = _replaced(_TABLE.format(name), page, found[0])
    return page


def _replaced(pattern: str, page: str, text: str) -> str:
    """The second group of a pattern, where it occurs, replaced by a text."""
    return re.sub(pattern, lambda found: f"{found[1]}{text}", page, flags=re.S | re.M)


def main(folder: Path) -> None:
    """Renews all pages and figures."""
    finished = [folder / name for name in STUDIES if (folder / name / "report.txt").exists()]
    rows = {place.name: [row for row in read_rows(place) if not row["error"]] for place in finished}
    for place in finished:
        if (STUDY_PAGES / f"{place.name}.svg").exists():
            shutil.copy(place / "figure.svg", STUDY_PAGES / f"{place.name}.svg")
        report = (place / "report.txt").read_text(encoding="utf-8")
        page = study_page(place.name, len(rows[place.name]), report)
        (STUDY_PAGES / f"{place.name}.md").write_text(page, encoding="utf-8")
    printed = folder / "peers.txt"
    peers = printed.read_text(encoding="utf-8") if printed.exists() else ""
    for path in PAGES:
        text = with_peers(with_tables(path.read_text(encoding="utf-8"), rows), peers)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
