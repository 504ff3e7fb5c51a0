"use strict";
/* Verdicts of audits. Everything from the data is shown as text, never as markup. */
const data = JSON.parse(document.getElementById("data").textContent);
const WORDS = { right: "right", wrong: "wrong", unknown: "unknown" };
const SVG = "http://www.w3.org/2000/svg";

function make(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

function draw(tag, attributes, text) {
  const node = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text) node.textContent = text;
  return node;
}

function row(finding) {
  const detail = make("td", {}, finding.detail);
  if (finding.fault) detail.append(make("br"), make("code", {}, finding.fault));
  const verdict = make("span", { class: `verdict ${finding.kind}` }, WORDS[finding.kind]);
  return make("tr", {}, make("th", { scope: "row" }, finding.check), make("td", {}, verdict), detail);
}

/* Stated positions and those of GPS from above, in metres; north is up. */
function plan(pairs) {
  const xs = pairs.flatMap(p => [p[0], p[2]]), ys = pairs.flatMap(p => [p[1], p[3]]);
  const [west, east, south, north] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const width = 900, height = 380, edge = 24;
  const scale = Math.min((width - 2 * edge) / Math.max(east - west, 1), (height - 3 * edge) / Math.max(north - south, 1));
  const x = e => width / 2 + (e - (west + east) / 2) * scale;
  const y = n => (height - edge) / 2 - (n - (south + north) / 2) * scale;
  const picture = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Positions from above" });
  for (const [a, b, c, d] of pairs) picture.append(draw("line", { class: "link", x1: x(a), y1: y(b), x2: x(c), y2: y(d) }));
  for (const [, , c, d] of pairs) picture.append(draw("path", { class: "gps", d: `M${x(c) - 4},${y(d) - 4}l8,8m0,-8l-8,8` }));
  for (const [a, b] of pairs) picture.append(draw("circle", { class: "stated", cx: x(a), cy: y(b), r: 3 }));
  const step = 10 ** Math.floor(Math.log10(120 / scale));
  picture.append(draw("line", { class: "bar", x1: edge, x2: edge + step * scale, y1: height - edge, y2: height - edge }));
  picture.append(draw("text", { x: edge, y: height - edge - 6 }, `${step} m`));
  const caption = make("figcaption", {}, make("b", {}, "● stated  × GPS of the photograph."), " From above, north is up. A line joins the two of one photograph.");
  return make("figure", {}, picture, caption);
}

function card(audit) {
  const counts = make("ul", { class: "summary" });
  for (const kind of ["wrong", "right", "unknown"]) {
    const count = audit.findings.filter(f => f.kind === kind).length;
    if (count) counts.append(make("li", { class: kind }, `${count} ${WORDS[kind]}`));
  }
  const head = make("thead", {}, make("tr", {}, ...["check", "verdict", "evidence"].map(w => make("th", { scope: "col" }, w))));
  const body = make("tbody", {}, ...audit.findings.map(row));
  const about = make("p", { class: "quiet" }, `${audit.kind}, ${audit.photographs} photographs`);
  const made = make("section", { class: "card" }, make("h2", {}, audit.subject), about, counts, make("div", { class: "scroll" }, make("table", {}, head, body)));
  if (audit.plan.length) made.append(plan(audit.plan));
  return made;
}

document.getElementById("audits").append(...data.audits.map(card));
