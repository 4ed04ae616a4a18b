"""Logs: records of arms that held a payload, from CSV, MCAP or a run, and what leaves for other programs.

Open first: ``record`` (joints and wrists by arm, each with its own clock), ``topics`` (samples by the field
names of ROS), ``findings`` (gaps, resets and units that do not fit).

``csv_log`` and ``mcap_log`` read and write topics, ``run_export`` writes a run for ROS, ``lerobot_export``
episodes of runs. A table of the scenario says which topic is which arm.

Imports ``base``, ``description``, ``model`` and ``results``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ArmRecord": "logs.record",
        "Record": "logs.record",
        "Topic": "logs.topics",
        "log_findings": "logs.findings",
        "write_episodes": "logs.lerobot_export",
        "write_run": "logs.run_export",
    },
)
