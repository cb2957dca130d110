"""A learned effect in words: its variables, a formula, and the known families that it looks like."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.effects.axes import Axis, Component, Family, Quantity, products
from bayesid.effects.tuning import TUNING

Shape = tuple[float, list[tuple[str, Array]]]
"""Multiple of the variable in a sine, 0 without a sine, and the texts and columns that are added."""
_WORDS = {
    Quantity.POSITION: ("q", "position"),
    Quantity.VELOCITY: ("dq", "speed"),
    Quantity.ACCELERATION: ("ddq", "acceleration"),
    Quantity.LOAD: ("tau", "load"),
}
"""Symbol and noun of the joint quantities."""


@dataclass(frozen=True)
class Description:
    """Text about a learned effect."""

    variables: tuple[str, ...]  # q4, dq5, ddq1, tau2 (the load) or t
    formula: str  # the effort in N m (N in a joint that slides); f is a smooth function, its RMS before it
    depends: str  # on what, in words
    families: tuple[str, ...]  # known families that it resembles, in words

    @property
    def sentence(self) -> str:
        """Depends on the positions of joints 4 and 6; not a friction effect."""
        return "; ".join([f"depends on {self.depends}", *self.families])


def described(
    joint: int, components: Sequence[Component], amplitudes: Sequence[Array], unit: str = "N m"
) -> Description:
    """A learned effect of a joint (from 1), a sum of functions, each with amplitudes (p,) of its products, in words."""
    parts = list(zip(components, amplitudes, strict=True))
    texts = [text for component, amplitude in parts for text in _terms(component, amplitude)]
    variables = {axis.variable for component in components for axis in component.axes}
    symbols = [symbol(*variable) for variable in sorted(variables)]
    if len(texts) > TUNING.most_terms:
        rms = float(np.sqrt(sum(np.mean(surface(component, amplitude)[1] ** 2) for component, amplitude in parts)))
        texts = [f"{_number(rms)} f({', '.join(symbols)})"]
    formula = " + ".join(texts).replace("+ -", "- ")
    return Description(
        variables=tuple(symbols),
        formula=f"{formula} {unit}" if len(texts) == 1 else f"({formula}) {unit}",
        depends=_dependence(parts),
        families=tuple(dict.fromkeys(_families(joint, parts))),
    )


def symbol(quantity: Quantity, joint: int) -> str:
    """Of a variable: q4, dq5, t."""
    return f"{_WORDS[quantity][0]}{joint}" if quantity in _WORDS else "t"


def surface(component: Component, amplitude: Array) -> tuple[list[Array], Array]:
    """Values of a function's variables over the range seen, and the (g1, g2, ...) effort on their grid, N m.

    The amplitudes (p,) are those of its products.
    """
    grids = [np.linspace(axis.low, axis.high, TUNING.grid) for axis in component.axes]
    values = amplitude.reshape([axis.count for axis in component.axes])
    for k, (axis, grid) in enumerate(zip(component.axes, grids, strict=True)):
        values = np.moveaxis(np.tensordot(axis.columns(grid), values, axes=(1, k)), 0, k)
    return grids, values


def _terms(component: Component, amplitude: Array) -> Iterator[str]:
    """The products that a function is the sum of, or the name of a smooth function."""
    fixed = [axis for axis in component.axes if axis.count == 1]
    free = [axis for axis in component.axes if axis.count > 1]
    grids, values = surface(Component(tuple(free), component.weights), amplitude) if free else ([], amplitude)
    factors = [_function_text(axis) for axis in fixed]
    written = _sum(free, grids, np.asarray(values)) if len(free) <= TUNING.most_products else None
    if written is not None:
        for size, texts in written:
            yield " ".join([_number(size), *filter(None, texts), *factors])
        return
    names = ", ".join(dict.fromkeys(symbol(*axis.variable) for axis in free))
    rms = float(np.sqrt(np.mean(values**2)))
    yield " ".join([_number(rms), f"f({names})", *factors])


def _sum(axes: Sequence[Axis], grids: Sequence[Array], values: Array) -> list[tuple[float, list[str]]] | None:
    """Size and texts of products whose sum is a function on a grid; None if more than a few are needed."""
    if not axes:
        return [(float(values.ravel()[0]), [])]
    if len(axes) == 1:
        shape = _shape(axes[0], grids[0], values)
        return None if shape is None else [(shape[1], [shape[0]])]
    left, sizes, right = np.linalg.svd(values)
    total, written, approximation = float(np.sum(values**2)), [], np.zeros_like(values)
    for k in range(TUNING.most_products):
        first, second = _shape(axes[0], grids[0], left[:, k]), _shape(axes[1], grids[1], right[k])
        if first is None or second is None:
            return None
        written.append((float(sizes[k]) * first[1] * second[1], [first[0], second[0]]))
        approximation = approximation + sizes[k] * np.outer(first[2], second[2])
        if np.sum((values - approximation) ** 2) < (1.0 - TUNING.explained) * total:
            return written
    return None


def _shape(axis: Axis, grid: Array, values: Array) -> tuple[str, float, Array] | None:
    """Text, factor and values of the simplest function of a variable that fits the given values; None if none does."""
    for turns, parts in _plain_shapes(axis, grid, symbol(*axis.variable)):
        waves = [np.sin(turns * grid), np.cos(turns * grid)] if turns else []
        columns = np.stack([*waves, *(column for _, column in parts)], axis=1)
        found = np.asarray(np.linalg.lstsq(columns, values, rcond=None)[0], dtype=np.float64)
        shape = np.asarray(columns @ found, dtype=np.float64)
        if np.sum((values - shape) ** 2) < (1.0 - TUNING.explained) * np.sum(values**2) + TINY:
            return *_sum_text(symbol(*axis.variable), turns, [text for text, _ in parts], found.tolist()), shape
    return None


def _plain_shapes(axis: Axis, grid: Array, name: str) -> Iterator[Shape]:
    """Functions that the axis allows, the simplest first; a smooth axis allows all."""
    smooth = axis.family is Family.SMOOTH
    powers = smooth or axis.family is Family.POWER
    constant, straight, square = ("", np.ones_like(grid)), (name, grid), (f"{name}^2", grid**2)
    turns = _sine_multiples(axis)
    yield 0.0, [constant]
    if powers:
        yield 0.0, [straight]
        yield 0.0, [square]
        yield 0.0, [straight, constant]
    if smooth and axis.quantity is Quantity.VELOCITY:
        yield 0.0, [(f"{name} |{name}|", grid * np.abs(grid))]
    yield from ((h, []) for h in turns)
    if axis.family is Family.FADING:
        fading = f"exp(-t / {_number(axis.order)} s)", axis.columns(grid)[:, 1]
        yield 0.0, [fading]
        yield 0.0, [constant, fading]
    yield from ((h, [constant]) for h in turns)
    if powers:
        yield 0.0, [square, straight, constant]


def _sine_multiples(axis: Axis) -> list[float]:
    """Multiples of a variable that a sine may have."""
    if axis.family is Family.PERIODIC:
        return [axis.order * k for k in range(1, axis.count // 2 + 1)]
    whole_turns = axis.family is Family.SMOOTH and axis.quantity is Quantity.POSITION
    return [float(k) for k in range(1, 9)] if whole_turns else []


def _sum_text(name: str, turns: float, texts: list[str], amplitudes: list[float]) -> tuple[str, float]:
    """A sum as text and factor, that of its first part: sin(3 q6 + 0.4), or (q2^2 - 0.3 q2 + 0.1)."""
    if turns:
        sine, cosine, *amplitudes = amplitudes
        phase, size = math.atan2(cosine, sine), math.hypot(sine, cosine)
        angle = name if turns == 1 else f"{_number(turns)} {name}"
        first = f"sin({angle} {_signed(phase)})" if abs(phase) > 5e-3 else f"sin({angle})"  # none to two digits
    else:
        (first, *texts), (size, *amplitudes) = texts, amplitudes
    pairs = zip(amplitudes, texts, strict=True)
    others = [f"{_signed(amplitude / (size or TINY))} {text}".strip() for amplitude, text in pairs]
    return (f"({first or '1'} {' '.join(others)})" if others else first), size


def _function_text(axis: Axis) -> str:
    name = symbol(*axis.variable)
    named = {Family.DIRECTION: f"sign({name})", Family.ODD: f"{name} |{name}|", Family.EVEN: f"|{name}|"}
    return named.get(axis.family, name if axis.order == 1.0 else f"{name}^{axis.order:g}")


def _number(value: float) -> str:
    return f"{value:.2g}" if abs(value) < 100.0 else f"{value:.0f}"


def _signed(value: float) -> str:
    return f"{'-' if value < 0.0 else '+'} {_number(abs(float(value)))}"


def _dependence(parts: Sequence[tuple[Component, Array]]) -> str:
    """The positions of joints 4 and 6 and the direction of motion of joint 5."""
    axes = [axis for component, _ in parts for axis in component.axes]
    speeds = {axis.variable for axis in axes if axis.family is not Family.DIRECTION}
    turning = sorted({axis.joint for axis in axes if axis.variable not in speeds})
    words = []
    for quantity in Quantity:
        joints = sorted({axis.joint for axis in axes if axis.quantity is quantity and axis.variable in speeds})
        if joints and quantity in _WORDS:
            words.append(f"the {_WORDS[quantity][1]}{'s' * (len(joints) > 1)} of {_joints(joints)}")
        if quantity is Quantity.VELOCITY and turning:
            words.append(f"the direction of motion of {_joints(turning)}")
        if joints and quantity is Quantity.TIME:
            words.append("the time since the recording began")
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _joints(joints: Sequence[int]) -> str:
    first = ", ".join(map(str, joints[:-1]))
    return f"joints {first} and {joints[-1]}" if first else f"joint {joints[0]}"


def _families(joint: int, parts: Sequence[tuple[Component, Array]]) -> Iterator[str]:
    speed = (Quantity.VELOCITY, joint)
    turning = [_odd(component, amplitude, speed) for component, amplitude in parts]
    if not any(axis.variable == speed for component, _ in parts for axis in component.axes):
        yield "not a friction effect"
    elif all(turning):
        yield f"odd in the speed of joint {joint}, as friction is"
    for component, _ in parts:
        for axis in component.axes:
            if axis.family is Family.PERIODIC and axis.quantity is Quantity.POSITION and axis.count <= TUNING.few_waves:
                times = "once" if axis.order == 1.0 else f"{axis.order:g} times"
                yield f"repeats {times} in a turn of joint {axis.joint}"
            if axis.family is Family.PERIODIC and axis.quantity is Quantity.TIME:
                yield f"oscillates at {_number(axis.order / (2.0 * np.pi))} Hz"
            if axis.family is Family.FADING:
                yield f"exponential in time, over {_number(axis.order)} s, as a joint that warms up"


def _odd(component: Component, amplitude: Array, variable: tuple[Quantity, int]) -> bool:
    """Whether a function changes its sign with a variable."""
    if all(axis.variable != variable for axis in component.axes):
        return False
    grids = np.meshgrid(*(_sample_values(axis, variable) for axis in component.axes), indexing="ij")
    values = []
    for sign in (1.0, -1.0):
        turned = [sign if axis.variable == variable else 1.0 for axis in component.axes]
        each = zip(component.axes, turned, grids, strict=True)
        values.append(products([axis.columns(way * grid.ravel()) for axis, way, grid in each]) @ amplitude)
    even, whole = values[0] + values[1], values[0] - values[1]
    return float(np.sum(even**2)) < TUNING.odd * float(np.sum(whole**2))


def _sample_values(axis: Axis, variable: tuple[Quantity, int]) -> Array:
    """Some values of a variable; of the one with changing sign only those seen with both signs."""
    low, high = (0.0, min(-axis.low, axis.high)) if axis.variable == variable else (axis.low, axis.high)
    return np.linspace(low, max(high, low), 9)[1:]
