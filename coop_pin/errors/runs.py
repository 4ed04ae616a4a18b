"""Runs that end early; what was computed up to then is kept."""

from __future__ import annotations

from typing import Any

from coop_pin.errors.root import CoopPinError


class UserCodeError(CoopPinError, RuntimeError):
    """A controller, motion or squeeze of the user's own raised; its exception is the cause of this one.

    Attributes:
        time: time of the tick, s.
        cause: type and message of the exception.
    """

    def __init__(self, time: float, error: Exception) -> None:
        self.time, self.cause = time, f"{type(error).__name__}: {error}"
        super().__init__(f"at t = {time:.6g} s a controller, motion or squeeze raised {self.cause}; the result up to then is kept")


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
        super().__init__(f"the run has come to its end at t = {end:.6g} s; make a new Simulation, or give the scenario a longer duration")


class ResultFileError(CoopPinError, ValueError):
    """A file is not a result of coop_pin, or is damaged."""
