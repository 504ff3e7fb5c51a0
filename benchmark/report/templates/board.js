(() => {
  const SAME = "same", CHANGED = "changed", NOVELTIES = ["seen", "unseen-condition", "unseen-place", "unseen-both"];
  const STATUS = ["ok", "fallback", "failed"];
  const PAGE = 10;
  const state = { track: 0, start: 0, season: CHANGED, part: ALL, threshold: Math.min(1, data.thresholds.length - 1),
    shared: 0, sort: null, run: 0, shown: PAGE };

  const track = () => data.tracks[state.track];
  const start = () => track().starts[state.start];
  // If methods were given different queries, the user chooses: each method's own queries, or the shared ones.
  const cellsShown = () => (state.shared && start().shared.length ? start().shared : start().cells);
  const labelOf = (run) => start().runs[run].label;
  const everyRun = () => start().runs.map((_, run) => run);
  const cellOf = (season, part) => cellsShown().find((c) => c.season === season && c.part === part);
  const cell = () => cellOf(state.season, state.part);
  const seasonName = (season) => ({ [SAME]: "same season", [CHANGED]: "changed" }[season] || (NOVELTIES.includes(season) ? season.replace("-", " ") : season));
  const partName = (part) => (part === ALL ? "all places" : part);
  const where = () => `${seasonName(state.season)}, ${partName(state.part)}`;
  const withFigures = () => everyRun().filter((run) => cell().runs[run]);
  const threshold = () => data.thresholds[state.threshold].text;

  // ---- the cell in the address, so that it can be linked to

  const words = () => [track().name, start() ? start().name : "", state.season, state.part, String(state.threshold), ...(state.shared ? ["shared"] : [])];
  const remember = () => history.replaceState(null, "", `#${words().map(encodeURIComponent).join("/")}`);
  const recall = () => {
    const [name, from, season, part, at, shared] = decodeURIComponent(location.hash.slice(1).replaceAll("/", "\n")).split("\n");
    const chosen = data.tracks.findIndex((t) => t.name === name);
    if (chosen < 0) return;
    state.track = chosen;
    state.start = Math.max(0, track().starts.findIndex((s) => s.name === from));
    state.shared = shared === "shared" ? 1 : 0;
    if (data.thresholds[Number(at)]) state.threshold = Number(at);
    if (start() && cellOf(season, part)) Object.assign(state, { season, part });
  };

  // ---- headline

  const columns = () => [
    { name: "method", word: true, key: (row) => row.label.toLowerCase() },
    { name: "queries", key: (row) => row.s.queries },
    { name: "courses", key: (row) => row.s.courses },
    ...data.thresholds.map((t, k) => ({ name: `${t.text} %`, key: (row) => valueOf(row.s.recall[k]), best: "descending" })),
    { name: `surest at ${threshold()} %`, key: (row) => valueOf(row.bounded), best: "descending" },
    ...integrityColumns(" %"),
    { name: "median error", key: (row) => row.s.t },
    { name: "failed + fallback", key: (row) => row.s.failed + row.s.fallback },
    { name: "s/query", key: (row) => row.s.seconds },
  ];
  const courses = (count) => `${count} ${count === 1 ? "course" : "courses"}`;
  const places = (count) => `${count} ${count === 1 ? "place" : "places"}`;
  const headline = () => {
    const rows = withFigures().map((run) => ({ run, label: labelOf(run), s: cell().runs[run].summary, places: cell().runs[run].places, bounded: cell().runs[run].bounded[state.threshold] }));
    return sortedTable("Results of the cell", columns(), ["look at"], rows, (row) => el("tr", {},
      el("th", { scope: "row", class: "word" }, swatch(row.run), row.label),
      el("td", {}, row.s.queries === cell().queries ? String(row.s.queries) : [String(row.s.queries), el("small", {}, `of ${cell().queries}`)]),
      el("td", {}, [String(row.s.courses), el("small", {}, `in ${places(row.places)}`)]),
      row.s.recall.map((value) => recallCell(row.run, value)),
      shareCell(row.bounded), row.s.integrity.map(shareCell),
      el("td", {}, row.s.t === null ? "–" : [`${digits(row.s.t)} m`, el("small", {}, `${digits(row.s.r)}°`)]),
      el("td", {}, `${row.s.failed} + ${row.s.fallback}`),
      el("td", {}, digits(row.s.seconds)),
      el("td", { class: "acts" }, el("button", { type: "button", "aria-label": `worst queries of ${row.label}`, onclick: () => {
        Object.assign(state, { run: row.run, shown: PAGE });
        paintWorst();
        document.getElementById("worst").scrollIntoView({ block: "start" });
      } }, "worst"))), state);
  };

  const overview = () => {
    const cells = cellsShown(), seasons = [...new Set(cells.map((c) => c.season))];
    const broad = seasons.filter((season) => [CHANGED, SAME].includes(season));
    const novel = cells.filter((c) => NOVELTIES.includes(c.season));
    const single = cells.filter((c) => !broad.includes(c.season) && !novel.includes(c));
    const inOrder = [...broad.flatMap((season) => cells.filter((c) => c.season === season)), ...novel, ...single];
    return scroll("Recall of every method in every cell", el("table", { class: "heat" },
      el("thead", {},
        el("tr", {}, el("td", {}), broad.map((season) => el("th", { scope: "colgroup", colspan: cells.filter((c) => c.season === season).length }, seasonName(season))),
          novel.length ? el("th", { scope: "colgroup", colspan: novel.length }, "changed, by what training may use") : null,
          single.length ? el("th", { scope: "colgroup", colspan: single.length }, "one condition, all places") : null),
        el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), inOrder.map((c) => el("th", { scope: "col" },
          broad.includes(c.season) ? partName(c.part) : seasonName(c.season), el("small", {}, `${c.queries} of ${courses(c.courses)}, ${places(c.places)}`))))),
      el("tbody", {}, everyRun().map((run) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(run), labelOf(run)),
        inOrder.map((c) => {
          const figures = c.runs[run];
          if (!figures) return el("td", { class: "cell" }, "–");
          if (!figures.summary.recall[state.threshold]) return el("td", { class: "cell" }, "–");
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
      const known = bins.map((_, bin) => bin).filter((bin) => bins[bin][1 + state.threshold]);
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
        el("td", {}, String(Math.max(...bins.map(([queries]) => queries)))), bins.map((found) => shareCell(found[1 + state.threshold])));
    })))));

  // ---- integrity

  const consistency = () => {
    const cells = cellsShown().filter((c) => c.part === ALL);
    return scroll("Covariances and false fixes by condition", el("table", {},
      el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), el("th", { scope: "col", class: "word" }, "figure"),
        cells.map((c) => el("th", { scope: "col" }, seasonName(c.season))))),
      el("tbody", {}, everyRun().flatMap((run) => {
        const line = (name, text, first) => el("tr", {},
          first ? el("th", { scope: "rowgroup", class: "word", rowspan: 6 }, swatch(run), labelOf(run)) : null,
          el("th", { scope: "row", class: "word" }, name),
          cells.map((c) => {
            const [value, right, ends] = c.runs[run] ? text(c.runs[run]) : ["–", false];
            return el("td", { class: right ? "right" : null }, value, ends ? el("small", {}, ends) : null);
          }));
        const nees = (figure) => (r) => (r.nees ? figure(r.nees) : ["–", false]);
        const share = (value, right) => [`${percent(value)} %`, right, interval(value)];
        const rare = (k) => (r) => (r.summary.integrity[k] ? share(r.summary.integrity[k], r.summary.integrity[k][0] <= 1) : ["–", false]);
        return [
          line("NEES, mean", nees((n) => [neesText(n.mean[0]), n.mean[0] >= 4.5 && n.mean[0] <= 8, neesInterval(n.mean)]), true),
          line("NEES, median", nees((n) => [neesText(n.median), false])),
          line("in the 95 % ellipsoid", nees((n) => share(n.within, n.within[0] >= 93 && n.within[0] <= 97))),
          ...INTEGRITY.map((name, k) => line(name, rare(k))),
        ];
      }))));
  };

  // ---- worst queries

  const inCell = () => {
    const q = track().queries, { conditions, parts } = track();
    const isAsked = cellsShown() === start().cells ? () => true : (k) => everyRun().every((run) => start().runs[run].status[k] !== null);
    return q.name.map((_, k) => k).filter((k) => isAsked(k) && (state.part === ALL || parts[q.part[k]] === state.part)
      && (state.season === SAME ? q.same[k] : state.season === CHANGED ? !q.same[k]
        : NOVELTIES.includes(state.season) ? !q.same[k] && q.novelty[k] === state.season : conditions[q.condition[k]] === state.season));
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

  // Two methods may share fewer courses than the cell has.
  const pairedCourses = (pairs) => {
    const counts = pairs.filter((p) => !p.reason).map((p) => p.courses), least = Math.min(...counts), most = Math.max(...counts);
    return least === most ? courses(least) : `${least} to ${courses(most)}`;
  };
  const paintCell = () => {
    const main = document.getElementById("cell"), c = cell(), runs = withFigures(), pairs = c.pairs[state.threshold];
    const sure = runs.filter((run) => c.runs[run].bounded[state.threshold]);
    forgetCharts(main);
    remember();
    const legendOf = (lines) => legend(labelOf, runs, lines);
    main.replaceChildren(
      el("section", { class: "card" }, el("h2", { id: "where" }, `${track().name}: ${where()}`),
        el("p", { class: "quiet", id: "facts" }, `Start: ${start().words}. ${c.queries} queries of ${courses(c.courses)} over ${places(c.places)}. Intervals and p are by course; [–]: of one course, the interval is unknown.`),
        headline(),
        el("p", { class: "quiet" }, `Surest: sort answers by predicted probability, highest first (or by sigma, smallest first), and accept as many of the first as possible so that fewer than 1 % of them are wrong at ${threshold()}. The figure is the share of all queries that are accepted and right.`)),
      el("div", { class: "grid" },
        card("overview", "All cells", `Recall (%) at ${threshold()}; below each heading the numbers of queries and courses. Scroll sideways for single conditions. Click a figure to show its cell above.`, overview()),
        runs.length > 1 ? el("section", { class: "card", id: "pairs" }, el("h3", {}, "Paired comparison"),
          el("p", { class: "quiet" }, `Change of recall in points at ${threshold()}, ${where()}, query by query; p is two-sided, coloured below 0.05 and not corrected for the number of pairs. `
            + (pairs.some((p) => !p.reason) ? `Intervals are by course (${pairedCourses(pairs)} here); p is from a permutation test that exchanges the methods course by course, and is at least 2 / 2^k with k courses.` : "")),
          pairedTable(everyRun().map(labelOf), (a, b) => pairs.find((p) => p.a === a && p.b === b)),
          pairs.filter((p) => p.reason).map((p) => el("p", { class: "quiet" }, `${labelOf(p.a)} and ${labelOf(p.b)} are not compared: ${p.reason}.`))) : null,
        el("section", { class: "card", id: "difficulty" }, el("h3", {}, "Difficulty"),
          el("p", { class: "quiet" }, `Recall (%) at ${threshold()}, ${where()}, with its interval. Overlap, scale and angle are of the map photograph that sees most of the query; n counts queries.`),
          el("div", { class: "grid" }, data.axes.map((axis, k) => el("div", {}, el("h4", {}, axis.short), el("p", { class: "quiet" }, axis.title), difficulty(k)))), legendOf(true),
          el("details", {}, el("summary", {}, "As a table"), difficultyTable(runs))),
        card("surest", "Surest first", `Percent right at ${threshold()} among the answers with the highest predicted probability or the smallest sigma. Methods that predict neither are left out.`,
          surestChart(labelOf, sure, (run) => c.runs[run].surest[state.threshold]), legend(labelOf, sure, true)),
        card("bounded", "Recall at bounded risk", `Percent of all queries accepted and right at each threshold, where fewer than 1 % of the accepted answers are wrong; ${where()}.`, scroll("Recall at bounded risk", el("table", {},
          el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "word" }, "method"), data.thresholds.map((t) => el("th", { scope: "col" }, t.text)))),
          el("tbody", {}, runs.map((run) => el("tr", {}, el("th", { scope: "row", class: "word" }, swatch(run), labelOf(run)), c.runs[run].bounded.map(shareCell))))))),
        card("consistency", "Integrity", "NEES (squared error normalized by the covariance: 6 in the mean and 5.35 in the median if covariances are right), errors inside the 95 % ellipsoid, false fixes, answers wrong by more than 1 m, and answers worse than the prior that they started from, over all places. Coloured: a mean from 4.5 to 8, 93 to 97 % inside, at most 1 % false or wrong. Intervals are by course.", consistency()),
        card("worst", "Worst queries", `${where()}. First answers with status ok, the largest error on top; then fallback poses, then failures. The last columns show the errors of the other methods.`, el("div", { id: "worst-queries" }))));
    paintWorst();
  };
  const choose = (change) => {
    Object.assign(state, change, { shown: PAGE });
    if (!cell()) state.part = ALL;
    if (!cell()) state.season = cellsShown()[0].season;
    paintControls();
    paintCell();
  };

  const select = (id, label, options, chosen, change) => el("label", { class: "choice" }, el("span", { class: "name" }, label),
    el("select", { id, onchange: (event) => { change(options[Number(event.target.value)][0]); document.getElementById(id).focus(); } },
      options.map(([option, text], k) => el("option", { value: k, selected: option === chosen }, text))));
  const paintControls = () => {
    const t = track(), cells = cellsShown();
    const seasons = [...new Set(cells.map((c) => c.season))];
    const parts = cells.filter((c) => c.season === state.season).map((c) => c.part);
    document.getElementById("controls").replaceChildren(...[
      select("start", "start", t.starts.map((s, k) => [k, s.words]), state.start, (value) => choose({ start: value, sort: null })),
      select("season", "condition", seasons.map((season) => [season, seasonName(season)]), state.season, (value) => choose({ season: value })),
      select("part", "part", parts.map((part) => [part, partName(part)]), state.part, (value) => choose({ part: value })),
      start().shared.length ? group("shared", "queries", [[0, "of each method"], [1, "of all methods"]], state.shared, (value) => { choose({ shared: value }); focusOn("shared", value); }) : null,
      group("threshold", "recall at", data.thresholds.map((t, k) => [k, t.text]), state.threshold, (value) => { choose({ threshold: value }); focusOn("threshold", value); }),
    ].filter(Boolean));
  };

  const measured = (t) => [...new Set(t.queries.dataset)].map((k) => t.datasets[k][0]);
  const results = (t) => (measured(t).length < t.datasets.length && t.starts.length ? `${measured(t).length} of ${places(t.datasets.length)}, ` : "");
  const paintTrack = () => {
    const t = track(), main = document.getElementById("board");
    forgetCharts(main);
    main.replaceChildren(...[
      el("p", { class: "lede" }, t.title),
      t.starts.length ? el("div", { class: "controls", id: "controls" }) : el("p", { class: "note" }, "Nothing is measured on this track yet."),
      results(t) ? el("p", { class: "note", id: "measured" }, `Measured so far: ${results(t)}namely ${measured(t).join(", ")}.`) : null,
      el("div", { id: "cell" }),
      t.cards.length ? el("details", {}, el("summary", {}, `What the authors of submissions state: ${t.cards.length}`), scroll("What the authors of submissions state", el("table", {},
        el("thead", {}, el("tr", {}, ["method", "authors", "start", "description", "trained on", "hardware", "code or paper", "data sets"].map((name) => el("th", {}, name)))),
        el("tbody", {}, t.cards.map((c) => el("tr", {}, [c.method, c.authors, c.start, c.description, c.trained_on, c.hardware || "–",
          c.url ? el("a", { href: c.url, rel: "noopener nofollow" }, c.url) : "–", Object.keys(c.datasets).join(", ")].map((cell) => el("td", {}, cell)))))))) : null,
      t.missing.length ? el("details", {}, el("summary", {}, `Missing results: ${t.missing.length}`), el("ul", {}, t.missing.map((text) => el("li", {}, text)))) : null,
      el("details", {}, el("summary", {}, "Data sets and the SHA-256 digests of their files"), el("pre", {}, t.datasets.map(([name, digest]) => `${name} ${digest || "not rendered yet"}`).join("\n"))),
    ].filter(Boolean));
    if (t.starts.length) choose({});
    document.querySelectorAll("#tracks button").forEach((button, k) => button.setAttribute("aria-current", String(k === state.track)));
  };

  document.getElementById("tracks").append(...data.tracks.map((t, k) => el("button", { type: "button",
    onclick: () => { Object.assign(state, { track: k, start: 0, season: CHANGED, part: ALL, sort: null, run: 0 }); paintTrack(); } },
    t.name, el("small", {}, `${results(t)}${t.queries.name.length} queries, ${t.methods.length} methods, ${t.starts.length} starts`))));
  recall();
  paintTrack();
  document.getElementById("paper").append(...paper());
})();
