"""Expansion of xacro files, which read no file outside their packages and no environment variable."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from coop_pin import limited_process
from coop_pin.description.urdf.find import UrdfFile
from coop_pin.description.urdf.xml import MAX_BYTES
from coop_pin.errors import MissingExtraError, UrdfError

_SCRIPT = Path(__file__).with_name("xacro_process.py")
_CPU_S, _MEMORY = 3, 2**30
"""Limits of an expansion: processor time, s, and memory, bytes; a robot takes a tenth of a second."""
_PATIENCE_S = 60.0


def expanded(urdf: UrdfFile) -> bytes:
    """Return the URDF of a xacro file, UTF-8.

    xacro evaluates Python expressions, in a process of its own with limits of time and memory. The files that
    it reads (includes, YAML) must lie in the file's folder or in a package that ``$(find ...)`` finds;
    environment variables count as not set. Packages are searched in the file's package folders and above the
    file.

    Raises:
        MissingExtraError: xacrodoc is not installed.
        UrdfError: the file cannot be expanded, or not within the limits.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        raise MissingExtraError("xacrodoc", "xacro", f"to read {urdf.path.name}")
    packages = [path.parent for folder in urdf.package_dirs for path in sorted(folder.glob("*/package.xml"))]
    above = [folder for folder in urdf.path.parents if (folder / "package.xml").is_file()]
    order = {
        "path": str(urdf.path),
        "packages": {folder.name: str(folder) for folder in packages},
        "roots": list(map(str, (urdf.path.parent, *above, *packages))),
        "arguments": dict(urdf.xacro_args),
        "largest": MAX_BYTES,
    }
    code, said = limited_process.ask(_SCRIPT, order, cpu_s=_CPU_S, memory=_MEMORY, patience_s=_PATIENCE_S)
    if code == 0:
        return said
    reason = f"it takes more than {_CPU_S} s or {_MEMORY / 1e9:.2g} GB; look for a macro that calls itself"
    if code == limited_process.REFUSED:
        advice = "check its arguments (xacro_args) and packages (package_dirs)"
        reason = f"{said.decode(errors='replace')}; {advice}"
    raise UrdfError(f"{urdf.path} cannot be expanded: {reason}")
