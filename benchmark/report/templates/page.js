(() => {
  const state = { board: 0, threshold: Math.min(1, data.thresholds.length - 1), condition: ALL,
    error: "t", sort: null, run: 0, place: 0 };

  const board = () => data.boards[state.board];
  const everyRun = (b) => b.runs.map((_, run) => run);
  const labelOf = (b) => (run) => b.runs[run].label;
  const listed = (b) => b.queries.map((_, k) => k)
    .filter((k) => state.condition === ALL || b.conditions[b.queries[k].condition] === state.condition);
  const summary = (b, run) => b.runs[run].summaries[state.condition];

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
    const points = everyRun(b).map((run) => [run, summary(b, run)]).filter(([, s]) => s && s.seconds && s.recall[state.threshold]);
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
        const levels = b.runs[run].basin.filter((level) => level.recall[state.threshold]).sort((a, c) => place(a) - place(c));
        const points = levels.map((level) => `${f.x(place(level)) + shift} ${f.y(level.recall[state.threshold][0])}`);
        if (points.length) f.root.append(svg("path", { d: `M${points.join("L")}`, fill: "none", "stroke-width": 2, "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } }));
        for (const level of levels) {
          const recall = level.recall[state.threshold];
          f.root.append(...whisker(f, run, f.x(place(level)) + shift, recall,
            `${b.runs[run].label}, prior wrong by ${plain(level.t)} m ${plain(level.r)}°: ${percent(recall)} % ${interval(recall)} of ${level.queries}`));
        }
      });
      return f.root;
    });
  };

  const surest = (b) => surestChart(labelOf(b), everyRun(b), (run) => {
    const right = b.runs[run].surest[state.threshold];
    return right && right.map((share, k) => [(100 * (k + 1)) / right.length, share]);
  });
  // Text between backticks is code.
  const coded = (text) => text.split("`").map((part, k) => (k % 2 ? el("code", {}, part) : part));
  const honesty = (run) => `${run.label}: ${run.nees
    ? `${neesText(run.nees.mean[0])} ${neesInterval(run.nees.mean)} on average, ${percent(run.nees.within)} % ${interval(run.nees.within)} inside, of ${run.nees.queries}`
    : "no covariance"}`;

  // ---- tables

  const tableColumns = () => [
    { name: "method", word: true, key: (row) => row.label.toLowerCase() },
    { name: "condition", word: true, broad: true, key: (row) => (row.condition === ALL ? "" : row.condition.toLowerCase()) },
    { name: "queries", key: (row) => row.s.queries },
    { name: "courses", key: (row) => row.s.courses },
    ...data.thresholds.map((t, k) => ({ name: t.text, unit: "%", key: (row) => valueOf(row.s.recall[k]), best: "descending" })),
    { name: "median m", key: (row) => row.s.t },
    { name: "median °", key: (row) => row.s.r },
    ...integrityColumns(""),
    { name: "failed + fallback", key: (row) => row.s.failed + row.s.fallback },
    { name: "s/query", key: (row) => row.s.seconds },
  ];

  const rowsOf = (b) => b.runs.flatMap((run, k) => [
    ...(b.conditions.length > 1 ? [ALL] : []), ...b.conditions]
    .filter((condition) => run.summaries[condition])
    .map((condition) => ({ run: k, label: run.label, condition, s: run.summaries[condition] })));

  const mainTable = (b) => sortedTable("Table of results", tableColumns(), ["look at"], rowsOf(b),
    (row) => el("tr", { class: row.condition === ALL ? "all" : null },
      el("th", { scope: "row", class: "word" }, swatch(row.run), row.label, el("small", { class: "narrow" }, row.condition)),
      el("td", { class: "word broad" }, row.condition),
      el("td", {}, String(row.s.queries)),
      el("td", {}, String(row.s.courses)),
      row.s.recall.map((recall) => recallCell(row.run, recall)),
      [row.s.t, row.s.r].map((value) => el("td", {}, digits(value))),
      row.s.integrity.map(shareCell),
      el("td", {}, `${row.s.failed} + ${row.s.fallback}`),
      el("td", {}, digits(row.s.seconds)),
      el("td", { class: "acts" }, ["worst", "best"].map((end) => el("button", {
        type: "button", "aria-label": `${end} query of ${row.label}, ${row.condition}`,
        onclick: () => open(row.run, row.condition, end) }, end)))), state);

  const heatMap = (b) => scroll("Recall by method and condition", el("table", { class: "heat" },
    el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"),
      b.conditions.map((condition) => el("th", { scope: "col" }, condition, b.map_conditions.includes(condition) ? " (map)" : "")))),
    el("tbody", {}, b.runs.map((run, k) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(k), run.label),
      b.conditions.map((condition) => {
        const s = run.summaries[condition];
        if (!s) return el("td", { class: "cell" }, "–");
        const recall = s.recall[state.threshold];
        if (!recall) return el("td", { class: "cell" }, "–");
        return el("td", { class: "cell", css: { background: `hsl(var(--heat) / ${(0.04 + 0.56 * recall[0] / 100).toFixed(3)})` } },
          el("button", { type: "button", title: `${run.label}, ${condition}: ${percent(recall)} % ${interval(recall)} of ${s.queries}; opens its worst query`,
            onclick: () => open(k, condition, "worst") }, percent(recall)));
      }))))));

  const pairTable = (b) => pairedTable(b.runs.map((run) => run.label),
    (a, c) => b.pairs.find((p) => p.a === a && p.b === c && p.threshold === state.threshold && p.condition === state.condition));

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
      el("figure", { id: "map-picture" }, right, el("figcaption", {}, "Nearest map photograph", beside ? `, ${beside.name}. ` : ". ", el("span", { class: "key ring" }, "○"), " the same points, as observed in it.")));
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

  const paintCharts = () => {
    const b = board(), holder = document.getElementById("charts");
    const threshold = data.thresholds[state.threshold].text;
    const where = state.condition === ALL ? "all queries" : state.condition;
    const runs = everyRun(b), withBasin = runs.filter((run) => b.runs[run].basin);
    forgetCharts(holder);
    holder.replaceChildren(
      card("curves", "Error curves", `Percent of ${where} localized below an error. Dotted lines are the thresholds; recall applies those of position and rotation together. Failures and fallback poses never count.`,
        group("error", "error", [["t", "position"], ["r", "rotation"]], state.error, (value) => { state.error = value; paintCharts(); focusOn("error", value); }),
        curves(b), legend(labelOf(b), runs, true)),
      card("speed", "Accuracy against seconds", `Recall (%) at ${threshold}, ${where}, with its interval. Each mark is a method.`, speed(b), legend(labelOf(b), runs)),
      card("basin", "Basin of convergence", withBasin.length
        ? `Recall (%) at ${threshold} of all queries, when the prior has exactly this error; each method gets the same priors.`
        : coded("Recall against the error of the prior. Nothing is measured yet. Run `objconnect basin DATASET --method METHOD --out RESULTS`."),
      ...(withBasin.length ? [basin(b, withBasin), legend(labelOf(b), withBasin, true)] : [])),
      card("surest", "Surest first", `Percent right at ${threshold} among the answers with the highest predicted probability or the smallest sigma. Failed queries come last.`,
        surest(b), legend(labelOf(b), runs, true),
        el("p", { class: "quiet" }, `NEES (6 in the mean if covariances are right) and share of errors inside the 95 % ellipsoid: ${b.runs.map(honesty).join("; ")}.`)),
      card("heat", "Conditions", `Recall (%) at ${threshold}; a cell opens its worst query.`, heatMap(b)),
      ...(b.runs.length > 1 ? [card("pairs", "Paired comparison", `Change of recall in points at ${threshold}, ${where}, query by query; p is two-sided, coloured below 0.05 and not corrected for the number of pairs. ${b.pairs_note}`, pairTable(b))] : []));
  };
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
        b.note ? el("p", { class: "note" }, coded(b.note)) : null, mainTable(b),
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
