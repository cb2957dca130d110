"""Golden results: the figures of 48 seeded runs, to compare versions of the code.

    python -m bayesid.studies.golden --check studies/golden.json     # before and after a change; exit 1 if they differ
    python -m bayesid.studies.golden --compare before.json now.json  # every figure that differs, of two full files
    python -m bayesid.studies.golden --update                        # after an intended change

A run is a few commands of `bayesid`; figures are read from the files that the last one writes. Budgets of searches and
sampling count work: no figure depends on the machine's load, and none is a time.

Tolerances. Text, whole numbers and hashes of signs must be equal. A figure x with the error e, written [x, e], equals y
with the error f if |x - y| is at most 1e-6 of the larger or at most 5 hypot(e, f). Figures without draws have no error,
except for coefficients and their sd, with 2e-7 sd. Figures of posterior draws have their Monte Carlo error, with ESS
the run's smallest effective sample size: sd / sqrt(ESS) for a mean and an sd, and sqrt(max(s (1 - s), 1 / ESS) / ESS)
for a share s. Where a seed only changes draws, the command runs with two seeds: an error is then at least the
difference over sqrt(2), and text that differs is not compared. The full file (--out) has all figures. The reference in
git has a hash of them, to the last digit, and a selection: for a list (names with #) the sum of cos(k) x_k, with 2e-7
of the list's norm as the error.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import math
import os
import re
import shlex
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from bayesid.arrays import Array
from bayesid.cli import main as bayesid
from bayesid.studies.discrepancy import generator
from bayesid.studies.real import DATA

Figures: TypeAlias = dict[str, Any]
"""Names with text, whole numbers, floats, or [float, error]; name#element for the elements of a list."""
Results: TypeAlias = dict[str, dict[str, Any]]  # runs, each with `hash` and `figures`, or with `error`
REFERENCE = Path(__file__).with_name("golden.json")
RELATIVE, ERRORS, _SMALL = 1e-6, 5.0, 2e-7  # ERRORS * _SMALL = RELATIVE
_DRAWN, _ROW = "differs between seeds", "{:<24} {:<44} {:<34} {}"
_STRONG, _SURE = 0.05, 0.99  # share of a joint's largest |effort| at which a sign counts; probability of a sure sign
_CASES = 20
_BRIEF = "--no-posterior --no-report"
_PLAIN = f"{_BRIEF} --complete off --out result"
_SIMULATE = "simulate --duration 10 --seed 1"
_LOADED = f"{_SIMULATE} --effect payload:2:0.2 --out loaded.csv"
_SHORT = ("demo", "real/ur10e/b_20s", "real/ur10e/c_unloaded", "blind/00", "blind/01", "gains/kr5", "tracker/simulated")


class Run(NamedTuple):
    """Commands of `bayesid`, run in an empty folder.

    Attributes:
        name: part/case.
        commands: the last one writes the folder `out`, from which figures are read.
        truth: logs with the true signs of the rows of `signed_log.csv`; none if unknown.
        seeds: of the last command; none for its default.
        case: number of the simulated case whose files are in the folder; -1 for none.
    """

    name: str
    commands: tuple[str, ...]
    truth: tuple[Path, ...] = ()
    seeds: tuple[int, ...] = ()
    case: int = -1


def simulated_runs() -> Iterator[Run]:
    """Demo, gains, payload, tracker, excitation, and simulated discrepancies."""
    yield Run("demo", ("demo --posterior-budget 3600 --out out",))
    wrong = "--gains 0.8~20%,1.2~20%,0.9~20%,1.1~20%,1.25~20%,0.85~20% --out out"
    for robot in ("kr5", "ur10e"):
        log, identify = _simulated(robot)
        yield Run(f"gains/{robot}", (log, f"{identify} {wrong}"), (Path("log_signed.csv"),))
    payload, track = "payload result loaded.csv --out out", "track result loaded_signed.csv --lag 0.05"
    yield Run("payload/simulated", (*_simulated("kr5"), f"{_LOADED} --robot kr5", payload), seeds=(0, 1))
    yield Run("tracker/simulated", (*_simulated("panda"), f"{_LOADED} --robot panda", f"{track} --out out"))
    yield Run("excite/robot", ("excite --robot kr5 --duration 10 --out out",))
    yield Run("excite/result", (*_simulated("ur10e"), "excite --for result --duration 10 --changes 300 --out out"))
    identify = f"identify baseline.csv --robot robot.toml {_PLAIN} --terms TERMS"
    compare = "discrepancy result log.csv --holdout holdout.csv --no-posterior --out out"
    for case in range(_CASES):
        yield Run(f"blind/{case:02d}", (identify, compare), (Path("truth.csv"),), case=case)


