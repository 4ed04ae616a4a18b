"""3-D views of runs, with the forces drawn: live view, replay, images and videos, and a Jupyter panel.

Public names are loaded on first use: meshcat takes its time.
"""

from __future__ import annotations

from typing import Any

from coop_pin.lazy import load_public

_PUBLIC = {
    "LiveView": "coop_pin.viz.live_view",
    "LiveRun": "coop_pin.viz.live_run",
    "NotebookView": "coop_pin.viz.replay",
    "Panel": "coop_pin.viz.panel",
    "notebook_view": "coop_pin.viz.replay",
    "open_view": "coop_pin.viz.live_view",
    "replay_html": "coop_pin.viz.replay",
    "save_image": "coop_pin.viz.export",
    "save_replay": "coop_pin.viz.replay",
    "save_video": "coop_pin.viz.export",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Load a public name on first use."""
    return load_public(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    """List the public names."""
    return list(__all__)
