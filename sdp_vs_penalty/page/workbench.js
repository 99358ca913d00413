"use strict";
// Dropped and chosen files are sent one by one; focus stays where it was when a step is redrawn.
const workbench = {
  async send(files) {
    const base = location.pathname;
    for (const file of files) {
      const query = new URLSearchParams({ name: file.name });
      try {
        await fetch(`${base}/files?${query}`, { method: "PUT", body: file });
      } catch (error) {
        console.warn("a file could not be sent", error);
      }
    }
    await fetch(`${base}/sent`, { method: "POST" });
  },
  show(stage, part, back) {
    if (!back && document.body.dataset.at !== stage) history.pushState({ stage }, "", `#${stage}`);
    const before = document.body.dataset.at;
    workbench.places[before] = scrollY; // a stage is found again as it was left
    document.body.dataset.at = stage; // look.css shows that screen
    localStorage.setItem(location.pathname, stage);
    for (const link of document.querySelectorAll("nav.stages a")) {
      if (link.dataset.to === stage) link.setAttribute("aria-current", "step");
      else link.removeAttribute("aria-current");
    }
    measure();
    const first = document.querySelector(`[data-stage="${stage}"] [data-part]:not(.hidden)`);
    const to = part && document.querySelector(`[data-part="${part}"]`);
    if (to && to !== first) to.scrollIntoView({ block: "start" });
    else if (to) scrollTo(0, 0);
    else if (before !== stage) scrollTo(0, workbench.places[stage] ?? 0);
    const heading = (to !== first && to?.querySelector("h3")) || document.querySelector(`[data-stage="${stage}"] h2`);
    if (to || before !== stage) heading?.focus({ preventScroll: true }); // focus goes to what changed
    dispatchEvent(new Event("resize")); // charts drawn out of sight learn how wide they are
  },
  center() {
    // A narrow page has the rail on one line: its active stage is kept in view.
    const rail = document.querySelector("nav.stages");
    const link = rail?.querySelector("[aria-current]");
    if (!link) return;
    const left = link.getBoundingClientRect().left - rail.getBoundingClientRect().left;
    rail.scrollLeft += left - (rail.clientWidth - link.offsetWidth) / 2;
  },
  key: null,
  pressed: null, // the key of the button whose job runs
  places: {},
};
addEventListener("resize", () => workbench.center()); // a change of the stage is one too
// Tables that are wider than the page say so; what stays in view says how high it is.
const measure = () => {
  for (const box of document.querySelectorAll(".wide")) box.classList.toggle("cut", box.scrollWidth > box.clientWidth + 1);
  const [bar, rail] = [".bar", "nav.stages"].map((name) => document.querySelector(name)?.offsetHeight ?? 0);
  const words = innerWidth > 640 ? 0 : Math.max(0, (document.querySelector(".now .choices")?.offsetTop ?? 0) - 6);
  document.documentElement.style.setProperty("--hide", `${words}px`);
  document.documentElement.style.setProperty("--bar", `${innerWidth > 900 ? bar : bar - words + rail}px`);
};
let due = 0;
const measureSoon = () => (due ||= requestAnimationFrame(() => (due = 0, measure())));
addEventListener("resize", measureSoon);
// A chart that is out of sight learns its width when it is seen: no fault.
addEventListener("unhandledrejection", (event) => /displayed plot div/.test(event.reason?.message) && event.preventDefault());

