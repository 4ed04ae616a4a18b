"""Whole runs of the paper's experiment against lean MuJoCo scripts, and batches against tuned rollouts.

    python benchmarks/bench_lean.py [--rounds 9] [--batches]

Lean scripts have nothing of coop_pin in their loop: planar kinematics and law (23) written out for these
arms, ``mj_step``, and the states kept at every tick. "numpy" is the law as equations of arrays, "floats" the
same with plain floats and a 2 x 2 system solved by hand, "no law" has no torques: the floor. The model is
that of mujoco_cell.py, parsed in every run. coop_pin is ``cp.run(..., engine="auto")``, warm, labelled
result included. With --batches: ``mujoco.rollout`` under the torques of the run, kept for 2 s, with RK4 and
implicitfast. Ratios of processor time, interleaved; errors are the largest of the payload's position against
coop_pin at 64 steps.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import mujoco.rollout
import numpy as np
from bench_batch import loop, measured, scenarios
from bench_mujoco import LADDER, OVERRIDES, SOLREF
from common import elsewhere, interleaved, ratio
from mujoco_cell import mjcf

import coop_pin as cp
from coop_pin import Simulation
from coop_pin.compiled import BatchSimulator
from coop_pin.laws import build_controller
from coop_pin.tracing.llvm_machine import native_width

L_1, L_2 = 0.425, 0.375
GAMMA, ALPHA, KAPPA, K_D = 2.0, 0.2, 5.0, np.array((60.0, 60.0, 10.0))
BASES, LEVERS, SQUEEZES = (0.0, 1.0), (0.12, -0.12), (-10.0, 10.0)
"""Of each arm: x of its base, distance from its wrist to P along the payload's x axis, f_d along it."""
T = np.array(((1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
RATE, TICKS, EVENT, PULSE_END = 80.0, 1600, 800, 816
Law = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


def desired() -> tuple[np.ndarray, np.ndarray]:
    """Return x, y and angle of the desired motion and their rates at all ticks, shape (n, 3) each."""
    t = np.arange(TICKS + 1)[:, None] / RATE
    first, second = np.array((-0.2, -0.11547005383792516)), np.array((0.5, 0.2886751345948129))
    a, b = np.exp(-t / 6.6) * first, np.exp(-t / 6.8) * second
    turn = np.full((TICKS + 1, 1), 1.0471975511965976)
    x = np.hstack((np.array((0.4, 0.030940107675850324)) + a + b, turn))
    return x, np.hstack((-a / 6.6 - b / 6.8, 0.0 * turn))


def numpy_law() -> Law:
    """Return law (23) of both arms, with arrays."""
    x_d, v_d = desired()
    start, sigma, turns = [None, None], [np.zeros(3), np.zeros(3)], [0.0, 0.0]

    def law(tick: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = np.empty(6)
        for arm in (0, 1):
            part = slice(3 * arm, 3 * arm + 3)
            drive, rates = T @ q[part], T @ v[part]
            phi = drive[1] + drive[2]
            c, s = np.cos((drive[0], drive[1], phi)), np.sin((drive[0], drive[1], phi))
            lever = LEVERS[arm]
            J = np.array(
                (
                    (-L_1 * s[0], -L_2 * s[1] - lever * s[2], -lever * s[2]),
                    (L_1 * c[0], L_2 * c[1] + lever * c[2], lever * c[2]),
                    (0.0, 1.0, 1.0),
                )
            )
            J_inv = np.linalg.inv(J)
            x = np.array(
                (
                    BASES[arm] + L_1 * c[0] + L_2 * c[1] + lever * c[2],
                    L_1 * s[0] + L_2 * s[1] + lever * s[2],
                    phi - turns[arm],
                )
            )
            if start[arm] is None:
                turns[arm] = 2.0 * np.pi * np.round((phi - x_d[0, 2]) / (2.0 * np.pi))
                x[2] -= turns[arm]
            error = GAMMA * (x - x_d[tick])
            surface = J_inv @ (J @ rates - v_d[tick] + error)
            if start[arm] is None:
                start[arm] = surface
            s_d = start[arm] * np.exp(-KAPPA * tick / RATE)
            s_r = rates - (J_inv @ (v_d[tick] - error) + s_d - ALPHA * sigma[arm])
            f = SQUEEZES[arm] * np.array((c[2], s[2], 0.0))
            tau[part] = -K_D * s_r - J.T @ f
            sigma[arm] = sigma[arm] + np.sign(surface - s_d) / RATE
        return tau

    return law


def float_law() -> Law:
    """Return law (23) of both arms, with plain floats: J x = r leaves two equations of two rates."""
    x_d, v_d = (values.tolist() for values in desired())
    start, sigma, turns = [None, None], [[0.0] * 3, [0.0] * 3], [0.0, 0.0]
    cos, sin, k = math.cos, math.sin, K_D.tolist()

    def law(tick: int, q: np.ndarray, v: np.ndarray) -> list[float]:
        q, v, tau = q.tolist(), v.tolist(), []
        (xd, yd, ad), (vx, vy, va), fade = x_d[tick], v_d[tick], math.exp(-KAPPA * tick / RATE)
        for arm in (0, 1):
            base, lever, squeeze, signs = BASES[arm], LEVERS[arm], SQUEEZES[arm], sigma[arm]
            q_1, q_2, q_3 = q[3 * arm : 3 * arm + 3]
            r_1, r_2, r_3 = v[3 * arm : 3 * arm + 3]
            d_2, r_2 = q_1 + q_2, r_1 + r_2
            phi = d_2 + q_3
            a, b, c, d = -L_1 * sin(q_1), -L_2 * sin(d_2), L_1 * cos(q_1), L_2 * cos(d_2)
            along, across = lever * cos(phi), lever * sin(phi)
            det = a * d - b * c
            if start[arm] is None:
                turns[arm] = 2.0 * math.pi * round((phi - ad) / (2.0 * math.pi))
            turn = va - GAMMA * (phi - turns[arm] - ad)
            x = vx - GAMMA * (base + c + d + along - xd) + across * turn
            y = vy - GAMMA * (-a - b + across - yd) - along * turn
            second = (a * y - c * x) / det
            surface = r_1 - (d * x - b * y) / det, r_2 - second, r_3 - turn + second
            if start[arm] is None:
                start[arm] = surface
            f_x, f_y = squeeze / lever * along, squeeze / lever * across
            pull = across * -f_x + along * f_y
            loads = a * f_x + c * f_y, b * f_x + d * f_y + pull, pull
            for j in range(3):
                s_q = surface[j] - start[arm][j] * fade
                tau.append(-k[j] * (s_q + ALPHA * signs[j]) - loads[j])
                signs[j] += ((s_q > 0.0) - (s_q < 0.0)) / RATE
        return tau

    return law


class Lean(NamedTuple):
    """Numbers of the experiment, taken once from the scenario.

    Attributes:
        scenario: scenario without Coulomb friction.
        start: joint angles at t = 0, rad, shape (6,).
        mass: mass of the payload after the event, kg.
        inertia: its principal inertias then, kg m^2.
        push: wrench of the pulse.
    """

    scenario: cp.Scenario
    start: np.ndarray
    mass: float
    inertia: np.ndarray
    push: tuple[float, ...]

    @classmethod
    def of(cls, scenario: cp.Scenario) -> Lean:
        run = Simulation(scenario, build_controller(scenario))
        after = scenario.surroundings_at(run.timeline.just_after(EVENT / RATE))
        return cls(scenario, run.plant.q.copy(), after.mass, np.diag(after.inertia), after.push)

    def xml(self, steps: int, solref: float, integrator: str = "RK4") -> str:
        """Return the model with some plant steps in a tick."""
        return mjcf(self.scenario, 1.0 / RATE / steps, solref).replace('"RK4"', f'"{integrator}"')

    def run(self, xml: str, steps: int, law: Law | None) -> tuple[np.ndarray, np.ndarray]:
        """Run; return states and torques at all ticks, shapes (n, 12) and (n, 6)."""
        model = mujoco.MjModel.from_xml_string(xml)
        data, bar = mujoco.MjData(model), model.body("payload").id
        data.qpos[:] = self.start
        states, torques = np.empty((TICKS + 1, 12)), np.empty((TICKS + 1, 6))
        q, v, ctrl, step = data.qpos, data.qvel, data.ctrl, mujoco.mj_step
        for tick in range(TICKS + 1):
            states[tick, :6], states[tick, 6:] = q, v
            if tick == EVENT:
                model.body_mass[bar], model.body_inertia[bar] = self.mass, self.inertia
                mujoco.mj_setConst(model, mujoco.MjData(model))
                data.xfrc_applied[bar] = self.push
            elif tick == PULSE_END:
                data.xfrc_applied[bar] = 0.0
            if law is not None:
                ctrl[:] = law(tick, q, v)
            torques[tick] = ctrl
            step(model, data, steps)
        return states, torques


def positions(states: np.ndarray) -> np.ndarray:
    """Return the payload's position by the first arm's joints, m, shape (n, 2)."""
    angles = np.cumsum(states[:, :3], axis=1)
    lengths = np.array((L_1, L_2, LEVERS[0]))
    return np.stack((np.cos(angles) @ lengths, np.sin(angles) @ lengths), axis=1)


def distance(found: np.ndarray, reference: np.ndarray) -> float:
    """Return the largest distance of two positions over time, m."""
    return float(np.linalg.norm(found - reference[: len(found)], axis=1).max())


def single_runs(lean: Lean, rounds: int) -> None:
    """Print cost of whole runs at equal steps and at 1e-6 m."""
    scenario = lean.scenario
    reference = cp.run(scenario, {"clock.steps_per_tick": 64}, warn=False).data
    target = reference.payload_position.values[:, :2]
    laws = {"numpy": numpy_law, "floats": float_law}

    def ours(steps: int) -> Callable[[], object]:
        same = scenario.override({"clock.steps_per_tick": steps})
        return lambda: cp.run(same, engine="auto", warn=False).data

    def script(steps: int, solref: float, law: Callable[[], Law] | None) -> Callable[[], object]:
        xml = lean.xml(steps, solref)
        return lambda: lean.run(xml, steps, None if law is None else law())

    def fewest(error: Callable[[int, float], float], settings: tuple[float, ...]) -> tuple[int, float]:
        return next(pair for pair in itertools.product(LADDER, settings) if error(*pair) <= 1e-6)

    def script_error(steps: int, solref: float) -> float:
        return distance(positions(lean.run(lean.xml(steps, solref), steps, numpy_law())[0]), target)

    def own_error(steps: int, _: float) -> float:
        found = cp.run(scenario, {"clock.steps_per_tick": steps}, engine="auto", warn=False).data
        return distance(found.payload_position.values[:, :2], target)

    best, own = fewest(script_error, SOLREF), fewest(own_error, (0.0,))[0]
    print(f"1e-6 m: MuJoCo {best[0]} steps, solref {best[1]} dt, {script_error(*best):.1e} m; coop_pin {own}")
    for name, law in laws.items():
        error = distance(positions(lean.run(lean.xml(5, 2.0), 5, law())[0]), target)
        print(f"{name}, 5 steps, solref 2 dt: {error:.1e} m; coop_pin {own_error(5, 0.0):.1e} m")
    tasks: dict[str, Callable[[], object]] = {"coop_pin, 5": ours(5), f"coop_pin, {own}": ours(own)}
    for name, law in {**laws, "no law": None}.items():
        tasks[f"{name}, 5"] = script(5, 2.0, law)
        tasks[f"{name}, {best[0]} at 1e-6"] = script(*best, law)
    seconds = interleaved(tasks, rounds, 3)
    for name, times in seconds.items():
        mine = seconds["coop_pin, 5"] if name.endswith("5") else seconds[f"coop_pin, {own}"]
        print(f"{name:24}{1e3 * np.median(times):8.1f} ms   coop_pin / it {ratio(mine, times)}", flush=True)


def batches(lean: Lean, rounds: int, count: int = 64) -> None:
    """Print cost and error of rollouts of 2 s under the torques of the run, and the cost of a batch."""
    ticks = int(2.0 * RATE)
    base = lean.scenario.replace(duration=2.0, events=())
    fine = cp.run(base, {"clock.steps_per_tick": 64}, warn=False).data
    target = fine.payload_position.values[:, :2]
    held = fine.torque.values.reshape(len(target), 6)[:ticks]

    def rollout(integrator: str, steps: int, solref: float, runs: int) -> Callable[[], np.ndarray]:
        model = mujoco.MjModel.from_xml_string(lean.xml(steps, solref, integrator))
        data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
        data.qpos[:] = lean.start
        state = np.zeros(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        states, control = np.tile(state, (runs, 1)), np.tile(held.repeat(steps, axis=0), (runs, 1, 1))
        return lambda: mujoco.rollout.rollout(model, data, states, control, nstep=ticks * steps)[0]

    def error(integrator: str, steps: int, solref: float) -> float:
        found = rollout(integrator, steps, solref, 1)()[0, steps - 1 :: steps, 1:13]
        return distance(positions(found), target[1:])

    simulator, runs = BatchSimulator(), scenarios(base, count)
    tasks: dict[str, Callable[[], object]] = {
        "compiled loop": loop(simulator, runs, native_width()),
        "batch with metrics": measured(simulator, runs),
    }
    chosen = [("RK4", 5), ("RK4", 1), ("implicitfast", 5), ("implicitfast", 1)]
    for integrator, steps in chosen:
        errors = {solref: error(integrator, steps, solref) for solref in (*SOLREF, 5.0, 10.0)}
        solref = min(errors, key=lambda each: errors[each])
        tasks[f"{integrator}, {steps}, {errors[solref]:.0e} m"] = rollout(integrator, steps, solref, count)
    for limit, integrator in itertools.product((1e-3, 1e-4, 1e-6), ("RK4", "implicitfast")):
        pairs = itertools.product(LADDER, SOLREF)
        found = next((pair for pair in pairs if error(integrator, *pair) <= limit), None)
        if found is None:
            print(f"{integrator}: not within {limit:g} m with {LADDER[-1]} steps in a tick")
        else:
            tasks[f"{integrator}, {found[0]}, within {limit:g} m"] = rollout(integrator, *found, count)
    seconds = interleaved(tasks, rounds, 1)
    for name, times in seconds.items():
        print(f"{name:36}{1e3 * np.median(times) / count:9.3f} ms a run   of the loop", end=" ")
        print(
            ratio(times, seconds["compiled loop"]),
            "  of a batch",
            ratio(times, seconds["batch with metrics"]),
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--batches", action="store_true")
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    lean = Lean.of(cp.Scenario.load("adept-paper", OVERRIDES))
    (batches if options.batches else single_runs)(lean, options.rounds)


if __name__ == "__main__":
    with elsewhere():
        main()
