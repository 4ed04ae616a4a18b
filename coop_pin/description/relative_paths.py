"""Relative paths in a scenario's file: they are those of the file's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def anchor_files(data: dict[str, Any], folder: Path) -> None:
    """Make the paths of URDF, mesh and CSV files and of package folders in the scenario's folder absolute."""
    cell = _table(data.get("cell"))
    arms = [_table(arm) for arm in _table(cell.get("arms")).values()]
    payload, motion = _table(cell.get("payload")), _table(data.get("motion"))
    paths = [(arm, "urdf") for arm in arms] + [(payload, "path"), (payload, "mesh_file"), (motion, "path")]
    for table, field in paths:
        if table.get(field):
            table[field] = _anchored(folder, table[field])
    for table in (*arms, payload):
        if isinstance(table.get("package_dirs"), list):
            table["package_dirs"] = [_anchored(folder, entry) for entry in table["package_dirs"]]


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _anchored(folder: Path, path: Any) -> Any:
    """Return a path that exists in a folder as absolute, any other as it is.

    A URDF that exists nowhere becomes absolute as well, so that the error names the intended folder.
    """
    if not isinstance(path, str):
        return path
    if (folder / path).exists():
        return str((folder / path).resolve())
    is_missing_robot = path.endswith((".urdf", ".xacro")) and not Path(path).exists()
    return str((folder / path).absolute()) if is_missing_robot else path
