"""From films to the missing effect, with the mouse alone, in a real browser."""

import base64
import json
import re
import shutil
from pathlib import Path
from time import perf_counter

import pytest

from gyrotrack import read_recording
from gyrotrack.tracking._profile import load

from .conftest import Visit, accessibility
from .test_view import Server

CLIPS = Path(__file__).parents[2] / "sample_clips"
FILMS = ("casing.mp4", "rotor_1.mp4", "rotor_2.mp4", "rotor_3.mp4")


@pytest.fixture
def open_page(chromium, tmp_path):
    """Open the start page in a work folder; called again, it opens the folder again in a new process."""
    opened = []

    def start(*words, width=1280, scheme="light"):
        server = Server(*words, "--folder", str(tmp_path))
        found = Visit(chromium, width)
        found.page.emulate_media(color_scheme=scheme)
        found.page.goto(server.url)
        found.page.locator("#folder", has_text=str(tmp_path)).wait_for()
        opened.append((server, found))
        return found.page

    yield start
    for server, found in opened:
        try:
            found.close([server.host, ""])
        finally:
            server.process.terminate()
            server.process.communicate(timeout=20)


def _end(page):
    page.click("#quit")
    page.locator("#ended").wait_for()


@pytest.mark.slow
def test_the_start_page_lists_the_films_of_the_work_folder(open_page, tmp_path):
    shutil.copy(CLIPS / "rotor_1.mp4", tmp_path / "rotor.mp4")
    page = open_page()
    page.get_by_role("button", name="add rotor.mp4").click()
    card = page.locator(".card", has_text="rotor.mp4")
    card.wait_for()
    assert "480 × 360 px, 2200 frames, stored at 25 fps" in card.inner_text()
    # the rate of the container is offered, and never taken by itself
    assert card.get_by_label("capture rate [fps]").input_value() == ""
    assert "Enter the capture rate of rotor.mp4." in page.locator("#missing-track").inner_text()
    assert page.locator("#track").is_disabled()
    card.get_by_role("button", name="rotor.mp4: capture rate 1000 fps").click()
    page.locator("#track:enabled").wait_for()
    assert page.locator("#command-track").text_content() == (
        "gyrotrack extract rotor.mp4 --capture-fps 1000 -o rotor.h5"
    )
    assert accessibility(page) == []


@pytest.mark.slow
def test_four_films_to_the_named_effect_with_two_clicks_in_four_minutes(open_page, tmp_path):
    began = perf_counter()
    page = open_page()
    # the first click opens the dialog of the files
    page.set_input_files("#choose", [str(CLIPS / name) for name in (*FILMS, "study.toml")])
    page.locator(".card").nth(3).wait_for(timeout=30_000)
    page.click("#analyse:enabled")
    # the motion grows while the films are tracked
    page.locator("#motion-board canvas").nth(1).wait_for(timeout=200_000)
    page.locator("#sentence", has_text="casing.air.quadratic").wait_for(timeout=240_000)
    assert perf_counter() - began < 240
    clocks = page.locator("#clocks").text_content()
    assert clocks.count("starts at") == 3
    assert "starts at 24.10" in clocks
    assert page.locator("#ranking .card").first.get_attribute("data-effect") == "casing.air.quadratic"
    page.get_by_role("button", name="add casing.air.quadratic", exact=True).click()
    page.locator("#verdict", has_text="No significant lack of fit").wait_for(timeout=30_000)
    # a reload shows the same part, and the same fit
    page.reload()
    page.locator("#ladder tr.now", has_text="quadratic air drag").wait_for(timeout=30_000)
    assert page.locator("#films").is_hidden()
    page.click("#tab-films")
    assert page.locator("#laboratory").is_hidden()
    assert accessibility(page) == []
    _end(page)
    # the folder is opened again: nothing is lost, and nothing has to be tracked again
    again = open_page(scheme="dark")
    again.locator("#tab-laboratory:enabled").wait_for()
    assert again.locator("#tracking .fine").count() == 4
    assert again.locator("#track").is_disabled()
    again.click("#tab-films")
    assert accessibility(again) == []
    again.click("#tab-laboratory")
    again.locator("#ladder tr").first.wait_for(timeout=30_000)


