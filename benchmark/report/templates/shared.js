"use strict";
// Everything measured is text: it reaches the page by textContent and attributes, never as markup.
const data = JSON.parse(document.getElementById("data").textContent);
const ALL = "all";

// ---- small tools

const SVG = "http://www.w3.org/2000/svg";
const fill = (node, attributes, children) => {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "css") Object.entries(value).forEach(([k, v]) => node.style.setProperty(k, v));
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
};
const el = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);
const svg = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

const LARGEST_NEES = 1000; // larger values are shown as "> 1000"; markdown.py has the same number
const neesInterval = ([, low, high]) => (low === null ? "[–]" : `[${neesText(low)}, ${neesText(high)}]`);
const neesText = (value) => (value > LARGEST_NEES ? `> ${LARGEST_NEES}` : digits(value));
const digits = (value) => {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  return size >= 100 ? value.toFixed(0) : size >= 10 ? value.toFixed(1) : size >= 1 ? value.toFixed(2) : value.toFixed(3);
};
// One decimal, ties to the even digit, as in leaderboard.md. Only odd quarters are ties in binary.
const tenths = (value) => {
  const below = Math.floor(10 * value);
  return (Math.abs((4 * value) % 2) === 1 ? (below + Math.abs(below % 2)) / 10 : value).toFixed(1);
};
const percent = (recall) => tenths(recall[0]);
// The ends of an interval are null where all queries are of one course.
const interval = (recall) => (recall[1] === null ? "[–]" : `[${tenths(recall[1])}, ${tenths(recall[2])}]`);
const signed = (value) => (value > 0 ? "+" : value < 0 ? "−" : "±") + tenths(Math.abs(value));
const probability = (p) => (p === null ? "p unknown" : p < 0.001 ? "p < 0.001" : `p = ${p.toFixed(p < 0.1 ? 3 : 2)}`);

const colour = (run) => `var(--m${run % 8})`;
const dashes = ["", "7 3", "2 3", "9 3 2 3", "5 5", "1 4", "12 4", "4 2 1 2"];
// Runs differ in the shape of their marks as well as in colour.
const marker = (run, x, y, size, attributes) => {
  const s = size;
  const shapes = [
    `M${-s} 0a${s} ${s} 0 1 0 ${2 * s} 0a${s} ${s} 0 1 0 ${-2 * s} 0z`,
    `M${-s} ${-s}h${2 * s}v${2 * s}h${-2 * s}z`,
    `M0 ${-1.25 * s}L${1.2 * s} ${s}H${-1.2 * s}z`,
    `M0 ${-1.35 * s}L${1.35 * s} 0L0 ${1.35 * s}L${-1.35 * s} 0z`,
  ];
  return svg("path", { d: shapes[run % 4], transform: `translate(${x} ${y})`, ...attributes });
};
const swatch = (run) => svg("svg", { class: "swatch", viewBox: "-6 -6 12 12", "aria-hidden": "true" },
  marker(run, 0, 0, 4.4, { css: { fill: colour(run) } }));
// label(run) returns the name of a run.
const legend = (label, runs, lines) => el("ul", { class: "legend" },
  runs.map((run) => el("li", {}, lines ? line(run) : null, swatch(run), label(run))));
