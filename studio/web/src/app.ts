// What the page knows, and its way to the server. Modes draw from here; nothing else keeps state of the case.

import { h } from "./dom";
import type { Analysis, Article, CaseSummary, ClientMessage, CompareRow, Edit, FromPage, Numbers, Role, ServerMessage, Unit, Upload } from "./protocol";

type Message<T extends ServerMessage["type"]> = Extract<ServerMessage, { type: T }>;

export interface MeshData {
  positions: Float32Array;
  triangles: Uint32Array;
  lines: Uint32Array;
  colors: Uint8Array | null;
  of: number;
}

export interface ValueData {
  title: string;
  values: Float32Array;
  low: number;
  high: number;
}

export const app = {
  welcome: null as Message<"welcome"> | null,
  cases: [] as CaseSummary[],
  open: null as Message<"case"> | null,
  plan: null as Message<"plan"> | null,
  analysis: null as Analysis | null,
  compared: [] as CompareRow[],
  articles: [] as Article[],
  progress: null as Message<"progress"> | null,
  steps: [] as Message<"step">[],
  connected: false,
  /** The server was started again, and does not know this page. */
  locked: false,
  /** Numbers of sliders that wait for the server, by key: they stand there until it has answered. */
  typed: new Map<string, number>(),
  meshes: new Map<string, MeshData>(),
  positions: new Map<string, Float32Array>(),
  values: new Map<string, ValueData>(),
};

const listeners: ((what: string) => void)[] = [];

/** Called with the type of a message, or `numbers:SLOT`. */
export function onChange(listener: (what: string) => void) {
  listeners.push(listener);
}

export function changed(what: string) {
  for (const listener of listeners) listener(what);
}

// --- what belongs to whom ---

type Open = Message<"case">;
const scanOf = ({ case: c }: Open) => (c.scan === null ? null : c.scans[c.scan]);
/** What tells a client from another, a scan in work with its template and rig, and a face that plans change. */
const OWNERS = {
  client: (_: Open) => [],
  scan: (m: Open) => [m.case.template, m.case.rig, scanOf(m)],
  face: (m: Open) => [m.case.template, m.case.rig, m.case.wrapped?.mesh],
};
type Owner = keyof typeof OWNERS;
const owned: { owner: Owner; of: string; forget: () => void }[] = [];

/** What is kept of a client, scan or face is forgotten when another one is shown: everything of that kind is named by this. */
export function belongs(owner: Owner, forget: () => void) {
  owned.push({ owner, of: "", forget });
}

function forgetOthers(m: Open | null) {
  for (const thing of owned) {
    const of = m ? JSON.stringify([m.id, OWNERS[thing.owner](m)]) : "";
    if (thing.of !== of) thing.forget();
    thing.of = of;
  }
}

belongs("client", () => {
  app.plan = null;
  for (const map of [app.meshes, app.positions, app.values]) map.clear();
});
belongs("scan", () => {
  app.compared = [];
  app.steps = [];
});
belongs("face", () => (app.analysis = null));

let socket: WebSocket | null = null;

/** The client that this window shows: it shows the same one after a reload, whatever other windows have opened. */
const CLIENT = "client";

export function connect() {
  const client = sessionStorage.getItem(CLIENT);
  socket = new WebSocket(`ws://${location.host}/socket${client ? `?client=${client}` : ""}`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    app.connected = true;
    app.locked = false;
    changed("connection");
  };
  socket.onclose = () => {
    const lost = app.connected;
    app.connected = false;
    if (app.progress) toast(`The server is gone, and with it what ran (${app.progress.what}): start it again.`, "error");
    app.progress = null;
    // not at each attempt: nothing is drawn anew under a hand
    if (lost) changed("connection");
    void fetch("/").then((answer) => {
      if (app.locked === (answer.status === 401)) return;
      app.locked = !app.locked;
      changed("connection");
    }, () => {});
    setTimeout(connect, 1000);
  };
  socket.onmessage = (event) => (typeof event.data === "string" ? message(JSON.parse(event.data)) : numbers(event.data));
}

/** Changes that the server has not heard yet; they outlast a reload. */
const UNHEARD = "unheard";
export let unheard: FromPage[] = JSON.parse(sessionStorage.getItem(UNHEARD) ?? "[]");

