"""Ten visits to the workbench, as a person makes them."""

import json
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from time import perf_counter, sleep

import pytest

from .conftest import HOSTILE, Visit, accessibility

FOUND = "casing.air.quadratic"


class Server:
    def __init__(self, *words):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gyrotrack", "view", *words, "--no-browser", "--json"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.url = json.loads(self.process.stdout.readline())["url"]
        self.host = self.url.split("/")[2]

    def children(self):
        """Return the processes that it started, by their parents in /proc."""
        found = set()
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                text = stat.read_text()
            except OSError:
                continue
            if int(text.rpartition(")")[2].split()[1]) == self.process.pid:
                found.add(int(stat.parent.name))
        return found

    def ended(self, children):
        """Wait for the end and return the exit code; its children must be gone too."""
        code = self.process.wait(20)
        assert self.process.stderr.read() == ""
        self.process.stdout.close()
        self.process.stderr.close()
        for _ in range(50):
            left = [c for c in children if Path(f"/proc/{c}").exists()]
            if not left:
                return code
            sleep(0.1)
        pytest.fail(f"left behind: {left}")


@pytest.fixture(scope="module")
def server(chromium, case, tmp_path_factory):
    found = Server(str(case), "--ledger", str(tmp_path_factory.mktemp("ledger") / "fits.json"))
    yield found
    if found.process.poll() is None:
        found.process.terminate()
    found.process.communicate(timeout=20)


@pytest.fixture
def visit(chromium, server):
    """A page of the workbench that stands at the first fit."""
    found = Visit(chromium)
    page = found.page
    page.goto(server.url)
    page.locator("#ladder tr").first.wait_for()
    if page.locator("#ladder tr.now").locator("th").inner_text().split()[0] != "start":
        page.get_by_role("button", name="show fit 1", exact=True).click()
        page.locator("#ladder tr.now th", has_text="start").wait_for()
    yield page
    found.close([server.host, ""])  # pictures made in the page itself have no host


def _rungs(page):
    return page.locator("#ladder tr").count()


def _rms(page):
    return float(page.locator("#ladder tr.now td").first.inner_text())


def _after(page, act):
    """Do something that makes a new rung, wait until it is drawn, and return how long that took [s]."""
    count = _rungs(page)
    began = perf_counter()
    act()
    page.locator("#ladder tr").nth(count).wait_for(state="attached")
    return perf_counter() - began


def _frame(page):
    return int(page.get_attribute("#frame", "data-shown").partition(":")[2])


def _shown(page, frame):
    page.locator(f"#frame[data-shown='casing:{frame}']").wait_for()


@pytest.mark.slow
def test_opening_shows_the_case_and_its_name_as_text(visit, tmp_path):
    assert visit.locator("h1").inner_text() == HOSTILE
    assert visit.title() == f"gyrotrack: {HOSTILE}"
    assert visit.locator("#board canvas").count() == 3
    assert visit.locator("#effects li").count() == 5
    assert visit.locator("#verdict").inner_text() == "Significant lack of fit"
    for tab, count in (("torque", 4), ("residual", 3), ("uncertainty", 3), ("motion", 3)):
        visit.click(f"#t-{tab}")
        visit.locator("#board canvas").nth(count - 1).wait_for()
        assert visit.locator("#board canvas").count() == count
    # a number has the digits that its u allows, as in the reports
    from fitting._numbers import with_uncertainty

    for value, u in (
        (3.3976, 0.017),
        (-0.0902246, 0.000087),
        (3.6e-10, 1.2e-13),
        (54321.0, 310.0),
        (0.5, 2.0),
    ):
        expected = with_uncertainty(value, u, "1").replace(" ×", "\u00a0×").replace("× ", "×\u00a0")
        assert visit.evaluate("([v, u]) => Charts.uncertain(v, u)", [value, u]) == expected
    picture = tmp_path / "page.png"
    visit.screenshot(path=picture, full_page=True)
    assert picture.stat().st_size > 50_000


