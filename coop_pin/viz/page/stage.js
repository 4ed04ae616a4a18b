"use strict";
// Shared by replay and live page: the viewer with its scene and lights, and the warning colours.
function coopPinStage(pane, messages, warningColours) {
  const viewer = new MeshCat.Viewer(pane);
  const node = (path) => viewer.scene_tree.find(["meshcat", ...path.split("/")]).object;

  function light() {
    viewer.set_property(["Grid"], "visible", false);
    viewer.set_property(["Axes"], "visible", false);
    viewer.set_property(["Background"], "top_color", [1, 1, 1]);
    viewer.set_property(["Background"], "bottom_color", [0.87, 0.9, 0.94]);
    const lamp = ["Lights", "SpotLight"];
    viewer.set_property(lamp, "visible", true);
    viewer.set_property(lamp.concat("<object>"), "castShadow", true);
    viewer.set_property(lamp.concat("<object>"), "position", [-1.0, -1.4, 3.4]);
    const shadow = viewer.scene_tree.find(lamp.concat("<object>")).object.shadow;
    shadow.mapSize.set(2048, 2048);
    shadow.bias = -0.0008;
    shadow.normalBias = 0.012;
    const strengths = { AmbientLight: 0.52, FillLight: 0.12, PointLightNegativeX: 0.12, PointLightPositiveX: 0.12, SpotLight: 0.42 };
    for (const [name, strength] of Object.entries(strengths)) {
      viewer.set_property(["Lights", name, "<object>"], "intensity", strength);
    }
  }

  // The floor fades into the background before the end of the spot light's cone.
  function haze() {
    const distance = viewer.camera.getWorldPosition(new MeshCat.THREE.Vector3()).length();
    viewer.scene.fog = new MeshCat.THREE.Fog(0xe9edf2, 1.15 * distance, 2.1 * distance);
  }

  // Give a body the warning colour of a code; 0 is its own colour.
  function setWarning(path, code) {
    node(path).traverse((part) => {
      if (!part.material || !part.material.color) { return; }
      if (!part.userData.own) { part.userData.own = part.material.color.clone(); }
      if (code === 0) { part.material.color.copy(part.userData.own); } else { part.material.color.setRGB(...warningColours[code]); }
    });
    viewer.set_dirty();
  }

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  for (const message of messages) { viewer.handle_command_bytearray(bytes(message)); }
  light();
  haze();
  return { viewer, node, setWarning, bytes };
}
