"""Markers found without being told their colours, on films of two renderers and a real one."""

import json
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from gyrotrack import Profile, TrackingError, propose
from gyrotrack.apps.cli._app import run
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._profile import PAPER, load, parse

ROOT = Path(__file__).parents[3]
WHEEL = ROOT.parent / "shared" / "real" / "bicycle_wheel_300fps.mp4"

ORANGE, MAGENTA, CYAN, YELLOW = (215, 110, 20), (180, 30, 150), (20, 150, 170), (200, 180, 30)
RED, BLUE, GREEN = (190, 35, 40), (35, 70, 175), (30, 135, 60)


def turning(speed, start=0.5):
    return lambda t: start + speed * t


FAST = {
    "width": 320,
    "height": 240,
    "radius": 105.0,
    "frames": 90,
    "fps": 1000.0,
    "exposure": 0.5e-3,
    "casing": turning(90.0, 2.0),
    "rotor": turning(640.0),
}


def chosen(proposal):
    return {m.profile.name: (m.profile.colour, m.profile.body) for m in proposal.markers}


PAPERS = {m.name: (m.colour, m.body) for m in PAPER.marker}


def error(track, angle, fps):
    frame = np.rint(track.time * fps)
    off = track.angle - angle(frame / fps)
    return np.std(off - np.median(off))


@pytest.mark.slow
def test_the_papers_gyroscope_is_found_and_tracked_as_well(rotor_clip):
    path, film = rotor_clip
    found = propose(path)
    assert chosen(found) == PAPERS
    assert found.notes == ()
    assert found.sound
    assert (found.profile.centre, found.profile.circle_colour) == ("circle", "red")
    mine, paper = extract(path, found.profile), extract(path, PAPER)
    for name, motion in (("casing", film.casing), ("rotor", film.rotor)):
        one, two = (error(r.bodies[name], motion, film.fps) for r in (mine, paper))
        assert one < 1.05 * two + 2e-5
        assert len(mine.bodies[name].time) == len(paper.bodies[name].time)


@pytest.mark.parametrize(
    ("settings", "markers", "disc"),
    [
        pytest.param(
            {"table": "wood", "red": ORANGE, "disc": ORANGE, "blue": MAGENTA, "green": CYAN, "glint": 0.6},
            {"orange": "casing", "magenta": "rotor", "cyan": "rotor", "white": "rotor"},
            "orange",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"red": BLUE, "disc": BLUE, "blue": RED, "green": YELLOW, "white": None, "sense": 1},
            {"blue": "casing", "red": "rotor", "yellow": "rotor"},
            "blue",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"table": "white", "glint": 0.9, "gradient": 0.35, "flicker": 0.08, "white": (245, 245, 240)},
            {"red": "casing", "blue": "rotor", "green": "rotor", "white": "rotor"},
            "red",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"table": "dark", "disc": None},
            {"red": "casing", "blue": "rotor", "green": "rotor", "white": "rotor"},
            None,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["wood", "swapped", "white", "orbit"],
)
def test_other_colours_tables_and_lights(draw, settings, markers, disc):
    path, _ = draw(**{**FAST, **settings})
    found = propose(path)
    assert {m.profile.name: m.profile.body for m in found.markers} == markers
    assert all(m.profile.name == m.profile.colour for m in found.markers)
    assert (found.profile.circle_colour if found.disc else None) == disc
    assert found.sound


@pytest.mark.slow
def test_two_markers_of_one_colour_are_reported(draw):
    path, _ = draw(**{**FAST, "green": BLUE})
    found = propose(path)
    assert any("two blue markers" in note for note in found.notes)
    assert set(chosen(found)) == {"red"}


@pytest.mark.slow
def test_a_faint_white_marker_is_named(draw):
    table = propose(draw(**{**FAST, "white": None})[0])
    assert not any("faint" in note for note in table.notes)
    faint = propose(draw(**{**FAST, "white": (126, 126, 126)})[0])
    assert set(chosen(faint)) == {"red", "blue", "green"}
    assert any("faint white patch" in note for note in faint.notes)


@pytest.mark.slow
def test_one_colour_on_both_bodies_is_reported(draw):
    path, _ = draw(**{**FAST, "blue": RED})
    found = propose(path)
    assert any("a second red marker" in note for note in found.notes)


@pytest.mark.slow
def test_a_casing_at_rest_is_known_by_the_disc(draw):
    path, _ = draw(**{**FAST, "casing": turning(0.0, 0.7)})
    found = propose(path)
    assert chosen(found) == PAPERS
    assert any("is at rest" in note for note in found.notes)


@pytest.mark.slow
def test_one_body_alone_is_uncertain_and_called_so(draw):
    path, _ = draw(**{**FAST, "rotor_papers": False})
    found = propose(path)
    assert chosen(found) == {"red": ("red", "casing")}
    assert any("Only one body" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"casing": turning(0.0), "rotor": turning(0.0)},
        {"rotor_papers": False, "casing_paper": False, "disc": None},
    ],
    ids=["rest", "nothing"],
)
def test_where_nothing_turns_nothing_is_proposed(draw, settings):
    path, _ = draw(**{**FAST, **settings, "frames": 60})
    with pytest.raises(TrackingError, match="No markers found") as caught:
        propose(path)
    assert path.name in caught.value.message
    assert caught.value.hint


