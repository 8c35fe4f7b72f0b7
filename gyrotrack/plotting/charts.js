"use strict";
/* Charts of long curves on one time axis.
 *
 * Of a curve with more points than the screen has columns, M4 keeps in each column the first, the last, the
 * lowest and the highest point: the line drawn through them is the one drawn through all points, so that no peak
 * is lost (U. Jugel, Z. Jerzak, G. Hackenbroich, V. Markl, Proc. VLDB Endow. 7, 797 (2014)).
 * Names from files only ever become text nodes.
 */
const Charts = (() => {
  const LEFT = 66, RIGHT = 10, TOP = 6, BOTTOM = 20;
  const FONT = "12px system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";
  const NONE = -32768;

  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }

  function column(packed) {
    const out = new Float64Array(packed.count);
    if ("step" in packed) {
      for (let i = 0; i < out.length; i++) out[i] = packed.start + i * packed.step;
    } else if ("floats" in packed) {
      out.set(new Float32Array(bytes(packed.floats)));
    } else {
      const steps = new Int16Array(bytes(packed.steps));
      for (let i = 0; i < out.length; i++) {
        out[i] = steps[i] === NONE ? NaN : packed.offset + steps[i] * packed.scale;
      }
    }
    return out;
  }

  /* the first place whose time is not before t */
  function place(time, t) {
    let low = 0, high = time.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time[middle] < t) low = middle + 1; else high = middle;
    }
    return low;
  }

  /* the points of a curve that show in [from, to] on so many columns; a gap keeps one point that is no number */
  function m4(time, value, from, to, columns) {
    const first = Math.max(0, place(time, from) - 1), last = Math.min(time.length - 1, place(time, to));
    const kept = [];
    if (last - first <= 4 * columns) {
      for (let i = first; i <= last; i++) kept.push(i);
      return kept;
    }
    const width = (to - from) / columns;
    let i = first;
    while (i <= last) {
      const bin = Math.floor((time[i] - from) / width);
      const begin = i;
      let low = -1, high = -1, gap = -1;
      for (; i <= last && Math.floor((time[i] - from) / width) === bin; i++) {
        const y = value[i];
        if (Number.isNaN(y)) { gap = i; continue; }
        if (low < 0 || y < value[low]) low = i;
        if (high < 0 || y > value[high]) high = i;
      }
      const chosen = [begin, i - 1];
      if (low >= 0) chosen.push(low, high);
      if (gap >= 0) chosen.push(gap);
      chosen.sort((a, b) => a - b);
      for (const c of chosen) if (kept[kept.length - 1] !== c) kept.push(c);
    }
    return kept;
  }

  function ticks(low, high, most) {
    const rough = (high - low) / Math.max(1, most);
    if (!(rough > 0) || !Number.isFinite(rough)) return { values: [low], places: 2 };
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough * 0.999);
    const values = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(k * step);
    return { values, places: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }

  function number(x, places) {
    if (places > 6) return x.toExponential(1);
    return (Object.is(Math.round(x * 10 ** places), -0) ? 0 : x).toFixed(places).replace("-", "\u2212");
  }

  /* four digits for the value below the pointer, or as many as are asked for */
  function told(x, digits = 4) {
    if (!Number.isFinite(x)) return "\u2013";
    const size = Math.abs(x);
    if (size === 0 || (size >= 1e-3 && size < 1e5)) {
      return String(Number(x.toPrecision(digits))).replace("-", "\u2212");
    }
    const [mantissa, power] = x.toExponential(digits - 1).split("e");
    const raised = [...String(Number(power))].map((c) => c === "-" ? "\u207b" : "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"[c]);
    return `${mantissa.replace("-", "\u2212")}\u00a0\u00d7\u00a010${raised.join("")}`;
  }

  function element(name, attributes = {}, ...children) {
    const out = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) out.setAttribute(key, value);
    out.append(...children);
    return out;
  }

  function swatch(trace) {
    const space = "http://www.w3.org/2000/svg";
    const svg = document.createElementNS(space, "svg");
    svg.setAttribute("viewBox", "0 0 22 10");
    svg.setAttribute("aria-hidden", "true");
    const shape = document.createElementNS(space, trace.kind === "band" ? "rect" : "line");
    const at = trace.kind === "band"
      ? { x: 0, y: 0, width: 22, height: 10, fill: trace.colour, opacity: 0.5 }
      : { x1: 0, x2: 22, y1: 5, y2: 5, stroke: trace.colour, "stroke-width": Math.min(5, trace.width + 0.7),
          "stroke-dasharray": trace.dash.join(" ") };
    for (const [key, value] of Object.entries(at)) shape.setAttribute(key, value);
    svg.append(shape);
    return svg;
  }

  class Panel {
    constructor(board, chart) {
      this.board = board;
      this.canvas = element("canvas", { role: "img" });
      this.head = element("p", { class: "head" });
      this.root = element("figure", { class: "panel" }, this.head, this.canvas);
      this.set(chart);
      this.listen();
    }

    set(chart) {
      this.chart = chart;
      this.canvas.setAttribute("aria-label", `${chart.title}. ${chart.finding}`);
      this.traces = chart.traces.map((t) => ({
        ...t, time: column(t.time), value: column(t.value), sigma: t.sigma ? column(t.sigma) : null,
      }));
      this.values = this.traces.map(() => element("span"));
      this.head.replaceChildren(element("b", {}, `${chart.title} [${chart.axis}]`), ...this.traces.map((t, i) =>
        element("span", { class: "key" }, swatch(t), t.label, " ", this.values[i])));
    }

    listen() {
      const at = (event) => {
        const box = this.canvas.getBoundingClientRect();
        return this.board.time((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT));
      };
      this.canvas.addEventListener("pointerdown", (event) => {
        if (event.button !== 0) return;
        this.canvas.setPointerCapture(event.pointerId);
        this.board.chosen = [at(event), at(event)];
        this.begin = event.clientX;
      });
      this.canvas.addEventListener("pointermove", (event) => {
        this.board.pointer = at(event);
        if (this.board.chosen && this.begin !== undefined) this.board.chosen[1] = at(event);
        this.board.ask();
      });
      this.canvas.addEventListener("pointerleave", () => { this.board.pointer = null; this.board.ask(); });
      this.canvas.addEventListener("pointerup", (event) => {
        const chosen = this.board.chosen;
        this.board.chosen = null;
        if (this.begin === undefined || !chosen) return;
        const far = Math.abs(event.clientX - this.begin) > 4;
        this.begin = undefined;
        if (far) this.board.show(Math.min(...chosen), Math.max(...chosen));
        else if (this.board.options.click) this.board.options.click(at(event), this.chart.name);
        this.board.ask();
      });
      this.canvas.addEventListener("pointercancel", () => { this.board.chosen = null; this.begin = undefined; });
      this.canvas.addEventListener("dblclick", () => this.board.show(...this.board.whole));
    }

    draw() {
      const box = this.canvas.getBoundingClientRect();
      if (box.width < LEFT + RIGHT + 20) return;
      const dense = window.devicePixelRatio || 1;
      const width = Math.round(box.width * dense), height = Math.round(box.height * dense);
      if (this.canvas.width !== width || this.canvas.height !== height) {
        this.canvas.width = width;
        this.canvas.height = height;
      }
      const g = this.canvas.getContext("2d");
      g.setTransform(dense, 0, 0, dense, 0, 0);
      g.clearRect(0, 0, box.width, box.height);
      const w = box.width - LEFT - RIGHT, h = box.height - TOP - BOTTOM;
      const [from, to] = this.board.range;
      const kept = this.traces.map((t) => m4(t.time, t.value, from, to, Math.ceil(w * dense)));
      const [low, high] = this.limits(kept, from, to);
      const x = (t) => LEFT + (t - from) / (to - from) * w;
      const y = (v) => TOP + (high - v) / (high - low) * h;
      g.save();
      g.beginPath();
      g.rect(LEFT, TOP, w, h);
      g.clip();
      g.fillStyle = "#f9f2a8";
      for (const m of this.board.marks) g.fillRect(x(m.start), TOP, Math.max(1.5, x(m.stop) - x(m.start)), h);
      g.restore();
      this.axes(g, x, y, from, to, low, high, w, h);
      g.save();
      g.beginPath();
      g.rect(LEFT, TOP, w, h);
      g.clip();
      this.traces.forEach((t, i) => this.trace(g, t, kept[i], x, y));
      if (this.board.cursor !== null) {
        g.strokeStyle = "#000"; g.lineWidth = 1.5;
        g.beginPath(); g.moveTo(x(this.board.cursor), TOP); g.lineTo(x(this.board.cursor), TOP + h); g.stroke();
      }
      if (this.board.chosen) {
        const [a, b] = this.board.chosen.map(x);
        g.fillStyle = "rgba(0, 114, 178, 0.18)";
        g.fillRect(Math.min(a, b), TOP, Math.abs(b - a), h);
      }
      if (this.board.pointer !== null) {
        g.strokeStyle = "#555"; g.lineWidth = 1; g.setLineDash([3, 3]);
        g.beginPath(); g.moveTo(x(this.board.pointer), TOP); g.lineTo(x(this.board.pointer), TOP + h); g.stroke();
      }
      g.restore();
      this.read();
    }

    limits(kept, from, to) {
      let low = Infinity, high = -Infinity;
      this.traces.forEach((t, k) => {
        if (t.beside) return;
        for (const i of kept[k]) {
          if (Number.isNaN(t.value[i]) || t.time[i] < from || t.time[i] > to) continue;
          const edge = t.kind === "band" && t.sigma ? 2 * t.sigma[i] : 0;
          low = Math.min(low, t.value[i] - edge);
          high = Math.max(high, t.value[i] + edge);
        }
      });
      if (!(low <= high)) return [-1, 1];
      const room = 0.07 * (high - low) || Math.abs(high) * 0.05 || 1;
      return [low - room, high + room];
    }

    axes(g, x, y, from, to, low, high, w, h) {
      g.font = FONT;
      g.lineWidth = 1;
      const across = ticks(from, to, w / 95), up = ticks(low, high, h / 22);
      g.strokeStyle = "#e3e4e8";
      g.beginPath();
      for (const v of across.values) { const p = Math.round(x(v)) + 0.5; g.moveTo(p, TOP); g.lineTo(p, TOP + h); }
      for (const v of up.values) { const p = Math.round(y(v)) + 0.5; g.moveTo(LEFT, p); g.lineTo(LEFT + w, p); }
      g.stroke();
      if (low < 0 && high > 0) {
        g.strokeStyle = "#777";
        g.beginPath(); g.moveTo(LEFT, y(0)); g.lineTo(LEFT + w, y(0)); g.stroke();
      }
      g.strokeStyle = "#444";
      g.beginPath(); g.moveTo(LEFT, TOP); g.lineTo(LEFT, TOP + h); g.lineTo(LEFT + w, TOP + h); g.stroke();
      g.fillStyle = "#3a3b40";
      g.textAlign = "center"; g.textBaseline = "top";
      across.values.forEach((v, i) => {
        if (x(v) < LEFT + w - 14 || !i) g.fillText(number(v, across.places), x(v), TOP + h + 4);
      });
      g.textAlign = "right";
      g.fillText("s", LEFT + w, TOP + h + 4);
      g.textBaseline = "middle";
      for (const v of up.values) g.fillText(number(v, up.places), LEFT - 5, y(v));
    }

    trace(g, t, kept, x, y) {
      if (t.sigma) {
        g.globalAlpha = t.kind === "band" ? 0.5 : 0.22;
        g.fillStyle = t.colour;
        this.runs(t, kept, (run) => {
          g.beginPath();
          run.forEach((i, n) => g[n ? "lineTo" : "moveTo"](x(t.time[i]), y(t.value[i] + 2 * t.sigma[i])));
          for (let n = run.length - 1; n >= 0; n--) g.lineTo(x(t.time[run[n]]), y(t.value[run[n]] - 2 * t.sigma[run[n]]));
          g.fill();
        });
        g.globalAlpha = 1;
      }
      if (t.kind === "band") return;
      g.strokeStyle = t.colour;
      g.fillStyle = t.colour;
      g.lineWidth = t.width;
      g.lineJoin = "round";
      g.setLineDash(t.dash);
      this.runs(t, kept, (run) => {
        g.beginPath();
        run.forEach((i, n) => g[n ? "lineTo" : "moveTo"](x(t.time[i]), y(t.value[i])));
        g.stroke();
        if (run.length === 1 || (t.kind === "points" && run.length < 400)) {
          for (const i of run) { g.beginPath(); g.arc(x(t.time[i]), y(t.value[i]), 2.1, 0, 7); g.fill(); }
        }
      });
      g.setLineDash([]);
    }

    runs(t, kept, use) {
      let run = [];
      for (const i of kept) {
        if (Number.isNaN(t.value[i]) || (t.sigma && Number.isNaN(t.sigma[i]))) {
          if (run.length) use(run);
          run = [];
        } else run.push(i);
      }
      if (run.length) use(run);
    }

    read() {
      const t = this.board.pointer;
      this.traces.forEach((trace, k) => {
        let text = "";
        if (t !== null && trace.kind !== "band" && trace.time.length) {
          let i = Math.min(place(trace.time, t), trace.time.length - 1);
          if (i > 0 && t - trace.time[i - 1] < trace.time[i] - t) i--;
          text = told(trace.value[i]);
        }
        if (this.values[k].textContent !== text) this.values[k].textContent = text;
      });
    }
  }

  class Board {
    constructor(root, board, options = {}) {
      this.root = root;
      this.options = options;
      this.pointer = this.chosen = this.cursor = null;
      this.marks = [];
      root.classList.add("board");
      this.buttons = element("span", { class: "marks" });
      this.shown = element("p", { class: "shown", role: "status" });
      this.tools = element("div", { class: "tools", role: "group", "aria-label": "zoom of all plots" });
      const button = (text, label, act) => {
        const out = element("button", { type: "button", "aria-label": label, title: label }, text);
        out.addEventListener("click", act);
        return out;
      };
      this.tools.append(
        button("whole run", "show the whole run", () => this.show(...this.whole)),
        button("+", "zoom in", () => this.scale(0.5)), button("\u2212", "zoom out", () => this.scale(2)),
        button("\u25c0", "earlier", () => this.move(-0.4)), button("\u25b6", "later", () => this.move(0.4)),
        this.buttons, this.shown);
      this.makeButton = button;
      this.body = element("div");
      root.replaceChildren(this.tools, this.body);
      this.panels = [];
      this.set(board);
      new ResizeObserver(() => this.ask()).observe(this.body);
    }

    set(board) {
      const kept = this.range;
      board.charts.forEach((chart, i) => {
        if (this.panels[i]) this.panels[i].set(chart);
        else { this.panels[i] = new Panel(this, chart); this.body.append(this.panels[i].root); }
      });
      for (const old of this.panels.splice(board.charts.length)) old.root.remove();
      let low = Infinity, high = -Infinity;
      for (const p of this.panels) for (const t of p.traces) if (t.time.length) {
        low = Math.min(low, t.time[0]); high = Math.max(high, t.time[t.time.length - 1]);
      }
      this.whole = low < high ? [low, high] : [0, 1];
      this.marks = board.marks;
      this.buttons.replaceChildren(...board.marks.map((m) => {
        const out = this.makeButton(m.text, `show the failing stretch ${m.text}`, () => {
          const room = Math.max(0.5 * (m.stop - m.start), 0.005 * (this.whole[1] - this.whole[0]));
          this.show(m.start - room, m.stop + room);
          if (this.options.stretch) this.options.stretch(m.start, m.stop);
        });
        out.className = "mark";
        return out;
      }));
      this.show(...(kept || this.whole));
    }

    time(share) { return this.range[0] + Math.min(1, Math.max(0, share)) * (this.range[1] - this.range[0]); }

    show(from, to) {
      const [low, high] = this.whole;
      const least = 1e-5 * (high - low);
      from = Math.max(low, from); to = Math.min(high, to);
      if (!(to - from > least)) return;
      this.range = [from, to];
      const text = `shown: ${told(from)} s to ${told(to)} s`;
      if (this.shown.textContent !== text) this.shown.textContent = text;
      this.ask();
    }

    scale(factor) {
      const middle = 0.5 * (this.range[0] + this.range[1]), half = 0.5 * factor * (this.range[1] - this.range[0]);
      this.show(middle - half, middle + half);
    }

    move(share) {
      const width = this.range[1] - this.range[0];
      let from = this.range[0] + share * width;
      from = Math.min(Math.max(from, this.whole[0]), this.whole[1] - width);
      this.show(from, from + width);
    }

    setCursor(time) { this.cursor = time; this.ask(); }

    ask() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => { this.waiting = false; for (const p of this.panels) p.draw(); });
    }
  }

  return { Board, element, told, m4, column };
})();
