"""Traced code: batches of runs, compiled once for many scenarios, and the law of one arm as C99.

Laws are those of coop_pin.control, sensors and drives those of coop_pin.simulation, run on traced numbers.
The plant alone is written anew, as scalar code with the numbers of the cell's Pinocchio tree, but for springs
and the free-flyer, which are those of coop_pin.grasps and coop_pin.chain; tests hold the two together.
llvmlite compiles batches. A *family* of runs shares one code: its ``Cover`` (events, delays, lost torques) is
what that code provides; numbers that all of them have *fold* into it, others are *inputs* in the *slots* of a
*block* of runs. In the order in which they build on each other:

- what runs share: engines, code_family;
- physics (plant): serial_arm (kinematics), arm_dynamics, cell_dynamics (closures, forces on the payload);
- numbers of runs: constants (what differs folds or is an input), signals (what changes in time);
- code: plant_code (a Runge-Kutta step), law_code (a law);
- checks of users' laws (laws): hidden_state (attributes), support (shaken ticks), single_runs (whole runs);
- runs: preparation (what runs must share), block (slots of the runs), tick (kernels of sensors, law, drives,
  observation, events), schedule (traced code on disk, the order of the kernels), samples (what was recorded),
  simulate (families, blocks of runs);
- other uses of the same code: lane (one run, interruptible), c_messages and c_export (what a law tells and
  hears, and the law, as C99), compiled_plant (the plant of a single run);
- engine_choice: which of them simulates a run.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "BatchResult": "coop_pin.compiled.simulate",
    "BatchSimulator": "coop_pin.compiled.simulate",
    "Lane": "coop_pin.compiled.lane",
    "law_reason": "coop_pin.compiled.code_family",
    "plant_reason": "coop_pin.compiled.code_family",
    "simulate_batch": "coop_pin.compiled.simulate",
    "support": "coop_pin.compiled.laws.support",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
