"use strict";
// Everything measured is text: it reaches the page by textContent and attributes, never as markup.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const ALL = "all";
  const state = { board: 0, threshold: Math.min(1, data.thresholds.length - 1), condition: ALL,
    error: "t", sort: null, run: 0, place: 0 };

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

  const digits = (value) => {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    return size >= 100 ? value.toFixed(0) : size >= 10 ? value.toFixed(1) : size >= 1 ? value.toFixed(2) : value.toFixed(3);
  };
  const percent = (recall) => recall[0].toFixed(1);
  const interval = (recall) => `[${recall[1].toFixed(1)}, ${recall[2].toFixed(1)}]`;
  const signed = (value) => (value > 0 ? "+" : value < 0 ? "−" : "±") + Math.abs(value).toFixed(1);
  const probability = (p) => (p < 0.001 ? "p < 0.001" : `p = ${p.toFixed(p < 0.1 ? 3 : 2)}`);

  const colour = (run) => `var(--m${run % 8})`;
  const dashes = ["", "7 3", "2 3", "9 3 2 3", "5 5", "1 4", "12 4", "4 2 1 2"];
  // Told apart by shape as well as by colour.
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
  const legend = (board, runs, lines) => el("ul", { class: "legend" },
    runs.map((run) => el("li", {}, lines ? line(run) : null, swatch(run), board.runs[run].label)));
  const line = (run) => svg("svg", { class: "line", viewBox: "0 0 30 10", "aria-hidden": "true" },
    svg("path", { d: "M0 5h30", "stroke-width": 2.4, "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } }));

  const board = () => data.boards[state.board];
  const everyRun = (b) => b.runs.map((_, run) => run);
  const listed = (b) => b.queries.map((_, k) => k)
    .filter((k) => state.condition === ALL || b.conditions[b.queries[k].condition] === state.condition);
  const summary = (b, run) => b.runs[run].summaries[state.condition];

  // ---- charts, drawn at the width they have, so that text keeps its size

  const pending = new Map();
  const watcher = new ResizeObserver((entries) => entries.forEach((entry) => {
    const chart = pending.get(entry.target);
    const width = Math.round(entry.contentRect.width);
    // Not at once: a chart that changes its height while sizes are being reported would be reported again.
    if (chart && width && width !== chart.width) { chart.width = width; requestAnimationFrame(chart.paint); }
  }));
  // draw(width) answers an svg; it is called again whenever the width changes.
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
    svg("line", { x1: x, x2: x, y1: f.y(recall[1]), y2: f.y(recall[2]), "stroke-width": 2, css: { stroke: colour(run), opacity: .55 } }),
    marker(run, x, f.y(recall[0]), 4.6, { css: { fill: colour(run) } }).appendChild(svg("title", {}, text)).parentNode,
  ];

  const curves = (b) => {
    const metric = state.error;
    const [low, high] = metric === "t" ? [0.01, 100] : [0.01, 180];
    const of = listed(b);
    const marks = data.thresholds.map((t) => [Number(metric === "t" ? t.key.split("m_")[0] : t.key.split("m_")[1].replace("deg", "")), ""]);
    return chart((width) => {
      const f = frame(width, "Share of queries below an error, by method",
        metric === "t" ? "position error, metres" : "rotation error, degrees",
        (from, to) => logarithmic(low, high, from, to), decades(low, high).map((v) => [v, plain(v)]), marks);
      for (const run of everyRun(b)) {
        const errors = of.map((k) => b.runs[run].queries[k]).filter((q) => q && q.status === "ok").map((q) => q[metric]).sort((a, c) => a - c);
        let path = `M${f.x(low)} ${f.y(0)}`, count = 0;
        for (const error of errors) {
          if (error > high) break;
          count += 1;
          path += `H${f.x(error).toFixed(1)}V${f.y((100 * count) / of.length).toFixed(1)}`;
        }
        f.root.append(svg("path", { d: `${path}H${f.x(high)}`, fill: "none", "stroke-width": 2.2, "stroke-linejoin": "round",
          "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } },
        svg("title", {}, b.runs[run].label)));
      }
      return f.root;
    });
  };

  const speed = (b) => {
    const points = everyRun(b).map((run) => [run, summary(b, run)]).filter(([, s]) => s && s.seconds);
    const seconds = points.map(([, s]) => s.seconds);
    const low = 10 ** Math.floor(Math.log10(Math.min(...seconds, 0.1) * 0.8));
    const high = 10 ** Math.ceil(Math.log10(Math.max(...seconds, 0.2) * 1.25));
    return chart((width) => {
      const f = frame(width, "Recall against seconds per query", "seconds per query", (from, to) => logarithmic(low, high, from, to),
        decades(low, high).map((v) => [v, plain(v)]));
      for (const [run, s] of points) {
        const recall = s.recall[state.threshold];
        f.root.append(...whisker(f, run, f.x(s.seconds), recall,
          `${b.runs[run].label}: ${percent(recall)} % ${interval(recall)}, ${digits(s.seconds)} s`));
      }
      return f.root;
    });
  };

  const basin = (b, runs) => {
    const sizes = [];
    for (const run of runs) for (const level of b.runs[run].basin) {
      if (!sizes.some((s) => s.t === level.t && s.r === level.r)) sizes.push({ t: level.t, r: level.r });
    }
    sizes.sort((a, c) => a.t - c.t || a.r - c.r);
    const place = (level) => sizes.findIndex((s) => s.t === level.t && s.r === level.r);
    return chart((width) => {
      const f = frame(width, "Recall against the error of the prior", "error of the prior",
        (from, to) => linear(-0.4, sizes.length - 0.6, from, to), sizes.map((s, k) => [k, `${plain(s.t)} m`, `${plain(s.r)}°`]));
      runs.forEach((run, k) => {
        const shift = (k - (runs.length - 1) / 2) * 5;
        const levels = [...b.runs[run].basin].sort((a, c) => place(a) - place(c));
        const points = levels.map((level) => `${f.x(place(level)) + shift} ${f.y(level.recall[state.threshold][0])}`);
        f.root.append(svg("path", { d: `M${points.join("L")}`, fill: "none", "stroke-width": 2, "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } }));
        for (const level of levels) {
          const recall = level.recall[state.threshold];
          f.root.append(...whisker(f, run, f.x(place(level)) + shift, recall,
            `${b.runs[run].label}, prior wrong by ${plain(level.t)} m ${plain(level.r)}°: ${percent(recall)} % ${interval(recall)} of ${level.queries}`));
        }
      });
      return f.root;
    });
  };

  const surest = (b) => chart((width) => {
    const f = frame(width, "Share right among the surest queries", "surest queries, percent of all",
      (from, to) => linear(0, 100, from, to), [0, 25, 50, 75, 100].map((v) => [v, String(v)]));
    for (const run of everyRun(b)) {
      const right = b.runs[run].surest[state.threshold];
      const points = right.map((share, k) => `${f.x((100 * (k + 1)) / right.length).toFixed(1)} ${f.y(share).toFixed(1)}`);
      f.root.append(svg("path", { d: `M${points.join("L")}`, fill: "none", "stroke-width": 2.2, "stroke-linejoin": "round",
        "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } },
      svg("title", {}, b.runs[run].label)));
    }
    return f.root;
  });
  const honesty = (run) => `${run.label}: ${run.nees
    ? `${digits(run.nees.mean)} on average, ${percent(run.nees.within)} % ${interval(run.nees.within)} inside, of ${run.nees.queries}`
    : "no covariance"}`;

  // ---- tables

  const scroll = (label, ...children) => el("div", { class: "scroll", role: "region", "aria-label": label, tabindex: "0" }, ...children);
  const bar = (run, recall) => svg("svg", { class: "bar", viewBox: "0 0 100 8", preserveAspectRatio: "none", "aria-hidden": "true" },
    svg("rect", { x: 0, y: 3, width: 100, height: 2, css: { fill: "var(--line)" } }),
    svg("rect", { x: recall[1], y: 1.5, width: Math.max(recall[2] - recall[1], 1), height: 5, css: { fill: colour(run), opacity: .4 } }),
    svg("rect", { x: Math.min(Math.max(recall[0] - 1, 0), 98), y: 0, width: 2, height: 8, css: { fill: colour(run) } }));

  const tableColumns = () => [
    { name: "method", word: true, key: (row) => row.label.toLowerCase() },
    { name: "condition", word: true, broad: true, key: (row) => (row.condition === ALL ? "" : row.condition.toLowerCase()) },
    { name: "queries", key: (row) => row.s.queries },
    ...data.thresholds.map((t, k) => ({ name: t.text, unit: "%", key: (row) => row.s.recall[k][0], best: "descending" })),
    { name: "median m", key: (row) => row.s.t },
    { name: "median °", key: (row) => row.s.r },
    { name: "false fixes", key: (row) => (row.s.wrong ? row.s.wrong[0] : null) },
    { name: "failed + fallback", key: (row) => row.s.failed + row.s.fallback },
    { name: "s/query", key: (row) => row.s.seconds },
  ];

  const rowsOf = (b) => b.runs.flatMap((run, k) => [
    ...(b.conditions.length > 1 ? [ALL] : []), ...b.conditions]
    .filter((condition) => run.summaries[condition])
    .map((condition) => ({ run: k, label: run.label, condition, s: run.summaries[condition] })));

  const mainTable = (b) => {
    const columns = tableColumns();
    const body = el("tbody", { id: "rows" });
    const heads = columns.map((column, k) => el("th", { scope: "col", class: `${column.word ? "word" : ""} ${column.broad ? "broad" : ""}` },
      el("button", { type: "button", onclick: () => sortBy(k) }, column.name)));
    const paint = () => {
      const rows = rowsOf(b);
      if (state.sort) {
        const { key } = columns[state.sort.column], sign = state.sort.direction === "ascending" ? 1 : -1;
        rows.sort((one, two) => {
          const a = key(one), c = key(two);
          if (a === null || c === null) return (a === null) - (c === null);
          return a < c ? -sign : a > c ? sign : 0;
        });
      }
      heads.forEach((head, k) => {
        if (state.sort && state.sort.column === k) head.setAttribute("aria-sort", state.sort.direction);
        else head.removeAttribute("aria-sort");
      });
      body.replaceChildren(...rows.map((row) => el("tr", { class: row.condition === ALL ? "all" : null },
        el("th", { scope: "row", class: "word" }, swatch(row.run), row.label, el("small", { class: "narrow" }, row.condition)),
        el("td", { class: "word broad" }, row.condition),
        el("td", {}, String(row.s.queries)),
        row.s.recall.map((recall) => el("td", {}, percent(recall), el("small", {}, interval(recall)), bar(row.run, recall))),
        [row.s.t, row.s.r].map((value) => el("td", {}, digits(value))),
        el("td", {}, row.s.wrong ? [percent(row.s.wrong), el("small", {}, interval(row.s.wrong))] : "–"),
        el("td", {}, `${row.s.failed} + ${row.s.fallback}`),
        el("td", {}, digits(row.s.seconds)),
        el("td", { class: "acts" }, ["worst", "best"].map((end) => el("button", {
          type: "button", "aria-label": `${end} query of ${row.label}, ${row.condition}`,
          onclick: () => open(row.run, row.condition, end) }, end))))));
    };
    const sortBy = (k) => {
      const first = columns[k].best || "ascending", other = first === "ascending" ? "descending" : "ascending";
      state.sort = { column: k, direction: state.sort && state.sort.column === k && state.sort.direction === first ? other : first };
      paint();
    };
    paint();
    return scroll("Table of results", el("table", { id: "results" },
      el("thead", {}, el("tr", {}, heads, el("th", { scope: "col" }, "look at"))), body));
  };

  const heatMap = (b) => scroll("Recall by method and condition", el("table", { class: "heat" },
    el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"),
      b.conditions.map((condition) => el("th", { scope: "col" }, condition, b.map_conditions.includes(condition) ? " (map)" : "")))),
    el("tbody", {}, b.runs.map((run, k) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(k), run.label),
      b.conditions.map((condition) => {
        const s = run.summaries[condition];
        if (!s) return el("td", { class: "cell" }, "–");
        const recall = s.recall[state.threshold];
        return el("td", { class: "cell", css: { background: `hsl(var(--heat) / ${(0.04 + 0.56 * recall[0] / 100).toFixed(3)})` } },
          el("button", { type: "button", title: `${run.label}, ${condition}: ${percent(recall)} % ${interval(recall)} of ${s.queries}; opens its worst query`,
            onclick: () => open(k, condition, "worst") }, recall[0].toFixed(0)));
      }))))));

  const pairTable = (b) => scroll("Paired comparison", el("table", { class: "pairs" },
    el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "row minus column"), b.runs.map((run) => el("th", { scope: "col" }, run.label)))),
    el("tbody", {}, b.runs.map((run, row) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(row), run.label),
      b.runs.map((_, column) => {
        const [a, c] = [Math.min(row, column), Math.max(row, column)];
        const pair = b.pairs.find((p) => p.a === a && p.b === c && p.threshold === state.threshold && p.condition === state.condition);
        if (!pair) return el("td", {}, "");
        const sign = row > column ? 1 : -1;
        const [low, high] = sign > 0 ? [pair.low, pair.high] : [-pair.high, -pair.low];
        const [won, lost] = sign > 0 ? [pair.won, pair.lost] : [pair.lost, pair.won];
        return el("td", { class: pair.p < 0.05 ? "real" : null, title: `right where the other is wrong: ${won}; wrong where it is right: ${lost}` },
          signed(sign * pair.change), el("small", {}, `[${signed(low)}, ${signed(high)}]`), el("small", {}, probability(pair.p)));
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

  // ---- queries

  // Best first: localized by position error, then fallback poses, then failures; the rest keeps its order.
  const order = (b) => {
    const of = (k) => b.runs[state.run].queries[k];
    const badness = (q) => (!q || q.t === null ? 2 : q.status === "ok" ? 0 : 1);
    return listed(b).sort((one, two) => badness(of(one)) - badness(of(two))
      || ((of(one) || {}).t || 0) - ((of(two) || {}).t || 0) || one - two);
  };
  const open = (run, condition, end) => {
    state.run = run;
    setCondition(condition);
    state.place = end === "best" ? 0 : order(board()).length - 1;
    paintQuery();
    document.getElementById("queries").scrollIntoView({ block: "start" });
    document.getElementById("queries").focus({ preventScroll: true });
  };

  const pairsOf = (flat) => {
    const points = [];
    for (let k = 0; k + 1 < flat.length; k += 2) points.push(flat[k] === null ? null : [flat[k], flat[k + 1]]);
    return points;
  };
  // Twice: a dark line below a bright one reads on any ground.
  const twice = (shape, kind) => [shape({ class: "halo", "stroke-width": 9 }), shape({ class: kind, "stroke-width": 4.5 })];
  const ring = ([x, y]) => twice((look) => svg("circle", { cx: x, cy: y, r: 13, ...look }), "truth");
  const cross = ([x, y]) => twice((look) => svg("path", { d: `M${x - 10} ${y - 10}l20 20m0 -20l-20 20`, ...look }), "guess");
  const joined = ([x, y], [u, v]) => svg("line", { class: "guess", x1: x, y1: y, x2: u, y2: v, "stroke-width": 3, "stroke-opacity": .8 });

  const photograph = (number, [width, height], label, ...drawing) => {
    const scale = 1000 / Math.max(width, height), w = width * scale, h = height * scale;
    return svg("svg", { viewBox: `0 0 ${w} ${h}`, role: "img", "aria-label": label },
      svg("image", { href: data.pictures[number], width: w, height: h, preserveAspectRatio: "none" }), ...drawing.flat(2));
  };
  const missing = (text) => el("div", { class: "none quiet" }, text);

  const sides = (b, k, q) => {
    const query = b.queries[k];
    const hasPicture = query.picture !== undefined && query.picture !== null;
    const truth = pairsOf(query.truth || []), guess = pairsOf((q && q.points) || []);
    const both = truth.map((point, n) => [point, guess[n]]).filter(([a, c]) => a && c);
    const left = hasPicture
      ? photograph(query.picture, query.size, `Query ${query.name} with map points`,
        both.map(([a, c]) => joined(a, c)), truth.filter(Boolean).map(ring), guess.filter(Boolean).map(cross))
      : missing(query.size ? "This page has room for the worst and best queries' photographs only." : "No album lies beside these results: run evaluate again to make it.");
    const beside = query.beside;
    const right = beside && beside.picture !== null
      ? photograph(beside.picture, beside.size, `Map photograph ${beside.name} with the same points`, pairsOf(beside.points).filter(Boolean).map(ring))
      : missing(hasPicture ? "No photograph of the map shows this ground." : "No map photograph.");
    return el("div", { class: "sides" },
      el("figure", { id: "query-picture" }, left, el("figcaption", {}, "Query. ", el("span", { class: "key ring" }, "○"), " map points at the true pose, ",
        el("span", { class: "key cross" }, "×"), q && q.t !== null ? " the same points at the estimated pose." : " no estimate to draw.")),
      el("figure", { id: "map-picture" }, right, el("figcaption", {}, "Nearest map photograph", beside ? `, ${beside.name}. ` : ". ", el("span", { class: "key ring" }, "○"), " the same points as the map saw them.")));
  };

  const strip = (b, ranked) => chart((width) => {
    const height = 92, of = b.runs[state.run].queries, low = 0.001, high = 1000;
    const x = linear(0, Math.max(ranked.length - 1, 1), 46, width - 10), y = logarithmic(low, high, height - 16, 10);
    const root = svg("svg", { class: "chart strip", viewBox: `0 0 ${width} ${height}`, width, height, role: "img",
      "aria-label": "Position error of every query, best to worst; failures on top",
      onclick: (event) => {
        const at = (event.clientX - root.getBoundingClientRect().left - 46) / (width - 56);
        state.place = Math.max(0, Math.min(ranked.length - 1, Math.round(at * (ranked.length - 1))));
        paintQuery();
      } });
    for (const value of [0.01, 1, 100]) {
      root.append(svg("line", { class: "rule", x1: 46, x2: width - 10, y1: y(value), y2: y(value) }),
        svg("text", { x: 40, y: y(value) + 4, "text-anchor": "end" }, `${plain(value)} m`));
    }
    ranked.forEach((k, place) => {
      const q = of[k], lost = !q || q.t === null, here = place === state.place;
      const dot = svg("circle", { cx: x(place), cy: lost ? 6 : y(q.t), r: here ? 5 : 2.6, css: { fill: here ? "var(--ink)" : colour(state.run), "fill-opacity": lost || q.status !== "ok" ? .35 : 1 } });
      root.append(dot);
    });
    root.append(svg("text", { x: 46, y: height - 1 }, "best"), svg("text", { x: width - 10, y: height - 1, "text-anchor": "end" }, "worst"));
    return root;
  });

  const fact = (name, value, wide) => el("div", { class: wide ? "wide" : null }, el("dt", {}, name), el("dd", {}, value));

  const paintQuery = () => {
    const b = board(), holder = document.getElementById("query"), ranked = order(b);
    forgetCharts(holder);
    if (!ranked.length) { holder.replaceChildren(el("p", { class: "quiet" }, "No query under this condition.")); return; }
    state.place = Math.max(0, Math.min(state.place, ranked.length - 1));
    const k = ranked[state.place], query = b.queries[k], q = b.runs[state.run].queries[k];
    const step = (to, text, name, disabled) => el("button", { type: "button", id: name, disabled, onclick: () => {
      const had = document.activeElement && document.activeElement.id;
      state.place = to; paintQuery();
      const again = had && document.getElementById(had);
      if (again && !again.disabled) again.focus();
    } }, text);
    const last = ranked.length - 1;
    holder.replaceChildren(
      el("div", { class: "walk" },
        el("label", { class: "choice" }, el("span", { class: "name" }, "method"),
          el("select", { id: "run", onchange: (event) => { state.run = Number(event.target.value); state.place = order(b).indexOf(k); paintQuery(); document.getElementById("run").focus(); } },
            b.runs.map((run, n) => el("option", { value: n, selected: n === state.run }, run.label)))),
        step(last, "Worst", "to-worst", state.place === last), step(0, "Best", "to-best", state.place === 0),
        step(state.place - 1, "Better", "to-better", state.place === 0), step(state.place + 1, "Worse", "to-worse", state.place === last),
        el("span", { class: "place", "aria-live": "polite" }, `${state.place + 1} of ${ranked.length}, best first`)),
      sides(b, k, q),
      el("dl", { class: "facts" },
        fact("query", query.name, true),
        fact("condition", b.conditions[query.condition]),
        fact("status", !q ? "not in this file" : q.status),
        fact("position error", q && q.t !== null ? `${digits(q.t)} m` : "–"),
        fact("rotation error", q && q.r !== null ? `${digits(q.r)}°` : "–"),
        fact("predicted sigma", q && q.sigma !== null ? `${digits(q.sigma)} m` : "–"),
        fact("inliers", q ? String(q.inliers) : "–"),
        fact("seconds", q ? digits(q.seconds) : "–"),
        q && q.reason ? fact("reason", q.reason, true) : null,
        b.runs.length > 1 ? fact("other methods here", b.runs.map((run, n) => {
          const other = run.queries[k];
          return n === state.run ? null : `${run.label}: ${!other || other.t === null ? "failed" : `${digits(other.t)} m${other.status === "ok" ? "" : " (fallback)"}`}`;
        }).filter(Boolean).join("; "), true) : null),
      strip(b, ranked));
  };

  // ---- the page

  const group = (name, label, options, chosen, choose) => el("div", { class: "choice", role: "group", "aria-label": label }, el("span", { class: "name" }, label),
    options.map(([value, text]) => el("button", { type: "button", "data-of": name, "data-value": value, "aria-pressed": String(value === chosen), onclick: () => choose(value) }, text)));
  const press = (name, chosen) => document.querySelectorAll(`[data-of="${name}"]`).forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.value === String(chosen))));

  const card = (id, title, about, ...children) => el("section", { class: "card", id }, el("h3", {}, title), about ? el("p", { class: "quiet" }, about) : null, ...children);

  const paintCharts = () => {
    const b = board(), holder = document.getElementById("charts");
    const threshold = data.thresholds[state.threshold].text;
    const where = state.condition === ALL ? "all queries" : state.condition;
    const runs = everyRun(b), withBasin = runs.filter((run) => b.runs[run].basin);
    forgetCharts(holder);
    holder.replaceChildren(
      card("curves", "Error curves", `Percent of ${where} localized below an error. Dotted lines: the thresholds, of which recall asks both. Failures and fallback poses never arrive.`,
        group("error", "error", [["t", "position"], ["r", "rotation"]], state.error, (value) => { state.error = value; paintCharts(); focusOn("error", value); }),
        curves(b), legend(b, runs, true)),
      card("speed", "Accuracy against seconds", `Recall (%) at ${threshold}, ${where}, with its interval; one mark a method.`, speed(b), legend(b, runs)),
      card("basin", "Basin of convergence", withBasin.length
        ? `Recall (%) at ${threshold} of all queries, when the prior is wrong by exactly so much; each method hears the same priors.`
        : "Recall against the error of the prior. Nothing measured yet: objconnect basin DATASET --method M --out RESULTS.",
      ...(withBasin.length ? [basin(b, withBasin), legend(b, withBasin, true)] : [])),
      card("surest", "Surest first", `Percent right at ${threshold} when only the queries of least predicted sigma are believed; those without one come last.`,
        surest(b), legend(b, runs, true),
        el("p", { class: "quiet" }, `Normalised error squared (6 when covariances are honest) and share inside the 95 % ellipsoid: ${b.runs.map(honesty).join("; ")}.`)),
      card("heat", "Conditions", `Recall (%) at ${threshold}; a cell opens its worst query.`, heatMap(b)),
      ...(b.runs.length > 1 ? [card("pairs", "Paired comparison", `Change of recall in points at ${threshold}, ${where}, query by query; p of McNemar's exact test, two-sided, coloured below 0.05 and not corrected for the number of pairs. ${b.pairs_note}`, pairTable(b))] : []));
  };
  const focusOn = (name, value) => { const button = document.querySelector(`[data-of="${name}"][data-value="${value}"]`); if (button) button.focus(); };

  const setCondition = (condition) => {
    const b = board();
    state.condition = condition === ALL || b.conditions.length < 2 ? ALL : condition;
    const select = document.getElementById("condition");
    if (select) select.value = String(b.conditions.indexOf(state.condition));
    paintCharts();
  };

  const paintBoard = () => {
    const b = board(), main = document.getElementById("board");
    forgetCharts(main);
    Object.assign(state, { condition: ALL, sort: null, run: 0, place: Infinity });
    main.replaceChildren(
      el("section", { class: "card" }, el("h2", {}, `${b.track}: ${b.dataset}`), el("p", { class: "quiet" }, b.facts),
        b.note ? el("p", { class: "note" }, b.note) : null, mainTable(b),
        el("details", {}, el("summary", {}, "What was run"), b.runs.map((run) => el("pre", {}, `${run.label}\nconfiguration ${run.config}\nweights ${run.weights || "none"}\n${Object.entries(run.environment).map((pair) => pair.join(" ")).join(", ")}\npeak memory ${run.summaries[ALL].memory === null ? "unknown" : `${run.summaries[ALL].memory} MB`}`)))),
      el("div", { class: "controls" },
        group("threshold", "recall at", data.thresholds.map((t, k) => [k, t.text]), state.threshold, (value) => { state.threshold = value; press("threshold", value); paintCharts(); }),
        b.conditions.length > 1 ? el("label", { class: "choice" }, el("span", { class: "name" }, "condition"),
          el("select", { id: "condition", onchange: (event) => { state.condition = event.target.value === "-1" ? ALL : b.conditions[Number(event.target.value)]; state.place = Infinity; paintCharts(); paintQuery(); } },
            el("option", { value: "-1" }, "all"), b.conditions.map((condition, k) => el("option", { value: k }, condition)))) : null),
      el("div", { class: "grid", id: "charts" }),
      el("section", { class: "card", id: "queries", tabindex: "-1", "aria-label": "Queries" }, el("h3", {}, "Query by query"),
        el("p", { class: "quiet" }, "By position error; failures are worst. The strip below shows every query: click in it to go there."), el("div", { id: "query" })));
    paintCharts();
    paintQuery();
    document.querySelectorAll("#boards button").forEach((button, k) => button.setAttribute("aria-current", String(k === state.board)));
  };

  if (data.boards.length > 1) {
    document.getElementById("boards").append(...data.boards.map((b, k) => el("button", { type: "button", onclick: () => { state.board = k; paintBoard(); } },
      b.dataset, el("small", {}, `${b.track}, start: ${b.start}`))));
  }
  paintBoard();
  document.getElementById("paper").append(...paper());
})();
