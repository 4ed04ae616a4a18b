"""The root of the tree: what every error can do."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self


def rebuild(kind: type[CoopPinError], message: str, fields: dict[str, Any]) -> CoopPinError:
    """Make an error from what it was pickled as."""
    layout: Any = kind
    while (
        layout.__module__ != "builtins"
    ):  # an OSError is larger than other exceptions: only its own __new__ may make one
        layout = layout.__base__
    error: CoopPinError = layout.__new__(kind, message)
    error.args = (message,)
    error.__dict__.update(fields)
    return error


class CoopPinError(Exception):
    """Root of every error that coop_pin raises on purpose; picklable, so that workers can send it.

    Attributes:
        result: where a run was under way, its RunResult up to then; otherwise None.
    """

    result: Any = None

    def __str__(self) -> str:
        """Return the message as written (a KeyError would quote it)."""
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by message and fields: constructors take numbers, not messages."""
        return rebuild, (type(self), str(self), self.__dict__)


class ArgumentError(CoopPinError, ValueError):
    """A value handed to a function is outside what the function accepts."""


class ShapeError(ArgumentError):
    """An array has the wrong shape.

    Attributes:
        name: the argument.
        shape: the shape it has.
        expected: the shape it must have.
    """

    def __init__(self, name: str, shape: tuple[int, ...], expected: tuple[int | str, ...]) -> None:
        self.name, self.shape, self.expected = name, shape, expected
        wanted = "(" + ", ".join(map(str, expected)) + ("," if len(expected) == 1 else "") + ")"
        super().__init__(f"{name} has shape {shape}; it must have shape {wanted}")


class NotFiniteError(ArgumentError):
    """An array holds a NaN or an infinity.

    Attributes:
        name: the argument.
        index: index of the first bad entry.
        value: the bad entry.
    """

    def __init__(self, name: str, index: tuple[int, ...], value: float) -> None:
        self.name, self.index, self.value = name, index, value
        where = f"[{', '.join(map(str, index))}]" if index else ""
        super().__init__(f"{name}{where} is {value}; every entry must be a finite number")


class NotPositiveError(ArgumentError):
    """A number that must be greater than zero is not.

    Attributes:
        name: the argument.
        value: the value it has.
    """

    def __init__(self, name: str, value: float) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} is {value:.6g}; it must be greater than zero")


class NotAPoseError(ArgumentError):
    """A 4x4 matrix is not a pose: its 3x3 block is no rotation, or its last row is not 0 0 0 1.

    Attributes:
        name: the argument.
        deviation: the largest entry of R^T R - I, or by how much the last row or the determinant is off.
    """

    def __init__(self, name: str, deviation: float, allowed: float) -> None:
        self.name, self.deviation = name, deviation
        super().__init__(
            f"{name} is not a pose: rotation block or last row is off by {deviation:.3g} (allowed {allowed:.3g});"
            " build it with coop_pin.spatial.make_pose"
        )


class NotIncreasingError(ArgumentError):
    """Times do not increase strictly.

    Attributes:
        name: the argument.
        index: index of the first entry that is not greater than the one before it.
        value: that entry.
        previous: the entry before it.
    """

    def __init__(self, name: str, index: int, value: float, previous: float) -> None:
        self.name, self.index, self.value, self.previous = name, index, value, previous
        super().__init__(
            f"{name}[{index}] is {value:.6g} after {previous:.6g}; times must increase strictly: sort them, drop repeats"
        )


class AmbiguousTurnError(ArgumentError):
    """The way round from one orientation to the next cannot be told: they are too near half a turn apart.

    Attributes:
        index: index of the second of the two orientations.
        angle: the angle between them, rad.
    """

    def __init__(self, first: str, second: str, index: int, angle: float) -> None:
        self.index, self.angle = index, angle
        super().__init__(
            f"the way round from {first} to {second}, {angle:.6g} rad apart, cannot be told (half a turn is pi);"
            " put an orientation in between, space the times more evenly, or use a Turn about a stated axis"
        )


