// A plan on the face: what is shown of it, the region that is being drawn, and its handle.

import * as THREE from "three";
import { app, belongs, edit as kept, preview, send, shown, toast } from "./app";
import { svg } from "./dom";
import { Sketch, planeOf, type Shape } from "./draw";
import type { Drawing, DrawnStep, Edit, Mask, Side } from "./protocol";
import { stage, surfaceOf, views } from "./scene";
import { Pane, type Tool } from "./stage";

const SKIN = 0xd9b79f;

export type Action = "turn" | Shape | "pin";

/** Vertices and regions of a face. */
const ofFace = () => ({ protect: [] as Mask[], pins: [] as number[] });
/** Sides of operations, and the plan that a blend begins from. */
const ofClient = () => ({ side: new Map<string, Side>(), from: "before" });
/** The picture is the whole plan, not a blend. */
const whole = () => ({ share: 1, difference: false });

export const state = {
  tab: "smart" as "smart" | "draw" | "steps",
  action: "turn" as Action,
  combine: "new" as "new" | "union" | "subtract" | "intersect",
  brush: 14,
  split: false,
  before: false,
  along: "normal" as "normal" | "view",
  ...ofClient(),
  ...whole(),
  ...ofFace(),
};

export interface Draft extends DrawnStep {
  /** Where the handle stands, and the surface's normal there. */
  centre: THREE.Vector3;
  normal: THREE.Vector3;
}

export let draft: Draft | null = null;
let sketch: Sketch | null = null;
/** A region that was sent to be kept, until the plan has it. */
let keeping: Draft | null = null;

belongs("client", () => Object.assign(state, ofClient(), whole()));
belongs("face", () => {
  if (draft ?? keeping) toast("The region that was drawn is gone: it was of the face before.", "note");
  draft = sketch = keeping = again = null;
  Object.assign(state, ofFace());
});

/** The plan that a blend begins from, unless it is gone or is in work itself. */
export function origin() {
  const c = app.open?.case;
  return c?.plans.find((p) => String(p.id) === state.from && p.id !== c.plan);
}

/** That plan as it was when its shape was asked for. */
let blended = "";

function originNow(): string {
  const { case: c, id } = app.open!;
  return JSON.stringify([id, c.template, c.rig, c.wrapped?.mesh, origin()]);
}

/** Asks for the shape between that plan and the one in work, and for that plan's own. */
export function blend() {
  blended = originNow();
  send({ type: "blend", from: origin()?.id ?? null, to: app.open!.case.plan, share: state.share, difference: state.difference });
}

const afterPane = new Pane(views.face, "After");
const beforePane = new Pane(views.face, "Before");

export let redraw: () => void = () => {};

export function onRedraw(f: () => void) {
  redraw = f;
}

export function show() {
  const masked = app.values.get("plan")?.title === "mask";
  const before = surfaceOf("face", SKIN, { values: false });
  const after = surfaceOf("plan", SKIN, { values: draft !== null || state.difference, toward: masked ? [0.1, 0.45, 0.85] : undefined });
  afterPane.pick = after;
  const other = origin();
  // another plan may have been changed, or the face, since its shape was asked for
  if (state.split && other && !draft && blended !== originNow()) blend();
  beforePane.show([(other && surfaceOf("other", SKIN, { values: false })) ?? before]);
  beforePane.title = other?.name ?? "Before";
  afterPane.show([state.before ? before : after]);
  const plan = app.open?.case.plans.find((p) => p.id === app.open?.case.plan);
  afterPane.title = !after ? "No face yet: add a template, a rig or a client" : state.before ? "Before" : (plan?.name ?? "After");
  const panes = state.split ? [beforePane, afterPane] : [afterPane];
  if (stage.panes.length !== panes.length || stage.panes.some((p, k) => p !== panes[k])) stage.show(panes);
  const pins = after ? state.pins.filter((v) => v < after.count) : [];
  afterPane.mark(pins.map((v) => ({ name: `pin ${v}`, at: after!.vertex(v), color: 0x202a33 })));
  overlay();
  stage.draw();
}

export function overlay() {
  const items: SVGElement[] = [];
  if (sketch) items.push(sketch.outline());
  if (draft) {
    const a = afterPane.toScreen(draft.centre, stage.canvas);
    const b = afterPane.toScreen(tip(), stage.canvas);
    items.push(svg("line", { x1: a.x, y1: a.y, x2: b.x, y2: b.y, class: "arrow" }), svg("circle", { cx: b.x, cy: b.y, r: 9, class: "handle" }));
  }
  stage.overlay.replaceChildren(...items);
}

let here = false;

