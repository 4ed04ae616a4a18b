"""Internal force against loss and delay of messages, for five laws that live on them, over thirty seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from pages import IMAGES, save_image

import coop_pin as cp
from coop_pin.figures.style import styled

CELL, BIAS, SEEDS, DURATION = "adept-anchored", 1e-3, 30, 30.0
LOSSES, DELAYS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3), (0, 1, 2, 3, 4, 6, 8)
LOSS_OF_DELAYS = 0.05
MEAN_GAINS = {"pose_gain": 7.19894, "sign_gain": 115.522, "anchor_gain": 0.0, "transient_rate": 5.0}
"""Gains of the law payload-pi of the benchmark on this cell."""


def laws() -> dict[str, dict[str, Any]]:
    """Return what makes a scenario of the cell one with each of the laws, by its name in the figure."""
    K = list(cp.Scenario.load(CELL).controller.gains.sliding_gain)
    mean = {"kind": "mean-pose", "gains": MEAN_GAINS | {"sliding_gain": K}}
    mean |= {"switching": {"kind": "saturation", "width": 10.0}}
    agreed = {"leak_to": "mean", "gains": mean["gains"] | {"leak": 2.0}}
    consensus = {"averaging": "consensus", "consensus_gain": 0.08}
    return {
        "mean pose, this tick's views": {"controller": mean | {"on_loss": "skip"}},
        "mean pose, last views": {"controller": mean},
        "mean pose by consensus": {"controller": mean | consensus},
        "consensus, integrals agree": {"controller": mean | consensus | agreed},
        "anchored, wrenches told": {"controller.force_path": {"kind": "messages"}, "sensors.wrist": {}},
    }


def forces(changes: Mapping[str, Any], network: Mapping[str, Any]) -> np.ndarray:
    """Return the rms error of the internal force over the last third of each run, N, inf if it diverged."""
    arm = next(iter(cp.Scenario.load(CELL).cell.arms))
    bias = {f"cell.arms.{arm}.calibration_error.tip.xyz": [BIAS, 0.0, 0.0]}
    run = {"network": dict(network), "duration": DURATION, "clock.record_every": 8, "beyond_bound": True}
    base = cp.Scenario.load(CELL, {"events": []}).override(bias | run | dict(changes))
    batch = cp.compiled.simulate_batch([base.replace(seed=seed) for seed in range(SEEDS)])
    late = batch.samples["time"][0] > 2.0 * DURATION / 3.0
    error = np.asarray(batch.samples["internal_axial_error"])[:, late].reshape(SEEDS, -1)
    return np.where(batch.is_valid, np.sqrt(np.mean(error**2, axis=1)), np.inf)


def curves() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the forces of each law by loss and by delay, N, shape (values, seeds) each."""
    return {
        name: (
            np.array([forces(changes, {"loss": loss}) for loss in LOSSES]),
            np.array([forces(changes, {"delay": delay, "loss": LOSS_OF_DELAYS}) for delay in DELAYS]),
        )
        for name, changes in laws().items()
    }


def figure(curves: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Return the figure: medians of the seeds, with bands from the least to the largest."""
    with styled():
        drawing, axes = plt.subplots(1, 2, figsize=(7.2, 3.0), sharey=True, layout="constrained")
        for panel, (ax, values) in enumerate(zip(axes, (LOSSES, DELAYS), strict=True)):
            for name, parts in curves.items():
                draw(ax, values, parts[panel], name)
            ax.set_yscale("log")
        axes[0].set_xlabel("probability of loss, delay 0")
        axes[1].set_xlabel(f"delay, ticks, loss {LOSS_OF_DELAYS:g}\n(a curve ends where runs diverge)")
        axes[0].set_ylabel("internal-force error\nat 1 mm of bias, N")
        axes[1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawing


def draw(ax: Any, values: Sequence[float], forces: np.ndarray, name: str) -> None:
    """Draw one law over the values at which no run diverged."""
    kept = np.isfinite(forces).all(axis=1)
    x, y = np.array(values)[kept], np.maximum(forces[kept], 1e-4)
    (line,) = ax.plot(x, np.median(y, axis=1), marker="o", markersize=3, label=name)
    ax.fill_between(x, y.min(axis=1), y.max(axis=1), alpha=0.2, color=line.get_color(), linewidth=0)


def main() -> None:
    """Simulate, print the medians and write the image of the page."""
    found = curves()
    for name, parts in found.items():
        for values, forces_of in zip((LOSSES, DELAYS), parts, strict=True):
            print(name, {x: f"{np.median(f):.3g}" for x, f in zip(values, forces_of, strict=True)})
    print(save_image(figure(found), Path(IMAGES) / "messages"))


if __name__ == "__main__":
    main()
