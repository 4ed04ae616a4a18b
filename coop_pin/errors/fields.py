"""Mistakes in what the user described, each at its field."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from typing import Any, Self

from coop_pin.errors.root import CoopPinError, rebuild


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
