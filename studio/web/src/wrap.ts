// Wrap: scan and template side by side, pairs of points, a run that is seen, and what it has come to.

import * as THREE from "three";
import { addFiles, app, copy, counted, edit, send, toast } from "./app";
import { ask, button, flag, h, row, section, select, slider, svg, toggle } from "./dom";
import type { Pair, Source, Unit, WrapSettings } from "./protocol";
import { options, stage, surfaceOf, views } from "./scene";
import { Pane, type Marker, type Tool } from "./stage";

const SKIN = 0xd9b79f;
const SCAN = 0xb7c3cc;
const state = { selected: "", auto: true, paint: 0 as 0 | 1 | -1, radius: 12, split: false, scanToo: false };

const scanPane = new Pane(views.scan, "Scan");
const resultPane = new Pane(views.scan, "Result");
const templatePane = new Pane(views.template, "Template");

function settings(): WrapSettings | null {
  return app.open?.case.wrap ?? null;
}

function pairs(): Pair[] {
  return settings()?.pairs ?? [];
}

/** The result, if it is that of the scan in work. */
function result() {
  return app.open?.current ? app.open.case.wrapped : null;
}

/** What the scan says at each template vertex counts so much; none for 1. */
let weights: Float32Array | null = null;
let shownMask: unknown = null;
const IGNORED: [number, number, number] = [0.15, 0.2, 0.35];

function ignored(w: Float32Array) {
  return { title: "mask", values: w.map((x) => 1 - x), low: 0, high: 1 };
}

export function show() {
  const scan = surfaceOf("scan", SCAN);
  const running = app.progress !== null && app.steps.length > 0;
  const wrapped = result() || running ? surfaceOf("wrapped", SKIN, { values: options.heat && !running }) : null;
  const mask = app.values.get("template");
  const template = surfaceOf("template", SKIN, { values: false });
  if (template && (mask !== shownMask || template !== templatePane.pick)) {
    weights = mask?.values.length === template.count ? mask.values.slice() : null;
    template.paint(weights && ignored(weights), IGNORED);
    shownMask = mask;
  }
  if (scan) {
    const material = scan.mesh.material as THREE.MeshStandardMaterial;
    material.transparent = !!wrapped && !state.split;
    material.opacity = material.transparent ? 0.45 : 1;
    scan.wireframe = false;
  }
  const both = options.overlay && !state.split;
  // colours of distance are read on the template alone
  const alone = both && wrapped !== null && options.heat && !running && !state.scanToo;
  scanPane.pick = scan;
  scanPane.show([alone ? null : scan, both ? wrapped : null]);
  if (wrapped && state.split) resultPane.show([wrapped]);
  templatePane.pick = template;
  templatePane.show([template]);
  scanPane.title = app.meshes.has("scan") ? alone ? "Wrapped template" : `Scan${thinned()}${both && wrapped ? " and wrapped template" : ""}` : "Scan: drop one here";
  templatePane.title = template ? "Template" : "Template: drop a mesh or a rig here";
  const panes = wrapped && state.split ? [scanPane, resultPane, templatePane] : [scanPane, templatePane];
  if (stage.panes.length !== panes.length || stage.panes.some((p, k) => p !== panes[k])) {
    stage.show(panes);
    for (const pane of panes) if (!pane.view.fitted && pane.surfaces.length) pane.fit();
  }
  mark();
  stage.draw();
}

function thinned(): string {
  const mesh = app.meshes.get("scan");
  const shown = mesh ? mesh.triangles.length / 3 : 0;
  return mesh && mesh.of > shown ? ` (${shown.toLocaleString("en")} of ${mesh.of.toLocaleString("en")} triangles shown)` : "";
}

function colour(pair: Pair): number {
  if (pair.name === state.selected) return 0x0b62d6;
  return pair.doubt ? 0xe08a00 : pair.vertex !== null && pair.target !== null ? 0x1d8a4a : 0xb3261e;
}

function mark() {
  const template = templatePane.pick;
  const onScan: Marker[] = [];
  const onTemplate: Marker[] = [];
  for (const pair of pairs()) {
    if (pair.target) onScan.push({ name: pair.name, at: new THREE.Vector3(...pair.target), color: colour(pair) });
    if (template && pair.vertex !== null && pair.vertex < template.count) onTemplate.push({ name: pair.name, at: template.vertex(pair.vertex), color: colour(pair) });
  }
  scanPane.selected = templatePane.selected = state.selected;
  scanPane.mark(onScan);
  templatePane.mark(onTemplate);
}

