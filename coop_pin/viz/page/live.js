"use strict";
// Shows frames as they arrive at a WebSocket; a still image shows the frame in the page.
(() => {
  const live = JSON.parse(document.getElementById("data").textContent);
  const stage = coopPinStage(document.getElementById("meshcat-pane"), live.messages, live.warning_colours);
  const { viewer } = stage, three = MeshCat.THREE;
  const element = (id) => document.getElementById(id);
  const nodes = live.nodes.map(stage.node), warnings = live.bodies.map(() => 0);
  const WINDOW_S = 10, REDRAW_MS = 200;
  let samples = [], path = [], drawnPath = 0, drawnAt = 0, count = 0, shown = null;

  const trailMaterial = new three.MeshBasicMaterial({ color: live.trail.colour });
  const trail = new three.Mesh(new three.BufferGeometry(), trailMaterial);
  trail.frustumCulled = false;
  viewer.scene_tree.find(["meshcat", "trails"]).object.add(trail);

  // A frame: the length of a JSON text, the text, and position, quaternion, scale of every node.
  function show(bytes) {
    const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    const rows = new Float32Array(bytes.slice(4 + length).buffer);
    nodes.forEach((node, index) => {
      const row = rows.subarray(10 * index, 10 * index + 10);
      node.position.fromArray(row, 0);
      node.quaternion.fromArray(row, 3);
      node.scale.fromArray(row, 7);
    });
    header.warnings.forEach((code, index) => {
      if (code !== warnings[index]) { stage.setWarning(live.bodies[index], code); warnings[index] = code; }
    });
    if (shown !== null && header.time < shown.time) { restart(); }
    samples.push(header);
    while (samples[0].time < header.time - WINDOW_S) { samples.shift(); }
    extendTrail(stage.node("payload").position);
    shown = header;
    count += 1;
    element("clock").textContent = `t = ${header.time.toFixed(2)} s`;
    viewer.set_dirty();
  }

  function restart() {
    samples = [];
    path = [];
    drawnPath = 0;
    trail.geometry.dispose();
    trail.geometry = new three.BufferGeometry();
  }

  function extendTrail(position) {
    const last = path[path.length - 1];
    if (last === undefined || last.distanceTo(position) >= live.trail.spacing) { path.push(position.clone()); }
    if (path.length > live.trail.max_points) { path = path.filter((_, index) => index % 2 === 0); }
  }

  function drawTrail() {
    if (path.length < 2 || path.length === drawnPath) { return; }
    drawnPath = path.length;
    trail.geometry.dispose();
    trail.geometry = new three.TubeGeometry(new three.CatmullRomCurve3(path), path.length, live.trail.radius, 6);
    viewer.set_dirty();
  }

  function chart(id, lines) {
    const canvas = element(id), scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = width * scale;
    canvas.height = height * scale;
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const end = samples[samples.length - 1].time, start = Math.max(end - WINDOW_S, samples[0].time);
    const most = Math.max(...lines.flatMap((line) => samples.map(line.value)), 1e-9);
    const power = 10 ** Math.floor(Math.log10(most));
    const top = [1, 2, 5, 10].find((step) => step * power >= most) * power;
    const left = 34, bottom = 14;
    const x = (time) => left + (width - left - 4) * (time - start) / Math.max(end - start, 1e-9);
    const y = (value) => height - bottom - (height - bottom - 6) * value / top;
    pen.font = "10px system-ui, sans-serif";
    pen.fillStyle = "#52606d";
    pen.strokeStyle = "#c9d1da";
    pen.textAlign = "right";
    for (const tick of [0, top / 2, top]) {
      pen.beginPath(); pen.moveTo(left, y(tick)); pen.lineTo(width - 4, y(tick)); pen.stroke();
      pen.fillText(Number(tick.toPrecision(3)), left - 4, y(tick) + 3);
    }
    pen.fillText(`${end.toFixed(1)} s`, width - 4, height - 2);
    pen.textAlign = "left";
    pen.fillText(`${start.toFixed(1)} s`, left, height - 2);
    for (const line of lines) {
      pen.strokeStyle = line.colour;
      pen.lineWidth = 1.6;
      pen.setLineDash(line.dash);
      pen.beginPath();
      samples.forEach((sample, index) => pen[index ? "lineTo" : "moveTo"](x(sample.time), y(line.value(sample))));
      pen.stroke();
    }
  }

  function redraw(now) {
    requestAnimationFrame(redraw);
    if (now - drawnAt < REDRAW_MS || samples.length === 0) { return; }
    drawnAt = now;
    drawTrail();
    const error = (sample) => 1000 * sample.position_error;
    chart("error", [{ value: error, colour: live.chart.actual, dash: [] }]);
    const measured = (sample) => sample.measured_internal ?? sample.internal;
    const hasMeasured = shown.measured_internal !== null;
    chart("force", [
      ...(hasMeasured ? [{ value: measured, colour: live.chart.measured, dash: [] }] : []),
      { value: (sample) => sample.desired_internal, colour: live.chart.desired, dash: [4, 3] },
      { value: (sample) => sample.internal, colour: live.chart.internal, dash: [] },
    ]);
    element("error-now").textContent = error(shown).toPrecision(3);
    element("force-now").textContent = `${shown.internal.toPrecision(3)} of ${shown.desired_internal.toPrecision(3)}`
      + (hasMeasured ? `, measured ${measured(shown).toPrecision(3)}` : "");
  }

  function connect() {
    const address = new URL("frames", location.href);
    address.protocol = address.protocol.replace("http", "ws");
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { element("status").textContent = "live"; };
    socket.onmessage = (message) => show(new Uint8Array(message.data));
    socket.onclose = () => {
      element("status").textContent = "no connection: the run or its notebook has ended";
      setTimeout(connect, 2000);
    };
  }

  window.coopPin = {
    viewer, node: stage.node, nodes: live.nodes,
    get count() { return count; }, get shown() { return shown; }, get samples() { return samples; },
  };
  show(stage.bytes(live.frame));
  samples = []; // the charts start with the run
  if (live.still) { element("status").textContent = live.still; } else { connect(); }
  requestAnimationFrame(redraw);
})();
