"""Random calls of the public interface: good arguments of which some are replaced by hostile ones.

    python tests/hostile_calls.py SEED FIRST COUNT

makes calls FIRST, FIRST + 1, ... of a seed, and writes two lines of JSON for each: what is called, then how
it ended. How a call ends:

- "result": it returns, and what it returns of kinematics and dynamics is finite;
- "refused": it raises a CoopPinError;
- "not callable so": Python itself refuses the call, because the arguments do not fit the signature: a
  TypeError whose traceback has no frame below this file but those of ``arrays.typed``;
- "bare": it raises anything else: an exception from below the public function;
- "nan", "slow": it returns numbers that are not finite, or takes longer than ``LIMIT_S``.

The first three are sound.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import itertools
import json
import math
import os
import random
import resource
import signal
import sys
import tempfile
import traceback
import types
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from cells import SCENARIOS
from linkages import bennett
from numpy_machine import NumpyMachine

import coop_pin as cp
from coop_pin import cli
from coop_pin.running.check import quick_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.run_state import RunState
from coop_pin.simulation.tick import TickInputs

SOUND = {"result", "refused", "not callable so"}
LIMIT_S, LIMIT_BYTES = 30.0, 6 << 30

QUIET = cp.Execution(workers=0, quiet=True)
SHORT = {"duration": 0.05, "events": ()}
FINITE = ("ArmModel", "CellChain", "ClosedChain", "Simulation", "solve_ik", "ik_branches", "simulate", "run")
"""What they return must be finite."""
DYNAMIC = ("configuration", "velocity", "payload_position", "pose_error", "kinetic_energy")


class Slow(BaseException):
    """A call that took too long; no ``except Exception`` catches it."""


def hostile_values() -> list[object]:
    """Values of wrong classes, shapes and sizes."""
    nan, inf = math.nan, math.inf
    return [
        *(
            None,
            True,
            False,
            0,
            -1,
            1,
            10**9,
            10**40,
            -(10**400),
            nan,
            inf,
            -inf,
            1e300,
            -1e300,
            5e-324,
            1e-15,
        ),
        *(
            "",
            "\0",
            "left",
            "a\0b",
            "../../x",
            "x" * 5000,
            "1e300",
            "\ud800",
            b"bytes",
            b"\0",
            Path("/nowhere/x"),
        ),
        *(
            [],
            (),
            {},
            set(),
            [nan],
            [1e300] * 3,
            [1e300] * 6,
            [0.0] * 7,
            [[1.0], [2.0, 3.0]],
            [None],
            ["x"] * 3,
        ),
        *({"left": None}, {"left": [0.0]}, {"": 0}, {0: 1}, {"arm/joint1": nan}, {"duration": nan}, range(3)),
        *(
            object(),
            object,
            len,
            lambda *_: None,
            lambda *_: nan,
            iter([1.0]),
            1 + 2j,
            types.SimpleNamespace(),
        ),
        *(np.array([]), np.zeros(3), np.zeros((4, 4)), np.eye(4), np.eye(4) * 1e300, np.full((4, 4), nan)),
        *(
            np.full(6, 1e300),
            np.full(12, 1e300),
            np.zeros((2, 3)),
            np.array(["a"]),
            np.array(None),
            np.float64(2),
        ),
        *(
            np.zeros(3, dtype=bool),
            np.array([1 + 1j]),
            np.zeros((0, 4)),
            np.ones((1, 1, 1)),
            np.array(10**30),
        ),
    ]


NAMESPACES = [value for name in dir(cp) if inspect.ismodule(value := getattr(cp, name)) and name != "errors"]
PUBLIC = {name: getattr(module, name) for module in (cp, *NAMESPACES) for name in module.__all__}
"""Public classes, functions and constants by name."""


class Calls:
    """Every function, class and method that is called, with arguments that it accepts.

    Attributes:
        recipes: by name, a function that returns what to call and its good arguments.
    """

    def __init__(self, folder: Path, scenario: cp.Scenario) -> None:
        folder.mkdir()
        self.folder, self.scenario = folder, scenario.override(SHORT)
        self.recipes = {}
        for name, target in PUBLIC.items():
            if inspect.isabstract(target):
                continue
            if hasattr(target, "model_fields"):
                self._add(name, functools.partial(self._description, target))
            elif hasattr(target, "_fields"):
                self._add(name, lambda target=target: (target, dict.fromkeys(target._fields, 0.0)))
        for name, arguments in self._arguments().items():
            self._add(name, functools.partial(self._call, name, arguments))
        for target, arguments in self._functions():
            name = ".".join((*target.__module__.split(".")[1:2], target.__name__))
            self._add(name, lambda target=target, arguments=arguments: (target, arguments()))

    def _add(self, name, recipe) -> None:
        self.recipes[name] = recipe

    def _call(self, name, arguments):
        owner, *method = name.split(".")
        target = PUBLIC[owner]
        if method:
            target = getattr(
                target if inspect.ismethod(getattr(target, method[0])) else self.own(owner), *method
            )
        return target, dict(arguments())

    def _description(self, kind):
        known = {type(value): value for value in self.descriptions}
        value = known.get(kind)
        return kind, {} if value is None else {
            name: getattr(value, name) for name in type(value).model_fields
        }

    def own(self, owner):
        """An object whose methods are called; one that calls change is made anew."""
        if owner == "Simulation":
            simulation = cp.Simulation(self.scenario, cp.laws.build_controller(self.scenario))
            simulation.tick()
            return simulation
        if owner in ("CellEnv", "VectorCellEnv"):
            environment = PUBLIC[owner](self.scenario)
            environment.reset()
            return environment
        if owner == "CellChain":
            return cp.grasps.CellChain(self.scenario.cell)
        if owner == "Scenario":
            return self.scenario
        if owner == "BatchSimulator":
            return cp.compiled.BatchSimulator(machine=NumpyMachine)
        return getattr(self, owner)

    @functools.cached_property
    def descriptions(self):
        cell, pose = self.scenario.cell, cp.Pose(xyz=(0.5, 0.0, 0.0))
        redundant = cp.Scenario.load("two-pandas-box")
        points = (cp.motions.Waypoint(time=0.0), cp.motions.Waypoint(time=1.0, xyz=(0.1, 0.0, 0.0)))
        return [
            *(
                self.scenario,
                cell,
                cell.payload,
                self.scenario.clock,
                self.scenario.plant,
                self.scenario.controller,
            ),
            *(
                self.scenario.controller.gains,
                pose,
                cell.arms["left"],
                redundant.controller,
                self.scenario.motion,
            ),
            *(
                redundant.controller.gains,
                cp.motions.HoldMotion(pose=pose),
                cp.motions.WaypointsMotion(points=points),
                points[0],
            ),
            *(
                cp.motions.CircleMotion(pose=pose, radius=0.1, angular_rate=1.0),
                cp.sweeps.Span(low=0.0, high=1.0),
                cp.actuators.JointFriction(),
            ),
            *(
                cp.motions.LineMotion(start=pose, goal=pose, duration=1.0),
                cp.events.PayloadChange(time=0.01, mass=1.0),
                cp.laws.Tanh(),
            ),
            cp.motions.SwingMotion(pose=pose, axis=(0.0, 0.0, 1.0), amplitude=0.1, period=1.0),
            cp.motions.TurnMotion(pose=pose, axis=(0.0, 0.0, 1.0), angle=0.1, duration=1.0),
            *(
                cp.events.WrenchPulse(time=0.0, duration=0.01, wrench=(1.0,) * 6),
                cp.plant.Stabilisation(),
                cp.laws.Saturation(),
            ),
            *(
                cp.sweeps.Sample(fields={"duration": cp.sweeps.Span(low=0.01, high=0.1)}, count=2),
                self.plan,
                cp.squeezes.ConstantSqueeze(),
            ),
        ]

    @functools.cached_property
    def plan(self):
        return cp.SweepPlan(base=self.scenario, axes={"duration": [0.02, 0.03]})

    @functools.cached_property
    def ArmModel(self):
        return cp.model.CellArm(self.scenario.cell, "left")

    @functools.cached_property
    def ClosedChain(self):
        return bennett("full")[0]

    @functools.cached_property
    def RunResult(self):
        return cp.run(self.scenario)

    @functools.cached_property
    def SweepResult(self):
        return cp.sweep(self.plan, out=self.folder / "sweep", execution=cp.Execution(workers=0, quiet=True))

    @functools.cached_property
    def simulation(self):
        return cp.Simulation(self.scenario, cp.laws.build_controller(self.scenario))

    @functools.cached_property
    def reach(self):
        return cp.feasibility.reachability(self.scenario, poses=3)

    @functools.cached_property
    def Comparison(self):
        return cp.compare(**self.compared(), out=self.folder / "compared")

    @functools.cached_property
    def figure(self):
        return cp.figures.torque_figure(self.RunResult)

    def compared(self):
        return {
            "scenarios": [self.scenario],
            "controllers": ["leader-follower"],
            "trials": ["nominal"],
            "seeds": 1,
            "duration": 0.05,
            "tuned": False,
            "execution": QUIET,
        }

    def _functions(self):
        """Functions of packages and what returns their good arguments, which may take long to make."""
        result, simulation = (lambda: {"result": self.RunResult}), (lambda: {"simulation": self.simulation})
        alone, along = (
            (lambda: {"scenario": self.scenario}),
            (lambda: {"scenario": self.scenario, "cell_reach": self.reach}),
        )
        for name in cp.figures.__all__:
            if name not in (
                "comparison_figure",
                "pareto_figure",
                "save_figure",
                "sweep_figure",
                "theorem_figure",
            ):
                yield getattr(cp.figures, name), result
        for name in ("loop_stability", "start_stability", "start_torques", "step_stability"):
            yield PUBLIC[name], simulation
        for function in (cp.design.gain_proposal, cp.feasibility.statics_along, cp.feasibility.task_inertia):
            yield function, along
        for function in (cp.feasibility.closure_problem, cp.compiled.support, cp.comparison.standard_trials):
            yield function, alone
        metrics = {"metric_a": "moving_position_rms_m", "metric_b": "torque_peak_Nm"}
        yield cp.figures.pareto_figure, lambda: {"result": self.SweepResult, **metrics}
        yield (
            cp.figures.sweep_figure,
            lambda: {"result": self.SweepResult, "metric": "moving_position_rms_m", "over": None},
        )
        yield (
            cp.figures.comparison_figure,
            lambda: {"comparison": self.Comparison, "scenario": self.scenario.name},
        )
        yield (
            cp.figures.save_figure,
            lambda: {
                "figure": self.figure,
                "stem": self.folder / "figure",
                "formats": ["svg"],
                "paper": False,
            },
        )
        yield (
            cp.figures.theorem_figure,
            lambda: {"result": self.RunResult, "monitor": cp.proof.theorem_monitor(self.RunResult)},
        )
        yield cp.proof.theorem_monitor, result
        yield cp.stability.steady_errors, lambda: {**alone(), "bias": 1e-3, "load": 10.0}
        yield cp.feasibility.static_torques, lambda: {**alone(), "poses": 3}
        yield cp.feasibility.maximum_reach, lambda: {"arm": self.scenario.cell.arms["left"]}
        yield cp.stability.motion_stability, lambda: {**simulation(), "cell_reach": self.reach}
        yield cp.compare, lambda: {**self.compared(), "out": self.folder / "compared"}
        yield cp.comparison.benchmark_scenario, lambda: {**alone(), "duration": 0.05}
        yield (
            cp.comparison.controllers_for,
            lambda: {**alone(), "controllers": ["leader-follower"], "tuned": True},
        )
        yield cp.comparison.tick_costs, lambda: {**alone(), "controllers": ["leader-follower"], "rounds": 1}
        yield (
            cp.comparison.tune_controllers,
            lambda: {
                "scenarios": [self.scenario],
                "controllers": ["leader-follower"],
                "generations": 1,
                "size": 1,
                "duration": 0.05,
                "out": self.folder / "tuned",
                "execution": QUIET,
            },
        )
        yield cp.compiled.plant_reason, lambda: {"plant": self.scenario.plant, "cell": self.scenario.cell}
        yield cp.compiled.simulate_batch, lambda: {"scenarios": [self.scenario], "machine": NumpyMachine}
        yield cp.export.export_c, lambda: {**alone(), "arm": "left", "folder": self.folder / "c", "ticks": 2}
        yield cp.proof.anchor_bounded_time, result
        yield implausible_numbers, alone
        yield quick_findings, simulation
        yield cp.check, lambda: {**alone(), "poses": 3}
        yield cp.feasibility.loads_without_an_arm, along
        posture = lambda: {**along(), "posture": cp.laws.PostureGains()}  # noqa: E731
        yield cp.feasibility.internal_moment, posture
        yield cp.feasibility.motion_wrenches, posture
        yield (
            cp.new_cell,
            lambda: {
                "arms": ["ur5", "ur5"],
                "payload": "box",
                "mass": 2.0,
                "size": (0.3, 0.2, 0.1),
                "grasp": "sides",
                "layout": "facing",
                "tips": (),
                "distance": None,
                "name": "cell",
            },
        )
        yield (
            command_new,
            lambda: {
                "path": self.folder / f"cell{next(numbers)}.toml",
                "arms": "ur5 ur5",
                "payload": "box",
                "mass": 2.0,
                "size": "0.3 0.2 0.1",
                "tips": "tool0 tool0",
                "distance": 0.7,
            },
        )
        yield cp.comparison.controller_names, dict
        yield (
            cp.laws.anchor_gain_bound,
            lambda: {"pole": 0.5, "delay": 1, "every": 1, "force_gain": 0.1, "lag": 0.0},
        )
        yield cp.laws.force_gain_bound, lambda: {"pole": 0.5, "delay": 1, "lag": 0.0}
        yield (
            cp.motions.check_consistency,
            lambda: {"reference": self.scenario.motion, "times": [0.01, 0.02], "allowed": 1e-3},
        )
        yield cp.sweeps.estimate, lambda: {"plan": self.plan}
        yield cp.Execution, lambda: {"workers": 0, "engine": "pinocchio", "quiet": True, "merge": ()}
        yield cp.model.CellArm, lambda: {"cell": self.scenario.cell, "name": "left"}
        yield cp.urdf.check_urdf, lambda: {"text": self.urdf}
        yield cp.urdf.text_checked, lambda: {"text": self.urdf, "loops": False}
        yield cp.urdf.find_urdf, lambda: {"name_or_path": "panda", "package_dirs": (), "xacro_args": {}}
        yield cp.urdf.check_file, lambda: {"urdf": cp.urdf.find_urdf("panda")}
        yield (
            cp.urdf.load_checked,
            lambda: {"urdf": cp.urdf.find_urdf("panda"), "strict": False, "loops": False},
        )
        yield cp.urdf.robot_files, dict
        yield cp.viz.save_report, lambda: {**result(), "path": self.folder / "report.html"}
        yield cp.viz.save_replay, lambda: {**result(), "path": self.folder / "replay.html", "names": ()}
        yield cp.viz.notebook_view, lambda: {**result(), "height": 300}
        yield cp.viz.metrics_table, result
        yield cp.viz.replay_html, lambda: {"result": self.RunResult, "times": ()}
        yield cp.viz.report_html, result
        yield cp.zoo.experiment_names, dict
        yield cp.zoo.load_experiment, lambda: {"name": cp.zoo.experiment_names()[0]}
        yield from self._newer_functions()
        yield cp.spatial.quaternions, lambda: {"R": np.eye(3)}
        yield cp.spatial.exp3, lambda: {"vector": np.zeros(3)}
        yield cp.spatial.log3, lambda: {"R": np.eye(3)}
        yield cp.spatial.rotation_from_rpy, lambda: {"rpy": np.zeros(3)}
        yield cp.spatial.weight_wrench, lambda: {"mass": 1.0, "gravity": (0.0, 0.0, -9.81)}
        yield cp.spatial.spatial_inertia, lambda: {"mass": 1.0, "inertia": np.eye(3), "R_WP": np.eye(3)}
        yield (
            cp.spatial.load_wrenches,
            lambda: {"interaction": np.zeros((2, 6)), "load_shares": np.full(2, 0.5)},
        )

    def _newer_functions(self):
        """Functions on carries, distances, the law's loop, wrenches of other definitions and states."""
        alone, along = (
            (lambda: {"scenario": self.scenario}),
            (lambda: {"scenario": self.scenario, "cell_reach": self.reach}),
        )
        rows = self.scenario.cell.task_rows.size
        stability, design, feasibility, laws = cp.stability, cp.design, cp.feasibility, cp.laws
        for function in (
            feasibility.distances,
            design.own_inertia,
            feasibility.force_reserve,
            stability.forecast,
        ):
            yield function, along
        for function in (
            *(feasibility.least_squeeze, feasibility.seen_by_arms, laws.build_controller),
            *(stability.admittance_stability, stability.eigenvalues, stability.regrasp_gaps),
        ):
            yield function, alone
        yield feasibility.table_force, lambda: {**alone(), "table_error": 0.002, "lag": 0.0}
        yield design.deflection_bias, lambda: {**alone(), "G": np.stack([np.eye(rows)] * 2)}
        yield design.own_inertia_proposal, lambda: {**along(), "least_stiffness": 0.0, "tips_give": False}
        yield stability.grasp_stability, lambda: {"simulation": self.simulation}
        yield stability.anchor_biases, lambda: {**alone(), "bias": 1e-3, "turn": 0.0}
        yield (
            stability.root_locus,
            lambda: {**alone(), "field": "controller.gains.sign_gain", "factors": (1.0, 2.0), "time": 0.0},
        )
        yield (
            cp.carry.plan_carry,
            lambda: {
                "cell": self.scenario.cell,
                "start": self.scenario.start,
                "goal": self.scenario.start,
                "squeeze": None,
                "duration": None,
                "reserve": 0.05,
                "smoothing": 0.05,
                "places": 21,
            },
        )
        yield cp.findings.recorded_distances, lambda: {"result": self.RunResult}
        yield cp.compiled.law_reason, lambda: {"law": self.scenario.controller}
        yield cp.compiled.plant_of, lambda: {"engine": "pinocchio"}
        yield laws.consensus_bound, lambda: {"largest": 2.0, "delay": 1}
        wrenches = np.arange(12.0).reshape(2, 6)
        tips = np.array([[0.5, 0.0, 0.0], [-0.5, 0.1, 0.0]])
        yield cp.spatial.norms6, lambda: {"vectors": wrenches}
        yield cp.spatial.rotations, lambda: {"quaternion": np.array([0.0, 0.0, 0.0, 1.0])}
        yield cp.spatial.symmetric_internal_wrenches, lambda: {"interaction": wrenches}
        yield cp.spatial.linkage_loads, lambda: {"tips": tips}
        for name in (
            *("determinate_grasp", "minimum_norm_internal_wrenches", "nonsqueezing_internal_wrenches"),
            *("virtual_linkage", "virtual_linkage_internal_wrenches"),
        ):
            yield getattr(cp.spatial, name), lambda: {"interaction": wrenches, "tips": tips}
        yield (
            cp.spatial.constraint_consistent_internal_wrenches,
            lambda: {
                "interaction": wrenches,
                "tips": tips,
                "masses": np.ones(2),
                "inertias": np.ones(2),
            },
        )
        yield cp.logs.write_run, lambda: {"result": self.RunResult, "file": self.folder / "run.csv"}
        fields = self.state._asdict()
        del fields["controller_state"]  # which is the law's to judge
        yield self.restored, lambda: dict(fields)

    @functools.cached_property
    def state(self):
        return self.own("Simulation").state()

    def restored(self, **fields):
        """A simulation that goes on from a state with other fields."""
        simulation = self.own("Simulation")
        simulation.restore(self.state._replace(**fields))
        simulation.tick()

    def _arguments(self):
        """Good arguments by the name of what is called."""
        chain, arm = self.ClosedChain, self.ArmModel
        start = bennett("full")[1]
        cell_chain = cp.grasps.CellChain(self.scenario.cell)
        X = self.scenario.start.matrix
        q = cell_chain.configuration(X)
        v = np.zeros(cell_chain.mechanism.model.nv)
        k = arm.nv
        angles = {name: np.zeros(k) for name in self.scenario.cell.arms}
        state, at = {"q": start.q, "v": start.v}, {"q": q, "v": v, "tau": v, "push": np.zeros(6)}
        arm_state = {"q": np.full(k, 0.5), "v": np.zeros(k)}
        joint, metric = chain.model.names[1], "moving_position_rms_m"
        controller = cp.laws.build_controller(self.scenario)
        frame = str(chain.model.frames[3].name)
        ranges = {"duration": (0.02, 0.04)}
        good = {
            "ArmModel": {"arm": self.scenario.cell.arms["left"], "X_PE": np.eye(4), "gravity": (0, 0,
                -9.8), "name": "x"},
            "ArmModel.configuration": {"angles": np.zeros(k)},
            "ArmModel.posture": {"posture": np.zeros(k)},
            "ArmModel.forward_dynamics": {**arm_state, "tau": np.zeros(k), "F_EP_W": np.zeros(6)},
            "ArmModel.inverse_dynamics": {**arm_state, "a": np.zeros(k), "F_EP_W": np.zeros(6)},
            "CellChain": {"cell": self.scenario.cell, "options": self.scenario.plant},
            "CellChain.configuration": {"X_WP": X},
            "CellChain.posed_configuration": {"angles": angles, "X_WP": X},
            "CellChain.require_held": {"q": q, "X_WP": X, "allowed": 1e-3},
            "CellChain.surround": {"surroundings": self.scenario.cell.surroundings},
            "CellChain.payload_twist": {"q": q, "v": v},
            "CellChain.interaction_wrenches": at,
            "CellChain.observe": at,
            "ClosedChain": {
                "model": chain.model, "closures": chain.closures.closures,
                    "stabilisation": cp.plant.Stabilisation(),
                "formulation": "kkt",
            },
            "ClosedChain.from_urdf": {"path_or_xml": "panda", "closures": (), "gravity": (0, 0, 0),
                "mimic": "ignore"},
            "ClosedChain.configuration": {"angles": {joint: 0.1}},
            "ClosedChain.velocity": {"rates": {joint: 0.1}},
            "ClosedChain.assemble": {"q_guess": start.q, "v_guess": start.v},
            "ClosedChain.closure_errors": {"q": start.q},
            "ClosedChain.energy": state,
            "ClosedChain.forward_dynamics": {**state, "tau": np.zeros_like(start.v)},
            "ClosedChain.frame_pose": {"q": start.q, "frame": frame},
            "ClosedChain.integrate": {**state, "duration": 0.01, "step": 0.002, "torque": None,
                "project": True},
            "ClosedChain.project_configuration": {"q": start.q},
            "ClosedChain.project_velocity": state,
            "ClosedChain.require_closed": {"q": start.q, "allowed": 1e-6},
            "Closure": {"frame_a": "a", "frame_b": "b", "rows": "full", "X_AC": np.eye(4),
                "X_BC": np.eye(4)},
            "Payload.mesh": {"mass": 1.0, "path": self.mesh, "scale": 1.0},
            "Payload.box": {"mass": 1.0, "size": (0.1, 0.1, 0.1)},
            "CsvMotion": {"path": self.table},
            "task_rows": {"name": "planar"},
            "inverse_pose": {"X_AB": X},
            "pose_error": {"X_WP": X, "X_WP_d": X},
            "shift_wrench": {"F_EA": np.zeros(6), "p_BA": np.zeros(3)},
            "rotate_vector6": {"R_AB": np.eye(3), "vector_B": np.zeros(6)},
            "internal_wrenches": {"interaction": np.zeros((2, 6)), "load_shares": np.full(2, 0.5)},
            "make_pose": {"translation": np.zeros(3), "rpy": np.zeros(3)},
            "rpy_from_rotation": {"rotation": np.eye(3)},
            "FunctionMotion": {"target": "hostile_calls:still"},
            "UserController": {"target": "hostile_calls:Calls", "options": {}},
            "RunResult": {"scenario": self.scenario, "data": self.RunResult.data},
            "RunResult.save": {"path": self.folder / "saved.nc"},
            "RunResult.load": {"path": self.folder / "saved.nc"},
            "Simulation": {"scenario": self.scenario, "controller": controller},
            "Simulation.add_event": {"event": cp.events.PayloadChange(time=0.04, mass=1.0)},
            "Simulation.step": {"command": cp.CellCommand(
                [np.zeros(len(each.posture)) for each in self.scenario.cell.arms.values()], None)},
            "Simulation.restore": {"state": self.state},
            "Simulation.reset": {"seed": 3},
            "ArmCommand": {"torque": np.zeros(k), "state": None},
            "Task": {"action": "squeeze", "scale": 1.0, "rewards": {"position_error_m": 1.0}, "ticks": 2,
                "law": True, "failure": 1.0, "gains": (), "dtype": "float32"},
            "CellEnv": {"scenario": self.scenario, "task": cp.gym.Task(), "render_mode": None},
            "CellEnv.reset": {"seed": 3, "options": None},
            "CellEnv.step": {"action": np.zeros(self.scenario.cell.task_rows.size)},
            "VectorCellEnv": {"scenarios": [self.scenario] * 2, "task": cp.gym.Task(), "num_envs": 2,
                "render_mode": "ansi"},
            "VectorCellEnv.reset": {"seed": [3], "options": None},
            "VectorCellEnv.step": {"actions": np.zeros((1, self.scenario.cell.task_rows.size))},
            "Simulation.references": {"time": 0.01},
            "Simulation.replace_controller": {"controller": controller},
            "Simulation.replace_squeeze": {"squeeze": self.scenario.squeeze},
            "SweepResult": {"plan": self.plan, "store": self.SweepResult.store},
            "SweepResult.load": {"folder": self.folder / "sweep"},
            "SweepResult.at": {"fields": {"duration": 0.02}},
            "SweepResult.best": {"metric": metric, "n": 1, "largest": False},
            "SweepResult.marginal": {"field": "duration", "metric": metric, "average": np.mean},
            "SweepResult.open": {"number": 0},
            "SweepResult.point": {"number": 0},
            "SweepResult.pareto": {"metric_a": metric, "metric_b": "torque_peak_Nm"},
            "SweepResult.sobol_indices": {"metric": metric, "confidence": 0.9, "resamples": 9},
            "SweepResult.stability_boundary": {"field": "duration", "by": None, "stable": None},
            "SweepResult.values": {"metric": metric},
            "Scenario.save": {"path": self.folder / "saved.toml", "commented": True},
            "Scenario.to_toml": {"commented": True},
            "Scenario.override": {"changes": {"duration": 0.02}},
            "Comparison.ranks": {"measure": "axial_rms_N", "seed": 0},
            "Comparison.open": {
                "scenario": self.scenario.name,
                "controller": "leader-follower",
                "trial": "nominal",
                "seed": 0,
            },
            "Comparison.load": {"path": self.folder / "compared"},
            "Comparison.write_csv": {"path": self.folder / "comparison.csv"},
            "Comparison.write_html": {"path": self.folder / "comparison.html"},
            "Comparison.summary": {},
            "Comparison.labels": {"scenario": self.scenario.name},
            "Comparison.information": {"scenario": self.scenario.name},
            "BatchSimulator": {"machine": NumpyMachine},
            "BatchSimulator.run": {"scenarios": [self.scenario]},
            "Scenario.load": {"name_or_path": "adept-paper", "overrides": {"clock.record_every": 2}},
            "Scenario.from_toml": {"text": self.scenario.to_toml()},
            "cell_summary": {"cell": self.scenario.cell, "X_WP": X},
            "grasps_from_configuration": {"arms": self.scenario.cell.arms, "joint_angles": angles,
                "payload_pose": X},
            "ik_branches": {"arm": arm, "X_WP": X, "posture": np.zeros(k)},
            "solve_ik": {"arm": arm, "X_WP": X, "posture": np.zeros(k)},
            "linspace": {"first": 0.0, "last": 1.0, "count": 3},
            "logspace": {"first": 0.1, "last": 1.0, "count": 3},
            "open_view": {"source": self.scenario, "frames_per_second": 30.0, "port": 0},
            "reachability": {"scenario": self.scenario, "poses": 5},
            "suggest": {"scenario": self.scenario, "poses": 5},
            "fewest_steps": {"scenario": self.scenario, "error": 1e-3},
            "run": {"scenario": self.scenario, "overrides": {}, "progress": None, "view": None,
                "realtime_rate": None},
            "sampled_stability": {"scenario": self.scenario},
            "scenario_names": {},
            "simulate": {"scenario": self.scenario, "controller": controller, "progress": None,
                "view": None},
            "sweep": {"base": self.scenario, "axes": {"duration": [0.02]}, "out": self.folder / "s",
                "execution": cp.Execution(workers=0, quiet=True), "retry_failed": False},
            "tune": {"scenario": self.scenario, "vary": ranges, "minimize": "torque_peak_Nm",
                "out": self.folder / "t",
                     "generations": 1, "population": 1, "subject_to": (), "seed": 0,
                         "metrics": (), "execution": cp.Execution(workers=0, quiet=True)},
        }  # fmt: skip
        for name in ("joint_angles", "mass_matrix", "tip_pose", "payload_pose", "payload_jacobian"):
            good[f"ArmModel.{name}"] = {"q": arm_state["q"]}
        for name in ("nonlinear_effects", "payload_acceleration_bias"):
            good[f"ArmModel.{name}"] = arm_state
        for name in ("payload_pose", "payload_jacobian", "tip_positions", "closure_errors"):
            good[f"CellChain.{name}"] = {"q": q}
        for name in ("tick", "snapshot", "result", "state", "observe", "traffic"):
            good[f"Simulation.{name}"] = {}
        for owner in ("CellEnv", "VectorCellEnv"):
            good[f"{owner}.render"] = {}
        return {name: functools.partial(dict, arguments) for name, arguments in good.items()}

    @functools.cached_property
    def mesh(self):
        corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
        (self.folder / "body.obj").write_text(corners)
        return str(self.folder / "body.obj")

    @functools.cached_property
    def urdf(self):
        return cp.urdf.find_urdf("adept_3dof").path.read_text()

    @functools.cached_property
    def table(self):
        (self.folder / "motion.csv").write_text("t,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,1,0,0,0,0,0,1\n")
        return str(self.folder / "motion.csv")

    @functools.cached_property
    def hostile(self):
        objects = [
            self.scenario,
            self.scenario.cell,
            self.ArmModel,
            self.ClosedChain,
            self.RunResult,
            self.plan,
        ]
        return [
            *hostile_values(),
            *objects,
            *self.descriptions,
            cp.chain.ClosureError(0.0, 0.0),
            cp.Scenario,
            cp,
        ]


