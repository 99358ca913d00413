"use strict";
// Dropped and chosen files are sent one by one; focus stays where it was when a step is redrawn.
const workbench = {
  async send(files, kind) {
    const base = location.pathname;
    for (const file of files) {
      const query = new URLSearchParams({ name: file.name, kind });
      try {
        if (file.size > LARGEST) {
          await fetch(`${base}/too-large?${new URLSearchParams({ name: file.name, size: file.size })}`, {
            method: "POST",
          });
        } else {
          await fetch(`${base}/files?${query}`, { method: "PUT", body: file });
        }
      } catch (error) {
        console.warn("a file could not be sent", error);
      }
    }
    if (kind === "runs") await fetch(`${base}/sent`, { method: "POST" });
  },
  show(step) {
    document.body.dataset.at = step; // look.css shows that stage, and on a phone all of them
    localStorage.setItem(location.pathname, step);
    for (const link of document.querySelectorAll("nav.steps a")) {
      if (link.dataset.to === step) {
        link.setAttribute("aria-current", "step");
        link.scrollIntoView({ block: "nearest", inline: "center" });
      } else link.removeAttribute("aria-current");
    }
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (matchMedia("(max-width: 640px)").matches)
      document
        .querySelector(`[data-step="${step}"]`)
        ?.scrollIntoView({ behavior: still ? "auto" : "smooth", block: "start" });
    else scrollTo(0, 0);
    document.querySelector(`[data-step="${step}"] h2`)?.focus({ preventScroll: true });
    dispatchEvent(new Event("resize")); // charts drawn out of sight learn how wide they are
  },
  key: null,
};

document.addEventListener("change", (event) => {
  const kind = event.target.dataset?.send;
  if (!kind) return;
  workbench.send([...event.target.files], kind).then(() => (event.target.value = ""));
});
for (const name of ["dragenter", "dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault(); // a file dropped beside a zone must not replace the page
    const zone = event.target.closest?.("[data-drop]");
    if (name === "dragleave" || name === "drop") zone?.classList.remove("over");
    else zone?.classList.add("over");
    if (name === "drop" && zone) workbench.send([...event.dataTransfer.files], zone.dataset.drop);
  });
}
document.addEventListener("click", (event) => {
  const link = event.target.closest?.("a[data-to]");
  if (!link) return;
  event.preventDefault();
  workbench.show(link.dataset.to);
});

document.addEventListener("focusin", (event) => {
  workbench.key = event.target.closest("[data-key]")?.dataset.key ?? null;
});
document.addEventListener("pointerdown", (event) => {
  if (!event.target.closest("[data-key]")) workbench.key = null;
});
addEventListener("DOMContentLoaded", () => {
  document.body.dataset.at = localStorage.getItem(location.pathname) ?? "robot";
  const arrive = new MutationObserver(() => {
    if (!document.querySelector("nav.steps a")) return;
    arrive.disconnect();
    document
      .querySelector(`nav.steps a[data-to="${document.body.dataset.at}"]`)
      ?.setAttribute("aria-current", "step");
  });
  arrive.observe(document.body, { childList: true, subtree: true });
  // The plotting script is large: fetched while the person still reads.
  setTimeout(() => import("nicegui-plotly").catch(() => {}), 1000);
  new MutationObserver(() => {
    if (document.activeElement !== document.body || workbench.key === null) return;
    document.querySelector(`[data-key="${CSS.escape(workbench.key)}"]`)?.focus({ preventScroll: true });
  }).observe(document.body, { childList: true, subtree: true });
});