const line = (run) => svg("svg", { class: "line", viewBox: "0 0 30 10", "aria-hidden": "true" },
  svg("path", { d: "M0 5h30", "stroke-width": 2.4, "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } }));

// ---- charts, drawn at the width they have, so that text keeps its size

const pending = new Map();
const watcher = new ResizeObserver((entries) => entries.forEach((entry) => {
  const chart = pending.get(entry.target);
  const width = Math.round(entry.contentRect.width);
  // Not at once: a chart that changes its height while sizes are being reported would be reported again.
  if (chart && width && width !== chart.width) { chart.width = width; requestAnimationFrame(chart.paint); }
}));
// draw(width) returns an svg; it is called again whenever the width changes.
const chart = (draw) => {
  const holder = el("div", {});
  const own = { width: 0, paint: () => holder.replaceChildren(draw(own.width)) };
  pending.set(holder, own);
  watcher.observe(holder);
  return holder;
};
const forgetCharts = (node) => pending.forEach((_, holder) => {
  if (node.contains(holder)) { watcher.unobserve(holder); pending.delete(holder); }
});

const linear = (low, high, from, to) => (value) => from + ((value - low) / (high - low || 1)) * (to - from);
const logarithmic = (low, high, from, to) => {
  const scale = linear(Math.log10(low), Math.log10(high), from, to);
  return (value) => scale(Math.log10(Math.min(Math.max(value, low), high)));
};
const decades = (low, high) => {
  const ticks = [];
  for (let k = Math.ceil(Math.log10(low) - 1e-9); k <= Math.log10(high) + 1e-9; k += 1) ticks.push(10 ** k);
  return ticks;
};
const plain = (value) => String(Number(value.toPrecision(6)));

// The frame all charts share: percent upwards, ticks [value, text...] along x.
const frame = (width, title, label, x, ticks, marks) => {
  const height = Math.max(230, Math.min(320, width * 0.62));
  const left = 42, right = width - 12, top = 14, bottom = height - (ticks.some((t) => t.length > 2) ? 58 : 44);
  const scaleX = x(left, right), y = linear(0, 100, bottom, top);
  const root = svg("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": title });
  for (const value of [0, 25, 50, 75, 100]) {
    root.append(svg("line", { class: value ? "rule" : "axis", x1: left, x2: right, y1: y(value), y2: y(value) }));
    root.append(svg("text", { x: left - 7, y: y(value) + 4, "text-anchor": "end" }, String(value)));
  }
  const every = Math.ceil((ticks.length * 52) / (right - left));
  for (const [value, ...texts] of ticks.filter((_, k) => k % every === 0)) {
    root.append(svg("line", { class: "axis", x1: scaleX(value), x2: scaleX(value), y1: bottom, y2: bottom + 4 }));
    texts.forEach((text, row) => root.append(
      svg("text", { x: scaleX(value), y: bottom + 17 + 14 * row, "text-anchor": "middle" }, text)));
  }
  for (const [value, text] of marks || []) {
    root.append(svg("line", { class: "mark", x1: scaleX(value), x2: scaleX(value), y1: top, y2: bottom }));
    root.append(svg("text", { x: scaleX(value), y: top - 4, "text-anchor": "middle" }, text));
  }
  root.append(svg("text", { x: (left + right) / 2, y: height - 4, "text-anchor": "middle" }, label));
  return { root, x: scaleX, y };
};
const whisker = (f, run, x, recall, text) => [
  ...(recall[1] === null ? [] : [svg("line", { x1: x, x2: x, y1: f.y(recall[1]), y2: f.y(recall[2]), "stroke-width": 2, css: { stroke: colour(run), opacity: .55 } })]),
  marker(run, x, f.y(recall[0]), 4.6, { css: { fill: colour(run) } }).appendChild(svg("title", {}, text)).parentNode,
];

// The surest queries first: points [coverage, share right] of each run, or null.
const surestChart = (label, runs, points) => chart((width) => {
  const f = frame(width, "Share right among the surest queries", "surest queries, percent of all",
    (from, to) => linear(0, 100, from, to), [0, 25, 50, 75, 100].map((v) => [v, String(v)]));
  for (const run of runs.filter(points)) {
    const drawn = points(run).map(([coverage, share]) => `${f.x(coverage).toFixed(1)} ${f.y(share).toFixed(1)}`);
    f.root.append(svg("path", { d: `M${drawn.join("L")}`, fill: "none", "stroke-width": 2.2, "stroke-linejoin": "round",
      "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } },
    svg("title", {}, label(run))));
  }
  return f.root;
});

// ---- tables

const scroll = (label, ...children) => el("div", { class: "scroll", role: "region", "aria-label": label, tabindex: "0" }, ...children);
const bar = (run, recall) => svg("svg", { class: "bar", viewBox: "0 0 100 8", preserveAspectRatio: "none", "aria-hidden": "true" },
  svg("rect", { x: 0, y: 3, width: 100, height: 2, css: { fill: "var(--line)" } }),
  recall[1] === null ? null : svg("rect", { x: recall[1], y: 1.5, width: Math.max(recall[2] - recall[1], 1), height: 5, css: { fill: colour(run), opacity: .4 } }),
  svg("rect", { x: Math.min(Math.max(recall[0] - 1, 0), 98), y: 0, width: 2, height: 8, css: { fill: colour(run) } }));

// A table whose headings sort it. columns: { name, word, broad, key(row), best }; line(row) returns a row; more are
// headings that do not sort. keeper.sort is { column, direction }, or null for the order of the rows.
const sortedTable = (label, columns, more, rows, line, keeper) => {
  const body = el("tbody", { id: "rows" });
  const heads = columns.map((column, k) => el("th", { scope: "col", class: `${column.word ? "word" : ""} ${column.broad ? "broad" : ""}` },
    el("button", { type: "button", onclick: () => sortBy(k) }, column.name)));
  const paint = () => {
    const listed = [...rows], { sort } = keeper;
    if (sort) {
      const { key } = columns[sort.column], sign = sort.direction === "ascending" ? 1 : -1;
      listed.sort((one, two) => {
        const a = key(one), c = key(two);
        if (a === null || c === null) return (a === null) - (c === null);
        return a < c ? -sign : a > c ? sign : 0;
      });
    }
    heads.forEach((head, k) => {
      if (sort && sort.column === k) head.setAttribute("aria-sort", sort.direction);
      else head.removeAttribute("aria-sort");
    });
    body.replaceChildren(...listed.map(line));
  };
  const sortBy = (k) => {
    const first = columns[k].best || "ascending", other = first === "ascending" ? "descending" : "ascending";
    keeper.sort = { column: k, direction: keeper.sort && keeper.sort.column === k && keeper.sort.direction === first ? other : first };
    paint();
  };
  paint();
  return scroll(label, el("table", { id: "results" },
    el("thead", {}, el("tr", {}, heads, more.map((name) => el("th", { scope: "col" }, name)))), body));
};
// A figure is null where it is unknown, or where the reference poses are too inexact to judge it.
const shareCell = (share) => el("td", {}, share ? [percent(share), el("small", {}, interval(share))] : "–");
const recallCell = (run, recall) => (recall ? el("td", {}, percent(recall), el("small", {}, interval(recall)), bar(run, recall)) : shareCell(recall));
const valueOf = (share) => (share ? share[0] : null);
const INTEGRITY = ["false fixes", "> 1 m", "worse than prior"];
const integrityColumns = (unit) => INTEGRITY.map((name, k) => ({ name: `${name}${unit}`, key: (row) => valueOf(row.s.integrity[k]) }));

// find(a, b) returns the comparison of runs a < b, or undefined.
const pairedTable = (labels, find) => scroll("Paired comparison", el("table", { class: "pairs" },
  el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "row minus column"), labels.map((label) => el("th", { scope: "col" }, label)))),
  el("tbody", {}, labels.map((label, row) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(row), label),
    labels.map((_, column) => {
      const pair = find(Math.min(row, column), Math.max(row, column));
      if (!pair) return el("td", {}, "");
      if (pair.reason) return el("td", { title: `not compared: ${pair.reason}` }, "–", el("small", {}, "not compared"));
      const sign = row > column ? 1 : -1;
      const ends = pair.low === null ? "[–]" : sign > 0 ? `[${signed(pair.low)}, ${signed(pair.high)}]` : `[${signed(-pair.high)}, ${signed(-pair.low)}]`;
      const [won, lost] = sign > 0 ? [pair.won, pair.lost] : [pair.lost, pair.won];
      return el("td", { class: pair.p !== null && pair.p < 0.05 ? "real" : null, title: `right where the other is wrong: ${won}; wrong where it is right: ${lost}` },
        signed(sign * pair.change), el("small", {}, ends), el("small", {}, probability(pair.p)));
    }))))));