def _simulated(robot: str) -> tuple[str, str]:
    """Commands that make a log and its result."""
    return f"{_SIMULATE} --robot {robot} --out log.csv", f"identify log.csv --robot {robot} {_PLAIN}"


def real_runs() -> Iterator[Run]:
    """Real logs, whose logged signs are hidden and serve as truth."""
    for log in sorted(DATA.resolve().glob("*/*.csv")):
        name = f"{log.parent.name}/{log.stem}"
        if log.parent.name == "lbr":  # minutes each: in `bayesid study real --floor`
            continue
        yield Run(f"real/{name}", (f"{_identify(log)} {_BRIEF} --out out",), (log,))
        if name in ("ur10e/c_unloaded", "panda/a"):
            sampled = f"{_identify(log)} --no-report --out out"
            yield Run(f"posterior/{name}", (sampled,), (log,), seeds=(0, 1))
    healthy, loaded = (DATA.resolve() / "ur10e" / name for name in ("c_unloaded.csv", "c_loaded.csv"))
    first, second = f"{_identify(healthy)} {_PLAIN}", f"{shlex.quote(str(loaded))} --unsigned all --out out"
    known = f"{first} --payload {shlex.quote(f'2.8~0.005@{loaded}')} --gains {','.join(6 * ['1~20%'])} --out out"
    yield Run("gains/real", (known,), (healthy, loaded))
    yield Run("payload/real", (first, f"payload result {second}"), seeds=(0, 1))
    yield Run("tracker/real", (first, f"track result {second} --lag 0.05"))


def _identify(log: Path) -> str:
    robot = next(log.parent.glob("robot.*"))
    return f"identify {shlex.quote(str(log))} --robot {shlex.quote(str(robot))} --unsigned all"


def figures_of(run: Run) -> Figures:
    """Runs the commands, the last one with each of its seeds."""
    with tempfile.TemporaryDirectory() as place, chdir(place):
        found, figures = [], _write_case(run.case) if run.case >= 0 else {}
        for words in run.commands[:-1]:
            _command(words)
        for more in [f" --seed {seed}" for seed in run.seeds] or [""]:
            _command(run.commands[-1] + more)
            found.append(read_figures(Path("out"), run.truth))
            Path("out").rename(f"out{len(found)}")
        return figures | _of_seeds(found[0], found[-1])


def _command(words: str) -> None:
    output, terms = io.StringIO(), Path("terms.txt")
    words = words.replace("TERMS", terms.read_text(encoding="utf-8").strip()) if terms.exists() else words
    code = 2  # of wrong options
    with redirect_stderr(output), redirect_stdout(output), suppress(SystemExit):
        code = bayesid([*shlex.split(words), "--quiet"])
    if code >= 128:
        raise KeyboardInterrupt  # caught by the command
    if code:
        raise RuntimeError(f"bayesid {words}: exit code {code}: {output.getvalue().strip()[-300:]}")


def _write_case(number: int) -> Figures:
    """Writes the files of a simulated case; its hidden effects."""
    blind = generator("golden")
    truth = blind.make_case(".", *blind.plan(_CASES, 0)[number])
    header = ",".join(f"tau{j}" for j in range(1, len(truth.noise) + 1))
    np.savetxt("truth.csv", truth.log_efforts, delimiter=",", header=header, comments="")
    hidden = [{"effect": name, "joints": joints} for name, joints in zip(truth.effects, truth.joints, strict=True)]
    return {**_flat("hidden", hidden), "hidden.size": truth.size}


def _of_seeds(first: Figures, second: Figures) -> Figures:
    """The figures of the first seed, with errors of at least the difference from the second."""
    merged = {name: value if second.get(name) == value else _DRAWN for name, value in first.items()}
    for name in first.keys() & second.keys():
        if merged[name] == _DRAWN and isinstance(first[name], float | list):
            (x, error), (y, _) = _with_error(first[name]), _with_error(second[name])
            merged[name] = [x, max(error, abs(x - y) / math.sqrt(2.0))]
    return merged


_TAKEN: Mapping[str, str] = {
    "summary": "n_samples n_segments n_coefficients terms processing.cutoff_hz search.method search.certified "
    "search.cost search.lower_bound search.sdp_solves noise.sd fit.relative_residual posterior.converged "
    "complete.effects complete.held_back_error.before complete.held_back_error.after gains.mean gains.sd "
    "gains.ratio_sd gains.factor gains.decided_by gains.converged payloads.payload.mass.value verdict.state",
    "discrepancy": "status found gap.before gap.after gap.noise_floor unexplained.joint where.joint not_borne_out",
    "payload": "shown check.passed check.chi_square check.residual_ratio posterior.converged",
    "stream": "summary.instants summary.rms_residual summary.largest_external_over_threshold n_alarms "
    "summary.smoothing.share summary.smoothing.sure summary.known_signs.share",
    "alarms": "kind joint joints time raised amount explained",
    "design": "start.condition_number reached joint_resolvability undecided limits.reached",
    "next_motion": "about information_gain_nats open_now open open_after_random_motion certain_signs reached checked",
}  # paths of the figures in each JSON file