let held: string | null = null;
let at: THREE.Vector3 | null = null;

const tool: Tool = {
  down(pane, event) {
    if (state.paint !== 0 && pane === templatePane) {
      weights ??= startWeights();
      stroke(pane, event);
      return true;
    }
    held = pane.markerAt(event, stage.canvas);
    at = null;
    if (held === null) return false;
    state.selected = held;
    mark();
    return true;
  },
  move(pane, event) {
    if (state.paint !== 0 && pane === templatePane) return stroke(pane, event);
    const hit = pane.hit(event, stage.canvas);
    if (held === null || !hit) return;
    at = pane === templatePane ? pane.pick!.vertex(hit.vertex) : hit.point;
    pane.moveMarker(held, at);
  },
  up(pane) {
    if (state.paint !== 0 && pane === templatePane && weights) {
      send({ type: "paint_mask", weights: Array.from(weights) });
      return;
    }
    if (held !== null && at) place(pane, held, at);
    held = null;
    redraw();
  },
  click(pane, event) {
    const hit = pane.hit(event, stage.canvas);
    if (hit) place(pane, null, hit.point);
    else if (state.selected) {
      state.selected = "";
      redraw();
    }
  },
};
scanPane.tool = resultPane.tool = templatePane.tool = tool;
resultPane.tool = null;

/** After a landmark has moved, goes on from the last result. */
let solveAgain = false;

function place(pane: Pane, name: string | null, point: THREE.Vector3) {
  const side = pane === templatePane ? "template" : "scan";
  solveAgain = state.auto && name !== null && result() !== null && side === "scan";
  send({ type: "place", name: name ?? wanting(side), side, point: point.toArray() });
  if (solveAgain) send({ type: "run", warm: true });
}

/** The selected pair, if it lacks this side. */
function wanting(side: "template" | "scan"): string | null {
  const pair = pairs().find((p) => p.name === state.selected);
  return pair && (side === "scan" ? pair.target : pair.vertex) === null ? pair.name : null;
}

// --- painting what counts ---

function startWeights(): Float32Array {
  return new Float32Array(templatePane.pick?.count ?? 0).fill(1);
}

function stroke(pane: Pane, event: PointerEvent) {
  const hit = pane.hit(event, stage.canvas);
  const surface = pane.pick;
  if (!hit || !surface || !weights) return;
  const to = (event.altKey ? -state.paint : state.paint) > 0 ? 1 : 0;
  for (let v = 0; v < surface.count; v++) {
    const d = surface.vertex(v).distanceTo(hit.point) / state.radius;
    if (d < 1) weights[v] = weights[v]! + (to - weights[v]!) * Math.min(1, 2 * (1 - d));
  }
  surface.paint(ignored(weights), IGNORED);
}

let redraw: () => void = () => {};

export function onRedraw(f: () => void) {
  redraw = f;
}

export function keys(event: KeyboardEvent): boolean {
  if ((event.key === "Delete" || event.key === "Backspace") && state.selected) {
    edit({ edit: "remove_pair", name: state.selected });
    state.selected = "";
    return true;
  }
  if (event.key === "Enter") {
    run(false);
    return true;
  }
  return false;
}

function run(warm: boolean) {
  if (app.progress) return;
  send({ type: "run", warm });
}

export const UNITS: [Unit, string][] = [
  ["mm", "mm"],
  ["cm", "cm"],
  ["m", "m"],
  ["um", "µm"],
  ["in", "inch"],
];

function unitOf(title: string, source: Source, which: "template" | "rig" | "scan") {
  return select(UNITS, source.unit, (unit) => edit({ edit: "set_unit", which, unit: unit as Unit }), { title: "Unit of the file's lengths", "aria-label": `unit of ${title}` });
}

function fileRow(title: string, source: Source | null, which: "template" | "rig" | "scan", add: () => void) {
  return h(
    "div",
    { class: "row" },
    h("b", {}, title),
    h("span", { class: "grow clip", title: source?.name ?? "" }, source?.name ?? "none"),
    source && unitOf(title, source, which),
    button(source ? "Change" : "Add", add),
  );
}

