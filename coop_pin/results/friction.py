"""Friction that grasps use of what their patches bear, over a run: margins, and when a payload dropped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import rotate_vector6, rotations
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import Pad
from coop_pin.description.scenario import Scenario
from coop_pin.results.breaches import Series
from coop_pin.results.quantity import Arrays

_WHOLE = 1.0 - 1e-9
"""Part of a load share from which it is whole; less is rounding."""
SHOWN = 2.0
"""Part of the friction above which pictures draw this much."""
_SLID = 1e-5
"""Slip from which a patch has slid, m; stuck bristles give less."""


class FrictionUse(NamedTuple):
    """Friction that g grasps use at n samples, as parts of what their pads or patches bear.

    With the tangential force f, the normal force N and the moment m about the normal, u is the friction that
    they need by ``spatial.limit_surface`` over mu N: slip from u = 1 on. Springs of a patch press as its
    moments in the plane say; a pad of a grasp that holds any wrench counts as evenly pressed. NaN where an
    arm does not bear its whole load share: it is free, takes hold or lets go, or a table takes the load.

    Attributes:
        arms: names of the arms.
        normal: N, shape (n, g).
        force: |f| / (mu N), shape (n, g); inf where nothing presses.
        torsion: |m| / (mu N r), likewise, with the torsion radius r of the pad.
        used: part u of the friction, likewise; the margin is 1 - u.
        reserve: normal force beyond what friction needs, N (1 - u), N, shape (n, g); negative from slip on.
    """

    arms: tuple[str, ...]
    normal: Array
    force: Array
    torsion: Array
    used: Array
    reserve: Array


def friction_use(data: Arrays, cell: Cell) -> FrictionUse:
    """Return the friction that patches use, and rigid and compliant grasps with a pad.

    Args:
        data: Arrays of a run.
        cell: Cell of the run.
    """
    pads = cell.padded
    parts = [np.zeros((5, len(np.asarray(data["time"])), 0))]
    parts += [_parts(pad_wrench(data, cell, name, pad), pad)[..., None] for name, pad in pads.items()]
    normal, *shares = np.concatenate(parts, axis=-1)
    bearing = _bearing(data, cell)[:, [list(cell.arms).index(name) for name in pads]]
    return FrictionUse(tuple(pads), normal, *(np.where(bearing, share, np.nan) for share in shares))


def _parts(F: Array, pad: Pad) -> Array:
    """Return N, |f| / (mu N), |m| / (mu N r), u and the reserve of a pad, shape (5, n)."""
    N, need = F[:, 2], pad.needed_friction(F)
    bears, lost = pad.mu * np.maximum(N, 0.0), np.where(np.isnan(F).any(axis=1), np.nan, np.inf)
    loads = (np.linalg.norm(F[:, :2], axis=1), np.abs(F[:, 5]) / pad.torsion_radius, need)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = [np.where(bears > 0.0, load / bears, lost) for load in loads]
    return np.stack((N, *parts, N - need / pad.mu))


def _bearing(data: Arrays, cell: Cell) -> Mask:
    """Return which arms bear their whole load share by the plan, shape (n, m)."""
    shares = np.asarray(data["load_share"]) if "load_share" in data else cell.shares
    shares = np.broadcast_to(shares, (len(np.asarray(data["time"])), len(cell.arms)))
    loads = shares / cell.gain_shares
    whole: Mask = loads > _WHOLE * loads.max(axis=1, keepdims=True)
    return whole & (shares.sum(axis=1, keepdims=True) > _WHOLE)


def pad_wrench(data: Arrays, cell: Cell, name: str, pad: Pad) -> Array:
    """Return the wrench on an arm about the middle of its pad in axes of the plane, shape (n, 6).

    Args:
        data: Arrays of a run.
        cell: Cell of the run.
        name: Name of the arm.
        pad: Patch or pad of the arm.
    """
    if name in cell.patches and "patch_wrench" in data:
        return np.asarray(data["patch_wrench"])[:, list(cell.patches).index(name)]
    R_PW = np.swapaxes(rotations(np.asarray(data["payload_quaternion"])), -1, -2)
    F = rotate_vector6(R_PW, np.asarray(data["interaction_wrench"])[:, list(cell.arms).index(name)])
    return pad.in_plane(F, cell.grasps[name].matrix)


def dropped_at(data: Arrays, scenario: Scenario) -> Array:
    """Return the time from which nothing holds the payload, s, shape (...); NaN if something always does.

    No arm, patch, table or partner exerts a wrench on it then. Without weight it drops from patches only.

    Args:
        data: Arrays of a run, or of runs with the same times.
        scenario: Scenario of the run.
    """
    cell = scenario.cell
    holders = [np.any(np.asarray(data["interaction_wrench"]) != 0.0, axis=(-2, -1))]
    if "patch_points" in data:
        holders.append(np.asarray(data["patch_points"]).sum(axis=-1) > 0.0)
    if "partner_wrench" in data:
        holders.append(np.any(np.asarray(data["partner_wrench"]) != 0.0, axis=-1))
    can_drop = (scenario.has_grasp_plan and any(cell.gravity)) or len(cell.patches) == len(cell.arms)
    falls = ~np.logical_or.reduce(holders) & can_drop
    return np.where(falls.any(axis=-1), np.asarray(data["time"])[falls.argmax(axis=-1)], np.nan)


def drop_metrics(data: Arrays, scenario: Scenario) -> dict[str, Array]:
    """Return when the payload drops, of cells whose payload can; see dropped_at."""
    can_drop = scenario.cell.padded or scenario.has_grasp_plan
    return {"dropped_at_s": dropped_at(data, scenario)} if can_drop else {}


def bearing_slip(data: Arrays, cell: Cell, before: Array | float = 0.0) -> Array:
    """Return the distance that the patch of each arm slides while it bears its load share, m, shape (n, m).

    Args:
        data: Arrays of a run, or of a part of it, at which it starts from zero.
        cell: Cell of the run.
        before: Slip of each patch, and table, before the part, m.
    """
    slip, arms = np.asarray(data["patch_slip"]), list(cell.arms)
    steps = np.maximum(np.diff(slip, axis=0, prepend=np.broadcast_to(before, slip[:1].shape)), 0.0)
    slid = np.zeros((len(slip), len(arms)))
    slid[:, [arms.index(name) for name in cell.patches]] = steps[:, : len(cell.patches)]
    return np.cumsum(np.where(_bearing(data, cell), slid, 0.0), axis=0)


def pad_friction(data: Arrays, cell: Cell) -> Array:
    """Return the part of its friction that the pad of each arm needs, shape (n, m); 0 where none bears."""
    use, arms = friction_use(data, cell), list(cell.arms)
    used = np.zeros((len(use.used), len(arms)))
    for name in cell.pads:
        used[:, arms.index(name)] = np.nan_to_num(use.used[:, use.arms.index(name)], posinf=np.inf)
    return used


def _losses(data: Arrays, cell: Cell) -> list[tuple[int, str, str]]:
    """Return sample, verb and arm of patches that slid or opened while they bore their load share, in order.

    A patch that opens as the payload drops is not one: nothing touches it then.
    """
    if "patch_points" not in data:
        return []
    bearing, slips = _bearing(data, cell), bearing_slip(data, cell)
    losses, points = list[tuple[int, str, str]](), np.asarray(data["patch_points"])
    for number, arm in enumerate(cell.patches):
        index = list(cell.arms).index(arm)
        opened = bearing[:, index] & (points[:, number] == 0.0) & points.any(axis=1)
        marks = {"slides from {} on": slips[:, index] > _SLID, "opens at {}": opened}
        losses += [(int(mask.argmax()), verb, arm) for verb, mask in marks.items() if mask.any()]
    return sorted(losses)


def friction_metrics(data: Arrays, cell: Cell) -> dict[str, float]:
    """Return the metric of cells with patches or pads: the least squeeze beyond what friction needs."""
    least = float(np.fmin.reduce(friction_use(data, cell).reserve, axis=None, initial=np.inf))
    return {"squeeze_reserve_min_N": least if np.isfinite(least) else float("nan")}


def friction_text(data: Arrays, scenario: Scenario) -> str:
    """Return when and why the payload dropped or would have, as a part of a sentence; "" if it did not."""
    cell, time, drop = scenario.cell, np.asarray(data["time"]), float(dropped_at(data, scenario))
    use = friction_use(data, cell)
    lost = list[str]()
    for k, verb, arm in _losses(data, cell):
        N = use.normal[k, use.arms.index(arm)]
        pressed = f", pressed by {N:.3g} N, which bear {cell.patches[arm].mu * N:.3g} N of friction"
        of, only = ("that of", "") if lost else ("the patch of", pressed if N > 0.0 else "")
        lost.append(f"{of} {arm!r} {verb.format(f'{time[k]:.3g} s')}{only}")
    outcome = ", and ".join(filter(None, (", ".join(lost[:-1]), *lost[-1:])))
    if np.isfinite(drop):
        return f"the payload drops at {drop:.3g} s: {outcome or 'no arm holds it'}"
    beyond = [
        f"{arm!r} from {time[(use.used[:, i] > 1.0).argmax()]:.3g} s on"
        for i, arm in enumerate(use.arms)
        if arm in cell.pads and (use.used[:, i] > 1.0).any()
    ]
    would = f"by friction alone the payload would slip from {' and '.join(beyond)}" if beyond else ""
    return "; ".join(part for part in (outcome, would) if part)


def wheel_friction(forces: Array, cell: Cell) -> Series:
    """Return the forces along the ground on the bases that roll, of all arms: 0 of those without.

    Args:
        forces: wheel_force, shape (..., n, b, 3).
        cell: cell.
    """
    needed, borne = np.zeros((2, *forces.shape[:-2], len(cell.arms)))
    columns = [list(cell.arms).index(name) for name in cell.wheels]
    needed[..., columns] = np.linalg.norm(forces[..., :2], axis=-1)
    borne[..., columns] = [base.friction for base in cell.wheels.values()] * forces[..., 2]
    return Series.at_most("wheel slip", needed, borne, needed - borne)
