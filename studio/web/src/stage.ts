// The pictures: one canvas with one or more panes beside each other, each a scene seen without perspective, so that lengths compare.

import * as THREE from "three";
import { MeshBVH, acceleratedRaycast } from "three-mesh-bvh";
import type { MeshData, ValueData } from "./app";

THREE.Mesh.prototype.raycast = acceleratedRaycast;

/** How a pane is looked at; panes that share it are linked. */
export interface View {
  target: THREE.Vector3;
  turn: THREE.Quaternion;
  /** Millimetres from bottom to top. */
  height: number;
  fitted: boolean;
  /** Meshes that it has shown. */
  seen: WeakSet<MeshData>;
}

export function view(): View {
  return { target: new THREE.Vector3(), turn: new THREE.Quaternion(), height: 300, fitted: false, seen: new WeakSet() };
}

export interface Hit {
  point: THREE.Vector3;
  normal: THREE.Vector3;
  /** Nearest corner of the triangle. */
  vertex: number;
}

/** What the pointer does in a pane; `down` says whether it takes the pointer from the view. */
export interface Tool {
  down(pane: Pane, event: PointerEvent): boolean;
  move?(pane: Pane, event: PointerEvent): void;
  up?(pane: Pane, event: PointerEvent): void;
  hover?(pane: Pane, event: PointerEvent): void;
  click?(pane: Pane, event: PointerEvent): void;
}

const STOPS: [number, number, number][] = [
  [0.16, 0.32, 0.66],
  [0.24, 0.66, 0.72],
  [0.86, 0.88, 0.52],
  [0.93, 0.55, 0.25],
  [0.75, 0.13, 0.18],
];

/** Blue over yellow to red. */
export function heat(share: number): [number, number, number] {
  const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
  const k = Math.min(Math.floor(at), STOPS.length - 2);
  const [a, b] = [STOPS[k]!, STOPS[k + 1]!];
  const mix = (i: number) => a[i]! + (b[i]! - a[i]!) * (at - k);
  return [mix(0), mix(1), mix(2)];
}

/** What is protected. */
const KEPT: [number, number, number] = [0.12, 0.38, 0.2];

/** A surface in a pane. */
export class Surface {
  readonly group = new THREE.Group();
  readonly mesh: THREE.Mesh;
  private readonly geometry = new THREE.BufferGeometry();
  private readonly wire: THREE.LineSegments;
  private readonly positions: THREE.BufferAttribute;
  private readonly colors: THREE.BufferAttribute;
  private bvh: MeshBVH | null = null;
  private readonly base: THREE.Color;
  private readonly own: Uint8Array | null;

  constructor(readonly data: MeshData, color: number, opacity = 1) {
    this.base = new THREE.Color(color);
    this.own = data.colors;
    this.positions = new THREE.BufferAttribute(data.positions.slice(), 3);
    this.colors = new THREE.BufferAttribute(new Float32Array(data.positions.length), 3);
    this.geometry.setAttribute("position", this.positions);
    this.geometry.setAttribute("color", this.colors);
    this.geometry.setIndex(new THREE.BufferAttribute(data.triangles.slice(), 1));
    const material = new THREE.MeshStandardMaterial({
      vertexColors: true,
      side: THREE.DoubleSide,
      roughness: 0.75,
      transparent: opacity < 1,
      opacity,
      polygonOffset: true,
      polygonOffsetFactor: 1,
      polygonOffsetUnits: 1,
    });
    this.mesh = new THREE.Mesh(this.geometry, material);
    const lines = new THREE.BufferGeometry();
    lines.setAttribute("position", this.positions);
    lines.setIndex(new THREE.BufferAttribute(data.lines.slice(), 1));
    this.wire = new THREE.LineSegments(lines, new THREE.LineBasicMaterial({ color: 0x1c2b33, transparent: true, opacity: 0.35 }));
    this.wire.visible = false;
    this.group.add(this.mesh, this.wire);
    if (data.triangles.length === 0) {
      this.group.add(new THREE.Points(this.geometry, new THREE.PointsMaterial({ size: 2, vertexColors: true, sizeAttenuation: false })));
    }
    this.paint(null);
    this.geometry.computeVertexNormals();
  }

