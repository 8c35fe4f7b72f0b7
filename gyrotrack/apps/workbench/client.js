"use strict";
/* What both parts of the page share: requests, errors, and which part is shown. */
const Page = (() => {
  const token = new URLSearchParams(location.search).get("token") || "";
  const at = (id) => document.getElementById(id);

  async function ask(path, body) {
    const options = { headers: { "x-gyrotrack-token": token } };
    if (body !== undefined) {
      options.method = "POST";
      options.body = body instanceof Blob ? body : JSON.stringify(body);
    }
    let answer;
    try {
      answer = await fetch(path, options);
    } catch {
      throw new Error("No answer from the program. Start gyrotrack view again if it has ended.");
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
    const out = text.charAt(0).toUpperCase() + text.slice(1);
    return /[.!?]$/.test(out) ? out : out + ".";
  }

  function complain(error) {
    at("error").textContent = error ? error.message : "";
    at("error").hidden = !error;
  }

  /* show a part of the page: "films" or "laboratory" */
  function turn(part) {
    for (const name of ["films", "laboratory"]) {
      if (at(name)) at(name).hidden = name !== part;
      const tab = at(`tab-${name}`);
      if (tab && name === part) tab.setAttribute("aria-current", "page"); else if (tab) tab.removeAttribute("aria-current");
    }
    document.body.dataset.part = part;
    window.scrollTo(0, 0);
    window.dispatchEvent(new Event("resize"));
  }

  return { ask, at, complain, sentence, turn };
})();
