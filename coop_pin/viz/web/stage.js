"use strict";
// The 3-D scene of a page: drawables, arrows with numbers, layers and views. A frame is a row of numbers (frames.py).
function coopPinStage(pane, holder, page) {
  try {
    return coopPinScene(pane, holder, page);
  } catch (error) { // a remote desktop or virtual machine: the rest of the page needs no WebGL
    console.warn(error);
    const said = document.createElement("p"), nothing = () => {};
    said.className = "none";
    said.textContent = "No 3-D view: this browser has no WebGL. Plots and numbers need none.";
    pane.prepend(said);
    return { show: nothing, trail: nothing, travelled: nothing, view: nothing, setLayer: nothing, arrows: {} };
  }
}

function coopPinScene(pane, holder, page) {
  const three = MeshCat.THREE, { scales } = page, vector = (...xyz) => new three.Vector3(...xyz);
  const viewer = new MeshCat.Viewer(pane);
  viewer.renderer.domElement.setAttribute("role", "img");
  viewer.renderer.domElement.setAttribute("aria-label", "3-D view of the arms, the payload and the forces of the arms on it");
  viewer.gui.domElement.remove(); // a person needs none of meshcat's controls
  viewer.scene.rotation.set(0, 0, 0);
  for (const name of ["Lights", "Grid", "Axes"]) { viewer.scene_tree.find([name]).object.visible = false; }
  for (const end of ["top_color", "bottom_color"]) { viewer.set_property(["Background"], end, [0.914, 0.929, 0.949]); } // as the fog: no edge of the floor

  // ---------------------------------------------------------------- drawables
  const floats = coopPinFloats;
  const points = (values) => Array.from({ length: values.length / 3 }, (_, k) => vector().fromArray(values, 3 * k));
  const tube = (path, radius) => new three.TubeGeometry(new three.CatmullRomCurve3(path), path.length, radius, 8);
  const shapes = {
    box: ({ size }) => new three.BoxGeometry(...size),
    cylinder: ({ size: [radius, length] }) => new three.CylinderGeometry(radius, radius, length, 40).rotateX(Math.PI / 2),
    sphere: ({ size: [radius] }) => new three.SphereGeometry(radius, 32, 16),
    mesh: ({ mesh }) => meshes[mesh],
  };
  const nodes = {}, layers = { moments: false, wanted: false }, layered = [];
  function node(path) {
    if (!nodes[path]) { viewer.scene.add(nodes[path] = new three.Group()); }
    return nodes[path];
  }

  function inLayer(name, object) {
    if (name) { layered.push([name, object]); object.visible = layers[name] ??= true; }
    return object;
  }

  function draw(item) {
    const { kind, size } = item.drawable;
    // Software rendering pays for every fragment: no hidden sides of solids, light computed at vertices, the floor last.
    const options = { color: item.colour, opacity: item.opacity, side: kind === "mesh" ? three.DoubleSide : three.FrontSide };
    options.transparent = item.over || options.opacity < 1;
    Object.assign(options, item.over ? { depthTest: false, depthWrite: false } : {});
    let drawn;
    const geometry = () => shapes[kind](item.drawable);
    if (kind === "axes") {
      drawn = new three.AxesHelper(...size);
    } else if (item.lit) {
      const material = kind === "mesh" ? new three.MeshPhongMaterial({ ...options, flatShading: true, shininess: 18 }) : new three.MeshLambertMaterial(options);
      drawn = new three.Mesh(geometry(), material);
      drawn.castShadow = drawn.receiveShadow = true;
      drawn.renderOrder = /^floor/.test(item.node) ? 1 : 0;
    } else {
      drawn = new three.Mesh(geometry(), new three.MeshBasicMaterial(options));
      drawn.renderOrder = item.over ? 3 : 0;
    }
    drawn.applyMatrix4(new three.Matrix4().fromArray(item.pose));
    node(item.node).add(inLayer(item.layer, drawn));
  }

  const [first] = page.runs, isCrowded = first.arms.length > 2, labels = coopPinLabels(pane, holder, viewer);
  const tips = first.arms.map(() => vector()), middle = vector(), isFree = first.arms.map(() => false); // of the frame that is shown
  const meshes = first.scene.meshes.map(({ low, step, vertices, faces, bytes }) => {
    const positions = Float32Array.from(coopPinNumbers(vertices, Uint16Array), (value, k) => low[k % 3] + step[k % 3] * value);
    const geometry = new three.BufferGeometry().setAttribute("position", new three.BufferAttribute(positions, 3));
    return geometry.setIndex(new three.BufferAttribute(coopPinNumbers(faces, bytes === 2 ? Uint16Array : Uint32Array), 1));
  });
  first.scene.items.forEach(draw);
  // The floor: a slab below a grid of 0.25 m, and the grid in step with the world's axes.
  const GRID = 0.25, EDGE = 6, [x, y] = first.scene.camera.target.map((value) => GRID * Math.round(value / GRID)), { colours } = page;
  const slab = new three.Matrix4().makeTranslation(x, y, first.scene.floor - 0.006).elements;
  draw({ node: "floor", drawable: { kind: "box", size: [8 * EDGE, 8 * EDGE, 0.01] }, colour: colours.floor, pose: slab, opacity: 1, lit: true });
  const grid = new three.GridHelper(EDGE, EDGE / GRID, colours.floor_lines, colours.floor_lines).rotateX(Math.PI / 2);
  grid.position.set(x, y, first.scene.floor);
  viewer.scene.add(grid);

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
    strut.inwards = () => (isCrowded ? middle : strut.middle.clone().add(Math.abs(along.z) < 0.7 ? vector(0, 0, 1) : vector(-1, 0, 0).applyQuaternion(camera.quaternion)));
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

  // Names of two arms stand at their bases; of more, at their grasps, with the internal force of the arm.
  first.arms.forEach((arm, k) => {
    const platform = `arms/${arm}/base_yaw`; // of a mobile base: its position moves
    const base = first.nodes.includes(platform) ? node(platform).position : vector(...first.bases[k]), internal = arrows[`forces/${arm}/internal`];
    const size = () => internal.value.length(), isTold = () => internal.object.visible && !(isFree[k] && size() < 0.05);
    const force = () => (isFree[k] ? ", free" : "") + (isTold() ? ` ${coopPinNumber(size())} N` : "");
    labels.add(isCrowded
      ? { text: () => arm + force(), anchor: () => tips[k], away: () => middle, steady: () => tips[k], shown: () => true }
      : { text: () => arm, anchor: () => unhidden(base), away: () => base.clone().setZ(base.z - 1), steady: () => base, centred: true, shown: () => true }, first.arm_colours[k], 0);
  });

  const ray = new three.Raycaster();
  ray.params.Line.threshold = 0;
  function unhidden(base) { // above a base that the payload hides
    const at = base.clone(), isHidden = () => {
      ray.set(camera.position, at.clone().sub(camera.position).normalize());
      return ray.intersectObject(node("payload"), true).some(({ distance }) => distance < at.distanceTo(camera.position));
    };
    for (let k = 0; k < 12 && isHidden(); k += 1) { at.z += 0.1; }
    return at;
  }

  // ---------------------------------------------------------------- frames
  function blocksOf(run) {
    let start = 0;
    return Object.fromEntries(Object.entries(run.blocks).map(([name, size]) => [name, (start += size) - size]));
  }
  const warned = {}, FREE = 3; // its code, of frames.py
  function setWarning(path, code) {
    if ((warned[path] ?? 0) === code) { return; }
    warned[path] = code;
    node(path).visible = code < page.warning_colours.length; // else a contact that there is not
    if (!node(path).visible) { return; }
    node(path).traverse(({ material, userData }) => {
      if (!material) { return; }
      userData.own = userData.own ?? material.color.clone();
      material.color.copy(code === 0 ? userData.own : new three.Color(page.warning_colours[code]));
    });
  }

  // Poses are interpolated between two frames; wrenches are held, because they are constant between ticks.
  const turned = new three.Quaternion();
  function pose(at, from, to, share) {
    first.nodes.forEach((path, k) => {
      const target = node(path), c = at.poses + 7 * k;
      target.position.fromArray(from, c).lerp(vector().fromArray(to, c), share);
      target.quaternion.fromArray(from, c + 3).slerp(turned.fromArray(to, c + 3), share);
    });
  }
  const at = blocksOf(first);
  // Numbers of labels are written anew if it tells; labels glide to their places where a run plays, else they are there at once.
  function show(from, to, share, tells = true, glides = false) {
    const centre = vector(), nowhere = vector(), groups = scales.moments === null ? ["forces"] : ["forces", "moments"];
    pose(at, from, to, share);
    centre.fromArray(from, at.poses + 7 * first.nodes.indexOf("payload"));
    tips.forEach((tip, k) => tip.fromArray(from, at.tips + 3 * k));
    middle.copy(tips.reduce((sum, tip) => sum.add(tip), vector()).divideScalar(tips.length));
    groups.forEach((group, g) => {
      const wrench = (block, arm, sign) => [0, 1, 2].map((axis) => sign * from[at[block] + 6 * arm + 3 * g + axis]);
      first.arms.forEach((arm, k) => {
        // Frames hold the wrenches on the arms, as the equations do; drawn are those of the arms on the payload.
        const [whole, internal, wanted] = ["interaction", "internal", "wanted"].map((block) => wrench(block, k, -1)), tip = tips[k];
        const inwards = middle.clone().sub(tip).normalize(); // to the middle of the other grasps: the axial direction
        arrows[`${group}/${arm}/load`].set(tip, inwards, ...whole.map((value, axis) => value - internal[axis]));
        arrows[`${group}/${arm}/internal`].set(tip, inwards, ...internal);
        arrows[`${group}/${arm}/wanted`].set(tip, inwards, ...wanted);
      });
      arrows[`${group}/payload/external`].set(nodes.hand?.visible ? nodes.hand.position : centre, nowhere, ...wrench("external", 0, 1));
    });
    const strutValues = (k, wanted) => [0, 1].map((part) => from[at.struts + 2 * (k + wanted * struts.length) + part]);
    struts.forEach((strut, k) => strut.set(tips, [...strutValues(k, 0), ...strutValues(k, 1)]));
    first.arms.forEach((arm, k) => arrows[`forces/${arm}/across`].set(tips[k], nowhere, ...[0, 1, 2].map((axis) => -from[at.across + 3 * k + axis])));
    first.nodes.slice(0, -2).forEach((path, k) => setWarning(path, from[at.warnings + k]));
    first.arms.forEach((arm, k) => { isFree[k] = from[at.warnings + first.nodes.findIndex((path) => path.startsWith(`arms/${arm}/`))] === FREE; });
    follow();
    isStill = !glides;
    if (tells) { chooseWorst(); labels.tell(); }
    viewer.set_dirty();
  }

  const trails = {};
  const travelled = (rows) => {
    const from = at.poses + 7 * first.nodes.indexOf("payload"), step = Math.max(Math.floor(rows.length / 240), 1);
    return rows.filter((_, k) => k % step === 0).map((row) => vector().fromArray(row, from));
  };
  function trail(name, all, colour, radius) {
    const path = [];
    for (const point of all) {
      if (!path.length || path[path.length - 1].distanceTo(point) > 0.003) { path.push(point); }
    }
    if (path.length < 2) { return; }
    if (!trails[name]) { viewer.scene.add(trails[name] = inLayer(name, new three.Mesh(undefined, new three.MeshBasicMaterial({ color: colour })))); }
    trails[name].geometry.dispose();
    trails[name].geometry = tube(path, radius);
  }

  // ---------------------------------------------------------------- light, camera, views
  const { eye, target, field_of_view: field, follows } = first.scene.camera, camera = new three.PerspectiveCamera(field, 1, 0.02, 60);
  const home = vector(...eye).sub(vector(...target)), distance = home.length(), SUN = vector(-1, -1.4, 3.2);
  camera.up.set(0, 0, 1);
  viewer.controls.dispose();
  viewer.set_camera(camera);
  const sun = new three.DirectionalLight(0xffffff, 0.46);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, { left: -1.8, right: 1.8, top: 1.8, bottom: -1.8, near: 0.1, far: 9 });
  sun.shadow.bias = -0.001;
  sun.shadow.normalBias = 0.012;
  const soft = new three.DirectionalLight(0xffffff, 0.16);
  soft.position.copy(home);
  viewer.scene.add(sun, sun.target, soft, new three.HemisphereLight(0xffffff, 0xd5dae2, 0.48));
  viewer.scene.fog = new three.Fog(0xe9edf2, 2.2 * distance, 4.2 * distance);

  // A payload that travels far is followed from the start: framed is the instant at which it is where the camera goes with it.
  let followed = null;
  function follow() {
    if (followed === null) { return; }
    const way = node("payload").position.clone().sub(followed);
    for (const point of [camera.position, viewer.controls.target, sun.position, sun.target.position]) { point.add(way); }
    followed.add(way);
  }
  const directions = { reset: () => home, top: () => vector(0, -1e-3, 1.25 * distance), side: () => vector(home.x, home.y, 0).setLength(distance) };
  function view(name) {
    followed = name === "follow" ? node("payload").position.clone() : follows ? vector(...follows) : null;
    const centre = name === "follow" ? followed : vector(...target);
    viewer.controls.target.copy(centre);
    camera.position.copy(centre).add(name === "follow" ? home.clone().multiplyScalar(0.7) : directions[name]());
    sun.target.position.copy(centre);
    sun.position.copy(centre).add(SUN);
    follow();
    viewer.set_dirty();
  }

  let shownSize = "", isStill = true;
  viewer.set_3d_pane_size = () => {
    const { clientWidth: width, clientHeight: height } = pane;
    if (!width || !height || shownSize === `${width} ${height}`) { return; }
    shownSize = `${width} ${height}`;
    camera.aspect = width / height;
    const half = Math.tan(field * Math.PI / 360) / Math.min(camera.aspect / 1.4, 1);
    camera.fov = 360 / Math.PI * Math.atan(half); // a narrow window shows as much as one of 7 to 5
    viewer.renderer.setSize(width, height);
    viewer.set_dirty();
  };
  new ResizeObserver(viewer.set_3d_pane_size).observe(pane);
  const render = viewer.render.bind(viewer);
  viewer.render = () => { render(); labels.place(isStill); };

  function setLayer(name, on) {
    layers[name] = on;
    layered.filter(([of]) => of === name).forEach(([, object]) => { object.visible = on; });
    viewer.set_dirty();
  }
  view("reset");
  trail("desired", points(floats(first.desired)), "#9a9fa6", 0.004);
  return { viewer, node, arms: first.arms, tips, arrows, struts, layers, show, trail, travelled, view, setLayer };
}
