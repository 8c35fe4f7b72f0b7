"use strict";
/* Dashboards of charts on one time axis, drawn by uPlot: common zoom and cursor, legend switches, shaded intervals
 * in which the model fails, keyboard, and export. Names from files only ever become text nodes. */
const Charts = (() => {
  const NONE = -32768, HEIGHT = 170, GRIP = 6;
  const DARK = { "#0072b2": "#56b4e9", "#d55e00": "#ff8f4a", "#009e73": "#35c79a", "#cc79a7": "#e39cc4", "#000000": "#f2f2f2",
    "#555555": "#b9b9b9", "#56b4e9": "#8fd0f5", "#e69f00": "#f0b429" };
  const dark = matchMedia("(prefers-color-scheme: dark)");

  function element(name, attributes = {}, ...children) {
    const out = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) out.setAttribute(key, value);
    out.append(...children);
    return out;
  }

  function button(text, label, work) {
    const out = element("button", { type: "button", "aria-label": label, title: label }, text);
    out.addEventListener("click", work);
    return out;
  }

  /* a number with four digits, or as many as are wanted */
  function format(x, digits = 4) {
    if (x === null || x === undefined || !Number.isFinite(x)) return "\u2013";
    const size = Math.abs(x);
    if (size === 0 || (size >= 1e-3 && size < 1e5)) return String(Number(x.toPrecision(digits))).replace("-", "\u2212");
    const [mantissa, power] = x.toExponential(digits - 1).split("e");
    const raised = [...String(Number(power))].map((c) => c === "-" ? "\u207b" : "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"[c]);
    return `${mantissa.replace("-", "\u2212")}\u00a0\u00d7\u00a010${raised.join("")}`;
  }

  /* a value with as many digits as its standard uncertainty allows: 3.398 \u00b1 0.017 */
  function uncertain(value, u) {
    if (!(u > 0) || !Number.isFinite(u)) return format(value, 4);
    const leading = Math.floor(Math.log10(u)), digits = -leading + (u / 10 ** leading < 2.95 ? 1 : 0);
    const power = Math.floor(Math.log10(Math.max(Math.abs(value), u)));
    const fixed = (x, n) => {
      const r = 10 ** Math.max(0, -n);
      return (n < 0 ? Math.round(x / r) * r : x).toFixed(Math.min(20, Math.max(0, n))).replace("-", "\u2212");
    };
    if (power > -3 && power < 5) return `${fixed(value, digits)} \u00b1 ${fixed(u, digits)}`;
    const raised = [...String(power)].map((c) => c === "-" ? "\u207b" : "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"[c]).join("");
    return `(${fixed(value / 10 ** power, digits + power)} \u00b1 ${fixed(u / 10 ** power, digits + power)})\u00a0\u00d7\u00a010${raised}`;
  }

  /* a unit with raised exponents: rad/s2 becomes rad/s² */
  const unit = (text) => text.replace(/(?<=[a-z])-?\d(?![\w.])/gi, (m) => [...m].map((c) => c === "-" ? "\u207b" : "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"[c]).join(""));

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

  /* numbers as the program packs them; nan becomes null */
  function column(packed) {
    const out = new Array(packed.count);
    if ("step" in packed) for (let i = 0; i < out.length; i++) out[i] = packed.start + i * packed.step;
    else if ("floats" in packed) {
      const read = new Float32Array(bytes(packed.floats));
      for (let i = 0; i < out.length; i++) out[i] = packed.first + read[i];
    } else {
      const read = new Int16Array(bytes(packed.steps));
      for (let i = 0; i < out.length; i++) out[i] = read[i] === NONE ? null : packed.offset + read[i] * packed.scale;
    }
    return out;
  }

  /* The vertical scale of what is visible within [from, to]: reference traces, else all normal ones, set the height;
   * everything else, bands included, widens it by at most that height. Hidden traces have no influence. */
  function limits(traces, from, to) {
    const range = (list, band) => {
      let low = Infinity, high = -Infinity;
      for (const t of list) {
        for (let i = 0; i < t.x.length; i++) {
          const v = t.value[i];
          if (v === null || t.x[i] < from || t.x[i] > to) continue;
          const edge = band && t.sigma && t.sigma[i] !== null ? 2 * t.sigma[i] : 0;
          if (v - edge < low) low = v - edge;
          if (v + edge > high) high = v + edge;
        }
      }
      return [low, high];
    };
    const shown = traces.filter((t) => t.shown && t.scale !== "none");
    const curves = shown.filter((t) => t.kind !== "band");
    const reference = curves.filter((t) => t.scale === "reference");
    const [low, high] = range(reference.length ? reference : curves, false);
    let [least, most] = range(shown, true);
    const height = high - low;
    if (height > 0) { least = Math.max(least, low - height); most = Math.min(most, high + height); }
    if (!(least <= most)) return [-1, 1];
    const room = 0.06 * (most - least) || Math.abs(most) * 0.05 || 1;
    return [least - room, most + room];
  }

  function theme() {
    const style = getComputedStyle(document.documentElement);
    const read = (name, other) => style.getPropertyValue(name).trim() || other;
    return { ink: read("--ink", "#1b1b1f"), grid: read("--grid", "#e3e4e8"), failing: read("--failing", "#f9f2a8"),
      paper: read("--paper", "#ffffff"), soft: read("--soft", "#55575d") };
  }

  const shade = (colour) => dark.matches ? DARK[colour.toLowerCase()] || colour : colour;
  const faded = (colour, share) => colour + Math.round(255 * share).toString(16).padStart(2, "0");

  function save(blob, name) {
    const link = element("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  class Panel {
    constructor(board, chart) {
      this.board = board;
      this.head = element("div", { class: "head" });
      this.plot = element("div", { class: "plot", role: "img" });
      this.root = element("figure", { class: "panel" }, this.head, this.plot);
      this.hidden = new Set();
      this.extra = [];
      this.set(chart);
    }

    set(chart) {
      this.chart = chart;
      this.plot.setAttribute("aria-label", `${chart.title}. ${chart.finding}`);
      this.traces = chart.traces.map((t) => ({ ...t, x: column(t.x), value: column(t.value),
        sigma: t.sigma ? column(t.sigma) : null, shown: !this.hidden.has(t.label) }));
      this.values = this.traces.map(() => element("span"));
      const keys = this.traces.map((t, i) => {
        const swatch = element("span", { class: t.kind === "band" ? "swatch band" : "swatch", "aria-hidden": "true" });
        const colour = shade(t.colour);
        if (t.kind === "band") swatch.style.background = colour; else swatch.style.borderTopColor = colour;
        if (t.dash.length) swatch.style.borderTopStyle = "dashed";
        const key = button("", `${t.label}: show or hide`, () => this.toggle(i));
        key.className = "key";
        key.setAttribute("aria-pressed", String(t.shown));
        key.append(swatch, t.label, " ", this.values[i]);
        key.removeAttribute("aria-label");
        return key;
      });
      this.keys = keys;
      const title = chart.title.charAt(0).toUpperCase() + chart.title.slice(1);
      this.head.replaceChildren(element("b", { title: chart.caption || chart.finding }, `${title} [${chart.unit}]${chart.is_time ? "" : `, against ${chart.x_label}`}`), ...keys, this.saving());
      this.build();
    }

    saving() {
      const name = this.chart.name;
      const out = element("details", { class: "save" }, element("summary", { "aria-label": `save ${this.chart.title}` }, "save"),
        element("div", {}, button("PNG", `save ${name} as PNG`, () => this.png()), button("SVG", `save ${name} as SVG`, () => this.svg()),
          button("CSV", `save ${name} as CSV`, () => this.csv())));
      return out;
    }

    toggle(i) {
      const t = this.traces[i];
      t.shown = !t.shown;
      if (t.shown) this.hidden.delete(t.label); else this.hidden.add(t.label);
      this.keys[i].setAttribute("aria-pressed", String(t.shown));
      for (const s of this.series[i]) this.u.setSeries(s, { show: t.shown });
      this.rescale();
    }

    build() {
      if (this.u) this.u.destroy();
      const look = theme(), tables = [], series = [{}], bands = [];
      this.series = [];
      let next = 1;
      for (const t of this.traces) {
        const colour = shade(t.colour), mine = [], table = [t.x];
        if (t.sigma) {
          const edge = (f) => t.value.map((v, i) => v === null || t.sigma[i] === null ? null : v + f * t.sigma[i]);
          table.push(edge(2), edge(-2));
          for (let k = 0; k < 2; k++) series.push({ stroke: "transparent", width: 0, points: { show: false }, show: t.shown });
          bands.push({ series: [next, next + 1], fill: faded(colour, t.kind === "band" ? 0.45 : 0.22) });
          mine.push(next, next + 1);
          next += 2;
        }
        if (t.kind !== "band") {
          table.push(t.value);
          series.push({ stroke: colour, width: t.width, dash: t.dash, show: t.shown,
            points: t.kind === "points" ? { show: t.x.length < 300, size: 4, fill: colour, width: 0 } : { show: false } });
          mine.push(next);
          t.at = next++;
        }
        this.series.push(mine);
        tables.push(table);
      }
      const axis = (more) => ({ stroke: look.ink, grid: { stroke: look.grid, width: 1 }, ticks: { stroke: look.grid, size: 4, width: 1 },
        font: "12px system-ui, 'DejaVu Sans', sans-serif", ...more });
      const number = (u, splits) => splits.map((v) => format(v, 6));
      const own = this.chart.is_time;
      const options = {
        width: Math.max(200, this.plot.clientWidth || 600), height: this.board.height(), series, bands, padding: [8, 10, 0, 0],
        legend: { show: false },
        cursor: { drag: { x: true, y: false, setScale: false }, sync: own ? { key: this.board.key } : undefined, points: { size: 6 },
          bind: { mousedown: (u, target, zoom) => (event) => { if (!this.overLine(event)) zoom(event); return null; }, dblclick: () => () => { this.board.show(...this.board.whole); if (!own) this.local = null; this.rescale(); return null; } } },
        scales: { x: { time: false, range: () => this.xRange() }, y: { range: () => limits([...this.traces, ...this.extra], ...this.xRange()) } },
        axes: [axis({ size: 30, values: own ? (u, splits) => number(u, splits).map((v) => `${v} s`) : number }), axis({ size: 62, values: number })],
        hooks: {
          drawClear: [(u) => this.shadeIntervals(u, look)],
          draw: [(u) => this.drawExtra(u), (u) => this.drawCursor(u, look)],
          setSelect: [(u) => this.selected(u)],
          setCursor: [(u) => this.read(u)],
        },
      };
      this.u = new uPlot(options, uPlot.join(tables, tables.map((t) => t.map(() => 2))), this.plot);
      this.listen();
    }

    xRange() {
      if (this.chart.is_time) return this.board.range;
      if (this.local) return this.local;
      let low = Infinity, high = -Infinity;
      for (const t of this.traces) if (t.scale !== "none") for (const x of t.x) { if (x < low) low = x; if (x > high) high = x; }
      return low < high ? [low, high] : [0, 1];
    }

    rescale() { this.u.setData(this.u.data, true); }

    selected(u) {
      if (u.select.width < 4) return;
      const from = u.posToVal(u.select.left, "x"), to = u.posToVal(u.select.left + u.select.width, "x");
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      if (this.chart.is_time) this.board.show(from, to);
      else { this.local = [from, to]; this.rescale(); }
    }

    listen() {
      const over = this.u.over;
      let begin = null;
      const time = (event) => this.u.posToVal(event.clientX - over.getBoundingClientRect().left, "x");
      const use = (event) => { if (this.chart.is_time && this.board.options.click) this.board.options.click(time(event), this.chart.name); };
      const scrub = (event) => { event.preventDefault(); use(event); };
      over.addEventListener("mousedown", (event) => {
        if (event.button !== 0) return;
        begin = event.clientX;
        if (this.overLine(event)) {
          document.addEventListener("mousemove", scrub);
          document.addEventListener("mouseup", () => document.removeEventListener("mousemove", scrub), { once: true });
        }
      });
      over.addEventListener("mouseup", (event) => { if (begin !== null && Math.abs(event.clientX - begin) < 4) use(event); begin = null; });
      over.addEventListener("mousemove", (event) => {
        if (event.shiftKey && !event.buttons) use(event);
        over.style.cursor = this.overLine(event) ? "ew-resize" : "";
      });
      over.addEventListener("wheel", (event) => {
        if (!this.chart.is_time || !(event.ctrlKey || event.metaKey)) return;
        event.preventDefault();
        this.board.scale(event.deltaY > 0 ? 1.25 : 0.8, time(event));
      }, { passive: false });
    }

    /* whether the pointer is over the line of the shown moment, which can be dragged */
    overLine(event) {
      if (!this.chart.is_time || this.board.cursor === null || !this.board.options.click) return false;
      const x = this.u.valToPos(this.board.cursor, "x"), at = event.clientX - this.u.over.getBoundingClientRect().left;
      return Math.abs(x - at) <= GRIP;
    }

    shadeIntervals(u, look) {
      if (!this.chart.is_time) return;
      const g = u.ctx, { left, top, width, height } = u.bbox;
      g.save();
      g.beginPath(); g.rect(left, top, width, height); g.clip();
      g.fillStyle = look.failing;
      for (const m of this.board.intervals) {
        // a chart shows the intervals of its body
        if (this.board.options.body && m.body && this.chart.body && m.body !== this.chart.body) continue;
        const a = u.valToPos(m.start, "x", true), b = u.valToPos(m.stop, "x", true);
        g.fillRect(a, top, Math.max(2, b - a), height);
      }
      g.restore();
    }

    drawCursor(u, look) {
      const g = u.ctx, { left, top, width, height } = u.bbox, line = (x0, y0, x1, y1) => { g.beginPath(); g.moveTo(x0, y0); g.lineTo(x1, y1); g.stroke(); };
      g.save();
      g.setLineDash([]);
      const zero = u.valToPos(0, "y", true);
      if (zero > top && zero < top + height) { g.strokeStyle = look.soft; g.lineWidth = 1; line(left, zero, left + width, zero); }
      const t = this.board.cursor;
      if (this.chart.is_time && t !== null) {
        const x = u.valToPos(t, "x", true);
        g.strokeStyle = look.ink; g.lineWidth = 2 * devicePixelRatio;
        if (x >= left && x <= left + width) line(x, top, x, top + height);
      }
      g.restore();
    }

    /* curves that are only looked at: dashed, over the others, and no part of an export as numbers */
    drawExtra(u) {
      const g = u.ctx, { left, top, width, height } = u.bbox;
      g.save();
      g.beginPath(); g.rect(left, top, width, height); g.clip();
      g.lineWidth = 2.2 * devicePixelRatio;
      g.setLineDash([6 * devicePixelRatio, 3 * devicePixelRatio]);
      for (const t of this.extra) {
        g.strokeStyle = shade(t.colour);
        g.beginPath();
        let pen = false;
        t.x.forEach((x, i) => {
          const v = t.value[i];
          if (v === null) { pen = false; return; }
          const a = u.valToPos(x, "x", true), b = u.valToPos(v, "y", true);
          if (pen) g.lineTo(a, b); else g.moveTo(a, b);
          pen = true;
        });
        g.stroke();
      }
      g.restore();
    }

    /* the values of all traces at the cursor */
    read(u) {
      const x = u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null;
      this.traces.forEach((t, k) => {
        let text = "";
        if (x !== null && t.kind !== "band" && t.x.length) {
          let low = 0, high = t.x.length - 1;
          while (low < high) { const m = (low + high) >> 1; if (t.x[m] < x) low = m + 1; else high = m; }
          if (low > 0 && x - t.x[low - 1] < t.x[low] - x) low--;
          text = format(t.value[low]);
        }
        if (this.values[k].textContent !== text) this.values[k].textContent = text;
      });
    }

    resize() {
      const width = this.plot.clientWidth;
      const height = this.board.height();
      if (width > 100 && (Math.abs(width - this.u.width) > 1 || Math.abs(height - this.u.height) > 2)) this.u.setSize({ width, height });
    }

    file(kind) { return `${this.chart.name}.${kind}`; }

    csv() {
      const rows = [["curve", this.chart.is_time ? "time [s]" : this.chart.x_label, `value [${this.chart.unit}]`, `u [${this.chart.unit}]`]];
      const quote = (x) => /[",\n]/.test(x) ? `"${x.replaceAll('"', '""')}"` : x;
      const [from, to] = this.xRange();
      for (const t of this.traces) {
        if (!t.shown) continue;
        t.x.forEach((x, i) => { if (x >= from && x <= to && t.value[i] !== null) rows.push([t.label, x, t.value[i], t.sigma?.[i] ?? ""]); });
      }
      save(new Blob([rows.map((r) => r.map((c) => quote(String(c))).join(",")).join("\n") + "\n"], { type: "text/csv" }), this.file("csv"));
    }

    png() {
      const from = this.u.ctx.canvas, head = Math.round(22 * devicePixelRatio), look = theme();
      const out = element("canvas", { width: from.width, height: from.height + head }), g = out.getContext("2d");
      g.fillStyle = look.paper;
      g.fillRect(0, 0, out.width, out.height);
      g.fillStyle = look.ink;
      g.font = `bold ${Math.round(13 * devicePixelRatio)}px system-ui, sans-serif`;
      g.fillText(`${this.chart.title} [${this.chart.unit}]`, 10 * devicePixelRatio, 0.75 * head);
      g.drawImage(from, 0, head);
      out.toBlob((blob) => save(blob, this.file("png")));
    }

    svg() {
      const u = this.u, space = "http://www.w3.org/2000/svg", [from, to] = this.xRange(), look = theme();
      const make = (name, attributes, text) => {
        const out = document.createElementNS(space, name);
        for (const [k, v] of Object.entries(attributes)) out.setAttribute(k, v);
        if (text !== undefined) out.textContent = text;
        return out;
      };
      const ratio = devicePixelRatio, box = { x: u.bbox.left / ratio, y: u.bbox.top / ratio + 22, width: u.bbox.width / ratio, height: u.bbox.height / ratio };
      const X = (v) => (box.x + u.valToPos(v, "x")).toFixed(2), Y = (v) => (box.y + u.valToPos(v, "y")).toFixed(2);
      const root = make("svg", { xmlns: space, width: u.width, height: u.height + 22, "font-family": "sans-serif", "font-size": 11 });
      root.append(make("rect", { width: "100%", height: "100%", fill: look.paper }), make("text", { x: 10, y: 15, "font-weight": "bold", fill: look.ink }, `${this.chart.title} [${this.chart.unit}]`));
      const clip = make("clipPath", { id: "area" });
      clip.append(make("rect", box));
      root.append(clip);
      for (const [k, axis] of u.axes.entries()) {
        axis._splits.forEach((v, i) => {
          const at = k ? Y(v) : X(v), [x1, x2, y1, y2] = k ? [box.x, box.x + box.width, at, at] : [at, at, box.y, box.y + box.height];
          if (k ? at < box.y || at > box.y + box.height : at < box.x || at > box.x + box.width) return;
          root.append(make("line", { x1, x2, y1, y2, stroke: look.grid }), make("text", k ? { x: box.x - 5, y: Number(at) + 4, "text-anchor": "end", fill: look.ink }
            : { x: at, y: box.y + box.height + 16, "text-anchor": "middle", fill: look.ink }, axis._values[i] ?? ""));
        });
      }
      const area = make("g", { "clip-path": "url" + "(#area)", fill: "none" });
      for (const t of this.traces) {
        if (!t.shown) continue;
        const colour = shade(t.colour);
        let line = "", up = [], down = [], pen = false;
        const close = () => {
          if (up.length > 1) area.append(make("path", { d: `M${up.join("L")}L${down.reverse().join("L")}Z`, fill: colour, "fill-opacity": t.kind === "band" ? 0.45 : 0.22 }));
          up = []; down = []; pen = false;
        };
        t.x.forEach((x, i) => {
          const v = t.value[i], s = t.sigma?.[i];
          if (v === null || x < from || x > to) { close(); return; }
          line += `${pen ? "L" : "M"}${X(x)},${Y(v)}`;
          pen = true;
          if (s !== undefined && s !== null) { up.push(`${X(x)},${Y(v + 2 * s)}`); down.push(`${X(x)},${Y(v - 2 * s)}`); }
        });
        close();
        if (t.kind !== "band") area.append(make("path", { d: line, stroke: colour, "stroke-width": t.width, "stroke-dasharray": t.dash.join(" ") }));
      }
      root.append(area);
      save(new Blob([new XMLSerializer().serializeToString(root)], { type: "image/svg+xml" }), this.file("svg"));
    }
  }

  let boards = 0;

  class Board {
    constructor(root, board, options = {}) {
      this.root = root;
      this.options = options;
      this.cursor = null;
      this.key = `board${boards++}`;
      this.intervals = [];
      root.classList.add("board");
      this.marks = element("span", { class: options.body ? "marks row" : "marks" });
      this.shown = element("p", { class: "shown", role: "status" });
      const tools = element("div", { class: "tools", role: "group", "aria-label": "zoom of all charts" },
        button("whole run", "show the whole run", () => this.show(...this.whole)),
        button("+", "zoom in", () => this.scale(0.5)), button("\u2212", "zoom out", () => this.scale(2)),
        button("\u25c0", "earlier", () => this.move(-0.4)), button("\u25b6", "later", () => this.move(0.4)), this.marks, this.shown);
      this.body = element("div");
      root.replaceChildren(tools, this.body);
      root.addEventListener("keydown", (event) => this.pressed(event));
      this.panels = [];
      this.set(board);
      new ResizeObserver(() => { for (const p of this.panels) p.resize(); }).observe(this.body);
      dark.addEventListener("change", () => { for (const p of this.panels) p.set(p.chart); });
    }

    /* height of each chart [px] */
    height() { return this.options.height ? Math.round(Math.min(460, Math.max(112, this.options.height()))) : HEIGHT; }

    set(board) {
      // the whole run is shown until it is zoomed, also if it grows
      const kept = this.range && this.range[0] === this.whole[0] && this.range[1] === this.whole[1] ? null : this.range;
      let low = Infinity, high = -Infinity;
      for (const c of board.charts) if (c.is_time) for (const t of c.traces) {
        const x = column(t.x);
        if (x.length) { low = Math.min(low, x[0]); high = Math.max(high, x[x.length - 1]); }
      }
      this.whole = low < high ? [low, high] : [0, 1];
      this.range = kept || this.whole;
      this.intervals = board.intervals;
      board.charts.forEach((chart, i) => {
        if (this.panels[i]) this.panels[i].set(chart);
        else {
          this.panels[i] = new Panel(this, chart);
          this.body.append(this.panels[i].root);
          this.panels[i].resize();
        }
      });
      for (const old of this.panels.splice(board.charts.length)) old.root.remove();
      this.marks.replaceChildren(...board.intervals.map((m) => {
        const out = button(m.text, `show the interval ${m.text}, in which the model fails`, () => {
          const room = Math.max(0.5 * (m.stop - m.start), 0.005 * (this.whole[1] - this.whole[0]));
          this.show(m.start - room, m.stop + room);
          if (this.options.interval) this.options.interval(m.start, m.stop);
        });
        out.className = "mark";
        return out;
      }));
      this.show(...this.range);
    }

    /* show curves { chart: [{ x, value, colour }] } over the charts of these names, in SI units; nothing elsewhere */
    overlay(curves) {
      for (const p of this.panels) {
        const wanted = curves[p.chart.name] || [];
        if (!wanted.length && !p.extra.length) continue;
        const unit = p.chart.unit, factor = { p: 1e12, n: 1e9, u: 1e6, "\u00b5": 1e6, "\u03bc": 1e6, m: 1e3 }[/^[pnu\u00b5\u03bcm](?=rad|N)/.exec(unit)?.[0]] || 1;
        p.extra = wanted.map((c) => ({ ...c, shown: true, scale: "normal", kind: "line", value: c.value.map((v) => v === null ? null : v * factor) }));
        p.rescale();
      }
    }

    pressed(event) {
      if (event.target.closest("summary, input, select") || event.altKey || event.ctrlKey || event.metaKey) return;
      const acts = { ArrowLeft: () => this.move(-0.2), ArrowRight: () => this.move(0.2), "+": () => this.scale(0.5), "-": () => this.scale(2), Home: () => this.show(...this.whole) };
      if (acts[event.key]) { event.preventDefault(); acts[event.key](); }
    }

    show(from, to) {
      const [low, high] = this.whole;
      from = Math.max(low, from); to = Math.min(high, to);
      if (!(to - from > 1e-5 * (high - low))) return;
      this.range = [from, to];
      // a thousandth of the interval is as much as can be seen
      const places = Math.min(9, Math.max(0, 2 - Math.floor(Math.log10(to - from)))), rounded = (t) => format(Number(t.toFixed(places)), 12);
      const text = `shown: ${rounded(from)} s to ${rounded(to)} s`;
      if (this.shown.textContent !== text) this.shown.textContent = text;
      for (const p of this.panels) if (p.chart.is_time) p.rescale();
    }

    scale(factor, about = 0.5 * (this.range[0] + this.range[1])) {
      this.show(about - factor * (about - this.range[0]), about + factor * (this.range[1] - about));
    }

    move(share) {
      const width = this.range[1] - this.range[0];
      const from = Math.min(Math.max(this.range[0] + share * width, this.whole[0]), this.whole[1] - width);
      this.show(from, from + width);
    }

    setCursor(time) {
      this.cursor = time;
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => { this.waiting = false; for (const p of this.panels) if (p.chart.is_time) p.u.redraw(false); });
    }
  }

  return { Board, element, button, format, uncertain, unit, column, limits };
})();
