"""Columns of a model and of effects; whitened once for every shape of an error model, and kept.

Error models are fitted on a lattice (`regression.selection.error_model`), so that most explanations of a log whiten the
same columns by the same filter again.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.selection.error_model import ErrorModel, bridged, unbridged
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True, eq=False)
class Columns:
    """What a hypothesis adds to the efforts: columns with free amplitudes, and a change without.

    Attributes:
        rows: joint (0-based) to (N, p) columns.
        shift: joint to (N,) change, N m.
        sd: (p,) prior standard deviations of the amplitudes.
        positive: (p,) which of them cannot be negative.
        slight: whether it changes no joint so much that what is left there would be judged otherwise.
    """

    rows: dict[int, Array]
    shift: dict[int, Array]
    sd: Array
    positive: Mask
    slight: bool = False

    @property
    def joints(self) -> set[int]:
        """Joints in which it acts."""
        return set(self.rows) | set(self.shift)

    @property
    def alone(self) -> Columns:
        """The same with arrays of their own: what is kept keeps no others in memory (see `stacked`)."""
        rows, shift = ({j: array.copy() for j, array in part.items()} for part in (self.rows, self.shift))
        return replace(self, rows=rows, shift=shift)


NO_COLUMNS = Columns(rows={}, shift={}, sd=np.zeros(0), positive=np.zeros(0, dtype=bool))
"""Of what leaves no trace."""


class Whitening:
    """Columns filtered to innovations, not divided by their standard deviation: what differs in size alone is shared.

    Those of the model (N, n, r), where samples are used (N, n), and of effects; the latest are kept, up to
    `most_bytes`.
    """

    def __init__(self, columns: Array, used: Mask, *, most_bytes: int = TUNING.kept_bytes) -> None:
        self.columns, self.used, self._most_bytes = columns, used, most_bytes
        self._bare: dict[int, tuple[Integers, Array]] = {}
        self._kept = OrderedDict[tuple[object, ...], tuple[tuple[Array, ...], object]]()
        self._bytes = 0

    def bare(self, joint: int) -> tuple[Integers, Array]:
        """Which (m,) of the model's columns show in a joint (no link shows behind it), and (N, m) these, bridged."""
        if joint not in self._bare:
            own, used = self.columns[:, joint], self.used[:, joint]
            index = np.flatnonzero((own * used[:, None]).any(axis=0))
            self._bare[joint] = index, bridged(np.asfortranarray(own[:, index]), used)
        return self._bare[joint]

    def model(self, joint: int, error: ErrorModel) -> tuple[Array, Array]:
        """(N, m) innovations of the model's columns that show in a joint, and their (m, m) products."""

        def make() -> tuple[Array, ...]:
            white = error.innovations(self.bare(joint)[1], self.used[:, joint])
            return white, white.T @ white

        white, products = self._of((joint, error.shape), None, make)
        return white, products

    def rows(self, effect: Columns, joint: int, error: ErrorModel) -> Array:
        """(N, p) innovations of an effect's columns in a joint where it has some."""
        key = id(effect), "rows", joint, error.shape
        return self._of(key, effect, lambda: (error.whiten(effect.rows[joint], self.used[:, joint]),))[0]

    def shift(self, effect: Columns, joint: int, error: ErrorModel) -> Array:
        """(N,) innovations of an effect's change in a joint where it makes one."""
        key = id(effect), "shift", joint, error.shape
        return self._of(key, effect, lambda: (error.whiten(effect.shift[joint], self.used[:, joint]),))[0]

    def group(self, stack: Array, joint: int, error: ErrorModel, *, keep: bool) -> tuple[Array, Array]:
        """(k, P, P) products of each of k effects' innovations, and (k, P, m) with those of the model's columns.

        Their columns are a stack (k, P, N) as of `together`; the products are kept if the same array will come again.
        """

        def make() -> tuple[Array, ...]:
            white = error.whiten(stack.reshape(-1, stack.shape[2]).T, self.used[:, joint]).T.reshape(stack.shape)
            return white @ white.transpose(0, 2, 1), white @ self.model(joint, error)[0]

        products, across = self._of((id(stack), joint, error.shape), stack, make) if keep else make()
        return products, across

    def across(self, stack: Array, effect: Columns, joint: int, error: ErrorModel, *, keep: bool) -> Array:
        """(k, P, p) products of k effects' innovations (see `group`) with those of one more effect's columns."""

        def pulled() -> tuple[Array, ...]:
            return (self.pulled_back(self.rows(effect, joint, error), joint, error),)

        def make() -> tuple[Array, ...]:
            return (stack @ self._of((id(effect), "pulled", joint, error.shape), effect, pulled)[0],)

        key = id(stack), id(effect), joint, error.shape
        return (self._of(key, (stack, effect), make) if keep else make())[0]

    def pulled_back(self, white: Array, joint: int, error: ErrorModel) -> Array:
        """(N, s) what columns must be multiplied with for the products of their innovations with (N, s)."""
        return unbridged(error.innovations(white[::-1], np.ones(len(white), dtype=bool))[::-1], self.used[:, joint])

    def _of(self, key: tuple[object, ...], owner: object, make: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        """What was kept, or is made and kept with its owner, lest another one takes its id."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        made = make()
        self._kept[key] = made, owner
        self._bytes += sum(array.nbytes for array in made)
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            _, (gone, _) = self._kept.popitem(last=False)
            self._bytes -= sum(array.nbytes for array in gone)
        return made


NOT_YET = Whitening(np.zeros((0, 0, 0)), np.zeros((0, 0), dtype=bool))
"""Of no columns."""


def stacked(effects: Sequence[Columns]) -> list[Columns]:
    """The same effects, with as many amplitudes in the same joints, their arrays views of one for each joint."""
    stacks = {j: together(effects, j)[0] for j in sorted(effects[0].joints)}
    p = len(effects[0].sd)
    return [
        replace(
            effect, rows={j: stacks[j][k, :p].T for j in effect.rows}, shift={j: stacks[j][k, -1] for j in effect.shift}
        )
        for k, effect in enumerate(effects)
    ]


def together(effects: Sequence[Columns], joint: int) -> tuple[Array, bool]:
    """(k, P, N) columns of k effects in a joint, a change behind them if any makes one; and whether it was there.

    Zeros where an effect does nothing. Effects that were `stacked` are not copied.
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
    """The array of three dimensions that all of an effect's part of a joint is a view of, if there is one."""
    parts = [part[joint].base for part in (effect.rows, effect.shift) if joint in part]
    base = parts[0] if parts and all(part is parts[0] for part in parts) else None
    return base if isinstance(base, np.ndarray) and base.ndim == 3 else None
