"""A fixed hub: the middle of the details of a body, its displacement and drift, and halves that differ."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _fixed_hub as _fixed_hub
from gyrotrack.tracking._registration import Ring, Template


class TestFixedHub:
    @pytest.mark.parametrize("hidden", [False, True])
    def test_the_middle_of_a_body_is_weighted_by_its_details(self, hidden):
        """A single bright sample has four neighbours with equal slopes; the weight contains the area."""
        ring = Ring((0.0, 0.0), 10.0, 22.0, 6, 8)
        body, allowed = np.zeros((6, 8)), np.ones((6, 8), dtype=bool)
        body[2, 4] = 50.0
        allowed[1, 4] = not hidden
        r, phi = ring.radius, ring.angle
        samples = [(2, 3), (2, 5), (3, 4)] + ([] if hidden else [(1, 4)])
        total = sum(r[i] ** 2 * np.exp(1j * phi[k]) for i, k in samples) / sum(r[i] for i, _ in samples)
        place = _fixed_hub._middle_of(SimpleNamespace(ring=ring, body=body, allowed=allowed))
        for angle in (0.0, 0.7):
            turned = total * np.exp(1j * angle)
            assert place(angle) == pytest.approx([turned.real, turned.imag])

    @pytest.mark.parametrize(
        ("steps", "options", "shift", "angle", "count"),
        [
            ([(5.0, -3.0), (0.5, 0.04), (-0.04, 0.04), (9.0, 9.0)], {}, (2.46, -1.92), 3.0, 3),
            ([(0.06, 0.0), (0.04, 0.0)], {}, (0.1, 0.0), 2.0, 2),
            ([(0.06, 0.0), (0.04, 0.0)], {"step": 0.1}, (0.06, 0.0), 1.0, 1),
            ([(0.01, -0.3), (0.0, 0.0)], {"step": 0.2}, (0.01, -0.3), 2.0, 2),
            ([(-9.0, 1.0)] * 20, {}, (-16.0, 8.0), 8.0, 8),
        ],
    )
    def test_a_hub_is_displaced_in_steps_of_two_pixels(
        self, monkeypatch, steps, options, shift, angle, count
    ):
        seen, begun = [], []

        def register(polar, template, start, *, move):
            seen.append(polar)
            begun.append(start)
            assert move
            return SimpleNamespace(shift=np.array(steps[len(seen) - 1]), angle=float(len(seen)))

        monkeypatch.setattr(_fixed_hub, "register", register)
        template = SimpleNamespace(ring=SimpleNamespace(unwrap=lambda picture, at: at))
        found, moved = _fixed_hub.displaced(None, template, 0.3, **options)
        assert (found, len(seen)) == (angle, count)
        assert moved == pytest.approx(shift)
        assert begun == [0.3, *np.arange(1.0, count)]
        at = np.cumsum(np.clip(steps[:count], -2.0, 2.0), axis=0)
        assert np.array(seen[1:]) == pytest.approx(at[:-1]) if count > 1 else seen == [(0.0, 0.0)]

    def test_the_drift_is_that_of_the_middle_of_the_body_in_four_frames_of_five(self, monkeypatch):
        """Of 118 frames every third is used; the displacement grows from frame to frame."""
        angle = 0.01 * np.arange(118.0)
        learnt = []

        def displaced(picture, template, start):
            return start + 0.1, np.array([0.0, 0.2 * picture])

        monkeypatch.setattr(
            _fixed_hub, "learn", lambda *given, **how: learnt.append((given, how)) or "template"
        )
        monkeypatch.setattr(_fixed_hub, "displaced", displaced)
        monkeypatch.setattr(_fixed_hub, "_middle_of", lambda _: lambda a: np.array([30.0 * a, 0.0]))
        ring = SimpleNamespace(inner=100.0, outer=300.0, unwrap=lambda p: -p, inside=lambda area: area)
        found, limit = _fixed_hub.drift(ring, list(range(118)), angle, "area", separate=True)
        shift = 0.2 * np.arange(0, 118, 3)  # along y; along x 3 px in all frames
        assert found == pytest.approx(np.quantile(np.abs(shift - np.median(shift)), 0.8))
        assert limit == pytest.approx(0.015 * 200.0)
        ((given, how),) = learnt
        assert given[0] == [-k for k in range(0, 118, 3)]
        assert given[1] == pytest.approx(angle[::3])
        assert given[2:] == ("area", ring)
        assert how == {"separate": True, "plain": True}

    def test_the_drift_contains_the_rotation_of_the_middle(self, monkeypatch):
        monkeypatch.setattr(_fixed_hub, "learn", lambda *_, **__: None)
        monkeypatch.setattr(
            _fixed_hub, "displaced", lambda p, _, start: (start + (0.5 if p else 0.0), np.zeros(2))
        )
        monkeypatch.setattr(_fixed_hub, "_middle_of", lambda _: lambda a: np.array([10.0 * a, 0.0]))
        ring = SimpleNamespace(inner=10.0, outer=20.0, unwrap=lambda p: p, inside=lambda _: None)
        # in two frames of five the middle is 5 px beside its place
        found, limit = _fixed_hub.drift(ring, [0, 0, 0, 1, 1], np.arange(5.0), None, separate=False)
        assert (found, limit) == (pytest.approx(5.0), 2.3)
        assert _fixed_hub.drift(ring, [0, 0, 0, 0, 1], np.arange(5.0), None, separate=False)[
            0
        ] == pytest.approx(np.quantile([0.0, 0.0, 0.0, 0.0, 5.0], 0.8))

    @pytest.mark.parametrize(("error", "share"), [(0.019, None), (0.021, 0.021), (0.5, 0.5)])
    def test_halves_differ_by_two_percent_of_the_standard_deviation(self, error, share):
        angle = 3.0 * np.array([1.0, -1.0] * 20)
        found = _fixed_hub.halves_differ(angle, 3.0 * error)
        assert found == (None if share is None else pytest.approx(share))


@pytest.mark.parametrize(("error", "share"), [(0.019, None), (0.021, 0.021)])
def test_halves_differ_by_two_percent_of_the_motion(error, share):
    angle = np.where(np.arange(50) % 2, 1.0, -1.0)
    assert _fixed_hub.halves_differ(angle, error) == (share and pytest.approx(share))


@pytest.mark.parametrize(("film", "fell"), [(0.61, False), (0.59, True)])
def test_an_explained_share_that_falls_by_a_fifth_is_refused(film, fell):
    assert _fixed_hub.fallen(0.8, film) == fell


def test_the_middle_of_the_details_turns_with_the_body():
    ring = Ring((60.0, 50.0), 10.0, 26.0, 8, 64)
    body = np.full((8, 64), 100.0, np.float32)
    body[3:5, 10:13] += np.float32([[20, 60, 20]] * 2)
    full = np.ones((8, 64), np.float32)
    place = _fixed_hub._middle_of(Template(ring, body, 0 * body, full, full, 1.0, full > 0))
    radius, angle = 18.0, 11 * ring.step
    np.testing.assert_allclose(place(0.0), [radius * math.cos(angle), radius * math.sin(angle)], atol=0.6)
    np.testing.assert_allclose(
        place(1.0), [radius * math.cos(angle + 1), radius * math.sin(angle + 1)], atol=0.6
    )


def test_a_displacement_is_found_in_steps_of_two_pixels(monkeypatch):
    true = np.array([5.0, -3.0])

    def near(polar, template, angle, move):
        return SimpleNamespace(shift=tuple(true - polar), angle=angle + 0.1)

    monkeypatch.setattr(_fixed_hub, "register", near)
    template = SimpleNamespace(ring=SimpleNamespace(unwrap=lambda picture, shift: np.array(shift)))
    angle, shift = _fixed_hub.displaced(None, template, 0.0)
    np.testing.assert_allclose(shift, true)
    assert angle == pytest.approx(0.4)  # steps of 2, 2, 1 and 0 px
    true[:] = (17.0, 0.0)
    assert _fixed_hub.displaced(None, template, 0.0)[1].tolist() == [16.0, 0.0]  # eight steps


@pytest.mark.parametrize(("outer", "limit"), [(100.0, 2.3), (400.0, 0.015 * 225.0)])
def test_the_drift_of_a_hub_is_that_of_four_frames_of_five(outer, limit, monkeypatch):
    ring = replace(Ring.about((0.0, 0.0), 50.0, outer), rows=4, columns=8)
    offs = iter([*[0.1] * 30, *[1.0] * 5, *[9.0] * 5])
    monkeypatch.setattr(Ring, "unwrap", lambda *_: None)
    monkeypatch.setattr(_fixed_hub, "learn", lambda *_, **__: None)
    monkeypatch.setattr(_fixed_hub, "_middle_of", lambda _: lambda angle: np.array([50.0 * angle, 0.0]))
    # the angle is refined by 0.02 rad, which displaces the middle by 1 px
    monkeypatch.setattr(
        _fixed_hub, "displaced", lambda p, t, a: (a + 0.02, np.array([next(offs) - 1.0, 0.0]))
    )
    moved, most = _fixed_hub.drift(ring, [None] * 80, np.zeros(80), (0, 0, 9, 9), separate=False)
    assert most == pytest.approx(limit)
    assert moved == pytest.approx(
        np.quantile(np.abs(np.array([0.1] * 30 + [1.0] * 5 + [9.0] * 5) - 0.1), 0.8)
    )
