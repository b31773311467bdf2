// The panel of a plan: ready operations as sliders, fine sculpting, the steps in their order, several plans beside each other.

import { app, belongs, copy, counted, faceShown, onChange, preview, send, shown, toast } from "./app";
import { ask, button, dialog, flag, h, section, select, slider, sure, toggle } from "./dom";
import type { Edit, Mask, Preset, Side, StepResult } from "./protocol";
import { options } from "./scene";
import { ahead, blend, discard, draft, dropSketch, edit, keep, origin, overlay, redraw, showDraft, state, unlike, type Action, type Draft } from "./sculpt";
import { pickFiles } from "./wrap";

export function panel(): HTMLElement[] {
  const open = app.open;
  if (!open) return [];
  const tabs: [typeof state.tab, string][] = [
    ["smart", "Smart operations"],
    ["draw", "Fine sculpting"],
    ["steps", `Steps (${app.plan?.steps.length ?? 0})`],
  ];
  const row = h("div", { class: "tabs", role: "tablist" }, tabs.map(([tab, text]) => h("button", { role: "tab", "aria-selected": String(tab === state.tab), onclick: () => {
    state.tab = tab;
    redraw();
  } }, text)));
  const part = { smart: readySection, draw: drawSection, steps: stepsSection }[state.tab]();
  return [plansSection(), row, part, saveSection()];
}

/** What went wrong stands under every tab. */
function trouble(): HTMLElement | null {
  const { error, results = [], steps = [] } = app.plan ?? {};
  const bad = steps.filter((_, k) => torn(results[k])).map((s) => s.name);
  if (error) return h("p", { class: "doubt", role: "alert" }, error);
  return bad.length ? h("p", { class: "doubt", role: "alert" }, `${bad.join(", ")}: the surface folds or tears; see Steps.`) : null;
}

function torn(r: StepResult | undefined): boolean {
  return r?.tears === true;
}

function plansSection(): HTMLElement {
  const c = app.open!.case;
  const current = c.plans.find((p) => p.id === c.plan);
  const on = shown();
  const names = counted(c.plans);
  const plans: [string, string][] = c.plans.map((p, k) => [String(p.id), names[k]!]);
  return section(
    "Plan",
    faceShown(),
    h(
      "div",
      { class: "row" },
      select(plans, String(c.plan), (id) => edit({ edit: "use_plan", id: Number(id) }), { class: "grow", "aria-label": "plan in work" }),
      button("New", () => void ask("Name of the new plan", `Plan ${String.fromCharCode(65 + (c.plans.length % 26))}`).then((name) => name && edit({ edit: "new_plan", name, copy_of: null, recipe: null }))),
      button("Copy", () => void ask("Name of the copy", `${current?.name} 2`).then((name) => name && edit({ edit: "new_plan", name, copy_of: c.plan, recipe: null }))),
      button("Name", () => void ask("Name of the plan", current?.name).then((name) => name && edit({ edit: "rename_plan", name }, on))),
      button("×", () => void sure(`Remove ${current?.name}? Undo brings it back.`, "Remove").then((yes) => yes && edit({ edit: "remove_plan", id: c.plan }, on)), { disabled: c.plans.length < 2, title: "Remove this plan", "aria-label": "remove plan" }),
    ),
    h(
      "div",
      { class: "row" },
      flag("Split", state, "split", redraw, { title: "The shape below, before or another plan, beside this plan" }),
      flag("Before", state, "before", redraw, { title: "Hold B" }),
      flag("Polygons", options, "wireframe", redraw, { title: "W" }),
      toggle("Difference", state.difference, () => {
        state.difference = !state.difference;
        if (state.difference) blend();
        else preview(null);
        redraw();
      }, { title: "How far this plan is from the other shape, in colours" }),
    ),
    h("div", { class: "row" }, h("span", {}, "From"), select([["before", "before"], ...plans.filter(([id]) => id !== String(c.plan))], String(origin()?.id ?? "before"), (from) => {
      state.from = from;
      blend();
    }, { "aria-label": "blend from" }), h("span", {}, "to this plan")),
    slider({ key: "blend", label: "Blend", min: 0, max: 1, step: 0.01, value: state.share, unit: "", live: (v) => {
      state.share = v;
      blend();
    }, done: (v) => {
      state.share = v;
      blend();
      redraw();
    } }),
    trouble(),
  );
}

