// The help sheet.

import { button, h } from "./dom";

const KEYS: [string, [string, string][]][] = [
  ["Everywhere", [
    ["Ctrl Z, Ctrl Shift Z", "undo, redo: everything, without limit"],
    ["Alt 1 … 6", "Clients, Wrap, Compare, Plan, Analyse, Knowledge"],
    ["1, 2, 3, 4", "view from the front, three-quarter, left, right"],
    ["0", "show all"],
    ["W, H", "polygons, heat map"],
    ["Esc", "cancel what runs or what is drawn"],
    ["Tab, ↑ ↓, Enter", "to a list, along it, choose a row"],
    ["?", "this sheet"],
  ]],
  ["Views", [
    ["drag", "turn"],
    ["Shift drag, right button", "shift"],
    ["wheel, two fingers, pinch", "nearer, farther"],
  ]],
  ["Wrap", [
    ["click", "place a landmark"],
    ["drag a point", "correct it"],
    ["Delete", "remove the selected landmark"],
    ["Enter", "wrap"],
    ["Alt while painting", "the other way round"],
  ]],
  ["Plan", [
    ["V C E S P L F N", "view, circle, ellipse, sector, polygon, lasso, brush, pin"],
    ["drag the round handle", "move the region"],
    ["Enter, Esc", "keep, discard; Enter also in the field of a number"],
    ["hold B", "before"],
    ["double click a slider", "back to 0"],
  ]],
];

export function toggleHelp() {
  const there = document.getElementById("help");
  if (there) return there.remove();
  const close = () => document.getElementById("help")?.remove();
  const sheet = h("dialog", { id: "help" }, h("div", { class: "row" }, h("h2", { class: "grow" }, "Keys and mouse"), button("Close", close)), h("div", { class: "columns" }, KEYS.map(([title, keys]) => h("section", {}, h("h3", {}, title), h("dl", {}, keys.map(([key, what]) => [h("dt", {}, key), h("dd", {}, what)]))))));
  sheet.onclick = (event) => event.target === sheet && close();
  sheet.onclose = close;
  document.body.append(sheet);
  sheet.showModal();
}
