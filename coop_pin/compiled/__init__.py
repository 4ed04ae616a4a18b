"""Compiled: plant, tick and laws of a run as compiled code: one run, runs as lanes of a program, laws as C99.

Open first: ``engine_choice`` (Pinocchio or compiled code, and in which way), ``kind`` (what runs of one code
share, and what cannot be compiled), ``simulate`` (batches of runs).

Laws are those of ``control``, sensors and drives those of ``simulation/devices``, run on traced numbers. The
plant alone is written anew, as scalar code with the numbers of the cell's Pinocchio tree, but for springs,
which are those of ``grasps``; tests hold the two together. Runs of one
``Kind`` share their code: a ``Cover`` (events, delays, lost torques) is what it provides, numbers that all of
them have *fold* into it, others are *inputs* in the *slots* of a *block* of runs. In the order in which they
build on each other:

- what runs share: engines (names), kind;
- physics (plant): serial_arm (kinematics), arm_dynamics, cell_numbers (constants), closures, cell_dynamics
  (forces on the payload);
- numbers of runs: constants (what differs folds or is an input, and signals, which change in time);
- code: plant_code (a Runge-Kutta step), law_code (a law);
- checks of users' laws: support (shaken ticks, single runs);
- runs: prepared_plant and preparation (their numbers), block (slots of the runs), tick (kernels of sensors,
  law, drives, observation, events), schedule (traced code on disk, the order of the kernels), samples (what
  was recorded), batch_result, simulate (blocks of runs);
- other uses of the same code: lane (one run, interruptible), c_messages and c_export (what a law tells and
  hears, and the law, as C99), compiled_plant (the plant of a single run);
- engine_choice: which of them simulates a run.

``law_code`` and ``c_export`` are in ``laws``. The public names of C99 are in ``cp.export``.

Imports ``base``, ``chain``, ``control``, ``description``, ``grasps``, ``model``, ``reference``, ``results``,
``simulation`` and ``tracing``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "BatchResult": "compiled.batch_result",
        "BatchSimulator": "compiled.simulate",
        "Lane": "compiled.lane",
        "law_reason": "compiled.kind",
        "plant_of": "compiled.engine_choice",
        "plant_reason": "compiled.kind",
        "simulate_batch": "compiled.simulate",
        "support": "compiled.laws.support",
    },
)
