// Drawing on the face: shapes on the screen become masks in the frame of the face, from where they were drawn.

import * as THREE from "three";
import { app } from "./app";
import { svg } from "./dom";
import type { Drawing, DrawnFrom } from "./protocol";
import { stage } from "./scene";
import type { Pane } from "./stage";

export type Shape = "circle" | "ellipse" | "sector" | "polygon" | "lasso" | "brush";
type Point = [number, number];

/** The axes in which a mask seen in this pane is drawn. */
interface Plane {
  from: DrawnFrom;
  /** A point of the canvas in the mask's coordinates. */
  map(p: Point): Point;
  /** Length of a pixel in them. */
  scale: number;
  /** Turn of the canvas's x axis in them, degrees; y of a camera's picture goes down, as the canvas's. */
  turn: number;
  flipped: boolean;
}

export function planeOf(pane: Pane): Plane {
  const frame = app.plan?.frame;
  const { rect } = pane;
  const top = stage.canvas.clientHeight - rect.y - rect.w;
  if (!frame) {
    const eye = pane.view.target.clone().addScaledVector(pane.toward(), 1000);
    const size: Point = [Math.max(1, Math.round(rect.z)), Math.max(1, Math.round(rect.w))];
    const from: DrawnFrom = { camera: { eye: eye.toArray(), target: pane.view.target.toArray(), up: pane.up().toArray(), height: pane.view.height, size } };
    return { from, map: ([x, y]) => [((x - rect.x) * size[0]) / rect.z, ((y - top) * size[1]) / rect.w], scale: 1, turn: 0, flipped: true };
  }
  const [X, Y, Z] = frame.axes.map((a) => new THREE.Vector3(...a)) as [THREE.Vector3, THREE.Vector3, THREE.Vector3];
  const toward = pane.toward();
  const pitch = Math.asin(Math.max(-1, Math.min(1, toward.dot(Y))));
  const yaw = Math.atan2(toward.dot(X), toward.dot(Z));
  const x = X.clone().multiplyScalar(Math.cos(yaw)).addScaledVector(Z, -Math.sin(yaw));
  const z = Z.clone().multiplyScalar(Math.cos(yaw)).addScaledVector(X, Math.sin(yaw));
  const y = Y.clone().multiplyScalar(Math.cos(pitch)).addScaledVector(z, -Math.sin(pitch));
  const origin = new THREE.Vector3(...frame.origin);
  const degrees = THREE.MathUtils.radToDeg;
  return {
    from: { frame: { yaw: degrees(yaw), pitch: degrees(pitch) } },
    map: (p) => {
      const d = worldOf(pane, p).sub(origin);
      return [d.dot(x) / frame.unit, d.dot(y) / frame.unit];
    },
    scale: pane.scale / frame.unit,
    turn: degrees(Math.atan2(pane.right().dot(y), pane.right().dot(x))),
    flipped: false,
  };
}

/** A point of the canvas in space, in the plane through the view's target. */
export function worldOf(pane: Pane, [px, py]: Point): THREE.Vector3 {
  const { rect } = pane;
  const dx = px - (rect.x + rect.z / 2);
  const dy = stage.canvas.clientHeight - py - (rect.y + rect.w / 2);
  return pane.view.target.clone().addScaledVector(pane.right(), dx * pane.scale).addScaledVector(pane.up(), dy * pane.scale);
}

/** A shape while it is drawn: points of the canvas. */
export class Sketch {
  points: Point[] = [];

  constructor(
    readonly shape: Shape,
    readonly radius: number,
    first: Point,
  ) {
    this.points = shape === "polygon" || shape === "lasso" || shape === "brush" ? [first] : [first, first];
  }

  move(p: Point) {
    const last = this.points[this.points.length - 1]!;
    const far = Math.hypot(p[0] - last[0], p[1] - last[1]);
    if (this.shape === "lasso" ? far > 3 : this.shape === "brush" && far > this.radius / 2) this.points.push(p);
    else if (this.shape !== "lasso" && this.shape !== "brush") this.points[this.points.length - 1] = p;
  }

  get big(): boolean {
    const [a, b] = [this.points[0]!, this.points[this.points.length - 1]!];
    if (this.shape === "brush") return true;
    return this.shape === "polygon" || this.shape === "lasso" ? this.points.length >= 3 : Math.hypot(b[0] - a[0], b[1] - a[1]) > 4;
  }

  /** In the coordinates of a mask. */
  drawing(plane: Plane): Drawing {
    const [a, b] = [this.points[0]!, this.points[this.points.length - 1]!];
    const centre = plane.map(a);
    const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    const radius = Math.max(Math.hypot(dx, dy) * plane.scale, 1e-3);
    switch (this.shape) {
      case "circle":
        return { circle: { centre, radius } };
      case "ellipse":
        return { ellipse: { centre, radii: [Math.max(Math.abs(dx), 2) * plane.scale, Math.max(Math.abs(dy), 2) * plane.scale], angle: plane.turn } };
      case "sector": {
        const up = plane.flipped ? dy : -dy;
        const middle = plane.turn + THREE.MathUtils.radToDeg(Math.atan2(up, dx));
        return { sector: { centre, inner: 0, outer: radius, start: middle - 35, sweep: 70 } };
      }
      case "polygon":
      case "lasso":
        return { polygon: { rings: [this.points.map((p) => plane.map(p))] } };
      case "brush": {
        const discs: Drawing[] = this.points.map((p) => ({ circle: { centre: plane.map(p), radius: this.radius * plane.scale } }));
        return discs.length === 1 ? discs[0]! : { union: discs };
      }
    }
  }

  outline(): SVGElement {
    const [a, b] = [this.points[0]!, this.points[this.points.length - 1]!];
    const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    const r = Math.hypot(dx, dy);
    const list = this.points.map((p) => p.join(",")).join(" ");
    switch (this.shape) {
      case "circle":
        return svg("circle", { cx: a[0], cy: a[1], r, class: "sketch" });
      case "ellipse":
        return svg("ellipse", { cx: a[0], cy: a[1], rx: Math.abs(dx), ry: Math.abs(dy), class: "sketch" });
      case "sector": {
        const angle = Math.atan2(dy, dx);
        const end = (turn: number) => `${a[0] + r * Math.cos(angle + turn)},${a[1] + r * Math.sin(angle + turn)}`;
        const half = (35 * Math.PI) / 180;
        return svg("path", { d: `M${a[0]},${a[1]} L${end(-half)} A${r},${r} 0 0 1 ${end(half)} Z`, class: "sketch" });
      }
      case "polygon":
      case "lasso":
        return svg(this.shape === "lasso" ? "polygon" : "polyline", { points: list, class: "sketch" });
      case "brush":
        return svg("polyline", { points: this.points.length === 1 ? `${list} ${a[0] + 0.1},${a[1]}` : list, class: "sketch brush", "stroke-width": 2 * this.radius });
    }
  }
}