function keepUnheard(messages: FromPage[]) {
  unheard = messages;
  try {
    sessionStorage.setItem(UNHEARD, JSON.stringify(messages));
  } catch {
    // too much for the browser to keep: while the page is open they are there
  }
}

/** Whether a change waits for the server. A region, a recipe and what is written of a client wait where they were made. */
function canWait(message: ClientMessage): boolean {
  return message.type === "place" || message.type === "paint_mask" || (message.type === "edit" && !["add_step", "set_recipe", "describe"].includes(message.edit.edit));
}

/** Sends what has waited for the client that is shown. */
function tellUnheard() {
  const [mine, others] = [true, false].map((own) => unheard.filter((m) => (m.case === app.open?.id) === own)) as [FromPage[], FromPage[]];
  if (mine.length === 0 || socket?.readyState !== WebSocket.OPEN) return;
  keepUnheard(others);
  for (const message of mine) socket.send(JSON.stringify(message));
  toast("The server is back and does now what you changed meanwhile.", "note");
}

/** Sends what is meant for a client: the one that is shown, or that was when the user began. */
export function send(message: ClientMessage, client = app.open?.id ?? null) {
  const whole: FromPage = { case: client, ...message };
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(whole));
  else if (canWait(message)) {
    keepUnheard([...unheard, whole]);
    toast("The server does not answer: is the program still running? What you change is kept here, and done when it is back.", "error");
    changed("unheard");
  } else {
    toast("The server does not answer: is the program still running? This was not done.", "error");
    changed("error");
  }
}

/** What a change is made on: the client, the plan and the revision that are shown. */
export function shown() {
  return { client: app.open?.id ?? null, plan: app.open?.case.plan ?? 0, revision: app.open?.revision ?? 0 };
}

/** Names in a list; those that come again are counted, as two scans that are called `scan.ply`. */
export function counted(things: { name: string }[]): string[] {
  return things.map(({ name }, k) => {
    const before = things.slice(0, k).filter((other) => other.name === name).length;
    return before ? `${name} (${before + 1})` : name;
  });
}

/** Of which scan the face is that plans change; what would mislead stands out. */
export function faceShown(): HTMLElement | null {
  const { case: c, current } = app.open!;
  if (!c.wrapped && !c.template) return null;
  if (c.wrapped && !current) return h("p", { class: "doubt" }, `Face: wrapped onto ${c.wrapped.scan}, not onto the scan in work as it is now; wrap that under Wrap.`);
  if (c.wrapped) return h("p", { class: "hint" }, `Face: wrapped onto ${c.wrapped.scan}.`);
  return h("p", { class: c.scan === null ? "hint" : "doubt" }, c.scan === null ? "Face: the template." : "Face: the template; nothing is wrapped onto the scan yet.");
}

/** Changes the case; what another window has changed since `on` was shown, the server does not let be changed unseen. */
export function edit(change: Edit, on = shown()) {
  const { client, plan, revision } = on;
  send({ type: "edit", plan, revision, edit: change }, client);
}

export function preview(change: Edit | null) {
  send({ type: "preview", edit: change });
}

function message(m: ServerMessage) {
  switch (m.type) {
    case "welcome":
      app.welcome = m;
      app.progress = null;
      break;
    case "cases":
      app.cases = m.cases;
      break;
    case "case":
      forgetOthers(m);
      sessionStorage.setItem(CLIENT, String(m.id));
      app.open = m;
      app.typed.clear();
      tellUnheard();
      break;
    case "no_case":
      forgetOthers(null);
      sessionStorage.removeItem(CLIENT);
      app.open = null;
      break;
    case "error":
      app.progress = null;
      toast(m.text, "error");
      break;
    case "note":
      toast(m.text, "note");
      break;
    case "progress":
      if (app.progress === null) app.steps = [];
      app.progress = m;
      break;
    case "idle":
      app.progress = null;
      break;
    case "step":
      app.steps.push(m);
      break;
    case "plan":
      app.plan = { ...m, command: m.preview ? (app.plan?.command ?? "") : m.command };
      break;
    case "analysis":
      app.analysis = m.analysis;
      break;
    case "compared":
      app.compared = [...app.compared.filter((row) => row.model !== m.row.model), m.row];
      break;
    case "exported":
      download(`/files/${m.at.asset}/${encodeURIComponent(m.at.file)}`, m.at.file);
      break;
    case "articles":
      app.articles = m.articles;
      break;
    case "unit_wanted":
      break;
  }
  if (m.type === "unit_wanted") wanted(m);
  changed(m.type);
}

