"""Showing runs: a 3-D replay or live view with the forces drawn, and figures. Shows what was recorded, computes no physics.

Everything is loaded on first use: meshcat and matplotlib take their time.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "LiveView": "coop_pin.viz.live_view",
    "LiveRun": "coop_pin.viz.live_run",
    "NotebookView": "coop_pin.viz.replay",
    "Panel": "coop_pin.viz.panel",
    "Viewer": "coop_pin.viz.live_view",
    "notebook_view": "coop_pin.viz.replay",
    "open_view": "coop_pin.viz.live_view",
    "replay_html": "coop_pin.viz.replay",
    "save_image": "coop_pin.viz.export",
    "save_replay": "coop_pin.viz.replay",
    "save_video": "coop_pin.viz.export",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
