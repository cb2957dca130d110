"""Progress of long computations; silent by default."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

Steps = Callable[[int, int], None]  # called as steps(done, total) by one stage
Show = Callable[[str, int, int], None]  # called as show(stage, done, total)


def no_steps(done: int, total: int) -> None:
    """Does nothing."""


def _silent(stage: str, done: int, total: int) -> None:
    """Does nothing."""


@dataclass(frozen=True)
class Progress:
    """Calls show(stage, done, total) as stages advance.

    A stage begins with done = 0 and ends with done = total, even if it stops early. A stage without steps is one step.
    """

    show: Show = _silent

    @classmethod
    def of(cls, show: Progress | Show) -> Progress:
        """A progress from a callable."""
        return show if isinstance(show, Progress) else cls(show)

    @contextmanager
    def stage(self, name: str) -> Iterator[Steps]:
        """One stage; the block may call the yielded function as steps(done, total).

        The end is reported once, when the block ends without an exception.
        """
        whole = 1

        def steps(done: int, total: int) -> None:
            nonlocal whole
            whole = total
            if done < total:
                self.show(name, done, total)

        self.show(name, 0, whole)
        yield steps
        self.show(name, whole, whole)

    def under(self, heading: str) -> Progress:
        """The same, stages named under a heading: `monday: search`."""
        return Progress(lambda stage, done, total: self.show(f"{heading}: {stage}", done, total))


SILENT = Progress()  # the default