let wanted: (m: Message<"unit_wanted">) => void = () => {};

/** What asks the user for a unit. */
export function onUnitWanted(ask: (m: Message<"unit_wanted">) => void) {
  wanted = ask;
}

function numbers(data: ArrayBuffer) {
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as Numbers;
  let at = 4 + length;
  const next = (bytes: number) => {
    const start = Math.ceil(at / 4) * 4;
    at = start + bytes;
    return start;
  };
  switch (header.numbers) {
    case "mesh": {
      const positions = new Float32Array(data, next(12 * header.vertices), 3 * header.vertices);
      const triangles = new Uint32Array(data, next(12 * header.triangles), 3 * header.triangles);
      const lines = new Uint32Array(data, next(8 * header.lines), 2 * header.lines);
      const colors = header.colors ? new Uint8Array(data, next(3 * header.vertices), 3 * header.vertices) : null;
      app.meshes.set(header.slot, { positions, triangles, lines, colors, of: header.of });
      app.positions.delete(header.slot);
      app.values.delete(header.slot);
      break;
    }
    case "positions":
      app.positions.set(header.slot, new Float32Array(data, next(12 * header.vertices), 3 * header.vertices));
      if (header.slot === "plan") app.values.delete("plan");
      break;
    case "values": {
      const values = new Float32Array(data, next(4 * header.vertices), header.vertices);
      app.values.set(header.slot, { title: header.title, values, low: header.low, high: header.high });
      break;
    }
    case "clear":
      for (const map of [app.meshes, app.positions, app.values]) map.delete(header.slot);
      break;
  }
  changed(`numbers:${header.slot}`);
}

export function toast(text: string, kind: "error" | "note") {
  const place = document.getElementById("toasts");
  if (!place) return;
  // said again, as in each frame of a drag, it stands there once
  for (const there of [...place.children]) if (there.textContent === text) there.remove();
  const element = document.createElement("div");
  element.className = `toast ${kind}`;
  element.textContent = text;
  element.setAttribute("role", kind === "error" ? "alert" : "status");
  element.title = "Click to close";
  element.onclick = () => element.remove();
  place.append(element);
  setTimeout(() => element.remove(), kind === "error" ? 15000 : 6000);
}

export function download(url: string, name: string) {
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
}

/** Sends files and lets them join the case. */
export async function addFiles(role: Role, files: File[], unit: Unit | null = null) {
  const uploads: Upload[] = [];
  const client = app.open?.id ?? null;
  app.progress = { type: "progress", what: "sending files", share: 0 };
  changed("progress");
  try {
    for (const [k, file] of files.entries()) {
      const answer = await fetch(`/upload?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file }).catch(() => {
        throw new Error(`${file.name} did not get to the server: may it be read, and does the program still run? Add it again.`);
      });
      const text = await answer.text();
      if (!answer.ok) throw new Error(text);
      uploads.push({ id: text, name: file.name });
      app.progress = { type: "progress", what: "sending files", share: (k + 1) / files.length };
      changed("progress");
    }
    // files of a mesh or rig belong together; each photo, recipe, client or file of landmarks is one of its own
    const together = ["template", "scan", "rig", "schedule"].includes(role);
    for (const files of together ? [uploads] : uploads.map((one) => [one])) send({ type: "add", role, files, unit }, client);
  } catch (error) {
    toast(error instanceof Error ? error.message : String(error), "error");
  }
  app.progress = null;
  changed("progress");
}

export async function copy(text: string) {
  try {
    await navigator.clipboard.writeText(text);
    toast("Copied.", "note");
  } catch {
    toast("The browser does not let the page copy: select the text and copy it by hand.", "error");
  }
}
