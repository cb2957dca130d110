"""Columns of a model and of effects, and their whitened forms, which are cached.

Error models are fitted on a lattice (`regression.selection.error_model`), so most fits to a log use the same filters.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.selection.error_model import ErrorModel, bridged, unbridged
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True, eq=False)
class Columns:
    """Efforts of a hypothesis: columns with free amplitudes, and a fixed change."""

    rows: dict[int, Array]  #: joint (0-based) to (N, p) columns
    shift: dict[int, Array]  #: joint to (N,) change, N m
    sd: Array  #: (p,) prior standard deviations of the amplitudes
    positive: Mask  #: (p,) which amplitudes cannot be negative

    @classmethod
    def of_joints(cls, columns: Array) -> Columns:
        """Columns (N, n, p) of all joints, of either sign, in units of their prior sd."""
        p = columns.shape[2]
        rows = {j: columns[:, j] for j in range(columns.shape[1])}
        return cls(rows, {}, np.ones(p), np.zeros(p, dtype=bool))

    @property
    def joints(self) -> set[int]:
        """Joints with columns or a change."""
        return set(self.rows) | set(self.shift)

    def in_joint(self, joint: int) -> Columns:
        """The part of one (0-based) joint."""
        rows, shift = ({0: part[joint]} if joint in part else {} for part in (self.rows, self.shift))
        return replace(self, rows=rows, shift=shift)

    @property
    def alone(self) -> Columns:
        """A copy with its own arrays, which keeps no other columns in memory (see `stacked`)."""
        rows, shift = ({j: array.copy() for j, array in part.items()} for part in (self.rows, self.shift))
        return replace(self, rows=rows, shift=shift)


NO_COLUMNS = Columns(rows={}, shift={}, sd=np.zeros(0), positive=np.zeros(0, dtype=bool))
"""Columns of an effect that does nothing."""


class Whitening:
    """Columns filtered to innovations, not scaled, so that filters of equal shape share them.

    They are the model's columns (N, n, r), zero where a sample is not used (N, n), and those of effects. The latest are
    cached, up to `most_bytes`.
    """

    def __init__(self, columns: Array, used: Mask, *, most_bytes: int = TUNING.kept_bytes) -> None:
        self.columns, self.used, self._most_bytes = columns, used, most_bytes
        self._bare: dict[int, tuple[Integers, Array]] = {}
        self._kept = OrderedDict[tuple[object, ...], tuple[tuple[Array, ...], object]]()
        self._bytes = 0

    def bare(self, joint: int) -> tuple[Integers, Array]:
        """Indices (m,) of the model's columns that act on a joint, and (N, m) these columns, bridged."""
        if joint not in self._bare:
            columns = self.columns[:, joint]
            index = np.flatnonzero(columns.any(axis=0))
            self._bare[joint] = index, bridged(np.asfortranarray(columns[:, index]), self.used[:, joint])
        return self._bare[joint]

    def always(self, joint: int, error: ErrorModel, beside: Columns) -> tuple[Array, Array]:
        """(N, m) innovations of a joint's model columns and of `beside`, and (folds, m, m) products."""

        def make() -> tuple[Array, ...]:
            used = self.used[:, joint]
            white = error.innovations(self.bare(joint)[1], used)
            if joint in beside.rows:
                white = np.concatenate([white, error.whiten(beside.rows[joint], used)], axis=1)
            return white, by_fold(white, white, error.rate)

        white, products = self._of((joint, error.shape, id(beside)), beside, make)
        return white, products

    def group(self, stack: Array, joint: int, error: ErrorModel, beside: Columns, *, keep: bool) -> tuple[Array, Array]:
        """(k, P, P) products of each of k effects' innovations, and (k, P, m) with those of `always`.

        Their columns are a stack (k, P, N) as of `together`. `keep` caches the products for the same array.
        """

        def make() -> tuple[Array, ...]:
            always, used = self.always(joint, error, beside)[0], self.used[:, joint]
            k, size, count = stack.shape
            products, across = np.empty((k, size, size)), np.empty((k, size, always.shape[1]))
            at_once = max(1, TUNING.whitened_at_once // max(size * count, 1))  # the processor's cache holds them
            for start in range(0, k, at_once):
                some = slice(start, start + at_once)
                white = error.whiten(stack[some].reshape(-1, count).T, used).T.reshape(-1, size, count)
                products[some], across[some] = white @ white.transpose(0, 2, 1), white @ always
            return products, across

        key = id(stack), joint, error.shape, id(beside)
        products, across = self._of(key, (stack, beside), make) if keep else make()
        return products, across

    def pulled_back(self, white: Array, joint: int, error: ErrorModel) -> Array:
        """(N, s) matrix whose products with columns are those of their innovations with `white` (N, s)."""
        return unbridged(error.innovations(white[::-1], np.ones(len(white), dtype=bool))[::-1], self.used[:, joint])

    def _of(self, key: tuple[object, ...], owner: object, make: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        """The cached value, or a new one; the cache holds `owner` so that its id stays unique."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        made = make()
        self._kept[key] = made, owner
        self._bytes += sum(array.nbytes for array in made)
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            _, (evicted, _) = self._kept.popitem(last=False)
            self._bytes -= sum(array.nbytes for array in evicted)
        return made


def blocks_of(duration: float) -> int:
    """Number of blocks of a log of this duration, s: fewer for a short log, at least one per fold."""
    return int(np.clip(duration / TUNING.shortest_block, TUNING.folds, TUNING.blocks))


def rows_of_blocks(samples: int, rate: float) -> list[slice]:
    """Rows of the blocks of a log at a rate, Hz; block b is in fold b modulo `Tuning.folds`."""
    count = blocks_of(samples / rate)
    starts = (-(-np.arange(count + 1) * samples // count)).tolist()
    return [slice(start, stop) for start, stop in pairwise(starts)]


def by_fold(left: Array, right: Array, rate: float) -> Array:
    """(folds, p, q) products of columns (N, p) and (N, q), at a rate in Hz."""
    products = np.zeros((TUNING.folds, left.shape[1], right.shape[1]))
    for block, rows in enumerate(rows_of_blocks(len(left), rate)):
        products[block % TUNING.folds] += left[rows].T @ right[rows]
    return products


def stacked(effects: Sequence[Columns]) -> list[Columns]:
    """The same effects as views of one array per joint, if they have equal joints and numbers of amplitudes."""
    stacks = {j: together(effects, j)[0] for j in sorted(effects[0].joints)}
    p = len(effects[0].sd)
    return [
        replace(
            effect, rows={j: stacks[j][k, :p].T for j in effect.rows}, shift={j: stacks[j][k, -1] for j in effect.shift}
        )
        for k, effect in enumerate(effects)
    ]


def together(effects: Sequence[Columns], joint: int) -> tuple[Array, bool]:
    """(k, P, N) columns of k effects in a joint, with a last one for changes if any; and whether it is there.

    Missing entries are zero. Effects that were `stacked` are not copied.
    """
    p, shifts = len(effects[0].sd), any(joint in effect.shift for effect in effects)
    size, array = p + shifts, _array_of(effects[0], joint)
    whole = array is not None and array.shape[:2] == (len(effects), size)
    if array is not None and whole and all(_array_of(effect, joint) is array for effect in effects):
        return array, True
    count = len(next(iter((effects[0].rows | effects[0].shift).values()))) if effects[0].joints else 0
    stack = np.zeros((len(effects), size, count))
    for k, effect in enumerate(effects):
        if joint in effect.rows:
            stack[k, :p] = effect.rows[joint].T
        if joint in effect.shift:
            stack[k, p] = effect.shift[joint]
    return stack, False


def _array_of(effect: Columns, joint: int) -> Array | None:
    """The three-dimensional array whose view is an effect's part of a joint, if any."""
    parts = [part[joint].base for part in (effect.rows, effect.shift) if joint in part]
    base = parts[0] if parts and all(part is parts[0] for part in parts) else None
    return base if isinstance(base, np.ndarray) and base.ndim == 3 else None
