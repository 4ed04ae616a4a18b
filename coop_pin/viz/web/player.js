"use strict";
// One clock for 3-D view, plots and tiles. A recorded run is played; of a run under way frames arrive at a WebSocket or from a notebook.
(() => {
  const page = JSON.parse(document.getElementById("data").textContent), element = (id) => document.getElementById(id);
  const stage = coopPinStage(element("pane"), element("labels"), page), REDRAW_MS = 200, STILL_MS = 300, PLAYED = 0.09, PAPER = [703, 363], PAPER_PANE = [340, 300], MOST_FRAMES = 20000;
  const [play, slider, clock, speed, notice, status] = ["play", "time", "clock", "speed", "event", "status"].map(element);
  const told = document.querySelectorAll(".told");
  const split = (flat, size) => Array.from({ length: flat.length / size }, (_, k) => flat.subarray(size * k, size * (k + 1)));
  const width = (run) => Object.values(run.blocks).reduce((sum, size) => sum + size, 0);
  const runs = page.runs.map((run) => {
    const rows = split(coopPinFloats(run.curves), run.columns);
    return {
      frames: split(coopPinFloats(run.frames), width(run)), width: width(run) + run.columns, shown: 0,
      columns: Array.from({ length: run.columns }, (_, column) => rows.map((row) => row[column])),
    };
  });
  let time = 0, spoken = "", playing = false, last = null, count = 0, arrived = false, changed = false, drawnAt = 0, played = 0, toldAt = 0, shownAt = 0;
  const end = () => (page.live ? runs[0].frames.at(-1)[0] : page.duration);

  // ---------------------------------------------------------------- tiles and clock
  coopPinScaleBar(element("tension"), page);
  const tiles = page.plots.filter(({ tile }) => tile).map(({ key, tile, unit, curves }) => {
    const box = document.createElement("div");
    box.innerHTML = `${tile}<b>&nbsp;</b>&nbsp;`;
    element("tiles").append(box);
    return { key, tile, unit, box, actual: curves.filter(({ role, label }) => role === "actual" && label !== "mrad turned"), wanted: curves.filter(({ role }) => role === "desired") };
  });
  const plots = coopPinPlots(element("plots"), page, runs, (to) => seek(to));
  const axial = page.plots.find(({ key }) => key === "axial") ?? page.plots[0];
  plots.add(element("scrub"), axial.curves.filter(({ role }) => role === "actual"), { bare: true, name: "internal force along, over time" });

  function showTiles() {
    for (const { key, tile, unit, box, actual, wanted } of tiles) {
      const values = actual.map(({ column }) => plots.value(runs[0], column)), worst = values.reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a)), goal = wanted[values.indexOf(worst)]; // of the same arm
      const sense = Math.abs(worst) < 0.05 ? "along" : worst < 0 ? "squeeze" : "pull apart";
      box.innerHTML = `${key === "axial" ? sense : tile}<b>${coopPinNumber(worst)}<small> ${unit}</small></b>${goal ? `wanted ${coopPinNumber(plots.value(runs[0], goal.column))}` : "&nbsp;"}`;
      if (key === "axial") { spoken = `${coopPinNumber(Math.abs(worst))} N ${sense}`; }
    }
  }

  // Arrows, tiles and captions are of the frame that holds at the time; poses move on to the next one.
  const holding = ({ frames }) => coopPinIndex(frames.length, (k) => frames[k][0], time);
  function around(run) {
    const from = holding(run), [frame, next = frame] = run.frames.slice(from, from + 2), step = next[0] - frame[0];
    run.shown = frame[0];
    return [frame, next, step > 0 ? Math.min((time - frame[0]) / step, 1) : 0];
  }
  // While a run plays, in steps of less than PLAYED, numbers are written four times a second; any other time is told at once.
  function show() {
    const glides = played > 0, tells = played < 2 || Math.abs(time - toldAt) >= 0.25 * Number(speed.value) - 1e-9;
    stage.show(...around(runs[0]), tells, glides);
    plots.moveTo(time, tells);
    shownAt = performance.now();
    if (tells) { toldAt = time; showTiles(); }
    slider.max = end();
    slider.value = time;
    slider.setAttribute("aria-valuetext", `${time.toFixed(2)} s, ${spoken}`);
    const whole = end().toFixed(2);
    clock.textContent = `t = ${time.toFixed(2).padStart(page.live ? 0 : whole.length)} s` + (page.live ? "" : ` / ${whole} s`);
    const texts = [...page.spans.filter(({ kind, start, end: over }) => kind === "event" && start <= time && time <= Math.max(over, start + 1)),
      ...page.breaches.filter((breach) => breach.time <= time && time <= breach.time + 1)].map(({ text }) => text);
    told.forEach((sentence) => sentence.classList.toggle("past", Math.abs(sentence.dataset.time - time) > 0.02));
    notice.hidden = texts.length === 0;
    notice.textContent = texts.join("  ·  ");
  }
  // A person stops at the nearest frame, so that cursor, arrows and numbers are of one recorded instant.
  function seek(to, steps = 0) {
    setPlaying(false);
    played = -2;
    goTo(to);
    const times = runs[0].frames.map(([first]) => first), k = holding(runs[0]), nearer = times[k + 1] - time < time - times[k];
    goTo(Math.round(1e5 * (times[k + (steps || nearer)] ?? time)) / 1e5);
    if (!page.live && self === top) { history.replaceState(null, "", `#t=${time}`); }
  }
  function goTo(to) {
    const before = time;
    time = Math.min(Math.max(to, 0), end());
    played = time > before && time - before < PLAYED * Number(speed.value) ? played + 1 : 0;
    show();
  }
  function setPlaying(on) {
    playing = on;
    last = null;
    play.textContent = on ? "❚❚" : "▶";
    play.setAttribute("aria-label", on ? "pause" : "play");
    if (on && !page.live && time >= end()) { goTo(0); }
  }
  function tick(present) {
    requestAnimationFrame(tick);
    if (toldAt !== time && present - shownAt > STILL_MS) { played = 0; show(); } // a live run that has stopped
    if (page.live) {
      if (arrived && playing) { arrived = false; goTo(end()); } // once a frame, however many have arrived
      if (changed && present - drawnAt > REDRAW_MS) { changed = false; plots.refresh(); trails(); drawnAt = performance.now(); }
    } else if (playing) {
      if (last !== null) { goTo(time + (present - last) / 1000 * Number(speed.value)); }
      last = present;
      if (time >= end()) { setPlaying(false); }
    }
  }
  function trails() {
    stage.trail("path", stage.travelled(runs[0].frames), page.colours.payload, 0.0025);
  }

  // ---------------------------------------------------------------- controls
  slider.addEventListener("input", () => seek(Number(slider.value)));
  play.addEventListener("click", () => {
    if (playing) { seek(time); } else { setPlaying(true); }
    if (page.live && playing) { goTo(end()); }
  });
  // Keys are for the clock, unless the focused control has a use for them.
  document.addEventListener("keydown", (event) => {
    const { key, target, ctrlKey, metaKey, altKey } = event, used = target.closest("select") || (key === " " && target.closest("button, summary"));
    const acts = {
      " ": () => play.click(), ArrowRight: () => seek(time, 1), ArrowLeft: () => seek(time, -1), Home: () => seek(0), End: () => seek(end()),
      ...Object.fromEntries(page.instants.slice(0, 9).map(({ time: at }, k) => [k + 1, () => seek(at)])),
    };
    if (used || !acts[key] || ctrlKey || metaKey || altKey) { return; }
    event.preventDefault();
    acts[key]();
  });
  // The address has the time, so that a moment can be shared.
  const address = () => Number(/^#t=([\d.]+)$/.exec(location.hash)?.[1] ?? NaN);
  const fromAddress = () => { if (!page.live && address() >= 0) { seek(address()); } };
  addEventListener("hashchange", fromAddress);
  for (const [k, { text, time: at }] of page.instants.entries()) {
    const chip = document.createElement("button");
    chip.textContent = text;
    if (k < 9) { chip.title = `key ${k + 1}`; }
    chip.addEventListener("click", () => seek(at));
    element("chips").append(chip);
  }
  told.forEach((sentence) => sentence.addEventListener("click", () => seek(Number(sentence.dataset.time))));
  document.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", () => stage.view(button.dataset.view)));
  const absent = { external: !page.pushes, cones: !page.runs[0].nodes.some((path) => path.startsWith("cones/")), moments: page.scales.moments === null };
  document.querySelectorAll("[data-layer]").forEach((button) => { button.parentNode.hidden = absent[button.dataset.layer] ?? false; });
  const warnings = new Set(runs[0].frames.flatMap((frame) => Array.from(frame.slice(-page.runs[0].blocks.warnings))));
  document.querySelectorAll("[data-warning]").forEach((line) => { line.hidden = !page.live && !warnings.has(Number(line.dataset.warning)); });
  document.querySelectorAll("[data-layer]").forEach((button) => button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", on);
    stage.setLayer(button.dataset.layer, on);
    show();
  }));
  if (innerWidth < 700 || innerHeight < 600 || self !== top) { element("legend").open = false; }

  // ---------------------------------------------------------------- print
  // On paper the view is as wide as the sheet, and its labels, which are text, are as much larger or smaller as the drawing.
  addEventListener("beforeprint", () => {
    const { clientWidth: width, clientHeight: height } = element("pane");
    if (!stage.viewer || !width) { return; }
    stage.viewer.render();
    const [wide, tall] = document.body.classList.contains("pane") ? PAPER_PANE : PAPER, share = Math.min(wide / width, tall / height);
    for (const [name, value] of Object.entries({ wide: width, tall: height, share })) { element("view").style.setProperty(`--${name}`, value); }
    plots.unfold();
  });

  // ---------------------------------------------------------------- a run under way
  function receive(message) {
    for (const row of split(new Float32Array(message), runs[0].width)) {
      const [{ frames, columns }] = runs;
      const isFirst = count === 0 || row[0] < frames[frames.length - 1][0];
      if (isFirst || frames.length > MOST_FRAMES) { // a reset; or so long a run that every second frame is dropped
        const kept = (_, k) => !isFirst && k % 2 === 0;
        frames.splice(0, frames.length, ...frames.filter(kept));
        columns.forEach((column) => column.splice(0, column.length, ...column.filter(kept)));
      }
      frames.push(row.subarray(0, runs[0].width - columns.length));
      columns.forEach((column, k) => column.push(row[row.length - columns.length + k]));
      count += 1;
    }
    arrived = changed = true;
  }
  function connect() {
    const address = new URL("frames", location.href);
    address.protocol = address.protocol.replace("http", "ws");
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { status.textContent = "live"; };
    socket.onmessage = ({ data }) => receive(data);
    socket.onclose = () => {
      status.textContent = "no connection: the run or its notebook has ended";
      setTimeout(connect, 2000);
    };
  }

  function listen() {
    const tell = (message) => parent.postMessage(message, "*");
    addEventListener("message", ({ source, data }) => {
      if (source !== parent) { return; }
      if (data.frames) { receive(data.frames); }
      if (data.changes) {
        page.spans = data.changes.map((change) => ({ kind: "event", ...change }));
        changed = true;
      }
      if (data.gone) { status.textContent = "no connection: the notebook's kernel has ended"; }
    });
    if (page.push) { coopPinPush(stage, element("labels"), page, (point, force) => tell({ kind: "push", point, force })); }
    status.textContent = page.push ? "live: drag the payload to push it" : "live";
    tell({ kind: "hello" });
  }

  window.coopPin = {
    ...stage, plots, runs, seek, goTo, play: () => setPlaying(true), duration: page.duration, instants: page.instants, marks: () => page.spans,
    get count() { return count; }, get time() { return time; }, get playing() { return playing; },
  };
  trails();
  goTo(page.start);
  fromAddress();
  if (page.live) {
    setPlaying(true);
    ({ server: connect, notebook: listen, none: () => { status.textContent = page.still; } })[page.channel]();
  }
  requestAnimationFrame(tick);
})();