@pytest.mark.slow
def test_the_history_is_annotated_undone_and_pruned(visit):
    count = _rungs(visit)
    visit.fill("#effect", "casing.air.laminar")
    _after(visit, lambda: visit.press("#effect", "Enter"))
    visit.fill("#note", HOSTILE)
    visit.press("#note", "Enter")
    visit.locator("#ladder tr.now", has_text="alert(1)").wait_for()
    label = visit.locator("#ladder tr.now .more").inner_text().partition(":")[0]
    visit.get_by_role("button", name=f"delete {label}", exact=True).click()
    visit.locator("#ladder tr.now th", has_text="start").wait_for()
    assert _rungs(visit) == count
    visit.click("h1")
    visit.keyboard.press("Control+z")
    visit.locator("#ladder tr.now", has_text="alert(1)").wait_for()
    assert _rungs(visit) == count + 1
    visit.click("#undo")
    visit.locator("#ladder tr.now", has_text="alert(1)").wait_for(state="detached")
    assert "laminar" in visit.locator("#ladder tr.now").inner_text()
    visit.get_by_role("button", name=f"delete {label}", exact=True).click()
    visit.locator("#ladder tr.now th", has_text="start").wait_for()


@pytest.mark.slow
def test_axe_finds_nothing(visit):
    """The schemes differ in their colours only."""
    visit.locator("#ranking .card").first.wait_for(timeout=150_000)
    for tab in ("model", "sliders", "report", "more", "fits"):
        visit.click(f"#t-{tab}")
        for summary in visit.locator("summary:visible").all():
            if summary.evaluate("(s) => !s.parentElement.open && !s.closest('.save')"):
                summary.click()
        visit.emulate_media(color_scheme="light")
        assert accessibility(visit) == []
        visit.emulate_media(color_scheme="dark")
        assert accessibility(visit, "color-contrast") == []


@pytest.mark.slow
def test_a_click_adds_what_the_ranking_puts_first(visit):
    before = _rms(visit)
    add = visit.get_by_role("button", name=f"add {FOUND}", exact=True)
    add.wait_for(timeout=150_000)
    first = visit.locator("#ranking .card").first
    assert first.get_attribute("data-effect") == FOUND
    assert first.locator("h3").inner_text().lower() == "quadratic air drag of the casing"
    assert "Accounts for" in first.inner_text()
    assert FOUND in visit.locator("#sentence").inner_text()
    assert _after(visit, add.click) < 20
    assert _rms(visit) < 0.7 * before
    assert visit.locator("#verdict").inner_text() == "No significant lack of fit"
    assert 0.8 < _rms(visit) < 1.2
    assert visit.locator("#board .mark").count() == 0
    assert "quadratic air drag of the casing" in visit.locator("#effects").text_content()


@pytest.mark.slow
def test_a_typed_law_is_fitted(visit):
    before = _rms(visit)
    visit.fill("#effect", "casing: -k*omega_c**2")
    _after(visit, lambda: visit.press("#effect", "Enter"))
    assert _rms(visit) < before
    assert "-k*omega_c**2" in visit.locator("#effects").text_content()
    assert visit.input_value("#effect") == ""
    visit.click("#t-sliders")
    assert "N m s²" in visit.locator("#parameters").inner_text()


@pytest.mark.slow
def test_an_error_of_the_user_is_reported_in_a_sentence(visit):
    count = _rungs(visit)
    for typed, told in (
        ("casing: -k*omega_c**", "is not a formula"),
        ("no.such.effect", "no.such.effect"),
        ("bearing.linear", "already in the model"),
        (HOSTILE, "script"),
        ("", "No change was requested."),
    ):
        visit.fill("#effect", typed)
        visit.click("#add")
        visit.locator("#error-text", has_text=told).wait_for()
        assert visit.locator("#error-text").inner_text().endswith((".", "?"))
        assert _rungs(visit) == count
        assert visit.locator("#error-text *").count() == 0
    # and it goes with the next thing that works
    visit.click("#t-model")
    _after(visit, visit.get_by_role("button", name="drop bearing.power").click)
    assert visit.locator("#error").is_hidden()