@pytest.mark.slow
def test_a_removed_film_comes_back_with_its_markers_and_a_second_command_opens_the_same_page(
    open_page, tmp_path, capsys
):
    from gyrotrack.apps.cli._app import run

    shutil.copy(CLIPS / "rotor_1.mp4", tmp_path / "rotor_1000fps.mp4")
    page = open_page(str(tmp_path / "rotor_1000fps.mp4"))
    card = page.locator(".card", has_text="rotor_1000fps.mp4")
    card.get_by_label("body").select_option("casing")
    page.get_by_role("button", name="remove rotor_1000fps.mp4").click()
    page.get_by_role("button", name="restore rotor_1000fps.mp4").wait_for()
    page.click("#undo")
    card.wait_for()
    assert card.get_by_label("body").input_value() == "casing"
    page.click("#redo")
    page.get_by_role("button", name="restore rotor_1000fps.mp4").click()
    card.wait_for()
    assert run(["view", "--folder", str(tmp_path), "--json", "--no-browser"]) == 0
    other = page.context.new_page()
    other.goto(json.loads(capsys.readouterr().out)["url"])
    other.locator(".card", has_text="rotor_1000fps.mp4").wait_for()
    # what one page changes, the other one shows
    page.get_by_role("button", name="remove rotor_1000fps.mp4").click()
    other.get_by_role("button", name="restore rotor_1000fps.mp4").wait_for(timeout=10_000)


@pytest.mark.slow
def test_hub_and_markers_by_hand_are_followed_and_saved(open_page, tmp_path):
    page = open_page(str(CLIPS / "rotor_1.mp4"))
    page.locator("#still[data-shown='1:0']").wait_for()
    box = page.locator("#still").bounding_box()

    def click(x, y):
        page.locator("#still").click(position={"x": x / 480 * box["width"], "y": y / 360 * box["height"]})
        page.wait_for_timeout(300)

    places = _places()
    click(*places["centre"])
    page.locator("#picks li", has_text="a red disc").wait_for()
    page.get_by_label("marker on the casing").check()
    click(*places["red"])
    page.get_by_label("marker on the rotor").check()
    click(*places["blue"])
    click(*places["green"])
    page.locator("#followed.fine", has_text="Tracked: ").wait_for(timeout=60_000)
    assert "casing in 100 % of 500 frames" in page.locator("#followed").inner_text()
    profile = load(tmp_path / "rotor_1.toml")
    assert [(m.colour, m.body) for m in profile.marker] == [
        ("red", "casing"),
        ("blue", "rotor"),
        ("green", "rotor"),
    ]
    assert profile.centre == "circle"
    assert "--profile rotor_1.toml" in page.locator("#command-film").text_content()
    assert accessibility(page) == []


def _places():
    """Return centre and markers in the first frame of the first rotor film [px], as the program measures them."""
    from gyrotrack.apps.workbench._films import preview

    film = CLIPS / "rotor_1.mp4"
    found = preview(film, profile=None, hub=None, points=[], frames=120)
    return {"centre": found["centre"][0]} | {m["name"]: m["place"][0] for m in found["markers"]}


# number of samples of the first curve in the pane of the motion
_SAMPLES = (
    "fetch('/api/project/motion').then((r) => r.json())"
    ".then((m) => m.charts.length ? m.charts[0].traces[0].x.count : 0)"
)