  setPositions(positions: Float32Array) {
    if (positions.length !== this.positions.array.length) return;
    (this.positions.array as Float32Array).set(positions);
    this.positions.needsUpdate = true;
    this.geometry.computeVertexNormals();
    this.geometry.computeBoundingSphere();
    this.geometry.computeBoundingBox();
    this.wire.geometry.boundingSphere = this.geometry.boundingSphere;
    this.bvh?.refit();
  }

  /** Colours by values, or between the mesh's colour and others: `toward` at 1, `KEPT` at -1; without values the mesh's own. */
  paint(values: ValueData | null, toward?: [number, number, number]) {
    const array = this.colors.array as Float32Array;
    const { r, g, b } = this.base;
    const rgb = new THREE.Color();
    for (let v = 0; v < array.length / 3; v++) {
      if (values && v < values.values.length) {
        const share = (values.values[v]! - values.low) / Math.max(values.high - values.low, 1e-9);
        if (toward) {
          const to = share < 0 ? KEPT : toward;
          const by = Math.abs(share);
          rgb.setRGB(r + (to[0] - r) * by, g + (to[1] - g) * by, b + (to[2] - b) * by);
        } else if (Number.isNaN(share)) rgb.setRGB(0.5, 0.5, 0.5);
        else rgb.setRGB(...heat(share), THREE.SRGBColorSpace);
      } else if (this.own) {
        rgb.setRGB(this.own[3 * v]! / 255, this.own[3 * v + 1]! / 255, this.own[3 * v + 2]! / 255, THREE.SRGBColorSpace);
      } else {
        rgb.setRGB(r, g, b);
      }
      array[3 * v] = rgb.r;
      array[3 * v + 1] = rgb.g;
      array[3 * v + 2] = rgb.b;
    }
    this.colors.needsUpdate = true;
  }

  set wireframe(on: boolean) {
    this.wire.visible = on;
  }

  vertex(v: number): THREE.Vector3 {
    return new THREE.Vector3().fromBufferAttribute(this.positions, v);
  }

  normal(v: number): THREE.Vector3 {
    return new THREE.Vector3().fromBufferAttribute(this.geometry.getAttribute("normal"), v);
  }

  get count(): number {
    return this.positions.count;
  }

  get box(): THREE.Box3 {
    return new THREE.Box3().setFromBufferAttribute(this.positions);
  }

  hit(ray: THREE.Raycaster): Hit | null {
    if (this.data.triangles.length === 0) return this.nearest(ray);
    if (!this.bvh) {
      this.bvh = new MeshBVH(this.geometry, { indirect: true });
      this.geometry.boundsTree = this.bvh;
    }
    ray.firstHitOnly = true;
    const [hit] = ray.intersectObject(this.mesh, false);
    if (!hit?.face) return null;
    const corners = [hit.face.a, hit.face.b, hit.face.c];
    const distance = (v: number) => this.vertex(v).distanceToSquared(hit.point);
    const vertex = corners.reduce((best, v) => (distance(v) < distance(best) ? v : best));
    const normal = hit.face.normal.clone();
    if (normal.dot(ray.ray.direction) > 0) normal.negate();
    return { point: hit.point.clone(), normal, vertex };
  }

  /** Of a point cloud, the point nearest to the ray. */
  private nearest(ray: THREE.Raycaster): Hit | null {
    let best: Hit | null = null;
    let least = 4;
    for (let v = 0; v < this.count; v++) {
      const point = this.vertex(v);
      const d = ray.ray.distanceSqToPoint(point);
      if (d < least) {
        least = d;
        best = { point, normal: ray.ray.direction.clone().negate(), vertex: v };
      }
    }
    return best;
  }

  dispose() {
    this.geometry.dispose();
    this.wire.geometry.dispose();
  }
}

export interface Marker {
  name: string;
  at: THREE.Vector3;
  color: number;
}

