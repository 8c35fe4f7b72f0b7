"use strict";
/* The report: a dashboard is drawn when its part is first opened; a link opens its target; all parts are open in print. */
(() => {
  const boards = JSON.parse(document.getElementById("dashboards").textContent);
  const drawn = new Set();
  const parts = [...document.querySelectorAll("details.part")];
  const expand = document.getElementById("expand");

  function draw() {
    boards.forEach((board, i) => {
      const root = document.getElementById(`board${i}`);
      if (!root || drawn.has(i)) return;
      drawn.add(i);
      new Charts.Board(root, board);
    });
  }

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
