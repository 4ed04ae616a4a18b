"""How far a sweep is, for people: rate, time left, failures."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from tqdm import tqdm


class SweepBar:
    """A progress bar on a terminal's stderr, nowhere else.

    Attributes:
        finished: runs done, those of earlier sessions included.
        failed: runs of these that failed.
    """

    def __init__(self, total: int, quiet: bool) -> None:
        self.finished, self.failed = 0, 0
        # disable=None: tqdm shows itself on terminals only. smoothing near 0: the rate of the whole session.
        self._bar = tqdm(total=total, unit=" runs", disable=True if quiet else None, smoothing=0.05, dynamic_ncols=True)

    def count(self, failed: bool, *, old: bool = False) -> None:
        """Count a run; old ones do not count as speed."""
        self.finished += 1
        self.failed += failed
        if old and not self._bar.disable:
            self._bar.initial += 1
        self._bar.set_postfix_str(f"{self.failed} failed" if self.failed else "", refresh=False)
        self._bar.update(1)

    def say(self, text: str) -> None:
        """Show a text before the bar."""
        self._bar.set_description_str(text, refresh=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._bar.close()
