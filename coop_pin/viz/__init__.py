"""Views of runs in 3-D, with the forces drawn: replay, live view, images, videos, Jupyter panel, and report.

Public names are loaded on first use: meshcat takes its time.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "LiveView": "coop_pin.viz.live.live_view",
    "LiveRun": "coop_pin.viz.live.live_run",
    "MetricRow": "coop_pin.viz.report",
    "NotebookView": "coop_pin.viz.replay",
    "Panel": "coop_pin.viz.live.panel",
    "metrics_table": "coop_pin.viz.report",
    "notebook_view": "coop_pin.viz.replay",
    "replay_html": "coop_pin.viz.replay",
    "report_html": "coop_pin.viz.report",
    "save_image": "coop_pin.viz.export",
    "save_replay": "coop_pin.viz.replay",
    "save_report": "coop_pin.viz.report",
    "save_video": "coop_pin.viz.export",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