export function enter() {
  here = true;
  showDraft();
}

/** Elsewhere the face is as the plan has left it, without what is drawn or blended. */
export function leave() {
  here = false;
  again = null;
  if (app.open && (draft || state.share !== 1 || state.difference)) preview(null);
}

/** Why the picture is not what a file of the plan would be. */
export function unlike(): string | null {
  if (draft) return "Keep or discard the region first: the file is of the plan";
  return state.share !== 1 ? "Set Blend to 1 first: the file is of the whole plan" : null;
}

// --- the draft ---

function axes(): THREE.Vector3[] {
  const frame = app.plan?.frame;
  return frame ? frame.axes.map((a) => new THREE.Vector3(...a)) : [new THREE.Vector3(1, 0, 0), new THREE.Vector3(0, 1, 0), new THREE.Vector3(0, 0, 1)];
}

function displacement(): THREE.Vector3 {
  const sum = new THREE.Vector3();
  axes().forEach((axis, k) => sum.addScaledVector(axis, draft?.displacement[k] ?? 0));
  return sum;
}

/** Where the handle is: the displacement, drawn four times as long so that a millimetre is seen. */
const LONGER = 4;

function tip(): THREE.Vector3 {
  return draft!.centre.clone().addScaledVector(displacement(), LONGER);
}

function stepOf(d: Draft): DrawnStep {
  const { centre: _centre, normal: _normal, ...step } = d;
  return step;
}

let asked = false;
let again: Edit | null = null;

/** Shows what a change would do: one question at a time, the last one counts. */
export function ahead(change: Edit) {
  if (asked) again = change;
  else {
    asked = true;
    preview(change);
  }
}

/** Changes the plan; a preview that still waits would be of the plan before. */
export function edit(change: Edit, on = shown()) {
  again = null;
  kept(change, on);
}

export function answered(what: "plan" | "error" | "connection") {
  asked = false;
  const next = again;
  again = null;
  const { plan } = app;
  if (what === "plan") {
    Object.assign(state, whole());
    const last = plan?.preview ? undefined : plan?.steps.at(-1);
    if (keeping && last?.name === keeping.name && String(last.displacement) === String(keeping.displacement)) keeping = null;
  } else if (keeping) {
    // refused, or not heard: it is there to be kept again
    draft ??= keeping;
    keeping = null;
    if (here && app.connected) showDraft();
  }
  if (next) ahead(next);
  else if (what === "plan" && here && !keeping && !plan?.preview) showDraft();
}

export function showDraft() {
  if (draft) ahead({ edit: "add_step", step: stepOf(draft) });
}

export function discard() {
  if (!draft && !sketch) return;
  draft = null;
  sketch = null;
  again = null;
  preview(null);
  redraw();
}

/** The shape that is being drawn goes; the region stays. */
export function dropSketch() {
  sketch = null;
}

export function keep() {
  if (!draft) return;
  const step = stepOf(draft);
  if (step.displacement.every((x) => x === 0)) {
    toast("Drag the round handle, or move a slider, so that the region moves; then keep it.", "note");
    return;
  }
  if (app.plan?.preview && app.plan.error) {
    toast(`Not kept: ${app.plan.error}`, "error");
    return;
  }
  keeping = draft;
  draft = null;
  edit({ edit: "add_step", step });
  redraw();
}

function sameView(a: Mask, b: Mask): boolean {
  if (!("drawn" in a) || !("drawn" in b)) return false;
  const [f, g] = [a.drawn.from, b.drawn.from];
  if ("frame" in f && "frame" in g) return Math.abs(f.frame.yaw - g.frame.yaw) < 0.05 && Math.abs(f.frame.pitch - g.frame.pitch) < 0.05;
  return JSON.stringify(f) === JSON.stringify(g);
}

/** Pins hold a surface that has an energy, which the direct model has not. */
function modelFor(model: string): string {
  return state.pins.length > 0 && model === "direct" ? "arap" : model;
}

