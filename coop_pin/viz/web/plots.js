"use strict";
// Time plots on one clock: cursors follow the play, a click seeks, a drag zooms, a double click shows all again.
const coopPinTick = (value) => Number(value.toPrecision(3)).toString().replace("-", "−");
// A value that is read: two digits, and never more than three decimals.
const coopPinNumber = (value) => coopPinTick(Math.abs(value) >= 99.5 ? Math.round(value) : Number(Number(value.toPrecision(2)).toFixed(3)));
const coopPinWhole = (value) => coopPinTick(Math.round(value));

// Numbers of a page are little-endian float32 in base64.
const coopPinBytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const coopPinNumbers = (text, kind) => new kind(coopPinBytes(text).buffer);
const coopPinFloats = (text) => coopPinNumbers(text, Float32Array);

// Index of the last time that is not later.
function coopPinIndex(count, timeOf, time) {
  let [low, high] = [0, count - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (timeOf(middle) <= time + 1e-6) { low = middle; } else { high = middle - 1; }
  }
  return low;
}

function coopPinPlots(place, page, runs, seek) {
  const FONT = "10px system-ui, sans-serif", plots = [], MOST = 3e4;

  // The range of y. A peak far beyond the rest gets a second range: beyond a knee values are drawn closer together.
  function rangeOf(columns, from, to) {
    const all = [];
    const step = Math.max(Math.floor((to - from) * columns.length / MOST), 1);
    let [low, high] = [0, 0]; // zero is always in sight
    for (const column of columns) {
      for (let k = from; k <= to; k += 1) {
        const value = column[k];
        if (value === null || value === undefined || Number.isNaN(value)) { continue; }
        low = Math.min(low, value);
        high = Math.max(high, value);
        if (k % step === 0) { all.push(value); }
      }
    }
    const least = Math.max(0.02 * (high - low), 1e-9 + 1e-6 * Math.abs(high));
    if (high - low < 2e-9) { low -= 1e-3; high += 1e-3; }
    const sorted = Float64Array.from(all).sort(), at = (share) => sorted[Math.round(share * (sorted.length - 1))];
    const [lower, upper] = sorted.length < 200 ? [low, high] : [Math.min(at(0.02), 0), Math.max(at(0.98), 0)], width = Math.max(upper - lower, least);
    const knee = (end, usual) => (Math.abs(end - usual) > 1.2 * width ? usual + 0.2 * Math.sign(end - usual) * width : end);
    return { low, high, lower: knee(low, lower), upper: knee(high, upper) };
  }

  const bandOf = ({ lower, upper }) => 0.35 * (upper - lower);
  function forward(value, y) {
    if (value > y.upper) { return y.high > y.upper ? y.upper + bandOf(y) * (value - y.upper) / (y.high - y.upper) : value; }
    if (value < y.lower) { return y.low < y.lower ? y.lower - bandOf(y) * (y.lower - value) / (y.lower - y.low) : value; }
    return value;
  }
  function backward(drawn, y) {
    if (drawn > y.upper) { return y.high > y.upper ? y.upper + (drawn - y.upper) * (y.high - y.upper) / bandOf(y) : drawn; }
    if (drawn < y.lower) { return y.low < y.lower ? y.lower - (y.lower - drawn) * (y.lower - y.low) / bandOf(y) : drawn; }
    return drawn;
  }

  function ticks(y) {
    const rough = (y.upper - y.lower) / 3.4, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].find((one) => one * power >= rough) * power, found = [];
    for (let k = Math.ceil(y.lower / step - 1e-6); k * step <= y.upper + 1e-6 * step; k += 1) { found.push(k * step); }
    return [...(y.low < y.lower ? [y.low] : []), ...found, ...(y.high > y.upper ? [y.high] : [])];
  }

  // Windows of the metrics and events are shaded; breaches of trust are triangles; a second range of y has a tint.
  function shade(u, y) {
    const { ctx, bbox } = u, x = (time) => Math.min(Math.max(u.valToPos(time, "x", true), bbox.left), bbox.left + bbox.width);
    ctx.save();
    for (const span of page.spans) {
      const left = x(span.start), width = x(span.end) - left;
      ctx.fillStyle = span.kind === "event" ? "rgba(204, 121, 167, .45)" : "rgba(0, 114, 178, .07)";
      ctx.fillRect(left, bbox.top, span.kind === "event" ? Math.max(width, 2) : width, bbox.height);
    }
    ctx.fillStyle = "rgba(230, 159, 0, .10)";
    for (const [from, to] of [[y.high, y.upper], [y.lower, y.low]]) {
      const top = u.valToPos(from, "y", true);
      if (from !== to) { ctx.fillRect(bbox.left, top, bbox.width, u.valToPos(to, "y", true) - top); }
    }
    ctx.restore();
  }
  function mark(u, curves, named) {
    const { ctx, bbox } = u, size = 5 * devicePixelRatio;
    const line = (level, colour) => {
      const y = u.valToPos(level, "y", true);
      ctx.strokeStyle = colour;
      ctx.beginPath(); ctx.moveTo(bbox.left, y); ctx.lineTo(bbox.left + bbox.width, y); ctx.stroke();
    };
    ctx.save();
    line(0, "#9aa5b1");
    ctx.setLineDash([2 * size, size]);
    const { limit } = curves[0];
    for (const level of limit ? [limit, -limit] : []) { // limits that the range of y has
      if (level <= u.scales.y.max && level >= u.scales.y.min) { line(level, "#1f2933"); }
    }
    ctx.font = FONT.replace("10px", `${10 * devicePixelRatio}px`);
    ctx.fillStyle = "#34566e";
    ctx.textAlign = "left";
    for (const { start, end, text } of page.spans.filter(({ kind }) => named && kind === "window")) {
      const left = Math.max(u.valToPos(start, "x", true), bbox.left) + size / 2, right = Math.min(u.valToPos(end, "x", true), bbox.left + bbox.width);
      if (ctx.measureText(text).width < right - left) { ctx.fillText(text, left, bbox.top + 2 * size); }
    }
    ctx.fillStyle = "#b42318";
    for (const { time } of page.breaches) {
      const x = u.valToPos(time, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) { continue; }
      ctx.beginPath();
      ctx.moveTo(x - size, bbox.top); ctx.lineTo(x + size, bbox.top); ctx.lineTo(x, bbox.top + 1.7 * size); ctx.fill();
    }
    ctx.restore();
  }

  function add(holder, curves, { bare = false, first = false, last = false, unit = "", name = "" } = {}) {
    const timed = first || last; // the times are at the first plot, too, which is always in sight
    const drawn = [...curves].sort((a, b) => (a.role === "actual") - (b.role === "actual"));
    const styled = (curve) => ({
      stroke: curve.colour, width: bare ? 1 : curve.role === "actual" ? 1.4 : 1.2, points: { show: false }, spanGaps: true,
      dash: curve.role === "desired" ? [4, 3] : curve.role === "measured" ? [1, 2] : undefined,
    });
    const tables = () => [runs[0].columns[0], ...drawn.map(({ column }) => runs[0].columns[column])];
    let y = { low: 0, high: 1, lower: 0, upper: 1 };
    const range = (u) => {
      const [from, to] = u.series[0].idxs ?? [0, u.data[0].length - 1];
      y = rangeOf(u.data.slice(1), from ?? 0, to ?? u.data[0].length - 1);
      const { limit } = curves[0]; // is in sight from half of it on
      if (limit && y.high > limit / 2) { y.high = Math.max(y.high, limit); y.upper = Math.max(y.upper, limit); }
      if (limit && y.low < -limit / 2) { y.low = Math.min(y.low, -limit); y.lower = Math.min(y.lower, -limit); }
      const margin = 0.05 * (forward(y.high, y) - forward(y.low, y));
      return [backward(forward(y.low, y) - margin, y), backward(forward(y.high, y) + margin, y)];
    };
    const axis = { font: FONT, stroke: "#52606d", grid: { stroke: "#e6e9ed", width: 1 }, ticks: { show: false } };
    const line = document.createElement("i"), cursor = (one) => { line.style.left = `${one.valToPos(now, "x")}px`; };
    const u = new uPlot({
      width: holder.clientWidth || 300, height: holder.clientHeight || 90, legend: { show: false }, padding: bare ? [2, 0, 2, 0] : [6, 14, timed ? 0 : 4, 0],
      cursor: { show: !bare, y: false, points: { show: false }, drag: { x: !bare, y: false }, ...(bare ? {} : { sync: { key: "time" } }) },
      scales: { x: { time: false }, y: { distr: 100, fwd: (v) => forward(v, y), bwd: (v) => backward(v, y), range } },
      axes: [
        { ...axis, show: !bare, size: timed ? 22 : 4, values: (_, all) => all.map((time) => (timed ? `${time} s` : "")) },
        { ...axis, show: !bare, size: 42, splits: () => ticks(y), values: (_, all) => all.map((tick) => (tick === y.low || tick === y.high ? coopPinNumber : coopPinTick)(tick)), filter: (_, all) => all },
      ],
      series: [{}, ...drawn.map(styled)],
      hooks: { drawClear: [(one) => shade(one, y)], draw: [(one) => mark(one, curves, first), cursor] },
    }, tables(), holder);
    u.over.append(line);
    u.ctx.canvas.setAttribute("role", "img");
    u.ctx.canvas.setAttribute("aria-label", name);
    let pressed = 0;
    u.over.addEventListener("mousedown", (event) => { pressed = event.clientX; });
    u.over.addEventListener("click", (event) => {
      if (Math.abs(event.clientX - pressed) < 4) { seek(u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x")); }
    });
    new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = holder;
      if (width && height && (width !== u.width || height !== u.height)) { u.setSize({ width, height }); moveTo(now); }
    }).observe(holder);
    plots.push({ u, line, tables, curves, unit });
    return u;
  }

  let now = 0;
  // The value of the sample whose frame is shown.
  const value = (run, column) => run.columns[column][coopPinIndex(run.columns[0].length, (k) => run.columns[0][k], run.shown)];
  function moveTo(time) {
    now = time;
    for (const { u, line } of plots) { line.style.left = `${u.valToPos(now, "x")}px`; }
    for (const { present, curves } of titles) { present.innerHTML = caption(curves); }
  }

  // Present values: of a few curves by their labels; of drives one line for each arm, in order.
  const ofDrives = (key) => key === "torque" || key === "share";
  const shown = ({ column, colour, plot }) => `<b style="--colour:${colour}">${(plot === "share" ? coopPinWhole : coopPinNumber)(value(runs[0], column))}</b>`;
  const plain = (label) => label.replace(/[<&]/g, "");
  function caption(curves) {
    const actual = curves.filter(({ role }) => role === "actual");
    if (!curves.some(({ plot }) => ofDrives(plot))) {
      return (curves.length < 6 ? curves : actual).map((curve) => `${plain(curve.label)} ${shown(curve)}`).join(" · ");
    }
    const armOf = ({ label }) => plain(label.slice(0, label.lastIndexOf(" "))), arms = [...new Set(actual.map(armOf))];
    return arms.map((arm) => `${arm} ${actual.filter((curve) => armOf(curve) === arm).map(shown).join(" ")}`).join("<br>");
  }

  // Headings and captions first, so that every plot is drawn once, at its size.
  const titles = page.plots.map(({ key, title, unit, curves }) => {
    const heading = document.createElement("h2"), present = document.createElement("output"), holder = document.createElement("div");
    const most = Math.max(...curves.map(({ column }) => runs[0].columns[column].reduce((worst, value) => Math.max(worst, Math.abs(value)), 0)));
    heading.textContent = `${title}, ${unit}${key === "share" && !page.live ? ` (at most ${coopPinWhole(most)} %)` : key === "torque" && !page.live ? ", no limits given" : ""}`;
    present.innerHTML = caption(curves);
    place.append(heading, present, holder);
    return { present, curves, holder, unit, name: `plot over time: ${heading.textContent}` };
  });
  titles.forEach(({ curves, holder, unit, name }, k) => add(holder, curves, { first: k === 0, last: k === titles.length - 1, unit, name }));

  function refresh() {
    for (const { u, tables } of plots) { u.setData(tables()); }
    moveTo(now);
  }
  return { add, moveTo, refresh, value, plots };
}
