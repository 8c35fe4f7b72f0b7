"""Figures of the report's page and of the workbench in a real Chromium without a window."""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

VISITS = 10
_PATIENCE = 60
_PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
# the first picture in which a plot of the run is drawn and its zoom answers, in ms since navigation
_USABLE = """
window.usable = null;
addEventListener("DOMContentLoaded", () => {
  const look = () => {
    const canvas = document.querySelector(".board canvas, #board canvas");
    const shown = document.querySelector(".shown"), zoom = document.querySelector("button[title='zoom in']");
    if (canvas && zoom && canvas.width > 100) {
      const seen = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      if (seen.some((v, i) => i % 4 === 3 && v)) {
        const before = shown.textContent;
        zoom.click();
        if (shown.textContent !== before) {
          document.querySelector("button[title='show the whole run']").click();
          window.usable = performance.now();
          return;
        }
      }
    }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
});
"""
# the charts of a run are drawn when their part of the report is opened
_OPEN_RUN = """
addEventListener("DOMContentLoaded", () => { document.getElementById("run").closest("details").open = true; });
"""
# while something goes on: tasks longer than 50 ms (what browsers call long), and the time from picture to picture
_WATCH = """
() => {
  window.tasks = []; window.gaps = [];
  new PerformanceObserver((l) => l.getEntries().forEach((e) => window.tasks.push(e.duration)))
    .observe({ type: "longtask" });
  let last = performance.now();
  const tick = (t) => { window.gaps.push(t - last); last = t; requestAnimationFrame(tick); };
  requestAnimationFrame(tick);
}
"""


@contextmanager
def chromium() -> Iterator[Any]:
    """Start a browser for the length of the block."""
    from playwright.sync_api import sync_playwright

    program = os.environ.get("GYROTRACK_CHROMIUM") or next(filter(None, map(shutil.which, _PROGRAMS)), None)
    if program is None:
        raise SystemExit("no Chromium is installed (Debian: apt-get install chromium)")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def page_of_report(browser: Any, report: Path) -> dict[str, Any]:
    """Open a report three times; then zoom and pan by hand with the mouse, and say how it went."""
    opened = []
    for _ in range(3):
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.add_init_script(_USABLE + _OPEN_RUN)
        page.goto(report.as_uri())
        opened.append(_usable(page))
        if len(opened) < 3:
            page.close()
    points = page.evaluate(
        "JSON.parse(document.getElementById('dashboards').textContent)"
        ".map((b) => Math.max(...b.charts.flatMap((c) => c.traces.map((t) => t.x.count))))"
    )
    page.evaluate(_WATCH)
    _zoom(page)
    found = {"usable_ms": opened, "points": points} | _smoothness(page)
    page.close()
    return found


def _usable(page: Any) -> float:
    # asked again and again from outside: the page's own policy forbids a function that waits inside
    began = perf_counter()
    while (found := page.evaluate("window.usable")) is None:
        if perf_counter() - began > _PATIENCE:
            raise SystemExit(f"no plot can be used after {_PATIENCE} s: {page.url}")
        page.wait_for_timeout(10)
    return float(found)


def _zoom(page: Any) -> None:
    canvas = page.locator(".board .u-over").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    middle = box["y"] + box["height"] / 2

    def press(name: str) -> None:
        # the button of the same board, as a person does who is looking at the plot
        page.locator(".board").first.locator(f"button[title='{name}']").evaluate("(b) => b.click()")
        page.wait_for_timeout(60)

    for start, stop in ((0.2, 0.8), (0.3, 0.6), (0.1, 0.9), (0.4, 0.7)):
        page.mouse.move(box["x"] + start * box["width"], middle)
        page.mouse.down()
        page.mouse.move(box["x"] + stop * box["width"], middle, steps=25)
        page.mouse.up()
        page.wait_for_timeout(60)
    for name in (*["zoom out"] * 8, *["zoom in"] * 6, *["later"] * 8, *["earlier"] * 8, "show the whole run"):
        press(name)


def _smoothness(page: Any) -> dict[str, Any]:
    tasks, gaps = page.evaluate("[window.tasks, window.gaps]")
    return {
        "long_tasks": len(tasks),
        "longest_task_ms": max(tasks, default=0.0),
        "pictures": len(gaps),
        "gap_p99_ms": sorted(gaps)[int(0.99 * len(gaps))],
        "gap_max_ms": max(gaps),
    }


class Server:
    """The workbench as a process of its own."""

    def __init__(self, words: list[str]) -> None:
        began = perf_counter()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gyrotrack", "view", *words, "--no-browser", "--json"],
            stdout=subprocess.PIPE,
            text=True,
        )
        self.url = json.loads(self.process.stdout.readline() if self.process.stdout else "")["url"]
        self.ready = perf_counter() - began

    def family(self) -> set[int]:
        """Return the process and those that it started."""
        found = {self.process.pid}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                text = stat.read_text()
            except OSError:
                continue
            if int(text.rpartition(")")[2].split()[1]) == self.process.pid:
                found.add(int(stat.parent.name))
        return found

    def end(self, page: Any) -> int:
        """Press Quit; return how many of its processes are left after two seconds."""
        family = self.family()
        page.click("#quit")
        page.locator("#ended").wait_for()
        self.process.wait(20)
        for _ in range(20):
            left = [p for p in family if Path(f"/proc/{p}").exists()]
            if not left:
                break
            sleep(0.1)
        return len(left)