def read_figures(folder: Path, truth: Sequence[Path] = ()) -> Figures:
    """Figures of a result folder; `truth` as in `Run`."""
    files = [file for file in sorted(folder.glob("*.json")) if file.stem in _TAKEN]
    contents = {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files}
    figures: Figures = {}
    for name, content in contents.items():
        for path in _TAKEN[name].split():
            figures |= _flat(f"{name}.{path}", _at(content, path))
    for name, path in (("summary", "complete.effects"), ("discrepancy", "found")):
        for k, effect in enumerate(_at(contents.get(name), path) or (), 1):
            figures[f"{name}.log10_bayes_factor#{k}"] = effect["log10_bayes_factor"]
    draws = (content["posterior"] for content in contents.values() if "posterior" in content)
    ess = next((posterior["min_ess"] for posterior in draws if posterior), math.inf)
    for name in ("mass", "com", "inertia"):
        for k, estimate in enumerate(np.atleast_1d(contents.get("payload", {}).get(name, [])), 1):
            error = estimate["sd"] / math.sqrt(ess)
            figures |= {f"payload.{name}.{kind}.{k}": [estimate[kind], error] for kind in ("value", "sd")}
    return figures | (_of_tables(folder, truth, ess) if (folder / "signed_log.csv").exists() else {})


def _of_tables(folder: Path, truth: Sequence[Path], ess: float) -> Figures:
    """Coefficients; signs of segments and samples; shares of confident signs, and of right ones."""
    segments = [line.split(",")[:5] for line in (folder / "segments.csv").read_text().splitlines()]
    signs = np.sign(_columns(folder / "signed_log.csv", "tau")).astype(int)
    sure = np.maximum(positive := _columns(folder / "signed_log.csv", "p"), 1.0 - positive)
    figures: Figures = {"signs.segments": _sha(segments), "signs.samples": _sha(signs.tolist())}
    for row in csv.DictReader((folder / "coefficients.csv").open(encoding="utf-8")):
        for kind in ("mean", "sd") if row["sd"] else ():
            figures[f"{kind}#{row['name']}"] = [float(row[kind]), max(_SMALL, ess**-0.5) * float(row["sd"])]
    shares = {"confidence": sure.mean(), "sure": (sure >= _SURE).mean()}
    if truth:
        effort = np.concatenate([_columns(path, "tau") for path in truth])
        strong = np.abs(effort) >= _STRONG * np.abs(effort).max(axis=0)
        shares["right"] = (signs == np.sign(effort))[strong].mean()
    for name, s in shares.items():
        error = math.sqrt(max(s * (1.0 - s), 1.0 / ess) / ess)
        figures[f"signs.{name}"] = [float(s), error] if error else float(s)
    return figures


