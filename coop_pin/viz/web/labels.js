"use strict";
// Length at which a force or moment is drawn: up to the linear length in proportion, then with the logarithm, up to the longest.
function coopPinLength(size, per, { linear, logarithmic, longest }) {
  const ratio = size / per / linear;
  return Math.min(linear * (ratio <= 1 ? ratio : 1 + logarithmic * Math.log(ratio)), longest);
}

// The scale of the struts: how thick a strut is at which force, up to the largest of the run.
function coopPinScaleBar(svg, { scales, peak, colours }) {
  const MIDDLE = 105, HALF = 100, TALL = 9, LEVEL = 25, most = Number(peak.toPrecision(2)) || 1, thick = (share) => TALL * coopPinLength(share * most, scales.forces, scales) / coopPinLength(most, scales.forces, scales);
  const shares = Array.from({ length: 41 }, (_, k) => k / 40), edge = (side, sign, all) => all.map((share) => `${(MIDDLE + side * HALF * share).toFixed(1)} ${(LEVEL + sign * Math.max(thick(share), 0.4)).toFixed(1)}`);
  const half = (side, colour) => `<path d="M${[...edge(side, -1, shares), ...edge(side, 1, [...shares].reverse())].join("L")}z" fill="${colour}"/>`;
  const knee = scales.linear * scales.forces / most, said = (newtons) => coopPinNumber(newtons), full = `${most < 1000 ? said(most) : `${said(most / 1000)} k`} N`.replace("k N", "kN");
  const marks = [0, ...(knee > 0.25 && knee < 0.62 ? [knee, -knee] : [])], at = (share) => MIDDLE + HALF * share;
  svg.innerHTML = half(-1, colours.squeezed) + half(1, colours.torn)
    + `<path d="${[...marks, 1, -1].map((share) => `M${at(share)} ${LEVEL + TALL + 2}v4`).join("")}" stroke="currentColor"/><text x="5" y="12">squeezed</text><text x="205" y="12" text-anchor="end">pulled apart</text>`
    + marks.map((share) => `<text x="${at(share)}" y="51" text-anchor="middle">${share ? said(knee * most) : "0"}</text>`).join("")
    + `<text x="5" y="51">${full}</text><text x="205" y="51" text-anchor="end">${full}</text>`;
  svg.setAttribute("aria-label", `thickness of the struts: squeezed up to ${full} on the left, pulled apart on the right`);
}

