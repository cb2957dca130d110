"""Progress bars, on a terminal only."""

from __future__ import annotations

from typing import NoReturn

from tqdm import tqdm

from bayesid.signs import Progress


class StageBars:
    """Progress bars on a terminal, one for each stage; none when quiet."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: tqdm[NoReturn] | None = None
        self._stage = ""

    def __enter__(self) -> StageBars:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    @property
    def show(self) -> Progress:
        """The callback."""
        return self._show

    def _show(self, stage: str, done: int, total: int) -> None:
        if self._bar is None or stage != self._stage:
            if self._bar is not None:
                self._bar.close()
            self._stage = stage
            disable = True if self._quiet else None  # None: only on a terminal
            self._bar = tqdm(total=total, desc=stage, unit="", delay=1.0, disable=disable, leave=False)
        self._bar.update(done - self._bar.n)


class CountBar:
    """A progress bar with rate and time left, on a terminal."""

    def __init__(self, unit: str, quiet: bool) -> None:
        self._unit = unit
        self._disable = True if quiet else None  # None: only on a terminal
        self._bar: tqdm[NoReturn] | None = None

    def __enter__(self) -> CountBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self, done: int, total: int, failed: int) -> None:
        """The callback; what was done before the first call does not count for the rate."""
        if self._bar is None:
            self._bar = tqdm(total=total, initial=done, unit=self._unit, disable=self._disable, smoothing=0.05)
        if failed:
            self._bar.set_postfix_str(f"{failed} failed", refresh=False)
        self._bar.update(done - self._bar.n)