def _columns(path: Path, stem: str) -> Array:
    """(N, n) columns stem1 to stemn of a CSV file."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    names = table.dtype.names or ()
    return np.column_stack([table[name] for name in names if re.fullmatch(rf"{stem}\d+", name)])


def _at(content: Any, path: str) -> Any:
    """The value at a path, in every element of a list; None if there is none."""
    for key in path.split("."):
        content = [item.get(key) for item in content] if isinstance(content, list) else (content or {}).get(key)
    return content


def _flat(name: str, value: Any) -> Figures:
    """Figures of a value: numbers of a list one by one, any other list as one text."""
    if isinstance(value, dict):
        return {key: x for part, deeper in value.items() for key, x in _flat(f"{name}.{part}", deeper).items()}
    if not isinstance(value, list):
        return {} if value is None else {name: value}
    if value and all(isinstance(item, float) for item in value):
        return {f"{name}#{k}": item for k, item in enumerate(value, 1)}
    named = ([item["effect"], *item["joints"]] if isinstance(item, dict) else [item] for item in value)
    return {name: " ".join(":".join(map(str, words)) for words in named)}


def _sha(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def reduced(figures: Figures) -> Figures:
    """Figures of the reference: one number per list, and eight digits."""
    kept = {name: value for name, value in figures.items() if "#" not in name}
    for stem in dict.fromkeys(name.partition("#")[0] for name in figures if "#" in name):
        values, errors = np.array([_with_error(figures[name]) for name in figures if name.startswith(f"{stem}#")]).T
        weights = np.cos(np.arange(1.0, len(values) + 1.0))
        error = max(_SMALL * float(np.linalg.norm(values)), float(np.abs(weights) @ errors))
        kept[f"{stem}#{len(values)}"] = [float(weights @ values), float(f"{error:.1e}")]
    return json.loads(json.dumps(kept), parse_float=lambda digits: float(f"{float(digits):.8g}"))


def _with_error(value: Any) -> tuple[float, float]:
    return (value[0], value[1]) if isinstance(value, list) else (value, 0.0)


def same(first: Any, second: Any) -> bool:
    """Whether two figures are equal within the tolerances of the module."""
    if not (isinstance(first, float | list) and isinstance(second, float | list)):
        return bool(first == second) or _DRAWN in (first, second)
    (x, e), (y, f) = _with_error(first), _with_error(second)
    return abs(x - y) <= max(RELATIVE * max(abs(x), abs(y)), ERRORS * math.hypot(e, f))


def differences(before: Results, after: Results) -> list[str]:
    """One line per figure that differs; none for runs with the same hash."""
    lines, missing = [], {"error": "missing"}
    for run in dict.fromkeys([*before, *after]):
        first, second = before.get(run, missing), after.get(run, missing)
        if "error" in first or "error" in second:
            lines.append(_ROW.format(run, "run", first.get("error", "done"), second.get("error", "done")))
        elif first["hash"] != second["hash"]:
            old, new = first["figures"], second["figures"]
            pairs = ((name, old.get(name, "missing"), new.get(name, "missing")) for name in dict.fromkeys([*old, *new]))
            lines += [_ROW.format(run, name, str(x), str(y)) for name, x, y in pairs if not same(x, y)]
    return lines


def execute(chosen: Iterable[Run], out: Path = Path(os.devnull)) -> Results:
    """Makes runs one by one; a failed one keeps its error. The file is updated after each run."""
    results: Results = {}
    for run in chosen:
        began = time.perf_counter()
        try:
            figures = figures_of(run)
            result = {"hash": _sha(figures), "figures": figures}
        except Exception as error:  # any: the other runs follow
            result = {"error": f"{type(error).__name__}: {error}"}
        results[run.name] = result
        out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        print(f"{run.name:<24} {time.perf_counter() - began:6.1f} s  {result.get('error', 'done')}", flush=True)
    return results


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, compares and writes; returns 1 if a figure differs or a run failed."""
    parser = argparse.ArgumentParser(prog="python -m bayesid.studies.golden")
    add = parser.add_argument
    add("--out", type=Path, default=os.devnull, metavar="FILE", help="file for all figures")
    add("--only", nargs="+", default=[""], metavar="NAME", help="beginnings of names of runs")
    add("--short", action="store_const", dest="only", const=_SHORT, help="a few quick runs")
    add("--list", action="store_true", help="print the names of the runs")
    add("--check", type=Path, metavar="FILE", help="compare with this reference")
    add("--update", action="store_true", help=f"write these runs into {REFERENCE.name}")
    add("--compare", type=Path, nargs=2, metavar="FILE", help="compare two full files; run nothing")
    options = parser.parse_args(arguments)
    if options.compare:
        return _compared(*(json.loads(path.read_text(encoding="utf-8")) for path in options.compare))
    if not DATA.is_dir():
        print(f"runs on real logs are left out: no folder {DATA}; set BAYESID_DATA to the folder of the logs")
    every = [*simulated_runs(), *(real_runs() if DATA.is_dir() else ())]
    chosen = [run for run in every if run.name.startswith(tuple(options.only))]
    if options.list:
        print("\n".join(run.name for run in chosen))
        return 0
    results = execute(chosen, options.out)
    few = {name: {**result, "figures": reduced(result.get("figures", {}))} for name, result in results.items()}
    if options.update:  # one line per run; other runs keep theirs
        kept = json.loads(REFERENCE.read_text(encoding="utf-8")) if REFERENCE.exists() else {}
        text = json.dumps({**kept, **few}, separators=(",", ":"))
        REFERENCE.write_text(text.replace("}},", "}},\n") + "\n", encoding="utf-8")
    failed = int(any("error" in result for result in results.values()))
    if options.check is None:
        return failed
    reference = json.loads(options.check.read_text(encoding="utf-8"))
    return max(failed, _compared({name: result for name, result in reference.items() if name in few}, few))


def _compared(before: Results, after: Results) -> int:
    """Prints a table of differences; returns the exit code."""
    lines = differences(before, after)
    exact = sum(result.get("hash", "") == after.get(name, {}).get("hash") for name, result in before.items())
    print(_ROW.format("run", "figure", "before", "after"), *lines, sep="\n")
    print(f"{len(lines)} differences; {exact} of {len(before)} runs are the same to the last digit")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
