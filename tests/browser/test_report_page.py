"""The report in a real browser: no fault, no request, no dialog, nothing against it from axe, zooming works."""

import pytest

from .conftest import HOSTILE, Visit, accessibility


@pytest.fixture(scope="module")
def report(case, tmp_path_factory):
    from gyrotrack.apps.cli._app import run

    folder = tmp_path_factory.mktemp("report")
    ledger = ["--ledger", str(folder / "fits.json"), "--json", "-q"]
    assert run(["improve", str(case), *ledger]) == 0
    path = folder / "report.html"
    assert run(["report", str(case), "-o", str(path), *ledger]) == 0
    return path


@pytest.fixture(params=[1280, 800])
def visit(chromium, report, request):
    found = Visit(chromium, width=request.param)
    found.page.goto(report.as_uri())
    yield found.page
    found.close([""])


@pytest.mark.slow
def test_it_shows_what_it_is_about_and_fits_the_window(visit):
    assert visit.locator("h1").inner_text() == HOSTILE
    assert "A missing effect was found" in visit.locator(".verdict").inner_text()
    assert visit.locator(".board canvas").count() == 10
    assert visit.locator("ul.sheet img").count() >= 4
    assert visit.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
    assert visit.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    if visit.viewport_size["width"] == 1280:
        table = visit.locator("[aria-label='table of candidates']")
        assert table.evaluate("(t) => t.scrollWidth <= t.clientWidth")


@pytest.mark.slow
def test_axe_finds_nothing(visit):
    assert accessibility(visit) == []


@pytest.mark.slow
def test_marked_stretches_zoom_all_plots(visit):
    shown = visit.locator(".shown").inner_text()
    visit.locator(".board .mark").first.click()
    assert visit.locator(".shown").inner_text() != shown


@pytest.mark.slow
def test_it_prints_without_what_needs_a_screen(visit):
    visit.emulate_media(media="print")
    assert visit.locator(".board").first.is_hidden()
    assert visit.locator("figure svg").first.is_visible()
    assert visit.pdf(prefer_css_page_size=True).startswith(b"%PDF-")


def test_sixty_thousand_points_are_thinned_with_their_peaks(chromium):
    from gyrotrack.plotting._interactive import script

    page = chromium.new_page()
    page.add_script_tag(content=f"{script()}; window.charts = Charts;")
    found = page.evaluate(
        """() => {
          const n = 60000, t = new Float64Array(n), y = new Float64Array(n);
          for (let i = 0; i < n; i++) { t[i] = i / 260; y[i] = Math.sin(i / 99) + ((i * 7919) % 101) / 1000; }
          y[31234] = 9; y[777] = -9; y[40000] = NaN;
          const began = performance.now();
          let kept;
          for (let k = 0; k < 20; k++) kept = charts.m4(t, y, 0, n / 260, 1000);
          const each = (performance.now() - began) / 20;
          const part = charts.m4(t, y, 100, 101, 1000);
          return { count: kept.length, peaks: [31234, 777, 40000].every((i) => kept.includes(i)),
                   ordered: kept.every((k, i) => !i || k > kept[i - 1]), first: kept[0], last: kept[kept.length - 1],
                   part: part.length, each };
        }"""
    )
    page.close()
    assert found["count"] <= 4 * 1001 + 1
    assert found["peaks"]
    assert found["ordered"]
    assert (found["first"], found["last"]) == (0, 59999)
    assert found["part"] == 262
    # a sixtieth of a second is one picture on the screen
    assert found["each"] < 100
