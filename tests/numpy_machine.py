"""Programs run by numpy, one operation at a time on all lanes: slow, the oracle of the compiled code."""

import numpy as np

from coop_pin.tracing.evaluation import evaluate
from coop_pin.tracing.kernel import LOAD, RECORD, Machine


class NumpyMachine(Machine):
    """Machine that evaluates a program by numpy."""

    def execute(self, block, uniforms, loads, record, between):
        program = self.program
        with np.errstate(all="ignore"):
            for code, row in program.instructions.tolist():
                between()
                if code == RECORD:
                    record[row] = block[: program.recorded]
                elif code == LOAD:
                    block[program.recorded : program.recorded + program.loaded] = loads[row]
                else:
                    kernel = program.kernels[code]
                    arguments = [
                        block[slot].copy() if space == "lane" else uniforms[row, slot]
                        for space, slot in kernel.reads
                    ]
                    slots, outputs = zip(*kernel.writes, strict=True) if kernel.writes else ((), ())
                    for slot, value in zip(slots, evaluate(kernel.tape, outputs, arguments), strict=True):
                        block[slot] = value