def visits(browser: Any, case: Path, folder: Path, count: int = VISITS) -> dict[str, Any]:
    """Visit the workbench: wait for the plots, add an effect of the library and a law of one's own, drop one, quit."""
    ready, usable, left = [], [], 0
    seconds: dict[str, list[float]] = {"add": [], "law": [], "drop": []}
    for n in range(count):
        server = Server([str(case), "--ledger", str(folder / "view.fits.json")])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.add_init_script(_USABLE)
        page.goto(server.url)
        usable.append(_usable(page))
        ready.append(server.ready)
        # what is looked for in the background takes the second core meanwhile, as it does for a person
        for what, words in (
            ("add", "casing.air.quadratic"),
            ("law", "casing: -k*omega_c**3"),
            ("drop", "bearing.power"),
        ):
            seconds[what].append(_redrawn(page, what, words))
        if n == 0:
            page.wait_for_selector("#ranking .card", timeout=120_000)
        left += server.end(page)
        page.close()
    return {
        "visits": count,
        "left_behind": left,
        "ready_s": ready,
        "usable_ms": usable,
        **{f"{k}_s": v for k, v in seconds.items()},
    }


def _redrawn(page: Any, what: str, words: str) -> float:
    rungs = page.locator("#ladder tr").count()
    began = perf_counter()
    if what == "drop":
        page.click("#t-model")
        page.get_by_role("button", name=f"drop {words}").click()
    else:
        page.fill("#effect", words)
        page.click("#add")
    page.locator("#ladder tr").nth(rungs).wait_for(state="attached")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return perf_counter() - began


def frames(browser: Any, case: Path, films: Path, folder: Path) -> dict[str, Any]:
    """Ask for frames with the overlay as the page does: one after the other, and anywhere in the film."""
    server = Server([str(case), "--films", str(films), "--ledger", str(folder / "frames.fits.json")])
    page = browser.new_page()
    page.goto(server.url)
    page.wait_for_selector("#frame[data-shown]", timeout=60_000)
    found = page.evaluate(
        """async () => {
          const clip = document.getElementById("clip").value, last = Number(document.getElementById("seek").max);
          const get = async (index) => {
            const began = performance.now();
            const answer = await fetch(`/api/frame?clip=${encodeURIComponent(clip)}&index=${index}&overlay=1`);
            await createImageBitmap(await answer.blob());
            return performance.now() - began;
          };
          const next = [], far = [];
          for (let i = 0; i < 60; i++) next.push(await get(Math.floor(last / 3) + i));
          for (let i = 0; i < 40; i++) far.push(await get(Math.floor(((i * 7919) % 1000) / 1000 * last)));
          return { frames: last + 1, next, far };
        }"""
    )
    found |= {"click": _clicks(page), **_slides(page)}
    server.end(page)
    page.close()
    return {
        "frames": found["frames"],
        **{
            f"{k}_{name}_ms": value
            for k in ("next", "far", "click", "linear", "exact")
            for name, value in (
                ("median", statistics.median(found[k])),
                ("p95", sorted(found[k])[int(0.95 * len(found[k]))]),
                ("max", max(found[k])),
            )
        },
    }


_ARRIVED = """
(count) => new Promise((done) => {
  const frame = document.getElementById("frame"), over = document.querySelectorAll("#board .u-over")[1];
  const box = over.getBoundingClientRect(), times = [];
  const next = (i) => {
    if (i === count) { done(times); return; }
    const x = box.left + (0.1 + 0.8 * ((i * 37) % count) / count) * box.width, y = box.top + box.height / 2;
    const was = frame.dataset.shown, began = performance.now();
    for (const type of ["mousemove", "mousedown", "mouseup", "click"])
      over.dispatchEvent(new MouseEvent(type, { clientX: x, clientY: y, bubbles: true, button: 0 }));
    const look = () => {
      if (frame.dataset.shown !== was) { times.push(performance.now() - began); setTimeout(() => next(i + 1), 30); }
      else if (performance.now() - began > 3000) { times.push(3000); next(i + 1); }
      else requestAnimationFrame(look);
    };
    look();
  };
  next(0);
})
"""
_SLID = """
(count) => new Promise((done) => {
  const board = document.getElementById("board"), found = { linear: [], exact: [] };
  const sliders = [...document.querySelectorAll("#parameters input[type=range]")];
  const next = (i) => {
    if (i === count) { done(found); return; }
    const s = sliders[i % sliders.length];
    delete board.dataset.overlay;
    const began = performance.now();
    const share = 0.2 + ((i * 61) % 600) / 1000;
    s.value = String(Number(s.min) + share * (s.max - s.min));
    s.dispatchEvent(new Event("input", { bubbles: true }));
    let linear = false;
    const look = () => {
      const now = performance.now() - began;
      if (!linear && board.dataset.overlay) { linear = true; found.linear.push(now); }
      if (board.dataset.overlay === "exact" || now > 5000) { found.exact.push(now); setTimeout(() => next(i + 1), 30); }
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  };
  next(0);
})
"""


def _clicks(page: Any) -> list[float]:
    """Click into the residual's chart at many times; return the time to the frame of each moment [ms]."""
    page.wait_for_timeout(500)
    return list(page.evaluate(_ARRIVED, 40))


def _slides(page: Any) -> dict[str, list[float]]:
    """Move the sliders of the parameters; return the times to the linearised and to the exact residual [ms]."""
    page.click("#t-sliders")
    page.wait_for_selector("#parameters input[type=range]", timeout=60_000)
    return dict(page.evaluate(_SLID, 40))
