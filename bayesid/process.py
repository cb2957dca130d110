"""What all threads of a process share, changed so that each finds it as it was: warnings, matplotlib's settings, BLAS.

Settings that are changed for a while and put back are torn where two threads overlap: the second keeps what the first
had changed as if it had always been so. Here one at a time changes them, and the last one puts them back.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator, contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Given = ParamSpec("Given")
Result = TypeVar("Result")

ALONE = threading.RLock()
"""Held while settings of the process are changed, by whoever changes them."""


def one_at_a_time(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """A function that only one thread is in: ArviZ, xarray, pandas and matplotlib change warnings as they go."""

    @wraps(function)
    def alone(*given: Given.args, **named: Given.kwargs) -> Result:
        with ALONE:
            return function(*given, **named)

    return alone


@contextmanager
def quiet(category: type[Warning]) -> Iterator[None]:
    """Leaves warnings of a category unsaid; short work only, as no other thread enters meanwhile.

    Args:
        category: of them.
    """
    with ALONE, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


class _OneBlasThread(ContextDecorator):
    """The threads inside, counted: the first sets the limit, the last lifts it."""

    def __init__(self) -> None:
        self._inside = 0
        self._limits: threadpool_limits | None = None

    def __enter__(self) -> None:
        with ALONE:
            if self._inside == 0:
                self._limits = threadpool_limits(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with ALONE:
            self._inside -= 1
            if self._inside == 0 and self._limits is not None:
                self._limits.restore_original_limits()


one_blas_thread = _OneBlasThread()
"""Around functions and blocks whose matrices are small, where threads only wait for each other."""
