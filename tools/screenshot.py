"""Take a picture of a replay page at a given time, in a headless browser with the network off.

    python tools/screenshot.py out/replay.html picture.png --time 6

Of a result, ``coop-pin view RESULT --image FILE.png --time T`` does the same. The README's picture is made
so:

    coop-pin run adept-paper --out out
    coop-pin view out --image docs/images/adept-paper.png --time 0.1
"""

from __future__ import annotations

import argparse
from pathlib import Path

from coop_pin.viz.export import HEIGHT, WIDTH, page_pictures


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("replay", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--time", type=float, default=6.0)
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--height", type=int, default=HEIGHT)
    given = parser.parse_args()
    (picture,) = page_pictures(
        given.replay.read_text(encoding="utf-8"), [given.time], given.width, given.height
    )
    given.picture.parent.mkdir(parents=True, exist_ok=True)
    given.picture.write_bytes(picture)


if __name__ == "__main__":
    main()
