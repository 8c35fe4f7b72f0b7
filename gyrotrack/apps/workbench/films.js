"use strict";
/* From film to case: sources, markers, tracking, synchronisation, fit. The server holds the state. */
(() => {
  if (!document.getElementById("films")) return;
  const { element, button } = Charts;
  const { ask, at, complain, sentence, turn } = Page;
  const COLOURS = ["red", "orange", "yellow", "green", "cyan", "blue", "magenta", "white"];
  const RATES = [30, 60, 120, 240, 480, 960, 1000];
  const SHOWN = { casing: "casing", rotor: "rotor", single: "single body" };
  let project = null, chosen = null, size = [1, 1], index = 0, picture = null, mode = "hub", hub = null, disc = "", picks = [],
    tracks = null, measured = null, running = false, timer = null, wantsLaboratory = false, asked = new Set(), cross = null, latest = 0, sending = 0, ended = false;

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
    const busy = Object.values(project.jobs).some(active) || project.sources.some((x) => Object.values(x.jobs).some(active));
    clearTimeout(timer);
    if (busy) timer = setTimeout(refresh, 300);
    if (wantsLaboratory && !busy) {
      wantsLaboratory = false;
      if (project.can_open) open();
    }
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
      return job.total ? `${job.done} of ${job.total} frames, ${job.seconds.toFixed(0)} s` : `${job.label || "starting"} \u2026 ${job.seconds.toFixed(0)} s`;
    }
    if (job?.state === "failed") return sentence(job.message);
    if (x.is_current && x.result.motion) return motion(x.result);
    if (x.is_current) return Object.entries(x.result.body).map(([name, b]) => `${name}: ${b.samples} angles of ${x.result.frames} frames, \u00b1${(1e3 * b.median_sigma).toPrecision(2)} mrad`).join("; ");
    if (x.can_continue) return "interrupted; continues from a checkpoint";
    if (job?.state === "cancelled") return "cancelled";
    return x.result.frames ? "settings were changed after tracking" : "not tracked yet";
  }

  function motion(result) {
    const m = result.motion, value = (v, unit) => `${v.value.toPrecision(6)} \u00b1 ${v.stderr.toPrecision(2)} ${unit}`;
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
      const job = project.jobs[step], busy = active(job);
      at(`cancel-${step}`).hidden = !busy;
      at(`busy-${step}`).textContent = busy ? `${job.label || (step === "match" ? "synchronising" : "fitting")} \u2026 ${job.seconds.toFixed(0)} s`
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
    const done = { sources: !project.missing.track.length, track: project.sources.length > 0 && project.sources.every((x) => x.is_current), match: project.is_matched, fit: project.can_open };
    for (const [name, value] of Object.entries(done)) at(`step-${name}`).classList.toggle("done", value);
  }

  /* instruction for the next step */
  function guide() {
    const films = project.sources.filter((x) => x.kind === "film"), busy = Object.values(project.jobs).some(active) || films.some((x) => active(x.jobs.track));
    if (busy) return "Running; the page may be closed in the meantime.";
    if (!project.sources.length) return project.samples ? "Start with your own films, or with the sample clips: four films of one run with their study.toml." : "Start with your films.";
    if (project.missing.track.length) return `Next: ${project.missing.track[0]}`;
    if (films.some((x) => !x.is_current)) {
      const seen = films.some((x) => x.jobs.preview?.state === "done");
      return seen ? "Next: track the films." : "Next: select a film, press \u201cPreview the tracking\u201d and check the markers; then track the films.";
    }
    if (!project.is_matched) return project.missing.match.length ? `Next: ${project.missing.match[0]}` : "Next: synchronise the clips. The casing, which all cameras see, determines the start of each film.";
    return project.can_open ? "Next: open the laboratory." : project.route === "single" ? "" : "Next: fit. The laboratory then shows the lack of fit and the candidate effects.";
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
          : `starts at ${c.offset_s.toFixed(4)} s \u00b1 ${(1e3 * c.offset_sigma_s).toPrecision(2)} ms; rate 1 ${c.rate < 1 ? "\u2212" : "+"} ${Math.abs(c.rate - 1).toExponential(1)} \u00b1 ${c.rate_sigma.toExponential(1)}; rms difference of the casing angles ${(1e3 * c.misfit_rad).toPrecision(2)} mrad${c.ambiguous ? "; AMBIGUOUS: the start is not unique" : ""}`;
        return element("div", { class: "clock" }, element("b", {}, c.name), element("span", { class: "line" }, bar), element("span", { class: c.ambiguous ? "fault" : "soft" }, text));
      });
    });
  }

  /* --- one film: hub and markers --- */

  function choose(key) {
    stop();
    chosen = key;
    tracks = null; index = 0; picture = null; cross = null; size = [1, 1];
    at("sources").querySelectorAll(".card").forEach((c) => c.classList.toggle("now", c.dataset.key === key));
    const x = source(), film_ = Boolean(x) && x.kind === "film" && !x.info.error;
    at("marker").hidden = !film_;
    at("nothing").hidden = film_;
    at("h-marking").textContent = film_ ? `Markers in ${x.name}` : "Markers";
    if (!film_) return;
    hub = x.hub; picks = x.picks.map((p) => ({ ...p })); disc = "";
    mode = hub ? "casing" : "hub";
    modes();
    corrections();
    rows();
    film(null);
    show(0);
    if (x.jobs.preview?.state === "done") followed();
  }

  function film(before) {
    const x = source();
    if (!x || x.kind !== "film") return;
    const job = x.jobs.preview, was = before?.sources.find((o) => o.key === x.key);
    if (was && (was.body !== x.body || was.is_current !== x.is_current)) modes();
    if (was && x.profile !== was.profile && !x.picks.length && picks.length) { picks = []; rows(); draw(); }
    const names = ["", ...new Set([...(project.profiles || []), x.profile].filter(Boolean))];
    same(at("profile-of"), names.join("\n"), () => names.map((n) => element("option", { value: n }, n || "markers of the paper (red disc; red, blue, white, green)")));
    at("profile-of").value = x.profile;
    at("profile-of").parentElement.hidden = x.body === "single";
    at("find").hidden = x.body === "single";
    at("find").disabled = active(x.jobs.profile);
    at("command-film").textContent = x.command || "Choose the body first.";
    if (x.jobs.profile?.state === "failed" && active(was?.jobs.profile)) complain(new Error(sentence(x.jobs.profile.message)));
    if (active(job)) { at("followed").textContent = `tracking the first frames \u2026 ${job.seconds.toFixed(0)} s`; at("followed").className = "soft"; }
    else if (active(x.jobs.profile)) { at("followed").textContent = "searching for markers \u2026"; at("followed").className = "soft"; }
    else if (job?.state === "failed") { at("followed").textContent = sentence(job.message); at("followed").className = "fault"; tracks = null; draw(); }
    else if (job?.state === "done" && (!tracks || active(was?.jobs.preview))) followed();
    else if (!job) { at("followed").textContent = ""; }
  }

  async function followed() {
    const mine = ++latest, key = chosen, found = await act(`preview?key=${encodeURIComponent(key)}`);
    if (mine !== latest || key !== chosen || !found || !found.frames) return;
    tracks = found;
    const kept = Object.entries(found.kept).map(([name, k]) => `${source().body === "single" ? "body" : name} in ${Math.round(100 * k)} % of ${found.frames} frames, \u00b1${found.sigma_mrad[name].toPrecision(2)} mrad`);
    at("followed").textContent = [`Tracked: ${kept.join("; ")}.`, ...found.warnings.map(sentence)].join(" ");
    at("followed").className = Object.values(found.kept).every((k) => k > 0.8) ? "fine" : "fault";
    play();
  }

  function modes() {
    const single = source().body === "single", result = source().is_current && source().result.markers;
    const correct = !single && result ? Object.keys(result).map((m) => [`correct:${m}`, `correction of ${m}`]) : [];
    const options = single ? [["hub", "hub"], ["casing", "point to follow"]] : [["hub", "hub"], ["casing", "marker on the casing"], ["rotor", "marker on the rotor"], ...correct];
    if (!options.some(([v]) => v === mode)) mode = "hub";
    at("modes").replaceChildren(element("legend", {}, "Click to mark"), ...options.map(([value, text]) => {
      const radio = element("input", { type: "radio", name: "mode", value, id: `mode-${value}` });
      radio.checked = value === mode;
      radio.addEventListener("change", () => { mode = value; if (correcting()) { stop(); tracks = null; show(index); } corrections(); });
      return element("span", {}, radio, element("label", { for: `mode-${value}` }, text));
    }));
  }

  const correcting = () => mode.startsWith("correct:") ? mode.slice(8) : "";

  function corrections() {
    at("correcting").hidden = !correcting();
    at("lost").textContent = `${correcting()} is not visible in this frame`;
  }

  /* manual correction of a marker in one frame */
  async function correct(place) {
    const found = await act("correct", { key: chosen, marker: correcting(), index, place });
    if (found) { await show(index); at("corrected").textContent = `Frame ${index}: ${correcting()} ${place ? "corrected" : "marked as lost"}. Corrections in total: ${measured?.corrections || 0}; synchronise the clips again when you have finished.`; }
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

  async function set(x, y) {
    if (correcting()) { correct([x * size[0], y * size[1]]); return; }
    const found = await act("colour", { key: chosen, index, x, y });
    if (!found) return;
    const place = [x * size[0], y * size[1]];
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
    draw();
    mark();
  }

  /* store the clicked positions and preview the tracking if they suffice */
  async function mark() {
    tracks = null;
    stop();
    show(0);
    const single = source().body === "single";
    if (picks.length || (single && hub)) await act("mark", { key: chosen, hub, picks, disc });
    else at("followed").textContent = hub ? "Now click on the markers." : "";
    draw();
  }

  /* --- frames --- */

  async function show(i) {
    const x = source();
    if (!x) return;
    const last = (tracks ? tracks.frames : x.info.frames || 1) - 1;
    at("place").max = Math.max(0, last);
    index = Math.min(Math.max(0, i), Math.max(0, last));
    at("place").value = index;
    at("at").textContent = `frame ${index}`;
    const wanted = index, key = chosen;
    try {
      const blob = await ask(`/api/project/frame?key=${encodeURIComponent(key)}&index=${wanted}`);
      const image = await createImageBitmap(blob);
      const marks = !tracks && x.is_current && x.body !== "single" ? await ask(`/api/project/tracked?key=${encodeURIComponent(key)}&index=${wanted}`) : null;
      if (key !== chosen || wanted !== index) return;
      picture = image;
      measured = marks && marks.markers ? marks : null;
      size = blob.size2;
      at("still").dataset.shown = `${key}:${wanted}`;
      draw();
    } catch (error) {
      stop();
      complain(error);
    }
  }

  function draw() {
    const canvas = at("still"), g = canvas.getContext("2d");
    if (!picture) return;
    canvas.width = picture.width; canvas.height = picture.height;
    g.drawImage(picture, 0, 0);
    const scale = picture.width / size[0];
    const stroke = (path, colour) => { for (const [width, style] of [[4, "rgb(0 0 0 / 70%)"], [2, colour]]) { g.lineWidth = width; g.strokeStyle = style; g.stroke(path); } };
    const plus = (x, y, r) => { const p = new Path2D(); p.moveTo(x - r, y); p.lineTo(x + r, y); p.moveTo(x, y - r); p.lineTo(x, y + r); return p; };
    const ring = (x, y, r) => { const p = new Path2D(); p.arc(x, y, r, 0, 7); return p; };
    const word = (text, x, y) => { g.font = "13px system-ui, sans-serif"; g.lineWidth = 3; g.strokeStyle = "#000"; g.fillStyle = "#fff"; g.strokeText(text, x, y); g.fillText(text, x, y); };
    const shown = measured || (tracks && index < tracks.frames ? { centre: tracks.centre[index], markers: tracks.markers.map((m) => ({ name: m.name, place: m.place[index], whole: m.whole[index] })) } : null);
    if (shown && (tracks || correcting() || index > 0)) {
      const centre = shown.centre;
      if (centre) stroke(plus(centre[0] * scale, centre[1] * scale, 8), "#fff");
      for (const m of shown.markers) {
        const p = m.place;
        if (!p) continue;
        if (centre) { const ray = new Path2D(); ray.moveTo(centre[0] * scale, centre[1] * scale); ray.lineTo(p[0] * scale, p[1] * scale); stroke(ray, m.whole ? "#3cff3c" : "#ffb000"); }
        stroke(ring(p[0] * scale, p[1] * scale, 7), m.whole ? "#3cff3c" : "#ffb000");
        word(m.name, p[0] * scale + 10, p[1] * scale - 6);
      }
    } else if (index === 0) {
      if (hub) { stroke(plus(hub[0] * scale, hub[1] * scale, 11), "#fff"); word("hub", hub[0] * scale + 10, hub[1] * scale - 6); }
      for (const p of picks) { stroke(ring(p.x * scale, p.y * scale, 8), "#56b4e9"); word(p.name, p.x * scale + 10, p.y * scale - 6); }
    }
    if (cross && document.activeElement === canvas) stroke(plus(cross[0] * picture.width, cross[1] * picture.height, 14), "#ff0");
    canvas.setAttribute("aria-label", `frame ${index} of ${source()?.name || ""}; arrow keys move the cross, Enter marks hub or marker`);
  }

  function stop() { running = false; at("run").textContent = "Play"; }

  async function play() {
    if (running) return;
    running = true;
    at("run").textContent = "Pause";
    const key = chosen;
    while (running && key === chosen && !ended) {
      const began = performance.now(), last = Number(at("place").max);
      if (document.body.dataset.part === "films") await show(index >= last ? 0 : index + 1);
      await new Promise((done) => setTimeout(done, Math.max(5, 40 - (performance.now() - began))));
    }
    if (key === chosen) stop();
  }

  /* --- upload --- */

  async function send(files) {
    const list = [...files].sort((a, b) => (a.name === "study.toml") - (b.name === "study.toml"));
    for (const file of list) {
      sending++;
      at("busy").textContent = `uploading ${file.name} (${(file.size / 1e6).toFixed(1)} MB) \u2026`;
      await act(`upload?name=${encodeURIComponent(file.name)}`, file);
      sending--;
    }
    at("busy").textContent = "";
  }

  async function open() {
    at("busy").textContent = "opening the laboratory \u2026";
    const found = await act("open", {});
    at("busy").textContent = "";
    if (!found) return;
    at("tab-laboratory").disabled = false;
    stop();
    turn("laboratory");
    opened = project.case + project.fit.fit_id;
    Laboratory.start();
  }

  let opened = "";

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
  for (const name of ["inertia_rotor", "inertia_casing", "inertia", "label", "surface"]) at(name).addEventListener("change", () => act("set", { name, value: at(name).value }));
  at("follow").addEventListener("click", () => { tracks = null; act("follow", { key: chosen }); });
  at("find").addEventListener("click", () => act("find", { key: chosen }));
  at("clear").addEventListener("click", () => { picks = []; hub = null; disc = ""; mode = "hub"; modes(); rows(); mark(); });
  at("profile-of").addEventListener("change", async () => { await act("set", { key: chosen, name: "profile", value: at("profile-of").value }); tracks = null; act("follow", { key: chosen }); });
  at("lost").addEventListener("click", () => correct(null));
  at("run").addEventListener("click", () => { if (running) stop(); else play(); });
  at("place").addEventListener("input", () => { stop(); show(Number(at("place").value)); });
  at("still").addEventListener("click", (event) => {
    const box = at("still").getBoundingClientRect();
    if (correcting() ? running : running || index !== 0) { stop(); if (correcting()) return; tracks = null; show(0); return; }
    set((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  });
  at("still").addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.002 : 0.015, moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    if (moves[event.key]) {
      event.preventDefault();
      cross = (cross || [0.5, 0.5]).map((v, k) => Math.min(1, Math.max(0, v + moves[event.key][k])));
      draw();
    } else if (event.key === "Enter" && cross) { event.preventDefault(); set(...cross); }
  });
  at("tab-films").addEventListener("click", () => { turn("films"); refresh(); });
  at("tab-laboratory").addEventListener("click", () => { if (opened === project.case + project.fit.fit_id) { stop(); turn("laboratory"); } else open(); });
  document.body.addEventListener("ended", () => { ended = true; clearTimeout(timer); });
  document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });
  refresh();
})();
