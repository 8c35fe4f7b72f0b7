"""The ghost: where a model says that a marker is, in the geometry of the picture."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from gyrotrack import Ghost, OutputError, UsageError, ghosts
from gyrotrack.plotting._ghost import (
    Stretch,
    animation,
    check_ghost_film,
    ghost_document,
    outline,
    turned,
    write_ghost_film,
)

HUB, RADIUS = np.array([60.0, 50.0]), 30.0


def made(differences, *, sense=1, frames=None, angle=0.3):
    """Return a ghost whose marker points to `angle` in the picture."""
    differences = np.atleast_2d(np.asarray(differences, dtype=float))
    n = differences.shape[1]
    number = np.arange(n) if frames is None else np.asarray(frames)
    hub = np.tile(HUB, (n, 1))
    square = RADIUS * np.array([[0.9, -0.1], [0.9, 0.1], [1.1, 0.1], [1.1, -0.1]])
    outlines = turned(hub[:, None] + square, hub, np.full(n, angle))
    names = tuple(f"model {i}" for i in range(len(differences)))
    return Ghost(
        "casing", "casing", number, 0.1 * number, names, differences, np.full_like(differences, 1e-3),
        {"red": outlines}, hub, sense,
    )  # fmt: skip


def angle_of(places):
    x, y = (places.mean(axis=-2) - HUB).T
    return np.arctan2(-y, x)


@pytest.mark.parametrize("sense", [1, -1])
def test_the_ghost_is_behind_by_the_difference_in_the_sense_of_rotation(sense):
    """Film minus model 0.1 rad: the model is 0.1 rad behind; clockwise motion (-1) makes it counter-clockwise."""
    found = made([0.1, -0.2], sense=sense)
    away = angle_of(found.turned("red", 0)) - angle_of(found.outlines["red"])
    assert away == pytest.approx([-0.1 * sense, 0.2 * sense])
    away = angle_of(found.turned("red", 0, 2)) - angle_of(found.outlines["red"])
    assert away == pytest.approx([-0.2 * sense, 0.4 * sense])


def test_points_are_turned_counter_clockwise_where_y_points_down():
    place = turned(np.array([[[61.0, 50.0]]]), HUB[None], np.array([np.pi / 2]))
    assert place[0, 0] == pytest.approx([60.0, 49.0])


@pytest.mark.parametrize(
    ("pixels", "factor"),
    [(8.1, 1), (7.9, 2), (0.5, 20), (0.016, 1000), (0.0, 1)],
)
def test_a_difference_below_eight_pixels_is_magnified_to_about_sixteen(pixels, factor):
    found = made([[0.0, pixels / RADIUS], [0.0, 0.0]])
    assert found.radius == pytest.approx(RADIUS)
    assert found.factor == factor
    assert found.factor == 1 or pixels * found.factor <= 16 * (1 + 1e-9)


def marker(**changes):
    n = 3
    corner = np.full((n, 2, 2), np.nan)
    corner[0] = [[88.0, 47.0], [88.0, 53.0]]
    angle = np.array([0.0, np.pi / 2, np.nan])
    values = {"corner": corner, "rho": np.full(n, 28.0), "delta": np.full(n, 6.0), "angle_fine": angle}
    return SimpleNamespace(**(values | changes))


def test_an_outline_has_the_near_corners_and_two_behind_them():
    found = outline(marker(), np.tile(HUB, (3, 1)), 1)
    assert found[0] == pytest.approx(np.array([[88, 47], [88, 53], [95.8, 53], [95.8, 47]]), abs=1e-9)
    # found by its angle alone: straight up, as wide as the median marker
    assert found[1, :2].mean(axis=0) == pytest.approx([60.0, 22.0])
    assert np.linalg.norm(found[1, 0] - found[1, 1]) == pytest.approx(6.0)
    assert np.isnan(found[2]).all()
    assert np.isnan(outline(marker(rho=np.full(3, np.nan)), np.tile(HUB, (3, 1)), 1)).all()


def test_the_document_has_a_ghost_per_frame():
    found = made([[0.1, 0.2]])
    found.outlines["red"][1] = np.nan
    document = ghost_document(found)
    assert {k: document[k] for k in ("clip", "body", "model", "factor", "frames")} == {
        "clip": "casing", "body": "casing", "model": "model 0", "factor": 2, "frames": [0, 1],
    }  # fmt: skip
    assert document["markers"]["red"]["measured"][1] is None
    assert document["markers"]["red"]["ghost"][1] is None
    assert np.array(document["markers"]["red"]["ghost"][0]) == pytest.approx(
        found.turned("red", 0, 2)[0], abs=0.006
    )
    assert document["difference"] == [0.1, 0.2]
    assert ghost_document(found, factor=1)["factor"] == 1


class Blank:
    """A film whose every frame is grey; frames in `missing` cannot be decoded."""

    def __init__(self, missing=()):
        self.missing = missing

    def picture(self, index, *, overlay=True):
        return None if index in self.missing else np.full((100, 120, 3), 90, dtype=np.uint8)


def test_an_animation_shows_all_models_and_says_the_factor(monkeypatch):
    monkeypatch.setattr("gyrotrack.plotting._ghost._FRAMES", 5)
    found = made([np.linspace(0, 0.004, 50), np.zeros(50)])
    picture = animation(found, Blank(), 1.0, 3.0)
    moving = Image.open(io.BytesIO(picture.webp))
    assert moving.n_frames == 5
    assert moving.size == (picture.width, picture.height)
    assert picture.jpeg.startswith(b"\xff\xd8")
    assert "model 0 2.6 ± 1.0 mrad" in picture.finding
    assert "0.70 s to 3.20 s" in picture.finding
    assert f"{found.inside(0.7, 3.3).factor} times as large" in picture.caption
    assert "times as large" not in animation(made(np.linspace(0, 0.5, 50)), Blank(), 1.0, 3.0).caption
    assert animation(found, Blank(range(50)), 1.0, 3.0) is None
    assert animation(found, Blank(), 9.0, 9.5) is None


def test_the_real_marker_and_the_ghost_are_drawn_where_they_are():
    """The picture is turned so that the ghost points up; the real marker is drawn at the difference from it."""
    found = made([[0.5]])
    frame = np.asarray(
        Image.open(io.BytesIO(animation(found, Blank(), -1.0, 1.0).webp)).convert("RGB")
    ).astype(int)
    panel = frame[40:280, :240]
    orange = (panel[..., 0] - panel[..., 2] > 90) & (panel[..., 0] > 150)
    rows, columns = np.nonzero(orange)
    assert columns.mean() == pytest.approx(120, abs=3)
    assert rows.mean() < 120
    white = (panel.min(axis=2) > 170) & ~orange
    y, x = (v.mean() - 120 for v in np.nonzero(white))
    # the film is ahead, counter-clockwise, of a model that points up
    assert np.arctan2(-y, x) == pytest.approx(np.pi / 2 + 0.5, abs=0.08)


def test_names_of_films_are_checked(tmp_path):
    with pytest.raises(UsageError, match="Unknown format of an overlay"):
        check_ghost_film(tmp_path / "a.gif", force=False)
    (tmp_path / "a.mp4").write_bytes(b"")
    with pytest.raises(OutputError):
        check_ghost_film(tmp_path / "a.mp4", force=False)
    with pytest.raises(OutputError, match="no stretch of film"):
        write_ghost_film(tmp_path / "b.mp4", [])


def test_a_film_has_consecutive_frames_around_the_largest_difference(tmp_path, monkeypatch):
    import av

    from gyrotrack.plotting import _frames

    class Opened(Blank):
        def __init__(self, path, recording):
            super().__init__()

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

    monkeypatch.setattr(_frames, "Film", Opened)
    monkeypatch.setattr("gyrotrack.plotting._ghost._LONGEST", 6)
    monkeypatch.setattr("gyrotrack.plotting._ghost._FRAMES", 5)
    difference = np.zeros(40)
    difference[30] = 0.4
    found = made([difference, np.zeros(40)])
    seen = []
    stretch = Stretch(found, tmp_path, SimpleNamespace(capture_fps=250.0), 0.0, 3.9)
    path = write_ghost_film(tmp_path / "a.mp4", [stretch], progress=lambda *x: seen.append(x))
    with av.open(str(path)) as film:
        assert sum(1 for _ in film.decode(video=0)) == 6
        assert (film.streams.video[0].width, film.streams.video[0].height) == (960, 544)
    with Image.open(write_ghost_film(tmp_path / "a.webp", [stretch])) as moving:
        assert moving.n_frames == 5


def test_a_case_without_films_has_no_ghost():
    record = SimpleNamespace(quantity="angle", parts=frozenset({"casing"}))
    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(record=record)]))
    assert ghosts(SimpleNamespace(recordings={}), [fit], ["base"]) == []
