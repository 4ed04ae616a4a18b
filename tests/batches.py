"""What tests of batches share: their samples against those of single runs."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from numpy_machine import NumpyMachine

from coop_pin.base.disk_cache import DiskCache
from coop_pin.compiled import BatchSimulator
from coop_pin.compiled.preparation import Prepared
from coop_pin.tracing.llvm_machine import LlvmMachine


def require_same_samples(found, wanted):
    """Require the variables of a single run, to 1e-9."""
    assert set(found.variables) == set(wanted.variables)
    for variable, array in wanted.variables.items():
        values = found[variable].values
        assert (values.shape, values.dtype) == (array.shape, array.dtype)
        if values.dtype.kind != "f":
            assert_array_equal(values, array.values, err_msg=variable)
            continue
        scale = max(1.0, np.abs(array.values[np.isfinite(array.values)]).max(initial=0.0))
        assert_allclose(values, array.values, rtol=0, atol=1e-9 * scale, err_msg=variable)


def require_same_bits(scenarios):
    """Require the bits of all vector widths, of the numpy oracle and of a smaller batch, and return them."""
    simulator = BatchSimulator(
        machine=NumpyMachine
    )  # whose program has the kernels: any width can have a text
    runs = [simulator.prepare(scenario) for scenario in scenarios]
    prepared = Prepared.joined(runs)
    family = simulator.family([prepared])
    _, machine, order = family.orders[prepared.kind.times]
    program, uniforms, (block, loads) = machine.program, order.uniforms, family.code.begin(prepared)
    machines = [LlvmMachine(program, width, DiskCache()) for width in (8, 4, 1)] + [NumpyMachine(program)]
    records = [machine.run(block.copy(), uniforms, loads) for machine in machines]
    for record in records:
        assert_array_equal(record, records[0])
    last = machines[0].run(block[:, [-1]], uniforms, loads[:, :, [-1]])
    assert_array_equal(last[..., 0], records[0][..., -1])
    alone = BatchSimulator(machine=NumpyMachine).run(scenarios[-1:]).samples  # numbers fold that were inputs
    together = BatchSimulator(machine=NumpyMachine).run(scenarios).samples
    for name, values in alone.items():
        assert_array_equal(values[0], together[name][-1], err_msg=name)
    return records[0]