class ScenarioError(CoopPinError, ValueError):
    """A description or scenario has mistakes; all of them are reported at once.

    Attributes:
        problems: one FieldError for each mistake.
    """

    problems: tuple[FieldError, ...]

    def __init__(self, problems: Iterable[FieldError], where: str = "the description") -> None:
        self.problems = tuple(problems)
        lines = "\n".join(f"  {problem}" for problem in self.problems)
        super().__init__(f"{where} has {len(self.problems)} mistakes:\n{lines}")


class FieldError(ScenarioError):
    """One mistake at one field.

    Attributes:
        path: dotted path of the field, for example "controller.gains.sign_gain".
        detail: what is wrong, with value and allowed values.
    """

    def __init__(self, detail: str, path: str = "") -> None:
        self.path, self.detail = path, detail
        self.problems = (self,)
        CoopPinError.__init__(self, self._message())

    def below(self, prefix: str) -> Self:
        """Return the same mistake seen from one level further out."""
        outer = copy.copy(self)
        outer.path = ".".join(part for part in (prefix, self.path) if part)
        outer.args = (outer._message(),)
        outer.problems = (outer,)
        return outer

    def _message(self) -> str:
        return f"{self.path}: {self.detail}" if self.path else self.detail

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the reference to itself."""
        fields = {key: value for key, value in self.__dict__.items() if key != "problems"}
        return _rebuild_field, (type(self), str(self), fields)


def _rebuild_field(kind: type[FieldError], message: str, fields: dict[str, Any]) -> FieldError:
    error = rebuild(kind, message, fields)
    assert isinstance(error, FieldError)
    error.problems = (error,)
    return error


def one_or_all(problems: Sequence[FieldError], where: str) -> ScenarioError:
    """Return the only problem itself, so that it can be caught by its type, or all of them together.

    Args:
        problems: at least one.
        where: the file or scenario that has them.
    """
    return problems[0] if len(problems) == 1 else ScenarioError(problems, where)


class UnknownFieldError(FieldError):
    """A field that does not exist."""


class MissingFieldError(FieldError):
    """A field that must be given is missing."""


class FieldNotFiniteError(FieldError):
    """A field holds a NaN or an infinity."""


class FieldShapeError(FieldError):
    """A field has the wrong number of entries."""


class LoadShareError(FieldError):
    """The load shares do not sum to one, or do not name the arms."""


class SqueezeError(FieldError):
    """The desired internal wrenches do not sum to zero."""


class SignGainError(FieldError):
    """A sign gain (alpha) that is not diagonal: s^T alpha sgn(s) would have no sign."""


class UnequalGainsError(FieldError):
    """Arms with different pose gains or force gains: the proof of Theorem 2 needs one for all."""


class ForceGainBoundError(FieldError):
    """A force gain at or beyond the bound of its sampled force path."""


class MotionError(FieldError):
    """A desired motion that contradicts itself."""


class EventTimeError(FieldError):
    """An event outside the run."""


class ScenarioFileError(CoopPinError, ValueError):
    """A file is not readable as a scenario."""


class NameNotFoundError(CoopPinError, KeyError):
    """A name is not known.

    Attributes:
        kind: what was looked for, for example "frame".
        name: the name asked for.
        known: the names there are.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str) -> None:
        self.kind, self.name, self.known = kind, name, tuple(known)
        super().__init__(
            f"no {kind} {name!r} in {where}" + (f"; {suggestion(name, self.known)}" if self.known else "")
        )


class FrameNotFoundError(NameNotFoundError):
    """A frame name is not in the model."""


class JointNotFoundError(NameNotFoundError):
    """A joint name is not in the model."""


class ArmNotFoundError(NameNotFoundError):
    """An arm name is not in the cell."""


class EntryNotFoundError(NameNotFoundError):
    """A name is not in a catalogue."""


def suggestion(name: str, known: Sequence[str]) -> str:
    """Say which known names come closest to a wrong one, or list them where they are few.

    Args:
        name: the wrong one.
        known: the names there are.
    """
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(map(repr, close)) + "?"
    shown = ", ".join(map(repr, known[:12]))
    return f"known: {shown}" + (f" and {len(known) - 12} more" if len(known) > 12 else "")


