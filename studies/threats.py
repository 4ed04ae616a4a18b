"""Threats to the validity of the benchmark, as runs: what changes with choices that nobody tuned.

Prints the stability of the baselines' damping, the effect of half of it, of the spring of spare joints, and
of a longer run. The numbers stand on docs/concepts/benchmark.md.

Usage: python studies/threats.py
"""

from __future__ import annotations

import math
from typing import Any

import coop_pin as cp
from coop_pin.comparison import controllers_for
from coop_pin.comparison.measures import measures
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.errors import DivergedError

DAMPED = ("printed", "sliding-pid", "adaptive", "adaptive-verginis")
OURS = ("payload-pi", "zeroed-leaky", "anchored")


def description(scenario: cp.Scenario, name: str) -> dict[str, Any]:
    """Return a controller with its stored gains."""
    return controllers_for(scenario, [name])[name]


def damped(law: dict[str, Any], factor: float) -> dict[str, Any]:
    """Return a controller with another joint damping."""
    K_d = [factor * value for value in law["gains"]["damping_gain"]]
    return law | {"gains": law["gains"] | {"damping_gain": K_d}}


def without_spring(law: dict[str, Any]) -> dict[str, Any]:
    """Return a baseline whose spare joints are damped and not pulled back to where they started."""
    spring = {"spare_gain": 0.0} if law["kind"] == "adaptive" else {"spare_gains": (0.0, 10.0)}
    return law | {"gains": law["gains"] | spring}


def errors(scenario: cp.Scenario, law: dict[str, Any]) -> str:
    """Return position and internal-force error, or when the run diverged."""
    try:
        found = measures(cp.run(scenario, {"controller": law}))
    except DivergedError as error:
        return f"diverged at {error.time:.1f} s"
    force = math.hypot(found["axial_rms_N"], found["shear_rms_N"])
    return f"{found['tracking_rms_mm']:.3g} mm, {force:.3g} N"


def main() -> None:
    """Print all of it."""
    for cell in ("two-pandas-box", "kinova-pair"):
        scenario = benchmark_scenario(cp.Scenario.load(cell), 5.0)
        for name in (*DAMPED, *OURS):
            value = cp.sampled_stability(scenario.override({"controller": description(scenario, name)})).value
            print(f"{cell}, {name}: T lambda {value:.2f} of 2 at the start")
    scenario = benchmark_scenario(cp.Scenario.load("two-pandas-box"), 5.0)
    for name in DAMPED:
        law = description(scenario, name)
        for factor in (1.0, 0.5):
            print(f"two-pandas-box, {name}, {factor:g} K_d: {errors(scenario, damped(law, factor))}")
    scenario = benchmark_scenario(cp.Scenario.load("five-joint-pair"), 5.0)
    for name in ("adaptive", "object-impedance", "computed-torque"):
        law = description(scenario, name)
        print(f"five-joint-pair, {name}: {errors(scenario, law)}")
        print(f"five-joint-pair, {name}, no spring: {errors(scenario, without_spring(law))}")
    scenario = benchmark_scenario(cp.Scenario.load("adept-anchored"), 20.0)
    law = description(scenario, "prescribed-performance")
    print(f"adept-anchored, prescribed-performance, 20 s: {errors(scenario, law)}")


if __name__ == "__main__":
    main()
