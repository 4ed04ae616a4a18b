"""Views of runs in 3-D, with the forces drawn: replay, live view, images, videos, Jupyter panel, report.

Open first: ``cell_scene`` (what is drawn of a cell and its contacts), ``web/stage.js`` (draws it;
``web/forces.js`` the arrows), ``replay`` (a recorded run as one HTML file).

- Scene: ``scene`` (drawables, scales of arrows), ``camera``, ``frames`` (numbers of an instant).
- Page: ``page``, ``curves`` (plots in time), ``highlights`` (worst instants).
- ``live``: a run while it is computed. ``report``: one page of a run; ``blame_page``: of a log.
- ``export`` (images, videos) by a ``browser``; ``explorer``: heat maps of many runs whose cells open replays.

Names are loaded on first use: meshcat takes its time.

Imports ``base``, ``comparison``, ``description``, ``figures``, ``grasps``, ``identification``, ``model``,
``reference``, ``results``, ``running``, ``simulation`` and ``sweeps``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "LiveRun": "viz.live.live_run",
        "LiveView": "viz.live.live_view",
        "MetricRow": "viz.report",
        "NotebookView": "viz.replay",
        "Panel": "viz.live.panel",
        "blame_html": "viz.blame_page",
        "metrics_table": "viz.report",
        "notebook_view": "viz.replay",
        "replay_html": "viz.replay",
        "report_html": "viz.report",
        "save_blame": "viz.blame_page",
        "save_image": "viz.export",
        "save_replay": "viz.replay",
        "save_report": "viz.report",
        "save_video": "viz.export",
    },
)
