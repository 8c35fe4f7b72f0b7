"use strict";
/* Common to both parts of the page: requests, errors, tabs, progress, news from the server, switching the parts. */
const Page = (() => {
  const at = (id) => document.getElementById(id);

  async function ask(path, body) {
    const options = {};
    if (body !== undefined) {
      options.method = "POST";
      options.body = body instanceof Blob ? body : JSON.stringify(body);
    }
    let answer;
    try {
      answer = await fetch(path, options);
    } catch {
      throw new Error("No answer from the program. If it has ended, run gyrotrack view again.");
    }
    if (answer.headers.get("content-type")?.startsWith("image/")) {
      const image = await answer.blob(), size = answer.headers.get("x-gyrotrack-size");
      image.size2 = size ? size.split(",").map(Number) : null;
      return image;
    }
    if (!answer.headers.get("content-type")?.includes("json")) throw new Error(await answer.text());
    const found = await answer.json();
    if (found.error) throw new Error([found.error.message, found.error.hint].filter(Boolean).map(sentence).join(" "));
    return found;
  }

  function sentence(text) {
    // the page has fields for what the command line has options for
    const own = text.replace(/ \(--[a-z-]+\)/g, ""), out = own.charAt(0).toUpperCase() + own.slice(1);
    return /[.!?]$/.test(out) ? out : out + ".";
  }

  function complain(error) {
    at("error-text").textContent = error ? error.message : "";
    at("error").hidden = !error;
  }

  const GLOSSARY = [
    ["misfit", "Rms of the residual divided by that of the noise. It contains everything that a model can describe, and not the white noise between neighbouring samples. 1 is the noise limit."],
    ["residual", "Measured minus modelled value."],
    ["lack of fit", "Deviation of the model from the data beyond noise."],
    ["unmodelled torque", "Difference between the torque required by the data and the model, without assuming a law."],
    ["candidate effect", "A law of the library that could be missing from the model."],
    ["nuisance parameter", "A parameter of the measurement (camera centre, tilt, shutter) that is fitted with every model."],
    ["u, \u03c3", "Standard uncertainty; for a residual, that of the noise."],
    ["rms", "Root mean square."],
    ["\u03c7\u00b2/n", "Reduced chi-square: mean square of the residual in units of the noise; 1 is the noise limit."],
    ["\u0394BIC", "Change of the Bayesian information criterion; negative favours the added effect."],
    ["false-alarm probability", "Probability of such an improvement anywhere in the list if no effect is missing."],
    ["prediction error", "Error on data that were left out of the fit, in units of the noise."],
    ["indistinguishable", "Effects that these data cannot distinguish."],
    ["omega_r, omega_c", "Angular rates of rotor and casing [rad/s]."],
    ["psi_r, psi_c", "Angles of rotor and casing [rad]."],
    ["delta", "Angular rate of the rotor relative to the casing, omega_r \u2212 omega_c [rad/s]."],
    ["rotor, casing, bearing", "Where a torque acts; a torque of the bearing acts on both bodies with opposite signs."],
    ["rolling shutter", "The rows of a frame are exposed one after another; the delay across the picture is a nuisance parameter."],
  ];

  /* a text whose known terms have tooltips */
  function explained(text) {
    const out = document.createDocumentFragment(), terms = GLOSSARY.filter(([t]) => t.length > 4 && !t.includes(","));
    const pattern = new RegExp(`(${terms.map(([t]) => t).join("|")})`, "i");
    for (const part of text.split(pattern)) {
      const known = terms.find(([t]) => t.toLowerCase() === part.toLowerCase());
      if (!known) { out.append(part); continue; }
      const word = document.createElement("abbr");
      word.title = known[1];
      word.textContent = part;
      out.append(word);
    }
    return out;
  }

  /* a dotted name or a formula that breaks only after dots and operators */
  function breakable(text) {
    return text.split(/(?<=[.*/+(_])(?=\S)/).flatMap((part, n) => n ? [document.createElement("wbr"), part] : [part]);
  }

  /* show a part of the page, "films" or "laboratory", also after it is reloaded */
  function turn(part) {
    for (const name of ["films", "laboratory"]) {
      if (at(name)) at(name).hidden = name !== part;
      const tab = at(`tab-${name}`);
      if (tab && name === part) tab.setAttribute("aria-current", "page"); else if (tab) tab.removeAttribute("aria-current");
    }
    document.body.dataset.part = part;
    history.replaceState(null, "", `#${part}`);
    window.scrollTo(0, 0);
    window.dispatchEvent(new Event("resize"));
    undoable();
  }

  /* tabs: buttons with data-tab in a tablist, panels with data-panel; the arrow keys move */
  function tabs(root, chosen) {
    const buttons = [...root.querySelectorAll("[role=tab]")];
    const choose = (name, focus = false) => {
      for (const b of buttons) {
        const own = b.dataset.tab === name;
        b.setAttribute("aria-selected", String(own));
        b.tabIndex = own ? 0 : -1;
        if (own && focus) b.focus();
      }
      for (const p of root.querySelectorAll("[data-panel]")) p.hidden = p.dataset.panel !== name;
      chosen?.(name);
    };
    buttons.forEach((b, n) => {
      b.addEventListener("click", () => choose(b.dataset.tab));
      b.addEventListener("keydown", (event) => {
        const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (step) { event.preventDefault(); choose(buttons[(n + step + buttons.length) % buttons.length].dataset.tab, true); }
      });
    });
    return choose;
  }

  /* share of a step that is done, as text, from its counts or from its usual duration */
  function percentage(job) {
    if (job.total) return Math.min(1, job.done / job.total);
    if (job.expected > 0) return Math.min(0.99, (job.seconds || 0) / job.expected);
    return null;
  }

  function progressText(job, label) {
    const share = percentage(job), seconds = job.seconds || 0;
    if (share === null) return `${label} \u2026 ${seconds.toFixed(0)} s`;
    const left = share > 0.02 ? seconds * (1 - share) / share : NaN;
    return `${label}: ${Math.round(100 * share)} %${left > 1 ? `, about ${duration(left)} more` : ""}`;
  }

  function duration(seconds) {
    if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s`;
    return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
  }

  /* the work that is shown in the header, by name, each with a way to cancel it */
  const works = new Map();
  function busy(name, job, label = "", cancel = null) {
    if (job) works.set(name, { job, label, cancel }); else works.delete(name);
    const [first] = works.values();
    at("busy").textContent = first ? progressText(first.job, first.label) : "";
    at("busy-bar").hidden = at("busy-cancel").hidden = true;
    if (!first) return;
    at("busy-bar").hidden = false;
    const share = percentage(first.job);
    if (share === null) at("busy-bar").removeAttribute("value"); else at("busy-bar").value = share;
    at("busy-cancel").hidden = !first.cancel;
    at("busy-cancel").onclick = () => { first.cancel?.(); };
  }

  /* undo and redo of the part that is shown */
  const histories = {};
  function undoable(part, labels) {
    if (part) histories[part] = labels;
    const shown = histories[document.body.dataset.part] || {};
    for (const name of ["undo", "redo"]) {
      at(name).disabled = !shown[name];
      at(name).title = shown[name] ? `${name}: ${shown[name]} (${name === "undo" ? "Ctrl+Z" : "Ctrl+Shift+Z"})` : `nothing to ${name}`;
    }
  }

  /* news from the server: what has changed in any tab, and what is running */
  const listeners = [];
  let ended = false, clock = 0;
  async function pulse() {
    clearTimeout(clock);
    if (ended) return;
    let quick = false;
    if (!document.hidden) {
      try {
        const found = await ask("/api/pulse");
        for (const f of listeners) quick = f(found) || quick;
      } catch { /* the next request of the user says so */ }
    }
    clock = setTimeout(pulse, quick ? 300 : 1200);
  }
  document.addEventListener("visibilitychange", () => { if (!document.hidden) pulse(); });

  function end() { ended = true; }

  document.addEventListener("DOMContentLoaded", () => {
    at("error-close").addEventListener("click", () => complain(null));
    for (const name of ["undo", "redo"]) at(name).addEventListener("click", () => (document.body.dataset.part === "films" ? Films : Laboratory)[name]());
    setTimeout(pulse, 500);
  });
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input:not([type=range]):not([type=checkbox]):not([type=radio]), select, textarea");
    if (!(event.ctrlKey || event.metaKey) || typing || event.key.toLowerCase() !== "z" && event.key !== "y") return;
    event.preventDefault();
    const name = event.shiftKey || event.key === "y" ? "redo" : "undo";
    if (!at(name).disabled) at(name).click();
  });

  /* whether the panes stand below one another, as in view.css */
  const narrow = () => window.matchMedia("(max-width: 43rem)").matches;

  return { ask, at, breakable, busy, complain, duration, end, explained, listen: (f) => listeners.push(f), narrow, percentage, progressText, pulse, sentence, tabs, turn, undoable, GLOSSARY };
})();
