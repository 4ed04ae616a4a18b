"""Traced code: batches of runs, compiled once for many scenarios, and the law of one arm as C99.

Laws are those of coop_pin.control, sensors and drives those of coop_pin.simulation, run on traced numbers.
The plant alone is written anew, as scalar code with the numbers of the cell's Pinocchio tree; tests hold the
two together. llvmlite compiles batches. A *family* of runs shares one code: its ``Cover`` (events, delays,
lost torques) is what that code provides; numbers that all of them have *fold* into it, others are *inputs* in
the *slots* of a *block* of runs. In the order in which they build on each other:

- physics: serial_arm (kinematics), arm_dynamics, cell_dynamics (closures, forces on the payload);
- numbers of runs: constants (what differs folds or is an input), signals (what changes in time);
- code: plant_code (a Runge-Kutta step), law_code (a law);
- checks of users' laws: hidden_state (attributes), support (shaken ticks), single_runs (whole runs);
- runs: preparation (what runs must share), block (slots of the runs), tick (kernels of sensors, law, drives,
  observation, events), schedule (traced code on disk, the order of the kernels), samples (what was recorded),
  simulate (families, blocks of runs);
- other uses of the same code: lane (one run, interruptible), c_messages and c_export (what a law tells and
  hears, and the law, as C99), traced_plant (the plant of a single run).
"""

from coop_pin.batch.c_export import CLaw, export_c
from coop_pin.batch.lane import Lane
from coop_pin.batch.simulate import BatchResult, BatchSimulator, simulate_batch
from coop_pin.batch.support import support
from coop_pin.description.code_family import law_reason, plant_reason

__all__ = [
    "BatchResult",
    "BatchSimulator",
    "CLaw",
    "Lane",
    "export_c",
    "law_reason",
    "plant_reason",
    "simulate_batch",
    "support",
]
