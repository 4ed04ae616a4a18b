"""Catalogue: the scenarios that come with coop_pin, as files and tables, not checked by any class."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from coop_pin.base.user_files import read_toml

_FOLDER = Path(__file__).parent / "scenarios"


def scenario_names() -> list[str]:
    """Return the names of the scenarios in the catalogue."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def scenario_file(name: str) -> Path:
    """Return the file of a scenario in the catalogue."""
    return _FOLDER / f"{name}.toml"


def scenario_tables() -> list[dict[str, Any]]:
    """Return the tables of all scenarios in the catalogue, as their files have them."""
    return [read_toml(scenario_file(name), kind="a scenario") for name in scenario_names()]


def name_by_summary(text: str) -> str | None:
    """Return the name of the scenario with whose summary a text begins, or None."""
    tables = zip(scenario_names(), scenario_tables(), strict=True)
    return next((name for name, table in tables if text.startswith(table["summary"])), None)
