"""Report of a run as one self-contained HTML page: scenario, metrics, figures, and the 3-D replay."""

from coop_pin.report.report import MetricRow, metrics_table, report_html, save_report

__all__ = ["MetricRow", "metrics_table", "report_html", "save_report"]
