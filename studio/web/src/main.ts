// The page: top bar, modes, keys. Start here; `app.ts` is what it knows, `stage.ts` the pictures, one file for each mode.

import "./style.css";
import * as analyse from "./analyse";
import { addFiles, app, connect, onChange, onUnitWanted, send, unheard } from "./app";
import * as clients from "./clients";
import * as compare from "./compare";
import { button, dialog, h, hand, select } from "./dom";
import { toggleHelp } from "./help";
import * as knowledge from "./knowledge";
import * as plan from "./plan";
import * as sculpt from "./sculpt";
import type { Role, Unit } from "./protocol";
import { legend, look, options, stage } from "./scene";
import { heat } from "./stage";
import { svg } from "./dom";
import * as wrap from "./wrap";

type Mode = "clients" | "wrap" | "compare" | "plan" | "analyse" | "knowledge";
const MODES: [Mode, string][] = [
  ["clients", "Clients"],
  ["wrap", "Wrap"],
  ["compare", "Compare"],
  ["plan", "Plan"],
  ["analyse", "Analyse"],
  ["knowledge", "Knowledge"],
];

let mode: Mode = "wrap";
const bar = h("header", {});
const content = h("div", { class: "content" });
const side = h("aside", { class: "panel" });
const picture = h("div", { class: "picture" });
const scale = h("div", { class: "legend" });
picture.append(stage.element, scale, h("div", { class: "looks" }, ([["Front", 0], ["¾", 45], ["Left", 90], ["Right", -90]] as const).map(([text, yaw]) => button(text, () => look(stage.panes, yaw))), button("All", fitAll, { title: "0" })));
document.body.append(bar, content, h("div", { id: "toasts", "aria-live": "polite" }));

function go(to: string) {
  if (to !== mode && mode === "plan") sculpt.leave();
  if (to !== mode && to === "plan") sculpt.enter();
  mode = to as Mode;
  stage.overlay.replaceChildren();
  if (mode === "analyse") analyse.enter();
  if (mode === "knowledge") knowledge.enter();
  if (mode === "clients") send({ type: "list_cases", query: "" });
  render();
}

function fitAll() {
  for (const view of new Set(stage.panes.map((p) => p.view))) stage.panes.find((p) => p.view === view)?.fit();
  stage.draw();
}

// --- drawing the page: at most once a frame, and not under a hand that is at a control ---

let waiting = false;
let late = false;

hand.free = () => late && render();
const CONTROLS = "button, input, select, textarea, label, summary, [tabindex='0']";
/** The part of the page where something is pressed: drawn anew before it is let go, it would not be clicked. */
let pressed: Element | null = null;
document.addEventListener("pointerdown", (event) => {
  pressed = (event.target as Element).closest("header, .panel, .page");
  hand.busy = pressed !== null;
});
for (const end of ["pointerup", "pointercancel"]) {
  document.addEventListener(end, (event) => {
    pressed = null;
    // a list stays open after the click that opens it, until something is chosen or it is left
    hand.busy = event.target instanceof HTMLSelectElement;
    hand.free();
  });
}

function render() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    if (pressed !== bar) drawBar();
    if (hand.busy) {
      late = true;
      pictures();
      return;
    }
    late = false;
    draw();
  });
}

function writing(): boolean {
  const active = document.activeElement;
  return active instanceof HTMLTextAreaElement || (active instanceof HTMLInputElement && ["text", "search"].includes(active.type) && !!active.closest(".page"));
}

function pictures() {
  if (mode === "wrap") wrap.show();
  else if (mode === "compare") compare.show();
  else if (mode === "plan") sculpt.show();
  else if (mode === "analyse") analyse.show();
  drawLegend();
}

/** Draws a part of the page anew; the control in it that has the focus keeps it, by its key or, reached by keys, its place. */
function keepingFocus(part: HTMLElement, draw: () => void) {
  const active = document.activeElement as HTMLElement | null;
  const key = active?.dataset["key"];
  const place = active && part.contains(active) && active.matches(":focus-visible") ? [...part.querySelectorAll(CONTROLS)].indexOf(active) : -1;
  draw();
  const again = key ? document.querySelector<HTMLElement>(`[data-key="${CSS.escape(key)}"]`) : part.querySelectorAll<HTMLElement>(CONTROLS)[place];
  if (again && again !== document.activeElement && again.tagName === active?.tagName) again.focus({ preventScroll: true });
}

function draw() {
  keepingFocus(content, drawContent);
}

