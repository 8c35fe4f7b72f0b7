"use strict";
/* The guided tour: eight steps, each beside the part of the page that it explains. */
(() => {
  const { at } = Page;
  const STEPS = [
    { at: "step-sources", part: "films", title: "Add the films", text: "Drop the films of one run here: one of the casing, and some of the rotor. With the sample clips you can try everything at once. The capture rate of each film is needed, because slow-motion files declare another one." },
    { at: "marking", part: "films", title: "Look at the film", text: "Click on the name of a film to see it. If its markers are not those of the paper, click on the hub and on each marker; the first frames are then tracked as a preview." },
    { at: "analyse", part: "films", title: "Analyse everything", text: "One click tracks all films, puts them on one clock, and fits the model. Every step can be cancelled, and continues where it was." },
    { at: "moving", part: "films", title: "The motion", text: "Speed and angle of each film grow here while it is tracked. A wrong frame is seen as a spike: go to the frame, choose the correction of the marker, and click on its middle." },
    { at: "scale", part: "laboratory", title: "Does the model fit?", text: "The misfit compares the deviation of the model with the noise of the measurement. 1 is the noise limit: more means that something is missing from the model." },
    { at: "charts", part: "laboratory", title: "Where does it fail?", text: "Shaded are the times at which a torque is missing. A click on a chart shows the film at that time; the tabs show torques, residuals and uncertainties." },
    { at: "candidates", part: "laboratory", title: "What is missing?", text: "Each card is a law that could be missing. Point at one to see in all charts what it would change; a click fits it. Undo takes it back." },
    { at: "trust", part: "laboratory", title: "Can you believe it?", text: "Recordings like yours are simulated and analysed in the same way, to count false alarms. Then plan the run that would settle what is still open, and write the report." },
  ];
  let step = 0;

  function mark(element) {
    for (const e of document.querySelectorAll(".toured")) e.classList.remove("toured");
    element?.classList.add("toured");
    element?.scrollIntoView({ block: "nearest" });
  }

  function show(n) {
    step = Math.min(Math.max(0, n), STEPS.length - 1);
    const s = STEPS[step], can = document.body.dataset.part === s.part || (s.part === "films" ? at("films") : at("tab-laboratory") && !at("tab-laboratory").disabled);
    if (can && document.body.dataset.part !== s.part) at(`tab-${s.part}`).click();
    at("guide-title").textContent = s.title;
    at("guide-text").textContent = s.text + (can ? "" : s.part === "laboratory" ? " This part opens when a case is fitted." : " This part is shown by gyrotrack view without a case.");
    at("guide-count").textContent = `${step + 1} of ${STEPS.length}`;
    at("guide-back").disabled = step === 0;
    at("guide-on").textContent = step === STEPS.length - 1 ? "Done" : "Next";
    const place = at(s.at);
    mark(can && place && place.offsetParent !== null ? place : null);
    // on the other side of the page from what it explains
    at("guide").classList.toggle("right", can && place?.getBoundingClientRect().left < 0.3 * window.innerWidth);
    if (!at("guide").open) at("guide").show();
    at("guide-on").focus();
  }

  function end() { at("guide").close(); mark(null); at("tour").focus(); }

  at("tour").addEventListener("click", () => show(document.body.dataset.part === "films" ? 0 : 4));
  at("guide-back").addEventListener("click", () => show(step - 1));
  at("guide-on").addEventListener("click", () => { if (step === STEPS.length - 1) end(); else show(step + 1); });
  at("guide-end").addEventListener("click", end);
  at("guide").addEventListener("keydown", (event) => { if (event.key === "Escape") { event.preventDefault(); end(); } });
})();
