// The knowledge base: articles in Markdown, some with a recipe that joins the plan in work.

import { app, edit, onChange, send } from "./app";
import { button, h, row, sure } from "./dom";
import type { Article } from "./protocol";

const state = { query: "", chosen: 0, writing: null as Article | null };

/** An article that was sent, until the server has it: one that is refused, or not heard, is still there to be corrected. */
let sent: Article | null = null;

onChange((what) => {
  if (what === "articles" && sent === state.writing) state.writing = null;
  if (["articles", "error", "connection"].includes(what)) sent = null;
});

export function enter() {
  send({ type: "list_articles", query: state.query });
}

/** Headings, lists, paragraphs, **bold**, *slanted* and `code`; everything else is text. */
export function markdown(text: string): HTMLElement {
  const inline = (line: string) =>
    line.split(/(\*\*[^*]+\*\*|\*[^*]+\*|`[^`]+`)/).map((part) => {
      if (part.startsWith("**") && part.length > 4) return h("b", {}, part.slice(2, -2));
      if (part.startsWith("*") && part.length > 2) return h("i", {}, part.slice(1, -1));
      if (part.startsWith("`") && part.length > 2) return h("code", {}, part.slice(1, -1));
      return part;
    });
  const blocks = text.split(/\n\s*\n/).filter((b) => b.trim());
  return h(
    "div",
    { class: "markdown" },
    blocks.map((block) => {
      const lines = block.split("\n").filter((line) => line.trim());
      const heading = /^(#{1,3}) (.*)/.exec(lines[0] ?? "");
      if (heading && lines.length === 1) return h(heading[1]!.length === 1 ? "h2" : "h3", {}, inline(heading[2]!));
      if (lines.every((line) => /^[-*] /.test(line))) return h("ul", {}, lines.map((line) => h("li", {}, inline(line.slice(2)))));
      return h("p", {}, inline(lines.join(" ")));
    }),
  );
}

export function page(redraw: () => void, go: (mode: string) => void): HTMLElement {
  const search = h("input", { type: "search", placeholder: "Search titles, tags, text", value: state.query, "data-key": "search-articles", "aria-label": "search articles" });
  search.oninput = () => {
    state.query = search.value;
    enter();
  };
  const choose = (article: Article) => {
    state.chosen = article.id;
    state.writing = null;
    redraw();
  };
  const chosen = app.articles.find((a) => a.id === state.chosen) ?? app.articles[0];
  return h(
    "main",
    { class: "page two" },
    h(
      "aside",
      {},
      h("div", { class: "row" }, search, button("New article", () => {
        state.writing = { id: 0, title: "", tags: "", body: "", recipe: "" };
        redraw();
      }, { class: "main" })),
      h("div", { class: "cards" }, app.articles.map((a) => h("div", { class: `card ${a === chosen && !state.writing ? "selected" : ""}`, ...row(a === chosen && !state.writing, () => choose(a)) }, h("b", {}, a.title), h("small", {}, a.tags)))),
    ),
    state.writing ? write(state.writing, redraw) : chosen ? read(chosen, redraw, go) : h("div", { class: "empty" }, h("p", {}, "No article has these words.")),
  );
}

function read(article: Article, redraw: () => void, go: (mode: string) => void): HTMLElement {
  const preset = app.welcome?.presets.find((p) => p.name === article.title);
  return h(
    "div",
    { class: "details" },
    h("h1", {}, article.title),
    h("small", {}, article.tags),
    markdown(article.body),
    article.recipe && h("pre", {}, article.recipe),
    h(
      "div",
      { class: "row wrap" },
      article.recipe &&
        button("Use in plan", () => {
          if (preset) edit({ edit: "set_preset", preset: preset.name, amount: preset.amount, side: "both" });
          else edit({ edit: "new_plan", name: article.title, copy_of: null, recipe: article.recipe });
          go("plan");
        }, { class: "main", disabled: app.open === null, title: preset ? "Adds it to the plan in work" : "A new plan of this recipe" }),
      button("Change", () => {
        state.writing = { ...article };
        redraw();
      }),
      button("Delete", () => void sure(`Delete the article ${article.title}? This cannot be undone.`, "Delete").then((yes) => yes && send({ type: "delete_article", id: article.id })), { class: "danger" }),
    ),
  );
}

function write(article: Article, redraw: () => void): HTMLElement {
  const field = (label: string, key: "title" | "tags" | "body" | "recipe", rows: number) => {
    const input = rows === 1 ? h("input", { "data-key": `article-${key}` }) : h("textarea", { rows, "data-key": `article-${key}`, spellcheck: key === "body" ? "true" : "false" });
    input.value = article[key];
    input.oninput = () => (article[key] = input.value);
    return h("label", { class: "field" }, h("span", {}, label), input);
  };
  const plan = app.open?.case.plans.find((p) => p.id === app.open?.case.plan);
  return h(
    "div",
    { class: "details" },
    field("Title", "title", 1),
    field("Tags", "tags", 1),
    field("Text (Markdown)", "body", 12),
    field("Recipe (TOML), or nothing", "recipe", 10),
    h(
      "div",
      { class: "row" },
      button("Save", () => {
        sent = article;
        send({ type: "save_article", article });
      }, { class: "main" }),
      plan && button("Take the plan in work", () => {
        article.recipe = plan.recipe;
        redraw();
      }),
      button("Cancel", () => {
        state.writing = null;
        redraw();
      }),
    ),
  );
}