export function pickFiles(role: Parameters<typeof addFiles>[0], accept: string, folder = false) {
  const input = h("input", { type: "file", accept: folder ? undefined : accept, multiple: true });
  if (folder) input.webkitdirectory = true;
  input.onchange = () => {
    // of a folder those directly in it
    const direct = (file: File) => file.webkitRelativePath.split("/").length <= 2;
    const files = [...(input.files ?? [])].filter((file) => !file.name.startsWith(".") && direct(file));
    if (files.length) void addFiles(role, files);
  };
  input.click();
}

/** Meshes, and what lies beside them. */
export const MESHES = ".obj,.ply,.stl,.off,.xyz,.gz,.glb,.gltf,.bin,.mtl,.png,.jpg,.jpeg";

export function panel(): HTMLElement[] {
  const open = app.open;
  if (!open) return [];
  const { case: c, regions } = open;
  const wrap = c.wrap;
  const running = app.progress !== null;
  const done = result();
  const change = (part: Partial<WrapSettings>) => edit({ edit: "set_wrap", settings: { ...wrap, ...part } });
  const whole = pairs().filter((p) => p.vertex !== null && p.target !== null).length;
  const scans: [string, string][] = counted(c.scans).map((name, k) => [String(k), name]);
  const files = section(
    "Files",
    fileRow("Template", c.template, "template", () => pickFiles("template", MESHES)),
    h("div", { class: "row" }, h("b", {}, "Rig"), h("span", { class: "grow clip" }, c.rig?.name ?? "none"), c.rig && unitOf("Rig", c.rig, "rig"), button("Folder", () => pickFiles("rig", "", true), { title: "A folder of shapes or .npy arrays" }), button("File", () => pickFiles("rig", ".npz,.glb,.gltf"), { title: "A rig in one file: .npz or .glb" })),
    fileRow("Scan", c.scan === null ? null : (c.scans[c.scan] ?? null), "scan", () => pickFiles("scan", MESHES)),
    c.scans.length > 1 && select(scans, String(c.scan), (k) => edit({ edit: "use_scan", index: Number(k) }), { "aria-label": "scan in work" }),
  );
  const landmarks = section(
    `Landmarks: ${whole} of ${pairs().length} pairs`,
    h("p", { class: "hint" }, "Click a point on the scan and the same point on the template. Drag a point to correct it."),
    h(
      "div",
      { class: "row wrap" },
      button("Suggest", () => send({ type: "suggest" }), { disabled: running || !c.rig || c.scan === null, title: c.rig ? "Places the rig's 68 landmarks on the scan" : "Needs a rig with 68 landmarks" }),
      button("Load on scan", () => pickFiles("scan_landmarks", "")),
      button("Load on template", () => pickFiles("template_landmarks", "")),
      button("Save", () => send({ type: "export", what: { export: "landmarks" } }), { disabled: whole === 0 }),
      button("Clear", () => edit({ edit: "set_pairs", pairs: [] }), { disabled: pairs().length === 0 }),
    ),
    h(
      "div",
      { class: "list", "data-key": "pairs" },
      pairs().map((pair) =>
        h(
          "div",
          {
            class: `item ${pair.name === state.selected ? "selected" : ""}`,
            title: pair.doubt ?? "",
            ...row(pair.name === state.selected, () => {
              state.selected = pair.name;
              focusOn(pair);
              redraw();
            }),
          },
          h("i", { class: `dot c${colour(pair).toString(16).padStart(6, "0")}` }),
          h("span", { class: "grow clip" }, pair.name, pair.doubt && h("small", { class: "doubt" }, ` ${pair.doubt}`)),
          h("small", {}, pair.target === null ? "not on scan" : pair.vertex === null ? "not on template" : partner(pair)),
          button("✎", () => void rename(pair), { title: "Another name", "aria-label": `rename ${pair.name}` }),
          button("×", () => edit({ edit: "remove_pair", name: pair.name }), { title: "Remove", "aria-label": `remove ${pair.name}` }),
        ),
      ),
    ),
  );
  const bounds = (name: "expression_bounds" | "identity_bounds", label: string, usual: [number, number]) =>
    h("label", { class: "row" }, h("input", { type: "checkbox", checked: wrap[name] !== null, onchange: () => change({ [name]: wrap[name] === null ? usual : null }) }), `${label} between ${usual[0]} and ${usual[1]}`);
  const chips = (name: "regions" | "free_regions") =>
    h(
      "div",
      { class: "row wrap" },
      regions.map((region) => {
        const on = wrap[name].includes(region);
        return toggle(region.replaceAll("_", " "), on, () => change({ [name]: on ? wrap[name].filter((r) => r !== region) : [...wrap[name], region] }), { class: on ? "chip on" : "chip" });
      }),
    );
  const how = h(
    "details",
    { "data-key": "how" },
    h("summary", {}, "How"),
    h("label", { class: "row" }, "Model", select([["", "automatic"], ...(app.welcome?.models ?? [])], wrap.model ?? "", (model) => change({ model: model || null }), { title: "automatic: hybrid with a rig, sumner without" })),
    h(
      "div",
      { class: "row" },
      h("span", {}, "Schedule"),
      h("span", { class: "grow clip", title: wrap.schedule?.file ?? "" }, wrap.schedule?.file ?? "the model's own"),
      wrap.schedule && button("×", () => change({ schedule: null }), { title: "The model's own schedule again", "aria-label": "remove the schedule" }),
      button("File", () => pickFiles("schedule", ".toml"), { title: "A schedule of one's own (.toml), as --config of nonrigid register" }),
    ),
    c.rig && slider({ key: "modes", label: "Identity modes", min: 0, max: 100, step: 1, value: wrap.identity_modes, unit: "", done: (identity_modes) => change({ identity_modes: Math.round(identity_modes) }) }),
    c.rig && bounds("expression_bounds", "Expressions", [0, 1]),
    c.rig && bounds("identity_bounds", "Identity", [-3, 3]),
    regions.length > 0 && [h("p", {}, "Look at the scan only in"), chips("regions"), h("p", {}, "Free, following smoothness alone"), chips("free_regions")],
    h("p", {}, "Paint on the template what the scan shall not say (hair, hands)"),
    h(
      "div",
      { class: "row wrap" },
      toggle("Ignore", state.paint === -1, () => paintMode(-1)),
      toggle("Count", state.paint === 1, () => paintMode(1)),
      button("All counts", () => send({ type: "paint_mask", weights: null }), { disabled: wrap.mask === null }),
    ),
    state.paint !== 0 && slider({ key: "radius", label: "Brush", min: 2, max: 40, step: 1, value: state.radius, done: (r) => (state.radius = r) }),
  );
  const runRow = h(
    "div",
    { class: "row" },
    button("Wrap", () => run(false), { class: "main grow", disabled: running || !c.template || c.scan === null, title: "Enter" }),
    button("Solve again", () => run(true), { disabled: running || !done, title: "Goes on from the last result, as after a corrected landmark" }),
  );
  const autoRow = h("label", { class: "row" }, h("input", { type: "checkbox", checked: state.auto, onchange: () => (state.auto = !state.auto) }), "solve again when a landmark was moved");
  return [files, landmarks, section("Wrap", how, runRow, autoRow, curves()), done ? outcome() : h("p", { class: "hint" }, "No result on this scan yet.")].filter((x) => x !== null);
}

