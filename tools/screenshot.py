"""Save an image of a replay page at a given time, drawn by a headless browser with the network off.

    python tools/screenshot.py out/replay.html image.png --time 6

``coop-pin view RESULT --image FILE.png --time T`` does the same from a result.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from coop_pin.viz.export import HEIGHT, WIDTH, page_images


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("replay", type=Path)
    parser.add_argument("image", type=Path)
    parser.add_argument("--time", type=float, default=6.0)
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--height", type=int, default=HEIGHT)
    options = parser.parse_args()
    (image,) = page_images(
        options.replay.read_text(encoding="utf-8"), [options.time], options.width, options.height
    )
    options.image.parent.mkdir(parents=True, exist_ok=True)
    options.image.write_bytes(image)


if __name__ == "__main__":
    main()
