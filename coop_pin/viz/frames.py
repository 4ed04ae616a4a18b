"""Frames of a scene: one row of numbers per instant, the same for a recorded run and for one under way.

A row holds the time, poses of bodies, payload and desired pose (m, and quaternions x, y, z, w), positions of
the tips (m), wrenches about P in world axes (N and N m), tension and twist of the struts of the virtual
linkage and those wanted (N and N m), the forces on the arms that no strut carries (N), and warning codes
of bodies and contacts.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial.internal_wrench import determinate_grasp, virtual_linkage
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import Partner
from coop_pin.figures import palette
from coop_pin.model.visuals import CellVisuals
from coop_pin.results.quantities import QUANTITIES
from coop_pin.results.quantity import Samples, computed
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.viz.contact_scene import contact_nodes, contact_poses

FRAMES_PER_SECOND = 30.0
NEAR_SINGULAR = 100.0
"""Condition number of the payload Jacobian from which an arm counts as near singular; 5 to 20 is usual."""

PLAIN, SINGULAR, SATURATED, FREE = 0, 1, 2, 3
"""Codes of warning colours, also those of the legend's lines (data-warning); contacts have two more."""

WARNING_COLOURS = (None, palette.SINGULAR, palette.SATURATED, palette.FREE, palette.SLIDES)
"""Warning colours by code; None is the body's own colour. What has a code beyond them is not drawn."""


class CellFrames:
    """Frames of a cell.

    Attributes:
        visuals: bodies of the arms.
        nodes: paths of the nodes that move, in the order of their poses.
        blocks: names and numbers of columns of the blocks of a row, in their order.
    """

    def __init__(
        self, cell: Cell, visuals: CellVisuals, partners: Sequence[Partner] = (), *, nearest: bool = False
    ) -> None:
        self.visuals, self._cell, self._partners = visuals, cell, partners
        arms, warned = len(cell.arms), [f"arms/{body.name}" for body in visuals.bodies]
        warned += contact_nodes(cell, partners, nearest)
        self.nodes = (*warned, "payload", "desired")
        self.blocks = {
            "time": 1,
            "poses": 7 * len(self.nodes),
            "tips": 3 * arms,
            **dict.fromkeys(("interaction", "internal", "wanted"), 6 * arms),
            "external": 6,
            "struts": 2 * arms * (arms - 1),
            "across": 3 * arms,
            "warnings": len(warned),
        }

    def rows(self, samples: Samples) -> Array:
        """Return the frames of samples, shape (n, columns); NaN in wrenches counts as zero.

        Args:
            samples: quantities by name, n samples along the first axis, as of ``run_samples``.
        """
        names, n = [body.name for body in self.visuals.bodies], len(samples["time"])
        saturated, condition = samples["saturated"].astype(bool), samples["jacobian_condition"]
        wrenches = ("interaction_wrench", "internal_wrench", "desired_internal_wrench", "external_wrench")
        poses, codes = contact_poses(samples, self._cell, self._partners)
        parts = (
            samples["time"],
            self.visuals.poses(samples["configuration"]),
            poses,
            *(
                samples[f"{of}_{part}"]
                for of in ("payload", "desired")
                for part in ("position", "quaternion")
            ),
            samples["tip_position"],
            *(np.nan_to_num(samples[name]) for name in wrenches),
            *strut_columns(samples, self._cell),
            warning_codes(names, self.visuals.joints, saturated, condition, free_arms(samples)),
            codes,
        )
        return np.concatenate([part.reshape(n, -1) for part in parts], axis=1)


def run_samples(result: RunResult) -> Samples:
    """Return the recorded samples of a run, by names of quantities."""
    return {str(name): result.data[name].values for name in ("time", *result.data.data_vars)}


