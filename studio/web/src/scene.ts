// What the modes share of the pictures: the stage, linked views, and a surface for each slot of the server.

import { app, type MeshData } from "./app";
import { Stage, Surface, lookFrom, view, type Pane } from "./stage";

export const stage = new Stage();
/** The scan and what lies on it, the template, and the face of plans. */
export const views = { scan: view(), template: view(), face: view() };

export const options = { wireframe: false, heat: true, overlay: true };

const surfaces = new Map<string, { surface: Surface; data: MeshData; positions: unknown; values: unknown; mode: string }>();

const TOPOLOGY: Record<string, string> = { wrapped: "template", plan: "face", other: "face" };

/** The surface of a slot as it is now; `key` tells apart surfaces of one slot in several panes. */
export function surfaceOf(slot: string, color: number, look: { key?: string; opacity?: number; values?: boolean; toward?: [number, number, number] } = {}): Surface | null {
  const data = app.meshes.get(TOPOLOGY[slot] ?? (slot.startsWith("compare/") ? "template" : slot));
  const positions = app.positions.get(slot) ?? (data && TOPOLOGY[slot] === undefined && !slot.startsWith("compare/") ? data.positions : undefined);
  if (!data || !positions || positions.length !== data.positions.length) return null;
  const key = `${slot}/${look.key ?? ""}/${look.opacity ?? 1}`;
  let known = surfaces.get(key);
  if (!known || known.data !== data) {
    known?.surface.dispose();
    known = { surface: new Surface(data, color, look.opacity), data, positions: data.positions, values: null, mode: "" };
    surfaces.set(key, known);
  }
  if (known.positions !== positions) {
    known.surface.setPositions(positions);
    known.positions = positions;
  }
  const values = look.values === false ? null : (app.values.get(slot) ?? null);
  const mode = String(look.toward);
  if (known.values !== values || known.mode !== mode) {
    known.surface.paint(values, look.toward);
    known.values = values;
    known.mode = mode;
  }
  known.surface.wireframe = options.wireframe;
  return known.surface;
}

/** Front, left or three-quarter view in the axes of the face, where landmarks give them. */
export function look(panes: Pane[], yaw: number, pitch = 0) {
  for (const v of new Set(panes.map((pane) => pane.view))) {
    const axes = v === views.face ? (app.plan?.frame?.axes as [number, number, number][] | undefined) : undefined;
    lookFrom(v, yaw, pitch, axes);
  }
  stage.draw();
}

/** The colour scale of a slot's values. */
export function legend(slot: string): { title: string; low: number; high: number } | null {
  const values = app.values.get(slot);
  return values ? { title: values.title, low: values.low, high: values.high } : null;
}
