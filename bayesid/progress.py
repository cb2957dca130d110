"""How far a long computation has come: one `Progress`, silent unless somebody looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Steps = Callable[[int, int], None]  # called as steps(done, total) by one stage


def no_steps(done: int, total: int) -> None:
    """Says nothing."""


def _silent(stage: str, done: int, total: int) -> None:
    """Says nothing."""


@dataclass(frozen=True)
class Progress:
    """What long stages call as progress(stage, done, total), and what that calls to show it.

    Example:
        >>> stages = []
        >>> progress = bayesid.Progress(lambda stage, done, total: stages.append(stage))
        >>> result = bayesid.identify(robot, log, terms, posterior=False, progress=progress)
        >>> stages[:2]
        ['prepare', 'search, round 1']
    """

    show: Callable[[str, int, int], None] = _silent

    def __call__(self, stage: str, done: int, total: int) -> None:
        """A stage has come so far; a stage without steps is one step that is not done yet."""
        self.show(stage, done, total)

    def under(self, heading: str) -> Progress:
        """The same, stages named under a heading: `monday: search`."""
        return Progress(lambda stage, done, total: self.show(f"{heading}: {stage}", done, total))

    def steps(self, stage: str) -> Steps:
        """One stage's own callback."""
        return lambda done, total: self.show(stage, done, total)


SILENT = Progress()  # the default: nobody looks
