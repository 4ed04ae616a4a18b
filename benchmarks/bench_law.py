"""Cost of a tick of one arm as C99: operations, instructions and time of laws with their kinematics.

    python benchmarks/bench_law.py        # needs gcc; instructions by valgrind, if it is there

Law (23), the payload-space law and the anchored PI against computed torque, for arms of 3, 6 and 7 joints.
The model of computed torque is a recursive Newton-Euler algorithm, traced like the laws; its torques are
compared with those of coop_pin.model_based, which computes with Pinocchio.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import timeit
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import coop_pin as cp
from coop_pin import ArmCommand, ArmController, Simulation
from coop_pin.compiled.laws.law_code import RecordedLaw
from coop_pin.compiled.plant.arm_dynamics import newton_euler
from coop_pin.compiled.plant.serial_arm import (
    RigidInertia,
    SerialArm,
    force_cross,
    frames,
    join,
    motion_cross,
)
from coop_pin.control.terms import right_inverse
from coop_pin.laws import build_controller
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.transmission import friction
from coop_pin.tracing.traced_array import traced

CELLS = {3: "adept-anchored", 6: "three-ur5-plate", 7: "two-pandas-box"}
CALLS = 300_000
COMPUTED_TORQUE = {"kind": "computed-torque", "force_path": {"kind": "late"}}


class TracedComputedTorque(ArmController):
    """Computed torque as in coop_pin.model_based, with the arm's dynamics as scalar code.

    tau = RNEA(q, qdot, a_q) - J^T F with a_q = J^+ (a - Jdot qdot) + N b: the product of the mass matrix with
    an acceleration is never formed. Jdot qdot is the payload's acceleration at rest of the joints' rates.
    """

    def __init__(self, scenario: cp.Scenario, arm: str) -> None:
        laws: Any = build_controller(scenario.override({"controller": COMPUTED_TORQUE}))
        law = laws.controllers[arm]
        self._position_gain, self._velocity_gain = law._gains.position_gain, law._gains.velocity_gain
        self._force, self._spare_gains = law._force, law._gains.spare_gains
        self._rows, self._load_share = law._rows, law._load_share
        model = law._dynamics.model
        X_JP = model.frames[model.getFrameId("payload")].placement
        self._arm = SerialArm.from_model(
            model, range(1, model.njoints), X_JP, model.inertias[model.njoints - 1]
        )
        self._to_joints, self._friction = law._dynamics.from_drive, friction(scenario.cell.arms[arm], arm)
        self._gravity, self._arm_gravity = np.array(scenario.cell.gravity), np.array(model.gravity.linear)
        payload = scenario.cell.payload
        self._payload = RigidInertia(payload.mass, np.zeros(3), np.array(payload.inertia_matrix))

    def init(self, measurement: Any, reference: Any) -> Any:
        return self._force.start(), measurement.q

    def step(self, measurement: Any, reference: Any, state: Any) -> ArmCommand:
        force, start = state
        J, rows = measurement.payload_jacobian, self._rows
        q, v = self._to_joints.dot(measurement.q), self._to_joints.dot(measurement.v)
        xtilde = rows.pose_error(measurement.payload_pose, reference.pose)
        xtildedot = measurement.payload_twist - reference.twist
        a = reference.acceleration - self._velocity_gain * xtildedot - self._position_gain * xtilde
        F_0 = rows.select(self._payload_force(measurement, self._expanded(a)))
        f_r, force = self._force.step(measurement, reference, force)
        bias = rows.select(self._bias(q, v))
        a_q = right_inverse(J, measurement.time).dot(a - bias)
        if J.shape[0] < J.shape[1]:
            b = -self._spare_gains[0] * (measurement.q - start) - self._spare_gains[1] * measurement.v
            a_q = a_q + b - right_inverse(J, measurement.time).dot(J.dot(b))
        tau, _, _ = newton_euler(self._arm, self._arm_gravity, q, v, self._to_joints.dot(a_q))
        torque = self._to_joints.T.dot(traced(tau - self._friction.force(v))) - J.T.dot(
            f_r - self._load_share * F_0
        )
        return ArmCommand(traced(torque), (force, start))

    def _expanded(self, values: Any) -> Any:
        """Return a six-vector with task rows in place and zeros elsewhere."""
        full = np.zeros(6).astype(object)
        full[list(self._rows.indices)] = values
        return traced(full)

    def _payload_force(self, measurement: Any, a: Any) -> Any:
        """Return M_0 a + Q_0 V + W_0 about P in world axes, shape (6,)."""
        R, V = measurement.payload_pose[:3, :3], self._expanded(measurement.payload_twist)
        inertia = self._payload.moved(R, np.zeros(3))
        bias = np.concatenate((np.zeros(3), force_cross(V, inertia.times(V))[3:]))
        return traced(inertia.times(join(a[:3] - self._gravity, a[3:])) + bias)

    def _bias(self, q: Any, v: Any) -> Any:
        """Return Jdot qdot of the payload about P in world axes, shape (6,)."""
        seen = frames(self._arm, q)
        V, A = np.zeros(6).astype(object), np.zeros(6).astype(object)
        for k in range(len(self._arm.bodies)):
            Sv = seen.S[:, k] * v[k]
            V = V + Sv
            A = A + motion_cross(V, Sv)
        w, p = V[3:], seen.p_WP
        linear = V[:3] + np.cross(w, p)
        return traced(np.concatenate((A[:3] + np.cross(A[3:], p) + np.cross(w, linear), A[3:])))


def laws(cell: str) -> dict[str, cp.Scenario]:
    """Return a scenario of the cell for each law."""
    base = cp.Scenario.load(cell).replace(events=(), beyond_bound=True)
    gains = {"pose_gain": 2.0, "sign_gain": 0.2, "damping_gain": 20.0, "transient_rate": 5.0}
    joints = ArmModel(next(iter(base.cell.arms.values()))).nv
    printed = "sliding-mode" if joints == base.cell.task_rows.size else "sliding-mode-redundant"
    late = {"kind": "late"}
    space = base.controller.model_dump() | {"kind": "payload-space"}
    return {
        "law (23)": base.replace(controller={"kind": printed, "gains": gains, "force_path": late}),
        "payload-space": base.replace(controller=space | {"force_path": {"kind": "none"}}),
        "anchored PI": base.replace(controller=space | {"force_path": late}),
        "computed torque": base.replace(
            controller={"kind": "user", "target": "bench_law:TracedComputedTorque", "force_path": late}
        ),
    }


DRIVER = """
#include "{name}.h"
#include <stdio.h>
#include <time.h>
static {name}_measurement measured;
static {name}_reference desired;
int main(void)
{{
    static {name}_state state;
    double torque[16], sum = 0.0, *q = (double *)&measured;
    for (unsigned i = 0; i < sizeof measured / sizeof *q; ++i) q[i] = 0.1 + 0.07 * i;
    for (unsigned i = 0; i < 16; i += 5) ((double *)&desired)[i] = 1.0;
    {name}_start(&measured, &desired, &state);
    clock_t start = clock();
    for (long tick = 0; tick < {calls}; ++tick) {{
        measured.q[0] += 1e-7;
        {name}_step(&measured, &desired, &state, torque);
        sum += torque[0];
    }}
    printf("%g %g\\n", (double)(clock() - start) / CLOCKS_PER_SEC / {calls}, sum);
    return 0;
}}
"""


def compiled_costs(law: cp.export.CLaw, folder: Path) -> tuple[float, float]:
    """Return instructions of a step, NaN without valgrind, and its time, s: the least of five."""
    name, flags = law.source.stem, ("-std=c99", "-O2", "-g", "-fno-inline")
    (folder / "driver.c").write_text(DRIVER.format(name=name, calls=CALLS))
    for program, main in (("test", law.self_test), ("driver", folder / "driver.c")):
        command = [
            "gcc",
            *flags,
            f"-I{folder}",
            str(law.source),
            str(main),
            "-o",
            str(folder / program),
            "-lm",
        ]
        subprocess.run(command, check=True)
    times = [
        float(
            subprocess.run([folder / "driver"], capture_output=True, text=True, check=True).stdout.split()[0]
        )
        for _ in range(5)
    ]
    if shutil.which("valgrind") is None:
        return float("nan"), min(times)
    tool = ["valgrind", "--tool=callgrind", f"--toggle-collect={name}_step", "--callgrind-out-file=/dev/null"]
    said = subprocess.run([*tool, str(folder / "test")], capture_output=True, text=True, check=True)
    collected = int(re.findall(r"Collected : (\d+)", said.stderr)[0])
    ticks = int(said.stdout.split()[0])
    return collected / ticks, min(times)


def model_error(scenario: cp.Scenario) -> float:
    """Return how far torques of computed torque are off those by Pinocchio, relative, over 20 ticks."""
    arm, recorded = next(iter(scenario.cell.arms)), RecordedLaw(build_controller(scenario))
    own, run = scenario.override({"controller": COMPUTED_TORQUE}), Simulation(scenario, recorded)
    for _ in range(20):
        run.tick()
    law, ticks = build_controller(own).controllers[arm], [first for first, *_ in recorded.ticks]
    state = law.init(ticks[0].measurement, ticks[0].reference)
    worst, scale = 0.0, 0.0
    for tick in ticks:
        torque, state = law.step(tick.measurement, tick.reference, state)
        worst, scale = max(worst, np.abs(torque - tick.torque).max()), max(scale, np.abs(torque).max())
    return worst / scale


def rnea_seconds(cell: str) -> float:
    """Return the least time of Pinocchio's inverse dynamics of the first arm, called from Python, s."""
    arm, calls = ArmModel(next(iter(cp.Scenario.load(cell).cell.arms.values()))), 20_000
    model, data, q, v = arm.model, arm.model.createData(), pin.neutral(arm.model), np.ones(arm.nv)
    return min(timeit.repeat(lambda: pin.rnea(model, data, q, v, v), number=calls)) / calls


def main() -> None:
    """Print the table."""
    print("floating-point operations, instructions and ns of a tick of the first arm, compiled with -O2")
    for joints, cell in CELLS.items():
        print(f"\n{joints} joints, {cell}")
        for name, scenario in laws(cell).items():
            with tempfile.TemporaryDirectory() as place:
                law = cp.export.export_c(scenario, next(iter(scenario.cell.arms)), place)
                instructions, seconds = compiled_costs(law, Path(place))
            flops = sum(law.flops.values())
            print(f"  {name:18}{flops:8}{instructions:10.0f}{1e9 * seconds:10.0f}", flush=True)
        error = model_error(laws(cell)["computed torque"])
        print(f"  torques of computed torque by this code and by Pinocchio differ by {error:.0e}")
        print(f"  pinocchio.rnea alone, called from Python, ns: {1e9 * rnea_seconds(cell):.0f}")


if __name__ == "__main__":
    main()