function drawContent() {
  const key = (document.activeElement as HTMLElement | null)?.dataset["key"];
  const selection = document.activeElement instanceof HTMLInputElement && ["text", "search"].includes(document.activeElement.type) ? [document.activeElement.selectionStart, document.activeElement.selectionEnd] : null;
  const opened = new Set([...side.querySelectorAll<HTMLElement>("details[open]")].map((d) => d.dataset["key"]));
  const scrolled = new Map([...content.querySelectorAll<HTMLElement>("[data-key], .panel, .cards, .details")].map((e) => [e.dataset["key"] ?? e.className, e.scrollTop]));
  if (mode === "clients") content.replaceChildren(clients.page(go));
  else if (mode === "knowledge") content.replaceChildren(knowledge.page(render, go));
  else {
    if (picture.parentElement !== content) content.replaceChildren(picture, side);
    const parts = mode === "wrap" ? wrap.panel() : mode === "compare" ? compare.panel(render) : mode === "plan" ? plan.panel() : analyse.panel(render);
    side.replaceChildren(...(parts.length ? parts : [h("p", { class: "hint" }, app.connected ? "No client is open: choose one under Clients." : "Waiting for the server.")]));
    for (const d of side.querySelectorAll<HTMLDetailsElement>("details")) d.open = opened.has(d.dataset["key"]);
    pictures();
  }
  for (const e of content.querySelectorAll<HTMLElement>("[data-key], .panel, .cards, .details")) {
    const top = scrolled.get(e.dataset["key"] ?? e.className);
    if (top) e.scrollTop = top;
  }
  const writer = selection && key ? content.querySelector(`[data-key="${CSS.escape(key)}"]`) : null;
  if (selection && writer instanceof HTMLInputElement) writer.setSelectionRange(selection[0] ?? null, selection[1] ?? null);
}

function drawBar() {
  keepingFocus(bar, drawBarContent);
}

function drawBarContent() {
  const { open, progress } = app;
  bar.replaceChildren(
    h("b", { class: "name" }, "nonrigid studio"),
    h("nav", {}, MODES.map(([m, text], k) => button(text, () => go(m), { class: m === mode ? "on" : "", title: `Alt ${k + 1}`, "aria-current": m === mode ? "page" : undefined }))),
    h("span", { class: "grow clip client", title: "The client that is open" }, open ? open.case.name : ""),
    progress
      ? h("span", { class: "progress", role: "status" }, h("span", {}, progress.what), h("progress", progress.share === null ? {} : { max: 1, value: progress.share }), button("Cancel", () => send({ type: "cancel" }), { title: "Esc" }))
      : h("small", { class: app.connected && !clients.isUnkept() ? "saved" : "doubt", role: "status" }, app.connected ? (open ? (clients.isUnkept() ? "what was written of the client is not kept yet" : "all changes saved") : "") : `${app.locked ? "the server was started again: open the address that it has printed" : "no server: start nonrigid-studio again"}${unheard.length ? `; changes that wait for it: ${unheard.length}` : ""}`),
    button("↶", () => send({ type: "undo" }), { disabled: !open?.undo, title: open?.undo ? `Undo: ${open.undo} (Ctrl Z)` : "Nothing to undo", "aria-label": "undo" }),
    button("↷", () => send({ type: "redo" }), { disabled: !open?.redo, title: open?.redo ? `Redo: ${open.redo} (Ctrl Shift Z)` : "Nothing to redo", "aria-label": "redo" }),
    button("?", toggleHelp, { title: "Keys and mouse (?)", "aria-label": "help" }),
  );
}

function drawLegend() {
  const slot = mode === "wrap" && options.heat ? "wrapped" : mode === "compare" && options.heat ? `compare/${app.compared.find((r) => r.summary)?.model}` : mode === "plan" ? "plan" : "";
  const values = slot ? legend(slot) : null;
  const shown = values && values.title !== "mask" && stage.panes.some((p) => p.surfaces.length > 0);
  if (!shown) return scale.replaceChildren();
  const stops = [0, 0.25, 0.5, 0.75, 1];
  const css = (share: number) => `rgb(${heat(share).map((c) => Math.round(255 * c)).join(",")})`;
  scale.replaceChildren(
    h("small", {}, values.title),
    svg("svg", { viewBox: "0 0 100 8", preserveAspectRatio: "none" }, svg("defs", {}, svg("linearGradient", { id: "heat" }, stops.map((s) => svg("stop", { offset: s, "stop-color": css(s) })))), svg("rect", { width: 100, height: 8, fill: "url(#heat)" })),
    h("div", { class: "row" }, h("small", { class: "grow" }, values.low.toFixed(1)), h("small", {}, values.high.toFixed(1))),
  );
}

// --- messages ---

wrap.onRedraw(render);
sculpt.onRedraw(render);
onUnitWanted((wanted) => {
  const options = wanted.units.map((u) => wrap.UNITS.find(([known]) => known === u)!) as [string, string][];
  const choice = select(options, wanted.units[0]!, () => {}, { "data-key": "ask" });
  const client = app.open?.id ?? null;
  void dialog(wanted.text, [choice], "Use this unit", () => choice.value).then((unit) => {
    if (unit) send({ type: "add", role: wanted.role, files: wanted.files, unit: unit as Unit }, client);
  });
});

