"use strict";
/* The laboratory: one case, its fits and films. Texts from the server become text nodes, never markup. */
const Laboratory = (() => {
  const { Board, element, button, format, uncertain } = Charts;
  const { ask, at, breakable, busy, complain, duration, explained, narrow, progressText, sentence, tabs, undoable, GLOSSARY } = Page;
  const BODIES = ["rotor", "casing"];
  const COLOURS = ["red", "orange", "yellow", "green", "cyan", "blue", "magenta", "white"];
  const GROUPS = { motion: ["speed", "residual-casing", "rotor", "difference"], torque: ["torque-speed", "torque-deflection", "torque-casing", "torque-rotor", "torque-angle"],
    residual: ["normalised", "residual-casing", "residual-rotor"], uncertainty: ["sigma", "centre", "energy"] };
  const FEW = 6;  // candidates before the button that shows all
  let board = null, charts = [], fixed = [], group = "motion", clips = [], clip = null, searches = 0, free = new Set(), laws = new Map(),
    shown = 0, key = "", revision = -1, misfit = null, most = 1, working = false, found = null, all = false;

  /* run a request that changes the tree; the page stays usable meanwhile */
  async function act(work) {
    complain(null);
    working = true;
    enable();
    try {
      return await work();
    } catch (error) {
      complain(error);
      return null;
    } finally {
      working = false;
      enable();
    }
  }

  /* what starts another fit, or changes the tree, waits for the running fit */
  function enable() {
    document.body.toggleAttribute("aria-busy", working);
    for (const b of document.querySelectorAll("#ranking .fit, #add, #effects button, #ladder button, #keep, #write-report")) b.disabled = working;
    at("from-here").disabled = at("reset").disabled = working || !sliders?.parameters.some((p) => p.now !== p.value);
  }

  const VERDICTS = {
    no_lack_of_fit: "No significant lack of fit", lack_of_fit: "Significant lack of fit",
    not_determined: "A parameter is not determined by the data", not_converged: "Not converged: results are not valid",
  };

  /* keys and formulas of a single body without the role that it has in the library */
  const own = (text) => !last || last.body === "casing" ? text : text.replace(/^casing(?=[.:])/, last.body).replace(/^touchpoint\./, "support.").replace(/\b(omega|psi)_c\b/g, "$1");
  const named = (x) => x.words || x.effect || x.name;

  function drawn() {
    const wanted = GROUPS[group], own = [...charts, ...fixed].filter((c) => wanted.includes(c.name));
    return own.sort((a, b) => wanted.indexOf(a.name) - wanted.indexOf(b.name));
  }

  /* the charts of the chosen tab share the height of the pane */
  const pane = at("charts"), area = at("board");
  const height = () => {
    const n = Math.max(1, Math.min(3, drawn().length)), tools = area.querySelector(".tools")?.offsetHeight || 60;
    const heads = [...area.querySelectorAll(".panel .head")].slice(0, n).reduce((sum, h) => sum + h.offsetHeight, 0) || 26 * n;
    return narrow() ? 190 : (pane.clientHeight - tools - heads - 56) / n - 9;
  };

  function plot(state) {
    const here = { intervals: state.board.intervals, charts: drawn() };
    if (!board) {
      at("board").replaceChildren();
      board = new Board(at("board"), here, { click: (t) => seek(t), interval: (a, b) => stretch(a, b), height, body: true });
    } else board.set(here);
  }

  let last = null, answered = -1, shownFit = -1;

  function render(state) {
    last = state;
    revision = state.revision;
    at("verdict").textContent = VERDICTS[state.verdict] || state.verdict;
    at("verdict").className = state.verdict;
    undoable("laboratory", state);
    if (state.revision !== answered) at("limits").hidden = true;
    if (state.revision !== answered) at("sentence").textContent = state.verdict === "no_lack_of_fit" ? "The model describes the data within the noise." : "The deviation of the model exceeds the noise in the shaded intervals.";
    shown = state.current;
    charts = state.board.charts.filter((c) => !["sigma", "centre"].includes(c.name));
    const tracking = state.board.charts.filter((c) => ["sigma", "centre"].includes(c.name));
    if (tracking.length) fixed = tracking;
    plot(state);
    misfit = state.misfit;
    most = Math.max(1.5, ...state.ladder.map((r) => r.misfit || 0));
    scale(misfit, null);
    at("measure-list").replaceChildren(...state.measures.flatMap((m) => [element("dt", {}, m.name, element("span", {}, m.value)), element("dd", {}, m.meaning)]));
    at("effects").replaceChildren(...state.effects.map((e) => element("li", {},
      element("strong", {}, named(e)),
      element("span", { class: "law" }, e.name === `${e.joint}: ${e.law}` ? "" : own(`${e.joint}: ${e.law}`)),
      button("drop", `drop ${e.name}`, () => change({ drop: e.name })))));
    at("parameters").replaceChildren(...state.parameters.map((p) => element("tr", { "data-name": p.name },
      element("th", { scope: "row", class: "name-of", title: p.name }, p.words || p.name), element("td", {}, p.value + (p.at_bound ? " (at a bound)" : ""),
        element("span", { class: "more soft" }, p.other ? ` fit ${state.compared + 1}: ${p.other}${p.difference_u === null ? "" : `; difference ${format(p.difference_u, 2)} u`}` : "")), element("td", { class: "slide" }))));
    sliders = null;
    at("moved").textContent = "";
    board.overlay({});
    if (!at("p-sliders").hidden) tune();
    at("ladder").replaceChildren(...state.ladder.map((r) => {
      const name = (r.parent >= 0 ? r.words || r.added : "start") + (r.fit_id ? ` (${r.fit_id})` : "");
      const head = element("th", { scope: "row", class: "name-of" }, r.depth ? "\u2514\u00a0" : "", ...breakable(name),
        element("span", { class: "more" }, [`fit ${r.place + 1}`, r.name, r.note].filter(Boolean).join(": ")));
      head.style.paddingLeft = `${0.7 * Math.max(0, r.depth - 1)}rem`;
      const now = r.place === state.current, leaf = state.ladder.length > 1 && !state.ladder.some((o) => o.parent === r.place);
      const acts = element("td", {});
      if (now) acts.append("shown ");
      else acts.append(button("show", `show fit ${r.place + 1}`, () => go(r.place)));
      if (!now && r.place === state.compared) acts.append("compared ");
      else if (!now) acts.append(button("compare", `compare with fit ${r.place + 1}`, () => apply("/api/compare", { place: r.place })));
      if (leaf) acts.append(button("delete", `delete fit ${r.place + 1}`, () => apply("/api/delete", { place: r.place })));
      return element("tr", now ? { class: "now" } : {}, head, element("td", {}, times(r.misfit)),
        element("td", {}, r.parent >= 0 ? format(r.delta_bic, 3) : "\u2013"), acts);
    }));
    if (clip && shownFit !== state.current) film.show(film.index);
    if (shownFit >= 0 && shownFit !== state.current) outcome("certificate");
    shownFit = state.current;
    for (const field of ["name", "note"]) if (document.activeElement !== at(field)) at(field).value = state.ladder.find((r) => r.place === state.current)?.[field] || "";
    enable();
  }

  /* --- the one measure of misfit: times the noise, on a logarithmic scale whose end is the worst fit --- */

  const times = (x) => x === null || x === undefined ? "\u2013" : x < 9.95 ? x.toFixed(x < 1.995 ? 2 : 1) : x.toPrecision(x < 99.5 ? 2 : 3);

  function scale(now, then) {
    const text = element("strong", {}, times(now)), parts = ["Misfit: ", text, " times the noise"];
    if (then !== null) parts.push(" \u2192 ", element("strong", {}, times(then)));
    at("misfit").replaceChildren(...parts);
    const bar = at("misfit-bar"), share = (x) => 100 * Math.min(1, Math.max(0, Math.log(Math.max(x, 0.5) / 0.5) / Math.log(Math.max(most, now || 1) / 0.5)));
    bar.classList.toggle("good", now < 1.2);
    bar.querySelector(".limit").style.left = `${share(1)}%`;
    bar.querySelector(".value").style.width = `${share(now || 0.5)}%`;
    bar.querySelector(".foreseen").style.width = then === null ? "0" : `${share(then)}%`;
    bar.querySelector(".foreseen").hidden = then === null;
    bar.setAttribute("aria-label", `misfit ${times(now)} times the noise${then === null ? "" : `, predicted ${times(then)}`}; the dashed line is the noise limit, 1`);
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
      // in steps of a tenth of u, from the fitted value; the ends are 5 u away, or at a bound of the parameter
      const u = p.u || (p.high - p.low) / 10, low = (p.low - p.value) / u, high = (p.high - p.value) / u;
      const input = element("input", { type: "range", min: String(low), max: String(high), step: "any", "aria-label": `move ${p.name}`, "data-place": String(k) });
      const text = element("span", { class: "soft" });
      input.value = "0";
      const label = (z) => `${z > 0 ? "+" : z < 0 ? "\u2212" : ""}${Math.abs(z).toFixed(1)} u`;
      input.setAttribute("aria-valuetext", label(0));
      input.addEventListener("input", () => {
        const z = Math.abs(Number(input.value)) < 0.05 ? 0 : Number(input.value);
        p.now = z === 0 ? p.value : Math.min(p.high, Math.max(p.low, p.value + z * u));
        text.textContent = `${label(z)}: ${uncertain(p.now, p.u)} ${p.unit === "1" ? "" : Charts.unit(p.unit)}`;
        input.setAttribute("aria-valuetext", text.textContent);
        move();
      });
      const end = (z) => element("span", {}, p.u ? label(z) : uncertain(p.value + z * u, null));
      cell.replaceChildren(input, element("span", { class: "axis", "aria-hidden": "true" }, end(low), end(high)), text);
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
    at("from-here").disabled = at("reset").disabled = working || changed.length === 0;
    if (!changed.length) { waiting = null; board.overlay({}); scale(misfit, null); at("moved").textContent = ""; return; }
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
      const answer = await ask("/api/moved", { values });
      if (mine === sliders && !waiting) {
        draw(answer.value);
        at("board").dataset.overlay = "exact";
        scale(misfit, answer.misfit);
        at("moved").textContent = `With these values the misfit is ${times(answer.misfit)} times the noise.`;
      }
    } catch (error) { complain(error); }
    asking = false;
    exact();
  }

  /* --- candidates --- */

  let predicted = {}, hovered = null;

  /* predicted residual with an added candidate, before it is fitted */
  async function predict(c) {
    const p = predicted[c.effect];
    if (!p) return;
    hovered = c.effect;
    scale(misfit, p.misfit);
    at("foreseen").textContent = `With ${named(c)}, before the fit${p.torque ? "" : ", to first order"}; dashed in the charts.`;
    if (!sliders) await tune();
    if (!sliders || hovered !== c.effect) return;
    const t = p.torque, line = (x, value) => [{ x, value, colour: MOVED }];
    draw(p.value, t ? { "torque-casing": line(t.time, t.casing), "torque-rotor": line(t.time, t.rotor), "torque-speed": line(t.omega_c, t.casing) } : {});
    at("board").dataset.overlay = c.effect;
  }

  function hidePrediction() {
    hovered = null;
    at("foreseen").textContent = "";
    scale(misfit, null);
    if (!board) return;
    delete at("board").dataset.overlay;
    if (sliders && sliders.parameters.some((p) => p.now !== p.value)) move(); else board.overlay({});
  }

  /* a picture of what a candidate does: its torque (coloured) over the unmodelled torque (grey) */
  function sketch(c, measured) {
    const t = predicted[c.effect]?.torque;
    if (!t) return null;
    const W = 116, H = 58, size = (v) => Math.max(...v.map(Math.abs)), body = size(t.casing) >= size(t.rotor) ? "casing" : "rotor", value = t[body];
    const m = measured.find((x) => x.body === body), low = Math.min(0, ...value), high = Math.max(0, ...value), x0 = t.time[0], x1 = t.time[t.time.length - 1];
    const make = (name, values) => { const e = document.createElementNS("http://www.w3.org/2000/svg", name); for (const [k, v] of Object.entries(values)) e.setAttribute(k, v); return e; };
    const room = 0.25 * (high - low) || 1, top = high + room, bottom = low - room;
    const points = (x, y) => x.map((a, i) => `${(W * (a - x0) / (x1 - x0 || 1)).toFixed(1)},${(H - H * (Math.min(top, Math.max(bottom, y[i])) - bottom) / (top - bottom)).toFixed(1)}`).join(" ");
    const svg = make("svg", { viewBox: `0 0 ${W} ${H}`, width: W, height: H, role: "img", "aria-label": `torque of ${named(c)} on the ${body} against time, over the unmodelled torque` });
    svg.append(make("rect", { width: W, height: H, fill: "var(--raised)", rx: 3 }), make("polyline", { points: points([x0, x1], [0, 0]), stroke: "var(--edge)", "stroke-width": 1, "stroke-dasharray": "2 3", fill: "none" }));
    if (m) svg.append(make("polyline", { points: points(m.time, m.torque_Nm), stroke: "var(--soft)", "stroke-width": 3, "stroke-opacity": 0.45, fill: "none" }));
    svg.append(make("polyline", { points: points(t.time, value), stroke: "var(--focus)", "stroke-width": 2, fill: "none" }));
    return svg;
  }

  // faults of the recording, which no torque of a model describes
  const FAULTS = { "camera.slip": "Corrected by the fit.", "camera.start": "State the starts: import --start-u." };

  /* k = 3.5 \u00b1 0.2 N m: the index of the symbol lowered, the value in one line */
  function strength(text) {
    const [, letter, index, value] = /^([^_ ]+)(?:_(\S+))? = (.*)$/.exec(text) || [null, text, "", ""];
    return element("p", { class: "strength" }, letter, ...(index ? [element("sub", {}, index)] : []), value ? ` = ${value}` : "");
  }

  function card(c, next, measured, experiment) {
    const p = predicted[c.effect], fault = FAULTS[c.effect] || (free.has(c.effect) ? "Always fitted." : "");
    const out = element("li", { class: established(c) ? "card" : "card pale", "data-effect": c.effect });
    const alike = c.indistinguishable_from, law = c.law || laws.get(c.effect) || c.effect;
    const left = element("div", {}, element("h3", {}, ...breakable(named(c))), ...(c.words ? [element("span", { class: "key" }, ...breakable(own(c.effect)))] : []));
    const row = element("div", { class: "row" }, left), picture = sketch(c, measured);
    if (picture) row.append(picture);
    out.append(row, ...(c.values || []).slice(0, 2).map(strength), element("p", {}, element("code", {}, ...breakable(own(law)))));
    if (p && p.share !== null) {
      const bar = element("span", {});
      bar.style.width = `${100 * p.share}%`;
      out.append(element("div", { class: "share", "aria-hidden": "true" }, bar), element("p", {}, `Accounts for ${share(p.share)} of the misfit: ${times(found.base_misfit)} \u2192 ${times(p.misfit)} times the noise.`));
    }
    if (c.kind === "measurement") out.append(element("p", { class: "soft" }, "A measurement effect: an error of the measurement, not of the motion."));
    if (!established(c)) out.append(element("p", { class: "soft" }, c.significant ? `A hint only: false-alarm probability ${format(c.p_value, 1)}.` : "Not significant."));
    if (alike.length) out.append(element("p", { class: "soft" }, `These data cannot distinguish it from ${(c.indistinguishable_words || alike).join(", ")}.`));
    const why = element("details", {}, element("summary", { "aria-label": `why ${c.effect}` }, "Why, and what would contradict it"), element("dl", {},
      element("dt", {}, "Why it fits"), element("dd", {}, `Its signature: ${c.fits || "none is stated"}. False-alarm probability of such an improvement: ${c.p_value < 1e-30 ? "< 10\u207b\u00b3\u2070" : format(c.p_value, 1)}.`),
      element("dt", {}, "What would contradict it"), element("dd", {}, c.contradiction || "Another value in a repeated run."),
      element("dt", {}, "What separates it from the next"), element("dd", {}, separates(c, next, experiment))));
    const fit = fault ? element("span", { class: "soft" }, fault) : button("Fit", `add ${c.effect}`, () => change({ add: c.effect }));
    if (!fault) fit.className = "fit";
    out.append(element("div", { class: "foot" }, fit, why));
    if (fault) return out;
    for (const name of ["mouseenter", "focusin"]) out.addEventListener(name, () => predict(c));
    for (const name of ["mouseleave", "focusout"]) out.addEventListener(name, (event) => { if (!out.contains(event.relatedTarget)) hidePrediction(); });
    out.addEventListener("click", (event) => { if (!event.target.closest("details, button, a") && !working && !String(getSelection())) change({ add: c.effect }); });
    return out;
  }

  let byName = new Map();
  /* a significant candidate of an adequate model is a hint only */
  const established = (c) => c.significant && found.diagnosis.verdict !== "adequate";
  const words = (e) => named(byName.get(e) || { effect: e });
  const share = (x) => x > 0.995 && x < 1 ? `${(Math.min(0.9999, x) * 100).toFixed(2)} %` : `${(100 * x).toFixed(x < 0.1 ? 1 : 0)} %`;

  function separates(c, next, experiment) {
    if (!next) return "There is no other candidate.";
    if (c.indistinguishable_from.includes(next.effect)) return experiment || "Nothing in these data. Plan the next run below.";
    const a = predicted[c.effect], b = predicted[next.effect];
    const better = c.score - next.score;
    return `${a && b ? `These data: with ${named(next)} the misfit stays at ${times(b.misfit)} times the noise. ` : ""}Difference of the improvements of \u03c7\u00b2: ${format(better, 3)}.`;
  }

  /* change the tree of fits or the view; search again if another fit is shown */
  async function apply(path, body) {
    const before = shown, state = await act(() => ask(path, body));
    if (!state) return;
    render(state);
    if (shown !== before) search();
  }

  async function change(request) {
    hidePrediction();
    const state = await act(() => ask("/api/change", request));
    busy("fit", null);
    if (!state) return false;
    render(state);
    search();
    return true;
  }

  const go = (place) => apply("/api/go", { place });

  async function search() {
    const mine = ++searches;
    at("searching").textContent = "Testing all candidate effects \u2026";
    at("ranking").replaceChildren();
    at("foreseen").textContent = "";
    at("next-experiment").textContent = "";
    at("more").hidden = true;
    predicted = {};
    let answer = null, trouble = null;
    try { answer = await ask("/api/rank", {}); } catch (error) { trouble = error; }
    if (mine !== searches) return;
    busy("search", null);
    if (trouble || answer.error) {
      at("searching").replaceChildren(trouble ? trouble.message : sentence(answer.error.message), " ", button("Test again", "test the candidate effects again", search));
      return;
    }
    found = answer;
    answered = revision;
    predicted = found.predicted || {};
    const listed = found.diagnosis.candidates.filter((c) => c.score > 0).slice(0, 12);
    byName = new Map(found.diagnosis.candidates.map((c) => [c.effect, c]));
    at("searching").textContent = listed.length ? listed.some(established) ? "Point at one to see its effect; a click fits it." : "None is established: nothing is missing that these data could show." : "No candidate effect improves the fit.";
    say(found.diagnosis.sentence);
    at("next-experiment").textContent = found.diagnosis.next_experiment;
    const measured = found.diagnosis.residual_torque || [];
    at("ranking").replaceChildren(...listed.map((c, n) => card(c, listed[n + 1], measured, found.diagnosis.next_experiment)));
    all = false;
    fold();
    enable();
  }

  /* the answer first; what every fit corrects is folded with the measures */
  function say(text) {
    const parts = text.replace(/^Significant lack of fit: /, "").split(/(?<=\.)\s+(?=[A-Z])/), answer = parts.filter((t) => /^(Missing|Cannot be told apart)\b/.test(t));
    const corrected = parts.filter((t) => t.includes("nuisance parameter")), hidden = parts.filter((t) => t.startsWith("Effects that could still be hidden"));
    const rest = parts.filter((t) => ![answer, corrected, hidden].some((known) => known.includes(t)));
    at("limits").hidden = hidden.length === 0;
    at("limits-text").textContent = hidden.join(" ");
    at("sentence").replaceChildren(...answer.map((t) => element("strong", {}, t)), explained(sentence(rest.join(" "))));
    at("also").textContent = corrected.join(" ");
  }

  function fold() {
    [...at("ranking").children].forEach((c, n) => { c.hidden = !all && n >= FEW; });
    at("more").hidden = all || at("ranking").children.length <= FEW;
  }

  /* --- certificate and next run: processes of the server, which go on if the page is closed --- */

  const outcomes = { certificate: null, plan: null };

  async function outcome(name) {
    let state = null;
    try { state = await ask(`/api/outcome?key=${name}`); } catch { return; }
    const running = state.state === "running" || state.state === "waiting";
    outcomes[name] = running ? state : null;
    at(name === "plan" ? "plan" : "certify").disabled = running;
    at(`cancel-${name}`).hidden = !running;
    const line = at(name === "plan" ? "plan-state" : "certificate-state");
    line.textContent = running ? progressText(expecting(name, state), name === "plan" ? "computing the next run" : state.total ? `simulating recordings, ${state.done} of ${state.total}` : "starting: the recording itself is analysed")
      : state.state === "failed" ? sentence(state.message) : state.state === "cancelled" ? (name === "plan" ? "Cancelled." : "Cancelled; the next test continues from here.") : "";
    line.classList.toggle("fault", state.state === "failed");
    if (running) busy(name, expecting(name, state), name === "plan" ? "planning" : "testing the answer", () => act(() => ask("/api/cancel", { key: name })).then(() => outcome(name)));
    else busy(name, null);
    if (name === "certificate") certificate(state.document); else protocol(state.document);
  }

  /* a step with its usual duration, until it counts its recordings */
  const expecting = (name, state) => ({ ...state, expected: name === "plan" ? 20 : Number.isFinite(spent) ? spent : 12 });

  function certificate(d) {
    const box = at("certificate");
    box.hidden = !d || !d.sentence;
    if (box.hidden) return;
    const rows = [["without the named effect: false alarms", `${d.null.alarms} of ${d.null.n}`, `rate ${d.null.interval.map((x) => (100 * x).toFixed(1)).join(" to ")} %`]];
    if (d.truth) rows.push(["with it: named first", `${Math.round(100 * d.truth.right_first)} %`, `of ${d.truth.n}; in its class ${Math.round(100 * d.truth.in_class)} %`],
      ["its intervals contain the true values", Object.values(d.truth.coverage).length ? `${Math.round(100 * Object.values(d.truth.coverage).reduce((a, b) => a + b, 0) / Object.values(d.truth.coverage).length)} %` : "\u2013", "mean of all parameters"]);
    for (const r of d.rivals) rows.push([`if ${r.words || words(r.effect)} were true: named`, Object.entries(r.named_as).map(([e, n]) => `${words(e) || "none"} ${n}\u00d7`).join(", ") || "none", ""]);
    box.replaceChildren(element("p", {}, sentence(d.sentence)), element("div", { class: "wide", tabindex: "0", role: "group", "aria-label": "table of the test" }, element("table", {},
      element("thead", {}, element("tr", {}, ...["simulated recordings", "result", ""].map((t) => t ? element("th", { scope: "col" }, t) : element("td", {})))),
      element("tbody", {}, ...rows.map(([a, b, c]) => element("tr", {}, element("th", { scope: "row" }, a), element("td", {}, b), element("td", {}, c)))))));
  }

  function protocol(d) {
    const box = at("protocol"), r = d?.next_run;
    box.hidden = !d || !("next_run" in d);
    if (box.hidden) return;
    if (!r) { box.replaceChildren(element("p", {}, d.warning || "No further run within the bounds would teach more.")); return; }
    const n = (x) => format(x, 3), windows = r.windows.map((t, k) => `rotor film ${k + 1} at ${n(t)} s`).join(", ");
    const speed = (w) => `${n(Math.abs(w))} rad/s (${n(Math.abs(w) * 30 / Math.PI)} rpm)`, one = last.body !== "casing";
    // the steps contain the first sentence
    box.replaceChildren(element("h3", {}, `Protocol of the next run: ${at("title").textContent}`), element("p", {}, sentence(r.sentence).replace(/^.*?\. (?=[A-Z])/, "").replace(/^It /, "This run ")),
      element("ol", {}, ...(one ? [
        `Set up the ${last.body}${r.inertia_casing_ratio === 1 ? "" : `, with a ring that makes its moment of inertia ${n(r.inertia_casing_ratio)} times as large,`}${r.touchpoint_ratio === 1 ? "" : ` on a support with ${n(r.touchpoint_ratio)} times the friction`} and the camera as before, exposure and focus locked.`,
        `Start the camera, then release the ${last.body} at ${speed(r.omega_casing)}. Film it for ${n(r.duration)} s.`,
        "Name the file with its capture rate, for example run2_300fps.mp4; then drop it on the page From film.",
      ] : [
        `Set up ${r.inertia_casing_ratio === 1 ? "the same casing" : `a casing with ${n(r.inertia_casing_ratio)} times the moment of inertia`} on ${r.touchpoint_ratio === 1 ? "the same surface" : `a surface with ${n(r.touchpoint_ratio)} times the friction`}; cameras as before, exposure and focus locked.`,
        `Spin the rotor up to ${speed(r.omega_rotor)}${r.omega_rotor < 0 ? " in the other sense of rotation" : ""}, with the casing at ${speed(r.omega_casing)}${r.omega_rotor * r.omega_casing < 0 ? " against the rotor" : ""}.`,
        `Start the casing camera, then release. Film the casing for ${n(r.duration)} s.`,
        windows ? `Film the rotor for ${n(r.window_length)} s each: ${windows} after the release.` : "No film of the rotor is needed.",
        "Name the files with body and capture rate, for example run2_casing_260fps.mp4 and run2_rotor_1_1000fps.mp4; then drop them on the page From film.",
      ]).map((t) => element("li", {}, t))),
      element("table", {}, element("tbody", {}, ...[["Date, operator", ""], ["Temperature [\u00b0C]", ""], ["Measured initial speeds [rad/s]", ""], ["Remarks", ""]].map(([a, b]) => element("tr", {}, element("th", { scope: "row" }, a), element("td", {}, b))))),
      button("Print the protocol", "print the protocol", () => window.print()));
  }

  /* --- frames --- */

  const timeOf = (n) => clip ? clip.start + (clip.stop - clip.start) * (clip.frames > 1 ? n / (clip.frames - 1) : 0) : NaN;
  const frameAt = (c, t) => Math.round((t - c.start) / Math.max(1e-9, c.stop - c.start) * (c.frames - 1));

  const film = new FilmView(at("film"), {
    key: () => clip?.key,
    label: (n) => `frame ${n} of ${clip.source} at ${timeOf(n).toFixed(3)} s`,
    time: timeOf,
    rate: () => clip.rate,
    visible: () => document.body.dataset.part === "laboratory" && !document.hidden,
    shown: (n) => board?.setCursor(timeOf(n)),
    async picture(n) {
      const image = await createImageBitmap(await ask(`/api/frame?clip=${encodeURIComponent(clip.key)}&index=${n}&overlay=0`));
      return { image, size: clip.width && clip.height ? [clip.width, clip.height] : [image.width, image.height] };
    },
    marks: (n) => ask(`/api/marks?clip=${encodeURIComponent(clip.key)}&index=${n}${at("ghost").checked ? "&ghost=1" : ""}`),
    drawn: (marks) => {
      const g = marks?.ghost, degrees = g ? Math.abs(g.difference_rad) * 180 / Math.PI : 0;
      at("apart").textContent = !g ? "" : `Measured and modelled angle differ by ${format(degrees, 2)}\u00b0${g.factor > 1 ? `; drawn ${g.factor} times larger` : ""}.`;
    },
    picked: ([x, y]) => { if (!at("picker").open || at("p-more").hidden || !clip) return; pick(x / film.size[0], y / film.size[1]); },
  });
  at("legend-frame").append(...FilmView.legend(true));
  at("ghost").addEventListener("change", () => { if (clip) film.show(film.index); });

  function choose(name, index = 0) {
    clip = clips.find((c) => c.key === name) || null;
    if (!clip) return Promise.resolve();
    at("clip").value = name;
    // the overlay shows markers: a body that is tracked as a whole has none
    for (const part of [at("legend-frame"), at("overlay").parentElement, at("ghost").parentElement]) part.hidden = !clip.markers.length;
    return film.open(clip.frames, Math.min(index, clip.frames - 1), clip.width && clip.height ? [clip.width, clip.height] : null);
  }

  function seek(t) {
    const inside = clips.filter((c) => c.found && t >= c.start && t <= c.stop);
    const best = inside.find((c) => clip && c.key === clip.key) || inside[0];
    if (!best) return Promise.resolve();
    film.stop();
    return best === clip ? film.show(frameAt(best, t)) : choose(best.key, frameAt(best, t));
  }

  async function stretch(from, to) {
    if (!clips.some((c) => c.found)) return;
    await seek(Math.max(from, Math.min(...clips.filter((c) => c.found).map((c) => c.start))));
    if (clip) film.play(Math.min(clip.frames - 1, frameAt(clip, to)));
  }

  function pick(x, y) {
    act(async () => {
      const answer = await ask("/api/colour", { clip: clip.key, index: film.index, x, y });
      const swatch = element("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.background = `rgb(${answer.rgb.map(Number).join(",")})`;
      const n = at("picked").children.length + 1;
      const name = element("input", { type: "text", size: 8, "aria-label": `name of marker ${n}` });
      name.value = answer.colour || `marker${n}`;
      const select = (label, values, value) => {
        const out = element("select", { "aria-label": label }, ...values.map((v) => element("option", { value: v }, v)));
        if (value) out.value = value;
        return out;
      };
      const row = element("li", {}, swatch, name, select(`colour of marker ${n}`, COLOURS, answer.colour), select(`body of marker ${n}`, BODIES));
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
      const answer = await ask("/api/profile", { name: "picked", centre: at("centre").value, marker });
      at("toml").textContent = answer.toml;
      at("toml").hidden = false;
      if (at("download").href) URL.revokeObjectURL(at("download").href);
      at("download").href = URL.createObjectURL(new Blob([answer.toml], { type: "application/toml" }));
      at("download").hidden = false;
    });
  }

  /* show the case that the server has opened; with the same case the page stays as it is */
  async function start() {
    const state = await act(() => ask("/api/state"));
    if (!state) return;
    if (state.key === key && board) { if (state.revision !== revision) { const before = shown; render(state); if (shown !== before) search(); } return; }
    key = state.key;
    film.stop();
    board = null; clips = []; clip = null;
    at("title").textContent = state.label;
    document.title = `gyrotrack: ${state.label}`;
    at("library").replaceChildren(...state.library.map((e) => element("option", { value: e.name }, `${e.joint}: ${e.law}`)));
    laws = new Map(state.library.map((e) => [e.name, `${e.joint}: ${e.law}`]));
    free = new Set(state.library.filter((e) => e.free).map((e) => e.name));
    clips = state.clips;
    render(state);
    const known = clips.filter((c) => c.found);
    at("nofilm").hidden = known.length > 0;
    at("player").hidden = known.length === 0;
    at("clip").replaceChildren(...known.map((c) => element("option", { value: c.key }, c.body === "casing" && last.body !== "casing" ? c.source : `${c.source} (${c.body})`)));
    if (last.body !== "casing") at("effect").placeholder = `${last.body}: -k*omega**3`;
    if (known.length) choose(known[0].key);
    search();
    outcome("certificate");
    outcome("plan");
    at("command-report").textContent = (await ask("/api/report")).command;
  }

  /* what other tabs and processes have changed */
  async function follow() {
    try {
      const state = await ask("/api/state");
      if (state.key !== key) { start(); return; }
      const before = shown;
      render(state);
      if (shown !== before) search();
    } catch (error) { complain(error); }
  }

  let spent = NaN;
  Page.listen((news) => {
    const lab = news.laboratory;
    if (!lab || document.body.dataset.part !== "laboratory") return false;
    busy("fit", lab.fit?.label ? lab.fit : null, `fitting ${lab.fit?.label || ""}`, async () => { await ask("/api/cancel_fit", {}); busy("fit", null); });
    const searching = lab.search?.seconds !== undefined;
    if (searching) {
      const job = { ...lab.search, expected: lab.search.expected || 12 };
      busy("search", job, "testing candidate effects", async () => { await ask("/api/cancel_rank", {}); busy("search", null); });
    } else busy("search", null);
    if (lab.search?.expected) spent = lab.search.expected;
    const jobs = Object.keys(lab.jobs);
    for (const name of ["certificate", "plan"]) if (jobs.includes(name) || outcomes[name]) outcome(name);
    if (key && !working && (lab.key !== key || lab.revision !== revision)) { revision = lab.revision; follow(); }
    return Boolean(jobs.length || searching || lab.fit?.label);
  });

  /* save the current fit, then write the report in a process */
  async function report() {
    const state = await act(() => ask("/api/keep", {}));
    if (!state) return;
    render(state);
    const begin = at("write-report");
    try {
      let answer = await ask("/api/write_report", {});
      at("command-report").textContent = answer.command;
      at("open-report").hidden = true;
      while (answer.state === "waiting" || answer.state === "running") {
        begin.disabled = true;
        at("report-state").textContent = progressText({ ...answer, expected: 15 }, "writing");
        await new Promise((done) => setTimeout(done, 400));
        answer = await ask("/api/report");
      }
      at("report-state").textContent = answer.state === "done" ? answer.name : answer.message || answer.state;
      at("open-report").hidden = answer.state !== "done";
    } catch (error) { complain(error); }
    begin.disabled = false;
  }

  at("glossary").replaceChildren(...GLOSSARY.flatMap(([term, text]) => [element("dt", {}, term), element("dd", {}, text)]));
  at("form").addEventListener("submit", async (event) => {
    event.preventDefault();
    if (await change({ add: at("effect").value })) at("effect").value = "";
  });
  const chooseCharts = tabs(at("charts"), (name) => {
    group = name;
    at("board").setAttribute("aria-labelledby", `t-${name}`);
    if (last) plot(last);
  });
  const chooseBelow = tabs(at("below"), (name) => { if (name === "sliders" && !sliders && last) tune(); });
  chooseCharts("motion");
  chooseBelow("fits");
  at("more").addEventListener("click", () => { all = true; fold(); });
  at("certify").addEventListener("click", () => act(() => ask("/api/certify", { count: Number(at("count").value) })).then(() => outcome("certificate")));
  at("cancel-certificate").addEventListener("click", () => act(() => ask("/api/cancel", { key: "certificate" })).then(() => outcome("certificate")));
  at("plan").addEventListener("click", () => act(() => ask("/api/plan", {})).then(() => outcome("plan")));
  at("cancel-plan").addEventListener("click", () => act(() => ask("/api/cancel", { key: "plan" })).then(() => outcome("plan")));
  at("count").addEventListener("change", estimate);
  function estimate() { at("certify-time").textContent = Number.isFinite(spent) ? `about ${duration(2.75 * Number(at("count").value) * spent * 0.35)}` : ""; }
  at("trust").addEventListener("mouseenter", estimate);
  at("trust").addEventListener("focusin", estimate);
  at("write-report").addEventListener("click", report);
  at("keep").addEventListener("click", () => apply("/api/keep", {}));
  at("reset").addEventListener("click", () => {
    for (const input of document.querySelectorAll("#parameters input")) { const p = sliders.parameters[Number(input.dataset.place)]; input.value = "0"; input.parentElement.lastChild.textContent = ""; p.now = p.value; }
    move();
  });
  at("from-here").addEventListener("click", () => change({ values: Object.fromEntries(sliders.parameters.filter((p) => p.now !== p.value).map((p) => [p.name, p.now])) }));
  for (const field of ["name", "note"]) at(field).addEventListener("change", () => apply("/api/note", { place: shown, name: at("name").value, note: at("note").value }));
  document.addEventListener("keydown", (event) => {
    if (document.body.dataset.part !== "laboratory") return;
    const typing = event.target.closest("input:not([type=range]):not([type=checkbox]), select, textarea");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const ready = clip && clip.found, acts = {
      "/": () => at("effect").focus(),
      c: () => at("ranking").querySelector(".fit")?.focus(),
      ",": () => ready && film.step(-1),
      ".": () => ready && film.step(1),
    };
    if (event.key === " " && ready && !event.target.closest("button, summary, a, input")) { event.preventDefault(); at("play").click(); }
    else if (acts[event.key]) { event.preventDefault(); acts[event.key](); }
  });
  at("clip").addEventListener("change", () => choose(at("clip").value));
  at("profile").addEventListener("click", profile);
  at("quit").addEventListener("click", async () => {
    film.stop();
    searches++;
    if (await act(() => ask("/api/quit", {}))) {
      Page.end();
      document.body.dispatchEvent(new Event("ended"));
      // hidden, not removed: answers that are still on their way are written there
      for (const part of document.body.children) part.hidden = true;
      document.body.append(element("main", {}, element("p", { id: "ended" }, "gyrotrack has ended. Close this page.")));
    }
  });
  if (document.body.dataset.case !== undefined) start();
  return { start, stop: () => film.stop(), undo: () => apply("/api/undo", {}), redo: () => apply("/api/redo", {}) };
})();
