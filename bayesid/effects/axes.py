"""Functions of one variable of a motion; a learned effect is a sum of their products.

A smooth function is a Gaussian process by the eigenfunctions of the Laplacian on an interval (Solin and Sarkka,
Hilbert space methods for reduced-rank Gaussian process regression, 2020), here cosines, which include the constant.
Other functions are periodic ones of a revolute joint, powers, the direction of motion, and exponentials in time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.tuning import TUNING


class Quantity(IntEnum):
    """Kind of a variable, by its number in model.toml."""

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    LOAD = 3
    TIME = 4


class Family(IntEnum):
    """Functions of an axis, by their number in model.toml."""

    SMOOTH = 0  # cosines over the range seen, the constant first
    PERIODIC = 1  # cos(h x), sin(h x), cos(2 h x) ...; with an odd count the constant comes first
    POWER = 2  # x^s, x^(s + 1) ...
    ODD = 3  # x |x|^(s - 1)
    DIRECTION = 4  # tanh(x / v)
    FADING = 5  # 1, exp(-x / T)
    EVEN = 6  # |x|^s


@dataclass(frozen=True)
class Axis:
    """A variable, and the functions of it that are used."""

    quantity: Quantity  # kind of variable
    joint: int  # of which joint (from 1); 0 for the time
    family: Family  # which functions
    low: float  # least value that the log has shown, in the variable's unit
    high: float  # the largest value
    order: float  # h of PERIODIC, s of POWER, ODD and EVEN, v of DIRECTION, T of FADING, in the variable's unit
    count: int  # number of functions

    @property
    def variable(self) -> tuple[Quantity, int]:
        return self.quantity, self.joint

    def columns(self, x: Array) -> Array:
        """(N, count) the functions at values x (N,).

        Outside the log's range, smooth functions and sums of powers are constant; a single power is constant only
        beyond another half range.
        """
        match self.family:
            case Family.SMOOTH:
                start = self.low - TUNING.margin * (self.high - self.low)
                return np.cos(np.outer(np.clip(x, self.low, self.high) - start, self.frequencies))
            case Family.PERIODIC:
                angle = np.outer(x, self.order * np.arange(1, self.count // 2 + 1))
                waves = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(len(x), -1)
                return np.column_stack([np.ones(len(x)), waves]) if self.count % 2 else waves
            case Family.POWER:
                return self._clipped(x)[:, None] ** (self.order + np.arange(self.count))
            case Family.ODD | Family.EVEN:
                kept = self._clipped(x)[:, None]
                return np.abs(kept) ** self.order * (np.sign(kept) if self.family is Family.ODD else 1.0)
            case Family.DIRECTION:
                return np.tanh(x / self.order)[:, None]
        return np.column_stack([np.ones(len(x)), np.exp(-np.maximum(x, 0.0) / self.order)])

    @property
    def frequencies(self) -> Array:
        """(count,) of cosines, in radians per unit of the variable."""
        return np.pi * np.arange(self.count, dtype=np.float64) / ((1.0 + 2.0 * TUNING.margin) * (self.high - self.low))

    def density(self, length: float) -> Array:
        """(count,) prior variances, adding up to 1.

        For cosines: a squared exponential kernel with a length relative to the range. For periodic functions: the
        fourth power of 1 / harmonic, as of a function with kinks. For others: equal.
        """
        if self.family is Family.PERIODIC:
            waves = np.repeat(np.arange(1.0, self.count // 2 + 1) ** -4.0, 2)
            variances = np.concatenate([np.ones(self.count % 2), waves])
            return np.asarray(variances / variances.sum())
        if self.family is not Family.SMOOTH:
            return np.full(self.count, 1.0 / self.count)
        density = np.exp(-0.5 * (self.frequencies * length * (self.high - self.low)) ** 2)
        density[1:] *= 2.0  # the mean square of a cosine is a half
        return np.asarray(density / density.sum())

    @property
    def constant(self) -> bool:
        """Whether the first of the functions is the constant."""
        powers, waves = self.family is Family.POWER, self.family is Family.PERIODIC
        among_others = (powers and self.order == 0.0) or (waves and self.count % 2 == 1)
        return self.family in (Family.SMOOTH, Family.FADING) or among_others

    def _clipped(self, x: Array) -> Array:
        further = TUNING.beyond * (self.high - self.low) if self.count <= 2 else 0.0
        return np.clip(x, self.low - further, self.high + further)


def products(axes: list[Array]) -> Array:
    """(N, p) products of one column of each of some arrays (N, p1), (N, p2) ..., the last one's fastest."""
    product = axes[0]
    for columns in axes[1:]:
        product = (product[:, :, None] * columns[:, None, :]).reshape(len(product), -1)
    return product


def scaled_to_one(columns: Array, used: Mask) -> Array:
    """(p,) RMS of columns (N, p) over the used samples (N,)."""
    return np.asarray(np.sqrt(np.mean(columns[used] ** 2, axis=0)))


@dataclass(frozen=True)
class Component:
    """One of the functions that are added: combinations of the products of its axes' functions."""

    axes: tuple[Axis, ...]  # its variables, each with its functions
    weights: Array  # (p, k) combinations of the p products that are k columns

    def columns(self, values: Callable[[Axis], Array]) -> Array:
        """(N, k) from the (N,) values of each axis' variable."""
        return np.asarray(products([axis.columns(values(axis)) for axis in self.axes]) @ self.weights)
