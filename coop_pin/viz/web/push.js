"use strict";
// A push by hand: a person drags the payload, an arrow shows the force, and it acts when they let go.
function coopPinPush(stage, labels, page, push) {
  if (!stage.viewer) { return; } // no WebGL
  const three = MeshCat.THREE, { viewer, node } = stage, { most, normal } = page.push, payload = node("payload");
  const pane = viewer.renderer.domElement, ray = new three.Raycaster(), plane = new three.Plane(), LEAST_PX = 5;
  const perMetre = most / 0.5, text = document.createElement("span"); // half a metre is the most
  const material = new three.MeshBasicMaterial({ color: page.colours.external, depthTest: false, transparent: true });
  const [shaft, head] = [new three.CylinderGeometry(0.007, 0.007, 1, 16), new three.ConeGeometry(0.022, 0.06, 20)].map((shape) => new three.Mesh(shape.rotateX(Math.PI / 2), material));
  const arrow = new three.Group().add(shaft, head), ahead = new three.Vector3(0, 0, 1);
  shaft.renderOrder = head.renderOrder = 30;
  arrow.visible = false;
  text.hidden = true;
  text.style.borderColor = page.colours.external;
  text.className = "push";
  viewer.scene.add(arrow);
  labels.append(text);
  let held = null; // the point in axes of the payload, where the pointer went down, and the force

  function aim({ clientX, clientY }) {
    const { left, top, width, height } = pane.getBoundingClientRect();
    ray.setFromCamera(new three.Vector2(2 * (clientX - left) / width - 1, 1 - 2 * (clientY - top) / height), viewer.camera);
    return [clientX - left, clientY - top];
  }
  function hit() {
    const solid = ({ object }) => object.isMesh && object.visible && object.material.opacity > 0.3;
    const behind = ray.intersectObject(viewer.scene, true).filter(solid)[0];
    const [first] = ray.intersectObject(payload, true).filter(solid);
    return first && behind.distance > first.distance - 0.06 ? first.point : null; // arrows and hands at it do not matter
  }
  function drag(event) {
    const [x, y] = aim(event), from = payload.localToWorld(held.point.clone()), to = new three.Vector3();
    if (!ray.ray.intersectPlane(plane, to)) { return; }
    const along = to.sub(from).clampLength(0, most / perMetre), length = along.length();
    held.force = along.clone().multiplyScalar(perMetre);
    arrow.visible = length > 1e-3;
    text.hidden = false;
    text.textContent = `push ${coopPinNumber(perMetre * length)} N: let go`;
    text.style.transform = `translate(${x + 14}px, ${y - 24}px)`;
    if (arrow.visible) {
      arrow.position.copy(from);
      arrow.quaternion.setFromUnitVectors(ahead, along.divideScalar(length));
      shaft.scale.z = Math.max(length - 0.06, 1e-4);
      shaft.position.z = shaft.scale.z / 2;
      head.position.z = length - 0.03;
    }
    viewer.set_dirty();
  }
  function end({ type, clientX, clientY }) {
    const far = held.force && Math.hypot(clientX - held.x, clientY - held.y) > LEAST_PX;
    if (far && type === "pointerup") { push(payload.localToWorld(held.point.clone()).toArray(), held.force.toArray()); }
    held = null;
    arrow.visible = false;
    text.hidden = true;
    viewer.set_dirty();
  }
  // Before the controls of the view get the event, which would turn it.
  pane.parentNode.addEventListener("pointerdown", (event) => {
    aim(event);
    const point = event.button === 0 ? hit() : null;
    if (!point) { return; }
    event.stopPropagation();
    pane.setPointerCapture(event.pointerId);
    held = { point: payload.worldToLocal(point.clone()), x: event.clientX, y: event.clientY, force: null };
    plane.setFromNormalAndCoplanarPoint(normal ? new three.Vector3(...normal) : viewer.camera.getWorldDirection(new three.Vector3()), point);
  }, true);
  let looked = 0;
  pane.addEventListener("pointermove", (event) => {
    if (held) { drag(event); return; }
    if (event.buttons || event.timeStamp - looked < 100) { return; } // looking for what is below the pointer takes its time
    looked = event.timeStamp;
    aim(event);
    pane.style.cursor = hit() ? "grab" : "";
  });
  for (const type of ["pointerup", "pointercancel"]) { pane.addEventListener(type, (event) => { if (held) { end(event); } }); }
}
