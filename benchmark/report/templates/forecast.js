
// ---- the forecast; shared.js, with the tools of all pages, stands above

const names = data.seasons.map((season) => season.name);
let chosen = names[0];
let looked = data.waypoints[0];
const share = (p) => `${Math.round(100 * p)} %`;
const rare = (p) => `${(100 * p).toFixed(1)} %`;
const metres = (value) => (value === null || value === undefined ? "–" : `${digits(value)} m`);
const sigma = (value) => (value === null ? "–" : `${value.toFixed(2)} m`);
const title = (text) => text[0].toUpperCase() + text.slice(1);

// Between the three colours of the scale.
const mixed = (p) => {
  const part = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  const [low, mid, high] = data.colours.map(part);
  const [a, b, t] = p < 0.5 ? [low, mid, 2 * p] : [mid, high, 2 * p - 1];
  return `rgb(${a.map((value, k) => Math.round(value + t * (b[k] - value))).join(" ")})`;
};

// The colours of the probabilities 0, 0.5 and 1.
const verdictColour = (verdict) => data.colours[["fails", "gaps", "holds"].indexOf(verdict)];

function verdicts() {
  const row = (name, value) => el("span", { class: "row" }, el("span", {}, name), el("span", {}, value));
  return el("div", { class: "verdicts", role: "group", "aria-label": "Seasons" }, data.seasons.map((season) => el("button", {
    type: "button", class: season.verdict, "data-season": season.name,
    css: { "border-left-color": verdictColour(season.verdict) },
    "aria-pressed": String(season.name === chosen), onclick: () => { chosen = season.name; paint(); },
  },
  el("span", { class: "name" }, season.name),
  el("strong", {}, title(data.verdicts[season.verdict])),
  row("fix at a waypoint", share(season.share)),
  row("longest distance between fixes", `${season.longest_gap_m.toFixed(0)} m`),
  row("false fixes", rare(season.false_risk)),
  row("horizontal, vertical sigma within the map", season.sigma_across_m === null ? "–" : `${season.sigma_across_m.toFixed(2)}, ${season.sigma_up_m.toFixed(2)} m`))));
}

function map() {
  const side = 800, scale = side / data.side_m;
  const x = (w) => side / 2 + w.enu_m[0] * scale, y = (w) => side / 2 - w.enu_m[1] * scale;
  const picture = svg("svg", { viewBox: `0 0 ${side} ${side}`, role: "img", "aria-label": `Waypoints over the site, ${chosen}` },
    svg("image", { href: data.ground, width: side, height: side }),
    svg("rect", { width: side, height: side, fill: "#fff", "fill-opacity": 0.25 }),
    svg("polyline", { points: data.waypoints.map((w) => `${x(w)},${y(w)}`).join(" "), fill: "none", stroke: "#111", "stroke-width": 2 }));
  const many = data.waypoints.length > 60;
  for (const w of data.waypoints) {
    const p = w.seasons[chosen].probability;
    picture.append(svg("circle", {
      cx: x(w), cy: y(w), r: many ? 7 : 15, fill: mixed(p), stroke: w === looked ? "#000" : "#fff", "stroke-width": w === looked ? 4 : 2,
      tabindex: 0, role: "button", "aria-label": `Waypoint ${w.number}: ${share(p)}`, onclick: () => { looked = w; paint(); },
      onkeydown: (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); looked = w; paint(); } },
    }));
    if (!many) picture.append(svg("text", { class: "number", x: x(w), y: y(w) + 5.5 }, String(w.number)));
  }
  const bar = 10 ** Math.floor(Math.log10(data.side_m / 3));
  picture.append(svg("rect", { x: 14, y: side - 46, width: Math.max(bar * scale + 16, 150), height: 36, fill: "#fff", "fill-opacity": 0.8, rx: 4 }),
    svg("line", { x1: 22, x2: 22 + bar * scale, y1: side - 17, y2: side - 17, stroke: "#111", "stroke-width": 3 }),
    svg("text", { class: "size", x: 22, y: side - 24, fill: "#111" }, `${bar} m, north up`));
  return picture;
}

function facts() {
  const outlook = looked.seasons[chosen];
  const fact = (name, value, wide) => el("div", { class: wide ? "wide" : null }, el("dt", {}, name), el("dd", {}, value));
  const scale = el("div", { class: "scale", css: { background: `linear-gradient(90deg, ${data.colours.join(", ")})` } });
  return el("div", { id: "facts", "aria-live": "polite" },
    el("h3", {}, `Waypoint ${looked.number}`),
    el("dl", { class: "facts" },
      fact("probability of a fix", share(outlook.probability)),
      fact("false fix", rare(outlook.false_risk)),
      fact("horizontal sigma", sigma(outlook.sigma_across_m)),
      fact("vertical sigma", sigma(outlook.sigma_up_m)),
      fact("map points in view", looked.points.toFixed(0)),
      fact("views found", `${outlook.found} of ${outlook.views}`),
      fact("position", `${looked.latitude.toFixed(6)}, ${looked.longitude.toFixed(6)}, ${looked.altitude_m.toFixed(1)} m`, true),
      outlook.cause ? fact("why it is weak", data.causes[outlook.cause], true) : null),
    el("p", { class: "quiet" }, "Colour: probability of a fix"), scale,
    el("div", { class: "ends" }, el("span", {}, "0 %"), el("span", {}, "50 %"), el("span", {}, "100 %")));
}

