"""Traps of engines: ten lines each, with what comes and what is right."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent / "traps"


def output(file: Path) -> str:
    """Return what a trap prints; empty where its engine is not installed.

    Raises:
        RuntimeError: it failed in another way.
    """
    ran = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, check=False)
    if ran.returncode and "ModuleNotFoundError" not in ran.stderr:
        raise RuntimeError(ran.stderr)
    return "" if ran.returncode else ran.stdout


def markdown() -> str:
    """Return all traps for a page."""
    parts = []
    for file in sorted(FOLDER.glob("*.py")):
        source = file.read_text(encoding="utf-8")
        title = (ast.get_docstring(ast.parse(source)) or "").strip()
        code = source.partition('"""\n\n')[2].strip()
        shown = output(file).strip() or "not installed"
        parts.append(f"**{title}**\n\n```python\n{code}\n```\n\n```text\n{shown}\n```")
    return "\n\n".join(parts)
