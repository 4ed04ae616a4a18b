"""A progress bar for people: on a terminal's stderr, nowhere else."""

from __future__ import annotations

from typing import Self

from tqdm import tqdm


class ProgressBar:
    """Shows how far a run is; a context manager that leaves the terminal clean."""

    def __init__(self, title: str, quiet: bool) -> None:
        # disable=None: tqdm shows itself on terminals only
        self._bar = tqdm(desc=title, unit=" ticks", leave=False, disable=True if quiet else None)

    def show(self, done: int, total: int) -> None:
        """Show that so many ticks of all are done."""
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._bar.close()
