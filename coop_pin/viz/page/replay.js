"use strict";
// Player of the run in this page: it sets the time, and the viewer draws. Nothing is fetched.
(() => {
  const run = JSON.parse(document.getElementById("data").textContent);
  const stage = coopPinStage(document.getElementById("meshcat-pane"), run.messages, run.warning_colours);
  const { viewer } = stage;
  const element = (id) => document.getElementById(id);
  const [play, slider, clock, speed, notice] = ["play", "time", "clock", "speed", "event"].map(element);

  viewer.animator.pause(); // the actions stay ready; this player sets their time
  viewer.animator.folder.domElement.style.display = "none"; // replaced by this player's buttons

  // The caption is on the left, so the scene is shifted a little to the right, at any size of the window.
  function shiftScene() {
    const { camera } = viewer, { aspect } = camera;
    camera.setViewOffset(1, 1, -0.05, 0, 1, 1);
    camera.aspect = aspect;
    camera.updateProjectionMatrix();
  }

  let time = 0, playing = false, last = null;
  const warnings = run.bodies.map(() => 0);

  // A warning colour is held until its next change.
  function showWarnings() {
    const wanted = run.bodies.map(() => 0);
    for (const [start, body, code] of run.warning_changes) {
      if (start > time) { break; }
      wanted[body] = code;
    }
    wanted.forEach((code, body) => {
      if (code !== warnings[body]) { stage.setWarning(run.bodies[body], code); warnings[body] = code; }
    });
  }

  function show() {
    viewer.animator.seek(time);
    viewer.animator.display_progress(time);
    showWarnings();
    slider.value = time;
    clock.textContent = `t = ${time.toFixed(2)} s / ${run.duration.toFixed(2)} s`;
    const now = run.events.filter((event) => event.start <= time && time <= Math.max(event.end, event.start + 1));
    notice.hidden = now.length === 0;
    notice.textContent = now.map((event) => event.text).join("  \u00b7  ");
  }

  function seek(to) {
    time = Math.min(Math.max(to, 0), run.duration);
    show();
  }

  function setPlaying(on) {
    playing = on;
    last = null;
    play.textContent = on ? "\u275a\u275a" : "\u25b6";
    if (on && time >= run.duration) { seek(0); }
  }

  function tick(now) {
    requestAnimationFrame(tick);
    if (!playing) { return; }
    if (last !== null) { seek(time + (now - last) / 1000 * Number(speed.value)); }
    last = now;
    if (time >= run.duration) { setPlaying(false); }
  }

  slider.max = run.duration;
  slider.addEventListener("input", () => { setPlaying(false); seek(Number(slider.value)); });
  play.addEventListener("click", () => setPlaying(!playing));
  document.addEventListener("keydown", (event) => {
    if (event.key === " ") { event.preventDefault(); setPlaying(!playing); }
    if (event.key === "ArrowRight") { event.preventDefault(); setPlaying(false); seek(time + 1 / 30); }
    if (event.key === "ArrowLeft") { event.preventDefault(); setPlaying(false); seek(time - 1 / 30); }
  });
  for (const event of run.events) {
    const mark = document.createElement("b");
    mark.style.left = `${100 * event.start / run.duration}%`;
    mark.title = event.text;
    element("track").append(mark);
  }

  window.coopPin = { viewer, seek: (to) => { setPlaying(false); seek(to); }, play: () => setPlaying(true), duration: run.duration };
  shiftScene();
  seek(0);
  setPlaying(true);
  requestAnimationFrame(tick);
})();
