"""The honest part: what alpha, K_f and a kinematic bias do to the internal force under law (23).

Runs about thirty simulations, prints their numbers and writes docs/images/internal-force.png and .svg:

    python studies/internal_force.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import coop_pin as cp
from coop_pin.results.judgements import axial_directions
from coop_pin.viz.figures import (
    BiasRun,
    ForceGainRun,
    InternalForceStudy,
    SignGainRun,
    internal_force_study_figure,
    save_figure,
)

IMAGES = Path(__file__).parent.parent / "docs" / "images"
ALPHA = "controller.gains.sign_gain"
QUIET = {"events": [], "duration": 10.0}
LOW_PASS = {"controller.force_path": {"kind": "low-pass", "pole": 0.9}}
STEPS = {80.0: 5, 400.0: 1, 2000.0: 1}


def force_error(changes: dict[str, Any]) -> float:
    """Return the rms of the internal-force error from 4 to 10 s, N."""
    return cp.run("adept-paper", QUIET | changes).internal_force().force_rms_error


def biased(alpha: float) -> BiasRun:
    """Return the internal force over 20 s with the left arm's kinematics off by 0.1 mm."""
    data = cp.run("adept-paper", {"events": [], ALPHA: alpha, "cell.arms.left.calibration_error.xyz": [1e-4, 0.0, 0.0]}).data
    force = np.nan_to_num(data.internal_wrench.values[:, 0, :3])
    return BiasRun(alpha, data.time.values, np.einsum("ni,ni->n", force, axial_directions(data)[:, 0]))


def study() -> InternalForceStudy:
    """Run everything."""
    rates = [(rate, alpha) for rate in STEPS for alpha in (0.0, 0.05, 0.1, 0.2, 0.5, 1.0)]
    sign_gains = tuple(
        SignGainRun(alpha, rate, force_error({ALPHA: alpha, "clock.rate_hz": rate, "clock.steps_per_tick": STEPS[rate]}))
        for rate, alpha in tqdm(rates, desc="alpha")
    )
    force_gains = tuple(
        ForceGainRun(gain, force_error(LOW_PASS | {ALPHA: 0.0, "controller.gains.force_gain": gain}))
        for gain in tqdm((0.0, 0.5, 1.0, 3.0, 9.0, 15.0), desc="K_f")
    )
    return InternalForceStudy(sign_gains, force_gains, (biased(0.0), biased(0.2)))


def main() -> None:
    """Print the numbers and write the figure."""
    results = study()
    for run in results.sign_gains:
        print(f"alpha {run.sign_gain:<5} at {run.rate_hz:>6.0f} Hz: {run.force_rms_error:8.3f} N")
    for gain in results.force_gains:
        product = gain.force_rms_error * (1 + gain.force_gain)
        print(f"K_f {gain.force_gain:<5}: {gain.force_rms_error:8.4f} N, times (1 + K_f): {product:.4f} N")
    for bias in results.biased:
        print(f"0.1 mm bias, alpha {bias.sign_gain}: {bias.internal_force[-1]:.2f} N along the line between the tips at 20 s")
    save_figure(internal_force_study_figure(results), IMAGES / "internal-force")


if __name__ == "__main__":
    main()
