// Clients: the vault's cases, and what belongs to the one that is open.

import { app, belongs, counted, edit, onChange, send } from "./app";
import { ask, button, h, row, section, sure } from "./dom";
import type { CaseSummary } from "./protocol";
import { MESHES, pickFiles } from "./wrap";

let query = "";

/** What was written about the client, until the server has it: what is refused, or not heard, is still there to be sent again. */
let written: { name?: string; date?: string; notes?: string } = {};
belongs("client", () => (written = {}));

onChange((what) => {
  const kept = app.open?.case;
  if (what === "case" && kept) for (const key of ["name", "date", "notes"] as const) if (written[key]?.trim() === kept[key].trim()) delete written[key];
});

/** Whether something that was written of the client is not kept. */
export const isUnkept = () => Object.keys(written).length > 0;

export function page(go: (mode: string) => void): HTMLElement {
  const shown = app.open;
  const open = (c: CaseSummary) => !c.trouble && send({ type: "open_case", id: c.id });
  const search = h("input", { type: "search", placeholder: "Search names, notes, plans", value: query, "data-key": "search-cases", "aria-label": "search clients" });
  search.oninput = () => {
    query = search.value;
    send({ type: "list_cases", query });
  };
  const list = h(
    "div",
    { class: "cards" },
    app.cases.map((c) =>
      h(
        "div",
        { class: `card ${c.id === shown?.id ? "selected" : ""}`, ...row(c.id === shown?.id, () => open(c)) },
        h("b", {}, c.name),
        h("small", {}, [c.date, `${c.scans} scan${c.scans === 1 ? "" : "s"}`, c.wrapped ? "wrapped" : "", `${c.plans} plan${c.plans === 1 ? "" : "s"}`].filter(Boolean).join(" · ")),
        h("p", { class: "clip" }, c.notes),
        c.trouble && h("p", { class: "doubt" }, c.trouble),
        c.trouble && button("Delete", () => void sure(`Delete ${c.name} with all its files? This cannot be undone.`, "Delete for good").then((yes) => yes && send({ type: "delete_case", id: c.id })), { class: "danger" }),
      ),
    ),
    app.cases.length === 0 && h("p", { class: "hint" }, query ? "No client has these words." : "No clients yet: make one with New client."),
  );
  return h(
    "main",
    { class: "page two" },
    h("aside", {}, h("div", { class: "row" }, search, button("New client", () => void ask("The client's name").then((name) => name && send({ type: "new_case", name })), { class: "main" }), button("Import", () => pickFiles("case", ".zip"), { title: "A client that was exported as a zip file" })), list, h("small", { class: "hint" }, `Kept in ${app.welcome?.vault ?? ""}`)),
    shown ? details(go) : h("div", { class: "empty" }, h("p", {}, "Choose a client on the left, or make a new one.")),
  );
}

function details(go: (mode: string) => void): HTMLElement {
  const { case: c, id } = app.open!;
  const [scans, plans] = [counted(c.scans), counted(c.plans)];
  // the page is not drawn anew while a text is written: the rest of them is what it is by now
  const describe = (part: typeof written) => {
    const { name, date, notes } = app.open!.case;
    Object.assign(written, part);
    edit({ edit: "describe", name, date, notes, ...written });
  };
  const field = (label: string, value: string, change: (value: string) => void) => {
    const input = h("input", { value, "data-key": `client-${label}` });
    input.onchange = () => change(input.value);
    return h("label", { class: "field" }, h("span", {}, label), input);
  };
  const notes = h("textarea", { rows: 8, "data-key": "client-notes" });
  notes.value = written.notes ?? c.notes;
  notes.onchange = () => describe({ notes: notes.value });
  return h(
    "div",
    { class: "details" },
    section("Client", field("Name", written.name ?? c.name, (name) => describe({ name })), field("Date", written.date ?? c.date, (date) => describe({ date })), h("label", { class: "field" }, h("span", {}, "Notes"), notes), isUnkept() && h("div", { class: "row" }, h("p", { class: "doubt" }, "Not kept yet."), button("Keep", () => describe({})))),
    section(
      "Scans",
      scans.map((name, k) => h("div", { class: "row" }, h("span", { class: "grow clip" }, name, k === c.scan && h("small", {}, " in work")), button("Open", () => {
        edit({ edit: "use_scan", index: k });
        go("wrap");
      }), button("×", () => edit({ edit: "remove_scan", index: k }), { title: "Remove; undo brings it back", "aria-label": `remove ${name}` }))),
      button("Add a scan", () => pickFiles("scan", MESHES)),
    ),
    section("Plans", c.plans.map((plan, k) => h("div", { class: "row" }, h("span", { class: "grow clip" }, plans[k], plan.id === c.plan && h("small", {}, " in work")), button("Open", () => {
      edit({ edit: "use_plan", id: plan.id });
      go("plan");
    })))),
    section(
      "Photos",
      h(
        "div",
        { class: "photos" },
        c.photos.map((photo, k) => h("figure", {}, h("img", { src: `/files/${photo.at.asset}/${encodeURIComponent(photo.at.file)}`, alt: photo.name }), h("figcaption", { class: "row" }, h("span", { class: "grow clip" }, photo.name), button("×", () => edit({ edit: "remove_photo", index: k }), { "aria-label": `remove ${photo.name}` })))),
      ),
      button("Add a photo", () => pickFiles("photo", ".png,.jpg,.jpeg,.webp")),
    ),
    section(
      "This client",
      h(
        "div",
        { class: "row wrap" },
        button("Export as zip", () => send({ type: "export", what: { export: "case" } })),
        button("Delete", () => void sure(`Delete ${c.name} with all scans, plans and photos? This cannot be undone.`, "Delete for good").then((yes) => {
          if (yes) send({ type: "delete_case", id });
        }), { class: "danger" }),
      ),
    ),
  );
}