// Labels of the 3-D view. Each stands beside its anchor on the side away from a second point, or on the next side that is
// free; it keeps that side while it is free, and moves there in small steps, so that it can be read while the run plays.
function coopPinLabels(pane, holder, viewer) {
  const labels = [], TURNS = [0, 45, -45, 90, -90, 135, -135, 180].map((degrees) => degrees * Math.PI / 180), RINGS = [9, 30, 54];
  const STEP = 9, NEAR = 14, BESIDE = ["tension", "event", "views"].map((id) => document.getElementById(id)); // pixels; what else stands over the view
  let obstacles = [], hovered = null;

  // A label: text() to write, anchor() and away() in the world, steady(), a point that never jumps, shown(); span is its element.
  function add(label, colour, rank) {
    const span = document.createElement("span");
    span.style.borderColor = colour;
    span.hidden = true;
    holder.append(span);
    labels.push(Object.assign(label, { span, rank, side: 0, ring: 0, offset: null, wide: 0, tall: 0, picked: false }));
    labels.sort((one, other) => one.rank - other.rank); // the first have the best places
    return label;
  }
  function tell() {
    for (const { span, text } of labels) {
      const written = text();
      if (span.textContent !== written) { span.textContent = written; }
    }
    for (const label of labels) {
      label.span.hidden = !isShown(label);
      Object.assign(label, { wide: label.span.offsetWidth || label.wide, tall: label.span.offsetHeight || label.tall });
    }
    const { left, top } = pane.getBoundingClientRect(); // a drawing has no offsetWidth
    obstacles = BESIDE.filter((one) => one).map((one) => one.getBoundingClientRect()).map(({ x, y, width, height }) => [x - left, y - top, width, height]);
  }
  const isShown = (label) => label.shown(label === hovered || label.picked);

  // ---------------------------------------------------------------- places
  const shared = ([x, y, w, h], [a, b, v, u]) => Math.max(Math.min(x + w, a + v) - Math.max(x, a), 0) * Math.max(Math.min(y + h, b + u) - Math.max(y, b), 0);
  function pixels(point, width, height) {
    const at = point.clone().project(viewer.camera);
    return { x: (1 + at.x) * width / 2, y: (1 - at.y) * height / 2, ahead: Math.abs(at.z) <= 1 };
  }
  function box({ wide, tall, centred }, at, angle, ring, width, height) {
    const [right, down] = [Math.cos(angle), Math.sin(angle)], out = centred && !ring ? 0 : RINGS[ring] + (Math.abs(right) * wide + Math.abs(down) * tall) / 2;
    const [x, y] = [at.x + right * out - wide / 2, at.y + down * out - tall / 2];
    return [Math.max(2, Math.min(x, width - wide - 2)), Math.max(2, Math.min(y, height - tall - 2)), wide, tall];
  }
  function place(isStill) {
    const { clientWidth: width, clientHeight: height } = pane, placed = [...obstacles];
    for (const label of labels) {
      const { span } = label;
      span.hidden = !isShown(label);
      if (span.hidden) { label.offset = null; continue; }
      if (!label.wide) { Object.assign(label, { wide: span.offsetWidth, tall: span.offsetHeight }); }
      const at = pixels(label.anchor(), width, height), from = pixels(label.away(), width, height), steady = pixels(label.steady(), width, height);
      span.hidden = !at.ahead;
      const angle = Math.hypot(at.x - from.x, at.y - from.y) < 1 ? Math.PI / 2 : Math.atan2(at.y - from.y, at.x - from.x);
      const tried = (side, ring) => box(label, at, angle + TURNS[side], ring, width, height), covered = (one) => placed.reduce((sum, other) => sum + shared(one, other), 0);
      let best = tried(label.side, label.ring);
      if (isStill || covered(best) > 4) {
        let least = Infinity;
        RINGS.forEach((_, ring) => TURNS.forEach((_, side) => {
          const one = tried(side, ring), cost = covered(one) + 4 * side + 22 * ring;
          if (cost < least) { least = cost; best = one; Object.assign(label, { side, ring }); }
        }));
      }
      placed.push(best);
      const to = { x: best[0] - steady.x, y: best[1] - steady.y }, now = label.offset ?? to, far = Math.hypot(to.x - now.x, to.y - now.y);
      const share = isStill || far <= STEP ? 1 : STEP / far;
      label.offset = { x: now.x + share * (to.x - now.x), y: now.y + share * (to.y - now.y) };
      span.style.transform = `translate(${(steady.x + label.offset.x).toFixed(1)}px, ${(steady.y + label.offset.y).toFixed(1)}px)`;
    }
  }

  // ---------------------------------------------------------------- hover and pick
  function nearest(event) {
    const { left, top, width, height } = pane.getBoundingClientRect(), [x, y] = [event.clientX - left, event.clientY - top];
    let [best, least] = [null, NEAR];
    for (const label of labels.filter(({ ends }) => ends)) {
      const line = label.ends();
      if (!line) { continue; }
      const [a, b] = line.map((point) => pixels(point, width, height)), [u, v] = [b.x - a.x, b.y - a.y];
      const along = Math.max(0, Math.min(((x - a.x) * u + (y - a.y) * v) / (u * u + v * v || 1), 1)), far = Math.hypot(x - a.x - along * u, y - a.y - along * v);
      if (far < least) { [best, least] = [label, far]; }
    }
    return best;
  }
  function hover(label) {
    if (label === hovered) { return; }
    hovered = label;
    pane.style.cursor = label ? "pointer" : "";
    viewer.set_dirty();
  }
  let pressed = [0, 0];
  pane.addEventListener("pointermove", (event) => { if (event.buttons === 0) { hover(nearest(event)); } });
  pane.addEventListener("pointerleave", () => hover(null));
  pane.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; }, true);
  pane.addEventListener("click", (event) => {
    const label = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 5 ? nearest(event) : null;
    if (!label) { return; }
    label.picked = !label.picked;
    hovered = null;
    viewer.set_dirty();
  });
  return { add, tell, place };
}
