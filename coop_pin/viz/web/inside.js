"use strict";
// A replay inside a page: unpacked as the page opens; on paper its view with its numbers stands there instead.
for (const frame of document.querySelectorAll("iframe[data-page]")) {
  const packed = new Blob([Uint8Array.from(atob(frame.dataset.page), (one) => one.charCodeAt(0))]);
  new Response(packed.stream().pipeThrough(new DecompressionStream("gzip"))).text().then((page) => { frame.srcdoc = page; });
}
addEventListener("beforeprint", () => {
  const replay = document.querySelector("iframe[data-page]").contentWindow, picture = document.getElementById("picture");
  if (!replay?.coopPin?.viewer) { return; }
  replay.coopPin.viewer.render();
  const drawn = replay.document.querySelector("#pane canvas"), scale = drawn.width / drawn.clientWidth, view = drawn.getBoundingClientRect();
  Object.assign(picture, { width: drawn.width, height: drawn.height, hidden: false });
  const pen = picture.getContext("2d");
  pen.drawImage(drawn, 0, 0);
  pen.font = `700 ${12 * scale}px system-ui, sans-serif`;
  for (const label of replay.document.querySelectorAll("#labels span:not([hidden])")) {
    const { left, top, width, height } = label.getBoundingClientRect(), at = [left - view.left, top - view.top, width, height].map((size) => size * scale);
    pen.fillStyle = "rgba(255, 255, 255, .9)";
    pen.fillRect(...at);
    pen.fillStyle = "#1f2933";
    for (const [k, line] of label.textContent.split("\n").entries()) { pen.fillText(line, at[0] + 5 * scale, at[1] + (12 + 16 * k) * scale); }
  }
});