onChange((what) => {
  if (what === "plan" || what === "error" || what === "connection") sculpt.answered(what);
  // the number that was typed stays
  if (what === "unheard") return drawBar();
  if (what === "case" && mode === "analyse") analyse.enter();
  if (what === "case" && mode === "clients") send({ type: "list_cases", query: "" });
  if (what.startsWith("numbers:") && (mode === "clients" || mode === "knowledge")) return;
  // a live frame changes the picture, not the panel
  if (what === "numbers:plan" || (what === "numbers:wrapped" && app.progress)) return pictures();
  if (writing() && mode !== "wrap" && what !== "articles" && what !== "cases") return drawBar();
  render();
});

// --- files dropped on the page ---

function roleOf(files: File[]): Role | null {
  const endings = files.map((f) => f.name.toLowerCase().replace(/\.gz$/, "").split(".").pop() ?? "");
  const all = (list: string[]) => endings.every((e) => list.includes(e));
  const meshes = endings.filter((e) => ["obj", "ply", "stl", "off", "xyz", "glb", "gltf"].includes(e)).length;
  // one mesh with a JSON file may as well be a scan and its landmarks
  if (files.length > 1 && endings.some((e) => e === "npy" || (e === "json" && meshes > 1))) return "rig";
  if (all(["zip"])) return "case";
  if (all(["png", "jpg", "jpeg", "webp"])) return "photo";
  if (all(["npz"])) return "rig";
  return null;
}

async function dropped(files: File[]) {
  let role = roleOf(files);
  if (!role && files.length === 1 && files[0]!.name.toLowerCase().endsWith(".toml")) {
    // steps make a recipe, levels a schedule
    const text = await files[0]!.slice(0, 1 << 20).text();
    role = /^\s*\[\[\s*step\b/m.test(text) ? "recipe" : "schedule";
  }
  if (!role) {
    const roles: [Role, string][] = [
      ["scan", files.length > 1 ? "a scan and what belongs to it" : "a scan"],
      ["template", files.length > 1 ? "the template and what belongs to it" : "the template"],
      ["rig", "a rig"],
      ["scan_landmarks", "landmarks on the scan"],
      ["template_landmarks", "landmarks on the template"],
    ];
    const choice = select(roles as [string, string][], "scan", () => {}, { "data-key": "ask" });
    role = (await dialog(files.length === 1 ? `What is ${files[0]!.name}?` : `What are these ${files.length} files?`, [choice], "Add", () => choice.value)) as Role | null;
  }
  if (role) await addFiles(role, files);
}

/** The files of what was dropped; of a folder those directly in it. */
async function filesOf(items: DataTransferItemList): Promise<File[]> {
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter((e) => e !== null);
  const file = (entry: FileSystemEntry) => new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
  const files: File[] = [];
  for (const entry of entries) {
    if (entry.isFile) files.push(await file(entry));
    else {
      const reader = (entry as FileSystemDirectoryEntry).createReader();
      for (;;) {
        const inside = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
        if (inside.length === 0) break;
        for (const e of inside) if (e.isFile && !e.name.startsWith(".")) files.push(await file(e));
      }
    }
  }
  return files;
}

document.addEventListener("dragover", (event) => event.preventDefault());
document.addEventListener("drop", (event) => {
  event.preventDefault();
  if (event.dataTransfer) void filesOf(event.dataTransfer.items).then((files) => (files.length ? dropped(files) : undefined));
});

// --- keys ---

document.addEventListener("keydown", (event) => {
  const target = event.target as HTMLElement;
  const typing = target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement || (target instanceof HTMLInputElement && target.type !== "range" && target.type !== "checkbox");
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && !typing) {
    event.preventDefault();
    send({ type: event.shiftKey ? "redo" : "undo" });
    return;
  }
  if (event.altKey && event.key >= "1" && event.key <= "6") {
    event.preventDefault();
    go(MODES[Number(event.key) - 1]![0]);
    return;
  }
  if (typing || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const views: Record<string, number> = { "1": 0, "2": 45, "3": 90, "4": -90 };
  const onButton = target instanceof HTMLButtonElement && (event.key === "Enter" || event.key === " ");
  let done = true;
  if (event.key === "?") toggleHelp();
  else if (event.key in views) look(stage.panes, views[event.key]!);
  else if (event.key === "0") fitAll();
  else if (event.key === "w") options.wireframe = !options.wireframe;
  else if (event.key === "h") options.heat = !options.heat;
  else if (event.key === "Escape" && app.progress) send({ type: "cancel" });
  else if (onButton) done = false;
  else if (mode === "wrap") done = wrap.keys(event);
  else if (mode === "plan") done = sculpt.keys(event) || (event.key.length === 1 && plan.chooseShape(event.key));
  else done = false;
  if (done) {
    event.preventDefault();
    render();
  }
});
document.addEventListener("keyup", (event) => mode === "plan" && sculpt.keyUp(event));

// what the view turns, the drawing on it follows
stage.canvas.addEventListener("pointermove", () => mode === "plan" && sculpt.overlay());
stage.canvas.addEventListener("wheel", () => mode === "plan" && requestAnimationFrame(() => sculpt.overlay()));

// what runs ends with the window, and what waits for the server
window.addEventListener("beforeunload", (event) => (app.progress || unheard.length) && event.preventDefault());

connect();
render();