@pytest.mark.slow
@pytest.mark.skipif(not WHEEL.exists(), reason="the film of the wheel is not here")
def test_the_tape_on_a_real_wheel_is_found():
    found = propose(WHEEL)
    assert chosen(found) == {"green": ("green", "rotor")}
    assert found.profile.centre == "orbit"
    assert found.sound


@pytest.mark.slow
@pytest.mark.skipif(not WHEEL.exists(), reason="the film of the wheel is not here")
def test_the_wheel_is_tracked_as_with_the_profile_by_hand():
    found = propose(WHEEL, capture_fps=300.0)
    by_hand = load(ROOT / "docs" / "bicycle.toml")
    mine = extract(WHEEL, found.profile.model_copy(update={"wander": by_hand.wander})).bodies["rotor"]
    hand = extract(WHEEL, by_hand).bodies["rotor"]
    assert len(mine.time) > 0.99 * len(hand.time)
    fits = [np.polyfit(track.time, track.angle, 2) for track in (mine, hand)]
    assert fits[0][1] == pytest.approx(fits[1][1], rel=5e-4)
    assert np.degrees(np.std(mine.angle - np.polyval(fits[0], mine.time))) < 1.0


@pytest.mark.slow
def test_the_command_writes_a_profile_that_extract_reads(casing_clip, tmp_path, capsys):
    film, target, picture = str(casing_clip[0]), tmp_path / "mine.toml", tmp_path / "mine.png"
    words = ["profile", film, "-o", str(target), "--picture", str(picture), "--capture-fps", "260"]
    assert run([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["output"] == str(target)
    assert said["verdict"] == "clear"
    assert {m["name"]: m["body"] for m in said["markers"]} == {n: b for n, (_, b) in PAPERS.items()}
    profile = load(target)
    assert profile == Profile.model_validate(said["profile"])
    assert profile.capture_fps == 260
    with av.open(str(picture)) as container:
        (drawn,) = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    panel = drawn[:, -400:].reshape(-1, 3).astype(int)  # a swatch of each colour
    for colour in (RED, BLUE, GREEN):
        assert (np.abs(panel - colour).max(axis=1) < 45).sum() > 2000
    assert run(words) == 1
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--picture", "x.jpg"], 2, ".png"),
        (["--capture-fps", "-3"], 2, "capture rate"),
        (["-o", "no/such/folder.toml"], 1, "does not exist"),
    ],
)
def test_wrong_words_are_one_sentence(casing_clip, tmp_path, capsys, monkeypatch, words, code, said):
    monkeypatch.chdir(tmp_path)
    assert run(["profile", str(casing_clip[0]), *words]) == code
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_measured_hue_survives_in_a_profile():
    marker = {"name": "a", "colour": "green", "body": "rotor", "hue": 210.5}
    assert parse({"marker": [marker]}, "p").marker[0].hue == 210.5


def discs(path, bodies, frames=60):
    """Draw grey discs with a red dot, (x, y, radius, rad per frame) each, before a coloured wall."""
    rng = np.random.default_rng(0)
    wall = np.clip(cv2.GaussianBlur(rng.normal(0, 1, (180, 320, 3)), (0, 0), 4) * 120 + 130, 0, 255)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = (
            320,
            180,
            "yuv420p",
            {"crf": "20", "x264-params": "mbtree=0"},
        )
        for k in range(frames):
            picture = wall.copy()
            for x, y, radius, step in bodies:
                dot = round(x + 0.65 * radius * np.cos(step * k)), round(y - 0.65 * radius * np.sin(step * k))
                cv2.circle(picture, (x, y), radius, (200, 200, 200), -1, cv2.LINE_AA)
                cv2.circle(picture, dot, 9, (30, 30, 160), -1, cv2.LINE_AA)
            noisy = np.clip(picture + rng.normal(0, 2.5, picture.shape), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, format="bgr24")))
        container.mux(stream.encode())
    return path


@pytest.mark.slow
def test_two_bodies_of_one_colour_are_refused_in_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    discs(tmp_path / "two.mp4", [(80, 90, 50, 0.2), (235, 90, 50, -0.31)])
    assert run(["extract", "two.mp4", "--capture-fps", "260", "--workers", "1"]) == 1
    said = capsys.readouterr().err
    assert "Two bodies" in said
    assert "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir()] == ["two.mp4"]


@pytest.mark.slow
def test_a_wall_of_the_colours_of_the_rotor_is_not_a_rotor(tmp_path):
    recording = extract(discs(tmp_path / "one.mp4", [(160, 90, 70, 0.2)]), capture_fps=260)
    assert list(recording.bodies) == ["casing"]
    assert np.ptp(recording.bodies["casing"].angle) == pytest.approx(0.2 * 59, abs=0.05)
    assert any("background" in warning for warning in recording.warnings)
