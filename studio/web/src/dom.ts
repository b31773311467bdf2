// Elements by hand: `h("button", { onclick }, "Run")`. Text is always text, so no name from a file can be markup.

import { app, toast } from "./app";

type Child = Node | string | number | null | undefined | false | Child[];
type Attributes = Record<string, unknown>;

export function h<K extends keyof HTMLElementTagNameMap>(tag: K, attributes: Attributes = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  set(element, attributes);
  add(element, children);
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

export function svg(tag: string, attributes: Attributes = {}, ...children: Child[]): SVGElement {
  const element = document.createElementNS(SVG, tag);
  set(element, attributes);
  add(element, children);
  return element;
}

function set(element: Element, attributes: Attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    // what a handler returns means nothing: a false would take Tab from the keyboard
    if (typeof value === "function") (element as unknown as Attributes)[name] = (event: Event) => void value(event);
    else if (name === "value" || name === "checked") (element as unknown as Attributes)[name] = value;
    else element.setAttribute(name, value === true ? "" : String(value));
  }
}

function add(element: Element, children: Child[]) {
  for (const child of children) {
    if (child === null || child === undefined || child === false) continue;
    if (Array.isArray(child)) add(element, child);
    else element.append(child instanceof Node ? child : String(child));
  }
}

export function button(text: string, onclick: () => void, attributes: Attributes = {}): HTMLButtonElement {
  return h("button", { type: "button", onclick, ...attributes }, text);
}

/** What makes a row or card of a list a thing to choose, by click or by keys; the arrows lead to its neighbours. */
export function row(chosen: boolean, choose: () => void): Attributes {
  const keys = (event: KeyboardEvent) => {
    const here = event.currentTarget as HTMLElement;
    if (event.target !== here) return;
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) {
      const rows = [...here.parentElement!.children].filter((other): other is HTMLElement => other instanceof HTMLElement && other.tabIndex === 0);
      rows[rows.indexOf(here) + step]?.focus();
    } else if (event.key === "Enter" || event.key === " ") choose();
    else return;
    event.preventDefault();
    event.stopPropagation();
  };
  return { tabindex: 0, "aria-current": chosen ? "true" : undefined, onclick: choose, onkeydown: keys };
}

export function toggle(text: string, on: boolean, onclick: () => void, attributes: Attributes = {}): HTMLButtonElement {
  return button(text, onclick, { class: on ? "on" : "", "aria-pressed": String(on), ...attributes });
}

/** A toggle of what is so or not so. */
export function flag<K extends string>(text: string, of: Record<K, boolean>, key: K, redraw: () => void, attributes: Attributes = {}): HTMLButtonElement {
  return toggle(text, of[key], () => {
    of[key] = !of[key];
    redraw();
  }, attributes);
}

export function select(options: (string | [string, string])[], value: string, onchange: (value: string) => void, attributes: Attributes = {}) {
  const list = options.map((option) => (typeof option === "string" ? [option, option] : option));
  const taken = () => {
    hand.busy = false;
    onchange(element.value);
    hand.free();
  };
  const left = () => {
    hand.busy = false;
    hand.free();
  };
  const element = h("select", { ...attributes, onchange: taken, onblur: left }, list.map(([v, text]) => h("option", { value: v, selected: v === value }, text)));
  return element;
}

export interface SliderOptions {
  key: string;
  label: string;
  min: number;
  max: number;
  step: number;
  value: number;
  unit?: string;
  title?: string;
  live?: (value: number) => void;
  done: (value: number) => void;
  /** Enter in the field of the number, when its value is taken over. */
  enter?: () => void;
}

/** Whether a hand is at a control, so that the page is not drawn again under it; `free` is called when it lets go. */
export const hand = { busy: false, free: () => {} };

/** How long after the last key a slider that keys move is let go, ms: five presses are one step to undo. */
const PAUSE = 400;

