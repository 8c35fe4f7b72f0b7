"use strict";
/* Common to both parts of the page: requests, errors, switching between the parts. */
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
    const out = text.charAt(0).toUpperCase() + text.slice(1);
    return /[.!?]$/.test(out) ? out : out + ".";
  }

  function complain(error) {
    at("error").textContent = error ? error.message : "";
    at("error").hidden = !error;
  }

  const GLOSSARY = [
    ["residual", "Measured minus modelled value."],
    ["lack of fit", "Deviation of the model from the data beyond noise."],
    ["unmodelled torque", "Difference between the torque required by the data and the model [N m], without assuming a law."],
    ["candidate effect", "A law of the library that could be missing from the model."],
    ["nuisance parameter", "A parameter of the measurement (camera centre, tilt, shutter) that is fitted with every model."],
    ["\u03c3", "Standard uncertainty; for a residual, that of the noise."],
    ["rms", "Root mean square; of the residual in units of its noise, 1 is the noise limit."],
    ["\u03c7\u00b2/n", "Reduced chi-square: mean square of the residual in units of the noise; 1 is the noise limit."],
    ["score", "Decrease of the deviance if the effect is added; its square root is about the significance in \u03c3."],
    ["\u0394BIC", "Change of the Bayesian information criterion; negative favours the added effect."],
    ["p", "Probability of such a score anywhere in the list if no effect is missing (family-wise)."],
    ["cross-validation error", "Error on data that were left out of the fit, in units of the noise."],
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

  return { ask, at, complain, explained, sentence, turn, GLOSSARY };
})();
