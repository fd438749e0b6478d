// The replays in a page follow the light or dark theme of the page.
"use strict";
(() => {
  const root = document.documentElement;
  const tell = frame => frame.contentWindow.postMessage({ theme: root.dataset.theme }, "*");
  addEventListener("DOMContentLoaded", () => {
    const frames = [...document.querySelectorAll("iframe.replay")];
    for (const frame of frames) frame.addEventListener("load", () => tell(frame));
    new MutationObserver(() => frames.forEach(tell)).observe(root, { attributeFilter: ["data-theme"] });
  });
})();