export class Pane {
  readonly scene = new THREE.Scene();
  readonly camera = new THREE.OrthographicCamera();
  readonly extras = new THREE.Group();
  readonly label = document.createElement("div");
  private readonly markers = new THREE.Group();
  private readonly light = new THREE.DirectionalLight(0xffffff, 1.9);
  surfaces: Surface[] = [];
  /** What is picked; the first surface unless set. */
  pick: Surface | null = null;
  tool: Tool | null = null;
  /** Share of the canvas: left, bottom, width, height. */
  rect = new THREE.Vector4();
  selected = "";

  constructor(readonly view: View, title: string) {
    this.label.className = "pane-label";
    this.title = title;
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f96, 1.15), this.light, this.light.target, this.extras, this.markers);
  }

  set title(text: string) {
    this.label.textContent = text;
  }

  show(surfaces: (Surface | null)[]) {
    const { view } = this;
    const now = surfaces.filter((s) => s !== null);
    const unseen = now.filter((s) => !view.seen.has(s.data));
    // what was whole stays whole; whoever looks closely is not moved away
    const cut = unseen.length > 0 && this.surfaces.every((s) => this.inside(s)) && !unseen.every((s) => this.inside(s));
    for (const old of this.surfaces) this.scene.remove(old.group);
    this.surfaces = now;
    for (const surface of this.surfaces) this.scene.add(surface.group);
    if (now.length > 0 && (!view.fitted || cut || (unseen.length > 0 && this.outside()))) this.fit();
    for (const surface of unseen) view.seen.add(surface.data);
  }

  private box(): THREE.Box3 {
    const box = new THREE.Box3();
    for (const surface of this.surfaces) box.union(surface.box);
    return box;
  }

  /** Whether what is shown lies beside the view, or is lost in it: another scan may be metres away, or in another unit. */
  private outside(): boolean {
    const box = this.box();
    const size = box.getSize(new THREE.Vector3()).length();
    const { height, target } = this.view;
    const off = box.getCenter(new THREE.Vector3()).sub(target);
    const aspect = Math.max(this.rect.z, 1) / Math.max(this.rect.w, 1);
    return Math.abs(off.dot(this.up())) > height / 2 || Math.abs(off.dot(this.right())) > (height / 2) * aspect || size < height / 8 || size > 8 * height;
  }

  /** Whether nothing of a surface is cut off by the edge of the view. */
  private inside({ box }: Surface): boolean {
    const { height, target } = this.view;
    const aspect = Math.max(this.rect.z, 1) / Math.max(this.rect.w, 1);
    const [up, right] = [this.up(), this.right()];
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => new THREE.Vector3(k & 1 ? box.max.x : box.min.x, k & 2 ? box.max.y : box.min.y, k & 4 ? box.max.z : box.min.z).sub(target));
    return corners.every((c) => Math.abs(c.dot(up)) <= height / 2 && Math.abs(c.dot(right)) <= (height / 2) * aspect);
  }

  fit() {
    const box = this.box();
    if (box.isEmpty()) return;
    box.getCenter(this.view.target);
    const size = box.getSize(new THREE.Vector3());
    const aspect = Math.max(this.rect.z, 1) / Math.max(this.rect.w, 1);
    this.view.height = 1.12 * Math.max(size.y, size.x / aspect, 0.6 * size.z);
    this.view.fitted = true;
  }

  mark(markers: Marker[]) {
    this.markers.clear();
    const radius = this.view.height / 160;
    for (const marker of markers) {
      const scale = marker.name === this.selected ? 1.5 : 1;
      const dot = new THREE.Mesh(BALL, new THREE.MeshBasicMaterial({ color: marker.color }));
      dot.position.copy(marker.at);
      dot.scale.setScalar(radius * scale);
      dot.name = marker.name;
      this.markers.add(dot);
    }
  }

  markerAt(event: PointerEvent, canvas: HTMLCanvasElement): string | null {
    let best: string | null = null;
    let least = 11;
    for (const dot of this.markers.children) {
      const at = this.toScreen(dot.position, canvas);
      const distance = Math.hypot(at.x - event.offsetX, at.y - event.offsetY);
      if (distance < least && !this.hidden(dot.position)) {
        least = distance;
        best = dot.name;
      }
    }
    return best;
  }

  moveMarker(name: string, to: THREE.Vector3) {
    this.markers.getObjectByName(name)?.position.copy(to);
  }

  /** Whether a surface lies before a point. */
  private hidden(point: THREE.Vector3): boolean {
    const back = this.toward();
    const ray = new THREE.Raycaster(point.clone().addScaledVector(back, 500), back.negate());
    const hit = this.pickable()?.hit(ray);
    return !!hit && hit.point.distanceTo(ray.ray.origin) < 500 - 4;
  }

  pickable(): Surface | null {
    return this.pick ?? this.surfaces[0] ?? null;
  }

  hit(event: PointerEvent, canvas: HTMLCanvasElement): Hit | null {
    return this.pickable()?.hit(this.ray(event, canvas)) ?? null;
  }

  ray(event: PointerEvent, canvas: HTMLCanvasElement): THREE.Raycaster {
    const ray = new THREE.Raycaster();
    ray.setFromCamera(this.toUnit(event.offsetX, event.offsetY, canvas), this.camera);
    return ray;
  }

  private toUnit(x: number, y: number, canvas: HTMLCanvasElement): THREE.Vector2 {
    const { rect } = this;
    return new THREE.Vector2((2 * (x - rect.x)) / rect.z - 1, (2 * (canvas.clientHeight - y - rect.y)) / rect.w - 1);
  }

  toScreen(point: THREE.Vector3, canvas: HTMLCanvasElement): THREE.Vector2 {
    const p = point.clone().project(this.camera);
    const { rect } = this;
    return new THREE.Vector2(rect.x + ((p.x + 1) / 2) * rect.z, canvas.clientHeight - rect.y - ((p.y + 1) / 2) * rect.w);
  }

  /** Millimetres of a pixel. */
  get scale(): number {
    return this.view.height / Math.max(this.rect.w, 1);
  }

  right(): THREE.Vector3 {
    return new THREE.Vector3(1, 0, 0).applyQuaternion(this.view.turn);
  }

  up(): THREE.Vector3 {
    return new THREE.Vector3(0, 1, 0).applyQuaternion(this.view.turn);
  }

  /** From the face to the viewer. */
  toward(): THREE.Vector3 {
    return new THREE.Vector3(0, 0, 1).applyQuaternion(this.view.turn);
  }

  render(renderer: THREE.WebGLRenderer) {
    const { view, camera, rect } = this;
    const half = view.height / 2;
    const aspect = rect.z / Math.max(rect.w, 1);
    [camera.left, camera.right, camera.top, camera.bottom] = [-half * aspect, half * aspect, half, -half];
    [camera.near, camera.far] = [-5000, 10000];
    camera.position.copy(view.target).addScaledVector(this.toward(), 2000);
    camera.quaternion.copy(view.turn);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    this.light.position.copy(camera.position).addScaledVector(this.up(), 900).addScaledVector(this.right(), -500);
    this.light.target.position.copy(view.target);
    const radius = view.height / 160;
    for (const dot of this.markers.children) dot.scale.setScalar(radius * (dot.name === this.selected ? 1.5 : 1));
    renderer.render(this.scene, camera);
  }
}

