// Tables sort by the column that is clicked, contents fold where the window is narrow, everything unfolds in print.
"use strict";
const contents = document.querySelector("#contents details");
const wide = matchMedia("(min-width: 1200px)");
const fold = () => { contents.open = wide.matches; };
wide.addEventListener("change", fold);
fold();
contents.addEventListener("click", (e) => {
  if (e.target.tagName !== "A") return;
  const section = document.querySelector(e.target.getAttribute("href")).closest("details");
  if (section) section.open = true;
  if (!wide.matches) contents.open = false;
});

// A number first in its cell counts as that number; words come after all numbers.
const key = (row, column) => {
  const text = row.cells[column].textContent.trim();
  const value = parseFloat(text.replace("−", "-"));
  return [Number.isNaN(value) ? Infinity : value, text];
};
const compare = (a, b) => (a[0] === b[0] ? a[1].localeCompare(b[1]) : a[0] < b[0] ? -1 : 1);
document.querySelectorAll("table").forEach((table) => {
  const head = table.rows[0];
  const body = head.parentNode;
  const rows = Array.from(table.rows).slice(1);
  Array.from(head.cells).forEach((cell, column) => {
    cell.setAttribute("aria-sort", "none");
    cell.tabIndex = 0;
    const sort = () => {
      const down = cell.getAttribute("aria-sort") === "ascending";
      Array.from(head.cells).forEach((other) => other.setAttribute("aria-sort", "none"));
      cell.setAttribute("aria-sort", down ? "descending" : "ascending");
      const keyed = rows.map((row) => [key(row, column), row]);
      keyed.sort((a, b) => compare(a[0], b[0]) * (down ? -1 : 1));
      keyed.forEach(([, row]) => body.appendChild(row));
    };
    cell.addEventListener("click", sort);
    cell.addEventListener("keydown", (e) => { if (e.key === "Enter") sort(); });
  });
});

let folded = [];
addEventListener("beforeprint", () => {
  folded = Array.from(document.querySelectorAll("details.study:not([open])"));
  folded.forEach((section) => { section.open = true; });
});
addEventListener("afterprint", () => folded.forEach((section) => { section.open = false; }));
