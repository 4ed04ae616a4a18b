"""Runs on Pinocchio in a process in which llvmlite cannot be imported."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.description.catalogue import scenario_names
from coop_pin.tracing.llvm_machine import can_compile

TICKS = 6


def samples(name: str) -> dict[str, np.ndarray]:
    """Floats of a short run whose payload's mass halves on the way."""
    scenario = cp.Scenario.load(name)
    period, mass = scenario.clock.period, 0.5 * scenario.cell.payload.mass
    drop = {"kind": "payload-change", "time": 2.5 * period, "mass": mass}
    short = scenario.override({"duration": TICKS * period, "events": [drop]})
    data = cp.run(short, engine="pinocchio", warn=False).data
    return {f"{name}/{key}": array.values for key, array in data.variables.items() if array.dtype.kind == "f"}


def run_all_without_llvmlite(path: str) -> None:
    """Write the samples of all scenarios of the catalogue."""
    records = list[logging.LogRecord]()
    logger, handler = logging.getLogger("coop_pin"), logging.Handler()
    handler.emit = records.append  # type: ignore[method-assign]
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    everything = {key: values for name in scenario_names() for key, values in samples(name).items()}
    assert not can_compile()
    about = [record.levelname for record in records if "llvmlite" in record.getMessage()]
    assert about == ["INFO"]
    np.savez(path, **everything)


@pytest.mark.gate
def test_every_scenario_of_the_catalogue_runs_and_springs_by_numpy_are_those_that_are_compiled(tmp_path):
    code = "import sys; sys.modules['llvmlite'] = None; import test_without_llvmlite as t; t.{}({!r})"
    path = tmp_path / "samples.npz"
    command = [sys.executable, "-c", code.format(run_all_without_llvmlite.__name__, str(path))]
    done = subprocess.run(
        command, cwd=Path(__file__).parent, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    assert can_compile()
    with np.load(path) as by_numpy:
        assert {key.split("/")[0] for key in by_numpy} == {*scenario_names()}
        elastic = [name for name in scenario_names() if cp.Scenario.load(name).cell.has_force_elements]
        assert len(elastic) >= 4
        for name in elastic:
            compiled = samples(name)
            for key, values in compiled.items():  # internal wrenches are differences of interaction wrenches
                whole = compiled[f"{name}/interaction_wrench"] if "/internal" in key else values
                scale = max(1.0, float(np.abs(np.nan_to_num(whole)).max(initial=0.0)))
                assert_allclose(by_numpy[key], values, rtol=0.0, atol=1e-11 * scale, err_msg=key)