const BALL = new THREE.SphereGeometry(1, 16, 12);

export class Stage {
  readonly element = document.createElement("div");
  readonly canvas = document.createElement("canvas");
  readonly overlay = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  readonly renderer: THREE.WebGLRenderer;
  panes: Pane[] = [];
  private waiting = false;
  /** Fingers on the picture; two of them shift and zoom. */
  private readonly fingers = new Map<number, THREE.Vector2>();
  private hold: { pane: Pane; x: number; y: number; moved: number; kind: "tool" | "turn" | "pan" | "pinch" } | null = null;

  constructor() {
    this.element.className = "stage";
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "application");
    this.canvas.setAttribute("aria-label", "3D view");
    this.element.append(this.canvas, this.overlay);
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setScissorTest(true);
    new ResizeObserver(() => this.resize()).observe(this.element);
    this.canvas.onpointerdown = (event) => this.down(event);
    this.canvas.onpointermove = (event) => this.move(event);
    this.canvas.onpointerup = (event) => this.up(event);
    this.canvas.onpointercancel = (event) => {
      this.fingers.delete(event.pointerId);
      this.hold = null;
    };
    this.canvas.oncontextmenu = (event) => event.preventDefault();
    this.canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  show(panes: Pane[]) {
    for (const pane of this.panes) pane.label.remove();
    this.panes = panes;
    for (const pane of panes) this.element.append(pane.label);
    this.layout();
  }