numbers = itertools.count()


def command_new(path, **options):
    """``coop-pin new`` with the words of its options; its exit code."""
    words = [word for name, value in options.items() for word in (f"--{name}", *str(value).split())]
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            return cli.main(["new", str(path), *words])
        except SystemExit as refusal:  # the words are no command
            return refusal.code


def still(_time):
    """A motion of a user."""
    return np.eye(4)


def random_call(calls: Calls, seed: int, number: int):
    """A call by its number: name, target, keyword arguments and which of them were replaced."""
    chance = random.Random(f"{seed} {number}")
    name = chance.choice(sorted(calls.recipes))
    target, arguments = calls.recipes[name]()
    names = [parameter for parameter in arguments if parameter not in ("out", "execution")]
    replaced = chance.sample(names, min(len(names), chance.choice((0, 1, 1, 1, 1, 2, 2, 3))))
    for parameter in replaced:
        arguments[parameter] = chance.choice(calls.hostile)
    if chance.random() < 0.02:
        arguments["no_such_argument"] = chance.choice(calls.hostile)
    return name, target, arguments, replaced


def not_finite(value: object) -> bool:
    """Whether a number anywhere in a result is NaN or infinite."""
    if isinstance(value, cp.RunResult):
        return any(
            not_finite(
                np.nan_to_num(value.data[name].values, posinf=np.nan, nan=np.nan if name != "torque" else 0.0)
            )
            for name in DYNAMIC
        )
    if isinstance(value, TickInputs | RunState):  # what sensors have not seen yet is NaN
        return False
    if isinstance(
        value, cp.results.Snapshot
    ):  # wrenches are NaN in undetermined rows, torques beyond an arm's joints
        value = [value.configuration, value.payload_pose, value.tip_position]
    if isinstance(value, float | np.ndarray) and np.asarray(value).dtype.kind == "f":
        return not np.isfinite(value).all()
    if isinstance(value, Mapping):
        value = list(value.values())
    return isinstance(value, list | tuple) and any(map(not_finite, value))


