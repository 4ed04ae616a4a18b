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
  const AIR = 0xe9edf2, three = MeshCat.THREE, { scales } = page, vector = (...xyz) => new three.Vector3(...xyz);
  // Other lights need other shader programs, which software compiles: nothing is drawn before the lights are there.
  const viewer = new MeshCat.Viewer(pane, false);
  viewer.renderer.domElement.setAttribute("role", "img");
  viewer.renderer.domElement.setAttribute("aria-label", "3-D view of the arms, the payload and the forces of the arms on it");
  viewer.gui.domElement.remove(); // a person needs none of meshcat's controls
  viewer.scene.rotation.set(0, 0, 0);
  for (const name of ["Lights", "Grid", "Axes"]) { viewer.scene_tree.find([name]).object.visible = false; }
  viewer.scene.background = new three.Color(AIR); // as the fog: no edge of the floor

  // ---------------------------------------------------------------- drawables
  const floats = coopPinFloats;
  const points = (values) => Array.from({ length: values.length / 3 }, (_, k) => vector().fromArray(values, 3 * k));
  const tube = (path, radius) => new three.TubeGeometry(new three.CatmullRomCurve3(path), path.length, radius, 8);
  const lines = (ends, color) => new three.LineSegments(new three.BufferGeometry().setFromPoints(ends), new three.MeshBasicMaterial({ color })); // as solids are: the same program
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
      drawn = new three.Group();
      ["#ff4d00", "#4dff00", "#004dff"].forEach((colour, k) => drawn.add(lines([vector(), vector().setComponent(k, size[0])], colour)));
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
  const steps = Array.from({ length: EDGE / GRID + 1 }, (_, k) => GRID * k - EDGE / 2), far = EDGE / 2;
  const grid = lines(steps.flatMap((at) => [vector(at, -far), vector(at, far), vector(-far, at), vector(far, at)]), colours.floor_lines);
  grid.position.set(x, y, first.scene.floor);
  viewer.scene.add(grid);

  const { arrows, struts, chooseWorst } = coopPinForces({ three, viewer, page, pane, labels, layers, inLayer, middle });

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
  viewer.scene.fog = new three.Fog(AIR, 2.2 * distance, 4.2 * distance);

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
  requestAnimationFrame(() => viewer.animate());

  function setLayer(name, on) {
    layers[name] = on;
    layered.filter(([of]) => of === name).forEach(([, object]) => { object.visible = on; });
    viewer.set_dirty();
  }
  view("reset");
  trail("desired", points(floats(first.desired)), "#9a9fa6", 0.004);
  return { viewer, node, arms: first.arms, tips, arrows, struts, layers, show, trail, travelled, view, setLayer };
}