function finish(pane: Pane) {
  const done = sketch;
  sketch = null;
  if (!done?.big) return redraw();
  const plane = planeOf(pane);
  const drawing = done.drawing(plane);
  const mask: Mask = { drawn: { from: plane.from, drawing } };
  if (draft && state.combine !== "new") {
    if (!sameView(draft.mask, mask)) {
      toast("Regions are joined or cut from one view: this one was drawn from elsewhere. Undo the turn, or draw a new region.", "error");
      return redraw();
    }
    const first = ("drawn" in draft.mask ? draft.mask.drawn.drawing : null) as Drawing;
    draft.mask = { drawn: { from: plane.from, drawing: { [state.combine]: [first, drawing] } as unknown as Drawing } };
  } else {
    const middle = done.points.reduce((sum, p) => [sum[0] + p[0], sum[1] + p[1]] as [number, number], [0, 0] as [number, number]).map((x) => x / done.points.length) as [number, number];
    const seen = done.shape === "polygon" || done.shape === "lasso" || done.shape === "brush" ? middle : done.points[0]!;
    const hit = pane.hit({ offsetX: seen[0], offsetY: seen[1] } as PointerEvent, stage.canvas);
    if (!hit) {
      toast("The region does not lie on the face: draw it over the surface.", "error");
      return redraw();
    }
    const count = (app.plan?.steps.length ?? 0) + 1;
    draft = {
      name: `${done.shape} ${count}`,
      model: draft?.model ?? modelFor("direct"),
      mask,
      soft: draft?.soft ?? 4,
      displacement: [0, 0, 0],
      mirror: draft?.mirror ?? false,
      through: false,
      protect: state.protect,
      pins: state.pins,
      centre: hit.point,
      normal: hit.normal,
    };
  }
  showDraft();
  redraw();
}

let dragging = false;

const tool: Tool = {
  down(pane, event) {
    const p: [number, number] = [event.offsetX, event.offsetY];
    if (draft) {
      const at = afterPane.toScreen(tip(), stage.canvas);
      if (Math.hypot(at.x - p[0], at.y - p[1]) < 14) {
        dragging = true;
        return true;
      }
    }
    if (state.action === "turn") return false;
    if (state.action === "pin") {
      // a pin that is clicked again goes, whatever the surface round it has become
      const there = pane.markerAt(event, stage.canvas);
      const vertex = there ? Number(there.slice("pin ".length)) : pane.hit(event, stage.canvas)?.vertex;
      if (vertex === undefined) return false;
      state.pins = state.pins.includes(vertex) ? state.pins.filter((v) => v !== vertex) : [...state.pins, vertex];
      if (draft) {
        draft.pins = state.pins;
        draft.model = modelFor(draft.model);
        showDraft();
      }
      redraw();
      return true;
    }
    if (state.action === "polygon" && sketch) {
      const first = sketch.points[0]!;
      if (sketch.points.length > 3 && Math.hypot(first[0] - p[0], first[1] - p[1]) < 10) {
        sketch.points.pop();
        finish(pane);
      } else sketch.points.push(p);
      overlay();
      return true;
    }
    sketch = new Sketch(state.action, state.brush / pane.scale / 2, p);
    if (state.action === "polygon") sketch.points.push(p);
    overlay();
    return true;
  },
  move(pane, event) {
    if (dragging && draft) {
      const at = afterPane.toScreen(draft.centre, stage.canvas);
      const drag = new THREE.Vector2(event.offsetX - at.x, at.y - event.offsetY).multiplyScalar(pane.scale / LONGER);
      let moved = new THREE.Vector3().addScaledVector(pane.right(), drag.x).addScaledVector(pane.up(), drag.y);
      if (state.along === "normal") {
        const seen = new THREE.Vector2(draft.normal.dot(pane.right()), draft.normal.dot(pane.up()));
        // seen end on, up is out
        const length = seen.length() > 0.25 ? drag.dot(seen) / seen.lengthSq() : drag.y;
        moved = draft.normal.clone().multiplyScalar(length);
      }
      draft.displacement = axes().map((axis) => Number(moved.dot(axis).toFixed(3))) as [number, number, number];
      showDraft();
      overlay();
      return;
    }
    sketch?.move([event.offsetX, event.offsetY]);
    overlay();
  },
  hover(_pane, event) {
    if (state.action === "polygon" && sketch) {
      sketch.points[sketch.points.length - 1] = [event.offsetX, event.offsetY];
      overlay();
    }
  },
  up(pane) {
    if (dragging) {
      dragging = false;
      redraw();
    } else if (sketch && state.action !== "polygon") finish(pane);
  },
};
afterPane.tool = tool;

export function keys(event: KeyboardEvent): boolean {
  if (event.key === "Enter" && sketch?.shape === "polygon") {
    sketch.points.pop();
    finish(afterPane);
  } else if (event.key === "Enter" && draft) keep();
  else if (event.key === "Escape") {
    if (draft || sketch) discard();
    else state.action = "turn";
    redraw();
  } else if (event.key === "b" && !event.repeat) {
    state.before = true;
    redraw();
  } else return false;
  return true;
}

export function keyUp(event: KeyboardEvent) {
  if (event.key === "b" && state.before) {
    state.before = false;
    redraw();
  }
}
