"""What ``coop-pin view`` does with a scenario."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

from coop_pin.description import Scenario
from coop_pin.run_scenario import run
from coop_pin.viz import open_view


def view_until_interrupted(scenario: Scenario, pace: float | None, port: int, show: Callable[[str], None]) -> None:
    """Serve a live view of a scenario's cell until Ctrl-C, which is how it ends.

    Args:
        scenario: whose cell.
        pace: at which its run goes by, over and over; None for a cell that stands still.
        port: on 127.0.0.1; 0 for any free one.
        show: called with the view's address.

    Raises:
        UnreachablePoseError: the start is out of an arm's reach.
        PortTakenError: the chosen port cannot be had.
        CoopPinError: the run broke off.
    """
    view = open_view(scenario, port=port)
    try:
        show(view.url)
        with contextlib.suppress(KeyboardInterrupt):
            if pace is None:
                threading.Event().wait()
            else:
                while view.is_alive:
                    run(scenario, view=view, pace=pace)
    finally:
        view.close()