@pytest.mark.slow
def test_an_effect_is_dropped_and_taken_back(visit):
    before, count = _rms(visit), _rungs(visit)
    visit.click("#t-model")
    _after(visit, visit.get_by_role("button", name="drop rotor.air.quadratic").click)
    assert visit.locator("#effects li").count() == 4
    assert _rms(visit) > before
    visit.click("#undo")
    visit.locator("#effects li").nth(4).wait_for()
    assert (_rms(visit), _rungs(visit)) == (before, count)
    visit.click("#redo")
    visit.locator("#effects li").nth(4).wait_for(state="detached")
    visit.click("#undo")
    visit.locator("#effects li").nth(4).wait_for()


@pytest.mark.slow
def test_a_click_on_the_residual_shows_the_frame_of_that_moment(visit):
    canvas = visit.locator("#board .u-over").nth(1)
    box = canvas.bounding_box()
    low, high = visit.evaluate("(() => { const s = document.querySelector('.shown').textContent;"
                               "return s.match(/[\\d.]+/g).map(Number); })()")  # fmt: skip
    # 0.25 s into the film, which begins 10 s into the run and has 260 frames a second
    share = (10.25 - low) / (high - low)
    canvas.click(position={"x": share * box["width"], "y": box["height"] / 2})
    visit.locator("#frame[data-shown]").wait_for()
    visit.wait_for_timeout(300)
    frame = _frame(visit)
    # a pixel is 60 s / 700: some twenty frames
    assert abs(frame - 65) < 40
    assert f"frame {frame}," in visit.locator("#where").inner_text()
    # dragging the line of the shown moment scrubs and does not zoom
    zoom, x, y = visit.locator(".shown").inner_text(), box["x"] + share * box["width"], box["y"] + 30
    visit.mouse.move(x, y)
    visit.mouse.down()
    visit.mouse.move(x + 1, y)  # a quarter of the film
    visit.mouse.up()
    visit.wait_for_timeout(300)
    assert _frame(visit) > frame
    assert visit.locator(".shown").inner_text() == zoom
    # the film is in sight, wherever the charts are scrolled to
    for at in (0, 900):
        visit.evaluate("(y) => window.scrollTo(0, y)", at)
        seen = visit.locator("#frame").bounding_box()
        assert seen["y"] >= 0
        assert seen["y"] + seen["height"] <= visit.viewport_size["height"]


@pytest.mark.slow
def test_frames_play_and_the_overlay_goes(visit):
    _shown(visit, 0)
    visit.click("#play")
    for _ in range(100):
        visit.wait_for_timeout(50)
        if _frame(visit) > 3:
            break
    visit.click("#play")
    visit.wait_for_timeout(300)
    at = _frame(visit)
    assert 3 < at < 129
    visit.wait_for_timeout(300)
    assert _frame(visit) == at
    drawn = visit.evaluate("document.getElementById('frame').toDataURL()")
    visit.uncheck("#overlay")
    visit.wait_for_timeout(600)
    assert visit.evaluate("document.getElementById('frame').toDataURL()") != drawn
    visit.focus("#seek")
    visit.keyboard.press("End")
    _shown(visit, 129)


@pytest.mark.slow
def test_picked_colours_make_a_profile_that_extract_reads(visit, tmp_path):
    from gyrotrack.tracking._profile import load

    _shown(visit, 0)
    visit.click("#t-more")
    visit.locator("#picker summary").click()
    visit.uncheck("#overlay")
    visit.wait_for_timeout(500)
    box = visit.locator("#frame").bounding_box()
    # the red and the green paper of the first frame of the sample film
    for x, y in ((0.56, 0.74), (0.60, 0.67)):
        visit.locator("#frame").click(position={"x": x * box["width"], "y": y * box["height"]})
        visit.wait_for_timeout(300)
    rows = visit.locator("#picked li")
    rows.nth(1).wait_for()
    assert rows.nth(0).get_by_label("colour of marker 1").input_value() == "red"
    rows.nth(0).get_by_label("body").select_option("casing")
    rows.nth(1).get_by_label("colour").select_option("green")
    rows.nth(1).get_by_label("name").fill("bad name!")
    visit.click("#profile")
    visit.locator("#error:not([hidden])").wait_for()
    rows.nth(1).get_by_label("name").fill("green")
    visit.click("#profile")
    visit.locator("#toml:not([hidden])").wait_for()
    with visit.expect_download() as saved:
        visit.click("#download")
    path = tmp_path / "profile.toml"
    saved.value.save_as(path)
    assert tomllib.loads(path.read_text())["marker"][0]["colour"] == "red"
    assert [m.body for m in load(path).marker] == ["casing", "rotor"]


