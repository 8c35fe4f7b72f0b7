"use strict";
/* The laboratory: one case, its fits and films. Texts from the server become text nodes, never markup. */
const Laboratory = (() => {
  const { Board, element, button, format } = Charts;
  const { ask, at, complain, explained, sentence, GLOSSARY } = Page;
  const BODIES = ["rotor", "casing"];
  const COLOURS = ["red", "orange", "yellow", "green", "cyan", "blue", "magenta", "white"];
  let board = null, fixed = [], clips = [], clip = null, index = 0, playing = false, until = null, searches = 0,
    free = new Set(), laws = new Map(), undoable = false, shown = 0, lastFit = NaN;

  /* run a slow request; `expected` is its last duration [s] */
  async function act(work, expected = NaN) {
    complain(null);
    document.body.setAttribute("aria-busy", "true");
    const began = performance.now();
    const usual = expected > 0.5 ? ` (the last fit took ${format(expected, 2)} s)` : "", passed = () => (performance.now() - began) / 1000;
    if (usual) at("busy").textContent = `fitting \u2026${usual}`;
    const clock = setInterval(() => { at("busy").textContent = `fitting \u2026 ${passed().toFixed(0)} s${usual}`; }, 1000);
    for (const b of document.querySelectorAll(".side button")) b.disabled = true;
    try {
      return await work();
    } catch (error) {
      complain(error);
      return null;
    } finally {
      clearInterval(clock);
      at("busy").textContent = "";
      document.body.removeAttribute("aria-busy");
      for (const b of document.querySelectorAll(".side button")) b.disabled = false;
      at("undo").disabled = !undoable;
      at("from-here").disabled = at("reset").disabled = !sliders?.parameters.some((p) => p.now !== p.value);
    }
  }

  const VERDICTS = {
    no_lack_of_fit: "no significant lack of fit", lack_of_fit: "significant lack of fit",
    not_determined: "a parameter is not determined by the data", not_converged: "not converged: results are not valid",
  };

  function render(state) {
    at("verdict").textContent = VERDICTS[state.verdict] || state.verdict;
    at("verdict").className = state.verdict;
    undoable = state.can_undo;
    at("undo").disabled = !undoable;
    shown = state.current;
    const charts = [...state.board.charts];
    if (!board) {
      at("board").replaceChildren();
      fixed = charts.filter((c) => c.name === "sigma" || c.name === "centre");
      board = new Board(at("board"), state.board, { click: (t) => seek(t), interval: (a, b) => stretch(a, b) });
    } else {
      board.set({ ...state.board, charts: [...charts, ...fixed] });
    }
    at("effects").replaceChildren(...state.effects.map((e) => element("li", {},
      element("strong", {}, e.name),
      element("span", { class: "law" }, e.name === `${e.joint}: ${e.law}` ? "" : `${e.joint}: ${e.law}`),
      button("drop", `drop ${e.name}`, () => change({ drop: e.name })))));
    at("parameters").replaceChildren(...state.parameters.map((p) => element("tr", { "data-name": p.name },
      element("th", { scope: "row" }, p.name), element("td", {}, p.value + (p.at_bound ? " (at a bound)" : ""),
        element("span", { class: "more" }, p.other ? `fit ${state.compared + 1}: ${p.other}, difference ${format(p.difference_sigma, 2)} \u03c3` : "")), element("td", { class: "slide" }))));
    sliders = null;
    at("moved").textContent = "";
    at("from-here").disabled = at("reset").disabled = true;
    board.overlay({});
    if (at("tuning").open) tune();
    const largest = Math.max(...state.ladder.map((r) => r.rmse_casing || 0));
    at("ladder").replaceChildren(...state.ladder.map((r) => {
      const bar = element("span", { class: "bar", "aria-hidden": "true" });
      bar.style.width = `${Math.max(1, 100 * r.rmse_casing / largest)}%`;
      const name = (r.parent >= 0 ? r.added : "start") + (r.fit_id ? ` (${r.fit_id})` : "");
      const head = element("th", { scope: "row" }, (r.depth ? "\u2514 " : "") + name, bar,
        element("span", { class: "more" }, [`fit ${r.place + 1}`, r.name, r.note].filter(Boolean).join(": ")));
      head.style.paddingLeft = `${0.8 * Math.max(0, r.depth - 1)}rem`;
      const now = r.place === state.current, leaf = state.ladder.length > 1 && !state.ladder.some((o) => o.parent === r.place);
      const acts = element("td", {});
      if (now) acts.append("shown ");
      else acts.append(button("show", `show fit ${r.place + 1}`, () => go(r.place)));
      if (!now && r.place === state.compared) acts.append("compared ");
      else if (!now) acts.append(button("compare", `compare with fit ${r.place + 1}`, () => apply("/api/compare", { place: r.place })));
      if (leaf) acts.append(button("delete", `delete fit ${r.place + 1}`, () => apply("/api/delete", { place: r.place })));
      return element("tr", now ? { class: "now" } : {}, head, element("td", {}, format(r.rmse_casing, 3)),
        element("td", {}, format(r.reduced_chi2, 3)), element("td", {}, format(r.held_out, 3)),
        element("td", {}, r.parent >= 0 ? format(r.delta_bic, 3) : "\u2013"), acts);
    }));
    for (const field of ["name", "note"]) at(field).value = state.ladder.find((r) => r.place === state.current)?.[field] || "";
  }

  /* --- parameters changed by sliders: predicted residuals, first linearised, then exact --- */

  const MOVED = "#cc79a7";
  let sliders = null, waiting = null, asking = false;

  async function tune() {
    let mine = null;
    try { mine = await ask("/api/sliders", {}); } catch (error) { complain(error); }
    if (!mine || mine.place !== shown) return;
    sliders = mine;
    const rows = new Map([...at("parameters").children].map((r) => [r.dataset.name, r.querySelector(".slide")]));
    sliders.parameters.forEach((p, k) => {
      p.now = p.value;
      const cell = rows.get(p.name);
      if (!cell || !(p.high > p.low)) return;
      const input = element("input", { type: "range", min: "0", max: "1000", step: "1", "aria-label": `move ${p.name}`, "data-place": String(k) });
      const text = element("span", { class: "soft" });
      const middle = 1000 * (p.value - p.low) / (p.high - p.low);
      input.value = String(middle);
      input.setAttribute("aria-valuetext", format(p.value));
      input.addEventListener("input", () => {
        p.now = Math.abs(Number(input.value) - middle) < 1 ? p.value : p.low + Number(input.value) / 1000 * (p.high - p.low);
        text.textContent = `${format(p.now)} ${p.unit === "1" ? "" : p.unit}`;
        input.setAttribute("aria-valuetext", text.textContent);
        move();
      });
      cell.replaceChildren(input, text);
    });
  }

  function curves(values) {
    const run = (k) => ({ x: sliders.time[k], value: values[k] });
    const windows = values.slice(1).map((_, k) => run(k + 1));
    const rotor = { x: windows.flatMap((w) => [...w.x, w.x[w.x.length - 1]]), value: windows.flatMap((w) => [...w.value, null]) };
    const normal = values[0].map((v, i) => sliders.sigma[i] > 0 ? v / sliders.sigma[i] : null);
    return { casing: run(0), rotor, normalised: { x: sliders.time[0], value: normal } };
  }

  function draw(values, more = {}) {
    const c = curves(values), with_ = (o) => [{ ...o, colour: MOVED }];
    board.overlay({ "residual-casing": with_(c.casing), "residual-rotor": with_(c.rotor), normalised: with_(c.normalised), ...more });
  }

  function move() {
    const changed = sliders.parameters.map((p, k) => [p.now - p.value, k]).filter(([d]) => d !== 0);
    at("from-here").disabled = at("reset").disabled = changed.length === 0;
    if (!changed.length) { waiting = null; board.overlay({}); at("moved").textContent = ""; return; }
    const linear = sliders.value.map((run, r) => run.map((v, i) => changed.reduce((sum, [d, k]) => sum + d * sliders.slope[r][k][i], v)));
    draw(linear);
    at("board").dataset.overlay = "linear";
    waiting = Object.fromEntries(changed.map(([, k]) => [sliders.parameters[k].name, sliders.parameters[k].now]));
    exact();
  }

  async function exact() {
    if (asking || !waiting) return;
    asking = true;
    const mine = sliders, values = waiting;
    waiting = null;
    try {
      const found = await ask("/api/moved", { values });
      if (mine === sliders && !waiting) {
        draw(found.value);
        at("board").dataset.overlay = "exact";
        at("moved").textContent = `changed parameters: rms residual ${format(found.rms, 3)} \u03c3, \u03c7\u00b2/n ${format(found.reduced_chi2, 3)}`;
      }
    } catch (error) { complain(error); }
    asking = false;
    exact();
  }

  /* predicted residual with an added candidate, before it is fitted */
  async function predict(name) {
    const p = predicted[name];
    if (!p) return;
    if (!sliders) await tune();
    if (!sliders) return;
    const t = p.torque, line = (x, value) => [{ x, value, colour: MOVED }];
    draw(p.value, t ? { "torque-casing": line(t.time, t.casing), "torque-rotor": line(t.time, t.rotor), "torque-speed": line(t.omega_c, t.casing) } : {});
    at("board").dataset.overlay = name;
    at("foreseen").textContent = `${name}: rms residual ${format(predictedBase, 3)} \u03c3 \u2192 ${format(p.rms, 3)} \u03c3${t ? "" : " (to first order)"}, dashed in the charts`;
  }

  function hidePrediction() {
    at("foreseen").textContent = "";
    delete at("board").dataset.overlay;
    if (sliders && sliders.parameters.some((p) => p.now !== p.value)) move(); else board.overlay({});
  }

  let predicted = {}, predictedBase = NaN;

  /* change the tree of fits or the view; search again if another fit is shown */
  async function apply(path, body) {
    const before = shown, state = await act(() => ask(path, body));
    if (!state) return;
    render(state);
    if (shown !== before) search();
  }

  async function change(request) {
    const began = performance.now(), state = await act(() => ask("/api/change", request), lastFit);
    if (!state) return false;
    lastFit = (performance.now() - began) / 1000;
    render(state);
    search();
    return true;
  }

  const go = (place) => apply("/api/go", { place });

  async function search() {
    const mine = ++searches;
    at("searching").textContent = "Testing candidate effects \u2026";
    at("ranking").replaceChildren();
    at("sentence").textContent = "";
    at("foreseen").textContent = "";
    predicted = {};
    let found = null, trouble = null;
    try { found = await ask("/api/rank", {}); } catch (error) { trouble = error; }
    if (mine !== searches) return;
    if (trouble || found.error) {
      at("searching").textContent = trouble ? trouble.message : sentence(found.error.message);
      return;
    }
    const shown = found.diagnosis.candidates.filter((c) => c.score > 0).slice(0, 12);
    at("searching").textContent = shown.length ? "" : "No candidate effect has a positive score.";
    at("sentence").replaceChildren(explained(found.diagnosis.sentence));
    predicted = found.predicted || {};
    predictedBase = found.base_rms ?? NaN;
    // faults of the recording, which no torque of a model describes
    const faults = { "camera.slip": "corrected by the fit", "camera.start": "state the starts: import --start-u" };
    const row = (c, tr) => {
      if (c.effect in faults) return tr;
      for (const [name, work] of [["mouseenter", () => predict(c.effect)], ["focusin", () => predict(c.effect)], ["mouseleave", hidePrediction], ["focusout", hidePrediction]]) tr.addEventListener(name, work);
      return tr;
    };
    at("ranking").replaceChildren(...shown.map((c) => row(c, element("tr", c.significant ? {} : { class: "pale" },
      element("th", { scope: "row", title: laws.get(c.effect) || c.effect }, c.effect, element("span", { class: "more" }, [
        ...(c.kind === "measurement" ? ["measurement effect"] : []),
        ...(c.indistinguishable_from.length ? [`indistinguishable from ${c.indistinguishable_from.join(", ")}`] : []),
      ].join("; "))),
      element("td", {}, format(c.score, 3)), element("td", {}, c.delta_bic === null ? "\u2013" : format(c.delta_bic, 3)),
      element("td", {}, c.p_value < 1e-30 ? "< 10\u207b\u00b3\u2070" : format(c.p_value, 1)),
      element("td", {}, c.effect in faults ? faults[c.effect] : free.has(c.effect) ? "always fitted"
        : button("add", `add ${c.effect}`, () => change({ add: c.effect })))))));
  }

  /* frames */

  function choose(key) {
    clip = clips.find((c) => c.key === key) || null;
    if (!clip) return;
    at("clip").value = key;
    at("seek").max = clip.frames - 1;
    show(Math.min(index, clip.frames - 1));
  }

  function timeOf(i) { return clip.start + (clip.stop - clip.start) * (clip.frames > 1 ? i / (clip.frames - 1) : 0); }

  function frameAt(c, t) { return Math.round((t - c.start) / Math.max(1e-9, c.stop - c.start) * (c.frames - 1)); }

  async function show(i) {
    index = Math.min(Math.max(0, i), clip.frames - 1);
    const wanted = index, key = clip.key;
    at("seek").value = index;
    at("where").textContent = `frame ${index}, ${timeOf(index).toFixed(3)} s`;
    if (board) board.setCursor(timeOf(index));
    try {
      const overlay = at("overlay").checked ? 1 : 0;
      const path = `/api/frame?clip=${encodeURIComponent(key)}&index=${wanted}&overlay=${overlay}`;
      const picture = await createImageBitmap(await ask(path));
      if (wanted !== index || key !== clip.key) return;
      const canvas = at("frame");
      canvas.width = picture.width;
      canvas.height = picture.height;
      canvas.getContext("2d").drawImage(picture, 0, 0);
      canvas.setAttribute("aria-label", `frame ${index} of ${clip.source} at ${timeOf(index).toFixed(3)} s`);
      canvas.dataset.shown = `${key}:${index}`;
    } catch (error) {
      playing = false;
      complain(error);
    }
  }

  function seek(t) {
    const inside = clips.filter((c) => c.found && t >= c.start && t <= c.stop);
    const best = inside.find((c) => clip && c.key === clip.key) || inside[0];
    if (!best) return;
    stop();
    index = frameAt(best, t);
    choose(best.key);
  }

  async function stretch(from, to) {
    seek(Math.max(from, Math.min(...clips.map((c) => c.start))));
    if (!clip || !clip.found) return;
    play(frameAt(clip, to));
  }

  function stop() { playing = false; at("play").textContent = "Play"; }

  /* every frame, or at a fraction of real time with frames skipped */
  async function play(end) {
    until = Math.min(end, clip.frames - 1);
    if (playing) return;
    playing = true;
    at("play").textContent = "Pause";
    const first = index, start = performance.now();
    while (playing && index < until) {
      const began = performance.now(), speed = Number(at("speed").value);
      const next = speed ? first + Math.floor((began - start) / 1000 * clip.rate * speed) : index + 1;
      if (next > index) await show(Math.min(next, until));
      await new Promise((done) => setTimeout(done, Math.max(speed ? 5 : 0, (speed ? 15 : 40) - (performance.now() - began))));
    }
    stop();
  }

  function pick(x, y) {
    act(async () => {
      const body = { clip: clip.key, index, x, y };
      const found = await ask("/api/colour", body);
      const swatch = element("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.background = `rgb(${found.rgb.map(Number).join(",")})`;
      const n = at("picked").children.length + 1;
      const name = element("input", { type: "text", size: 8, "aria-label": `name of marker ${n}` });
      name.value = found.colour || `marker${n}`;
      const select = (label, values, value) => {
        const out = element("select", { "aria-label": label }, ...values.map((v) => element("option", { value: v }, v)));
        if (value) out.value = value;
        return out;
      };
      const colour = select(`colour of marker ${n}`, COLOURS, found.colour);
      const on = select(`body of marker ${n}`, BODIES);
      const row = element("li", {}, swatch, name, colour, on);
      row.append(button("remove", `remove marker ${n}`, () => row.remove()));
      at("picked").append(row);
    });
  }

  function profile() {
    act(async () => {
      const marker = [...at("picked").children].map((row) => {
        const [colour, body] = row.querySelectorAll("select");
        return { name: row.querySelector("input").value, colour: colour.value, body: body.value };
      });
      const found = await ask("/api/profile", { name: "picked", centre: at("centre").value, marker });
      at("toml").textContent = found.toml;
      at("toml").hidden = false;
      if (at("download").href) URL.revokeObjectURL(at("download").href);
      at("download").href = URL.createObjectURL(new Blob([found.toml], { type: "application/toml" }));
      at("download").hidden = false;
    });
  }

  /* show the case that the server has opened */
  async function start() {
    stop();
    board = null; clips = []; clip = null; index = 0;
    const state = await act(() => ask("/api/state"));
    if (!state) return;
    at("title").textContent = state.label;
    document.title = `gyrotrack: ${state.label}`;
    at("library").replaceChildren(...state.library.map((e) => element("option", { value: e.name }, `${e.joint}: ${e.law}`)));
    laws = new Map(state.library.map((e) => [e.name, `${e.joint}: ${e.law}`]));
    free = new Set(state.library.filter((e) => e.free).map((e) => e.name));
    clips = state.clips;
    render(state);
    const found = clips.filter((c) => c.found);
    at("nofilm").hidden = found.length > 0;
    at("player").hidden = found.length === 0;
    at("clip").replaceChildren(...found.map((c) => element("option", { value: c.key }, `${c.source} (${c.body})`)));
    if (found.length) choose(found[0].key);
    search();
    at("command-report").textContent = (await ask("/api/report")).command;
  }

  at("glossary").replaceChildren(...GLOSSARY.flatMap(([term, text]) => [element("dt", {}, term), element("dd", {}, text)]));
  at("form").addEventListener("submit", async (event) => {
    event.preventDefault();
    if (await change({ add: at("effect").value })) at("effect").value = "";
  });
  /* save the current fit, then write the report in a process */
  async function report() {
    const state = await act(() => ask("/api/keep", {}));
    if (!state) return;
    render(state);
    const begin = at("write-report");
    try {
      let found = await ask("/api/write_report", {});
      at("command-report").textContent = found.command;
      at("open-report").hidden = true;
      while (found.state === "waiting" || found.state === "running") {
        begin.disabled = true;
        at("report-state").textContent = `writing \u2026 ${Math.round(found.seconds || 0)} s (about 10 s)`;
        await new Promise((done) => setTimeout(done, 400));
        found = await ask("/api/report");
      }
      at("report-state").textContent = found.state === "done" ? found.name : found.message || found.state;
      at("open-report").hidden = found.state !== "done";
    } catch (error) { complain(error); }
    begin.disabled = false;
  }

  at("write-report").addEventListener("click", report);
  at("keep").addEventListener("click", () => apply("/api/keep", {}));
  at("undo").addEventListener("click", () => apply("/api/undo", {}));
  at("tuning").addEventListener("toggle", () => { if (at("tuning").open && !sliders) tune(); });
  at("reset").addEventListener("click", () => { for (const input of document.querySelectorAll("#parameters input")) { const p = sliders.parameters[Number(input.dataset.place)]; input.value = String(1000 * (p.value - p.low) / (p.high - p.low)); input.nextSibling.textContent = ""; p.now = p.value; } move(); });
  at("from-here").addEventListener("click", () => change({ values: Object.fromEntries(sliders.parameters.filter((p) => p.now !== p.value).map((p) => [p.name, p.now])) }));
  for (const field of ["name", "note"]) at(field).addEventListener("change", () => apply("/api/note", { place: shown, name: at("name").value, note: at("note").value }));
  document.addEventListener("keydown", (event) => {
    if (document.body.dataset.part !== "laboratory") return;
    const typing = event.target.closest("input:not([type=range]):not([type=checkbox]), select, textarea");
    if ((event.ctrlKey || event.metaKey) && event.key === "z" && !typing) { event.preventDefault(); if (undoable) apply("/api/undo", {}); return; }
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const film = clip && clip.found, acts = {
      "/": () => at("effect").focus(),
      ",": () => film && (stop(), show(index - 1)),
      ".": () => film && (stop(), show(index + 1)),
    };
    if (event.key === " " && film && !event.target.closest("button, summary, a, input")) { event.preventDefault(); at("play").click(); }
    else if (acts[event.key]) { event.preventDefault(); acts[event.key](); }
  });
  at("clip").addEventListener("change", () => { stop(); index = 0; choose(at("clip").value); });
  at("seek").addEventListener("input", () => { stop(); show(Number(at("seek").value)); });
  at("overlay").addEventListener("change", () => show(index));
  at("play").addEventListener("click", () => { if (playing) stop(); else play(clip.frames - 1); });
  at("frame").addEventListener("click", (event) => {
    if (!at("picker").open || !clip) return;
    const box = at("frame").getBoundingClientRect();
    pick((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  });
  at("profile").addEventListener("click", profile);
  at("quit").addEventListener("click", async () => {
    stop();
    searches++;
    if (await act(() => ask("/api/quit", {}))) {
      document.body.dispatchEvent(new Event("ended"));
      document.body.replaceChildren(element("main", {}, element("p", { id: "ended" }, "gyrotrack has ended. Close this page.")));
    }
  });
  if (document.body.dataset.case !== undefined) start();
  return { start };
})();