/** A slider with its number; `live` while it moves, `done` when it is let go. Double click brings 0 back. */
export function slider(given: SliderOptions): HTMLElement {
  const done = (value: number) => {
    if (!app.connected) app.typed.set(given.key, value);
    given.done(value);
  };
  const o = { ...given, value: app.typed.get(given.key) ?? given.value, done };
  const shown = (v: number) => String(Number(v.toFixed(2)));
  const number = h("input", { type: "number", min: o.min, max: o.max, step: o.step, value: shown(o.value), "data-key": `${o.key}#`, "aria-label": o.label });
  const range = h("input", { type: "range", min: o.min, max: o.max, step: o.step, value: String(o.value), "data-key": o.key, "aria-label": o.label });
  range.oninput = () => {
    number.value = shown(Number(range.value));
    o.live?.(Number(range.value));
  };
  let keyed = false;
  let timer = 0;
  const settle = () => {
    if (timer === 0) return;
    clearTimeout(timer);
    timer = 0;
    hand.busy = false;
    o.done(Number(range.value));
    hand.free();
  };
  range.onpointerdown = () => {
    keyed = false;
  };
  range.onkeydown = (event) => {
    keyed = true;
    if (event.ctrlKey || event.metaKey) settle();
  };
  range.onblur = settle;
  range.onchange = () => {
    if (!keyed) return o.done(Number(range.value));
    hand.busy = true;
    clearTimeout(timer);
    timer = window.setTimeout(settle, PAUSE);
  };
  // a number that is half typed stays; out of it, or Enter, takes it over
  let typing = false;
  const typed = () => {
    const value = Number(number.value);
    const inside = number.value !== "" && value >= o.min && value <= o.max;
    if (typing && inside) o.done(value);
    else if (typing) {
      toast(`${o.label} goes from ${o.min} to ${o.max}; what was typed is not taken over.`, "error");
      number.value = shown(o.value);
    }
    typing = false;
    hand.busy = false;
    hand.free();
  };
  number.oninput = () => {
    typing = true;
    hand.busy = true;
  };
  number.onchange = typed;
  number.onblur = () => typing && typed();
  number.onkeydown = (event) => {
    if (event.key !== "Enter") return;
    typed();
    o.enter?.();
  };
  range.ondblclick = () => {
    range.value = "0";
    number.value = "0";
    o.done(0);
  };
  return h("label", { class: o.value !== 0 ? "slider set" : "slider", title: o.title }, h("span", {}, o.label), range, number, h("small", {}, o.unit ?? "mm"));
}

export function section(title: string, ...children: Child[]): HTMLElement {
  return h("section", {}, h("h2", {}, title), children);
}

/** Asks for a line of text; null when it is not given. */
export function ask(title: string, value = ""): Promise<string | null> {
  const input = h("input", { value, "data-key": "ask" });
  return dialog(title, [input], "OK", () => input.value.trim() || null, () => input.select());
}

/** Asks whether to do something that cannot be undone. */
export async function sure(text: string, what: string): Promise<boolean> {
  return (await dialog(text, [], what, () => "yes")) !== null;
}

export function dialog(title: string, body: Child[], ok: string, value: () => string | null, shown?: () => void): Promise<string | null> {
  return new Promise((resolve) => {
    const form = h("form", { method: "dialog" }, h("h2", {}, title), body, h("div", { class: "row end" }, button("Cancel", () => close(null)), h("button", { class: "main" }, ok)));
    const element = h("dialog", {}, form);
    const close = (answer: string | null) => {
      element.remove();
      resolve(answer);
    };
    form.onsubmit = (event) => {
      event.preventDefault();
      close(value());
    };
    element.oncancel = () => close(null);
    // beside it, as by the second click of two, it keeps the focus
    element.onmousedown = (event) => event.target === element && event.preventDefault();
    document.body.append(element);
    element.showModal();
    shown?.();
  });
}
