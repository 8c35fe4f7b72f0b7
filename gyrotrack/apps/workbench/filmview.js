"use strict";
/* One film: frame, steps, speed, zoom, and an overlay with thin lines that keep their width at every zoom. */
const FilmView = (() => {
  const { element } = Charts;
  const FOUND = "#3cff3c", PARTIAL = "#ffb000", HAND = "#ff7ad9", CENTRE = "#ffffff", PICKED = "#56b4e9", GHOST = "#7cf2ff";
  const MOST_ZOOM = 16, CLICK = 4;

  /* `options`: picture(index) and marks(index) ask the server; time(index) [s]; rate() frames a second; shown(index) and
   * picked([x, y] in px of the film) are called; extra(index) returns more to draw, as `marks` does */
  class FilmView {
    constructor(root, options) {
      this.options = options;
      const get = (role) => root.querySelector(`[data-role=${role}]`);
      this.canvas = get("canvas"); this.slider = get("slider"); this.text = get("text"); this.playing = get("play");
      this.speed = get("speed"); this.overlay = get("overlay"); this.ticks = get("ticks");
      this.index = 0; this.frames = 1; this.size = [4, 3]; this.zoom = 1; this.middle = [0.5, 0.5];
      this.image = null; this.marks = null; this.running = false; this.request = 0; this.loading = null; this.cross = null;
      get("back").addEventListener("click", () => this.step(-1));
      get("on").addEventListener("click", () => this.step(1));
      get("in").addEventListener("click", () => this.scale(1.6));
      get("out").addEventListener("click", () => this.scale(1 / 1.6));
      get("fit").addEventListener("click", () => this.scale(0));
      this.playing.addEventListener("click", () => { if (this.running) this.stop(); else this.play(); });
      this.slider.addEventListener("input", () => { this.stop(); this.show(Number(this.slider.value)); });
      this.overlay.addEventListener("change", () => this.draw());
      this.canvas.addEventListener("wheel", (event) => {
        if (!(event.ctrlKey || event.metaKey)) return;
        event.preventDefault();
        this.scale(event.deltaY > 0 ? 0.8 : 1.25, this.placeOf(event));
      }, { passive: false });
      this.canvas.addEventListener("pointerdown", (event) => this.pressed(event));
      this.canvas.addEventListener("keydown", (event) => this.typed(event));
      this.canvas.addEventListener("blur", () => this.draw());
      new ResizeObserver(() => this.draw()).observe(this.canvas.parentElement);
    }

    /* show a film from a frame on */
    open(frames, index = 0, size = null) {
      this.stop();
      this.frames = Math.max(1, frames); this.zoom = 1; this.middle = [0.5, 0.5]; this.cross = null;
      this.image = null; this.marks = null;
      if (size) this.size = size;
      return this.show(index);
    }

    setTicks(frames) {
      this.ticks.replaceChildren(...frames.slice(0, 500).map((f) => {
        const tick = element("span");
        tick.style.left = `${100 * f / Math.max(1, this.frames - 1)}%`;
        return tick;
      }));
    }

    /* show a frame; while one is on its way, only the last one that was asked for in the meantime follows */
    show(index) {
      this.slider.max = this.frames - 1;
      const wanted = this.index = Math.min(Math.max(0, index), this.frames - 1);
      this.request++;
      this.slider.value = wanted;
      const time = this.options.time(wanted), text = `frame ${wanted}${Number.isFinite(time) ? `, ${time.toFixed(3)} s` : ""}`;
      this.text.textContent = text;
      this.slider.setAttribute("aria-valuetext", text);
      this.options.shown?.(wanted);
      this.loading ||= this.load().finally(() => { this.loading = null; });
      return this.loading;
    }

    async load() {
      let request;
      do {
        request = this.request;
        await this.fetched(this.index, request);
      } while (request !== this.request);
    }

    async fetched(wanted, mine) {
      const key = this.options.key(), old = () => this.options.key() !== key;
      try {
        const asked = this.options.marks(wanted), picture = await this.options.picture(wanted);
        if (old()) return;
        this.image = picture.image; this.size = picture.size; this.marks = null;
        if (!this.running) this.draw();
        const marks = await asked;
        if (old()) return;
        this.marks = marks;
        this.canvas.dataset.shown = `${key}:${wanted}`;
        this.canvas.setAttribute("aria-label", this.options.label(wanted));
        this.draw();
        this.options.drawn?.(marks);
      } catch (error) {
        if (mine !== this.request) return;
        this.stop();
        Page.complain(error);
      }
    }

    step(n) { this.stop(); return this.show(this.index + n); }

    stop() { this.running = false; this.playing.textContent = "Play"; }

    /* every frame, or at a fraction of real time with frames skipped; to a frame, or again and again */
    async play(until = null) {
      if (this.running) return;
      const mine = this.run = {}, last = until ?? this.frames - 1;
      this.running = true;
      this.playing.textContent = "Pause";
      if (until === null && this.index >= last && !this.options.loop) await this.show(0);
      const first = this.index, start = performance.now();
      while (this.running && this.run === mine) {
        if (this.index >= last) { if (!this.options.loop || until !== null) break; await this.show(0); }
        const began = performance.now(), speed = Number(this.speed.value);
        const next = speed && !this.options.loop ? first + Math.floor((began - start) / 1000 * this.options.rate() * speed) : this.index + 1;
        if (next > this.index && this.options.visible()) await this.show(Math.min(next, last));
        await new Promise((done) => setTimeout(done, Math.max(5, (speed ? 15 : 40) - (performance.now() - began))));
      }
      if (this.run === mine) this.stop();
    }

    /* --- places --- */

    view() {
      const [w, h] = this.size, part = 1 / this.zoom, half = part / 2;
      const x = Math.min(1 - half, Math.max(half, this.middle[0])), y = Math.min(1 - half, Math.max(half, this.middle[1]));
      this.middle = [x, y];
      return { left: (x - half) * w, top: (y - half) * h, scale: this.canvas.width / (part * w) };
    }

    /* position of an event in px of the film */
    placeOf(event) {
      const box = this.canvas.getBoundingClientRect(), v = this.view(), ratio = this.canvas.width / box.width;
      return [v.left + (event.clientX - box.left) * ratio / v.scale, v.top + (event.clientY - box.top) * ratio / v.scale];
    }

    scale(factor, about = null) {
      const before = this.zoom, [w, h] = this.size;
      this.zoom = factor ? Math.min(MOST_ZOOM, Math.max(1, this.zoom * factor)) : 1;
      if (about) this.middle = this.middle.map((m, k) => { const a = about[k] / [w, h][k]; return a + (m - a) * before / this.zoom; });
      this.draw();
    }

    pressed(event) {
      if (event.button !== 0) return;
      const from = [event.clientX, event.clientY], middle = [...this.middle], box = this.canvas.getBoundingClientRect();
      let moved = false;
      const move = (e) => {
        if (Math.hypot(e.clientX - from[0], e.clientY - from[1]) > CLICK) moved = true;
        if (moved && this.zoom > 1) {
          this.middle = [middle[0] - (e.clientX - from[0]) / box.width / this.zoom, middle[1] - (e.clientY - from[1]) / box.height / this.zoom];
          this.draw();
        }
      };
      const up = (e) => {
        window.removeEventListener("pointermove", move);
        window.removeEventListener("pointerup", up);
        if (!moved) { this.cross = null; this.options.picked?.(this.placeOf(e)); }
      };
      window.addEventListener("pointermove", move);
      window.addEventListener("pointerup", up);
    }

    typed(event) {
      const step = (event.shiftKey ? 0.001 : 0.015) / this.zoom, moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      const zooms = { "+": 1.6, "-": 1 / 1.6, 0: 0 };
      if (moves[event.key]) {
        event.preventDefault();
        const from = this.cross || this.middle;
        this.cross = from.map((v, k) => Math.min(1, Math.max(0, v + moves[event.key][k])));
        if (this.zoom > 1) this.middle = [...this.cross];
        this.draw();
      } else if (event.key in zooms) { event.preventDefault(); this.scale(zooms[event.key]); }
      else if (event.key === "Enter" && this.cross) { event.preventDefault(); this.options.picked?.([this.cross[0] * this.size[0], this.cross[1] * this.size[1]]); }
    }

    /* --- drawing --- */

    draw() {
      const canvas = this.canvas, room = canvas.parentElement;
      if (!this.image || !room.clientWidth) return;
      const [w, h] = this.size, ratio = devicePixelRatio || 1, most = Math.max(160, (window.innerWidth < 690 ? 0.4 : window.innerWidth < 1090 ? 0.28 : 0.42) * window.innerHeight);
      const width = Math.min(room.clientWidth, most * w / h), height = width * h / w;
      canvas.style.width = `${width}px`; canvas.style.height = `${height}px`;
      canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
      const g = canvas.getContext("2d"), v = this.view();
      g.imageSmoothingEnabled = this.zoom < 4;
      g.drawImage(this.image, -v.left * v.scale, -v.top * v.scale, w * v.scale, h * v.scale);
      const to = ([x, y]) => [(x - v.left) * v.scale, (y - v.top) * v.scale];
      const shown = this.options.extra?.(this.index) || this.marks;
      if (this.overlay.checked && shown) this.drawMarks(g, shown, to, ratio);
      if (this.cross && document.activeElement === canvas) {
        const [x, y] = to([this.cross[0] * w, this.cross[1] * h]);
        this.stroke(g, this.plus(x, y, 12 * ratio), "#ffff00", ratio);
      }
    }

    stroke(g, path, colour, ratio, width = 1.2) {
      g.lineWidth = (width + 1.6) * ratio; g.strokeStyle = "rgb(0 0 0 / 55%)"; g.stroke(path);
      g.lineWidth = width * ratio; g.strokeStyle = colour; g.stroke(path);
    }

    plus(x, y, r) { const p = new Path2D(); p.moveTo(x - r, y); p.lineTo(x + r, y); p.moveTo(x, y - r); p.lineTo(x, y + r); return p; }

    drawMarks(g, shown, to, ratio) {
      const ring = (x, y, r) => { const p = new Path2D(); p.arc(x, y, r, 0, 7); return p; };
      const centre = shown.centre ? to(shown.centre) : null, labels = [];
      for (const m of shown.markers) {
        const colour = m.picked ? PICKED : m.by_hand ? HAND : m.whole ? FOUND : PARTIAL;
        const place = m.clicked || m.place;
        if (!place) continue;
        const [x, y] = to(place);
        if (centre && !m.picked) {
          const ray = new Path2D();
          ray.moveTo(...centre); ray.lineTo(x, y);
          g.globalAlpha = 0.6; this.stroke(g, ray, colour, ratio, 0.8); g.globalAlpha = 1;
        }
        for (const c of m.corners || []) this.stroke(g, ring(...to(c), 2.5 * ratio), colour, ratio, 1);
        this.stroke(g, ring(x, y, 5 * ratio), colour, ratio);
        if (m.by_hand) this.stroke(g, this.plus(x, y, 8 * ratio), colour, ratio, 1);
        const label = m.by_hand ? `${m.name}, by hand` : m.whole || m.picked || !m.status ? m.name : `${m.name}, ${m.status}`;
        labels.push([label, x, y]);
      }
      if (shown.ghost) {
        g.setLineDash([5 * ratio, 3 * ratio]);
        for (const corners of shown.ghost.markers) {
          const p = new Path2D();
          corners.forEach((c, n) => { if (n) p.lineTo(...to(c)); else p.moveTo(...to(c)); });
          p.closePath();
          this.stroke(g, p, GHOST, ratio, 2);
        }
        g.setLineDash([]);
      }
      this.drawLabels(g, labels, ratio);
      if (centre) this.stroke(g, this.plus(...centre, 7 * ratio), CENTRE, ratio);
    }

    /* each label right of its marker; below the labels that it would cover */
    drawLabels(g, labels, ratio) {
      g.font = `600 ${13 * ratio}px system-ui, "DejaVu Sans", sans-serif`;
      g.lineWidth = 3.5 * ratio; g.lineJoin = "round"; g.strokeStyle = "rgb(0 0 0 / 85%)"; g.fillStyle = "#fff";
      const height = 16 * ratio, drawn = [];
      for (const [text, x, y] of labels.sort((a, b) => a[2] - b[2])) {
        const width = g.measureText(text).width, left = Math.min(x + 9 * ratio, g.canvas.width - width - 3 * ratio);
        let top = Math.max(14 * ratio, y - 7 * ratio);
        for (const d of drawn) if (left < d.right && left + width > d.left && top > d.top - height && top < d.top + height) top = d.top + height;
        drawn.push({ left, right: left + width, top });
        g.strokeText(text, left, top); g.fillText(text, left, top);
      }
    }
  }

  /* the legend of the overlay, as a list */
  FilmView.legend = (ghost = false) => [...(ghost ? [["where the model says", GHOST]] : []), ["complete marker: corners and middle", FOUND], ["partly visible", PARTIAL], ["by hand", HAND], ["centre", CENTRE]].map(([text, colour]) => {
    const swatch = element("span", { class: colour === CENTRE ? "swatch plus" : "swatch ring", "aria-hidden": "true" });
    swatch.style.setProperty("--colour", colour);
    return element("li", {}, swatch, text);
  });

  return FilmView;
})();
