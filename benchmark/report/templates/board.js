(() => {
  const SAME = "same", CHANGED = "changed";
  const STATUS = ["ok", "fallback", "failed"];
  const PAGE = 10;
  const state = { track: 0, start: 0, season: CHANGED, part: ALL, threshold: Math.min(1, data.thresholds.length - 1),
    sort: null, run: 0, shown: PAGE };

  const track = () => data.tracks[state.track];
  const start = () => track().starts[state.start];
  const labelOf = (run) => start().runs[run].label;
  const everyRun = () => start().runs.map((_, run) => run);
  const cellOf = (season, part) => start().cells.find((c) => c.season === season && c.part === part);
  const cell = () => cellOf(state.season, state.part);
  const seasonName = (season) => ({ [SAME]: "same season", [CHANGED]: "changed" }[season] || season);
  const partName = (part) => (part === ALL ? "all places" : part);
  const where = () => `${seasonName(state.season)}, ${partName(state.part)}`;
  const withFigures = () => everyRun().filter((run) => cell().runs[run]);
  const threshold = () => data.thresholds[state.threshold].text;

  // ---- the cell in the address, so that it can be linked to

  const words = () => [track().name, start() ? start().name : "", state.season, state.part, String(state.threshold)];
  const remember = () => history.replaceState(null, "", `#${words().map(encodeURIComponent).join("/")}`);
  const recall = () => {
    const [name, from, season, part, at] = decodeURIComponent(location.hash.slice(1).replaceAll("/", "\n")).split("\n");
    const chosen = data.tracks.findIndex((t) => t.name === name);
    if (chosen < 0) return;
    state.track = chosen;
    state.start = Math.max(0, track().starts.findIndex((s) => s.name === from));
    if (data.thresholds[Number(at)]) state.threshold = Number(at);
    if (start() && cellOf(season, part)) Object.assign(state, { season, part });
  };

  // ---- headline

  const columns = () => [
    { name: "method", word: true, key: (row) => row.label.toLowerCase() },
    { name: "queries", key: (row) => row.s.queries },
    ...data.thresholds.map((t, k) => ({ name: `${t.text} %`, key: (row) => row.s.recall[k][0], best: "descending" })),
    { name: `surest at ${threshold()} %`, key: (row) => (row.bounded ? row.bounded[0] : null), best: "descending" },
    { name: "false fixes %", key: (row) => row.s.wrong[0] },
    { name: "median m", key: (row) => row.s.t },
    { name: "median °", key: (row) => row.s.r },
    { name: "failed + fallback", key: (row) => row.s.failed + row.s.fallback },
    { name: "s/query", key: (row) => row.s.seconds },
  ];
  const plainCell = (value) => el("td", {}, value ? [percent(value), el("small", {}, interval(value))] : "–");
  const headline = () => {
    const rows = withFigures().map((run) => ({ run, label: labelOf(run), s: cell().runs[run].summary, bounded: cell().runs[run].bounded[state.threshold] }));
    return sortedTable("Results of the cell", columns(), ["look at"], rows, (row) => el("tr", {},
      el("th", { scope: "row", class: "word" }, swatch(row.run), row.label),
      el("td", {}, row.s.queries === cell().queries ? String(row.s.queries) : [String(row.s.queries), el("small", {}, `of ${cell().queries}`)]),
      row.s.recall.map((value) => recallCell(row.run, value)),
      plainCell(row.bounded), plainCell(row.s.wrong),
      [row.s.t, row.s.r].map((value) => el("td", {}, digits(value))),
      el("td", {}, `${row.s.failed} + ${row.s.fallback}`),
      el("td", {}, digits(row.s.seconds)),
      el("td", { class: "acts" }, el("button", { type: "button", "aria-label": `worst queries of ${row.label}`, onclick: () => {
        Object.assign(state, { run: row.run, shown: PAGE });
        paintWorst();
        document.getElementById("worst").scrollIntoView({ block: "start" });
      } }, "worst"))), state);
  };

  const overview = () => {
    const { cells } = start(), seasons = [...new Set(cells.map((c) => c.season))];
    const broad = seasons.filter((season) => [CHANGED, SAME].includes(season));
    const single = cells.filter((c) => !broad.includes(c.season));
    const inOrder = [...broad.flatMap((season) => cells.filter((c) => c.season === season)), ...single];
    return scroll("Recall of every method in every cell", el("table", { class: "heat" },
      el("thead", {},
        el("tr", {}, el("td", {}), broad.map((season) => el("th", { scope: "colgroup", colspan: cells.filter((c) => c.season === season).length }, seasonName(season))),
          single.length ? el("th", { scope: "colgroup", colspan: single.length }, "one condition, all places") : null),
        el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), inOrder.map((c) => el("th", { scope: "col" },
          broad.includes(c.season) ? partName(c.part) : c.season, el("small", {}, `${c.queries}, ±${c.half.toFixed(1)}`))))),
      el("tbody", {}, everyRun().map((run) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(run), labelOf(run)),
        inOrder.map((c) => {
          const figures = c.runs[run];
          if (!figures) return el("td", { class: "cell" }, "–");
          const value = figures.summary.recall[state.threshold], part = figures.summary.queries;
          return el("td", { class: "cell", "aria-current": String(c === cell()), css: { background: `hsl(var(--heat) / ${(0.04 + 0.56 * value[0] / 100).toFixed(3)})` } },
            el("button", { type: "button", title: `${labelOf(run)}, ${seasonName(c.season)}, ${partName(c.part)}: ${percent(value)} % ${interval(value)} of ${figures.summary.queries}; shows the cell`,
              onclick: () => choose({ season: c.season, part: c.part }) }, percent(value), part === c.queries ? null : el("small", {}, `of ${part}`)));
        }))))));
  };

  // ---- difficulty

  const difficulty = (number) => chart((width) => {
    const axis = data.axes[number], runs = withFigures();
    const counts = axis.labels.map((_, bin) => Math.max(...runs.map((run) => cell().runs[run].difficulty[number][bin][0])));
    const f = frame(width, `Recall against ${axis.short}`, axis.unit, (from, to) => linear(-0.5, axis.labels.length - 0.5, from, to),
      axis.labels.map((label, bin) => [bin, label, `n ${counts[bin]}`]));
    const step = Math.min(10, (width / axis.labels.length / (runs.length + 1)));
    runs.forEach((run, k) => {
      const shift = (k - (runs.length - 1) / 2) * step;
      const bins = cell().runs[run].difficulty[number];
      const known = bins.map((_, bin) => bin).filter((bin) => bins[bin][0]);
      const value = (bin) => bins[bin][1 + state.threshold];
      if (known.length > 1) f.root.append(svg("path", { d: `M${known.map((bin) => `${f.x(bin) + shift} ${f.y(value(bin)[0])}`).join("L")}`,
        fill: "none", "stroke-width": 1.8, "stroke-dasharray": dashes[run % 8], css: { stroke: colour(run) } }));
      for (const bin of known) f.root.append(...whisker(f, run, f.x(bin) + shift, value(bin),
        `${labelOf(run)}, ${axis.short} ${axis.labels[bin]}: ${percent(value(bin))} % ${interval(value(bin))} of ${bins[bin][0]}`));
    });
    return f.root;
  });

  const difficultyTable = (runs) => scroll("Recall by difficulty", el("table", {},
    el("thead", {}, el("tr", {}, ["difficulty", "bin"].map((name) => el("th", { scope: "col", class: "word" }, name)), el("th", { scope: "col" }, "queries"),
      runs.map((run) => el("th", { scope: "col" }, labelOf(run))))),
    el("tbody", {}, data.axes.flatMap((axis, number) => axis.labels.map((label, bin) => {
      const bins = runs.map((run) => cell().runs[run].difficulty[number][bin]);
      return el("tr", {}, el("th", { scope: "row", class: "word" }, axis.short), el("td", { class: "word" }, `${label} ${axis.unit}`),
        el("td", {}, String(Math.max(...bins.map(([queries]) => queries)))), bins.map((found) => plainCell(found[1 + state.threshold])));
    })))));

  // ---- integrity

  const consistency = () => {
    const cells = start().cells.filter((c) => c.part === ALL);
    return scroll("Covariances and false fixes by condition", el("table", {},
      el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), el("th", { scope: "col", class: "word" }, "figure"),
        cells.map((c) => el("th", { scope: "col" }, seasonName(c.season))))),
      el("tbody", {}, everyRun().flatMap((run) => {
        const line = (name, text, first) => el("tr", {},
          first ? el("th", { scope: "rowgroup", class: "word", rowspan: 4 }, swatch(run), labelOf(run)) : null,
          el("th", { scope: "row", class: "word" }, name),
          cells.map((c) => {
            const [value, right] = c.runs[run] ? text(c.runs[run]) : ["–", false];
            return el("td", { class: right ? "right" : null }, value);
          }));
        const nees = (figure) => (r) => (r.nees ? figure(r.nees) : ["–", false]);
        return [
          line("NEES, mean", nees((n) => [neesText(n.mean), n.mean >= 4.5 && n.mean <= 8]), true),
          line("NEES, median", nees((n) => [neesText(n.median), false])),
          line("in the 95 % ellipsoid", nees((n) => [`${percent(n.within)} %`, n.within[0] >= 93 && n.within[0] <= 97])),
          line("false fixes", (r) => [`${percent(r.summary.wrong)} %`, r.summary.wrong[0] <= 1]),
        ];
      }))));
  };

  // ---- worst queries

  const inCell = () => {
    const q = track().queries, { conditions, parts } = track();
    return q.name.map((_, k) => k).filter((k) => (state.part === ALL || parts[q.part[k]] === state.part)
      && (state.season === SAME ? q.same[k] : state.season === CHANGED ? !q.same[k] : conditions[q.condition[k]] === state.season));
  };
  // Worst first: wrong answers that were called right, the farthest off first; then fallbacks, then failures.
  const worstOf = (run) => {
    const answers = start().runs[run];
    return inCell().filter((k) => answers.status[k] !== null)
      .sort((a, b) => answers.status[a] - answers.status[b] || (answers.t[b] || 0) - (answers.t[a] || 0) || a - b);
  };
  const found = (run, k) => {
    const answers = start().runs[run], status = answers.status[k];
    if (status === null) return "–";
    return status === 2 ? "failed" : `${digits(answers.t[k])} m${status ? " (fallback)" : ""}`;
  };
  const value = (number) => (number === null ? "–" : plain(number));
  const thumbs = (k) => {
    const pictures = (track().pictures || {})[k];
    if (!pictures) return "–";
    return el("div", { class: "thumbs" }, pictures.map((picture, side) => (picture === null ? null
      : el("img", { src: data.pictures[picture], alt: side ? "map photograph" : "query" }))));
  };
  const paintWorst = () => {
    const holder = document.getElementById("worst-queries"), t = track(), q = t.queries;
    if (!withFigures().includes(state.run)) [state.run] = withFigures();
    const ranked = worstOf(state.run), answers = start().runs[state.run];
    const others = everyRun().filter((run) => run !== state.run);
    const pictured = Boolean(t.pictures && Object.keys(t.pictures).length);
    const lost = ranked.filter((k) => answers.status[k] === 2).length;
    holder.replaceChildren(
      el("label", { class: "choice" }, el("span", { class: "name" }, "method"),
        el("select", { id: "run", onchange: (event) => { Object.assign(state, { run: Number(event.target.value), shown: PAGE }); paintWorst(); document.getElementById("run").focus(); } },
          withFigures().map((run) => el("option", { value: run, selected: run === state.run }, labelOf(run))))),
      scroll("Worst queries", el("table", {},
        el("thead", {}, el("tr", {}, [["query", 1], ["condition", 1], ["part", 1], ["error", 0], ["rotation", 0], ["sigma", 0], ...data.axes.map((axis) => [axis.column, 0])]
          .map(([name, word]) => el("th", { scope: "col", class: word ? "word" : null }, name)),
        others.map((run) => el("th", { scope: "col" }, labelOf(run))), pictured ? el("th", { scope: "col", class: "word" }, "query, map") : null)),
        el("tbody", { id: "worst-rows" }, ranked.slice(0, state.shown).map((k) => el("tr", {},
          el("th", { scope: "row", class: "word" }, t.datasets[q.dataset[k]][0], el("small", {}, q.name[k])),
          el("td", { class: "word" }, t.conditions[q.condition[k]]), el("td", { class: "word" }, t.parts[q.part[k]]),
          el("td", {}, found(state.run, k)), el("td", {}, answers.r[k] === null ? "–" : `${digits(answers.r[k])}°`),
          el("td", {}, answers.sigma[k] === null ? "–" : `${digits(answers.sigma[k])} m`),
          data.axes.map((axis) => el("td", {}, value(q[axis.key][k]))),
          others.map((run) => el("td", {}, found(run, k))), pictured ? el("td", { class: "word" }, thumbs(k)) : null))))),
      el("div", { class: "choice" },
        el("button", { type: "button", id: "more", disabled: state.shown >= ranked.length, onclick: () => { state.shown += PAGE; paintWorst(); } }, "More"),
        el("span", { class: "quiet" }, `${Math.min(state.shown, ranked.length)} of ${ranked.length} queries; ${lost} failed`)));
  };

  // ---- the page

  // Two methods may share fewer flights than the cell has.
  const pairedFlights = (pairs) => {
    const counts = pairs.map((p) => p.flights), least = Math.min(...counts), most = Math.max(...counts);
    return least === most ? `${least}` : `${least} to ${most}`;
  };
  const paintCell = () => {
    const main = document.getElementById("cell"), c = cell(), runs = withFigures(), pairs = c.pairs[state.threshold];
    const sure = runs.filter((run) => c.runs[run].bounded[state.threshold]);
    forgetCharts(main);
    remember();
    const legendOf = (lines) => legend(labelOf, runs, lines);
    main.replaceChildren(
      el("section", { class: "card" }, el("h2", { id: "where" }, `${track().name}: ${where()}`),
        el("p", { class: "quiet", id: "facts" }, `Start: ${start().words}. ${c.queries} queries of ${c.flights} flights. At a recall of 90 % the 95 % interval is ±${c.half.toFixed(1)} points.`),
        headline(),
        el("p", { class: "quiet" }, `Surest: accept answers from the highest predicted probability down (or from the smallest sigma up) while fewer than 1 % of them are wrong at ${threshold()}. The figure is the share of all queries that are accepted and right.`)),
      el("div", { class: "grid" },
        card("overview", "All cells", `Recall (%) at ${threshold()}; below each heading the number of queries, and half the width of the 95 % interval at a recall of 90 %. Click a figure to show its cell above.`, overview()),
        runs.length > 1 ? el("section", { class: "card", id: "pairs" }, el("h3", {}, "Paired comparison"),
          el("p", { class: "quiet" }, `Change of recall in points at ${threshold()}, ${where()}, query by query; p is two-sided, coloured below 0.05 and not corrected for the number of pairs. `
            + (pairs.length && pairs.every((p) => p.clustered) ? `Intervals are from a bootstrap over whole flights (${pairedFlights(pairs)} here), and p is from a permutation test over flights.` : "With fewer than five flights, intervals are Bonett and Price's and p is McNemar's. Both assume independent queries, so the true intervals are wider and the true p is larger.")),
          pairedTable(everyRun().map(labelOf), (a, b) => pairs.find((p) => p.a === a && p.b === b))) : null,
        el("section", { class: "card", id: "difficulty" }, el("h3", {}, "Difficulty"),
          el("p", { class: "quiet" }, `Recall (%) at ${threshold()}, ${where()}, with its interval. Overlap, scale and angle are of the map photograph that sees most of the query; n counts queries.`),
          el("div", { class: "grid" }, data.axes.map((axis, k) => el("div", {}, el("h4", {}, axis.short), el("p", { class: "quiet" }, axis.title), difficulty(k)))), legendOf(true),
          el("details", {}, el("summary", {}, "As a table"), difficultyTable(runs))),
        card("surest", "Surest first", `Percent right at ${threshold()} among the answers with the highest predicted probability or the smallest sigma. Methods that predict neither are left out.`,
          surestChart(labelOf, sure, (run) => c.runs[run].surest[state.threshold]), legend(labelOf, sure, true)),
        card("bounded", "Recall at bounded risk", `Percent of all queries accepted and right at each threshold, while fewer than 1 % of the accepted answers are wrong; ${where()}.`, scroll("Recall at bounded risk", el("table", {},
          el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), data.thresholds.map((t) => el("th", { scope: "col" }, t.text)))),
          el("tbody", {}, runs.map((run) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(run), labelOf(run)), c.runs[run].bounded.map(plainCell))))))),
        card("consistency", "Integrity", "NEES (squared error normalized by the covariance: 6 in the mean and 5.35 in the median if covariances are right), errors inside the 95 % ellipsoid, and false fixes, over all places. Coloured: a mean from 4.5 to 8, 93 to 97 % inside, at most 1 % false fixes.", consistency()),
        card("worst", "Worst queries", `${where()}. First answers with status ok, the largest error on top; then fallback poses, then failures. The last columns show the errors of the other methods.`, el("div", { id: "worst-queries" }))));
    paintWorst();
  };
  const choose = (change) => {
    Object.assign(state, change, { shown: PAGE });
    if (!cell()) state.part = ALL;
    if (!cell()) state.season = start().cells[0].season;
    paintControls();
    paintCell();
  };

  const select = (id, label, options, chosen, change) => el("label", { class: "choice" }, el("span", { class: "name" }, label),
    el("select", { id, onchange: (event) => { change(options[Number(event.target.value)][0]); document.getElementById(id).focus(); } },
      options.map(([option, text], k) => el("option", { value: k, selected: option === chosen }, text))));
  const paintControls = () => {
    const t = track(), { cells } = start();
    const seasons = [...new Set(cells.map((c) => c.season))];
    const parts = cells.filter((c) => c.season === state.season).map((c) => c.part);
    document.getElementById("controls").replaceChildren(
      select("start", "start", t.starts.map((s, k) => [k, s.words]), state.start, (value) => choose({ start: value, sort: null })),
      select("season", "condition", seasons.map((season) => [season, seasonName(season)]), state.season, (value) => choose({ season: value })),
      select("part", "part", parts.map((part) => [part, partName(part)]), state.part, (value) => choose({ part: value })),
      group("threshold", "recall at", data.thresholds.map((t, k) => [k, t.text]), state.threshold, (value) => { choose({ threshold: value }); focusOn("threshold", value); }));
  };

  const paintTrack = () => {
    const t = track(), main = document.getElementById("board");
    forgetCharts(main);
    main.replaceChildren(...[
      el("p", { class: "lede" }, t.title),
      t.starts.length ? el("div", { class: "controls", id: "controls" }) : el("p", { class: "note" }, "Nothing is measured on this track yet."),
      el("div", { id: "cell" }),
      t.missing.length ? el("details", {}, el("summary", {}, `Missing results: ${t.missing.length}`), el("ul", {}, t.missing.map((text) => el("li", {}, text)))) : null,
      el("details", {}, el("summary", {}, "Data sets and the SHA-256 digests of their files"), el("pre", {}, t.datasets.map(([name, digest]) => `${name} ${digest || "not rendered yet"}`).join("\n"))),
    ].filter(Boolean));
    if (t.starts.length) choose({});
    document.querySelectorAll("#tracks button").forEach((button, k) => button.setAttribute("aria-current", String(k === state.track)));
  };

  document.getElementById("tracks").append(...data.tracks.map((t, k) => el("button", { type: "button",
    onclick: () => { Object.assign(state, { track: k, start: 0, season: CHANGED, part: ALL, sort: null, run: 0 }); paintTrack(); } },
    t.name, el("small", {}, `${t.queries.name.length} queries, ${t.methods.length} methods, ${t.starts.length} starts`))));
  recall();
  paintTrack();
  document.getElementById("paper").append(...paper());
})();
