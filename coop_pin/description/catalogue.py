"""The scenarios that come with coop_pin."""

from __future__ import annotations

from pathlib import Path

from coop_pin.errors import EntryNotFoundError

_FOLDER = Path(__file__).parent / "scenarios"


def scenario_names() -> list[str]:
    """Return the names of the shipped scenarios."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def scenario_path(name: str) -> Path:
    """Return the file of a shipped scenario.

    Raises:
        EntryNotFoundError: there is none of that name.
    """
    path = _FOLDER / f"{name}.toml"
    if name not in scenario_names():
        raise EntryNotFoundError("scenario", name, scenario_names(), "the catalogue")
    return path