function paintMode(mode: 1 | -1) {
  state.paint = state.paint === mode ? 0 : mode;
  redraw();
}

function partner(pair: Pair): string {
  const template = templatePane.pick;
  if (!template || pair.vertex === null || pair.vertex >= template.count) return "";
  const at = template.vertex(pair.vertex);
  const centre = template.box.getCenter(new THREE.Vector3());
  const mirror = new THREE.Vector3(2 * centre.x - at.x, at.y, at.z);
  if (Math.abs(at.x - centre.x) < 2) return "midline";
  let best: Pair | null = null;
  let least = 4;
  for (const other of pairs()) {
    if (other === pair || other.vertex === null || other.vertex >= template.count) continue;
    const d = template.vertex(other.vertex).distanceTo(mirror);
    if (d < least) [best, least] = [other, d];
  }
  return best ? `↔ ${best.name}` : "";
}

function focusOn(pair: Pair) {
  if (pair.target && scanPane.surfaces.length) views.scan.target.set(...pair.target);
  const template = templatePane.pick;
  if (template && pair.vertex !== null && pair.vertex < template.count) views.template.target.copy(template.vertex(pair.vertex));
}

async function rename(pair: Pair) {
  const to = await ask("Name of the landmark", pair.name);
  if (to && to !== pair.name) edit({ edit: "rename_pair", name: pair.name, to });
}

