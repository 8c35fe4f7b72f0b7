"use strict";
/* From film to case: sources, markers, tracking, synchronisation, fit. The server holds the state. */
const Films = (() => {
  if (!document.getElementById("films")) return null;
  const { element, button } = Charts;
  const { ask, at, busy, complain, duration, narrow, percentage, progressText, sentence, turn, undoable } = Page;
  const COLOURS = ["red", "orange", "yellow", "green", "cyan", "blue", "magenta", "white"];
  const RATES = [30, 60, 120, 240, 480, 960, 1000];
  const SHOWN = { casing: "casing", rotor: "rotor", single: "single body" };
  let project = null, chosen = null, mode = "hub", hub = null, disc = "", picks = [], tracks = null, doubted = null, charted = null,
    drawn = "", timer = null, wantsLaboratory = false, asked = new Set(), latest = 0, sending = 0, ended = false;

  const source = () => project?.sources.find((x) => x.key === chosen) || null;
  const active = (job) => Boolean(job) && (job.state === "waiting" || job.state === "running");

  async function act(path, body) {
    complain(null);
    try {
      const found = await ask(`/api/project/${path}`, body);
      if (found.sources) render(found);
      return found;
    } catch (error) {
      complain(error);
      return null;
    }
  }

  async function refresh() {
    if (ended) return;
    clearTimeout(timer);
    try { render(await ask("/api/project")); } catch (error) { complain(error); }
  }

  /* --- display --- */

  function render(found) {
    const before = project;
    project = found;
    at("folder").textContent = project.folder;
    at("samples").hidden = !project.samples || project.sources.length > 0;
    at("listed").hidden = project.available.length === 0;
    same(at("available"), project.available.join("\n"), () => project.available.map((name) => button(name, `add ${name}`, () => act("add", { name }))));
    cards();
    tracking();
    fields();
    steps();
    if (!source() && project.sources.length) choose(project.sources.find((x) => x.kind === "film")?.key || null);
    else if (!source()) choose(null);
    else film(before);
    undoable("films", project);
    same(at("removed"), JSON.stringify(project.removed), () => project.removed.map((x) => button(`restore ${x.name}`, `restore ${x.name}`, () => act("restore", { key: x.key }))));
    at("removed-list").hidden = project.removed.length === 0;
    const stopped = sending ? [] : project.uploads;
    at("stopped-list").hidden = stopped.length === 0;
    same(at("stopped"), JSON.stringify(stopped), () => stopped.map((u) => element("li", {}, `${u.name}: ${Math.floor(100 * u.share)} % `, button("discard", `discard the part of ${u.name} that has arrived`, () => act("discard", { key: u.key })))));
    const working = Object.values(project.jobs).some(active) || project.sources.some((x) => Object.values(x.jobs).some(active));
    clearTimeout(timer);
    if (working) timer = setTimeout(refresh, 300);
    whole();
    moving(working);
    if (wantsLaboratory && !working && !project.analysing) {
      wantsLaboratory = false;
      if (project.can_open) open();
    }
  }

  /* all work of the project as one line in the header */
  function whole() {
    const films = project.sources.filter((x) => active(x.jobs.track)), step = ["match", "fit"].find((k) => active(project.jobs[k]));
    if (films.length) {
      const all = project.sources.filter((x) => x.kind === "film"), total = all.reduce((n, x) => n + (x.jobs.track?.total || x.info.frames || 0), 0);
      const done = all.reduce((n, x) => n + (active(x.jobs.track) ? x.jobs.track.done : x.is_current ? x.jobs.track?.total || x.info.frames || 0 : 0), 0);
      const seconds = Math.max(...films.map((x) => x.jobs.track.seconds || 0));
      busy("project", { done, total, seconds }, films.length > 1 ? "tracking the films" : `tracking ${films[0].name}`, () => { wantsLaboratory = false; act("cancel", { step: "all" }); });
    } else if (step) busy("project", { ...project.jobs[step], expected: project.seconds[step] || USUAL[step] }, step === "match" ? "synchronising" : "fitting", () => { wantsLaboratory = false; act("cancel", { step }); });
    else busy("project", null);
  }

  /* angle and speed of all films, which grow while they are tracked */
  async function moving(working) {
    if (document.body.dataset.part !== "films") return;
    if (charted?.waiting) { charted.again = true; return; }
    const key = JSON.stringify([project.revision, working ? project.sources.map((x) => x.jobs.track?.angles || 0) : 0]);
    if (key === drawn) return;
    drawn = key;
    charted = { ...charted, waiting: true };
    try {
      const found = await ask("/api/project/motion");
      at("no-motion").hidden = found.charts.length > 0;
      at("motion-board").hidden = found.charts.length === 0;
      if (found.charts.length) {
        if (!charted.board) charted.board = new Charts.Board(at("motion-board"), found, { click: seek, height: () => narrow() ? 190 : (moving_.clientHeight - 90 - [...moving_.querySelectorAll(".head")].reduce((sum, h) => sum + h.offsetHeight, 0)) / 2 - 14 });
        else charted.board.set(found);
      }
    } catch (error) { complain(error); }
    charted.waiting = false;
    if (charted.again) { charted.again = false; moving(working); }
  }

  const moving_ = at("moving");
  const USUAL = { match: 6, fit: 8, preview: 6 };  // seconds, before a step has been run in this folder

  const offset = () => (project.is_matched && project.match.clips?.find((c) => c.name === source()?.name)?.offset_s) || 0;
  function seek(time) {
    const x = source();
    if (x?.kind === "film" && x.capture_fps && !tracks) { film_.stop(); film_.show(Math.round((time - offset()) * x.capture_fps)); }
  }

  /* replace the children only if they have changed, to keep the focus */
  function same(root, key, make) {
    if (root.dataset.shows === key) return;
    root.dataset.shows = key;
    root.replaceChildren(...make());
  }

  function cards() {
    const known = new Map([...at("sources").children].map((c) => [c.dataset.key, c]));
    for (const [key, card] of known) if (!project.sources.some((x) => x.key === key)) card.remove();
    for (const x of project.sources) {
      const card = known.get(x.key) || build(x);
      const get = (name) => card.querySelector(`[data-name=${name}]`);
      card.classList.toggle("now", x.key === chosen);
      if (document.activeElement !== get("body")) get("body").value = x.body;
      const rate = get("rate");
      if (rate) {
        if (document.activeElement !== rate) rate.value = x.capture_fps ?? "";
        get("from").textContent = x.capture_fps ? x.rate_from : "";
        get("rates").hidden = Boolean(x.capture_fps);
      }
      get("facts").textContent = facts(x);
      get("facts").classList.toggle("fault", Boolean(x.info.error));
      if (x.kind === "table") {
        same(get("reading"), JSON.stringify([x.reading, x.jobs.read?.state]), () => reading(x));
        if (!x.jobs.read && !asked.has(x.key)) { asked.add(x.key); act("read", { key: x.key }); }
      }
    }
  }

  function facts(x) {
    const i = x.info;
    if (i.error) return sentence(i.error);
    if (x.kind !== "film") return x.kind === "table" ? "table of angles, rates or points" : "recording";
    return [`${i.width} \u00d7 ${i.height} px`, i.frames ? `${i.frames} frames` : "", i.container_fps ? `stored at ${Number(i.container_fps.toPrecision(5))} fps` : ""].filter(Boolean).join(", ");
  }

  /* what each column of a table is taken for, and the speeds */
  function reading(x) {
    const job = x.jobs.read;
    if (active(job)) return [element("p", { class: "soft" }, "reading \u2026")];
    if (job && job.state === "failed") return [element("p", { class: "fault" }, sentence(job.message))];
    const head = element("tr", {}, ...["column", "taken for", "unit", "because"].map((t) => element("th", { scope: "col" }, t)));
    return (x.reading.reading || []).flatMap((r) => [
      element("table", { "aria-label": `reading of ${x.name}` }, element("thead", {}, head.cloneNode(true)), element("tbody", {},
        ...r.columns.map((c) => element("tr", {}, element("th", { scope: "row" }, c.column), ...[c.quantity, c.unit, c.why].map((t) => element("td", {}, t)))),
        ...r.left_out.map((n) => element("tr", { class: "soft" }, element("th", { scope: "row" }, n), element("td", {}, "left out"), element("td"), element("td"))))),
      element("p", { class: "soft" }, `${r.format}, ${r.rows} rows`),
    ]).concat((x.reading.plot || []).map(sketch));
  }

  /* a small plot of a speed */
  function sketch(p) {
    const make = (name, values) => { const e = document.createElementNS("http://www.w3.org/2000/svg", name); for (const [k, v] of Object.entries(values)) e.setAttribute(k, v); return e; };
    const [t0, t1] = [p.time[0], p.time[p.time.length - 1]], low = Math.min(0, ...p.omega), high = Math.max(0, ...p.omega);
    const at_ = (t, w) => `${(300 * (t - t0) / (t1 - t0 || 1)).toFixed(1)},${(60 - 60 * (w - low) / (high - low || 1)).toFixed(1)}`;
    const text = `speed of the ${p.body}, ${Math.min(...p.omega).toPrecision(4)} to ${Math.max(...p.omega).toPrecision(4)} rad/s, ${t0.toPrecision(4)} to ${t1.toPrecision(4)} s`;
    const svg = make("svg", { viewBox: "-2 -2 304 64", width: 304, height: 64, role: "img", "aria-label": text });
    svg.append(make("polyline", { points: `${at_(t0, 0)} ${at_(t1, 0)}`, fill: "none", stroke: "currentColor", "stroke-opacity": 0.3 }),
      make("polyline", { points: p.time.map((t, i) => at_(t, p.omega[i])).join(" "), fill: "none", stroke: "currentColor", "stroke-width": 1.5 }));
    return element("figure", { class: "sketch" }, svg, element("figcaption", { class: "soft" }, text));
  }

  function build(x) {
    const id = `source-${x.key}`;
    const body = element("select", { id: `${id}-body`, "data-name": "body" }, element("option", { value: "" }, "choose \u2026"),
      ...Object.entries(SHOWN).map(([value, text]) => element("option", { value }, text)));
    body.addEventListener("change", () => act("set", { key: x.key, name: "body", value: body.value }));
    const name = button(x.name, `show ${x.name}`, () => choose(x.key));
    name.className = "name";
    const card = element("li", { "data-key": x.key, class: "card" }, element("span", { class: "first" }, name, element("span", { class: "soft", "data-name": "facts" }),
      button("remove", `remove ${x.name}`, () => act("remove", { key: x.key }))),
      element("span", { class: "entry" }, element("label", { for: `${id}-body` }, "body"), body));
    if (x.kind === "film") {
      const rate = element("input", { type: "number", id: `${id}-rate`, "data-name": "rate", min: "0", step: "any", size: 7 });
      rate.addEventListener("change", () => act("set", { key: x.key, name: "capture_fps", value: rate.value }));
      const set = (value) => act("set", { key: x.key, name: "capture_fps", value: String(value) });
      const stored = x.info.container_fps, rates = element("span", { class: "chips", "data-name": "rates" });
      if (stored) rates.append(button(`${Number(stored.toPrecision(6))} (stored rate)`, `${x.name}: capture rate equals the stored rate`, () => set(stored)));
      for (const r of RATES) if (r !== stored) rates.append(button(String(r), `${x.name}: capture rate ${r} fps`, () => set(r)));
      card.append(element("span", { class: "entry" }, element("label", { for: `${id}-rate` }, "capture rate [fps]"), rate, element("span", { class: "soft", "data-name": "from" })), rates);
    }
    if (x.kind === "table") card.append(element("div", { class: "reading", "data-name": "reading" }));
    at("sources").append(card);
    return card;
  }

  function tracking() {
    const films = project.sources.filter((x) => x.kind === "film");
    const known = new Map([...at("tracking").children].map((c) => [c.dataset.key, c]));
    for (const [key, row] of known) if (!films.some((x) => x.key === key)) row.remove();
    for (const x of films) {
      let row = known.get(x.key);
      if (!row) {
        const stop = button("Cancel", `cancel tracking ${x.name}`, () => act("cancel", { step: `track:${x.key}` }));
        stop.dataset.name = "cancel";
        const again = button("Track again", `track ${x.name} again`, () => act("track", { key: x.key }));
        again.dataset.name = "again";
        row = element("li", { "data-key": x.key }, element("span", { class: "name" }, x.name),
          element("progress", { "data-name": "bar", "aria-label": `progress of ${x.name}`, max: "1", value: "0" }), element("span", { "data-name": "state", role: "status" }), stop, again,
          element("ul", { class: "warnings", "data-name": "warnings" }));
        at("tracking").append(row);
      }
      const get = (name) => row.querySelector(`[data-name=${name}]`), job = x.jobs.track, busy = active(job);
      get("bar").hidden = !busy;
      if (busy && job.total) get("bar").value = job.done / job.total; else get("bar").removeAttribute("value");
      get("cancel").hidden = !busy;
      get("again").hidden = busy || !x.body || !(x.is_current || (job && job.state !== "done"));
      get("again").textContent = x.can_continue ? "Continue" : "Track again";
      get("state").textContent = status(x, job);
      get("state").className = job?.state === "failed" ? "fault" : x.is_current ? "fine" : "soft";
      const warnings = x.is_current ? x.result.warnings || [] : [];
      same(get("warnings"), warnings.join("\n"), () => warnings.map((w) => element("li", {}, sentence(w))));
    }
    at("track").disabled = project.missing.track.length > 0 || !films.some((x) => !x.is_current && !active(x.jobs.track));
    at("track").textContent = films.some((x) => x.can_continue && !x.is_current && !active(x.jobs.track)) ? "Continue tracking" : films.length > 1 ? "Track the films" : "Track the film";
    at("step-track").hidden = films.length === 0 && project.sources.length > 0;
  }

  function status(x, job) {
    if (active(job)) {
      if (job.state === "waiting") return "waiting for a free core";
      return job.total ? `${Math.round(100 * job.done / job.total)} %, ${job.done} of ${job.total} frames, ${job.seconds.toFixed(0)} s` : `${job.label || "starting"} \u2026 ${job.seconds.toFixed(0)} s`;
    }
    if (job?.state === "failed") return sentence(job.message);
    if (x.is_current && x.result.motion) return motion(x.result);
    if (x.is_current) return Object.entries(x.result.body).map(([name, b]) => `${name}: ${b.samples} angles of ${x.result.frames} frames, \u00b1${(1e3 * b.median_sigma).toPrecision(2)} mrad`).join("; ");
    if (x.can_continue) return "interrupted; continues from a checkpoint";
    if (job?.state === "cancelled") return "cancelled";
    return x.result.frames ? "settings were changed after tracking" : "not tracked yet";
  }

  function motion(result) {
    const m = result.motion, value = (v, unit) => `${Charts.uncertain(v.value, v.stderr)} ${unit}`;
    const facts = m.kind === "oscillation" ? `period ${value(m.period, "s")}` : `mean ${value(m.omega_mean, "rad/s")}, angular acceleration ${value(m.alpha, "rad/s\u00b2")}`;
    return [`${m.kind}, ${m.turns.toFixed(2)} turns: ${facts}.`, result.sentence].filter(Boolean).join(" ");
  }

  function fields() {
    for (const [name, value] of Object.entries(project.fields)) {
      const input = at(name);
      if (document.activeElement !== input) input.value = value;
      const read = at(`read-${name}`), found = project.inertias[name];
      if (read) {
        read.textContent = found.error || (found.value && `= ${found.value}`);
        read.classList.toggle("fault", Boolean(found.error));
      }
    }
    const single = project.route === "single";
    for (const p of document.querySelectorAll("[data-route]")) p.hidden = (p.dataset.route === "single") !== single;
    at("surface").parentElement.hidden = single;
    // the command that tracks a single body needs the inertia
    const order = single ? ["sources", "match", "track", "fit"] : ["sources", "track", "match", "fit"];
    order.forEach((name, n) => { at(`step-${name}`).querySelector(".number").textContent = String(n + 1); });
    if (single) at("step-sources").after(at("step-match")); else at("step-track").after(at("step-match"));
    at("match-title").textContent = single ? "Inertia" : project.route === "import" ? "Inertias" : "Synchronisation and inertias";
    at("match").textContent = single ? "Measure the motion" : project.route === "import" ? "Create the case" : "Synchronise the clips";
    at("match").hidden = single && project.sources.some((x) => x.kind === "film");
  }

  function steps() {
    const single = project.route === "single";
    same(at("missing-track"), project.missing.track.join("\n"), () => project.sources.length ? project.missing.track.map((t) => element("li", {}, t)) : []);
    const why = project.missing.track.length ? [] : project.missing.match;
    same(at("missing-match"), why.join("\n"), () => why.map((t) => element("li", {}, t)));
    for (const step of ["match", "fit"]) {
      const job = project.jobs[step], running = active(job);
      at(`cancel-${step}`).hidden = !running;
      at(`busy-${step}`).textContent = running ? progressText({ ...job, expected: project.seconds[step] || USUAL[step] }, job.label || (step === "match" ? "synchronising" : "fitting"))
        : job?.state === "failed" ? sentence(job.message) : step === "match" && project.is_matched && project.case ? `written: ${project.case}` : "";
      at(`busy-${step}`).className = job?.state === "failed" ? "fault" : "soft";
    }
    at("match").disabled = project.missing.match.length > 0 || active(project.jobs.match);
    at("fit").disabled = !project.is_matched || (single && !project.can_open) || active(project.jobs.fit) || active(project.jobs.match);
    at("fit").textContent = project.can_open || single ? "Open the laboratory" : "Fit and open the laboratory";
    at("tab-laboratory").disabled = !project.can_open;
    for (const step of ["track", "match", "fit"]) {
      const lines = [project.commands[step]].flat().join("\n");
      at(`command-${step}`).textContent = lines;
      at(`command-${step}`).parentElement.hidden = !lines;
    }
    at("fit-text").textContent = single ? (project.is_matched && !project.can_open ? "No torque law was fitted; see the warnings above."
      : "The motion is fitted and diagnosed; the laboratory shows the lack of fit and tests all candidate effects.")
      : "The reduced model of the paper is fitted; the laboratory then shows its lack of fit and tests all candidate effects.";
    clocks();
    at("next").textContent = guide();
    const ready = project.sources.length > 0 && !project.missing.track.length, working = Object.values(project.jobs).some(active) || project.sources.some((x) => active(x.jobs.track));
    at("analyse").disabled = !ready || working;
    at("analyse").textContent = project.can_open ? "Open the laboratory" : "Analyse everything";
    at("analyse-text").hidden = project.can_open;
    at("analyse").parentElement.hidden = project.sources.length === 0 || (single && project.is_matched && !project.can_open);
    at("analyse-text").textContent = project.missing.match.some((t) => t.includes("inertia")) && !single ? "Track and synchronise; enter both moments of inertia in step 3 meanwhile." : `Track${single ? "" : ", synchronise"} and fit, then open the laboratory.`;
    const done = { sources: !project.missing.track.length, track: project.sources.length > 0 && project.sources.every((x) => x.is_current), match: project.is_matched, fit: project.can_open };
    for (const [name, value] of Object.entries(done)) at(`step-${name}`).classList.toggle("done", value);
  }

  /* instruction for the next step */
  function guide() {
    const films = project.sources.filter((x) => x.kind === "film"), busy = Object.values(project.jobs).some(active) || films.some((x) => active(x.jobs.track));
    if (busy) return "Running; the page may be closed in the meantime.";
    if (!project.sources.length) return project.samples ? "Add the films of one run, or use the sample clips: four films with their study.toml." : "Add the films of one run.";
    if (project.missing.track.length) return `Next: ${project.missing.track[0]}`;
    if (films.some((x) => !x.is_current)) {
      return "Next: press \u201cAnalyse everything\u201d, or first select a film and preview its tracking.";
    }
    if (!project.is_matched) return project.missing.match.length ? `Next: ${project.missing.match[0]}` : "Next: synchronise the clips. The casing, which all cameras see, determines the start of each film.";
    return project.can_open ? "Next: open the laboratory." : project.route === "single" ? "The motion is measured; no torque law could be fitted. The reasons stand below the angles." : "Next: fit. The laboratory then shows the lack of fit and the candidate effects.";
  }

  /* the clips on the clock of the casing camera */
  function clocks() {
    const clips = project.is_matched ? project.match.clips || [] : [];
    at("clocks").hidden = clips.length === 0;
    same(at("clocks"), JSON.stringify(clips), () => {
      const known = clips.filter((c) => c.duration_s !== null);
      const first = Math.min(0, ...known.map((c) => c.offset_s)), last = Math.max(1e-9, ...known.map((c) => c.offset_s + c.duration_s));
      return clips.map((c) => {
        const bar = element("span", { class: "span", "aria-hidden": "true" });
        bar.style.marginLeft = `${100 * (c.offset_s - first) / (last - first)}%`;
        bar.style.width = `${Math.max(0.5, 100 * (c.duration_s || 0) / (last - first))}%`;
        const text = c.rate === undefined ? "reference clock"
          : `starts at ${Charts.uncertain(c.offset_s, c.offset_sigma_s)} s; clock error ${Charts.uncertain(1e6 * (c.rate - 1), 1e6 * c.rate_sigma)} ppm; rms difference of the casing angles ${(1e3 * c.misfit_rad).toPrecision(2)} mrad${c.ambiguous ? "; AMBIGUOUS: the start is not unique" : ""}`;
        return element("div", { class: "clock" }, element("b", {}, c.name), element("span", { class: "line" }, bar), element("span", { class: c.ambiguous ? "fault" : "soft" }, text));
      });
    });
  }

  /* --- one film: hub and markers --- */

  const film_ = new FilmView(at("marker"), {
    key: () => chosen,
    label: (n) => `frame ${n} of ${source()?.name || ""}; arrow keys move the cross, Enter marks hub or marker`,
    time: (n) => { const x = source(); return x?.capture_fps ? n / x.capture_fps : NaN; },
    rate: () => source()?.capture_fps || 25,
    visible: () => document.body.dataset.part === "films" && !document.hidden,
    get loop() { return Boolean(tracks); },
    async picture(n) {
      const blob = await ask(`/api/project/frame?key=${encodeURIComponent(chosen)}&index=${n}`);
      return { image: await createImageBitmap(blob), size: blob.size2 };
    },
    async marks(n) {
      const x = source();
      if (!x || tracks || !x.is_current || x.body === "single") return null;
      const found = await ask(`/api/project/tracked?key=${encodeURIComponent(chosen)}&index=${n}`);
      return found.markers ? found : null;
    },
    extra(n) {
      if (tracks && n < tracks.frames) return { centre: tracks.centre[n], markers: tracks.markers.map((m) => ({ name: m.name, place: m.place[n], whole: m.whole[n], corners: m.corners?.[n] })) };
      if (tracks || n > 0 || source()?.is_current) return null;
      return { centre: hub, markers: picks.map((p) => ({ name: p.name, place: [p.x, p.y], picked: true })) };
    },
    drawn: (marks) => { listed(marks); if (charted?.board && source()?.capture_fps) charted.board.setCursor(offset() + film_.index / source().capture_fps); },
    picked: (place) => {
      if (correcting()) { if (film_.running) film_.stop(); else correct(place); return; }
      if (film_.running || film_.index !== 0) { film_.stop(); tracks = null; film_.open(frames(), 0, film_.size); return; }
      set(place);
    },
  });
  at("legend-still").append(...FilmView.legend());

  const frames = () => (tracks ? tracks.frames : source()?.result?.frames || source()?.info.frames || 1);

  function choose(key) {
    film_.stop();
    chosen = key;
    tracks = null;
    at("sources").querySelectorAll(".card").forEach((c) => c.classList.toggle("now", c.dataset.key === key));
    const x = source(), shown = Boolean(x) && x.kind === "film" && !x.info.error;
    at("marker").hidden = !shown;
    at("nothing").hidden = shown;
    at("h-marking").textContent = shown ? `Film: ${x.name}` : "Film";
    doubt(null);
    at("corrected").textContent = "";
    if (!shown) return;
    hub = x.hub; picks = x.picks.map((p) => ({ ...p })); disc = x.disc;
    mode = hub ? "casing" : "hub";
    modes();
    corrections();
    listed(null);
    rows();
    film(null);
    film_.open(frames(), 0, [x.info.width || 4, x.info.height || 3]);
    if (x.jobs.preview?.state === "done" && !x.is_current) followed();
  }

  function film(before) {
    const x = source();
    if (!x || x.kind !== "film") return;
    const job = x.jobs.preview, was = before?.sources.find((o) => o.key === x.key);
    if (was && (was.body !== x.body || was.is_current !== x.is_current)) {
      modes();
      if (x.is_current) { tracks = null; film_.open(frames(), film_.index, film_.size); }
    }
    // changed in another tab, or undone
    if (was && JSON.stringify([x.picks, x.hub, x.disc]) !== JSON.stringify([was.picks, was.hub, was.disc])) {
      hub = x.hub; picks = x.picks.map((p) => ({ ...p })); disc = x.disc;
      rows();
      film_.draw();
    }
    if (was && was.is_current && x.is_current && JSON.stringify(was.result.warnings) !== JSON.stringify(x.result.warnings)) film_.show(film_.index);
    const names = ["", ...new Set([...(project.profiles || []), x.profile].filter(Boolean))];
    same(at("profile-of"), names.join("\n"), () => names.map((n) => element("option", { value: n }, n || "markers of the paper (red disc; red, blue, white, green)")));
    at("profile-of").value = x.profile;
    at("profile-of").parentElement.hidden = x.body === "single";
    at("find").hidden = x.body === "single";
    at("find").disabled = active(x.jobs.profile);
    at("command-film").textContent = x.command || "Choose the body first.";
    if (x.jobs.profile?.state === "failed" && active(was?.jobs.profile)) complain(new Error(sentence(x.jobs.profile.message)));
    if (active(job)) { at("followed").textContent = progressText({ ...job, expected: project.seconds.preview || USUAL.preview }, "tracking the first frames"); at("followed").className = "soft"; }
    else if (active(x.jobs.profile)) { at("followed").textContent = progressText({ ...x.jobs.profile, expected: project.seconds.profile || USUAL.preview }, "searching for markers"); at("followed").className = "soft"; }
    else if (job?.state === "failed") { at("followed").textContent = sentence(job.message); at("followed").className = "fault"; if (active(was?.jobs.preview)) { tracks = null; film_.draw(); } }
    else if (job?.state === "done" && active(was?.jobs.preview)) followed();
    else if (!job) { at("followed").textContent = x.is_current ? "" : x.body === "single" ? "The first frame. The hub is found automatically; click on it if another one is meant." : "The first frame. Mark hub and markers here if they are not those of the paper."; at("followed").className = "soft"; }
  }

  async function followed() {
    const mine = ++latest, key = chosen, found = await act(`preview?key=${encodeURIComponent(key)}`);
    if (mine !== latest || key !== chosen || !found || !found.frames) return;
    tracks = found;
    const kept = Object.entries(found.kept).map(([name, k]) => `${source().body === "single" ? "body" : name} in ${Math.round(100 * k)} % of ${found.frames} frames, \u00b1${found.sigma_mrad[name].toPrecision(2)} mrad`);
    at("followed").textContent = [`Tracked: ${kept.join("; ")}.`, ...found.warnings.map(sentence)].join(" ");
    at("followed").className = Object.values(found.kept).every((k) => k > 0.8) ? "fine" : "fault";
    await film_.open(found.frames, 0, film_.size);
    film_.play();
  }

  function modes() {
    const single = source().body === "single", result = source().is_current && source().result.markers;
    const correct = !single && result ? Object.keys(result).map((m) => [`correct:${m}`, `correction of ${m}`]) : [];
    const options = single ? [["hub", "hub"], ["casing", "point to follow"]] : [["hub", "hub"], ["casing", "marker on the casing"], ["rotor", "marker on the rotor"], ...correct];
    if (!options.some(([v]) => v === mode)) mode = "hub";
    at("modes").replaceChildren(element("legend", {}, "A click marks"), ...options.map(([value, text]) => {
      const radio = element("input", { type: "radio", name: "mode", value, id: `mode-${value}` });
      radio.checked = value === mode;
      radio.addEventListener("change", () => {
        mode = value;
        doubt(null);
        corrections();
        if (correcting() && tracks) { tracks = null; film_.open(frames(), film_.index, film_.size); }
      });
      return element("span", {}, radio, element("label", { for: `mode-${value}` }, text));
    }));
  }

  const correcting = () => mode.startsWith("correct:") ? mode.slice(8) : "";

  function corrections() {
    at("correcting").hidden = !correcting();
    at("lost").textContent = `${correcting()} is not visible in this frame`;
  }

  /* manual correction of a marker in one frame, which stays in view */
  async function correct(place, confirmed = false) {
    const frame = film_.index, marker = correcting();
    doubt(null);
    const found = await act("correct", { key: chosen, marker, index: frame, place, confirmed });
    if (!found) return;
    if (found.jump_deg !== undefined) { doubt({ place, frame, marker, jump: found.jump_deg }); return; }
    at("corrected").textContent = `Frame ${frame}: ${marker} ${place ? "corrected" : "marked as not visible"}. Synchronise the clips again when you have finished.`;
    await film_.show(frame);
  }

  function doubt(found) {
    doubted = found;
    at("doubt").hidden = !found;
    if (found) at("doubt-text").textContent = `This position of ${found.marker} is ${Math.abs(found.jump).toFixed(0)}\u00b0 away from where the neighbouring frames put it.`;
  }

  /* the corrections of the film that is shown */
  function listed(marks) {
    const rows_ = marks?.corrections || [], box = at("corrections-box");
    box.hidden = rows_.length === 0;
    film_.setTicks(rows_.map((c) => c.frame));
    same(at("corrections"), JSON.stringify([chosen, rows_]), () => rows_.map((c) => element("li", {},
      element("span", {}, `frame ${c.frame}: ${c.marker}${c.lost ? ", not visible" : ""}`),
      button("show", `show frame ${c.frame}`, () => { film_.stop(); film_.show(c.frame); }),
      button("delete", `delete the correction of ${c.marker} in frame ${c.frame}`, async () => {
        if (await act("uncorrect", { key: chosen, marker: c.marker, index: c.frame })) { at("corrected").textContent = ""; await film_.show(film_.index); }
      }))));
  }

  function rows() {
    const list = picks.map((p, n) => {
      const name = element("input", { type: "text", size: 8, maxlength: 40, "aria-label": `name of marker ${n + 1}` });
      name.value = p.name;
      name.addEventListener("change", () => { p.name = name.value; mark(); });
      const pick = (label, values, field) => {
        const out = element("select", { "aria-label": label }, ...values.map((v) => element("option", { value: v }, v)));
        out.value = p[field];
        out.addEventListener("change", () => { p[field] = out.value; mark(); });
        return out;
      };
      const parts = source().body === "single" ? [] : [name, pick(`colour of marker ${n + 1}`, COLOURS, "colour"), pick(`body of marker ${n + 1}`, ["casing", "rotor"], "body")];
      return element("li", {}, `${n + 1}`, ...parts, button("remove", `remove marker ${n + 1}`, () => { picks.splice(n, 1); rows(); mark(); }));
    });
    if (hub) list.unshift(element("li", {}, `hub at (${hub[0].toFixed(0)}, ${hub[1].toFixed(0)}) px${disc ? `, a ${disc} disc` : ""}`, button("remove", "remove the hub", () => { hub = null; disc = ""; rows(); mark(); })));
    at("picks").replaceChildren(...list);
  }

  async function set(place) {
    const found = await act("colour", { key: chosen, index: film_.index, x: place[0] / film_.size[0], y: place[1] / film_.size[1] });
    if (!found) return;
    if (mode === "hub") {
      hub = place;
      disc = found.colour === "white" ? "" : found.colour;
      mode = "casing";
      modes();
    } else {
      const colour = found.colour || "white", taken = picks.map((p) => p.name);
      let name = colour;
      for (let k = 2; taken.includes(name); k++) name = `${colour}_${k}`;
      picks.push({ x: place[0], y: place[1], name, colour, body: source().body === "single" ? "casing" : mode });
    }
    rows();
    film_.draw();
    mark();
  }

  /* store the clicked positions and preview the tracking if they suffice */
  async function mark() {
    tracks = null;
    film_.stop();
    await act("mark", { key: chosen, hub, picks, disc });
    if (!picks.length) at("followed").textContent = hub ? "Now click on the markers." : "";
    film_.open(frames(), 0, film_.size);
  }

  /* --- upload --- */

  async function send(files) {
    const list = [...files].sort((a, b) => (a.name === "study.toml") - (b.name === "study.toml"));
    for (const file of list) {
      sending++;
      await upload(file);
      sending--;
    }
  }

  /* upload a file with its progress; it can be cancelled, continues by itself after an interruption, and where it
   * stopped if the same file is chosen again, also after a restart */
  async function upload(file) {
    complain(null);
    const words = `name=${encodeURIComponent(file.name)}&size=${file.size}&modified=${file.lastModified}`;
    let cancelled = false, request = null;
    const stop = () => { cancelled = true; request?.abort(); };
    for (let attempt = 0; attempt < ATTEMPTS && !cancelled; attempt++) {
      if (attempt) {
        busy("upload", { seconds: 0 }, `connection lost, ${file.name} continues`, stop);
        await new Promise((done) => setTimeout(done, Math.min(8000, 500 * 2 ** attempt)));
      }
      let known;
      try { known = await ask(`/api/project/uploaded?${words}`); } catch (error) {
        if (error.message.startsWith("No answer") && attempt + 1 < ATTEMPTS) continue;
        busy("upload", null);
        complain(error);
        return;
      }
      const offset = await same_(file, known) ? known.received : 0;
      const answer = await part(file, offset, `${words}&offset=${offset}`, (r) => { request = r; if (cancelled) r.abort(); }, stop);
      if (!answer) continue;
      busy("upload", null);
      if (answer.error) complain(new Error(`${sentence(answer.error.message)} ${answer.error.hint}`)); else render(answer);
      return;
    }
    busy("upload", null);
    if (!cancelled) complain(new Error(`The upload of ${file.name} was interrupted. Choose the file again: it continues where it stopped.`));
    refresh();
  }

  const ATTEMPTS = 6;

  /* whether the last bytes that have arrived are those of the file */
  async function same_(file, known) {
    if (!known.received) return false;
    const tail = await file.slice(known.received - known.tail, known.received).arrayBuffer();
    const sum = new Uint8Array(await crypto.subtle.digest("SHA-256", tail));
    return [...sum].map((b) => b.toString(16).padStart(2, "0")).join("") === known.sha256;
  }

  /* send a file from a byte on; null if the connection was lost */
  function part(file, offset, words, begun, cancel) {
    return new Promise((done) => {
      const request = new XMLHttpRequest(), began = performance.now();
      const show = (loaded) => busy("upload", { done: offset + loaded, total: file.size, seconds: (performance.now() - began) / 1000 }, `uploading ${file.name}`, cancel);
      request.open("POST", `/api/project/upload?${words}`);
      request.upload.addEventListener("progress", (event) => show(event.loaded));
      request.addEventListener("loadend", () => { try { done(JSON.parse(request.responseText)); } catch { done(null); } });
      begun(request);
      show(0);
      request.send(file.slice(offset));
    });
  }

  async function open() {
    film_.stop();
    turn("laboratory");
    busy("open", { seconds: 0 }, "opening the laboratory");
    const found = await act("open", {});
    busy("open", null);
    if (!found) { turn("films"); return; }
    at("tab-laboratory").disabled = false;
    Laboratory.start();
  }

  Page.listen((news) => {
    const p = news.project;
    if (p && project && p.revision !== project.revision && !sending) refresh();
    return Boolean(p && Object.keys(p.jobs).length);
  });

  at("choose").addEventListener("change", async () => { await send(at("choose").files); at("choose").value = ""; });
  const drop = at("drop");
  for (const name of ["dragenter", "dragover"]) document.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
  for (const name of ["dragleave", "drop"]) document.addEventListener(name, (event) => { event.preventDefault(); drop.classList.remove("over"); });
  document.addEventListener("drop", (event) => { if (event.dataTransfer?.files.length) { turn("films"); send(event.dataTransfer.files); } });
  at("samples").addEventListener("click", () => act("samples", {}));
  at("track").addEventListener("click", () => act("track", {}));
  at("match").addEventListener("click", () => act("match", {}));
  at("fit").addEventListener("click", () => {
    if (project.can_open) { open(); return; }
    wantsLaboratory = true;
    act("fit", {});
  });
  for (const step of ["match", "fit"]) at(`cancel-${step}`).addEventListener("click", () => { wantsLaboratory = false; act("cancel", { step }); });
  for (const name of ["inertia_rotor", "inertia_casing", "inertia", "label", "surface", "body_name"]) at(name).addEventListener("change", () => act("set", { name, value: at(name).value }));
  at("analyse").addEventListener("click", () => { if (project.can_open) { open(); return; } wantsLaboratory = true; act("analyse", {}); });
  at("follow").addEventListener("click", () => act("follow", { key: chosen }));
  at("find").addEventListener("click", () => act("find", { key: chosen }));
  at("clear").addEventListener("click", () => { picks = []; hub = null; disc = ""; mode = "hub"; modes(); rows(); mark(); });
  at("profile-of").addEventListener("change", async () => { await act("set", { key: chosen, name: "profile", value: at("profile-of").value }); tracks = null; act("follow", { key: chosen }); });
  at("lost").addEventListener("click", () => correct(null));
  at("doubt-keep").addEventListener("click", () => { const d = doubted; if (d && d.frame === film_.index) correct(d.place, true); else doubt(null); });
  at("doubt-drop").addEventListener("click", () => doubt(null));
  at("tab-films").addEventListener("click", () => { Laboratory.stop(); turn("films"); refresh(); });
  at("tab-laboratory").addEventListener("click", open);
  document.body.addEventListener("ended", () => { ended = true; clearTimeout(timer); });
  document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });
  document.addEventListener("keydown", (event) => {
    if (document.body.dataset.part !== "films" || at("marker").hidden || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("input:not([type=range]), select, textarea")) return;
    const acts = { ",": () => film_.step(-1), ".": () => film_.step(1) };
    if (event.key === " " && !event.target.closest("button, summary, a, input")) { event.preventDefault(); at("run").click(); }
    else if (acts[event.key]) { event.preventDefault(); acts[event.key](); }
  });
  at("error-close").addEventListener("click", () => complain(null));
  (async () => {
    const wanted = location.hash.slice(1);
    await refresh();
    if (wanted === "films") turn("films");
    else if (wanted === "laboratory" && project?.can_open && document.body.dataset.case === undefined) open();
    else turn(document.body.dataset.part);
  })();
  const again = (name) => { at("corrected").textContent = ""; doubt(null); return act(name, {}); };
  return { undo: () => again("undo"), redo: () => again("redo"), act, project: () => project };
})();
