"""The report in a real browser: no fault, request or dialog; axe-core finds nothing; zoom, links, export, print."""

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
@pytest.mark.release
def test_it_shows_what_it_is_about_and_fits_the_window(visit):
    assert visit.locator("h1").inner_text() == HOSTILE
    assert "Missing:" in visit.locator(".answer").inner_text()
    # the answer and its three figures are in sight at once on a wide screen
    bottom = visit.evaluate("document.querySelector('.overview').getBoundingClientRect().bottom")
    if visit.viewport_size["width"] == 1280:
        assert bottom < 800
    assert visit.locator("details.part[open]:not(#ghost)").count() == 0
    visit.click("#expand") if visit.locator("#expand").is_visible() else _open_all(visit)
    visit.locator(".board canvas").nth(10).wait_for()
    assert visit.locator(".board canvas").count() == 11
    assert visit.locator("ul.sheet img").count() >= 4
    assert visit.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
    assert visit.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    if visit.viewport_size["width"] == 1280:
        table = visit.locator("[aria-label='table of candidates']")
        assert table.evaluate("(t) => t.scrollWidth <= t.clientWidth")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(visit, scheme):
    visit.emulate_media(color_scheme=scheme)
    assert accessibility(visit) == []
    _open_all(visit)
    visit.locator(".board canvas").nth(10).wait_for()
    assert accessibility(visit) == []


@pytest.mark.slow
def test_marked_stretches_zoom_all_plots(visit):
    _open_all(visit)
    shown = visit.locator(".shown").inner_text()
    visit.locator(".board .mark").first.click()
    assert visit.locator(".shown").inner_text() != shown


@pytest.mark.slow
def test_it_prints_without_what_needs_a_screen(visit):
    _open_all(visit)
    visit.emulate_media(media="print")
    assert visit.locator(".board").first.is_hidden()
    assert visit.locator("figure svg").first.is_visible()
    assert visit.pdf(prefer_css_page_size=True).startswith(b"%PDF-")


def _open_all(page):
    page.evaluate("for (const d of document.querySelectorAll('details.part')) d.open = true")


@pytest.mark.slow
def test_a_link_opens_its_part(visit):
    visit.get_by_role("link", name="Parameters", exact=True).click()
    visit.locator("#parameters[open] table").first.wait_for()


@pytest.mark.slow
def test_a_chart_is_exported_as_numbers(visit, tmp_path):
    _open_all(visit)
    visit.locator(".panel .save summary").nth(1).click()
    for kind, head in (("CSV", b"curve,time [s],value ["), ("SVG", b"<svg"), ("PNG", b"\x89PNG")):
        with visit.expect_download() as saved:
            visit.get_by_role("button", name=f"save residual-casing as {kind}").click()
        saved.value.save_as(tmp_path / kind)
        assert (tmp_path / kind).read_bytes().startswith(head)
    rows = (tmp_path / "CSV").read_text().splitlines()[1:]
    assert {r.split(",")[0] for r in rows} >= {"base model", "final model"}


@pytest.mark.slow
def test_the_scale_of_the_browser_is_that_of_the_figures(chromium):
    import numpy as np

    from gyrotrack.plotting._charts import Chart, Dashboard, Trace, dashboard_document, scripts

    x = np.linspace(0, 10, 201)
    gap = np.where((x > 4) & (x < 5), np.nan, np.cos(x))
    chart = Chart(
        "c",
        "t",
        "1",
        (
            Trace("measured", x, gap, "#000000", scale="reference"),
            Trace("model", x, 1e6 * x, "#000000", np.full(201, 0.2)),
            Trace("law", x, -1e9 * x, "#000000", scale="none"),
        ),
        "f",
    )
    document = dashboard_document(Dashboard("b", (chart,)))["charts"][0]["traces"]
    page = chromium.new_page()
    library, charts = scripts()
    page.add_script_tag(content=f"{library}; window.uPlot = uPlot;")
    page.add_script_tag(content=f"{charts}; window.charts = Charts;")
    read = """(traces) => traces.map((t) => ({...t, x: charts.column(t.x), value: charts.column(t.value),
        sigma: t.sigma ? charts.column(t.sigma) : null, shown: true}))"""
    low, high = page.evaluate(f"(d) => charts.limits(({read})(d), 0, 10)", document)
    assert (low + 0.06 / 1.12 * (high - low), high - 0.06 / 1.12 * (high - low)) == pytest.approx(
        chart.limits, abs=1e-3
    )
    # a hidden trace has no influence; nan is a gap
    hidden = f"(d) => {{ const t = ({read})(d); t[1].shown = false; return charts.limits(t, 0, 10); }}"
    assert page.evaluate(hidden, document)[1] < 1.2
    nulls = page.evaluate(f"(d) => ({read})(d)[0].value.filter((v) => v === null).length", document)
    assert nulls == int(np.isnan(gap).sum())
    page.close()


@pytest.mark.slow
def test_the_ghosts_are_shown_and_speeds_change_their_unit(visit):
    assert visit.locator("#ghost img").first.is_visible()
    assert visit.locator("#ghost img").first.evaluate("(i) => i.complete && i.naturalWidth > 300")
    assert "film minus model" in visit.locator("#ghost figcaption").first.inner_text()
    _open_all(visit)
    visit.locator(".board canvas").nth(10).wait_for()
    board = visit.locator(".board").first
    assert "[rad/s]" in board.inner_text()
    visit.click("#rpm")
    assert visit.locator("#rpm").get_attribute("aria-pressed") == "true"
    assert "[rpm]" in board.inner_text()
    visit.click("#rpm")
    assert "[rpm]" not in board.inner_text()