/** Energy and inliers of the run, step by step. */
function curves(): HTMLElement | null {
  const steps = app.steps;
  if (steps.length === 0) return null;
  const [width, height] = [300, 74];
  const most = Math.max(...steps.map((s) => Math.log10(Math.max(s.energy, 1e-12))));
  const least = Math.min(...steps.map((s) => Math.log10(Math.max(s.energy, 1e-12))));
  const x = (k: number) => (k / Math.max(steps.length - 1, 1)) * (width - 8) + 4;
  const line = (value: (k: number) => number) => steps.map((_, k) => `${x(k).toFixed(1)},${(height - 6 - value(k) * (height - 12)).toFixed(1)}`).join(" ");
  const energy = line((k) => (Math.log10(Math.max(steps[k]!.energy, 1e-12)) - least) / Math.max(most - least, 1e-9));
  const inliers = line((k) => steps[k]!.inliers);
  const levels = steps.flatMap((s, k) => (k > 0 && steps[k - 1]!.level !== s.level ? [svg("line", { x1: x(k), x2: x(k), y1: 0, y2: height, class: "grid" })] : []));
  const last = steps[steps.length - 1]!;
  return h(
    "figure",
    {},
    svg("svg", { viewBox: `0 0 ${width} ${height}`, class: "curves" }, levels, svg("polyline", { points: energy, class: "energy" }), svg("polyline", { points: inliers, class: "inliers" })),
    h("figcaption", {}, h("span", { class: "energy" }, `energy ${last.energy.toPrecision(3)} (log)`), " ", h("span", { class: "inliers" }, `on the scan ${(100 * last.inliers).toFixed(0)} %`), ` level ${last.level} of ${last.levels}, moved ${last.motion.toFixed(2)} mm`),
  );
}

interface Weight {
  name: string;
  value: number;
  std_dev: number | null;
  at_bound: boolean;
}

const reports = new Map<string, Weight[]>();

function outcome(): HTMLElement {
  const wrapped = result()!;
  const { summary } = wrapped;
  const key = wrapped.report.asset;
  if (!reports.has(key)) {
    reports.set(key, []);
    fetch(`/files/${key}/${wrapped.report.file}`)
      .then((answer) => answer.json())
      .then((report: { weights: Weight[] }) => {
        reports.set(key, report.weights);
        redraw();
      })
      .catch(() => toast("The report of this result cannot be read; wrap again.", "error"));
  }
  const list = [...(reports.get(key) ?? [])].sort((a, b) => Math.abs(b.value) - Math.abs(a.value));
  const percent = (share: number) => `${(100 * share).toFixed(1)} %`;
  const save = (format: string) => button(format, () => send({ type: "export", what: { export: "wrapped", format } }));
  return section(
    "Result",
    h(
      "table",
      { class: "numbers" },
      h("tr", {}, h("td", {}, "within 3 mm of the scan"), h("td", {}, percent(summary.within))),
      h("tr", {}, h("td", {}, "their median distance"), h("td", {}, `${summary.median.toFixed(3)} mm`)),
      h("tr", {}, h("td", {}, "triangles turned over"), h("td", {}, String(summary.flipped))),
      h("tr", {}, h("td", { title: "The error exceeds 3 mm on a face, the same share of the size on other subjects" }, "probably wrong"), h("td", {}, percent(summary.probability))),
    ),
    summary.doubts.map((doubt) => h("p", { class: "doubt" }, doubt)),
    h(
      "div",
      { class: "row wrap" },
      flag("Heat map", options, "heat", redraw, { title: "H" }),
      flag("Polygons", options, "wireframe", redraw, { title: "W" }),
      flag("Split", state, "split", redraw),
      flag("Scan too", state, "scanToo", redraw, { title: "The scan through the coloured template" }),
    ),
    h("div", { class: "row wrap" }, h("span", {}, "Save as"), save("obj"), save("ply"), save("glb"), button("Copy as command", () => void copy(app.open?.command ?? ""), { title: app.open?.command ?? "" })),
    list.length > 0 &&
      h(
        "details",
        { "data-key": "weights" },
        h("summary", {}, `${list.length} weights`),
        h(
          "table",
          { class: "numbers weights" },
          list.map((w) => h("tr", { class: w.at_bound ? "bound" : "" }, h("td", {}, w.name), h("td", {}, h("meter", { min: 0, max: 3, value: Math.abs(w.value) })), h("td", {}, w.value.toFixed(2)), h("td", {}, w.at_bound ? "at bound" : w.std_dev === null ? "" : `± ${w.std_dev.toFixed(2)}`))),
        ),
      ),
  );
}
