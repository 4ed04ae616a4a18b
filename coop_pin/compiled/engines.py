"""Names of the engines that simulate runs."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

from coop_pin.base.errors import FieldError

Engine: TypeAlias = Literal["auto", "pinocchio", "compiled", "mujoco"]
"""What simulates a run: "pinocchio", one tree of arms and payload; "compiled", code of plant, sensors, law
and drives where all can be compiled, otherwise of the plant; "mujoco", MuJoCo's dynamics with soft welds, for
grasps that do not give; "auto" chooses between the first two by length and number of runs."""
Way: TypeAlias = Literal["pinocchio", "plant", "lanes", "mujoco"]
"""How a run is computed: on Pinocchio; on MuJoCo; by a compiled plant under an interpreted law; or by
compiled code of plant, sensors, law and drives, as one of the lanes of a program."""
FORMER = {"single": "pinocchio", "traced": "compiled", "batch": "compiled"}
"""Former names, which are answered with the present ones."""


def engine_named(word: Any, path: str = "") -> Any:
    """Return the engine of a name, the name itself.

    Args:
        word: name.
        path: field that has it.

    Raises:
        FieldError: there is no such engine; a former name is answered with the present one.
    """
    if str(word) in FORMER:
        raise FieldError(f"is {word!r}, whose runs are those of engine {FORMER[str(word)]!r}", path)
    if not isinstance(word, str) or word not in get_args(Engine):
        raise FieldError(f"is {word!r}; it must be one of {get_args(Engine)}", path)
    return word