class MissingExtraError(CoopPinError, ImportError):
    """An optional package is not installed.

    Attributes:
        package: the package.
        extra: the extra of coop-pin that brings it.
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(f"{package} is not installed; {purpose}, run: pip install 'coop-pin[{extra}]'")


class MissingPinocchioError(CoopPinError, ImportError):
    """Pinocchio cannot be used: it is not there, does not load, is of another version, or another package has its name.

    Attributes:
        found: what was found in its place.
    """

    def __init__(self, found: str) -> None:
        self.found = found
        super().__init__(
            f"{found}. On Linux (glibc 2.28 or later, not musl) and macOS: pip install 'pin>=4.1,<5'. With conda, and on Windows, where "
            "PyPI has no wheel of pin: conda install -c conda-forge 'pinocchio>=4.1,<5'. Only conda-forge calls it pinocchio; on PyPI it "
            "is pin"
        )


class UnreachablePoseError(CoopPinError, ValueError):
    """An arm cannot hold the payload at a pose.

    Attributes:
        arm: the arm.
        gap_m: the least distance found between its tip and its grasp.
        gap_rad: the angle that is left between them at that distance.
    """

    def __init__(self, arm: str, gap_m: float, gap_rad: float, detail: str = "") -> None:
        self.arm, self.gap_m, self.gap_rad = arm, gap_m, gap_rad
        super().__init__(
            f"arm {arm!r} misses its grasp by {gap_m:.3g} m and {gap_rad:.3g} rad at the best joint angles found;"
            f" move the payload pose, the base or the grasp{detail}"
        )


class JointLimitError(UnreachablePoseError):
    """An arm could hold the payload at a pose, but only beyond its joint limits.

    Attributes:
        joint: the joint that stands farthest beyond its limits at the best angles that hold the payload.
        value: where it stands there, rad or m.
        lower: its limits.
        upper: likewise.
    """

    def __init__(
        self, arm: str, gap_m: float, gap_rad: float, joint: str, value: float, lower: float, upper: float
    ) -> None:
        self.joint, self.value, self.lower, self.upper = joint, value, lower, upper
        detail = f". Only joint limits prevent it: {joint!r} would stand at {value:.4g} (allowed {lower:.4g} to {upper:.4g})"
        super().__init__(arm, gap_m, gap_rad, detail)


class OpenClosureError(CoopPinError, ValueError):
    """Closures stand open where they must be closed.

    Attributes:
        closure: the closure.
        gap_m: distance across it.
        gap_rad: angle across it.
    """

    def __init__(self, closure: str, gap_m: float, gap_rad: float, allowed: float) -> None:
        self.closure, self.gap_m, self.gap_rad = closure, gap_m, gap_rad
        super().__init__(
            f"closure {closure!r} is open by {gap_m:.3g} m and {gap_rad:.3g} rad (allowed {allowed:.3g});"
            " project the state onto the closures first, or correct the starting angles"
        )


class ConstraintSolveError(CoopPinError, ArithmeticError):
    """The constrained dynamics left a residual: J a + gamma is not zero.

    Attributes:
        residual: its largest entry, m/s^2 or rad/s^2.
        allowed: the largest accepted.
    """

    def __init__(self, residual: float, allowed: float) -> None:
        self.residual, self.allowed = residual, allowed
        super().__init__(
            f"the constraint solver left a residual of {residual:.3g} (allowed {allowed:.3g});"
            " the state is far off the closures or the closures contradict each other; check grasps and starting angles, or lower the gains"
        )


class MassMatrixError(CoopPinError, ArithmeticError):
    """A mass matrix is not positive definite: something moves without mass.

    Attributes:
        smallest: its smallest eigenvalue.
    """

    def __init__(self, smallest: float) -> None:
        self.smallest = smallest
        super().__init__(
            f"the mass matrix has an eigenvalue {smallest:.3g}; it must be greater than zero:"
            " give every moving link, or what is fixed to it, a mass and an inertia"
        )


class IntegrationError(CoopPinError, ArithmeticError):
    """A motion could not be followed to its end; what was computed up to then is kept.

    Attributes:
        time: time of the last good state, s.
        step: the time step, s.
        result: the Trajectory up to then.
    """

    def __init__(self, time: float, step: float, why: str, result: Any) -> None:
        self.time, self.step, self.result = time, step, result
        super().__init__(
            f"the motion broke down after t = {time:.6g} s: {why}; take a step smaller than {step:.3g} s; the motion up to then is kept"
        )


class SingularJacobianError(CoopPinError, ArithmeticError):
    """A payload Jacobian is singular (Assumption 2 of the paper fails).

    Attributes:
        condition: its condition number.
        time: time, s.
        limit: the greatest that is allowed.
    """

    def __init__(self, condition: float, time: float, limit: float, owner: str = "the arm") -> None:
        self.condition, self.time, self.limit = condition, time, limit
        super().__init__(
            f"{owner} is singular at t = {time:.6g} s: condition number {condition:.3g} of its payload Jacobian"
            f" (allowed {limit:.3g}); keep the motion away from stretched or folded arms"
        )


class SingularArmError(SingularJacobianError):
    """An arm of the cell reached a singular pose.

    Attributes:
        arm: the arm.
        condition: condition number of its payload Jacobian.
        time: time, s.
    """

    def __init__(self, arm: str, condition: float, time: float, limit: float) -> None:
        self.arm = arm
        super().__init__(condition, time, limit, owner=f"arm {arm!r}")


class InconsistentReferenceError(CoopPinError, ValueError):
    """A desired twist or acceleration is not the derivative of what it belongs to.

    Attributes:
        quantity: what disagrees, for example "linear part of V_WP_d".
        time: the time at which it disagrees most, s.
        gap: norm of the difference there, SI.
    """

    def __init__(self, quantity: str, time: float, gap: float, allowed: float) -> None:
        self.quantity, self.time, self.gap = quantity, time, gap
        super().__init__(
            f"the {quantity} disagrees with central differences by {gap:.3g} at t = {time:.6g} s (allowed {allowed:.3g});"
            " check its axes (world), its order (linear first) and its signs, or leave it out"
        )


class ReferenceFileError(CoopPinError, ValueError):
    """A file is not readable as a table of poses.

    Attributes:
        path: the file.
        line: number of the bad line, counted from one; zero for the file as a whole.
    """

    def __init__(self, path: str, line: int, detail: str) -> None:
        self.path, self.line = path, line
        super().__init__(f"{path}, line {line}: {detail}" if line else f"{path}: {detail}")


class UrdfNotFoundError(FieldError, FileNotFoundError):
    """A robot description file is not where it was looked for."""


class UrdfError(FieldError):
    """A robot description file that cannot be used."""


class AmbiguousTipError(UrdfError):
    """No tip is given and the URDF has several links at its ends.

    Attributes:
        leaves: the links that carry no other.
    """

    def __init__(self, urdf: str, leaves: Iterable[str], path: str = "") -> None:
        self.leaves = tuple(leaves)
        super().__init__(
            f"must be given: {urdf!r} has {len(self.leaves)} links at its ends, {', '.join(map(repr, self.leaves))}",
            path,
        )


class LockedJointError(UrdfError):
    """A joint is locked where it cannot be."""


class MimicJointError(UrdfError):
    """A URDF couples moving joints, and nothing says what to do about it.

    Attributes:
        joints: the joints that follow others.
    """

    def __init__(self, urdf: str, joints: Iterable[str], path: str = "") -> None:
        self.joints = tuple(joints)
        super().__init__(
            f"{urdf!r} has joints that mimic others: {', '.join(map(repr, self.joints))}. Pinocchio's forward dynamics cannot couple them:"
            ' lock them or their leaders with locked = { joint = angle }, or let them move on their own with mimic = "ignore"',
            path,
        )


class UnsupportedJointError(UrdfError):
    """A joint that no motor turns: planar or floating.

    Attributes:
        joint: its name.
    """

    def __init__(self, urdf: str, joint: str, kind: str, path: str = "") -> None:
        self.joint = joint
        super().__init__(
            f"{urdf!r} has joint {joint!r} of type {kind}; arms have revolute, continuous, prismatic and fixed joints",
            path,
        )


class MeshError(FieldError):
    """A mesh that cannot be read, or does not enclose a volume."""


class UserCodeError(CoopPinError, RuntimeError):
    """A controller, motion or squeeze of the user's own raised; its exception is the cause of this one.

    Attributes:
        time: time of the tick, s.
        cause: type and message of the exception.
    """

    def __init__(self, time: float, error: Exception) -> None:
        self.time, self.cause = time, f"{type(error).__name__}: {error}"
        super().__init__(
            f"at t = {time:.6g} s a controller, motion or squeeze raised {self.cause}; the result up to then is kept"
        )


class DivergedError(CoopPinError, ArithmeticError):
    """A run left the range of finite, closed motion; what was computed up to then is kept.

    Attributes:
        time: time of the last good tick, s.
        quantity: what ran away.
        value: its value.
        limit: what it may not exceed.
    """

    def __init__(self, time: float, quantity: str, value: float, limit: float) -> None:
        self.time, self.quantity, self.value, self.limit = time, quantity, value, limit
        super().__init__(
            f"the run diverged at t = {time:.6g} s: {quantity} reached {value:.3g} (limit {limit:.3g});"
            " lower the gains or raise the control rate ('coop-pin check' tells how far); the result up to then is kept"
        )


class RunInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a run; what was computed up to then is kept. A KeyboardInterrupt, so that ``except Exception`` lets it pass.

    Attributes:
        time: time of the last recorded tick, s; not a number if there is none.
        result: the RunResult up to then.
    """

    def __init__(self, time: float, result: Any) -> None:
        self.time, self.result = time, result
        super().__init__(f"the run was interrupted at t = {time:.6g} s; the result up to then is kept")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by fields, not by message."""
        return type(self), (self.time, self.result)


class RunFinishedError(CoopPinError, RuntimeError):
    """A tick was asked of a run that has come to its end.

    Attributes:
        end: time of its last tick, s.
    """

    def __init__(self, end: float) -> None:
        self.end = end
        super().__init__(
            f"the run has come to its end at t = {end:.6g} s; make a new Simulation, or give the scenario a longer duration"
        )


class ResultFileError(CoopPinError, ValueError):
    """A file is not a result of coop_pin, or is damaged."""


class RunTimeoutError(CoopPinError, TimeoutError):
    """A run took longer than its limit.

    Attributes:
        limit: the limit, s of wall time.
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        super().__init__(
            f"the run took longer than its limit of {limit:g} s; raise time_limit_s, shorten the run or lower steps_per_tick"
        )


