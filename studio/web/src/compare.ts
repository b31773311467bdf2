// Compare: several models on the same scan, in linked views, with a table of errors and times.

import { app, send } from "./app";
import { button, flag, h, section, toggle } from "./dom";
import { options, stage, surfaceOf, views } from "./scene";
import { Pane } from "./stage";

const chosen = new Set(["hybrid", "blendshape", "graph", "arap"]);
const panes = new Map<string, Pane>();
const scan = new Pane(views.scan, "Scan");

export function show() {
  const list = [scan];
  scan.show([surfaceOf("scan", 0xb7c3cc, { key: "compare" })]);
  for (const row of app.compared) {
    if (!row.summary) continue;
    let pane = panes.get(row.model);
    if (!pane) panes.set(row.model, (pane = new Pane(views.scan, row.model)));
    pane.title = `${row.model}: ${(100 * row.summary.within).toFixed(1)} % within 3 mm`;
    pane.show([surfaceOf(`compare/${row.model}`, 0xd9b79f, { values: options.heat })]);
    list.push(pane);
  }
  if (stage.panes.length !== list.length || stage.panes.some((p, k) => p !== list[k])) {
    stage.show(list);
    scan.fit();
  }
  stage.draw();
}

export function panel(redraw: () => void): HTMLElement[] {
  const c = app.open?.case;
  if (!c) return [];
  const ready = c.template !== null && c.scan !== null;
  return [
    section(
      "Models",
      h(
        "div",
        { class: "row wrap" },
        (app.welcome?.models ?? []).map((model) =>
          toggle(model, chosen.has(model), () => {
            if (!chosen.delete(model)) chosen.add(model);
            redraw();
          }, { class: chosen.has(model) ? "chip on" : "chip" }),
        ),
      ),
      button("Compare", () => {
        app.compared = [];
        send({ type: "compare", models: (app.welcome?.models ?? []).filter((m) => chosen.has(m)) });
      }, { class: "main", disabled: !ready || app.progress !== null || chosen.size === 0 }),
      !ready && h("p", { class: "hint" }, "Needs a template and a scan: add them under Wrap."),
      h("p", { class: "hint" }, "Each starts anew with the landmarks that have both sides, and the model's own schedule."),
      h("div", { class: "row" }, flag("Heat map", options, "heat", redraw), flag("Polygons", options, "wireframe", redraw)),
    ),
    section(
      "Table",
      h(
        "table",
        { class: "numbers" },
        h("tr", {}, ["model", "% in 3 mm", "median", "p95", "turned", "wrong", "s"].map((t) => h("th", {}, t))),
        app.compared.map((row) =>
          row.summary
            ? h("tr", {}, h("td", {}, row.model), h("td", {}, (100 * row.summary.within).toFixed(1)), h("td", {}, row.summary.median.toFixed(3)), h("td", {}, row.summary.p95.toFixed(2)), h("td", {}, String(row.summary.flipped)), h("td", {}, `${(100 * row.summary.probability).toFixed(0)} %`), h("td", {}, row.seconds.toFixed(2)))
            : h("tr", {}, h("td", {}, row.model), h("td", { colspan: 6, class: "doubt" }, row.error)),
        ),
      ),
      h("small", {}, "Share of the vertices within 3 mm of the scan; their median and the 95th percentile of all distances, mm; turned: triangles turned over; wrong: probability that the error exceeds 3 mm on a face, the same share of the size on other subjects."),
    ),
  ];
}
