// Analyse: measurements of the face and its plans, drawn on it; outlines over each other; a report to print.

import * as THREE from "three";
import { app, belongs, counted, faceShown, send, toast } from "./app";
import { button, h, row as rowToChoose, section, svg, toggle } from "./dom";
import type { Analysis, MeasureRow } from "./protocol";
import { stage, surfaceOf, views } from "./scene";
import { Pane, lookFrom } from "./stage";

const pane = new Pane(views.face, "Measurements");
/** As many are measured at once, and have a colour. */
const MOST_PLANS = 6;
const state = { after: false, chosen: null as string | null, group: "all", plans: null as Set<number> | null };

belongs("client", () => ([state.plans, state.chosen] = [null, null]));

function plans(): number[] {
  const c = app.open?.case;
  if (!c) return [];
  const known = c.plans.map((p) => p.id);
  return known.filter((id) => (state.plans ?? new Set([c.plan])).has(id));
}

/** Measures anew; until the answer comes, nothing is known: an error leaves no older numbers on another face. */
export function enter() {
  app.analysis = null;
  send({ type: "analyse", plans: plans() });
}

function shown(a: Analysis): MeasureRow[] {
  return a.rows.filter((row) => (state.group === "all" || row.group === state.group) && row.values[0] !== null);
}

export function show() {
  const surface = surfaceOf(state.after ? "plan" : "face", 0xd9b79f, { values: false, key: "analyse" });
  pane.show([surface]);
  const plan = app.open?.case.plans.find((p) => p.id === app.open?.case.plan);
  pane.title = surface ? (state.after ? (plan?.name ?? "After") : "Before") : "No face yet";
  pane.extras.clear();
  const a = app.analysis;
  if (a) {
    // of the plan in work, where it is measured
    const column = state.after ? 1 + a.plans.indexOf(app.open?.case.plan ?? -1) : 0;
    for (const row of state.after && column === 0 ? [] : shown(a)) {
      const joined = row.lines[column] ?? [];
      if (joined.length < 2) continue;
      const strong = row.name === state.chosen;
      if (!strong && state.group === "all" && state.chosen !== null) continue;
      const points = joined.map((p) => new THREE.Vector3(...p));
      const material = new THREE.LineBasicMaterial({ color: strong ? 0x0b62d6 : 0x1f3a4d, depthTest: false, transparent: true, opacity: strong ? 1 : 0.45 });
      const line = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), material);
      line.renderOrder = 2;
      pane.extras.add(line);
    }
  }
  if (stage.panes.length !== 1 || stage.panes[0] !== pane) stage.show([pane]);
  stage.draw();
}

const COLOURS = ["#3c4a55", "#c2410c", "#0b62d6", "#1d8a4a", "#8b2fb0", "#b38600", "#0e7490"];

/** Outlines of the midline over each other, with E-line and the vertical through the subnasale. */
export function profile(a: Analysis): SVGElement | HTMLElement {
  const all = a.profiles.flatMap((p) => p.pieces);
  if (all.length === 0) return h("p", { class: "hint" }, "No outline: nasion, menton and pairs of landmarks are needed for the midline.");
  const points = a.profiles[0]!.points;
  const find = (name: string, of = points) => of.find((p) => p[0] === name);
  // what lies before the ears
  const front = Math.max(...all.map((p) => p[0])) + 6;
  const low = Math.min(...points.map((p) => p[2])) - 20;
  const high = Math.max(...points.map((p) => p[2])) + 25;
  const back = front - 0.55 * (high - low);
  const y = (up: number) => high - up;
  const x = (forward: number) => forward - back;
  const path = (pieces: [number, number, number, number][]) =>
    pieces
      .filter((p) => p[0] > back && p[1] > low && p[1] < high)
      .map((p) => `M${x(p[0]).toFixed(2)},${y(p[1]).toFixed(2)}L${x(p[2]).toFixed(2)},${y(p[3]).toFixed(2)}`)
      .join("");
  const lines: SVGElement[] = [];
  const last = a.profiles[a.profiles.length - 1]!.points;
  const [tip, chin, sub] = ["pronasale", "pogonion", "subnasale"].map((name) => find(name, last));
  if (tip && chin) lines.push(svg("line", { x1: x(tip[1]), y1: y(tip[2]), x2: x(chin[1]), y2: y(chin[2]), class: "helper" }));
  if (sub) lines.push(svg("line", { x1: x(sub[1]), y1: 0, x2: x(sub[1]), y2: high - low, class: "helper dashed" }));
  return svg(
    "svg",
    { viewBox: `0 0 ${(front - back).toFixed(1)} ${(high - low).toFixed(1)}`, class: "profile" },
    lines,
    a.profiles.map((p, k) => svg("path", { d: path(p.pieces), stroke: COLOURS[k % COLOURS.length], class: "outline" })),
    points.map((p) => svg("g", {}, svg("circle", { cx: x(p[1]), cy: y(p[2]), r: 0.8, class: "point" }), svg("title", {}, p[0]))),
  );
}