const paper = () => {
  const first = data.paper.lines.findIndex((line) => !line.reported);
  return [el("h3", {}, data.paper.title), el("p", { class: "quiet" }, data.paper.note),
    scroll(data.paper.title, el("table", { id: "paper-table" },
      el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), el("th", { scope: "col", class: "word" }, "source"),
        data.paper.columns.map((name) => el("th", { scope: "col" }, name)))),
      el("tbody", {}, data.paper.lines.map((line, k) => el("tr", { class: line.reported ? "reported" : k === first ? "measured-first" : null },
        el("th", { scope: "row", class: "word" }, line.method), el("td", { class: "word" }, line.source),
        line.cells.map((cell) => el("td", {}, cell === null ? "–" : cell.text)))))))];
};

// ---- controls

const group = (name, label, options, chosen, choose) => el("div", { class: "choice", role: "group", "aria-label": label }, el("span", { class: "name" }, label),
  options.map(([value, text]) => el("button", { type: "button", "data-of": name, "data-value": value, "aria-pressed": String(value === chosen), onclick: () => choose(value) }, text)));
const press = (name, chosen) => document.querySelectorAll(`[data-of="${name}"]`).forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.value === String(chosen))));

const card = (id, title, about, ...children) => el("section", { class: "card", id }, el("h3", {}, title), about ? el("p", { class: "quiet" }, about) : null, ...children);

const focusOn = (name, value) => { const button = document.querySelector(`[data-of="${name}"][data-value="${value}"]`); if (button) button.focus(); };