function readySection(): HTMLElement {
  const presets = app.welcome?.presets ?? [];
  const steps = app.plan?.steps ?? [];
  const stepOfPreset = (p: Preset) => steps.find((s) => s.preset === p.name);
  const sideOf = (p: Preset): Side => stepOfPreset(p)?.side ?? state.side.get(p.name) ?? "both";
  const change = (p: Preset, amount: number, side = sideOf(p)): Edit => ({ edit: "set_preset", preset: p.name, amount, side });
  const sides: Side[] = ["both", "left", "right"];
  return h(
    "section",
    {},
    h(
      "div",
      { class: "presets" },
      presets.map((p) => {
        const side = sideOf(p);
        const amount = stepOfPreset(p)?.amount ?? 0;
        return h(
          "div",
          { class: "row preset" },
          slider({ key: `preset-${p.name}`, label: p.name.replaceAll("-", " "), title: `${p.about} Usual: ${p.amount} mm.`, min: p.range[0], max: p.range[1], step: 0.1, value: amount, live: (v) => ahead(change(p, v)), done: (v) => edit(change(p, v)) }),
          button({ both: "L+R", left: "L", right: "R" }[side], () => {
            const next = sides[(sides.indexOf(side) + 1) % 3]!;
            state.side.set(p.name, next);
            if (amount !== 0) edit(change(p, amount, next));
            redraw();
          }, { class: "side", title: `Side of the subject: ${side}. Click for the next.`, "aria-label": `side of ${p.name}: ${side}` }),
        );
      }),
    ),
    app.plan && !app.plan.frame && h("p", { class: "doubt" }, "This face has no 68 landmarks, so the smart operations cannot find their places: add a rig that has them."),
  );
}

const SHAPES: [Action, string, string][] = [
  ["turn", "View", "V: turn the view"],
  ["circle", "Circle", "C: from the middle outwards"],
  ["ellipse", "Ellipse", "E: from the middle to a corner"],
  ["sector", "Sector", "S: from the tip outwards"],
  ["polygon", "Polygon", "P: click corners, Enter or the first corner ends"],
  ["lasso", "Lasso", "L: round the region"],
  ["brush", "Brush", "F: paint the region"],
  ["pin", "Pin", "N: points that stay where they are"],
];

export function chooseShape(key: string): boolean {
  const found = SHAPES.find(([, , title]) => title.startsWith(`${key.toUpperCase()}:`));
  if (!found) return false;
  state.tab = "draw";
  state.action = found[0];
  dropSketch();
  redraw();
  return true;
}

function drawSection(): HTMLElement {
  const d = draft;
  const update = (part: Partial<Draft>) => {
    if (!draft) return;
    Object.assign(draft, part);
    showDraft();
    overlay();
  };
  const number = (k: 0 | 1 | 2, label: string) =>
    slider({ key: `move-${k}`, label, min: -12, max: 12, step: 0.1, enter: keep, value: d?.displacement[k] ?? 0, live: (v) => update({ displacement: d!.displacement.map((x, i) => (i === k ? v : x)) as [number, number, number] }), done: (v) => {
      update({ displacement: d!.displacement.map((x, i) => (i === k ? v : x)) as [number, number, number] });
      redraw();
    } });
  const combine: [typeof state.combine, string][] = [
    ["new", "New"],
    ["union", "Add"],
    ["subtract", "Cut"],
    ["intersect", "Cross"],
  ];
  const regions = app.open?.regions ?? [];
  const isPart = (name: string) => state.protect.some((m) => "parts" in m && m.parts.names.includes(name));
  const setProtect = (masks: Mask[]) => {
    state.protect = masks;
    update({ protect: masks });
    redraw();
  };
  return h(
    "section",
    {},
    h("div", { class: "row wrap" }, SHAPES.map(([action, text, title]) => toggle(text, state.action === action, () => {
      state.action = action;
      dropSketch();
      redraw();
    }, { title }))),
    state.action === "brush" && slider({ key: "brush", label: "Brush", min: 2, max: 60, step: 1, value: state.brush, done: (v) => {
      state.brush = v;
      redraw();
    } }),
    d
      ? [
          h("div", { class: "row" }, combine.map(([value, text]) => toggle(text, state.combine === value, () => {
            state.combine = value;
            redraw();
          }, { title: "What the next shape does to the region" }))),
          slider({ key: "soft", label: "Blur", min: 0, max: 20, step: 0.5, enter: keep, value: d.soft, live: (soft) => update({ soft }), done: (soft) => {
            update({ soft });
            redraw();
          } }),
          number(0, "To the left"),
          number(1, "Up"),
          number(2, "Out"),
          h("div", { class: "row" }, h("span", {}, "Handle"), toggle("Normal", state.along === "normal", () => {
            state.along = "normal";
            redraw();
          }), toggle("In view", state.along === "view", () => {
            state.along = "view";
            redraw();
          })),
          h("label", { class: "row" }, "Model", select(app.welcome?.morph_models ?? [], d.model, (model) => {
            update({ model });
            redraw();
          })),
          h("label", { class: "row" }, h("input", { type: "checkbox", checked: d.mirror, disabled: !app.plan?.frame, onchange: () => {
            update({ mirror: !d.mirror });
            redraw();
          } }), "both sides, mirrored"),
          h("label", { class: "row" }, h("input", { type: "checkbox", checked: d.through, onchange: () => {
            update({ through: !d.through });
            redraw();
          } }), "also what the surface hides"),
          h("div", { class: "row" }, button("Keep", keep, { class: "main grow", title: "Enter" }), button("Discard", discard, { title: "Esc" }), button("Protect it", () => {
            const { mask } = d;
            discard();
            setProtect([...state.protect, mask]);
            toast("This region is protected in the steps that you draw from now on.", "note");
          }, { title: "Takes this region as one that must not move" })),
        ]
      : h("p", { class: "hint" }, "Choose a shape and draw it on the face; then drag the round handle."),
    h(
      "details",
      { "data-key": "protect" },
      h("summary", {}, `Protected: ${state.protect.length}, pins: ${state.pins.length}`),
      h("div", { class: "row wrap" }, regions.map((name) => toggle(name.replaceAll("_", " "), isPart(name), () => setProtect(isPart(name) ? state.protect.filter((m) => !("parts" in m) || !m.parts.names.includes(name)) : [...state.protect, { parts: { names: [name] } }]), { class: isPart(name) ? "chip on" : "chip" }))),
      h("div", { class: "row" }, button("Nothing protected", () => setProtect([]), { disabled: state.protect.length === 0 }), button("No pins", () => {
        state.pins = [];
        update({ pins: [] });
        redraw();
      }, { disabled: state.pins.length === 0 })),
    ),
  );
}