function cell(row: MeasureRow, k: number): HTMLElement {
  const value = row.values[k] ?? null;
  if (value === null) return h("td", { title: row.missing }, "–");
  const first = row.values[0] ?? null;
  const change = k > 0 && first !== null ? value - first : 0;
  const outside = row.typical !== null && (value < row.typical[0] || value > row.typical[1]);
  return h("td", { class: outside ? "outside" : "", title: row.typical ? `typical ${row.typical[0]} to ${row.typical[1]}: ${row.source}` : row.formula }, value.toFixed(1), Math.abs(change) >= 0.05 && h("small", {}, ` ${change > 0 ? "+" : ""}${change.toFixed(1)}`));
}

export function table(a: Analysis, rows: MeasureRow[], onclick?: (row: MeasureRow) => void): HTMLElement {
  return h(
    "table",
    { class: "numbers measures" },
    h("thead", {}, h("tr", {}, h("th", {}, ""), a.columns.map((c) => h("th", {}, c)), h("th", {}, "typical"))),
    h(
      "tbody",
      {},
      rows.map((row, k) => [
        rows[k - 1]?.group !== row.group && h("tr", { class: "group" }, h("td", { colspan: a.columns.length + 2 }, row.group)),
        h("tr", { class: row.name === state.chosen ? "selected" : "", title: row.formula, ...(onclick && rowToChoose(row.name === state.chosen, () => onclick(row))) }, h("td", {}, row.name), a.columns.map((_, i) => cell(row, i)), h("td", { title: row.source }, row.typical ? `${row.typical[0]}–${row.typical[1]}` : "", h("small", {}, ` ${row.unit}`))),
      ]),
    ),
  );
}

