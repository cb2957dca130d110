"""Numbers of a robot file."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array, frozen
from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST
from bayesid.robot.tuning import TUNING


def given_numbers(value: object, shape: tuple[int, ...], key: str, where: str, most: float = LARGEST) -> Array:
    """What a key of a robot file holds, as numbers of this world in a shape.

    Args:
        value: of the key.
        shape: of the numbers.
        key: for messages.
        where: for messages.
        most: that each may be, either way.

    Raises:
        InputError: it holds something else.
    """
    try:
        numbers = frozen(value, shape, key)
        if np.abs(numbers).max(initial=0.0) > most:
            raise InputError(
                f"key '{key}' holds {np.abs(numbers).max():g}", where, f"give {most:g} at most, in SI units"
            )
        return numbers
    except InputError:
        raise
    except (TypeError, ValueError):
        wanted = "a finite number" if not shape else f"finite numbers in the shape {' x '.join(map(str, shape))}"
        raise InputError(f"key '{key}' cannot be used", where, f"give {wanted}") from None


def check_count(n_joints: int, where: str) -> None:
    """Refuses what has more moving joints than any robot.

    Raises:
        InputError: it has.
    """
    if n_joints > TUNING.most_joints:
        remedy = f"give a robot of {TUNING.most_joints} joints at most, or the chain to identify (`tip`)"
        raise InputError(f"has {n_joints} moving joints", where, remedy)
