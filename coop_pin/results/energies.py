"""Energy balance of a run: its energy, the work done on it, and what neither explains."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.results.quantity import Arrays

WORK = ("work_actuation", "work_friction", "work_external", "work_payload_change")
"""Work done since the start: by the three forces besides gravity; last by changes of payload and gravity."""
WORK_OF_GRASPS = ("work_grasps",)
"""Work after that of WORK, in cells with compliant grasps, patches or tables."""
WORK_OF_STOPS = ("work_stops",)
"""Work after these, in cells whose arms or payload have end stops."""
WORK_OF_LINKS = ("work_payload_joints",)
"""Work after these, in cells whose payload has several links."""


def work_names(is_elastic: bool, has_stops: bool, has_links: bool = False) -> tuple[str, ...]:
    """Return the names of the works of a cell in their order.

    Args:
        is_elastic: Whether it has compliant grasps, patches or tables.
        has_stops: Whether its arms or its payload have end stops.
        has_links: Whether its payload has several links.
    """
    return WORK + is_elastic * WORK_OF_GRASPS + has_stops * WORK_OF_STOPS + has_links * WORK_OF_LINKS


def energies(data: Arrays) -> tuple[Array, list[Array]]:
    """Return the energy of a cell, J, and all work done on it, J, that its run records."""
    energy = np.asarray(data["kinetic_energy"]) + np.asarray(data["potential_energy"])
    works = [np.asarray(data[name]) for name in work_names(True, True, True) if name in data]
    for name in ("elastic_energy", "stop_energy", "payload_joint_energy"):
        if name in data:
            energy = energy + np.asarray(data[name])
    return energy, works


def start_energy(data: Arrays) -> Array:
    """Return the energy before the first sample, and before an event there, J, shape (..., 1)."""
    energy, works = energies(data)
    return energy[..., :1] - sum(work[..., :1] for work in works)


def unexplained_energy(data: Arrays, start: Array) -> Array:
    """Return the energy that is neither that of the start nor work done, J, shape (..., n).

    Args:
        data: arrays of a run, or of a part of it.
        start: start_energy of the run, shape (..., 1).
    """
    energy, works = energies(data)
    return energy - start - sum(works)


def energy_balance(data: Arrays) -> Array:
    """Return the energy minus all work done, less the same at the start, J, shape (..., n).

    It is zero for an exact integration. The work of an event at the start is done at the first sample.
    """
    return unexplained_energy(data, start_energy(data))
