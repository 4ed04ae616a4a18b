// Live page inside a notebook: hands messages between the page, a frame of its own, and the kernel.
function render({ model, el }) {
  const view = Math.random().toString(36).slice(2), frame = document.createElement("iframe");
  Object.assign(frame, { title: "coop_pin live", srcdoc: model.get("page") });
  frame.style.cssText = `display: block; width: 100%; height: ${model.get("height")}px; border: 0`;
  const tell = (message, moved = []) => frame.contentWindow?.postMessage(message, "*", moved);
  const changed = () => tell({ changes: model.get("changes") });
  const gone = () => tell({ gone: true });
  function toPage({ kind, to }, [bytes]) {
    if (kind !== "frames" || (to && to !== view)) { return; }
    const frames = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
    tell({ frames }, [frames]);
  }
  function toKernel({ source, data }) {
    if (source !== frame.contentWindow) { return; }
    if (data.kind === "hello") { changed(); }
    model.send({ ...data, view });
  }
  model.on("msg:custom", toPage);
  model.on("change:changes", changed);
  model.on("comm_live_update", gone);
  addEventListener("message", toKernel);
  el.append(frame);
  return () => {
    removeEventListener("message", toKernel);
    for (const [name, act] of [["msg:custom", toPage], ["change:changes", changed], ["comm_live_update", gone]]) { model.off(name, act); }
  };
}
export default { render };
