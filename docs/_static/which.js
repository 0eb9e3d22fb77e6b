// docs/how_to/which.md: its first table answers five questions, its table of graphs becomes cards with filters.
// Without this script both remain tables.
"use strict";
(() => {
  const text = (node) => node.textContent.replace(/\s+/g, " ").trim();
  const period = (cell, value) => cell === "any" || cell === (value > 12 ? "long" : "short");
  const listed = (cell, value) => cell === "any" || cell.split(", ").includes(value);

  // The first row whose conditions hold, as in `dmframe which`: rows of five cells, the period in ms.
  const firstRow = (rows, answers) =>
    rows.findIndex((cells) => cells.every((cell, k) => (k === 1 ? period(cell, answers[k]) : listed(cell, answers[k]))));
  globalThis.dmframeWhich = { firstRow };
  if (typeof document === "undefined") return;

  const made = (name, properties = {}, ...children) => {
    const node = Object.assign(document.createElement(name), properties);
    node.append(...children);
    return node;
  };
  const labelled = (label, field) => made("label", {}, `${label} `, field);
  const options = (values) => values.map((value) => made("option", { value }, value));
  const inner = (cell) => (cell.querySelector("p") ?? cell).innerHTML;
  const heads = (table) => [...table.tHead.rows[0].cells].map(text);
  const bodyRows = (table) => [...table.tBodies[0].rows];

  function ask(table) {
    const rows = bodyRows(table), cells = rows.map((row) => [...row.cells].slice(0, 5).map(text));
    const values = [
      ["unknown", "stiff", "p_pi", "soft", "torque"], null, ["varies", "repeats", "stops"],
      ["constant", "changes"], ["lengths", "delay", "nothing"],
    ];
    const fields = values.map((choices) =>
      choices ? made("select", {}, ...options(choices)) : made("input", { type: "number", min: 0.1, step: "any", value: 8 }));
    const answer = made("output");
    const show = () => {
      const chosen = firstRow(cells, fields.map((field, k) => (k === 1 ? Number(field.value) : field.value)));
      rows.forEach((row, k) => row.classList.toggle("which-answer", k === chosen));
      const kind = fields[1].value > 12 ? "long" : "short";
      const line = (cell) => {
        const lines = inner(cell).split(/<br\s*\/?>/);
        return lines.find((part) => part.includes(`${kind}: `))?.replace(`${kind}: `, "") ?? lines[0];
      };
      const [take, error, why] = [...rows[chosen].cells].slice(5);
      answer.innerHTML = `<strong>Take ${line(take)}</strong>: ${inner(why)}. Error in mm, ideal / with <code>ur</code>: ${line(error)}.`;
    };
    const labels = ["servo", "period, ms", "path", "load", "known"];
    const form = made("form", { className: "which-questions" }, ...fields.map((field, k) => labelled(labels[k], field)), answer);
    form.addEventListener("input", show);
    form.addEventListener("submit", (event) => event.preventDefault());
    const wrapper = table.closest(".table-wrapper"), whole = made("details", {}, made("summary", {}, "All answers"));
    wrapper.before(form, whole);
    whole.append(wrapper);
    show();
  }

  function cards(table) {
    const names = heads(table), rows = bodyRows(table);
    table.classList.add("which-cards");
    let last = "";
    for (const row of rows) {
      [...row.cells].forEach((cell, k) => cell.setAttribute("data-head", names[k]));
      const use = text(row.cells[0]).replace(/ \S+$/, ""); // without the graph's name
      if (!/^(baseline: )?the same/.test(use)) last = use;
      else row.cells[0].prepend(made("small", { textContent: `${last}; ` }));
    }
    const short = { proved: (cell) => cell.replace(/ over samples.*|, but.*/, (part) => (part[0] === "," ? ", in part" : " over samples")) };
    const facets = [["controlled", (cell) => cell.split(";")[0]], ["robot", (cell) => cell.split(",")[0]],
      ["servo, command, clock", (cell) => cell.split(",")[0]], ["servo, command, clock", (cell) => cell.split(", ").at(-1), "clock"],
      ["proved", short.proved]];
    const selects = facets.map(([head, of, label]) => {
      const at = names.indexOf(head);
      const read = (row) => of(text(row.cells[at])).replace(", as admittance shifts it", "");
      const values = [...new Set(rows.map(read))].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
      return { read, field: made("select", {}, made("option", { value: "" }, "any"), ...options(values)), label: label ?? head.split(",")[0] };
    });
    const search = made("input", { type: "search", placeholder: "words" });
    const count = made("output");
    const show = () => {
      const words = search.value.toLowerCase().split(/\s+/);
      for (const row of rows) {
        const fits = selects.every(({ read, field }) => !field.value || read(row) === field.value);
        row.hidden = !(fits && words.every((word) => text(row).toLowerCase().includes(word)));
      }
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} graphs`;
    };
    const form = made("form", { className: "which-filters" }, labelled("contains", search),
      ...selects.map(({ label, field }) => labelled(label, field)), count);
    form.addEventListener("input", show);
    form.addEventListener("submit", (event) => event.preventDefault());
    table.closest(".table-wrapper").before(form);
    show();
  }

  document.addEventListener("DOMContentLoaded", () => {
    for (const table of document.querySelectorAll(".table-wrapper table")) {
      const names = table.tHead ? heads(table) : [];
      if (names[0] === "servo" && names[5] === "take") ask(table);
      if (names[0] === "use it if") cards(table);
    }
  });
})();
