"""Report of a run as one self-contained HTML page: scenario, metrics, figures, and the 3-D replay.

Everything is loaded on first use, because matplotlib and the replay are slow to load.
"""

from __future__ import annotations

from typing import Any

from coop_pin.lazy import load_public

_PUBLIC = {
    "MetricRow": "coop_pin.report.report",
    "metrics_table": "coop_pin.report.report",
    "report_html": "coop_pin.report.report",
    "save_report": "coop_pin.report.report",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Load a public name on first use."""
    return load_public(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    """List the public names."""
    return list(__all__)
