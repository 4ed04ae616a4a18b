"""Memory of a user's law outside its state, which a run that returns to an earlier tick brings back."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from coop_pin.control.controller import CellController
from coop_pin.control.hidden_state import (
    Contents,
    changes,
    names_random_numbers,
    of_kind,
    random_numbers,
    users_kinds,
    users_laws,
)


class LawMemory(NamedTuple):
    """What the objects of users' laws hold besides the state of a run.

    Attributes:
        attributes: copies of the attributes of each object.
        kept: names of the attributes that cannot be copied.
        shared: attributes of classes and modules, which belong to all runs.
    """

    attributes: tuple[dict[str, Any], ...]
    kept: tuple[str, ...]
    shared: Contents

    @classmethod
    def of(cls, controller: CellController) -> LawMemory | None:
        """Return the memory of a controller; None of the package's laws, which have none."""
        laws = [*users_laws("cell", controller)]
        if not laws:
            return None
        attributes, kept = [], []
        for owner, law in laws:
            copies, failed = _copies(vars(law))
            attributes.append(copies)
            kept += [f"its attribute {name!r} ({owner})" for name in failed]
        kinds = dict.fromkeys(kind for _, law in laws for kind in users_kinds(type(law)))
        shared = {name: part for kind in kinds for name, part in of_kind(kind).items()}
        shared |= random_numbers() if any(map(names_random_numbers, kinds)) else {}
        return cls(tuple(attributes), tuple(kept), shared)

    def restore(self, controller: CellController) -> list[str]:
        """Bring back the attributes of a controller, arrays in place; return what cannot be brought back."""
        for (_, law), kept in zip(users_laws("cell", controller), self.attributes, strict=True):
            values, now = _copies(kept)[0], vars(law)
            for name in now.keys() - kept.keys():
                del now[name]
            for name, value in values.items():
                if isinstance(array := now.get(name), np.ndarray) and _is_like(array, value):
                    array[...] = value
                else:
                    now[name] = value
        after = LawMemory.of(controller)
        return [*self.kept, *changes(self.shared, after.shared if after else {})]


def _is_like(array: np.ndarray[Any, Any], value: Any) -> bool:
    is_array = isinstance(value, np.ndarray) and array.flags.writeable
    return is_array and (array.shape, array.dtype) == (value.shape, value.dtype)


def _copies(attributes: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return copies of attributes, which share what they shared, and the names of those that have none."""
    memo, copies, failed = dict[int, Any](), dict[str, Any](), list[str]()
    for value in attributes.values():
        if type(value).__module__.partition(".")[0] in ("coop_pin", "pinocchio"):  # frozen, or scratch
            memo[id(value)] = value
    for name, value in attributes.items():
        try:
            copies[name] = copy.deepcopy(value, memo)
        except Exception:  # of any class
            copies[name] = value
            failed.append(name)
    return copies, failed
