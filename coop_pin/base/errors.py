"""Error tree of coop_pin: every exception and warning that the package raises on purpose.

Each class carries the numbers and names of its message as attributes, can be pickled (workers of a sweep send
errors to the main process) and also derives from the built-in exception that fits it, so that
``except ValueError`` works. A class of its own exists only if a caller tells it from its siblings.
"""

from __future__ import annotations

import contextlib
import copy
import difflib
import math
import os
import signal
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

_KNOWN = str(Path(__file__).parents[1]) + os.sep, sysconfig.get_path("stdlib") + os.sep
"""Folders of this package and the standard library."""


class _Picklable(BaseException):
    """Exception that is pickled by its attributes, because constructors take numbers, not messages."""

    def __str__(self) -> str:
        """Return the message as written; KeyError would quote it, OSError would have lost it."""
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).__new__, (type(self),), {**self.__dict__, "args": self.args}


class _Interrupt(_Picklable, KeyboardInterrupt):
    """Ctrl-C that says what is kept. Uncaught, it ends a script with its message and exit code 130.

    Python ends so on KeyboardInterrupt itself only; classes derived from it would end with a traceback and 1.
    """

    def __init__(self, message: str) -> None:
        super().__init__(message)
        if sys.excepthook is sys.__excepthook__:
            sys.excepthook = _end_interrupted


