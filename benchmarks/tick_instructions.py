"""Instructions of a tick, counted by callgrind: a figure without noise for comparisons with other checkouts.

    PYTHONPATH=CHECKOUT python benchmarks/tick_instructions.py [SCENARIO] [CHANGE=VALUE ...]

Ticks are counted after some that are not, with the working out of their samples. Needs valgrind.
"""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys

WARM, COUNTED = 40, 32
_CHILD = "COUNTED_BY_CALLGRIND"


def _callgrind(switch: str) -> None:
    """Switch the counting of this process on or off."""
    environment = {
        name: value for name, value in os.environ.items() if name not in {"LD_PRELOAD", "PYTHONPATH"}
    }
    command = ["callgrind_control", "-i", switch, str(os.getpid())]
    subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)


def run_ticks(name: str, changes: list[str]) -> None:
    """Do the ticks, the last of them counted."""
    import coop_pin as cp
    from coop_pin.laws import build_controller

    overrides = dict(change.split("=", 1) for change in changes)
    scenario = cp.Scenario.load(name).override({"events": [], "duration": 4.0} | overrides)
    simulation = cp.Simulation(scenario, build_controller(scenario))
    for _ in range(WARM):
        simulation.tick()
    simulation.recorder.observe()
    gc.collect()
    gc.disable()
    _callgrind("on")
    for _ in range(COUNTED):
        simulation.tick()
    simulation.recorder.observe()
    _callgrind("off")


def main(arguments: list[str]) -> None:
    """Count and print."""
    name, *changes = arguments or ["adept-paper"]
    if _CHILD in os.environ:
        run_ticks(name, changes)
        return
    tool = ["valgrind", "--tool=callgrind", "--instr-atstart=no", "--callgrind-out-file=/dev/null"]
    environment = os.environ | {_CHILD: "1", "PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1"}
    command = [*tool, sys.executable, __file__, name, *changes]
    output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stderr
    count = int(re.findall(r"Collected : (\d+)", output)[0])
    print(f"{name}: {count / COUNTED:.4g} instructions a tick")


if __name__ == "__main__":
    main(sys.argv[1:])
