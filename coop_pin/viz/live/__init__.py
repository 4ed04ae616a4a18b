"""Live view: a run that is drawn while it is computed, and its Jupyter panel.

Open first: ``live_view`` (``cp.open_view``), ``live_run`` (a simulation in a thread, with gains that change),
``panel`` (buttons and sliders in Jupyter).

``live_scene`` makes the frames. ``live_widget`` hands them to a notebook's page through its kernel,
``live_server`` and ``live_server_process`` serve them to browsers.

Imports what ``viz`` imports.
"""
