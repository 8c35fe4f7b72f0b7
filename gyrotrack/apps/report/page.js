"use strict";
/* The boards of the report: one for each case, from the data that the page carries. */
(() => {
  const boards = JSON.parse(document.getElementById("boards").textContent);
  boards.forEach((board, i) => {
    const root = document.getElementById(`board${i}`);
    if (root) new Charts.Board(root, board);
  });
})();
