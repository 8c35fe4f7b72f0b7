"""Parts, clips and stretches of ghosts, from residual angles of known size."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from gyrotrack.plotting import _ghost as module
from gyrotrack.plotting._ghost import Ghost, Stretch, animated, ghosts, stretches


def ghost(count=10, differences=None, *, outlines=True, rate=10.0, body="casing", clip="casing"):
    t = np.arange(count) / rate
    d = np.atleast_2d(np.zeros(count) if differences is None else np.asarray(differences, float))
    hub = np.tile([50.0, 40.0], (count, 1))
    square = np.array([[28.0, -2.0], [28.0, 2.0], [32.0, 2.0], [32.0, -2.0]])
    shapes = {"M": hub[:, None] + square} if outlines else {}
    names = tuple(f"m{i}" for i in range(len(d)))
    return Ghost(clip, body, np.arange(count) + 100, t, names, d, 0.1 * np.abs(d), shapes, hub, 1)


class TestParts:
    def test_both_ends_belong_to_a_part(self):
        found = ghost(differences=np.arange(10.0)).inside(0.2, 0.5)
        assert found.frame.tolist() == [102, 103, 104, 105]
        assert found.difference[0].tolist() == [2.0, 3.0, 4.0, 5.0]
        assert (len(found.hub), len(found.outlines["M"]), found.sigma.shape) == (4, 4, (1, 4))

    def test_the_radius_is_the_median_of_the_known_outlines(self):
        found = ghost()
        assert found.radius == pytest.approx(30.0)
        found = ghost()
        found.outlines["M"][:9] = np.nan
        assert found.radius == pytest.approx(30.0)
        assert np.isnan(ghost(outlines=False).radius)
        assert ghost(outlines=False, differences=np.full(10, 1e-3)).factor == 1

    def test_a_magnified_difference_is_at_most_six_tenths_of_a_radian(self):
        """About a hub 10 px away, 16 px would be 1.6 rad."""
        found = ghost(differences=np.full(10, 0.01))
        found.outlines["M"][:] = found.hub[:, None] + np.array([[9.0, -1], [9, 1], [11, 1], [11, -1]])
        assert found.radius == pytest.approx(10.0)
        assert found.factor == 50

    @pytest.mark.parametrize(
        ("count", "worst", "first"), [(250, 30, 0), (400, 30, 0), (400, 200, 75), (400, 390, 150)]
    )
    def test_a_film_has_250_frames_around_the_largest_difference(self, count, worst, first):
        d = np.zeros((2, count))
        d[0, worst], d[1, 5] = -1.0, 9.0
        found = module._around_worst(ghost(count, d), 0.0, count / 10.0)
        assert found.frame[0] == 100 + first
        assert len(found.frame) == 250

    def test_a_stretch_has_frames_before_and_after_it(self):
        assert module._around_worst(ghost(100), 2.0, 4.0).time[[0, -1]] == pytest.approx([1.7, 4.3])


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.1, "0.10 rad"), (-0.25, "−0.25 rad"), (0.0999, "100 mrad"), (-2e-3, "−2.0 mrad"), (0.0, "0 mrad")],
)
def test_small_angles_are_in_mrad(value, text):
    assert module._angle(value) == text


def test_the_largest_difference_of_each_model_is_stated():
    d = np.array([[0.0, -3e-3, 1e-3], [2e-3, 1e-3, 0.0]])
    found = module._finding(ghost(3, d))
    assert found == (
        "0.00 s to 0.20 s, casing: largest difference of the angle, film minus model: m0 −3.0 ± 0.3 mrad; m1 "
        "2.00 ± 0.20 mrad."
    )


def marker(name, body, count=5, rho=28.0):
    return SimpleNamespace(
        name=name, body=body, corner=np.full((count, 2, 2), np.nan), rho=np.full(count, rho),
        delta=np.full(count, 6.0), angle_fine=np.zeros(count),
    )  # fmt: skip


def recording(*markers, count=5, bodies=(), centre=(60.0, 50.0)):
    return SimpleNamespace(
        time=np.arange(count) * 1.0, centre=np.tile(centre, (count, 1)), sense=-1, width=200, height=80,
        markers={m.name: m for m in markers},
        bodies={b: SimpleNamespace(time=np.arange(1.0, 4.0), angle=np.array([0.0, 0.5, 1.0])) for b in bodies},
    )  # fmt: skip


class TestOutlines:
    def test_the_hub_of_a_frame_without_one_is_the_median(self):
        centre = np.array([[1.0, 2.0], [np.nan, 5.0], [3.0, 4.0], [5.0, 9.0]])
        assert module._filled(centre).tolist() == [[1.0, 2.0], [3.0, 4.0], [3.0, 4.0], [5.0, 9.0]]
        assert np.isnan(module._filled(np.full((2, 2), np.nan))).all()

    def test_markers_of_other_bodies_are_omitted(self):
        r = recording(marker("C", "casing"), marker("R", "rotor"), marker("X", "casing", rho=np.nan))
        assert list(module._outlines(r, {"rotor"})) == ["C"]
        assert list(module._outlines(r, {"casing"})) == ["R"]

    def test_a_body_without_markers_has_a_pointer(self):
        """It begins at half of the distance to the border, 30 px below the hub; clockwise angles are negative."""
        found = module._outlines(recording(bodies=("rotor", "casing")), {"rotor"})["pointer"]
        assert np.isnan(found[[0, 4]]).all()
        near = found[:, :2].mean(axis=1) - [60.0, 50.0]
        assert np.linalg.norm(near[1:4], axis=1) == pytest.approx([15.0] * 3)
        assert np.arctan2(-near[1:4, 1], near[1:4, 0]) == pytest.approx([0.0, -0.5, -1.0])
        assert np.linalg.norm(found[2, 0] - found[2, 1]) == pytest.approx(0.15 * 15.0)
        assert module._outlines(recording(), {"rotor"}) == {}
        assert module._outlines(recording(bodies=("casing",), centre=(-5.0, 50.0)), set()) == {}
        assert module._outlines(recording(bodies=("rotor",)), {"rotor"}) == {}


class TestGhosts:
    """Two fits of a case with a casing clip and two clips of the rotor."""

    def case(self, windows=(1, 2)):
        clips = {
            "casing": recording(marker("C", "casing")),
            **{f"rotor_{w}": recording(marker("R", "rotor")) for w in windows},
        }
        return SimpleNamespace(
            recordings=clips | {"other": recording()},
            placements={"rotor_2": SimpleNamespace(clock_offset=100.0, clock_rate=2.0)},
            rotor=SimpleNamespace(window=np.repeat(windows, 3) if windows else None),
        )  # fmt: skip

    def fits(self, quantity="angle", known=5):
        def fit(size):
            def run(i):
                def at(time):
                    value = np.where(np.arange(5) < known, size + i + 0.01 * time, np.nan)
                    return value, np.full(5, 0.1 * size)

                return SimpleNamespace(at=at)

            record = SimpleNamespace(quantity=quantity, parts={"casing", "rotor"})
            return SimpleNamespace(
                problem=SimpleNamespace(data=[None, SimpleNamespace(record=record)]),
                angle_residuals=lambda index: [run(i) for i in range(3)] if index == 1 else None,
            )

        return [fit(10.0), fit(20.0)]

    def test_each_clip_has_its_run_of_the_residuals(self):
        found = ghosts(self.case(), self.fits(), ("base", "final"), 1)
        assert [(g.clip, g.body, list(g.outlines)) for g in found] == [
            ("casing", "casing", ["C"]), ("rotor_1", "rotor", ["R"]), ("rotor_2", "rotor", ["R"]),
        ]  # fmt: skip
        assert [g.time[1] for g in found] == [1.0, 1.0, 102.0]
        assert [g.difference[:, 1].tolist() for g in found] == [
            pytest.approx([10.01, 20.01]), pytest.approx([11.01, 21.01]), pytest.approx([13.02, 23.02])
        ]  # fmt: skip
        assert found[0].sigma[:, 0].tolist() == [1.0, 2.0]
        assert (found[0].models, found[0].sense) == (("base", "final"), -1)

    def test_frames_outside_of_the_fitted_run_are_omitted(self):
        assert [len(g.time) for g in ghosts(self.case(), self.fits(known=3), ("a", "b"), 1)] == [3, 3, 3]
        assert ghosts(self.case(), self.fits(known=0), ("a", "b"), 1) == []

    def test_speeds_and_cases_without_films_have_none(self):
        assert ghosts(self.case(), self.fits("omega"), ("a", "b"), 1) == []
        case = self.case()
        case.recordings = {}
        assert ghosts(case, self.fits(), ("a", "b"), 1) == []
        assert [g.clip for g in ghosts(self.case(()), self.fits(), ("a", "b"), 1)] == ["casing"]


class TestStretches:
    def test_a_film_shows_the_run_and_the_lacks_of_fit_of_its_body(self, monkeypatch):
        parts = [ghost(), ghost(body="rotor", clip="rotor_1"), ghost(body="rotor", clip="lost")]
        monkeypatch.setattr(module, "ghosts", lambda *args: parts)
        monkeypatch.setattr(
            "gyrotrack.plotting._frames.find_film", lambda r, folders: None if r == "lost" else f"film of {r}"
        )
        case = SimpleNamespace(recordings={k: k for k in ("casing", "rotor_1", "lost")})
        intervals = [
            ("casing", 0.2, 0.4), ("rotor", 0.5, 9.0), ("casing", -1.0, 0.1), ("rotor", 0.9, 2.0), ("casing", 1.0, 2.0),
            ("casing", -1.0, 0.0),
        ]  # fmt: skip
        found = stretches(case, [], [], intervals, [])
        assert [(s.film, s.start, s.stop) for s in found] == [
            ("film of casing", 0.0, 0.9), ("film of casing", 0.2, 0.4), ("film of casing", 0.0, 0.1),
            ("film of rotor_1", 0.5, 0.9),
        ]  # fmt: skip

    @pytest.mark.parametrize("wrong", [True, False])
    def test_a_film_that_cannot_be_read_has_no_animation(self, monkeypatch, wrong):
        from gyrotrack import VideoError

        class Film:
            def __init__(self, path, r):
                if wrong:
                    raise VideoError("no film", "")

            def __enter__(self):
                return "film"

            def __exit__(self, *_):
                pass

        monkeypatch.setattr("gyrotrack.plotting._frames.Film", Film)
        monkeypatch.setattr(module, "animation", lambda *args: args)
        found = animated(Stretch("ghost", "path", "recording", 1.0, 2.0))
        assert found == (None if wrong else ("ghost", "film", 1.0, 2.0))

    def test_a_film_has_a_panel_for_each_model(self):
        assert module._film_size(1) == (480, 544)
        assert module._film_size(3) == (1440, 544)


@pytest.mark.parametrize("worst", [-9e-3, 9e-3])
def test_the_still_picture_is_that_of_the_largest_difference(monkeypatch, worst):
    d = np.linspace(0.0, 4e-3, 10)
    d[6] = worst
    monkeypatch.setattr(
        module,
        "_panels",
        lambda shown, i, picture, factor: Image.new("RGB", (16, 16), (20 * i, 100, 250 - 20 * i)),
    )
    found = module.animation(
        ghost(10, d), SimpleNamespace(picture=lambda number, *, overlay: number), 0.0, 0.9
    )
    still = np.asarray(Image.open(io.BytesIO(found.jpeg)))
    assert still[8, 8] == pytest.approx([120, 100, 130], abs=6)
    moving = Image.open(io.BytesIO(found.webp))
    assert (moving.n_frames, found.width, found.height) == (10, 16, 16)
    # a frame is shown for 0.16 s, the last one for six times as long
    times = []
    for k in range(10):
        moving.seek(k)
        moving.load()
        times.append(moving.info["duration"])
    assert times == [160] * 9 + [960]