document.addEventListener("change", (event) => {
  if (event.target.dataset?.send === undefined) return;
  workbench.send([...event.target.files]).then(() => (event.target.value = ""));
});
for (const name of ["dragenter", "dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault(); // a file must not replace the page
    const zone = event.target.closest?.(".drop");
    if (name === "dragleave" || name === "drop") zone?.classList.remove("over");
    else zone?.classList.add("over");
    const field = event.target.closest?.(".field")?.querySelector("select");
    const column = name === "drop" && event.dataTransfer.getData("text/plain");
    if (field && column) {
      field.value = column; // of a file, dragged to what it is
      field.dispatchEvent(new Event("change", { bubbles: true }));
    }
    if (name === "drop" && event.dataTransfer.files.length) workbench.send([...event.dataTransfer.files]); // wherever it falls
  });
}
document.addEventListener("dragstart", (event) => {
  const column = event.target.closest?.(".of-file");
  if (column) event.dataTransfer.setData("text/plain", column.dataset.column);
});
document.addEventListener("click", (event) => {
  const link = event.target.closest?.("[data-to]");
  if (!link) return;
  event.preventDefault();
  workbench.show(link.dataset.to, link.dataset.partOf);
  const field = link.dataset.opens && document.querySelector(`[data-key="${link.dataset.opens}"]`);
  for (let fold = field?.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  if (field?.type === "file") field.click();
  else field?.focus();
});

let pressed = null; // a button that is drawn anew under the finger is pressed all the same
document.addEventListener("pointerdown", (event) => (pressed = event.target.closest?.("button[data-key]")));
document.addEventListener("pointerup", (event) => {
  const now = event.target.closest?.("button[data-key]");
  if (now && pressed && !pressed.isConnected && now.dataset.key === pressed.dataset.key && now.innerText === pressed.innerText) now.click();
});
document.addEventListener("click", (event) => {
  const question = event.target.closest?.("[data-confirm]")?.dataset.confirm;
  if (question && !confirm(question)) event.stopImmediatePropagation();
}, true);

// While a job runs, no button starts another one, and the one that was pressed says what runs.
const JOBS = "button.action:not(.free, .cell, [data-play]):not(.dock *)";
const showBusy = () => {
  const page = document.querySelector(".page");
  const isBusy = page?.ariaBusy === "true";
  if (!isBusy) workbench.pressed = null;
  for (const button of document.querySelectorAll(JOBS)) {
    const isPressed = isBusy && workbench.pressed !== null && button.dataset.key === workbench.pressed;
    button.ariaDisabled = isBusy ? "true" : null;
    button.classList.toggle("running", isPressed);
    if (isPressed && page.dataset.doing) button.dataset.runs = `${page.dataset.doing} …`;
    else delete button.dataset.runs;
  }
};
document.addEventListener("click", (event) => {
  const button = event.target.closest?.("button.action");
  if (button?.ariaDisabled === "true") event.stopImmediatePropagation();
  else if (button?.matches(JOBS)) workbench.pressed = button.dataset.key;
}, true);
document.addEventListener("click", (event) => {
  const back = event.target.closest?.("[data-key=undo], [data-key=redo]"); // seen at once, drawn anew when done
  const words = back?.querySelector(".what")?.firstChild;
  if (words) words.textContent = words.textContent.replace(/^Undo/, "Undoing").replace(/^Redo/, "Redoing");
});
addEventListener("popstate", (event) => {
  const stage = event.state?.stage ?? (location.hash.slice(1) || "measure");
  // One stage back, or on again; "skip to content" leads to no stage.
  if (document.querySelector(`[data-stage="${CSS.escape(stage)}"]`)) workbench.show(stage, null, true);
});
document.addEventListener("click", async (event) => {
  if (!event.target.closest?.("[data-again]")) return;
  const words = document.querySelector(".lost p"); // the server may be back, or may have to be started
  const answer = await fetch(location.pathname, { cache: "no-store" }).catch(() => null);
  if (answer?.ok) location.reload();
  else words.textContent = `The program does not run. ${startAgain()}`;
});
const startAgain = () => `Start it in a terminal by ${workbench.start}, then press the button. Your work is on disk.`;
const lost = (is) => {
  for (const button of document.querySelectorAll("button[data-key]:not([data-again])")) button.disabled = is;
  let box = document.querySelector(".lost");
  if (!is) return box?.remove();
  if (box) return;
  box = document.createElement("div");
  box.className = "lost";
  box.setAttribute("role", "alert");
  box.innerHTML = "<p></p>";
  box.firstChild.textContent = `The connection to the program is lost. If it has ended, s${startAgain().slice(1)}`;
  box.insertAdjacentHTML("beforeend", '<button type="button" class="action primary" data-again data-key="again">Open it again</button>');
  document.body.prepend(box); // above what stays in view, not over it
};

document.addEventListener("focusin", (event) => {
  workbench.key = event.target.closest("[data-key]")?.dataset.key ?? null;
});
document.addEventListener("pointerdown", (event) => {
  if (!event.target.closest("[data-key]")) workbench.key = null;
});
document.addEventListener("toggle", () => dispatchEvent(new Event("resize")), true); // so do these
addEventListener("DOMContentLoaded", () => {
  const asked = location.hash.slice(1); // a link may lead to a stage
  document.body.dataset.at = workbench.stages.includes(asked) ? asked : localStorage.getItem(location.pathname) ?? "measure";
  const arrive = () => {
    const link = document.querySelector(`nav.stages a[data-to="${document.body.dataset.at}"]`);
    link?.setAttribute("aria-current", "step");
    workbench.center();
    if (link) waiting.disconnect();
  };
  const waiting = new MutationObserver(arrive);
  waiting.observe(document.body, { childList: true, subtree: true });
  arrive(); // the page may be there already
  // The plotting script is large: fetched while the person still reads.
  setTimeout(() => import("nicegui-plotly").catch(() => {}), 1000);
  const popup = document.querySelector("#popup"); // NiceGUI's, which has no button
  if (popup) new MutationObserver(() => lost(popup.ariaHidden === "false")).observe(popup, { attributes: true });
  new MutationObserver(showBusy).observe(document.body, {
    childList: true, subtree: true, attributes: true, attributeFilter: ["aria-busy", "data-doing"],
  });
  new MutationObserver(() => {
    measureSoon();
    if (document.activeElement !== document.body || workbench.key === null) return;
    document.querySelector(`[data-key="${CSS.escape(workbench.key)}"]`)?.focus({ preventScroll: true });
  }).observe(document.body, { childList: true, subtree: true });
});

// The arms in 3D, one a scene, and the time cursor in the charts beside it: drawn once, moved here.
const arms = {};
class Arm {
  constructor(id) {
    this.id = id;
    this.time = this.tries = 0;
  }
  get frame() {
    return document.querySelector(`[data-arm="${this.id}"]`);
  }
  load(moves) {
    this.moves = moves;
    this.tries = 0;
    this.at(moves.t[0]);
    this.settle();
  }
  settle() {
    // A scene draws all the time: let it draw only what has changed and can be seen.
    const scene = this.frame && getElement(this.id);
    if (!scene?.renderer) return this.tries++ < 300 && setTimeout(() => this.settle(), 200);
    if (!scene.thrifty) {
      const draw = scene.renderer.render.bind(scene.renderer);
      let last = "";
      scene.thrifty = true;
      scene.renderer.setClearColor(0, 0); // the page's own colour, light or dark
      for (const object of scene.scene?.children ?? [])
        if (object.object_id === "ground") object.visible = false; // of the ground, the lines stay
      scene.renderer.render = (world, camera) => {
        const there = [...scene.objects.values()].filter((o) => o.mesh?.parent).length;
        const now = Math.floor(performance.now() / 1000); // a browser may lose what was drawn
        const state = `${camera.matrixWorld.elements} ${this.drawn} ${there} ${scene.renderer.domElement.width} ${now}`;
        const hidden = scene.$el.offsetParent === null; // what was drawn is lost with the canvas's place
        if (!hidden && state !== last) draw(world, camera);
        last = hidden ? "" : state;
      };
    }
    this.at(this.time);
    const whole = this.moves.groups.every((group) => scene.objects.get(group)?.mesh);
    if (!whole && this.tries++ < 300) setTimeout(() => this.settle(), 200); // objects arrive one by one
    else setTimeout(() => this.at(this.time), 1000); // and what hangs on them
  }
  at(time) {
    const { t, poses, errors, groups } = this.moves;
    if (!this.frame) return;
    const [start, end] = [t[0], t[t.length - 1]]; // from the run's first sample, as the charts
    this.time = Math.min(Math.max(time, start), end);
    let k = t.findIndex((x) => x > this.time);
    if (k < 1) k = k < 0 ? t.length - 1 : 1;
    const share = (this.time - t[k - 1]) / (t[k] - t[k - 1] || 1);
    const objects = getElement(this.id)?.objects;
    for (const [i, group] of groups.entries()) {
      const mesh = objects?.get(group)?.mesh;
      if (!mesh) continue;
      const [a, b] = [poses[k - 1][i], poses[k][i]];
      mesh.position.set(...[0, 1, 2].map((c) => a[c] + share * (b[c] - a[c])));
      const other = mesh.quaternion.clone().set(...b.slice(3));
      mesh.quaternion.set(...a.slice(3)).slerp(other, share);
    }
    for (const object of objects?.values() ?? []) {
      const link = /^link-(\d+)$/.exec(object.mesh?.name ?? "");
      if (!link) continue;
      const error = errors[k][Math.min(+link[1], errors[k].length - 1)];
      object.mesh.material.color.setRGB(0.0 + 0.84 * error, 0.45 - 0.18 * error, 0.7 - 0.7 * error);
    }
    this.drawn = (this.drawn ?? 0) + 1;
    this.frame.querySelector("[data-time]").value = (1000 * (this.time - start)) / (end - start || 1);
    this.frame.querySelector("[data-clock]").textContent = `${this.time.toFixed(1)} s`;
    this.cursor();
  }
  cursor() {
    for (const chart of this.frame.closest(".part").querySelectorAll(".chart.timed")) {
      const plot = chart.classList.contains("js-plotly-plot") ? chart : chart.querySelector(".js-plotly-plot");
      const axis = plot?._fullLayout?.xaxis2 ?? plot?._fullLayout?.xaxis;
      if (!axis?.l2p) continue;
      let line = chart.querySelector(".cursor");
      if (!line) {
        line = document.createElement("div");
        line.className = "cursor";
        chart.append(line);
      }
      const x = axis.l2p(this.time);
      line.hidden = x < 0 || x > axis._length;
      line.style.left = `${axis._offset + x}px`;
    }
  }
  play() {
    this.playing = !this.playing;
    this.frame.querySelector("[data-play]").textContent = this.playing ? "Pause" : "Play";
    let before = performance.now();
    const next = (now) => {
      if (!this.playing || !this.frame) return;
      const end = this.moves.t[this.moves.t.length - 1];
      this.at(this.time >= end ? this.moves.t[0] : this.time + (now - before) / 1000);
      before = now;
      requestAnimationFrame(next);
    };
    if (this.playing) requestAnimationFrame(next);
  }
}
document.addEventListener("input", (event) => {
  const arm = arms[event.target.dataset?.time];
  if (!arm) return;
  const [start, end] = [arm.moves.t[0], arm.moves.t[arm.moves.t.length - 1]];
  arm.at(start + (event.target.value / 1000) * (end - start));
});
document.addEventListener("click", (event) => {
  const asked = event.target.closest?.("[data-copy]");
  if (!asked) return;
  const rows = [...document.querySelectorAll(`${asked.dataset.copy} tr`)];
  const text = rows.map((row) => [...row.cells].map((cell) => cell.innerText.trim()).join("\t")).join("\n");
  navigator.clipboard?.writeText(text).then(() => (asked.textContent = "Copied"));
});