class WorkerDiedError(CoopPinError, RuntimeError):
    """A run ended its worker's process again and again: a crash in native code, an exit, or too little memory.

    Attributes:
        deaths: how many workers died with it.
    """

    def __init__(self, deaths: int) -> None:
        self.deaths = deaths
        super().__init__(f"{deaths} workers died while running it; run it alone (workers = 0) to see why")


class WorkersLostError(CoopPinError, ConnectionError):
    """No worker is left, or the scheduler is gone; every finished run is kept."""


class CodeChangedError(CoopPinError, RuntimeError):
    """A process that runs the user's own code loaded it before an edit, or has another version of it.

    Attributes:
        name: the code, "module:function".
    """

    def __init__(self, name: str) -> None:
        self.name = name
        again = "start the same command again (in a notebook restart the kernel, elsewhere the workers): finished runs are kept"
        super().__init__(
            f"{name} is not as this process loaded it: it was edited since, or a worker has another version; {again}"
        )


class SweepStoreError(CoopPinError, ValueError):
    """A folder is not that of a sweep, or its plan is damaged."""


class StoreLockedError(CoopPinError, RuntimeError):
    """Another process works on the folder of a sweep.

    Attributes:
        owner: who holds it, as far as it said.
    """

    def __init__(self, folder: str, owner: str) -> None:
        self.owner = owner
        super().__init__(f"{folder} is in use by {owner}; wait until it ends, or choose another folder")