@pytest.mark.slow
def test_plots_zoom_together(visit):
    canvas = visit.locator("#board .u-over").nth(0)
    before = [visit.locator("#board canvas").nth(i).screenshot() for i in (0, 1, 2)]  # this scrolls
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    middle = box["y"] + box["height"] / 2
    visit.mouse.move(box["x"] + 200, middle)
    visit.mouse.down()
    visit.mouse.move(box["x"] + 400, middle, steps=5)
    visit.mouse.up()
    shown = visit.locator(".shown").inner_text()
    assert "0 s to 60" not in shown
    for i, was in zip((0, 1, 2), before, strict=True):
        tries = 50
        while visit.locator("#board canvas").nth(i).screenshot() == was and tries:
            visit.wait_for_timeout(100)
            tries -= 1
        assert tries
    visit.locator("#board .mark").first.click()
    assert visit.locator(".shown").inner_text() != shown
    visit.get_by_role("button", name="show the whole run").press("Enter")
    assert "0 s to" in visit.locator(".shown").inner_text()


@pytest.mark.slow
def test_a_fit_is_kept_in_the_ledger_and_quitting_leaves_nothing_behind(chromium, case, tmp_path):
    ledger = tmp_path / "fits.json"
    server = Server(str(case), "--ledger", str(ledger))
    found = Visit(chromium, width=800)
    page = found.page
    page.goto(server.url)
    page.locator("#ladder tr").first.wait_for()
    page.fill("#effect", FOUND)
    _after(page, lambda: page.click("#add"))
    page.click("#keep")
    page.locator("#ladder tr.now", has_text="(f2)").wait_for()
    fits = json.loads(ledger.read_text())["fits"]
    assert [f["added"] for f in fits[1:]] == [f"+{FOUND}"]
    assert fits[1]["parent"] == "f1"
    value = fits[1]["parameters"][f"{FOUND}.k"]
    assert abs(value["value"] - 3e-10) < 5 * value["stderr"]
    page.click("#t-report")
    page.click("#write-report")
    page.locator("#open-report").wait_for(timeout=120_000)
    with found.context.expect_page() as opened:
        page.click("#open-report")
    assert FOUND in opened.value.locator("body").inner_text()
    assert case.with_suffix(".report.html").is_file()
    children = server.children()
    assert children  # the search for what is missing
    page.click("#quit")
    page.locator("#ended").wait_for()
    assert server.ended(children) == 0
    found.close([server.host, ""])


@pytest.mark.slow
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.release
def test_a_signal_ends_it_while_it_searches(chromium, case, tmp_path, sign):
    server = Server(str(case), "--ledger", str(tmp_path / "fits.json"))
    found = Visit(chromium)
    found.page.goto(server.url)
    found.page.locator("#ladder tr").first.wait_for()
    for _ in range(100):
        if children := server.children():
            break
        sleep(0.1)
    found.context.close()
    os.kill(server.process.pid, sign)
    assert server.ended(children) == 0


@pytest.mark.slow
def test_sliders_move_the_residual_and_candidates_are_foreseen(visit):
    visit.click("#t-sliders")
    slider = visit.get_by_label("move casing.air.linear.b2")
    slider.wait_for()
    assert visit.locator("#from-here").is_disabled()
    before = visit.locator("#board canvas").nth(1).screenshot()
    slider.focus()
    visit.keyboard.press("ArrowRight")
    took = visit.evaluate("""async () => {
        const input = document.querySelector("[aria-label='move casing.air.linear.b2']"), took = [];
        for (let k = 0; k < 15; k++) {
            const began = performance.now();
            input.value = String(Number(input.value) + 0.1);
            input.dispatchEvent(new Event("input"));
            const first = performance.now() - began;
            const board = document.getElementById("board");
            while (board.dataset.overlay !== "exact") await new Promise((f) => setTimeout(f, 1));
            took.push([first, performance.now() - began]);
        }
        return took;
    }""")
    first, exact = (sorted(t[k] for t in took)[7] for k in (0, 1))
    assert first < 50
    assert exact < 200  # 50 on idle cores
    assert "times the noise" in visit.locator("#moved").inner_text()
    assert visit.locator("#board canvas").nth(1).screenshot() != before
    visit.click("#reset")
    assert visit.locator("#moved").inner_text() == ""
    card = visit.locator("#ranking .card").first
    card.wait_for(timeout=150_000)
    card.hover()
    visit.locator("#foreseen", has_text="With quadratic air drag of the casing").wait_for()
    visit.locator(f"#board[data-overlay='{FOUND}']").wait_for()
    assert "→" in visit.locator("#misfit").inner_text()
    assert visit.locator("#board").get_attribute("data-overlay") == FOUND
    visit.hover("h1")
    visit.locator("#board:not([data-overlay])").wait_for()


