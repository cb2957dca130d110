"""Do the tests detect a wrong sign, factor, index or comparison? Random changes of numerical expressions.

`python -m bayesid.studies.mutations --count 60 --seed 0` changes one expression in a copy of the source, runs the tests
of its package (`tests/NAME`) until the first failure, and prints the changes that no test detects. Seed and source
determine the changes. Some have no observable effect (a bound that is never reached): compare the share with that of an
earlier commit.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

PACKAGES = ("effects", "regression", "signs", "posterior", "identification")
LONGEST = 600
"""s, limit for the tests of one package; exceeding it (an endless loop) counts as detected."""
_SWAPPED: dict[type[ast.operator], ast.operator] = {
    ast.Add: ast.Sub(),
    ast.Sub: ast.Add(),
    ast.Mult: ast.Div(),
    ast.Div: ast.Mult(),
}
_REVERSED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.Gt(),
    ast.Gt: ast.Lt(),
    ast.LtE: ast.GtE(),
    ast.GtE: ast.LtE(),
    ast.Eq: ast.NotEq(),
    ast.NotEq: ast.Eq(),
}


@dataclass(frozen=True)
class Mutation:
    """One changed expression.

    Attributes:
        path: of the file, below the root.
        line: where the expression begins.
        kind: sign, factor, index or comparison.
        before: the expression.
        after: the changed expression.
        place: (first line, first column, last line, last column) of the expression; columns in bytes.
    """

    path: str
    line: int
    kind: str
    before: str
    after: str
    place: tuple[int, int, int, int]

    @property
    def package(self) -> str:
        """The package whose tests should detect it."""
        return self.path.split("/")[1]

    def applied(self, source: str) -> str:
        """The source with the change."""
        first, begin, last, end = self.place
        lines = source.encode().splitlines(keepends=True)
        head, tail = lines[first - 1][:begin], lines[last - 1][end:]
        changed = head + f"({self.after})".encode() + tail
        return b"".join([*lines[: first - 1], changed, *lines[last:]]).decode()

    def __str__(self) -> str:
        """Place and change."""
        return f"{self.path}:{self.line} {self.kind}: {self.before} -> {self.after}"


def mutations_of(source: str, path: str) -> Iterator[Mutation]:
    """All changes of a file's functions, except in texts, annotations and raise statements."""
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef):
            for node in _numerical(function.body):
                changed = _changed(node)
                if changed is not None and isinstance(node, ast.expr):
                    assert node.end_lineno is not None
                    assert node.end_col_offset is not None
                    place = (node.lineno, node.col_offset, node.end_lineno, node.end_col_offset)
                    yield Mutation(path, node.lineno, changed[0], ast.unparse(node), changed[1], place)


def _numerical(nodes: Sequence[ast.AST]) -> Iterator[ast.AST]:
    for node in nodes:
        if isinstance(node, ast.JoinedStr | ast.Raise | ast.FunctionDef):
            continue
        yield node
        fields = [value for name, value in ast.iter_fields(node) if name not in ("annotation", "returns")]
        flat = [item for value in fields for item in (value if isinstance(value, list) else [value])]
        yield from _numerical([item for item in flat if isinstance(item, ast.AST)])


def _changed(node: ast.AST) -> tuple[str, str] | None:
    """Kind and text of the changed expression; None for other nodes."""
    if isinstance(node, ast.BinOp) and type(node.op) in _SWAPPED and not _is_text(node):
        kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "factor"
        return kind, ast.unparse(ast.BinOp(node.left, _SWAPPED[type(node.op)], node.right))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
        return "sign", ast.unparse(node.operand)
    if isinstance(node, ast.Constant) and isinstance(node.value, float) and 0.0 < node.value < np.inf:
        return "factor", repr(2.0 * node.value)
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, int):
        return "index", ast.unparse(ast.Subscript(node.value, ast.Constant(1 - node.slice.value), ast.Load()))
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _REVERSED:
        return "comparison", ast.unparse(ast.Compare(node.left, [_REVERSED[type(node.ops[0])]], node.comparators))
    return None


def _is_text(node: ast.BinOp) -> bool:
    parts = [part for side in (node.left, node.right) for part in ast.walk(side)]
    return any(
        isinstance(part, ast.JoinedStr) or (isinstance(part, ast.Constant) and isinstance(part.value, str))
        for part in parts
    )


def drawn(root: Path, count: int, seed: int) -> list[Mutation]:
    """Random changes, each kind equally often."""
    found: dict[str, list[Mutation]] = {}
    for package in PACKAGES:
        for path in sorted((root / "bayesid" / package).rglob("*.py")):
            name = path.relative_to(root).as_posix()
            for mutation in mutations_of(path.read_text(encoding="utf-8"), name):
                found.setdefault(mutation.kind, []).append(mutation)
    rng = np.random.default_rng(seed)
    kinds = sorted(found)
    return [found[kind][rng.integers(len(found[kind]))] for kind, _ in zip(kinds * count, range(count), strict=False)]


def fails(root: Path, package: str, mutation: Mutation | None = None) -> bool:
    """Whether a test of a package fails in a copy of the source, with a change if one is given."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "bayesid"
        copy.mkdir()
        for name in ("bayesid", "studies", "tests", "docs"):
            shutil.copytree(root / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(root / name, copy / name)
        if mutation is not None:
            changed = copy / mutation.path
            changed.write_text(mutation.applied(changed.read_text(encoding="utf-8")), encoding="utf-8")
        return _tests_fail(copy, package)


def _tests_fail(root: Path, package: str) -> bool:
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", f"tests/{package}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    try:
        ended = subprocess.run(command, cwd=root, env=environment, capture_output=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return True
    return ended.returncode != 0


def main() -> None:
    """Prints the changes, detected or missed, and the share of detected ones."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=60, help="number of changes (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the random changes (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="in parallel (default: one per core)")
    parser.add_argument("--root", type=Path, default=Path(__file__).parents[1], help="folder of the source")
    options = parser.parse_args()
    mutations, caught = drawn(options.root, options.count, options.seed), 0
    with ThreadPoolExecutor(options.workers) as pool:
        red = [
            name for name, red in zip(PACKAGES, pool.map(partial(fails, options.root), PACKAGES), strict=True) if red
        ]
        if red:
            sys.exit(f"tests fail without any change: {', '.join(red)}")
        results = pool.map(lambda mutation: fails(options.root, mutation.package, mutation), mutations)
        for mutation, failed in zip(mutations, results, strict=True):
            caught += failed
            print("detected" if failed else "MISSED  ", mutation, flush=True)
    print(f"{caught} of {len(mutations)} changes detected ({100 * caught / len(mutations):.0f} %)")


if __name__ == "__main__":
    main()
