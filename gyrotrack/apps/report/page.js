"use strict";
/* The report: a dashboard is drawn when its part is first opened; a link opens its target; all parts are open in print. */
(() => {
  const boards = JSON.parse(document.getElementById("dashboards").textContent);
  const drawn = new Map();
  const rpm = document.getElementById("rpm");
  const PER_RAD = 60 / (2 * Math.PI);
  const parts = [...document.querySelectorAll("details.part")];
  const expand = document.getElementById("expand");

  function draw() {
    boards.forEach((board, i) => {
      const root = document.getElementById(`board${i}`);
      if (!root || drawn.has(i)) return;
      drawn.set(i, new Charts.Board(root, shown(board)));
    });
  }

  /* A speed in rpm: values are integers with scale and offset, and milli-units become units. */
  function inRpm(chart) {
    const prefix = /^([mµn]?)rad\/s$/.exec(chart.unit);
    if (!prefix) return chart;
    const factor = PER_RAD * { "": 1, m: 1e-3, "µ": 1e-6, n: 1e-9 }[prefix[1]];
    const changed = (v) => v && { ...v, scale: factor * v.scale, offset: factor * v.offset };
    const traces = chart.traces.map((t) => ({ ...t, value: changed(t.value), ...(t.sigma ? { sigma: changed(t.sigma) } : {}) }));
    return { ...chart, unit: "rpm", traces };
  }

  function shown(board) {
    return rpm.getAttribute("aria-pressed") === "true" ? { ...board, charts: board.charts.map(inRpm) } : board;
  }

  rpm.addEventListener("click", () => {
    rpm.setAttribute("aria-pressed", String(rpm.getAttribute("aria-pressed") !== "true"));
    for (const [i, board] of drawn) board.set(shown(boards[i]));
  });

  function reveal() {
    const part = location.hash && document.getElementById(location.hash.slice(1))?.closest("details.part");
    if (part) { part.open = true; part.scrollIntoView(); }
  }

  document.getElementById("run").addEventListener("toggle", (event) => { if (event.target.open) draw(); });
  addEventListener("hashchange", reveal);
  addEventListener("beforeprint", () => { for (const p of parts) p.open = true; });
  expand.addEventListener("click", () => {
    const open = parts.some((p) => !p.open);
    for (const p of parts) p.open = open;
    expand.textContent = open ? "Collapse all" : "Expand all";
  });
  reveal();
})();
