"""3-D views of runs, with the forces drawn: live view, replay, images and videos, and a Jupyter panel.

Public names are loaded on first use: meshcat takes its time.
"""

from coop_pin import lazy_names

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
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