class StoreWriteError(CoopPinError, OSError):
    """A file of a sweep cannot be written; every run written before is kept.

    Attributes:
        path: the file.
        reason: what the system said.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(
            f"{path} cannot be written: {reason}; make room, then run the same command again: finished runs are kept"
        )


class UnfinishedSweepError(CoopPinError, ValueError):
    """A question needs every run of a sweep, and some are missing or failed.

    Attributes:
        unfinished: how many.
    """

    def __init__(self, question: str, unfinished: int, total: int) -> None:
        self.unfinished = unfinished
        super().__init__(
            f"{question} needs all {total} runs, but {unfinished} of them failed or are missing; look at result.failures"
        )


class NothingFeasibleError(CoopPinError, ValueError):
    """Tuning found no run within all bounds.

    Attributes:
        tried: number of runs.
        failed: how many of them failed.
        folder: where they are kept.
    """

    def __init__(
        self, tried: int, failed: int, bounds: Sequence[str], folder: str, complaint: str = ""
    ) -> None:
        self.tried, self.failed, self.folder = tried, failed, folder
        wanted = "keeps " + ", ".join(bounds) if bounds else "has a finite metric"
        said = f"; the first that failed said: {complaint}" if complaint else ""
        super().__init__(
            f"none of {tried} runs ({failed} failed), kept in {folder}, {wanted};"
            f" change the ranges, loosen the bounds or search longer{said}"
        )


class SweepInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a sweep; every finished run is kept. A KeyboardInterrupt, so that ``except Exception`` lets it pass.

    Attributes:
        folder: the folder of the sweep.
        finished: number of runs it holds.
        total: number of runs of the plan.
    """

    def __init__(self, folder: str, finished: int, total: int) -> None:
        self.folder, self.finished, self.total = folder, finished, total
        super().__init__(
            f"interrupted with {finished} of {total} runs kept in {folder}; run the same command again to go on"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by fields, not by message."""
        return type(self), (self.folder, self.finished, self.total)


class BrowserNotFoundError(CoopPinError, RuntimeError):
    """There is no browser to draw pictures with.

    Attributes:
        looked_for: where one was looked for.
    """

    def __init__(self, looked_for: Sequence[str]) -> None:
        self.looked_for = tuple(looked_for)
        super().__init__(
            f"there is no browser to draw pictures with (looked for {', '.join(looked_for)});"
            " run: playwright install chromium, or install Chromium or Chrome, or say where one is in the variable CHROMIUM"
        )


class BrowserError(CoopPinError, RuntimeError):
    """The browser that draws pictures does not start, or the page in it went wrong.

    Attributes:
        browser: its path.
        complaint: what it said.
    """

    def __init__(self, browser: str, complaint: str) -> None:
        self.browser, self.complaint = browser, complaint
        super().__init__(
            f"{browser} drew no picture: {complaint}; name another Chromium or Chrome in the variable CHROMIUM"
        )


class VideoError(CoopPinError, OSError):
    """The encoder did not write a whole video: the disk is full, or it ended early.

    Attributes:
        path: of the video.
        frames: that were written.
        wanted: frames of the whole video.
    """

    def __init__(self, path: Path, frames: int, wanted: int) -> None:
        self.path, self.frames, self.wanted = path, frames, wanted
        super().__init__(
            f"{path} was not written: the encoder wrote {frames} of {wanted} frames and said why above; is the disk full?"
        )


class TimeOutsideRunError(ArgumentError):
    """A picture was asked for of a time that the run does not have.

    Attributes:
        time: s.
        end: of the run, s.
    """

    def __init__(self, time: float, end: float) -> None:
        self.time, self.end = time, end
        super().__init__(f"time is {time:.6g} s; the run has pictures from 0 to {end:.6g} s")


class PictureSizeError(ArgumentError):
    """A width or height that pictures cannot have.

    Attributes:
        name: the argument.
        value: pixels.
    """

    def __init__(self, name: str, value: int, allowed: str) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} is {value} pixels; it must be {allowed}")


class PortTakenError(CoopPinError, OSError):
    """The port chosen for a view cannot be had.

    Attributes:
        port: its number.
        reason: what the system said.
    """

    def __init__(self, port: int, reason: str) -> None:
        self.port, self.reason = port, reason
        super().__init__(
            f"port {port} of 127.0.0.1 cannot be had ({reason}); choose another from 1024 to 65535, or 0 for any free one"
        )


class UrdfWarning(UserWarning):
    """A robot description file whose masses or inertias no body can have, or whose numbers look like another unit's."""


class GeometryWarning(UserWarning):
    """A visual geometry that cannot be read and is left out of pictures; the physics does not use it."""


class ViewWarning(UserWarning):
    """A 3-D view that does not show, or no longer; the simulation goes on without it."""