@pytest.mark.slow
def test_a_fit_in_one_tab_appears_in_all_and_the_candidates_are_near_for_the_keyboard(visit, server):
    visit.locator("#ranking .card").first.wait_for(timeout=150_000)
    visit.locator("body").focus()
    visit.evaluate("document.activeElement.blur()")
    for _ in range(12):
        visit.keyboard.press("Tab")
        if visit.evaluate("Boolean(document.activeElement.closest('#ranking .card'))"):
            break
    else:
        pytest.fail("the candidates are not reached within 12 tabs")
    other = visit.context.new_page()
    other.goto(server.url)
    other.locator("#ladder tr").first.wait_for()
    count = _rungs(other)
    _after(visit, lambda: visit.keyboard.press("Enter"))
    other.locator("#ladder tr").nth(count).wait_for(timeout=15_000)
    assert other.locator("#verdict").inner_text() == visit.locator("#verdict").inner_text()
    visit.click("#undo")
    other.locator("#ladder tr").nth(count).wait_for(state="detached", timeout=15_000)
    other.reload()
    other.locator("#ladder tr").first.wait_for()
    assert _rungs(other) == count


LAYOUT = """() => {
    const out = [], cut = (e) => e.offsetParent === null || e.closest(".hidden, .wide, .marks") || e.id === "choose";
    if (document.documentElement.scrollWidth > innerWidth) out.push("the page scrolls sideways");
    for (const p of document.querySelectorAll(".pane"))
        if (p.offsetParent && p.scrollWidth > p.clientWidth + 1) out.push(`pane ${p.id}`);
    const all = "button, select, input, h2, h3, p, label, canvas, td, th, summary, code";
    for (const e of document.querySelectorAll(all)) {
        if (cut(e)) continue;
        const r = e.getBoundingClientRect(), p = (e.closest(".pane") || document.body).getBoundingClientRect();
        if (!r.width || (r.right <= p.right + 1 && r.left >= p.left - 1)) continue;
        out.push(`${e.tagName} ${e.id} ${e.textContent.slice(0, 30)}`);
    }
    return out;
}"""


@pytest.mark.slow
@pytest.mark.release
def test_nothing_is_cut_at_any_width_and_the_panes_stay_on_the_screen(visit):
    visit.locator("#ranking .card").first.wait_for(timeout=150_000)
    for width, height, scheme in (
        (390, 844, "light"),
        (768, 1024, "dark"),
        (1280, 800, "light"),
        (1920, 1080, "dark"),
        (3840, 2160, "light"),
    ):
        visit.set_viewport_size({"width": width, "height": height})
        visit.emulate_media(color_scheme=scheme)
        visit.wait_for_timeout(400)
        assert visit.evaluate(LAYOUT) == [], width
        panes = [visit.locator(f"#laboratory {p}").bounding_box() for p in ("#film", "#charts", "#answer")]
        assert all(p is not None and p["width"] > 250 for p in panes)
        if width < 690:  # the panes grow with the charts, which must not grow with the panes
            assert visit.locator("#board canvas").first.bounding_box()["height"] < 260
        if width >= 1280:  # film, motion and answer beside each other, none beyond the screen
            assert panes[0]["x"] < panes[1]["x"] < panes[2]["x"]
            assert all(p["y"] + p["height"] <= height for p in panes)
    visit.set_viewport_size({"width": 1280, "height": 1000})
