"""Digits of internal force and moment of several engines on cases that have a closed form.

Usage: coop-pin conform [--engine NAME ...] [--case TEXT ...] [--page FILE]
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import traps
from cases import all_cases
from engine import HERE
from table import columns, markdown, text, with_block


def main() -> int:
    """Print the table, and write it into a page; 1 if an engine failed."""
    parser = argparse.ArgumentParser(
        prog="coop-pin conform", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--engine",
        nargs="+",
        default=[],
        help="names of files in engines/ without .py, files or folders of your own, or module:Class; all of"
        " engines/ when omitted",
    )
    parser.add_argument("--case", nargs="+", default=[], help="words of cases; all when omitted")
    parser.add_argument("--page", type=Path, help="page of which the block 'conform' or 'traps' is replaced")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")  # of readers of URDF: the inner links of guides have no mass
    cases = [case for case in all_cases() if all(word in case.label for word in asked.case)]
    if not cases:
        parser.error(f"no case has the words {asked.case}")
    table = columns(asked.engine or [str(HERE)], cases)
    print(text(table, cases))
    if asked.page:
        page = asked.page.read_text(encoding="utf-8")
        blocks = {"conform": markdown(table, cases), "traps": traps.markdown()}
        for name in [name for name in blocks if f"<!-- {name} -->" in page] or blocks:
            page = with_block(page, name, blocks[name])
        asked.page.write_text(page, encoding="utf-8")
    return int(any(column.failures for column in table))


if __name__ == "__main__":
    sys.exit(main())