export function panel(redraw: () => void): HTMLElement[] {
  const c = app.open?.case;
  if (!c) return [];
  const a = app.analysis;
  const wanted = new Set(plans());
  const names = counted(c.plans);
  const groups = ["all", ...new Set((a?.rows ?? []).map((r) => r.group))];
  return [
    section(
      "Plans",
      faceShown(),
      h("div", { class: "row wrap" }, c.plans.map((p, k) => toggle(names[k]!, wanted.has(p.id), () => {
        if (!wanted.delete(p.id)) {
          if (wanted.size >= MOST_PLANS) return toast(`${MOST_PLANS} plans at most are measured and printed beside each other: take one out first.`, "error");
          wanted.add(p.id);
        }
        state.plans = wanted;
        enter();
        redraw();
      }, { class: wanted.has(p.id) ? "chip on" : "chip" }))),
      h("div", { class: "row" }, toggle("Before", !state.after, () => {
        state.after = false;
        redraw();
      }), toggle("After", state.after, () => {
        state.after = true;
        redraw();
      }), button("Print report", () => print(a), { disabled: !a, class: "main" })),
    ),
    a
      ? section(
          "Profile",
          profile(a),
          h("div", { class: "row wrap" }, a.columns.map((name, k) => h("span", { class: `key k${k % 7}` }, name)), h("small", {}, "straight: E-line; dashed: vertical through subnasale")),
        )
      : h("p", { class: "hint" }, "Measuring; if nothing comes, the message below says what is missing."),
    a &&
      section(
        "Measurements",
        h("div", { class: "row wrap" }, groups.map((group) => toggle(group, state.group === group, () => {
          state.group = group;
          redraw();
        }, { class: state.group === group ? "chip on" : "chip" }))),
        table(a, shown(a), (row) => {
          state.chosen = state.chosen === row.name ? null : row.name;
          redraw();
        }),
        h("small", {}, "Red: outside the typical range, whose source a hover names."),
      ),
    a &&
      section(
        "Regions",
        h(
          "table",
          { class: "numbers" },
          h("tr", {}, ["", "area", "asymmetry", ...a.columns.slice(1).flatMap((name) => [`${name}: volume`, "largest"])].map((t) => h("th", {}, t))),
          a.regions.map((r) => h("tr", {}, h("td", {}, r.name.replaceAll("_", " ")), h("td", {}, `${(r.area / 100).toFixed(1)} cm²`), h("td", {}, `${r.asymmetry.toFixed(2)} mm`), r.plans.flatMap((p) => [h("td", {}, `${(p[2] / 1000).toFixed(2)} cm³`), h("td", {}, `${p[3].toFixed(2)} mm`)]))),
        ),
      ),
  ].filter((x) => x !== null);
}

/** A page for the client, and the browser's dialog to print it. */
export function print(a: Analysis | null) {
  const c = app.open?.case;
  if (!a || !c) return;
  const keep = views.face.turn.clone();
  const height = views.face.height;
  const shots: HTMLElement[] = [];
  const axes = app.plan?.frame?.axes as [number, number, number][] | undefined;
  pane.extras.visible = false;
  const plan = c.plans.find((p) => p.id === c.plan);
  for (const [slot, name] of [["face", "before"], ["plan", plan?.name ?? "after"]] as const) {
    pane.show([surfaceOf(slot, 0xd9b79f, { values: false, key: "analyse" })]);
    pane.fit();
    for (const [yaw, side] of [[0, "front"], [45, "from the left"], [90, "left"]] as const) {
      lookFrom(views.face, yaw, 0, axes);
      shots.push(h("figure", {}, h("img", { src: stage.picture(pane, 420), alt: `${name}, ${side}` }), h("figcaption", {}, `${name}, ${side}`)));
    }
  }
  pane.extras.visible = true;
  views.face.turn.copy(keep);
  views.face.height = height;
  show();
  const torn = (app.plan?.steps ?? []).filter((_, k) => app.plan?.results[k]?.tears).map((s) => s.name);
  document.getElementById("print")?.remove();
  const page = h(
    "article",
    { id: "print" },
    h("h1", {}, c.name),
    h("p", {}, `${c.date || new Date().toLocaleDateString("sv")}${plan ? `, ${plan.name}` : ""}`),
    faceShown(),
    c.notes && h("p", { class: "notes" }, c.notes),
    h("div", { class: "shots" }, shots),
    h("h2", {}, "Steps"),
    h("ol", {}, (app.plan?.steps ?? []).map((s) => h("li", {}, `${s.name}: ${s.preset ? `${s.amount.toFixed(1)} mm` : s.displacement ? `${(s.amount * Math.hypot(...s.displacement)).toFixed(1)} mm` : s.model}${s.side === "both" ? "" : `, ${s.side} side`}`))),
    torn.length > 0 && h("p", { class: "doubt" }, `${torn.join(", ")}: the surface folds or tears.`),
    h("h2", {}, "Profile"),
    profile(a),
    h("h2", {}, "Measurements"),
    table(a, a.rows.filter((r) => r.values[0] !== null)),
    h("p", { class: "small" }, "A simulation on the surface of the face: no forecast of an operation's outcome."),
  );
  document.body.append(page);
  window.print();
}
