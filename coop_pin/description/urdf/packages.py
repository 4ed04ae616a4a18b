"""ROS packages: folders with a package.xml, by the name that it states."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from coop_pin.base.errors import FileReadError
from coop_pin.base.user_files import head_of_user_file

_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_LARGEST = 1_000_000


def packages(folders: Sequence[Path]) -> Iterator[tuple[str, Path]]:
    """Yield name and folder of the packages that some folders are, or that lie directly in them.

    A package has the name of its package.xml, and that of its folder.

    Args:
        folders: searched in this order.
    """
    for folder in folders:
        for file in (folder / "package.xml", *sorted(folder.glob("*/package.xml"))):
            if file.is_file():
                yield _name(file), file.parent
                yield file.parent.name, file.parent


def _name(file: Path) -> str:
    """Return the name in a package.xml; that of its folder if there is none."""
    try:
        head, _ = head_of_user_file(file, limit=_LARGEST, kind="a package.xml")
    except FileReadError:
        head = b""
    match = _NAME.search(head)
    return match[1].decode("utf-8", "replace") if match else file.parent.name