@pytest.mark.slow
@pytest.mark.release
def test_a_cancelled_film_is_continued_from_its_checkpoint(open_page, tmp_path):
    shutil.copy(CLIPS / "casing.mp4", tmp_path / "casing_260fps.mp4")
    page = open_page(str(tmp_path / "casing_260fps.mp4"))
    page.click("#track:enabled")
    page.locator("#tracking", has_text="of 7670 frames").wait_for(timeout=60_000)
    grown = set()
    for _ in range(200):  # beyond the first of four parts, of which two are tracked at a time
        grown.add(page.evaluate(_SAMPLES))
        done = re.search(r"(\d+) of", page.locator("#tracking [data-name=state]").inner_text())
        if done is None or int(done[1]) > 4200:
            break
        page.wait_for_timeout(100)
    assert len(grown) > 8  # the motion grows by frames, not by parts
    page.get_by_role("button", name="cancel tracking").click()
    page.locator("#tracking", has_text="checkpoint").wait_for()
    assert page.evaluate(_SAMPLES) > 0
    assert (tmp_path / "casing_260fps.h5.unfinished").exists()
    page.click("#track:enabled")
    page.locator("#tracking .fine", has_text="7670 angles").wait_for(timeout=120_000)
    assert not (tmp_path / "casing_260fps.h5.unfinished").exists()
    # a marker is corrected by hand in one frame, which stays in view, and the recording keeps it
    page.get_by_label("correction of red").check()
    page.locator("#place").fill("3000")
    page.locator("#still[data-shown='1:3000']").wait_for(timeout=20_000)
    tracked = page.evaluate("fetch('/api/project/tracked?key=1&index=3000').then((r) => r.json())")
    (x, y), (u, v) = (next(m["place"] for m in tracked["markers"] if m["name"] == "red"), tracked["centre"])
    box = page.locator("#still").bounding_box()

    def click(x, y):
        share = {"x": x / 480 * box["width"], "y": y / 360 * box["height"]}
        page.locator("#still").click(position=share)

    click(2 * u - x, 2 * v - y)  # on the other side
    page.locator("#doubt-text", has_text="180°").wait_for(timeout=20_000)
    assert page.locator("#corrections li").count() == 0
    page.click("#doubt-drop")
    click(x, y)
    page.locator("#corrected", has_text="Frame 3000: red corrected").wait_for(timeout=20_000)
    page.locator("#corrections", has_text="frame 3000: red").wait_for()
    assert page.get_attribute("#still", "data-shown") == "1:3000"
    path = tmp_path / "casing_260fps.h5"
    (note,) = read_recording(path).extra["corrections"]
    assert (note["marker"], note["frame"], note["by"]) == ("red", 3000, "hand")
    assert note["place_px"] == pytest.approx([x, y], abs=2)
    assert accessibility(page) == []
    page.click("#undo")
    page.locator("#corrections-box").wait_for(state="hidden")
    page.click("#redo")
    page.get_by_role("button", name="delete the correction of red in frame 3000").click()
    page.locator("#corrections-box").wait_for(state="hidden")
    assert page.get_attribute("#still", "data-shown") == "1:3000"
    assert "corrections" not in read_recording(path).extra


@pytest.mark.slow
def test_a_table_shows_how_it_is_read_before_it_becomes_a_case(open_page, tmp_path):
    rows = "".join(f"{i / 50},{90 - 0.5 * i / 50},0.1\n" for i in range(400))
    (tmp_path / "wheel.csv").write_text("t [s],speed [rpm],temperature\n" + rows, encoding="utf-8")
    page = open_page()
    page.get_by_role("button", name="add wheel.csv").click()
    read = page.get_by_role("table", name="reading of wheel.csv")
    read.wait_for(timeout=30_000)
    text = read.inner_text()
    assert "speed" in text
    assert "rpm" in text
    assert "left out" in text
    plot = page.locator(".reading svg")
    plot.wait_for()
    assert "speed of the" in plot.get_attribute("aria-label")
    assert accessibility(page) == []


@pytest.mark.slow
def test_an_interrupted_upload_continues_where_it_stopped(open_page, tmp_path):
    film = CLIPS / "rotor_1.mp4"
    content = film.read_bytes()
    page = open_page()
    words = f"name=rotor_1.mp4&size={len(content)}&modified={int(film.stat().st_mtime * 1000)}"
    half = len(content) // 2
    page.evaluate(
        "([words, part]) => fetch(`/api/project/upload?${words}&offset=0`, {method: 'POST',"
        " body: Uint8Array.from(atob(part), (c) => c.charCodeAt(0))}).then((r) => r.status)",
        [words, base64.b64encode(content[:half]).decode()],
    )
    page.reload()
    page.locator("#stopped", has_text="rotor_1.mp4: ").wait_for()
    offsets = []
    page.on("request", lambda r: offsets.append(r.url) if "/api/project/upload?" in r.url else None)
    page.set_input_files("#choose", [str(film)])
    page.locator(".card", has_text="rotor_1.mp4").wait_for(timeout=30_000)
    assert [re.search(r"offset=(\d+)", url)[1] for url in offsets] == [str(half)]
    assert (tmp_path / "rotor_1.mp4").read_bytes() == content
    page.locator("#stopped-list").wait_for(state="hidden")
