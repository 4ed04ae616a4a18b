"""Compiled code of cells: the plant of a run, whole runs as lanes of one program, the law of an arm as C99.

Laws are those of coop_pin.control, sensors and drives those of coop_pin.simulation, run on traced numbers.
The plant alone is written anew, as scalar code with the numbers of the cell's Pinocchio tree; tests hold the
two together. Runs of one ``Kind`` share their code: a ``Cover`` (events, delays, lost torques) is what it
provides, numbers that all of them have *fold* into it, others are *inputs* in the *slots* of a *block*.

Open first: kind (what runs share, and what cannot be compiled), simulate (many runs), engine_choice (which
engine, in which way). Before the code stand prepared_plant, preparation, constants and signals (numbers of
runs); the code is plant (physics), laws, tick, block and schedule (code on disk, order of the kernels);
after it come samples, batch_result and lane (one run, interruptible). It imports coop_pin.simulation and what
that imports, and the compiler, coop_pin.tracing.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "BatchResult": "coop_pin.compiled.batch_result",
    "BatchSimulator": "coop_pin.compiled.simulate",
    "CLaw": "coop_pin.compiled.laws.c_export",
    "Lane": "coop_pin.compiled.lane",
    "export_c": "coop_pin.compiled.laws.c_export",
    "law_reason": "coop_pin.compiled.kind",
    "plant_of": "coop_pin.compiled.engine_choice",
    "plant_reason": "coop_pin.compiled.kind",
    "simulate_batch": "coop_pin.compiled.simulate",
    "support": "coop_pin.compiled.laws.support",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
