"""Bodies whose hub moves: registration along a path, and the choice among several paths, with replaced slow steps."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking import _moving_hub as moving
from gyrotrack.tracking._moving_hub import Path
from gyrotrack.tracking._registration import Ring


class Sized(SimpleNamespace):
    def __len__(self):
        return self.count


def film_of(frames, **more):
    return Sized(
        frames=lambda: iter(frames), some=lambda index: [frames[i] for i in index], count=len(frames),
        path=SimpleNamespace(name="film"), warnings=(), **more,
    )  # fmt: skip


class TestRegistration:
    """`register` is exact, except that it may be told to err; frames are their numbers, 10 to 29."""

    FRAMES = np.arange(10, 30)
    TRUE = 0.3 * np.sin(np.arange(20) / 3.0)

    def along(self, monkeypatch, *, misfit=None, off=None, never=False, area=None, white=0.0, progress=None):
        misfit = np.ones(20) if misfit is None else misfit
        off = np.zeros((20, 2)) if off is None else np.asarray(off)
        asked = {"register": 0, "learn": []}

        def register(polar, template, start, *, move):
            assert move
            asked["register"] += 1
            frame, shift = polar
            k = frame - 10
            part = {"one": 0.01, "two": -0.02}.get(template, 0.0)
            angle = start + 0.1 if never else self.TRUE[k] + part
            return SimpleNamespace(angle=angle, shift=tuple(off[k] - shift), misfit=misfit[k], formal=1e-3)

        class Template:
            def halves(self):
                return ("one", "two")

        def learn(polars, theta, allowed, ring, *, separate, plain):
            assert plain
            assert not separate
            asked["learn"].append((len(polars), allowed, ring))
            return Template()

        monkeypatch.setattr(Ring, "unwrap", lambda self, frame, shift: (frame, np.array(shift)))
        monkeypatch.setattr(moving, "StoredPictures", SimpleNamespace(of=lambda n, given: list(given)))
        monkeypatch.setattr(moving, "register", register)
        monkeypatch.setattr(moving, "learn", learn)
        monkeypatch.setattr(moving, "explained", lambda *_: (0.77, None))
        monkeypatch.setattr(moving, "white_noise", lambda *_: white)
        ring = Ring.about((100.0, 50.0), 5.0, 30.0, finest=48.0)
        given = 1.1 * self.TRUE, np.zeros((20, 2))
        found = moving._along_path(film_of(list(range(40))), self.FRAMES, ring, *given, area, progress)
        np.testing.assert_array_equal(given[1], 0.0)  # the arguments are not changed
        return found, asked

    def test_angles_are_counter_clockwise_as_seen(self, monkeypatch):
        found, asked = self.along(monkeypatch)
        np.testing.assert_allclose(found.angle, -self.TRUE)
        np.testing.assert_allclose(found.halves, -self.TRUE + np.array([[-0.01], [0.02]]))
        np.testing.assert_array_equal(found.frame, self.FRAMES)
        assert (found.explained, found.correlated, found.warnings, found.scale) == (0.77, 0.0, (), 1.0)
        np.testing.assert_allclose(found.sigma, 1e-3)
        # two iterations, of which the second one changes nothing; then twice for each frame, once from the last frames,
        # and once for each half
        assert asked["register"] == (2 + 2 + 2) * 20 + 18
        assert [n for n, *_ in asked["learn"]] == [20] * 3
        assert asked["learn"][0][1].all()
        assert asked["learn"][0][2].rows == Ring.about((100.0, 50.0), 5.0, 30.0, finest=100.0).rows
        assert asked["learn"][0][2].rows > Ring.about((100.0, 50.0), 5.0, 30.0, finest=24.0).rows

    def test_ten_iterations_are_enough(self, monkeypatch):
        _, asked = self.along(monkeypatch, never=True)
        # a common change of all angles is no change of the motion, so only the first one counts
        assert asked["register"] == (1 + 4) * 20 + 18
        monkeypatch.setattr(moving, "_SETTLED", -1.0)
        assert self.along(monkeypatch, never=True)[1]["register"] == (10 + 4) * 20 + 18

    @pytest.mark.parametrize(("worse", "kept"), [(1.19, True), (1.21, False)])
    def test_equal_parts_of_a_body_are_not_confused(self, monkeypatch, worse, kept):
        """The rough angle of a body with two equal parts jumps by half a turn, and fits better there or not."""
        true = 0.4 * np.arange(20)

        def register(polar, template, start, *, move):
            turn = np.rint((start - true[polar]) / np.pi)
            return SimpleNamespace(
                angle=true[polar] + np.pi * turn,
                shift=(0.0, 0.0),
                misfit=worse if turn == 0 else 1.0,
                formal=1e-3,
            )

        template = SimpleNamespace(halves=lambda: ("one", "two"))
        monkeypatch.setattr(Ring, "unwrap", lambda self, frame, shift: frame)
        monkeypatch.setattr(moving, "StoredPictures", SimpleNamespace(of=lambda n, given: list(given)))
        monkeypatch.setattr(moving, "register", register)
        monkeypatch.setattr(moving, "learn", lambda *_, **__: template)
        monkeypatch.setattr(moving, "explained", lambda *_: (0.9, None))
        monkeypatch.setattr(moving, "white_noise", lambda *_: 1e-3)
        ring = Ring.about((100.0, 50.0), 5.0, 30.0)
        rough = true + np.pi * (np.arange(20) >= 12)
        found = moving._along_path(
            film_of(list(range(20))), np.arange(20), ring, rough, np.zeros((20, 2)), None, None
        )
        assert -found.angle == pytest.approx(true if kept else rough)

    @pytest.mark.parametrize("rounds", [0, 10])
    def test_a_body_that_is_larger_has_a_larger_ring_and_moves_further(self, monkeypatch, rounds):
        """The path is corrected while the template is learnt, and again in every frame."""
        monkeypatch.setattr(moving, "_ROUNDS", rounds)
        size, sizes = np.linspace(2.0, 1.0, 20), {}

        def unwrap(ring, frame, shift):
            sizes[frame] = (ring.inner, ring.outer, ring.rows)
            return frame, np.array(shift)

        def register(polar, template, start, *, move):
            frame, shift = polar
            return SimpleNamespace(
                angle=0.1 * frame, shift=(0.5 if shift[0] == 0 else 0.0, 0.0), misfit=1.0, formal=1e-3
            )

        template = SimpleNamespace(halves=lambda: ("one", "two"))
        monkeypatch.setattr(Ring, "unwrap", unwrap)
        monkeypatch.setattr(moving, "StoredPictures", SimpleNamespace(of=lambda n, given: list(given)))
        monkeypatch.setattr(moving, "register", register)
        monkeypatch.setattr(moving, "learn", lambda *_, **__: template)
        monkeypatch.setattr(moving, "explained", lambda *_: (0.9, None))
        monkeypatch.setattr(moving, "white_noise", lambda *_: 1e-3)
        ring = Ring.about((100.0, 50.0), 5.0, 30.0)
        given = 0.1 * np.arange(20), np.zeros((20, 2))
        found = moving._along_path(film_of(list(range(20))), np.arange(20), ring, *given, None, None, size)
        assert found.hub_path[:, 0] == pytest.approx(0.5 * size)
        assert [found.ring_at(k).outer for k in (0, 19)] == [60.0, 30.0]
        assert sizes[0] == (10.0, 60.0, ring.rows)
        assert sizes[19] == (5.0, 30.0, ring.rows)

    def test_a_path_is_corrected_by_two_pixels_at_most_each_time(self, monkeypatch):
        off = np.zeros((20, 2))
        off[4], off[7] = (9.0, -1.5), (-1.0, -5.0)
        found, _ = self.along(monkeypatch, off=off)
        expected = off.copy()
        expected[4, 0] = 6.0
        np.testing.assert_allclose(found.hub_path, expected)

    def test_the_used_part_of_the_picture_is_that_of_an_area(self, monkeypatch):
        _, asked = self.along(monkeypatch, area=(0, 0, 100, 100))
        _, allowed, ring = asked["learn"][0]
        assert 0.4 < allowed.mean() < 0.6
        np.testing.assert_array_equal(allowed, ring.inside((0, 0, 100, 100)))

    def test_frames_beyond_six_times_the_usual_misfit_are_omitted(self, monkeypatch):
        misfit = np.ones(20)
        misfit[3], misfit[4], misfit[5] = 5.9, 6.1, 0.2
        told = []
        found, _ = self.along(
            monkeypatch, misfit=misfit, white=3e-3, progress=lambda *given: told.append(given)
        )
        np.testing.assert_array_equal(found.frame, np.delete(self.FRAMES, 4))
        # the uncertainty grows with the root of the misfit, and is that of the noise in most frames
        expected = np.full(20, 3e-3)
        expected[3] *= np.sqrt(5.9)
        np.testing.assert_allclose(found.sigma, np.delete(expected, 4))
        assert found.scale == pytest.approx(3.0)
        assert found.halves.shape == (2, 19)
        assert len(found.hub_path) == 19
        assert len(found.warnings) == 1
        assert told == [(k + 1, 20) for k in range(20)]
        # never below the bound of the registration
        assert self.along(monkeypatch, white=0.4e-3)[0].scale == 1.0


class TestChoice:
    """Several bodies: the one with the largest range of angles that is one rigid body."""

    def free(self, monkeypatch, ranges, *, rigid=None, near=None, places=None, noise=3.0):
        count = 30
        rigid = [True] * len(ranges) if rigid is None else rigid
        places = [(10.0 * k, 20.0) for k in range(len(ranges))] if places is None else places
        paths = [
            Path(np.arange(count), np.linspace(at, np.add(at, (60.0, 0.0)), count), 9.0, 0.5) for at in places
        ]
        asked = {"rotation": [], "along": []}

        def rotation(film, path, noise):
            k = next(k for k, p in enumerate(paths) if p is path)
            asked["rotation"].append((k, noise))
            return None if ranges[k] is None else (path, k, np.linspace(0.0, ranges[k], count), None)

        def along(film, frame, k, theta, *_):
            asked["along"].append(k)
            return SimpleNamespace(
                explained=0.9 if rigid[k] else 0.5, angle=theta, sigma=np.full(count, 1e-3), frame=np.arange(count),
                halves=np.zeros((2, count)), warnings=(), body=k,
            )  # fmt: skip

        monkeypatch.setattr(moving, "fresh_frames", lambda _: np.arange(count))
        monkeypatch.setattr(moving, "spatial_noise", lambda _: noise)
        monkeypatch.setattr(moving, "find_paths", lambda *given: asked.update(limit=given[2]) or paths)
        monkeypatch.setattr(moving, "_rotation", rotation)
        monkeypatch.setattr(moving, "_along_path", along)
        monkeypatch.setattr(moving, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
        try:
            found = moving.track_free_body(film_of([None] * count), near)
        except TrackingError:
            found = None
        return found, asked

    def test_the_body_that_turns_most_is_taken_and_others_are_named(self, monkeypatch):
        found, asked = self.free(monkeypatch, [1.0, 3.0, None, 2.0])
        assert found.body == 1
        assert asked["along"] == [1]
        assert asked["rotation"] == [(k, 3.0) for k in range(4)]
        *others, last = found.warnings
        # the other bodies in the order of their rotations, by the start of their paths
        assert ["30,20" in others[0], "0,20" in others[1], len(others)] == [True, True, 2]
        assert "by 60 px" in last
        assert "30 of 30 frames" in last

    def test_a_body_that_is_not_rigid_leaves_the_next_one(self, monkeypatch):
        found, asked = self.free(monkeypatch, [1.0, 3.0, 2.0], rigid=[True, False, True])
        assert found.body == 2
        assert asked["along"] == [1, 2]
        assert len(found.warnings) == 2
        assert self.free(monkeypatch, [1.0, 3.0], rigid=[False, False])[0] is None

    def test_four_paths_are_examined(self, monkeypatch):
        _, asked = self.free(monkeypatch, [1.0] * 6)
        assert [k for k, _ in asked["rotation"]] == [0, 1, 2, 3]

    @pytest.mark.parametrize(("noise", "used"), [(0.2, 0.5), (0.8, 0.8)])
    def test_the_noise_is_half_a_grey_level_at_least(self, monkeypatch, noise, used):
        _, asked = self.free(monkeypatch, [1.0], noise=noise)
        assert asked["limit"] == used

    def test_a_point_selects_the_path_that_passes_it(self, monkeypatch):
        """Any part of the path counts."""
        found, _ = self.free(monkeypatch, [3.0, 1.0], places=[(0.0, 20.0), (0.0, 90.0)], near=(45.0, 80.0))
        assert found.body == 1


class TestPaths:
    def square(self, places, side=9, level=200, also=()):
        frames = []
        for k, (x, y) in enumerate(places):
            frame = np.full((60, 160), 60, np.uint8)
            frame[y : y + side, x : x + side] = level
            for x2, y2, side2, first, last in also:
                if first <= k < last:
                    frame[y2 : y2 + side2, x2 + 2 * k : x2 + 2 * k + side2] = 200
            frames.append(frame)
        return frames

    def paths(self, frames, noise=1.0):
        return moving.find_paths(film_of(frames), np.arange(len(frames)), noise)

    def test_the_body_that_sweeps_the_largest_area_is_the_first(self):
        places = [(10 + 3 * k, 5) for k in range(30)]
        found = self.paths(self.square(places, side=7, also=[(20, 30, 15, 0, 30)]))
        assert len(found) == 2
        # widths of about 14 and 6 px, and distances of 58 and 87 px
        assert [round(p.place[0, 1]) for p in found] == [37, 8]

    @pytest.mark.parametrize(
        ("level", "noise", "paths"), [(72, 2.1, 0), (72, 1.9, 1), (49, 1.9, 0), (48, 1.9, 1)]
    )
    def test_a_body_differs_by_six_times_the_noise(self, level, noise, paths):
        assert len(self.paths(self.square([(10 + 3 * k, 5) for k in range(30)], level=level), noise)) == paths

    @pytest.mark.parametrize(("level", "paths"), [(70, 1), (80, 2)])
    def test_a_body_differs_by_a_tenth_of_the_largest_contrast(self, level, paths):
        """A body of 140 grey levels beside a faint one of 10 or 20 grey levels."""
        places = [(10 + 3 * k, 5) for k in range(30)]
        assert len(self.paths(self.square(places, level=level, also=[(20, 30, 15, 0, 30)]))) == paths

    @pytest.mark.parametrize(("hidden", "paths"), [(4, 1), (5, 2)])
    def test_a_path_continues_after_five_frames_at_most(self, hidden, paths):
        places = [(10 + 3 * k, 5) for k in range(34)]
        frames = self.square(places)
        for k in range(15, 15 + hidden):
            frames[k] = np.full((60, 160), 60, np.uint8)
        found = self.paths(frames)
        assert len(found) == paths
        assert sum(len(p.frame) for p in found) == 34 - hidden

    def outlined(self, monkeypatch, x, area):
        """Return the paths of an outline at given places and areas, NaN where it is hidden."""
        given = iter(zip(x, area, strict=True))

        def outlines(_):
            at, size = next(given)
            return [] if np.isnan(at) else [moving._Outline(np.array([at, 20.0]), size)]

        monkeypatch.setattr(moving, "_outlines", outlines)
        return self.paths([np.full((9, 9), 60, np.uint8)] * len(x))

    @pytest.mark.parametrize(("travel", "paths"), [(9.5, 0), (10.5, 1)])
    def test_a_body_moves_by_half_its_diameter(self, monkeypatch, travel, paths):
        found = self.outlined(monkeypatch, np.linspace(30.0, 30.0 + travel, 20), np.full(20, 100.0 * np.pi))
        assert len(found) == paths
        if paths:
            assert found[0].radius == pytest.approx(10.0)
            np.testing.assert_allclose(found[0].place[[0, -1]], [[30.0, 20.0], [30.0 + travel, 20.0]])

    @pytest.mark.parametrize(("area", "whole"), [(1.28, True), (1.32, False), (0.72, True), (0.68, False)])
    def test_frames_with_a_part_of_the_outline_are_left_out(self, monkeypatch, area, whole):
        """While the area changes slowly, the outlines belong to one path."""
        areas = 300.0 * np.concatenate(
            [np.ones(40), np.linspace(1.0, area, 12)[1:], np.linspace(area, 1.0, 12)]
        )
        found = self.outlined(monkeypatch, 30.0 + 2 * np.arange(len(areas)), areas)
        assert len(found) == 1
        assert (50 in found[0].frame) is whole
        assert 48 in found[0].frame
        assert len(found[0].frame) == len(found[0].place)

    @pytest.mark.parametrize(("seen", "paths"), [(11, 0), (12, 1)])
    def test_a_path_has_twelve_frames(self, monkeypatch, seen, paths):
        for rest in (0, 9):  # it ends with the film, or before
            x = np.concatenate([30.0 + 2 * np.arange(seen), np.full(rest, np.nan)])
            assert len(self.outlined(monkeypatch, x, np.full(len(x), 100.0))) == paths


@pytest.mark.parametrize("side", ["left", "top", "right", "bottom"])
@pytest.mark.parametrize(("apart", "found"), [(0, 0), (1, 0), (2, 1), (3, 1)])
def test_an_outline_at_the_border_is_not_complete(side, apart, found):
    """A gap of one pixel is closed."""
    region = np.zeros((40, 60), bool)
    x, y = {"left": (apart, 17), "top": (25, apart), "right": (54 - apart, 17), "bottom": (25, 34 - apart)}[
        side
    ]
    region[y : y + 6, x : x + 6] = True
    outlines = moving._outlines(region)
    assert len(outlines) == found
    for one in outlines:
        np.testing.assert_allclose(one.place, [x + 2.5, y + 2.5])
        assert one.area == 25.0  # within the middles of the pixels at the edge


@pytest.mark.parametrize(("size", "found"), [((5, 6), 0), ((5, 7), 1), ((6, 5), 0), ((7, 5), 1)])
def test_an_outline_has_24_square_pixels(size, found):
    region = np.zeros((40, 60), bool)
    region[10 : 10 + size[0], 20 : 20 + size[1]] = True  # (5 - 1) x (7 - 1) = 24
    assert len(moving._outlines(region)) == found


def test_the_largest_fifty_outlines_are_used():
    region = np.zeros((200, 400), bool)
    for k in range(60):
        region[
            5 + 15 * (k // 20) : 11 + 15 * (k // 20), 5 + 18 * (k % 20) : 11 + 18 * (k % 20) + (k >= 10)
        ] = True
    found = moving._outlines(region)
    assert len(found) == 50
    assert {one.area for one in found} == {30.0}


def test_a_body_is_expected_with_the_velocity_of_its_last_two_steps():
    link = moving._Link()
    for frame, x, area in ((3, 10.0, 5.0), (4, 12.0, 9.0), (7, 22.0, 6.0), (8, 24.0, 7.0)):
        link.frame.append(frame)
        link.outline.append(moving._Outline(np.array([x, 2 * x]), area))
        if len(link.frame) == 2:
            np.testing.assert_allclose(link.expected(9), [12.0, 24.0])
    # 12 px in 4 frames from the third-last outline
    np.testing.assert_allclose(link.expected(10), [30.0, 60.0])
    assert link.area() == 6.5
    link.outline += [moving._Outline(np.zeros(2), 50.0)] * 10
    assert link.area() == 50.0


def test_a_body_that_becomes_smaller_in_each_frame_is_one_body():
    """Its area falls by 9 % per frame: to 0.65 of the median of the last ten frames, but to 0.91 of the last one."""
    links = []
    for k in range(15):
        moving._link(links, k, [moving._Outline(np.array([50.0 + k, 40.0]), 900.0 * 0.91**k)])
    assert [len(link.frame) for link in links] == [15]
    # an area that falls suddenly is another body
    moving._link(links, 15, [moving._Outline(np.array([65.0, 40.0]), 0.5 * 900.0 * 0.91**14)])
    assert [len(link.frame) for link in links] == [15, 1]
