// A page opened from a folder may not read others: excerpts of the search's results are then of coopPinTexts.
if (location.protocol === "file:") {
  window.fetch = (page) => {
    const text = coopPinTexts[page.replace(document.documentElement.dataset.content_root, "").replace(/\.html$/, "")];
    const main = Object.assign(document.createElement("div"), { textContent: text ?? "" });
    main.setAttribute("role", "main");
    return Promise.resolve(new Response(main.outerHTML));
  };
}
