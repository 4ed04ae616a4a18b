"""Dask's scheduler and worker without the web server that each of them opens beside its own port."""

from __future__ import annotations

from typing import Any

from distributed import Scheduler, Worker


class QuietScheduler(Scheduler):
    """A scheduler that listens on its own port only."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open nothing: ``dashboard=False`` leaves a server for health checks and statistics on port 8787."""


class QuietWorker(Worker):
    """A worker that listens on its own port only."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open nothing."""
