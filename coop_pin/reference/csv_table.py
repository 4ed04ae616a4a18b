"""Tables of numbers in CSV files with a header."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FileReadError, suggestion
from coop_pin.base.user_files import read_user_file

_MAX_BYTES = 50_000_000
"""Half a million rows."""


def read_table(
    path: str, known: Callable[[Sequence[str]], Sequence[str]]
) -> tuple[tuple[str, ...], list[int], Array]:
    """Return the columns' names, the line number of each row, and the rows, shape (n, number of columns).

    Args:
        path: a CSV file with a header.
        known: function from the names in the header to those of a table of this kind.

    Raises:
        FileReadError: the file cannot be read, a column is missing, unknown or there twice, or a number is
            none; it carries the line.
    """
    try:
        text = read_user_file(path, limit=_MAX_BYTES, kind="a table").decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""))
        columns = _header(path, next(reader, []), known)
        cells = [(reader.line_num, row) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileReadError(f"cannot be read as a table: {error}", path) from error
    if len(cells) < 2:
        raise FileReadError(f"has {len(cells)} rows of numbers; a motion needs at least 2", path)
    numbers = np.array([_numbers(path, line, columns, row) for line, row in cells])
    return columns, [line for line, _ in cells], numbers


def _header(
    path: str, cells: Sequence[str], known_of: Callable[[Sequence[str]], Sequence[str]]
) -> tuple[str, ...]:
    """Return the columns' names, checked."""
    columns = tuple(cell.strip() for cell in cells)
    known = known_of(columns)
    if missing := ", ".join(name for name in known if name not in columns):
        raise FileReadError(f"columns missing: {missing}; needed: {', '.join(known)}", path, 1)
    for index, name in enumerate(columns):
        if name not in known:
            raise FileReadError(f"unknown column {name!r}; {suggestion(name, known)}", path, 1)
        if name in columns[:index]:
            raise FileReadError(f"column {name!r} is given twice; keep one", path, 1)
    return columns


def _numbers(path: str, line: int, columns: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return the numbers of one line, checked."""
    if len(cells) != len(columns):
        raise FileReadError(f"has {len(cells)} cells; the header has {len(columns)}", path, line)
    return [_number(path, line, *cell) for cell in zip(columns, cells, strict=True)]


def _number(path: str, line: int, name: str, cell: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise FileReadError(f"{name} is {cell!r}; it must be a finite number", path, line)
    return number
