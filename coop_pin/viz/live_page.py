"""The page of a live view."""

from __future__ import annotations

from coop_pin.figures import palette
from coop_pin.viz.cell_scene import TRAIL_RADIUS_M, TRAIL_SPACING_M
from coop_pin.viz.live_frame import LiveFrame
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.meshcat_commands import scene_messages
from coop_pin.viz.page import LEGEND, PUSH, SATURATED, SINGULAR, as_text, page_html
from coop_pin.viz.tints import COLOURS
from coop_pin.viz.trail import MOST_POINTS


def live_html(title: str, scene: LiveScene, frame: LiveFrame, still: str = "") -> str:
    """Return the page: it draws the scene, shows one frame, and waits for more at the address it came from.

    Args:
        title: its heading.
        scene: what it shows.
        frame: what it shows first.
        still: of a page that waits for nothing, and needs no network: why.
    """
    live = {
        "messages": [as_text(message) for message in scene_messages(scene.scene)],
        "nodes": scene.nodes,
        "bodies": scene.bodies,
        "colours": COLOURS,
        "trail": {"colour": palette.ACTUAL, "radius": TRAIL_RADIUS_M, "spacing": TRAIL_SPACING_M, "most": MOST_POINTS},
        "chart": {"actual": palette.ACTUAL, "desired": palette.DESIRED, "internal": palette.INTERNAL},
        "frame": as_text(frame.packed()),
        "still": still,
    }
    return page_html("live", title, "", (*LEGEND, PUSH, SATURATED, SINGULAR), scene.scales, live)
