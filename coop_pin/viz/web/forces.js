"use strict";
// Arrows of forces and moments with their numbers, and struts of the virtual linkage, in the scene of stage.js.
function coopPinForces({ three, viewer, page, pane, labels, layers, inLayer, middle }) {
  const [first] = page.runs, { scales } = page, isCrowded = first.arms.length > 2, vector = (...xyz) => new three.Vector3(...xyz);

  // ---------------------------------------------------------------- arrows
  // Shape and colour tell the parts apart, in greyscale too: [shaft radius, head radius, pieces of the shaft].
  const HEAD = 0.05, STYLES = { internal: [0.008, 0.02, 1], wanted: [0.008, 0.02, 1], load: [0.0045, 0.014, 4], external: [0.011, 0.024, 2], across: [0.003, 0.011, 1] };
  function solid(colour, [radius, head, pieces], heads, grown, options) {
    const kind = options ? three.MeshBasicMaterial : three.MeshLambertMaterial;
    const material = new kind({ color: colour, transparent: true, depthTest: false, depthWrite: false, ...options });
    const part = (geometry) => new three.Mesh(geometry, material), shaft = new three.Group(), tip = new three.Group();
    for (let k = 0; k < pieces; k += 1) {
      const long = pieces === 1 ? 1 : 0.68 / pieces;
      shaft.add(part(new three.CylinderGeometry(radius + grown, radius + grown, long, 20).rotateX(Math.PI / 2).translate(0, 0, (k + 0.5) / pieces)));
    }
    for (let k = 0; k < heads; k += 1) {
      const cone = new three.ConeGeometry(head + 1.6 * grown, HEAD / heads + 3 * grown, 24).rotateX(Math.PI / 2);
      tip.add(part(cone.translate(0, 0, (k + 0.5) * HEAD / heads + 0.4 * grown)));
    }
    return { shaft, tip };
  }

  const drawnLength = (size, per) => coopPinLength(size, per, scales);
  // An outline: a grown solid, drawn where a hidden thinner one has not marked the stencil.
  const MARK = { colorWrite: false, stencilWrite: true, stencilRef: 1, stencilZPass: three.ReplaceStencilOp };
  const AROUND = { stencilWrite: true, stencilRef: 1, stencilFunc: three.NotEqualStencilFunc };

  const arrows = {};
  function makeArrow(group, arm, part) {
    const moment = group === "moments", shape = STYLES[part].map((size, k) => (moment && k < 2 ? 0.7 * size : size));
    const object = new three.Group(), heads = moment ? 2 : 1, wanted = part === "wanted";
    const colour = page.colours[part === "across" ? "internal" : part];
    const solids = wanted ? [solid(0, shape, heads, 0.001, MARK), solid(colour, shape, heads, 0.006, AROUND)] : [solid(colour, shape, heads, 0)];
    solids.forEach(({ shaft, tip }, k) => {
      object.add(shaft, tip);
      object.traverse((drawn) => { drawn.renderOrder = drawn.renderOrder || (wanted ? 20 + k : 10); });
    });
    viewer.scene.add(object);
    const per = scales[group], unit = moment ? "N m" : "N", name = `${group}/${arm}/${part}`, grasp = vector();
    const arrow = { name, part, value: vector(), length: 0, tip: vector(), outer: vector(), inner: vector(), object };
    const isExtra = isCrowded ? part !== "external" : ["wanted", "across"].includes(part); // told on hover, or where there is room
    arrow.text = labels.add({
      text: () => `${{ wanted: "wanted ", across: "by moments " }[part] ?? ""}${coopPinNumber(arrow.value.length())} ${unit}`,
      anchor: () => arrow.outer, away: () => arrow.inner, steady: () => grasp, ends: () => object.visible && [arrow.outer, arrow.inner],
      shown: (isAsked) => object.visible && (isAsked || (arrow.length >= 0.03 && !(isExtra && (isCrowded || pane.clientWidth < 500)))),
    }, colour, { internal: 2, external: 2, load: 3 }[part] ?? 4).span;
    // A force towards the other grasps ends at its own, one away from them starts there: no arrow crosses the payload.
    arrow.set = (end, inwards, x, y, z) => {
      grasp.copy(end);
      arrow.value.set(x, y, z);
      const size = arrow.value.length(), length = drawnLength(size, per);
      arrow.length = length;
      object.visible = length > 0.002 && layers[part] !== false && (!moment || layers.moments);
      const along = length > 0 ? arrow.value.clone().divideScalar(size) : vector(0, 0, 1);
      const pressed = three.MathUtils.smoothstep(along.dot(inwards), 0.25, 0.6); // in between it slides: none jumps while it turns
      object.position.copy(along).multiplyScalar(-pressed * length).add(grasp);
      object.quaternion.setFromUnitVectors(vector(0, 0, 1), along);
      for (const { shaft, tip } of solids) {
        shaft.scale.z = Math.max(length - HEAD, 1e-6);
        tip.position.z = Math.max(length - HEAD, 0);
        tip.scale.setScalar(Math.max(Math.min(length / HEAD, 1), 1e-6));
      }
      arrow.tip.copy(along).multiplyScalar(length).add(object.position);
      [arrow.outer, arrow.inner] = pressed > 0.5 ? [object.position, arrow.tip] : [arrow.tip, object.position];
    };
    arrows[name] = arrow;
  }
  for (const group of scales.moments === null ? ["forces"] : ["forces", "moments"]) {
    for (const arm of first.arms) { for (const part of ["load", "internal", "wanted"]) { makeArrow(group, arm, part); } }
    makeArrow(group, "payload", "external");
  }
  first.arms.forEach((arm) => makeArrow("forces", arm, "across"));

  // ---------------------------------------------------------------- virtual linkage
  // A strut between every two grasps: as thick as its tension is large, with an outline for the wanted one and a
  // ring with a head for its twist. Values are computed in Python (frames.py).
  const THICKNESS = 0.1, RING = 0.045, Z = vector(0, 0, 1);
  const struts = first.arms.flatMap((_, i) => first.arms.slice(i + 1).map((_, k) => makeStrut(i, i + 1 + k)));
  function makeStrut(i, j) {
    const object = new three.Group(), ring = new three.Group(), rods = {}, along = vector();
    const part = (geometry, order, options) => {
      const mesh = new three.Mesh(geometry, new three.MeshBasicMaterial({ transparent: true, depthTest: false, depthWrite: false, ...options }));
      mesh.renderOrder = order;
      return mesh;
    };
    const rod = new three.CylinderGeometry(1, 1, 1, 24).rotateX(Math.PI / 2).translate(0, 0, 0.5);
    for (const [order, [name, options]] of Object.entries({ edge: { color: 0xffffff }, core: {}, mark: MARK, around: { color: page.colours.wanted, ...AROUND } }).map((entry, k) => [[5, 6, 7, 8][k], entry])) {
      object.add(rods[name] = part(rod, order, options));
    }
    ring.add(part(new three.TorusGeometry(1, 0.1, 10, 40, 1.5 * Math.PI), 9, { color: page.colours.internal }));
    ring.add(part(new three.ConeGeometry(0.28, 0.6, 16).rotateZ(-Math.PI / 2).translate(0.25, -1, 0), 9, { color: page.colours.internal }));
    object.add(ring);
    inLayer("struts", object);
    viewer.scene.add(object);
    const strut = { name: `${first.arms[i]} to ${first.arms[j]}`, tension: 0, twist: 0, wanted: 0, radius: 0, middle: vector(), start: vector(), tip: vector(), object };
    const label = labels.add({
      text: () => strut.said(), anchor: () => strut.middle, away: () => strut.inwards(), steady: () => strut.middle,
      ends: () => object.visible && isLoaded() && [strut.start, strut.tip],
      shown: (isAsked) => object.visible && isLoaded() && (isAsked || !isCrowded || strut === worst),
    }, "", 1);
    const isLoaded = () => !isCrowded || strut.tension !== 0 || strut.wanted !== 0; // else an arm that holds nothing
    strut.text = label.span;
    // Labels stand outwards of the middle of several struts; else below a level one and beside a steep one.
    strut.inwards = () => (isCrowded ? middle : strut.middle.clone().add(Math.abs(along.z) < 0.7 ? vector(0, 0, 1) : vector(-1, 0, 0).applyQuaternion(viewer.camera.quaternion)));
    strut.set = (tips, [tension, twist, wanted, wantedTwist]) => {
      along.copy(tips[j]).sub(tips[i]);
      const length = along.length(), squeezed = (Math.abs(tension) < 0.05 ? wanted : tension) < 0;
      const [radius, outline] = [tension, wanted].map((newtons) => THICKNESS * drawnLength(Math.abs(newtons), scales.forces));
      Object.assign(strut, { tension, twist, wanted, radius });
      strut.start.copy(tips[i]);
      strut.tip.copy(tips[j]);
      strut.middle.copy(tips[i]).lerp(tips[j], 0.5);
      object.position.copy(tips[i]);
      object.quaternion.setFromUnitVectors(Z, along.normalize());
      for (const [name, wide] of Object.entries({ edge: radius + 0.005, core: radius, mark: outline, around: outline + 0.003 })) {
        rods[name].scale.set(wide, wide, length);
        rods[name].visible = name === "edge" || name === "core" ? radius > 1e-4 : outline > 1e-4;
      }
      rods.core.material.color.set(squeezed ? page.colours.squeezed : page.colours.torn);
      const turn = scales.moments === null ? 0 : drawnLength(Math.abs(twist), scales.moments) / scales.linear;
      ring.visible = turn > 0.1;
      ring.position.z = 0.7 * length; // as it turns the payload at the second grasp
      ring.scale.setScalar(RING * (0.6 + turn));
      ring.scale.x *= Math.sign(twist);
      Object.assign(strut, { wantedTwist, twisted: ring.visible });
      label.span.style.borderColor = squeezed ? page.colours.squeezed : page.colours.torn;
    };
    strut.said = () => {
      const { tension, twist, wanted, wantedTwist, twisted } = strut, squeezed = (Math.abs(tension) < 0.05 ? wanted : tension) < 0;
      const said = (newtons) => (Math.abs(newtons) < 0.05 ? "0 N" : `${newtons < 0 ? "squeezed" : "pulled apart"} ${coopPinNumber(Math.abs(newtons))} N`);
      const isMet = struts.length > 1 && Math.abs(tension - wanted) < 0.05 * Math.abs(wanted); // the outline tells: numbers of many struts are short
      return said(tension) + (isMet || Math.abs(wanted) < 0.05 ? "" : `\nwanted ${wanted < 0 === squeezed && Math.abs(tension) >= 0.05 ? coopPinNumber(Math.abs(wanted)) : said(wanted)}`)
        + (twisted ? `\ntwisted ${coopPinNumber(Math.abs(twist))} N m` + (Math.abs(wantedTwist) < 0.005 ? "" : `, wanted ${coopPinNumber(Math.abs(wantedTwist))}`) : "");
    };
    return strut;
  }

  // The strut that is farthest from what is wanted; another one has to be clearly worse.
  let worst = struts[0];
  function chooseWorst() {
    const error = ({ tension, wanted, object }) => (object.visible ? Math.abs(tension - wanted) + 1e-3 * Math.abs(tension) : -1);
    const other = struts.reduce((a, b) => (error(b) > error(a) ? b : a), worst);
    if (error(other) > 1.3 * error(worst) + 0.1) { worst = other; }
  }

  return { arrows, struts, chooseWorst };
}