def strut_columns(samples: Samples, cell: Cell) -> tuple[Array, Array]:
    """Return tension and twist of the struts, and those wanted, shape (n, 2, p, 2), and the forces across.

    Arms that hold nothing have no struts. Beside joints the split of the load decides about tensions, so that
    struts are those of the internal wrenches.

    Args:
        samples: quantities by name, n samples along the first axis.
        cell: the cell.

    Returns:
        Tensions, N, and twists, N m; forces on the arms that no strut carries, N, shape (n, m, 3).
    """
    F = samples["internal_wrench" if cell.splits_load else "interaction_wrench"]
    p_WP = samples["payload_position"][:, None]
    wrenches = np.stack((F, np.where(np.isnan(F), F, samples["desired_internal_wrench"])), axis=1)
    tips = np.broadcast_to((samples["tip_position"] - p_WP)[:, None], (*wrenches.shape[:-1], 3))
    wrenches, tips = determinate_grasp(wrenches, tips)
    pairs = list(itertools.combinations(range(wrenches.shape[2]), 2))
    struts, across = np.zeros((len(F), 2, len(pairs), 2)), np.zeros((*F.shape[:2], 3))
    free = np.broadcast_to(free_arms(samples), F.shape[:2])
    for pattern in np.unique(free, axis=0):
        rows, holds = np.flatnonzero((free == pattern).all(axis=1))[:, None], np.flatnonzero(~pattern)
        held = [number for number, pair in enumerate(pairs) if not pattern[list(pair)].any()]
        if len(holds) > 1 or len(pattern) == 1:
            part = virtual_linkage(wrenches[rows[:, 0]][:, :, holds], tips[rows[:, 0]][:, :, holds])
            struts[rows, :, held] = part.struts.swapaxes(1, 2)
            across[rows, holds] = part.rest[:, 0, :, :3]
    return struts, across


def snapshot_samples(snapshot: Snapshot, cell: Cell) -> Samples:
    """Return a snapshot as one sample, with the quantities that follow from it."""
    values = {
        name: np.asarray(value)[None] for name, value in snapshot._asdict().items() if value is not None
    }
    follow = [q for q in QUANTITIES if q.source is not None and q.dims != "arm joint"]  # of the payload
    names = {q.name for q in follow if not (q.group or q.name in values)}
    if snapshot.measured_internal_wrench is not None:
        names |= {q.name for q in follow if q.name.startswith("measured_internal_")}
    return computed(QUANTITIES, values, cell.shares, names)


def frame_samples(time: Array, frames_per_second: float, instants: Sequence[float] = ()) -> Array:
    """Return the indices of the samples that hold at an even frame rate and at instants, and of the last.

    Args:
        time: times of the samples, s, increasing, shape (n,).
        frames_per_second: 1/s.
        instants: s.
    """
    times = np.concatenate((np.arange(time[0], time[-1], 1.0 / frames_per_second), instants, time[-1:]))
    return np.unique(np.maximum(np.searchsorted(time, times + 1e-9, side="right") - 1, 0))


def free_arms(samples: Samples) -> Mask:
    """Return which arms hold nothing by the plan, shape (n, m); none in a run without a plan.

    Args:
        samples: quantities by name, n samples along the first axis.
    """
    condition = samples["jacobian_condition"]
    return np.equal(samples.get("load_share", np.ones_like(condition)), np.zeros_like(condition))


def warning_codes(
    bodies: Sequence[str], joints: Mapping[str, Sequence[str]], saturated: Mask, condition: Array, free: Mask
) -> NDArray[np.int8]:
    """Return the codes of the bodies' warning colours.

    The whole arm has a warning colour near a singularity and while it holds nothing, the driven link at a
    torque limit.

    Args:
        bodies: ``<arm>/<joint>`` or ``<arm>/base``; others are plain.
        joints: driven joints of each arm, in the order of the arrays.
        saturated: mask of the torques at their limits, shape (n, m, k).
        condition: condition numbers of the payload Jacobians, shape (n, m).
        free: mask of the arms that hold nothing, shape (n, m).

    Returns:
        Codes, shape (n, bodies).
    """
    arms = list(joints)
    codes = np.full((len(condition), len(bodies)), PLAIN, dtype=np.int8)
    for index, body in enumerate(bodies):
        name, _, joint = body.partition("/")
        if name not in joints:  # a link of the payload
            continue
        arm = arms.index(name)
        codes[free[:, arm], index] = FREE
        codes[condition[:, arm] >= NEAR_SINGULAR, index] = SINGULAR
        if joint in joints[name]:
            codes[saturated[:, arm, joints[name].index(joint)], index] = SATURATED
    return codes