function stepsSection(): HTMLElement {
  const { steps = [], results = [], milliseconds = 0 } = app.plan ?? {};
  return h(
    "section",
    {},
    steps.length === 0 && h("p", { class: "hint" }, "No steps yet: move a slider of a smart operation, or draw a region."),
    h(
      "ol",
      { class: "steps" },
      steps.map((step, k) => {
        const r = results[k];
        const bad = torn(r);
        const change = (part: object): Edit => ({ edit: "change_step", index: k, change: { name: null, amount: null, model: null, displacement: null, soft: null, mirror: null, side: null, protect: null, ...part } });
        return h(
          "li",
          {},
          h(
            "div",
            { class: "row" },
            h("span", { class: "grow clip" }, step.name || "step", h("small", {}, ` ${step.model}${step.side === "both" ? "" : `, ${step.side}`}${step.protects ? `, protects ${step.protects}` : ""}${step.pins ? `, ${step.pins} pins` : ""}`)),
            button("↑", () => edit({ edit: "move_step", from: k, to: k - 1 }), { disabled: k === 0, "aria-label": "earlier", title: "Earlier" }),
            button("↓", () => edit({ edit: "move_step", from: k, to: k + 1 }), { disabled: k === steps.length - 1, "aria-label": "later", title: "Later" }),
            button("×", () => edit({ edit: "remove_step", index: k }), { "aria-label": `remove ${step.name}`, title: "Remove" }),
          ),
          step.preset === null && [
            slider({ key: `amount-${k}`, label: "Amount", min: -2, max: 2, step: 0.05, value: step.amount, unit: "×", live: (amount) => ahead(change({ amount })), done: (amount) => edit(change({ amount })) }),
            slider({ key: `soft-${k}`, label: "Blur", min: 0, max: 20, step: 0.5, value: Number(step.soft.toFixed(1)), live: (soft) => ahead(change({ soft })), done: (soft) => edit(change({ soft })) }),
            h("label", { class: "row" }, "Model", select(app.welcome?.morph_models ?? [], step.model, (model) => edit(change({ model })))),
          ],
          r && h("small", { class: bad ? "doubt" : "" }, `${r.moving} vertices, at most ${r.reached.toFixed(2)} mm${bad ? `; ${r.folded} triangles turned over, edges up to ${r.stretch[1].toFixed(1)} times as long: use less, or more blur` : ""}`),
        );
      }),
    ),
    steps.length > 0 && h("small", {}, `${milliseconds.toFixed(0)} ms`),
  );
}

function saveSection(): HTMLElement {
  const none = (app.plan?.steps.length ?? 0) === 0;
  const why = unlike();
  const save = (format: string) => button(format, () => send({ type: "export", what: { export: "face", format } }), { disabled: none || why !== null, title: why ?? undefined });
  return section(
    "Keep",
    h("div", { class: "row wrap" }, h("span", {}, "Face as"), save("obj"), save("ply"), save("glb")),
    h(
      "div",
      { class: "row wrap" },
      button("Save recipe", () => send({ type: "export", what: { export: "recipe" } }), { disabled: none }),
      button("Load recipe", () => pickFiles("recipe", ".toml")),
      button("Recipe as text", () => void editRecipe()),
      button("Copy as command", () => void copy(app.plan?.command ?? ""), { disabled: none || !app.plan?.command, title: app.plan?.command }),
    ),
  );
}

/** A recipe that was sent as a text, until it is the plan's: one that is refused is there again, to be corrected. */
let sent: string | null = null;
belongs("client", () => (sent = null));

onChange((what) => {
  if (sent === null) return;
  if (app.open?.case.plans.some((p) => p.recipe === sent)) sent = null;
  else if (what === "error") {
    const refused = sent;
    sent = null;
    void editRecipe(refused);
  }
});

async function editRecipe(written: string | null = null) {
  const c = app.open!.case;
  const on = shown();
  const text = h("textarea", { rows: 24, cols: 90, spellcheck: "false", "data-key": "recipe" });
  text.value = written ?? c.plans.find((p) => p.id === c.plan)?.recipe ?? "";
  const recipe = await dialog("The plan as a recipe", [text], "Use", () => text.value);
  if (recipe === null) return;
  sent = recipe;
  edit({ edit: "set_recipe", recipe }, on);
}
