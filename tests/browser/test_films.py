"""From films to the missing effect, with the mouse alone, in a real browser."""

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
        found.close([server.host, ""])
        server.process.terminate()
        server.process.communicate(timeout=20)


def _end(page):
    page.click("#quit")
    page.locator("#ended").wait_for()


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
    assert page.locator("#command-track").inner_text() == (
        "gyrotrack extract rotor.mp4 --capture-fps 1000 -o rotor.h5"
    )
    assert accessibility(page) == []


@pytest.mark.slow
def test_four_films_to_the_named_effect_by_mouse_in_four_minutes(open_page, tmp_path):
    began = perf_counter()
    page = open_page()
    page.set_input_files("#choose", [str(CLIPS / name) for name in (*FILMS, "study.toml")])
    page.locator(".card").nth(3).wait_for(timeout=30_000)
    page.locator("#track:enabled").wait_for()
    page.click("#track")
    page.locator("#match:enabled").wait_for(timeout=200_000)
    page.click("#match")
    page.locator("#fit:enabled").wait_for(timeout=60_000)
    clocks = page.locator("#clocks").inner_text()
    assert clocks.count("starts at") == 3
    assert "starts at 24.10" in clocks
    assert accessibility(page) == []
    page.click("#fit")
    page.locator("#sentence", has_text="casing.air.quadratic").wait_for(timeout=120_000)
    assert perf_counter() - began < 240
    assert page.locator("#ranking th").first.inner_text().startswith("casing.air.quadratic")
    page.get_by_role("button", name="add casing.air.quadratic", exact=True).click()
    page.locator("#verdict", has_text="no significant lack of fit").wait_for(timeout=30_000)
    _end(page)
    # the folder is opened again: nothing is lost, and nothing has to be tracked again
    again = open_page(scheme="dark")
    again.locator("#tab-laboratory:enabled").wait_for()
    assert again.locator("#tracking .fine").count() == 4
    assert again.locator("#track").is_disabled()
    assert accessibility(again) == []
    again.click("#tab-laboratory")
    again.locator("#effects li").first.wait_for(timeout=30_000)


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
    assert "--profile rotor_1.toml" in page.locator("#command-film").inner_text()
    assert accessibility(page) == []


def _places():
    """Return centre and markers in the first frame of the first rotor film [px], as the program measures them."""
    from gyrotrack.apps.workbench._films import preview

    film = CLIPS / "rotor_1.mp4"
    found = preview(film, profile=None, hub=None, single=False, points=[], frames=120)
    return {"centre": found["centre"][0]} | {m["name"]: m["place"][0] for m in found["markers"]}


@pytest.mark.slow
def test_a_cancelled_film_is_continued_from_its_checkpoint(open_page, tmp_path):
    shutil.copy(CLIPS / "casing.mp4", tmp_path / "casing_260fps.mp4")
    page = open_page(str(tmp_path / "casing_260fps.mp4"))
    page.click("#track:enabled")
    page.locator("#tracking", has_text="of 7670 frames").wait_for(timeout=60_000)
    for _ in range(200):  # beyond the first of four parts, of which two are tracked at a time
        if int(page.locator("#tracking [data-name=state]").inner_text().split()[0]) > 4200:
            break
        page.wait_for_timeout(100)
    page.get_by_role("button", name="cancel tracking").click()
    page.locator("#tracking", has_text="checkpoint").wait_for()
    assert (tmp_path / "casing_260fps.h5.unfinished").exists()
    page.click("#track:enabled")
    page.locator("#tracking .fine", has_text="7670 angles").wait_for(timeout=120_000)
    assert not (tmp_path / "casing_260fps.h5.unfinished").exists()
    # a marker is corrected by hand in one frame, and the recording keeps it
    page.get_by_label("correction of red").check()
    page.locator("#place").fill("40")
    page.locator("#still[data-shown='1:40']").wait_for()
    box = page.locator("#still").bounding_box()
    page.locator("#still").click(position={"x": 0.6 * box["width"], "y": 0.7 * box["height"]})
    page.locator("#corrected", has_text="Frame 40: red corrected. Corrections in total: 1").wait_for(
        timeout=20_000
    )
    (note,) = read_recording(tmp_path / "casing_260fps.h5").extra["corrections"]
    assert (note["marker"], note["frame"], note["by"]) == ("red", 40, "hand")
    assert note["place_px"] == pytest.approx([0.6 * 480, 0.7 * 360], abs=2)
    assert accessibility(page) == []


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
