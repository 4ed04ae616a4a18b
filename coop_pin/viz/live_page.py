"""The page of a live view."""

from __future__ import annotations

import html
from string import Template

from coop_pin.viz import palette
from coop_pin.viz.cell_scene import TRAIL_RADIUS_M, TRAIL_SPACING_M
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.meshcat_door import scene_messages
from coop_pin.viz.page_parts import LEGEND, PUSH, SATURATED, SINGULAR, arrow_note, as_text, common_parts, legend, page_file, script_json
from coop_pin.viz.tints import COLOURS

_MOST_TRAIL_POINTS = 1500


def live_html(title: str, scene: LiveScene, frame: bytes, still: str = "") -> str:
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
        "trail": {"colour": palette.ACTUAL, "radius": TRAIL_RADIUS_M, "spacing": TRAIL_SPACING_M, "most": _MOST_TRAIL_POINTS},
        "chart": {"actual": palette.ACTUAL, "desired": palette.DESIRED, "internal": palette.INTERNAL},
        "frame": as_text(frame),
        "still": still,
    }
    return Template(page_file("live.html")).substitute(
        common_parts(),
        title=html.escape(title),
        legend=legend((*LEGEND, PUSH, SATURATED, SINGULAR)),
        note=arrow_note(scene.newtons_per_metre),
        live=script_json(live),
        player=page_file("live.js"),
    )
