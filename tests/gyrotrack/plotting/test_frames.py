"""Overlays of detections and proposals: places of pixels, captions and panels; films by their hash or their size."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack import OutputError, UsageError, VideoError
from gyrotrack.io._schema import STATUS
from gyrotrack.plotting import _frames as module
from gyrotrack.plotting._frames import colour_picture, find_film, with_detections
from gyrotrack.video._container import Frame

WIDTH, HEIGHT = 200, 160
OK = STATUS["ok"]
PART = next(code for word, code in STATUS.items() if word != "ok")
GREEN, ORANGE = (60, 255, 60), (0, 200, 255)


def frame(level=0):
    y = np.full((HEIGHT, WIDTH), level, np.uint8)
    return Frame(0, 0, y, *(np.full((HEIGHT // 2, WIDTH // 2), 128, np.uint8) for _ in range(2)))


def marker(status=OK, angle=0.5 * np.pi, rho=50.0, corner=((110.0, 40.0), (90.0, 40.0)), **more):
    parts = {
        "name": "M1", "status": np.array([status, OK]), "angle_fine": np.array([angle, angle]),
        "rho": np.array([[rho, np.nan], [rho, rho]]), "corner": np.array([corner, corner]),
        "sigma": np.array([0.25, np.nan]), "sigma_calibrated": np.array([0.002, 0.002]),
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


def recording(*markers, sense=1, centre=(100.0, 80.0), **more):
    parts = {
        "markers": {m.name: m for m in markers}, "centre": np.array([centre, centre]), "sense": sense,
        "time": np.array([0.0, 0.5]), "source": "/films/a.mp4", "source_sha256": "", "width": WIDTH,
        "height": HEIGHT, "frames_declared": 2, "frames_decoded": 2, "capture_fps": 260.0,
        "bodies": {
            "casing": SimpleNamespace(
                time=np.array([0.0]), angle=np.array([1.5]), sigma=np.array([0.01]), n_markers=np.array([1])
            )
        },
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


def near(picture, colour, tolerance=70):
    """Return the box (left, right, top, bottom) of the pixels of about this colour (BGR); None without one."""
    rows, columns = np.nonzero(np.abs(picture.astype(int) - colour).max(axis=2) < tolerance)
    keep = rows > 22  # below the text in the corner
    if not keep.any():
        return None
    return columns[keep].min(), columns[keep].max(), rows[keep].min(), rows[keep].max()


class TestColours:
    @pytest.mark.parametrize(("u", "v", "largest"), [(220, 128, 0), (128, 220, 2), (20, 20, 1)])
    def test_chroma_gives_blue_red_and_green(self, u, v, largest):
        planes = [np.full((4, 6), 128, np.uint8), np.full((2, 3), u, np.uint8), np.full((2, 3), v, np.uint8)]
        picture = colour_picture(Frame(0, 0, *planes))
        assert picture.shape == (4, 6, 3)
        assert int(np.argmax(picture[1, 1])) == largest

    def test_without_chroma_it_is_grey(self):
        assert (colour_picture(frame(77)) == 77).all()


class TestDetections:
    def drawn(self, m, **more):
        made = recording(m, **more)
        made.centre = made.centre.astype(float)
        return with_detections(frame(), 0, made)

    @pytest.mark.parametrize(("angle", "sense"), [(0.5 * np.pi, 1), (-0.5 * np.pi, -1)])
    def test_a_ray_points_up_at_a_quarter_turn(self, angle, sense):
        """It extends from 0.9 to 1.15 of the radius of 50 px; the centre is at (100, 80)."""
        far = ((500.0, 500.0), (500.0, 500.0))  # corners outside of the picture
        left, right, top, bottom = near(
            self.drawn(marker(angle=angle, corner=far), sense=sense)[:, :101], GREEN
        )
        assert abs(left - 100) <= 1
        assert abs(right - 100) <= 1
        assert bottom == pytest.approx(80 - 45, abs=1)
        assert top == pytest.approx(80 - 57.5, abs=1.5)

    def test_corners_of_a_complete_marker_are_circles(self):
        picture = self.drawn(marker(angle=0.0, corner=((60.0, 120.0), (90.0, 120.0))))
        box = near(picture[100:], GREEN)
        assert box[:2] == (pytest.approx(57, abs=2), pytest.approx(93, abs=2))
        picture = self.drawn(marker(PART, angle=0.0, corner=((60.0, 120.0), (90.0, 120.0))))
        assert near(picture, GREEN, 40) is None
        assert near(picture, ORANGE) is not None

    @pytest.mark.parametrize("change", [{"angle": np.nan}, {"rho": np.nan}])
    def test_a_marker_without_a_place_is_not_drawn(self, change):
        m = marker(**change)
        m.rho = np.full((2, 2), np.nan) if "rho" in change else m.rho
        assert near(self.drawn(m), GREEN, 40) is None

    def test_the_centre_is_a_cross_if_it_is_known(self):
        found = near(self.drawn(marker(angle=np.nan)), (255, 255, 255))
        assert found == pytest.approx((94, 106, 74, 86), abs=1)
        assert near(self.drawn(marker(), centre=(np.nan, np.nan)), (255, 255, 255)) is None

    def test_places_are_rounded(self):
        assert module._point(np.array([1.6, 2.4])) == (2, 2)
        assert module._enlarged((1.0, 2.0), 2.0) == (3, 5)


class TestFilms:
    def found(self, monkeypatch, tmp_path, content=b"film", frames=2, size=(WIDTH, HEIGHT), **more):
        path = tmp_path / "a.mp4"
        path.write_bytes(content)
        probed = []

        def probe(path):
            probed.append(path)
            if frames is None:
                raise VideoError("no film", "")
            return SimpleNamespace(width=size[0], height=size[1], frames_declared=frames)

        monkeypatch.setattr(module, "probe", probe)
        return find_film(recording(**more), [tmp_path / "other", tmp_path]) == path, bool(probed)

    def test_a_film_has_the_hash_of_the_recording(self, monkeypatch, tmp_path):
        import hashlib

        right = hashlib.sha256(b"film").hexdigest()
        assert self.found(monkeypatch, tmp_path, source_sha256=right) == (True, False)
        assert self.found(monkeypatch, tmp_path, source_sha256="0" * 64) == (False, False)

    @pytest.mark.parametrize(
        ("change", "found"),
        [
            ({}, True), ({"frames": 3}, False), ({"size": (HEIGHT, WIDTH)}, True),  # stored upright
            ({"size": (WIDTH, WIDTH)}, False), ({"frames": None}, False),
        ],
    )  # fmt: skip
    def test_large_films_have_the_size_and_the_number_of_frames(self, monkeypatch, tmp_path, change, found):
        monkeypatch.setattr(module, "_MAX_HASHED", 3)
        assert self.found(monkeypatch, tmp_path, source_sha256="0" * 64, **change) == (found, True)
        assert self.found(monkeypatch, tmp_path, **change) == (found, True)

    def test_a_recording_without_a_name_has_no_film(self, tmp_path):
        assert find_film(recording(source=""), [tmp_path]) is None
        assert find_film(recording(source="missing.mp4"), [tmp_path]) is None


class TestSheets:
    @pytest.mark.parametrize(
        ("time", "count", "text"),
        [
            (0.0, 1, "casing: 1.5000 +- 0.0100 rad, 1 marker"),
            (5e-10, 2, "casing: 1.5000 +- 0.0100 rad, 2 markers"),
            (2e-9, 1, "casing: no angle"),
            (-0.5, 1, "casing: no angle"),
            (0.5, 1, "casing: no angle"),
        ],
    )
    def test_a_body_has_its_angle_in_the_frame(self, time, count, text):
        made = recording()
        made.time[0] = time
        made.bodies["casing"].n_markers[0] = count
        assert module._body_line("casing", 0, made) == text

    def test_a_marker_has_its_status_and_both_uncertainties(self):
        made = recording(marker(angle=0.5))
        assert module._marker_line("M1", 0, made) == "  M1: ok, 0.5000 +- 0.0020 (marker 0.25)"
        assert module._marker_line("M1", 1, made) == "  M1: ok, 0.5000 +- 0.0020"
        assert module._marker_line("M1", 0, recording(marker(angle=np.nan))) == "  M1: ok"

    @pytest.mark.parametrize("width", [100, 1000])
    def test_a_tile_has_the_picture_and_a_line_for_each_body_and_marker(self, width):
        tile = module._tile(
            np.full((width // 2, width, 3), 40, np.uint8), 0, recording(marker(), marker(name="M2"))
        )
        assert tile.shape == (260 + 17 * 3 + 14, 520 + 8, 3)
        assert (tile[4:264, 4:524] == 40).all()
        assert (tile[:4] == 255).all()
        assert (tile[264:] < 100).any()  # text

    @pytest.mark.parametrize(("decoded", "count"), [(100, 12), (5, 5), (1, 1)])
    def test_twelve_frames_are_spread_over_the_film(self, monkeypatch, decoded, count):
        asked = []
        monkeypatch.setattr(module, "probe", lambda _: SimpleNamespace(time_base=0.01))
        monkeypatch.setattr(
            module, "frames_at", lambda path, stamps: asked.extend(stamps) or {s: s for s in stamps}
        )
        monkeypatch.setattr(module, "with_detections", lambda found, k, r: (found, k))
        r = recording(frames_decoded=decoded, pts_time=0.03 * np.arange(decoded))
        found = module._selected_frames("film", r)
        assert len(found) == count
        assert [k for k, _ in found][:: max(count - 1, 1)] == ([0, decoded - 1] if count > 1 else [0])
        assert asked == [3 * k for k, _ in found]
        assert [p for _, p in found] == [(3 * k, k) for k, _ in found]

    def test_without_timestamps_the_film_is_read(self, monkeypatch):
        class Reader:
            def __init__(self, path):
                pass

            def __enter__(self):
                return iter([SimpleNamespace(index=k) for k in range(4)])

            def __exit__(self, *_):
                pass

        monkeypatch.setattr(module, "probe", lambda _: SimpleNamespace(time_base=0.01))
        monkeypatch.setattr(module, "frames_at", lambda path, stamps: {})
        monkeypatch.setattr(module, "with_detections", lambda found, k, r: k)
        monkeypatch.setattr(module, "Reader", Reader)
        monkeypatch.setattr(module, "FRAMES", 2)
        r = recording(frames_decoded=4, pts_time=np.array([0.0, np.nan, np.nan, np.nan]))
        assert module._selected_frames("film", r) == [(0, 0), (3, 3)]

    @pytest.mark.parametrize(("count", "rows"), [(1, 1), (4, 1), (5, 2), (12, 3)])
    def test_a_sheet_has_four_columns(self, monkeypatch, tmp_path, count, rows):
        monkeypatch.setattr(module, "_selected_frames", lambda *_: [(k, k) for k in range(count)])
        monkeypatch.setattr(module, "_tile", lambda picture, k, r: np.full((20, 30, 3), k, np.uint8))
        module.write_contact_sheet(tmp_path / "a.png", "film", recording())
        sheet = cv2.imread(str(tmp_path / "a.png"))
        assert sheet.shape == (30 + 20 * rows, 30 * min(4, 4), 3)
        assert [int(sheet[35 + 20 * (k // 4), 30 * (k % 4) + 5, 0]) for k in range(count)] == list(
            range(count)
        )
        assert (sheet[-1, -1] == (255 if count % 4 else count - 1)).all()

    def test_a_film_without_frames_has_no_sheet(self, monkeypatch, tmp_path):
        monkeypatch.setattr(module, "_selected_frames", lambda *_: [])
        with pytest.raises(OutputError, match="No frame"):
            module.write_contact_sheet(tmp_path / "a.png", "film", recording())

    @pytest.mark.parametrize(
        ("name", "sheet", "overlay"), [("a.png", 1, 1), ("a.PNG", 1, 1), ("a.mp4", 0, 1), ("a.gif", 0, 0)]
    )
    def test_formats_are_those_of_the_suffix(self, tmp_path, name, sheet, overlay):
        for check, allowed in ((module.check_contact_sheet, sheet), (module.check_overlay, overlay)):
            if allowed:
                check(tmp_path / name, force=False)
            else:
                with pytest.raises(UsageError, match="Unknown format"):
                    check(tmp_path / name, force=False)
        (tmp_path / name).touch()
        if overlay:
            with pytest.raises(OutputError):
                module.check_overlay(tmp_path / name, force=False)
            module.check_overlay(tmp_path / name, force=True)


class TestHeld:
    def film(self):
        film = object.__new__(module.Film)
        film._held = {}
        return film

    @pytest.mark.parametrize(("width", "most"), [(100, 48), (4000, 3), (2000, 12), (9000, 2)])
    def test_frames_are_held_up_to_a_size(self, width, most):
        film = self.film()
        for k in range(60):
            film._hold(SimpleNamespace(pts=k, width=width, height=int(0.625 * width)))
        expected = max(2, min(48, int(48 * 2**20 // (1.5 * width * int(0.625 * width)))))
        assert len(film._held) == expected
        assert expected == pytest.approx(most, abs=1)
        assert list(film._held) == list(range(60 - expected, 60))

    def test_a_frame_that_is_decoded_again_is_the_latest(self):
        film = self.film()
        for pts in (1, 2, 3, 1):
            film._hold(SimpleNamespace(pts=pts, width=10, height=10))
        assert list(film._held) == [2, 3, 1]


GEOMETRY = SimpleNamespace(
    inner=40.0, outer=60.0, half_width=0.2, radius=50.0, colour="white", contrast=(100.0, 0.0)
)


class TestProposals:
    def proposed(self, colour="white", **more):
        geometry = SimpleNamespace(**(vars(GEOMETRY) | {"colour": colour} | more))
        profile = SimpleNamespace(name="M1", body="casing", hue=None, colour=colour)
        return SimpleNamespace(marker=geometry, profile=profile, angle=np.zeros(1), seen=0.9)

    def test_the_outline_is_a_sector_of_a_ring(self):
        found = module._sector(GEOMETRY, 0.5 * np.pi, (100.0, 80.0), 1.0)
        x, y = found.T.astype(float)
        radius, turn = np.hypot(x - 100.5, y - 80.5), np.arctan2(80.5 - y, x - 100.5)
        assert np.sort(radius) == pytest.approx(np.repeat([40.0, 60.0], 9), abs=1.0)
        assert (turn.min(), turn.max()) == pytest.approx((0.5 * np.pi - 0.2, 0.5 * np.pi + 0.2), abs=0.03)
        narrow = module._sector(GEOMETRY, 0.0, (100.0, 80.0), 10.0, inset=5.0, width=0.5)
        x, y = narrow.T.astype(float)
        radius = np.hypot(x - 1005, y - 805) / 10
        assert (radius.min(), radius.max()) == pytest.approx((45.0, 55.0), abs=0.1)
        assert np.ptp(np.arctan2(805 - y, x - 1005)) == pytest.approx(0.2, abs=0.01)

    def test_the_colour_is_that_of_the_middle(self):
        picture = np.full((HEIGHT, WIDTH, 3), 10, np.uint8)
        cv2.fillPoly(picture, [module._sector(GEOMETRY, 0.0, (100.0, 80.0), 1.0, 3.0, 0.7)], (20, 120, 220))
        assert module._mean_colour(picture, GEOMETRY, 0.0, (100.0, 80.0)) == (20, 120, 220)

    @pytest.mark.parametrize("colour", ["white", "red"])
    @pytest.mark.parametrize("scale", [1, 3])
    def test_pixels_of_the_colour_of_a_marker_are_marked(self, colour, scale):
        centre, angle = (100.0, 80.0), 0.5 * np.pi
        y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
        radius, turn = np.hypot(x - 100, y - 80), np.arctan2(80 - y, x - 100)
        inside = (radius > 40) & (radius < 60) & (np.abs(turn - angle) < 0.2)
        plane = np.where(inside, 150, 50).astype(np.uint8)
        made = frame(50)
        if colour == "white":
            made = Frame(0, 0, plane, made.u, made.v)
        else:
            made = Frame(0, 0, made.y, plane[::2, ::2].copy(), made.v)
        found = module._mask(made, self.proposed(colour), angle, centre, (HEIGHT * scale, WIDTH * scale, 3))
        assert found.shape == (HEIGHT * scale, WIDTH * scale)
        large = cv2.resize(inside.astype(np.uint8), (WIDTH * scale, HEIGHT * scale)).astype(bool)
        both = (found > 0) & large
        assert both.sum() > 0.8 * large.sum()
        assert (found > 0).sum() < 1.3 * large.sum()

    def proposal(self, *markers, disc=None):
        return SimpleNamespace(
            markers=markers, disc=disc, centre=(100.0, 80.0),
            profile=SimpleNamespace(name="rig", circle_colour="white"),
        )  # fmt: skip

    def test_a_panel_has_a_swatch_and_a_caption_for_each_marker(self, monkeypatch):
        texts = []
        monkeypatch.setattr(module, "_write", lambda panel, text, *_, **__: texts.append(text))
        red = self.proposed("red", contrast=(30.0, 40.0))
        red.profile.name, red.profile.hue = "M2", 12.4
        colours = {"M1": (10, 20, 30), "M2": (40, 50, 60)}
        panel = module._panel(self.proposal(self.proposed(), red), colours, 100)
        assert panel.shape == (78 * 2 + 100, 430, 3)
        assert module._panel(self.proposal(self.proposed()), colours, 500).shape[0] == 500
        assert panel[100, 40].tolist() == [10, 20, 30]
        assert panel[178, 40].tolist() == [40, 50, 60]
        assert texts[:2] == ["rig", "centre (100, 80) px: the markers' orbit"]
        assert texts[2:8] == [
            "M1 on the casing", "white; contrast 100 of 255", "20 x 20 px at 50 px; fully visible in 90 %",
            "M2 on the casing", "red, hue 12 deg; contrast 50 of 255", "20 x 20 px at 50 px; fully visible in 90 %",
        ]  # fmt: skip
        module._panel(self.proposal(disc=SimpleNamespace(radius=9.0)), {}, 10)
        assert texts[-1].endswith("white disc, radius 9 px")

    def test_the_centre_is_a_cross_and_a_disc(self):
        big = np.full((HEIGHT * 2, WIDTH * 2, 3), 100, np.uint8)
        module._draw_centre(big, self.proposal(disc=SimpleNamespace(radius=20.0)), 2.0)
        assert big[161, 201].min() > 250  # twice (100.5, 80.5)
        assert big[161, 201 + 40].min() > 200
        big[:] = 100
        module._draw_centre(big, self.proposal(), 2.0)
        assert big[161, 201 + 40].tolist() == [100, 100, 100]

    def test_notes_are_wrapped_to_the_width(self, monkeypatch):
        lines = []
        monkeypatch.setattr(module, "_text_panel", lambda found, width: lines.extend(found))
        module._notes_panel(["word " * 20, "short"], 300)
        assert lines[0] == "- " + " ".join(["word"] * 6)
        assert all(8.2 * len(x) <= 300 for x in lines)
        assert lines[1].startswith("  word")
        assert lines[-1] == "- short"
        assert " ".join(lines).count("word") == 20

    @pytest.mark.parametrize(("count", "height"), [(0, 0), (1, 36), (3, 76)])
    def test_a_panel_of_text_has_twenty_pixels_a_line(self, count, height):
        assert module._text_panel(["x"] * count, 50).shape == (height, 50, 3)

    def test_a_picture_is_padded_below(self):
        padded = module._padded(np.zeros((3, 4, 3), np.uint8), 5)
        assert padded[:, 0, 0].tolist() == [0, 0, 0, 255, 255]

    def test_tiles_are_side_by_side(self, tmp_path):
        tiles = [np.full((40, 80, 3), v, np.uint8) for v in (10, 200)]
        module.write_tiles(tmp_path / "a.png", tiles, "text")
        picture = cv2.imread(str(tmp_path / "a.png"))
        assert picture.shape == (36 + 400, 1600, 3)
        assert (picture[100, 100, 0], picture[100, 1500, 0]) == (10, 200)

    @pytest.mark.parametrize(
        ("width", "scale"), [(200, 4.0), (400, 2.0), (500, 2.0), (1000, 1.0), (2800, 0.5)]
    )
    def test_small_pictures_are_enlarged_and_large_ones_reduced(self, monkeypatch, tmp_path, width, scale):
        planes = [
            np.zeros((100, width), np.uint8),
            *(np.full((50, width // 2), 128, np.uint8) for _ in range(2)),
        ]
        seen, rows = [], []
        monkeypatch.setattr(
            module,
            "_draw_proposed",
            lambda big, m, frame, angle, centre, scale: seen.append((big.shape, angle, scale)),
        )
        monkeypatch.setattr(module, "_draw_centre", lambda *_: None)
        monkeypatch.setattr(module, "_write_png", lambda path, parts, *, force: rows.extend(parts))
        first = self.proposed()
        first.clear, first.angle = np.array([True, True, False]), np.array([0.1, 0.2, 0.3])
        second = self.proposed()
        second.clear, second.angle = np.array([False, True, True]), np.array([1.1, 1.2, 1.3])
        made = self.proposal(first, second)
        made.samples, made.notes = SimpleNamespace(frames=[Frame(0, 0, *planes)] * 3), ["note"]
        module.write_picture(tmp_path / "a.png", made)
        # of the three frames, the second one shows both markers
        assert seen == [((round(100 * scale), round(width * scale), 3), a, scale) for a in (0.2, 1.2)]
        assert len({r.shape[1] for r in rows}) == 1
        assert rows[0].shape[1] == round(width * scale) + 430
