"""Progress bars, on a terminal only."""

from __future__ import annotations

import sys
import time
from threading import Event, RLock, Thread
from typing import NoReturn

from tqdm import tqdm

_DELAY = 1.0
"""s; a stage that ends sooner is not worth a bar."""


class StageBars:
    """Progress bars on a terminal, one for each stage that takes over a second; none when quiet."""

    def __init__(self, quiet: bool) -> None:
        self._shown = not quiet and sys.stderr.isatty()
        self._bar: tqdm[NoReturn] | None = None
        self._stage = ""
        self._ended, self._drawing = Event(), RLock()
        self._clock = Thread(target=self._tick, daemon=True)

    def __enter__(self) -> StageBars:
        if self._shown:
            self._clock.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._clock.is_alive():
            self._clock.join()
        self._close()

    def show(self, stage: str, done: int, total: int) -> None:
        """The callback of `bayesid.identify` and its like; a stage without steps is one step that is not done yet."""
        if not self._shown:
            return
        with self._drawing:
            if self._bar is None or stage != self._stage:
                self._close()
                self._stage = stage
                self._bar = tqdm(total=total, desc=stage, unit="", delay=_DELAY, leave=False)
            self._bar.update(done - self._bar.n)

    def _close(self) -> None:
        bar, self._bar = self._bar, None
        if bar is not None:
            bar.close()

    def _tick(self) -> None:
        """Keeps the elapsed time of a stage running that says nothing for a while."""
        while not self._ended.wait(0.5):
            with self._drawing:
                if self._bar is not None and time.time() - self._bar.start_t > _DELAY:
                    self._bar.refresh()


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
