"""Values handed to a function that it cannot take."""

from __future__ import annotations

from coop_pin.errors.root import CoopPinError


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
        super().__init__(f"{name}[{index}] is {value:.6g} after {previous:.6g}; times must increase strictly: sort them, drop repeats")


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
