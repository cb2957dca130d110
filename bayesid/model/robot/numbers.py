"""Numbers of a robot file."""

from __future__ import annotations

from bayesid.arrays import Array, frozen
from bayesid.errors import InputError


def given_numbers(value: object, shape: tuple[int, ...], key: str, where: str) -> Array:
    """What a key of a robot file holds, as finite numbers in a shape.

    Raises:
        InputError: it holds something else.
    """
    try:
        return frozen(value, shape, key)
    except (TypeError, ValueError):
        wanted = "a finite number" if not shape else f"finite numbers in the shape {' x '.join(map(str, shape))}"
        raise InputError(f"key '{key}' cannot be used", where, f"give {wanted}") from None