def ending(name: str, target, arguments) -> tuple[str, str]:
    """How a call ends, and what it raised or returned."""
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        value = target(**arguments)
    except Slow as slow:
        return "slow", "".join(traceback.format_tb(slow.__traceback__)[-3:])
    except cp.CoopPinError as error:
        return "refused", f"{type(error).__name__}: {error}"
    except TypeError as error:
        below = {frame.name for frame in traceback.extract_tb(error.__traceback__)[1:]}
        kind = "not callable so" if below <= {"call", "bind", "_bind"} else "bare"
        return kind, "".join(traceback.format_exception(error)[-4:])
    except Exception as error:
        return "bare", "".join(traceback.format_exception(error)[-4:])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    if name == "open_view":
        value.close()
    if name.split(".")[0] in FINITE and not_finite(value):
        return "nan", repr(value)[:300]
    return "result", type(value).__name__


def stop(*_: object) -> None:
    """Raise Slow, from a timer."""
    raise Slow


def main(seed: int, first: int, count: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    signal.signal(signal.SIGALRM, stop)
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    out = sys.stdout
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        cells = [Calls(Path(folder) / name, SCENARIOS[name]()) for name in SCENARIOS]
        for calls in cells:
            calls.RunResult.save(calls.folder / "saved.nc")
        (Path(folder) / "a" / "b").mkdir(parents=True)
        os.chdir(Path(folder) / "a" / "b")  # where files with a hostile name are written
        for number in range(first, first + count):
            name, target, arguments, replaced = random_call(cells[number % 2], seed, number)
            given = {key: repr(arguments[key])[:100] for key in replaced}
            print(json.dumps({"number": number, "call": name, "given": given}), file=out, flush=True)
            kind, text = ending(name, target, arguments)
            print(
                json.dumps({"number": number, "call": name, "given": given, "end": kind, "text": text}),
                file=out,
                flush=True,
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