def _end_interrupted(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Tell an uncaught exception; of an _Interrupt its message alone.

    Raises:
        SystemExit: 130, of an _Interrupt.
    """
    if not isinstance(error, _Interrupt):
        return sys.__excepthook__(kind, error, trace)
    print(error, file=sys.stderr)
    raise SystemExit(128 + signal.SIGINT)


def is_ctrl_c(error: BaseException) -> bool:
    """Return whether an error that is not coop_pin's own stands for Ctrl-C.

    Compiled code that loads makes an ImportError of it, a class statement a RuntimeError, both with their
    cause, and pydantic, while it writes JSON, a PydanticSerializationError with its name in the text.
    """
    if isinstance(error, CoopPinError):
        return False
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__
    is_of_pydantic = type(error).__name__ == "PydanticSerializationError"
    return cause is not None or (
        is_of_pydantic and any(name in str(error) for name in ("KeyboardInterrupt", "CtrlC"))
    )


class CoopPinError(_Picklable, Exception):
    """Base class of all errors of coop_pin; ``result`` is the RunResult up to the error if it ended a run."""

    result: Any = None


# ---------------------------------------------------------------- arguments


class ArgumentError(CoopPinError, ValueError):
    """An argument outside what a function accepts."""


class WrongTypeError(CoopPinError, TypeError):
    """An argument ``name`` of the type ``actual`` where an object of the type ``expected`` is needed."""

    def __init__(self, name: str, actual: str, expected: str) -> None:
        self.name, self.actual, self.expected = name, actual, expected
        super().__init__(f"{name} is of type {actual}; it must be of type {expected}")


class NotEnoughMemoryError(ArgumentError):
    """Arrays of ``needed`` bytes where ``free`` bytes are available; nothing has been allocated."""

    def __init__(self, what: str, needed: float, free: int, remedy: str) -> None:
        self.needed, self.free = needed, free
        super().__init__(
            f"{what} need {needed / 1e9:.3g} GB of memory and {free / 1e9:.3g} GB are free; {remedy}"
        )


class ShapeError(ArgumentError):
    """An array of the wrong shape: ``name`` of the argument, its ``shape``, the ``expected`` shape."""

    def __init__(self, name: str, shape: tuple[int, ...], expected: tuple[int | str, ...]) -> None:
        self.name, self.shape, self.expected = name, shape, expected
        form = "(" + ", ".join(map(str, expected)) + ("," if len(expected) == 1 else "") + ")"
        super().__init__(f"{name} has shape {shape}; it must have shape {form}")


class OutOfRangeError(ArgumentError):
    """A number ``name``, or its entry at ``index``, outside its allowed range; NaN and infinity included."""

    def __init__(
        self, name: str, value: float, allowed: str = "greater than zero", index: tuple[int, ...] = ()
    ) -> None:
        self.name, self.value, self.allowed, self.index = name, value, allowed, index
        entry = f"{name}[{', '.join(map(str, index))}]" if index else name
        super().__init__(f"{entry} is {value:.6g}; it must be {allowed}")


class AmbiguousTurnError(ArgumentError):
    """A rotation to orientation ``index[0]`` that is ambiguous: its ``angle`` in rad is close to pi."""

    def __init__(self, first: str, second: str, index: int, angle: float) -> None:
        self.index, self.angle = (index,), angle
        super().__init__(
            f"the rotation from {first} to {second} is ambiguous ({angle:.6g} rad, close to pi); add an"
            " orientation between them, space the times more evenly, or use a turn about a given axis"
        )


# ---------------------------------------------------------------- names and packages


def suggestion(name: str, known: Sequence[str]) -> str:
    """Return the known names closest to a misspelt one, or all of them if none is close.

    Args:
        name: the misspelt name.
        known: the existing names.
    """
    close = difflib.get_close_matches(str(name), known, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(map(repr, close)) + "?"
    shown = ", ".join(map(repr, known[:12]))
    return f"known: {shown}" + (f" and {len(known) - 12} more" if len(known) > 12 else "")


class NameNotFoundError(CoopPinError, KeyError):
    """An unknown ``name`` of a ``kind`` such as "frame" or "metric"; ``known`` are the existing names."""

    def __init__(self, kind: str, name: str, known: Iterable[str], container: str) -> None:
        self.kind, self.name, self.known = kind, name, tuple(known)
        hint = f"; {suggestion(name, self.known)}" if self.known else ""
        super().__init__(f"no {kind} {name!r} in {container}{hint}")


class MissingExtraError(CoopPinError, ImportError):
    """An optional ``package`` that is not installed; ``extra`` of coop-pin installs it."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra = package, extra
        command = f"pip install 'coop-pin[{extra}]' (in a clone: pip install -e '.[{extra}]')"
        super().__init__(f"{package} is not installed; {purpose}, run: {command}")


@contextlib.contextmanager
def needs_extra(package: str, extra: str, purpose: str) -> Iterator[None]:
    """Raise a MissingExtraError for an import of an optional package that fails inside.

    Args:
        package: name of the package as pip knows it.
        extra: extra of coop-pin that installs it.
        purpose: reason to need it, such as "to draw images".
    """
    try:
        yield
    except ImportError:
        raise MissingExtraError(package, extra, purpose) from None


class MissingPinocchioError(CoopPinError, ImportError):
    """Pinocchio is missing, broken or unsupported; ``reason`` says which."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(
            f"{reason}. On Linux (glibc 2.28 or later, not musl) and macOS: pip install 'pin>=4.1,<5'. With"
            " conda, and on Windows, for which PyPI has no wheel: conda install -c conda-forge"
            " 'pinocchio>=4.1,<5'. Only conda-forge calls it pinocchio; on PyPI it is pin"
        )


# ---------------------------------------------------------------- files


class FileReadError(CoopPinError, ValueError):
    """A missing, damaged or foreign file (scenario, result, table, sweep); ``path`` and ``line`` if known."""

    def __init__(self, detail: str, path: str = "", line: int = 0) -> None:
        self.path, self.line = path, line
        prefix = f"{path}, line {line}: " if line else f"{path}: " if path else ""
        super().__init__(prefix + detail)


class ArmsDisagreeError(FileReadError):
    """A table of joint angles by which two ``arms`` hold the payload apart, worst at ``time`` in s.

    By ``distance`` in m and ``angle`` in rad.
    """

    def __init__(
        self,
        first: str,
        second: str,
        time: float,
        distance: float,
        angle: float,
        allowed: float,
        path: str,
        line: int,
    ) -> None:
        self.arms, self.time, self.distance, self.angle = (first, second), time, distance, angle
        super().__init__(
            f"arms {first!r} and {second!r} hold the payload {distance:.4g} m and {angle:.4g} rad apart at"
            f" t = {time:.6g} s (allowed {allowed:g}); correct bases, grasps or the table, or raise"
            " motion.allowed",
            path,
            line,
        )


class FileWriteError(CoopPinError, OSError):
    """A file ``path`` that cannot be written whole, with its ``reason``; earlier files are kept."""

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(
            f"{path} cannot be written: {reason}; free some disk space or choose another folder, then run the"
            " same command again (finished runs of a sweep are kept)"
        )


# ---------------------------------------------------------------- fields of a scenario


class ScenarioError(CoopPinError, ValueError):
    """All mistakes of a scenario or another description; ``problems`` has one FieldError for each."""

    def __init__(self, problems: Iterable[FieldError], owner: str = "the description") -> None:
        self.problems = tuple(problems)
        lines = "\n".join(f"  {problem}" for problem in self.problems)
        super().__init__(f"{owner} has {len(self.problems)} mistakes:\n{lines}")


class FieldError(ScenarioError):
    """One mistake: dotted ``path`` of the field, and ``detail`` with its value and the allowed values."""

    def __init__(self, detail: str, path: str = "") -> None:
        self.detail = detail
        self._place(path)

    def _place(self, path: str) -> None:
        self.path, self.problems = path, (self,)
        self.args = (f"{path}: {self.detail}" if path else self.detail,)

    def below(self, prefix: str) -> Self:
        """Return the same mistake with its path prefixed by that of an outer field."""
        outer = copy.copy(self)
        outer._place(".".join(part for part in (prefix, self.path) if part))
        return outer


class UnknownFieldError(FieldError):
    """A field that does not exist."""


def one_or_all(problems: Sequence[FieldError], owner: str) -> ScenarioError:
    """Return the only problem itself, to be caught by its type, or all of them as one ScenarioError.

    Args:
        problems: mistakes, at least one.
        owner: the file or scenario that has them.
    """
    return problems[0] if len(problems) == 1 else ScenarioError(problems, owner)


# ---------------------------------------------------------------- robots


class UrdfError(FieldError):
    """A robot description that is missing or unusable; ``names`` are the links or joints concerned."""

    def __init__(self, detail: str, path: str = "", names: Iterable[str] = ()) -> None:
        self.names = tuple(names)
        super().__init__(detail, path)


class MimicJointError(UrdfError):
    """A URDF with mimic joints and no policy for them; ``names`` are the joints that follow others."""

    def __init__(self, urdf: str, joints: Iterable[str], path: str, stop: str) -> None:
        super().__init__(
            f"{urdf!r} has mimic joints: {', '.join(map(repr, joints))}. Pinocchio's forward dynamics cannot"
            f" couple them to the joints they follow: {stop}, or let them move independently with"
            ' mimic = "ignore"',
            path,
            joints,
        )


# ---------------------------------------------------------------- kinematics and dynamics


class UnreachablePoseError(CoopPinError, ValueError):
    """A payload pose that ``arm`` cannot reach: its tip stays ``distance`` m and ``angle`` rad away."""

    def __init__(self, arm: str, distance: float, angle: float, detail: str = "") -> None:
        self.arm, self.distance, self.angle = arm, distance, angle
        super().__init__(
            f"arm {arm!r} misses its grasp by {distance:.3g} m and {angle:.3g} rad at the best joint angles"
            f" found; move the payload pose, the base or the grasp{detail}"
        )


class JointLimitError(UnreachablePoseError):
    """A pose out of reach because ``joint`` at ``value`` is beyond ``lower`` or ``upper`` (rad or m)."""

    def __init__(
        self, arm: str, distance: float, angle: float, joint: str, value: float, lower: float, upper: float
    ) -> None:
        self.joint, self.value, self.lower, self.upper = joint, value, lower, upper
        needed = f"{joint!r} would be at {value:.4g} (allowed {lower:.4g} to {upper:.4g})"
        super().__init__(arm, distance, angle, f". Only joint limits prevent it: {needed}")


class InfeasibleMotionError(CoopPinError, ValueError):
    """A motion beyond a cell.

    ``cause`` is "rank", "reach", "singularity", "limits", "torque", "stability" or "friction"; ``detail``
    says where and by how much.
    """

    def __init__(self, cause: str, detail: str) -> None:
        self.cause, self.detail = cause, detail
        super().__init__(f"the cell cannot do this motion ({cause}): {detail}")


class OpenClosureError(CoopPinError, ValueError):
    """A closure error of ``closure`` beyond the tolerance: ``distance`` in m, ``angle`` in rad."""

    def __init__(self, closure: str, distance: float, angle: float, allowed: float) -> None:
        self.closure, self.distance, self.angle = closure, distance, angle
        super().__init__(
            f"the closure error of {closure!r} is {distance:.3g} m and {angle:.3g} rad (allowed"
            f" {allowed:.3g}): close it by ``assemble(q)`` or ``project_configuration(q)`` of the chain, or"
            " correct the joint angles"
        )


class ConstraintSolveError(CoopPinError, ArithmeticError):
    """A ``residual`` of the constrained dynamics J a + gamma = 0 beyond ``allowed``, m/s^2 or rad/s^2."""

    def __init__(self, residual: float, allowed: float) -> None:
        self.residual, self.allowed = residual, allowed
        super().__init__(
            f"the constraint solver left a residual of {residual:.3g} (allowed {allowed:.3g}): the closure"
            " errors are large or the closures contradict each other; check grasps and initial joint"
            " angles, or lower the gains"
        )


class MassMatrixError(CoopPinError, ArithmeticError):
    """A mass matrix that is not positive definite; ``smallest`` is its smallest eigenvalue."""

    def __init__(self, smallest: float) -> None:
        self.smallest = smallest
        super().__init__(
            f"the mass matrix has an eigenvalue {smallest:.3g}; all must be greater than zero:"
            " give every moving link, or a link fixed to it, a mass and an inertia"
        )


class IntegrationError(CoopPinError, ArithmeticError):
    """An integration with ``step`` s that failed after ``time`` s; ``result`` is the Trajectory before."""

    def __init__(self, time: float, step: float, reason: str, result: Any) -> None:
        self.time, self.step, self.result = time, step, result
        super().__init__(
            f"the integration failed after t = {time:.6g} s: {reason}; take a step smaller than {step:.3g} s;"
            " the trajectory up to then is kept"
        )


class SingularJacobianError(CoopPinError, ArithmeticError):
    """A singular payload Jacobian of ``arm`` ("" if unknown): ``condition`` above ``limit`` at ``time`` s."""

    def __init__(self, condition: float, time: float, limit: float, arm: str = "") -> None:
        self.condition, self.time, self.limit, self.arm = condition, time, limit, arm
        super().__init__(
            f"{f'arm {arm!r}' if arm else 'the arm'} is singular at t = {time:.6g} s: condition number"
            f" {condition:.3g} of its payload Jacobian (allowed {limit:.3g}); keep the motion away from"
            " stretched or folded arms"
        )


# ---------------------------------------------------------------- runs


class InvalidStateError(CoopPinError, RuntimeError):
    """An operation that its object is not ready for: a tick of a finished run, an unfinished sweep."""


class TracingError(ArgumentError, TypeError):
    """Runs that traced code cannot give, for example as a law branches on a value; the message says why."""


def place_of(error: BaseException) -> tuple[str, int, str]:
    """Return file, line and function of the innermost frame of the user's code in an exception's traceback.

    Without such a frame they are those of the innermost one. A file of the user's is named relative to the
    current folder if it is below it; of any other the name alone is returned: tables hold no paths of a host.

    Args:
        error: exception that was caught; one that was never raised has the place ("", 0, "").
    """
    frames = list(traceback.walk_tb(error.__traceback__))[::-1]
    if not frames:
        return "", 0, ""
    # By the file of the module: compiled code states one of its own for each frame, a notebook has none.
    users = (entry for entry in frames if is_users_file(entry[0].f_globals.get("__file__") or ""))
    frame, line = next(users, frames[0])
    return shown(Path(frame.f_code.co_filename)), line, frame.f_code.co_qualname


def is_of_users_code(error: BaseException) -> bool:
    """Return whether an exception went through a function of the user's, below the one that caught it."""
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
    return any(is_users_file(frame.f_globals.get("__file__") or __file__) for frame in frames)


def source_of(function: Callable[..., Any]) -> tuple[str, int, str]:
    """Return file, first line and name of a function or method, as ``place_of``; ("", 0, name) if unknown."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    code = getattr(function, "__code__", None)
    return ("", 0, name) if code is None else (shown(Path(code.co_filename)), code.co_firstlineno, name)


def is_users(function: Callable[..., Any]) -> bool:
    """Return whether a function or method is of neither this package nor an installed one."""
    code = getattr(function, "__code__", None)
    return code is not None and is_users_file(code.co_filename)


def shown(file: Path) -> str:
    """Return the path of a user's file relative to the current folder if it is below it, else its name."""
    file, here = file.resolve(), Path.cwd()
    is_below = is_users_file(str(file)) and file.is_relative_to(here)
    return file.relative_to(here).as_posix() if is_below else file.name


def is_installed(path: Path) -> bool:
    """Return whether a path is of an installed package."""
    return bool({"site-packages", "dist-packages"} & {*path.parts})


def is_users_file(file: str) -> bool:
    """Return whether a file is of neither this package, the standard library nor an installed package."""
    return not (file.startswith(_KNOWN) or is_installed(Path(file)))


def _kept(time: float) -> str:
    """Return that a result is kept; "" before the first tick is over, when there is none."""
    return "; the result up to then is kept" if time > 0.0 else ""


class UserCodeError(CoopPinError, RuntimeError):
    """An exception (``cause``, and __cause__) in the user's ``function`` at ``time`` s, sys.exit included.

    ``file``, ``line`` and ``function``, such as "MyLaw.step", are those of ``place_of``.
    """

    def __init__(self, time: float, error: BaseException) -> None:
        self.time, self.cause = time, f"{type(error).__name__}: {error}"
        self.file, self.line, self.function = place_of(error)
        super().__init__(
            f"at t = {time:.6g} s {self.function} failed at {self.file}:{self.line}: {self.cause}"
            f"{_kept(time)}"
        )


class CommandError(CoopPinError, TypeError):
    """A command at ``time`` s by ``function`` of a law, at ``file`` and ``line``, with a ``problem``."""

    def __init__(self, time: float, step: Callable[..., Any], problem: str, remedy: str) -> None:
        self.time, self.problem = time, problem
        self.file, self.line, self.function = source_of(step)
        super().__init__(
            f"at t = {time:.6g} s {self.function} ({self.file}:{self.line}) returned {problem}; {remedy}"
        )


class DivergedError(CoopPinError, ArithmeticError):
    """A run that diverged at ``time`` s: ``quantity`` reached ``value``, above its ``limit``."""

    def __init__(self, time: float, quantity: str, value: float, limit: float) -> None:
        self.time, self.quantity, self.value, self.limit = time, quantity, value, limit
        remedy = "lower the gains or raise the control rate ('coop-pin check' shows how far)"
        if math.isnan(value):
            remedy = "a gain, a motion, a squeeze or an event is too large for floating-point numbers"
        super().__init__(
            f"the run diverged at t = {time:.6g} s: {quantity} reached {value:.3g} (limit {limit:.3g});"
            f" {remedy}{_kept(time)}"
        )


class RunInterruptedError(_Interrupt):
    """Ctrl-C at ``time`` s of a run; ``result`` is what is kept. Not caught by ``except Exception``."""

    def __init__(self, time: float, result: Any) -> None:
        self.time, self.result = time, result
        super().__init__(f"the run was interrupted at t = {time:.6g} s{_kept(time)}")


# ---------------------------------------------------------------- sweeps


class RunTimeoutError(CoopPinError, TimeoutError):
    """A run that took longer than its ``limit`` in s of wall time."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        super().__init__(
            f"the run took longer than its limit of {limit:g} s; raise time_limit_s, shorten the run"
            " or lower steps_per_tick"
        )


class WorkerDiedError(CoopPinError, RuntimeError):
    """A run whose worker died ``deaths`` times, last with exit ``code``: a crash, an exit, or no memory."""

    def __init__(self, deaths: int, code: int) -> None:
        self.deaths, self.code = deaths, code
        super().__init__(
            f"{deaths} workers died while running it, the last with exit code {code} (negative: killed by"
            " that signal); run it alone (workers = 0) to see why"
        )


class WorkersLostError(CoopPinError, ConnectionError):
    """All workers of a sweep, or its scheduler, are gone; finished runs are kept."""


class CodeRefusedError(CoopPinError, PermissionError):
    """Code ``name``, "module:name", that a scenario or a plan names and that is not to run here."""

    def __init__(self, name: str, detail: str) -> None:
        self.name = name
        super().__init__(f"{name!r} is code {detail}")


class CodeChangedError(CoopPinError, RuntimeError):
    """User code ``name`` ("module:function") whose ``files`` changed after its import, or between workers."""

    def __init__(self, name: str, files: Iterable[str | Path] = ()) -> None:
        self.name, self.files = name, tuple(shown(Path(file)) for file in files)
        super().__init__(
            f"{name} changed after its import ({', '.join(self.files) or 'here or in a worker'}); load it"
            " and the modules that import it again (importlib.reload), or restart the kernel or the workers;"
            " finished runs are kept"
        )


class StoreLockedError(CoopPinError, RuntimeError):
    """A sweep folder that another process, ``owner``, is using."""

    def __init__(self, folder: str, owner: str) -> None:
        self.owner = owner
        super().__init__(f"{folder} is in use by {owner}; wait until it ends, or choose another folder")


class NothingFeasibleError(CoopPinError, ValueError):
    """Tuning without a run within all bounds: ``tried`` and ``failed`` runs, kept in ``folder``."""

    def __init__(
        self, tried: int, failed: int, bounds: Sequence[str], folder: str, complaint: str = ""
    ) -> None:
        self.tried, self.failed, self.folder = tried, failed, folder
        condition = "satisfies " + ", ".join(bounds) if bounds else "has a finite metric"
        first = f"; the first that failed said: {complaint}" if complaint else ""
        super().__init__(
            f"none of {tried} runs ({failed} failed), kept in {folder}, {condition};"
            f" change the ranges, loosen the bounds or search longer{first}"
        )


class SweepInterruptedError(_Interrupt):
    """Ctrl-C with ``finished`` of ``total`` runs kept in ``folder``. Not caught by ``except Exception``."""

    def __init__(self, folder: str, finished: int, total: int) -> None:
        self.folder, self.finished, self.total = folder, finished, total
        super().__init__(
            f"interrupted with {finished} of {total} runs kept in {folder};"
            " run the same command again to continue"
        )


# ---------------------------------------------------------------- views


class BrowserError(CoopPinError, RuntimeError):
    """No headless browser (``browser`` is None), or one that renders no image; ``complaint`` says why."""

    def __init__(self, browser: str | None, complaint: str) -> None:
        self.browser, self.complaint = browser, complaint
        problem = f"{browser} rendered no image" if browser else "no browser to render images with was found"
        super().__init__(
            f"{problem}: {complaint}; run: playwright install chromium, or install Chromium or Chrome,"
            " or set the environment variable CHROMIUM to its path"
        )


class PortTakenError(CoopPinError, OSError):
    """A ``port`` that a live view cannot use, with the ``reason`` of the operating system."""

    def __init__(self, port: int, reason: str) -> None:
        self.port, self.reason = port, reason
        super().__init__(
            f"port {port} of 127.0.0.1 cannot be used ({reason}); choose another from 1024 to 65535,"
            " or 0 for any free one"
        )


# ---------------------------------------------------------------- warnings


class UrdfWarning(UserWarning):
    """Suspicious numbers in a robot description file, or a visual geometry of it that cannot be read."""


class ScenarioWarning(UserWarning):
    """A scenario that runs but will not work: drives too weak to hold the cell, gains unstable if sampled."""


class ViewWarning(UserWarning):
    """A 3-D view that cannot open or has stopped; the simulation continues without it."""
