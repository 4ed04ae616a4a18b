"""Tables and images that studies write into the documentation; a table replaces the text of a block."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from coop_pin.figures import save_figure

IMAGES = Path(__file__).parent.parent / "docs" / "images"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = (header, ["---"] * len(header), *rows)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def with_block(page: str, name: str, text: str) -> str:
    """Return a page with the text between its two comments of a name.

    Raises:
        ValueError: the page does not have both comments once.
    """
    form = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(\n<!-- end of {re.escape(name)} -->)", re.DOTALL)
    page, count = form.subn(lambda block: f"{block[1]}\n{text}\n{block[2]}", page)
    if count != 1:
        raise ValueError(f"the page has {count} blocks named {name!r}; it must have one")
    return page


def save_image(figure: Figure, stem: Path) -> Path:
    """Save a figure as PNG, the only format in git, and return the file.

    Args:
        figure: any figure.
        stem: path of the file without its suffix.
    """
    (file,) = save_figure(figure, stem, formats=("png",))
    return file


def write_block(page: Path, name: str, text: str) -> None:
    """Replace a block of a page."""
    page.write_text(with_block(page.read_text(encoding="utf-8"), name, text), encoding="utf-8")
