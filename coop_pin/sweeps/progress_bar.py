"""Progress bar of runs and sweeps."""

from __future__ import annotations

import threading
from typing import Self

from tqdm import tqdm

_EVERY_S = 1.0
"""Time between two drawings of a bar that does not move, s."""


class ProgressBar:
    """A progress bar on a terminal's standard error; nothing is drawn elsewhere, for example in a log file.

    Attributes:
        finished: items done, those of earlier sessions included.
        failed: number of these that failed.

    Args:
        unit: name of what is counted, for example "runs".
        total: number of all; ``advance_to`` can give it later.
        title: text before the bar.
        quiet: draw nothing at all.
        keep: leave the finished bar on the terminal.
    """

    def __init__(
        self, unit: str, *, total: int | None = None, title: str = "", quiet: bool = False, keep: bool = False
    ) -> None:
        self.finished, self.failed = 0, 0
        self._counting, self._over, self._title = threading.Lock(), threading.Event(), title
        # disable=None: tqdm draws on terminals only. smoothing near 0: the rate is that of the whole session.
        self._bar = tqdm(
            desc=f"{title}: getting ready" if title else None,
            total=total,
            unit=f" {unit}",
            leave=keep,
            disable=True if quiet else None,
            smoothing=0.05,
            dynamic_ncols=True,
        )
        if not self._bar.disable:  # also before the first item, while code is compiled
            threading.Thread(target=self._keep_time, name="coop_pin progress", daemon=True).start()

    def _keep_time(self) -> None:
        while not self._over.wait(_EVERY_S):
            self._bar.refresh()

    def advance_to(self, finished: int, total: int) -> None:
        """Show that this many items of all are done."""
        if self.finished == 0 and self._title:
            self.describe(self._title)
        self.finished, self._bar.total = finished, total
        self._bar.update(finished - self._bar.n)

    def count(self, items: int = 1, *, failed: int = 0, old: bool = False) -> None:
        """Count items and the failed ones of them; old ones, of an earlier session, do not enter the rate.

        Any thread may count.
        """
        with self._counting:
            self.finished += items
            self.failed += failed
            if not self._bar.disable:
                self._bar.initial += items * old
                self._bar.set_postfix_str(f"{self.failed} failed" if self.failed else "", refresh=False)
                self._bar.update(items)

    def describe(self, text: str) -> None:
        """Show a text before the bar."""
        self._bar.set_description_str(text, refresh=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        self._bar.close()