function profile() {
  const width = 1000, height = 140, top = 8, base = 118, count = data.waypoints.length;
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none", role: "img", "aria-label": `Probability along the route, ${chosen}` });
  const step = width / count;
  data.waypoints.forEach((w, k) => {
    const p = w.seasons[chosen].probability;
    picture.append(svg("rect", { x: k * step + 1, width: Math.max(step - 2, 1), y: base - p * (base - top), height: Math.max(p * (base - top), 1), fill: mixed(p) }));
  });
  const weak = base - data.config.weak * (base - top);
  picture.append(svg("line", { class: "mark", x1: 0, x2: width, y1: weak, y2: weak }), svg("line", { class: "axis", x1: 0, x2: width, y1: base, y2: base }));
  return el("div", { class: "profile" }, picture,
    el("div", { class: "ends" }, el("span", {}, `waypoint 1`), el("span", {}, `dashed: ${share(data.config.weak)}`), el("span", {}, `waypoint ${count}`)));
}

const rows = (heads, lines) => el("div", { class: "scroll" }, el("table", {},
  el("thead", {}, el("tr", {}, heads.map(([name, word]) => el("th", { scope: "col", class: word ? "word" : null }, name)))),
  el("tbody", {}, lines)));
const from = (part) => (part.first === part.last ? `${part.first}` : `${part.first} to ${part.last}`);

function weakStretches() {
  const season = data.seasons.find((one) => one.name === chosen);
  if (!season.stretches.length) return el("p", { class: "quiet" }, `None: at every waypoint a fix has a probability of at least ${share(data.config.weak)}.`);
  return rows([["waypoints", true], ["distance without a fix"], ["mean probability"], ["why, and what to do", true]], season.stretches.map((stretch) => el("tr", {},
    el("td", { class: "word" }, from(stretch)), el("td", {}, metres(stretch.gap_m)), el("td", {}, share(stretch.probability)),
    el("td", { class: "word wide" }, title(data.causes[stretch.cause]) + "."))));
}

function photographs() {
  if (!data.photographs.length) return el("p", { class: "quiet" }, `Nowhere on this flight: where a fix is unlikely, at least ${data.few_points} points of the map are in view. More photographs in the same season would not help.`);
  return rows([["waypoints", true], ["points in view"], ["fixes lost"], ["around", true]], data.photographs.map((part) => el("tr", {},
    el("td", { class: "word" }, from(part)), el("td", {}, part.points.toFixed(0)), el("td", {}, digits(part.lost)),
    el("td", { class: "word" }, `${part.latitude.toFixed(6)}, ${part.longitude.toFixed(6)}`))));
}

function everyWaypoint() {
  return rows([["waypoint"], ["probability"], ["false fix"], ["horizontal sigma"], ["vertical sigma"], ["map points"], ["views found"]], data.waypoints.map((w) => {
    const outlook = w.seasons[chosen];
    return el("tr", {}, [w.number, share(outlook.probability), rare(outlook.false_risk), sigma(outlook.sigma_across_m), sigma(outlook.sigma_up_m), w.points.toFixed(0), `${outlook.found} of ${outlook.views}`].map((cell) => el("td", {}, String(cell))));
  }));
}

const section = (id, head, quiet, ...inner) => el("section", { class: "card", id }, el("h2", {}, head), quiet ? el("p", { class: "quiet" }, quiet) : null, ...inner);

function paint() {
  const focus = document.activeElement ? document.activeElement.getAttribute("data-season") : null;
  const config = data.config, calibration = data.calibration;
  const calibrated = calibration.queries
    ? `Calibrated on ${calibration.queries} queries in renders of ${calibration.source}.`
    : "Not calibrated for this method: the smoothed share of views with a fix.";
  document.getElementById("forecast").replaceChildren(
    verdicts(),
    section("map", `The route, ${chosen}`, "Choose a season above, and a waypoint here.", el("div", { class: "map" }, map(), facts()), profile()),
    section("weak", "Weak stretches", `Waypoints where a fix is less likely than ${share(config.weak)}. The aircraft can fly ${metres(config.gap_m)} without one.`, weakStretches()),
    section("photographs", "Where more map photographs would help", "Over all seasons, the most first.", photographs()),
    section("every", "Every waypoint", null, el("details", {}, el("summary", {}, `${data.waypoints.length} waypoints in ${chosen}`), everyWaypoint())),
    section("how", "How to read this", null,
      el("p", { class: "quiet" }, `A fix is right within ${config.fix_m} m and ${config.fix_deg}°; a false fix is reported as found and wrong by more than 5 m or 10°. Each waypoint is rendered ${config.views === 1 ? "once" : `${config.views} times`} a season in a twin of the site and localized in its map from the start ${config.start}; views of neighbours within about ${data.pool_m} m count, too. ${calibrated}`),
      data.notes.length ? el("p", { class: "note" }, data.notes.join("\n")) : null));
  if (focus) document.querySelector(`[data-season="${focus}"]`).focus();
}

document.getElementById("about").textContent = `${data.flight} over ${data.scene}: ${data.waypoints.length} waypoints, ${Math.round(data.waypoints[data.waypoints.length - 1].along_m)} m, localized by ${data.method.name}.`;
paint();