  private resize() {
    this.renderer.setSize(this.element.clientWidth, this.element.clientHeight, false);
    this.layout();
  }

  private layout() {
    const count = Math.max(this.panes.length, 1);
    const { clientWidth: width, clientHeight: height } = this.element;
    const columns = count <= 3 ? count : Math.ceil(Math.sqrt(count * (width / Math.max(height, 1)) * 0.8));
    const rows = Math.ceil(count / columns);
    this.panes.forEach((pane, k) => {
      const [column, row] = [k % columns, Math.floor(k / columns)];
      pane.rect.set((column * width) / columns, height - ((row + 1) * height) / rows, width / columns, height / rows);
      pane.label.style.left = `${pane.rect.x + 10}px`;
      pane.label.style.top = `${(row * height) / rows + 8}px`;
    });
    this.draw();
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.drawNow();
    });
  }

  drawNow() {
    const { renderer } = this;
    renderer.setScissor(0, 0, this.element.clientWidth, this.element.clientHeight);
    renderer.setViewport(0, 0, this.element.clientWidth, this.element.clientHeight);
    renderer.setClearColor(0xc9ced3);
    renderer.clear();
    renderer.setClearColor(0xeef0f2);
    for (const pane of this.panes) {
      const { x, y, z, w } = pane.rect;
      const gap = this.panes.length > 1 ? 1 : 0;
      renderer.setViewport(x, y, z - gap, w - gap);
      renderer.setScissor(x, y, z - gap, w - gap);
      pane.render(renderer);
    }
  }

  /** A picture of one pane alone, as a data URL. */
  picture(pane: Pane, size: number): string {
    const keep = pane.rect.clone();
    const ratio = this.renderer.getPixelRatio();
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(size, size, false);
    this.renderer.setViewport(0, 0, size, size);
    this.renderer.setScissor(0, 0, size, size);
    this.renderer.setClearColor(0xffffff);
    pane.rect.set(0, 0, size, size);
    pane.render(this.renderer);
    const url = this.canvas.toDataURL("image/png");
    pane.rect.copy(keep);
    this.renderer.setPixelRatio(ratio);
    this.resize();
    this.drawNow();
    return url;
  }

  private paneAt(event: PointerEvent | WheelEvent): Pane | null {
    const y = this.canvas.clientHeight - event.offsetY;
    const inside = ({ rect }: Pane) => event.offsetX >= rect.x && event.offsetX < rect.x + rect.z && y >= rect.y && y < rect.y + rect.w;
    return this.panes.find(inside) ?? null;
  }

  private down(event: PointerEvent) {
    const pane = this.paneAt(event);
    if (!pane) return;
    this.canvas.focus();
    this.canvas.setPointerCapture(event.pointerId);
    if (event.pointerType === "touch") {
      this.fingers.set(event.pointerId, new THREE.Vector2(event.offsetX, event.offsetY));
      // what a finger draws, another one does not end
      if (this.fingers.size > 1 && this.hold?.kind !== "tool") this.hold = { pane: this.hold?.pane ?? pane, x: 0, y: 0, moved: 0, kind: "pinch" };
      if (this.fingers.size > 1) return;
    }
    const pan = event.button !== 0 || event.shiftKey;
    const kind = pan ? "pan" : pane.tool?.down(pane, event) ? "tool" : "turn";
    this.hold = { pane, x: event.offsetX, y: event.offsetY, moved: 0, kind };
    this.draw();
  }

  private move(event: PointerEvent) {
    const { hold } = this;
    if (!hold) {
      const pane = this.paneAt(event);
      pane?.tool?.hover?.(pane, event);
      return;
    }
    if (hold.kind === "pinch") return this.pinch(hold.pane, event);
    const own = this.fingers.get(event.pointerId);
    if (own ? [...this.fingers.keys()][0] !== event.pointerId : this.fingers.size > 0) return;
    own?.set(event.offsetX, event.offsetY);
    const [dx, dy] = [event.offsetX - hold.x, event.offsetY - hold.y];
    hold.x = event.offsetX;
    hold.y = event.offsetY;
    hold.moved += Math.hypot(dx, dy);
    const { pane } = hold;
    const { view } = pane;
    if (hold.kind === "tool") pane.tool?.move?.(pane, event);
    else if (hold.kind === "pan") view.target.addScaledVector(pane.right(), -dx * pane.scale).addScaledVector(pane.up(), dy * pane.scale);
    else if (hold.moved > 3) {
      const turn = (axis: THREE.Vector3, angle: number) => view.turn.premultiply(new THREE.Quaternion().setFromAxisAngle(axis, angle));
      turn(pane.up(), -dx * 0.008);
      turn(pane.right(), -dy * 0.008);
      view.turn.normalize();
    }
    this.draw();
  }

  /** Two fingers: what lies between them follows, and what is between stretches with their distance. */
  private pinch(pane: Pane, event: PointerEvent) {
    const [one, other] = [this.fingers.get(event.pointerId), [...this.fingers].find(([id]) => id !== event.pointerId)?.[1]];
    if (!one || !other) return;
    const to = new THREE.Vector2(event.offsetX, event.offsetY);
    const { view } = pane;
    const shift = to.clone().sub(one).multiplyScalar(0.5 * pane.scale);
    view.target.addScaledVector(pane.right(), -shift.x).addScaledVector(pane.up(), shift.y);
    view.height = inBounds((view.height * Math.max(one.distanceTo(other), 10)) / Math.max(to.distanceTo(other), 10));
    one.copy(to);
    this.draw();
  }

  private up(event: PointerEvent) {
    const { hold } = this;
    const drawing = hold?.kind === "tool" && this.fingers.size > 1 && [...this.fingers.keys()][0] !== event.pointerId;
    this.fingers.delete(event.pointerId);
    if (drawing) return;
    this.hold = null;
    if (!hold) return;
    if (hold.kind === "tool") hold.pane.tool?.up?.(hold.pane, event);
    else if (hold.kind === "turn" && hold.moved <= 3) hold.pane.tool?.click?.(hold.pane, event);
    this.draw();
  }

  private wheel(event: WheelEvent) {
    event.preventDefault();
    const pane = this.paneAt(event);
    if (!pane) return;
    const lines = event.deltaMode === 1 ? 20 : 1;
    // a pinch on a trackpad is a wheel with Ctrl, in smaller steps
    pane.view.height *= Math.exp(Math.max(-1, Math.min(1, event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0012))));
    pane.view.height = inBounds(pane.view.height);
    this.draw();
  }
}

/** A height of a view, mm. */
function inBounds(height: number): number {
  return Math.max(5, Math.min(5000, height));
}

/** Looks from a side: yaw to the subject's left, pitch from above, degrees, in the axes of the face. */
export function lookFrom(view: View, yaw: number, pitch: number, axes?: [number, number, number][]) {
  const base = new THREE.Quaternion();
  if (axes) {
    const [x, y, z] = axes.map((a) => new THREE.Vector3(...a)) as [THREE.Vector3, THREE.Vector3, THREE.Vector3];
    base.setFromRotationMatrix(new THREE.Matrix4().makeBasis(x, y, z));
  }
  const turned = new THREE.Quaternion().setFromEuler(new THREE.Euler(THREE.MathUtils.degToRad(-pitch), THREE.MathUtils.degToRad(yaw), 0, "YXZ"));
  view.turn.copy(base.multiply(turned));
}
