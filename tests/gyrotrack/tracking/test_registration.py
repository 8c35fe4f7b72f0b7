"""The ring without markers against an independent renderer: error, claimed uncertainty, hub, hopeless films."""

import itertools
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack._column_store import StoredPictures
from gyrotrack.tracking import _registration
from gyrotrack.tracking._any_body import track_body
from gyrotrack.tracking._film import Film, fresh_frames
from gyrotrack.tracking._hub_search import Motion, distant_hub, edge_hub, fit_circle
from gyrotrack.tracking._registration import (
    TURN,
    Ring,
    Template,
    follow,
    learn,
    register,
    rolled,
    without_slips,
)
from gyrotrack.tracking._tracked import hub_error


class Rendered:
    """Frames in memory with the interface of `Film`."""

    def __init__(self, frames):
        self._frames, self._shake = frames, None
        self.path = Path("rendered.mp4")
        self.warnings = ()
        small = [f[::4, ::4].astype(float) for f in frames]
        self.changes = np.array([255.0] + [np.abs(b - a).mean() for a, b in itertools.pairwise(small)])
        self.selected = np.ones(len(frames), dtype=np.bool_)

    def __len__(self):
        return len(self._frames)

    def stabilise(self, shake):
        self._shake = shake

    def frames(self, first=0, stop=None):
        return iter(self.some(range(len(self))[first:stop]))

    def some(self, index):
        found = (self._frames[i] for i in index)
        if self._shake is not None:
            found = (self._shake.stabilised(f, i) for f, i in zip(found, index, strict=True))
        return StoredPictures.of(len(index), found)


def renderer(radius, seed=0):
    """Return a function theta -> clean frame of a textured disc on a textured, still background, and its hub."""
    rng = np.random.default_rng(seed)
    size, up = int(2 * radius * 1.25), 4
    hub = np.array([size / 2 + 2.3, size / 2 - 1.6])
    background = 90 + 25 * cv2.GaussianBlur(rng.normal(size=(size, size)), None, 4) * 8
    n = up * size
    coarse = cv2.resize(rng.normal(size=(24, 24)), (n, n), interpolation=cv2.INTER_CUBIC)
    y, x = np.mgrid[0:n, 0:n]
    away = np.hypot(x - n / 2, y - n / 2) / up
    disc = np.where(away < radius, 130 + 30 * coarse, 0).astype(np.float32)

    def turned(picture, theta):
        c, s = np.cos(theta), np.sin(theta)  # from x to y, as `register` counts
        turn = np.array([[c, -s, 0], [s, c, 0]], dtype=float)
        turn[:, 2] = (hub + 0.5) * up - 0.5 - turn[:, :2] @ [n / 2, n / 2]
        large = cv2.warpAffine(picture, turn, (n, n), flags=cv2.INTER_LINEAR)
        return cv2.resize(large, (size, size), interpolation=cv2.INTER_AREA)

    around = (1 - turned((away < radius).astype(np.float32), 0.0)) * background  # a circle, at every angle

    def draw(theta):
        return cv2.GaussianBlur(turned(disc, theta) + around, None, 0.8)

    return draw, hub


def film_of(draw, angles, noise, seed=1):
    rng = np.random.default_rng(seed)
    clean = (draw(a) for a in angles)
    return Rendered(
        [np.clip(np.rint(c + rng.normal(0, noise, c.shape)), 0, 255).astype(np.uint8) for c in clean]
    )


def bound(draw, noise, theta=0.3, step=1e-3):
    """Return the Cramer-Rao bound of the angle for a known picture and hub."""
    slope = (draw(theta + step) - draw(theta - step)) / (2 * step)
    return float(np.sqrt((noise**2 + 1 / 12) / np.sum(slope**2)))


def check(radius, angles, noise, seed=0):
    draw, hub = renderer(radius, seed)
    found = track_body(film_of(draw, angles, noise))
    assert np.hypot(*(np.array(found.ring.hub) - hub)) < 0.15
    error = -found.angle - angles[found.frame]
    error -= error.mean()
    return error, found, bound(draw, noise)


SPIN_DOWN = (lambda t: 0.4 + 9.0 * t - 1.2 * t**2)(np.arange(120) / 60)
SWING = 0.25 * np.sin(2 * np.pi * np.arange(120) / 37)


@pytest.mark.slow
@pytest.mark.parametrize("angles", [SPIN_DOWN, SWING], ids=["spin-down", "oscillation"])
def test_error_and_uncertainty(angles):
    error, found, least = check(60, angles, 4.0)
    assert len(found.frame) > 115
    assert error.std() < 1.5 * least
    assert 0.8 < (error / found.sigma).std() < 1.25


@pytest.mark.release
@pytest.mark.slow
def test_error_and_uncertainty_of_a_large_disc():
    error, found, least = check(300, SPIN_DOWN[:60], 6.0, seed=3)
    assert error.std() < 1.5 * least
    assert 0.8 < (error / found.sigma).std() < 1.25


@pytest.mark.slow
def test_sense_is_counter_clockwise_as_seen():
    draw, _ = renderer(60)
    found = track_body(film_of(draw, SPIN_DOWN[:60], 3.0))
    assert found.angle[-1] < found.angle[0]  # from x to y is clockwise as seen


@pytest.mark.slow
def test_two_bodies_are_not_one():
    left, right = renderer(40)[0], renderer(40, seed=3)[0]
    angles = np.linspace(0.0, 14.0, 60)
    frames = [
        np.hstack([a, b])
        for a, b in zip(
            film_of(left, angles, 2.0).frames(), film_of(right, 0.4 - 0.6 * angles, 2.0).frames(), strict=True
        )
    ]
    with pytest.raises(TrackingError, match="Two bodies turn"):
        track_body(Rendered(frames))


def test_nothing_moves():
    draw, _ = renderer(60)
    with pytest.raises(TrackingError):
        track_body(film_of(draw, np.zeros(40), 3.0))


@pytest.mark.slow
def test_a_body_that_slides_does_not_turn():
    draw, _ = renderer(60)
    still = draw(0.0)
    rng = np.random.default_rng(0)
    frames = [
        np.clip(np.roll(still, 2 * k, axis=1) + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8)
        for k in range(40)
    ]
    with pytest.raises(TrackingError):
        track_body(Rendered(frames))


def test_registration_of_one_frame_is_exact_without_noise():
    ring = Ring((0.0, 0.0), 20, 60, 20, 256)
    k = np.arange(256) * ring.step
    body = np.outer(np.linspace(1, 2, 20), 40 * np.cos(3 * k) + 20 * np.sin(7 * k + 1)).astype(np.float32)
    turns = np.linspace(0, 6, 30)
    polars = [rolled(body, a / ring.step) for a in turns]
    template = learn(polars, turns, np.ones((20, 256), dtype=bool), ring, separate=False)
    for angle in (0.0123, 1.7, 5.9):
        assert register(rolled(body, angle / ring.step), template, angle + 0.02).angle == pytest.approx(
            angle, abs=1e-5
        )


def test_circle_through_an_arc_with_strays():
    rng = np.random.default_rng(2)
    angle = rng.uniform(0.2, 1.1, 60)
    x, y = 500 + 400 * np.cos(angle), -80 + 400 * np.sin(angle)
    x[::9] += 60
    centre = fit_circle(x + rng.normal(0, 0.05, 60), y + rng.normal(0, 0.05, 60))
    assert np.hypot(centre[0] - 500, centre[1] + 80) < 3


@pytest.mark.parametrize(("share", "hub"), [(0.6, (50.0, 70.0)), (0.4, (120.0, 30.0))])
def test_the_hub_of_edges_is_that_of_most_of_them(share, hub):
    """Rings about one point at the left, about another one at the right."""
    y, x = np.mgrid[0:120, 0:160].astype(np.float32)
    left, right = (np.cos(np.hypot(x - u, y - v) / 2.5) for u, v in ((50, 70), (120, 30)))
    mean = (120 + 40 * np.where(x < 160 * share, left, right)).astype(np.float32)
    motion = Motion(mean, mean, 1.0, np.ones(mean.shape, dtype=bool), (0, 0, 160, 120))
    assert edge_hub(motion) == pytest.approx(hub, abs=0.1)


@pytest.mark.parametrize(("contrast", "found"), [(0.9, False), (1.1, True)])
def test_an_edge_has_half_a_grey_level_per_pixel(contrast, found):
    """A cone about the hub that rises by one grey level in two pixels."""
    y, x = np.mgrid[0:80, 0:80].astype(np.float32)
    mean = 0.5 * contrast * np.hypot(x - 33, y - 44)
    motion = Motion(mean, mean, 1.0, np.ones(mean.shape, dtype=bool), (0, 0, 80, 80))
    place = edge_hub(motion)
    assert place == (pytest.approx((33.0, 44.0), abs=0.1) if found else None)


def test_hub_of_a_ball_far_from_it_is_not_pulled_towards_the_ball():
    """The rotation of a pendulum's ball is measured with errors as large as itself; its displacement is precise."""
    rng = np.random.default_rng(5)
    hub, angle = 300.0 - 700.0j, 0.1 * np.sin(0.2 * np.arange(160))
    place = hub + 800j * np.exp(1j * angle)
    turn = np.exp(1j * np.diff(angle))
    shift = np.diff(place) + rng.normal(0, 0.1, (159, 2)) @ [1, 1j]
    left = 1.0 - turn * np.exp(1j * rng.normal(0, 5e-3, 159))
    # the body's rotation about its own centroid is that about the hub: b - (1 - a) c is the displacement
    found = distant_hub(place.mean() - 300j, left, shift, place[:-1])
    assert found is not None
    assert abs(complex(*found) - hub) < 0.1 * 800
    # a body about its hub is left to the other estimate
    assert distant_hub(1.0 + 0.5j, left, shift, np.zeros(159, dtype=complex)) is None


@pytest.mark.release
@pytest.mark.slow
def test_a_pendulum_before_a_textured_wall():
    """A ball on a rod that turns little before a wall with texture, its hub above: the wall is not the body's."""
    rng = np.random.default_rng(7)
    wall = 120 + 25 * cv2.GaussianBlur(rng.normal(size=(200, 200)), None, 3) * 6
    hub, up = np.array([100.0, 30.0]), 8
    angles = 0.2 * np.exp(-np.arange(90) / 200) * np.cos(2 * np.pi * np.arange(90) / 31)
    frames = []
    for angle in angles:
        cover = np.zeros((200 * up, 200 * up), np.uint8)
        end = hub + 130 * np.array([np.sin(angle), np.cos(angle)])
        at = [tuple(int(v) for v in np.rint((p + 0.5) * up - 0.5)) for p in (hub, end)]
        cv2.line(cover, at[0], at[1], 255, 2 * up)
        cv2.circle(cover, at[1], 9 * up, 255, -1)
        share = cv2.resize(cover, (200, 200), interpolation=cv2.INTER_AREA) / 255.0
        shown = wall * (1 - share) + 30 * share + rng.normal(0, 2, wall.shape)
        frames.append(np.clip(np.rint(shown), 0, 255).astype(np.uint8))
    found = track_body(Rendered(frames))
    expected = angles[found.frame]
    scale = np.polyfit(expected, found.angle, 1)[0]
    assert scale == pytest.approx(1.0, abs=0.03)
    assert np.hypot(*(np.array(found.ring.hub) - hub)) < 5


def test_halves_of_a_ring_show_a_displaced_hub():
    """e / r is the error of an angle; the halves of the ring show it by their difference."""
    ring = Ring((0.0, 0.0), 20, 60, 20, 256)
    k = np.arange(256) * ring.step
    body = np.outer(np.ones(20), 40 * np.cos(3 * k) + 20 * np.sin(7 * k + 1)).astype(np.float32)
    turns = np.linspace(0, 7, 60)
    polars = [rolled(body, a / ring.step) for a in turns]
    parts = learn(polars, turns, np.ones((20, 256), dtype=bool), ring, separate=False, plain=True).halves()
    radius = [float(np.average(ring.radius, weights=part.information())) for part in parts]
    whole = float(np.average(ring.radius, weights=parts[0].whole().information()))
    error = 0.5 * np.cos(turns - 0.4)
    noise = np.random.default_rng(0).normal(0, 2e-4, (2, 60))
    halves = turns + error / np.array(radius)[:, None] + noise
    assert hub_error(turns, halves, parts) == pytest.approx(0.5 / whole / np.sqrt(2), rel=0.05)
    assert hub_error(turns, turns + noise, parts) == 0.0
    swing = 0.1 * np.sin(3 * turns)
    scaled = swing * (1 + 0.5 / np.array(radius))[:, None] + noise
    assert hub_error(swing, scaled, parts) == pytest.approx(0.5 / whole * swing.std(), rel=0.1)
    assert hub_error(10 * turns, halves, parts) == 0.0  # over many turns it resembles no motion


@pytest.mark.parametrize(
    ("known", "inner"),
    [
        ([1, 1, 1, 1, 1, 1, 1], 3),
        ([8, 1, 1, 1, 1, 1, 1], 1),
        ([0, 0, 0, 0, 0, 1, 8], 6),
        ([1, 1, 6, 1, 1, 1, 2], 2),
    ],
)
def test_halves_of_a_ring_have_equal_information(monkeypatch, known, inner):
    """Within a row; each has at least one."""
    ring = Ring((0.0, 0.0), 20, 60, 7, 64)
    flat = np.ones((7, 64), np.float32)
    template = Template(ring, flat, flat, flat, flat, 1.0, flat > 0)
    monkeypatch.setattr(Template, "information", lambda _: np.array(known, dtype=float))
    assert [part.rows for part in template.halves()] == [slice(0, inner), slice(inner, None)]


@pytest.mark.slow
def test_a_body_without_an_axle():
    """A disc on a string: it turns to and fro while its hub moves."""
    draw, _ = renderer(60)
    t = np.arange(150)
    angles = 0.2 * np.sin(2 * np.pi * t / 41)
    rng = np.random.default_rng(4)
    frames = []
    for k, angle in enumerate(angles):
        place = np.float32([[1, 0, 3 * np.sin(k / 9.0)], [0, 1, 2 * np.cos(k / 7.0)]])
        clean = draw(angle)
        moved = cv2.warpAffine(
            clean, place, clean.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        frames.append(np.clip(np.rint(moved + rng.normal(0, 2, clean.shape)), 0, 255).astype(np.uint8))
    found = track_body(Rendered(frames))
    assert found.way == "features"
    error = -found.angle - angles[found.frame]
    assert np.std(error) < 0.005
    assert np.polyfit(angles[found.frame], -found.angle, 1)[0] == pytest.approx(1, abs=0.01)


def encoded(path, pictures, rate):
    """Write grey pictures (120, 160) as a film; without mbtree, which gives other bits in each run."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 160, 120, "yuv420p"
        stream.options = {"crf": "18", "x264-params": "mbtree=0"}
        for picture in pictures:
            grey = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, "gray").reformat(format="yuv420p")))
        container.mux(stream.encode())
    return path


@pytest.mark.slow
def test_flicker_and_reversals_are_not_repeated_frames(tmp_path):
    """100 Hz at 60 fps lights two of three frames alike; an oscillation is at rest twice a period."""
    time = np.arange(90) / 60.0
    angle = 0.3 * np.cos(2.0 * np.pi * 1.2 * time + 0.4)
    angle[40] = angle[39]
    texture = np.random.default_rng(4).uniform(60.0, 160.0, (12, 12)).astype(np.float32)
    texture = cv2.resize(texture, (160, 120), interpolation=cv2.INTER_CUBIC)
    light = 1.0 + 0.05 * np.cos(2.0 * np.pi * 100.0 * time + 1.0)
    light[40] = light[39]
    turns = [cv2.getRotationMatrix2D((80.0, 60.0), float(np.rad2deg(one)), 1.0) for one in angle]
    seen = (
        gain * cv2.warpAffine(texture, turn, (160, 120), borderMode=cv2.BORDER_REFLECT)
        for turn, gain in zip(turns, light, strict=True)
    )
    path = encoded(tmp_path / "flicker.mp4", seen, 60)
    fresh = fresh_frames(Film(path))
    assert sorted(set(range(90)) - set(fresh.tolist())) == [40]


def test_spokes_that_shadows_at_rest_modulate_are_followed_without_jumps():
    """Twelve alike spokes under a shading at rest match best after a jump back by one of them."""
    ring = Ring.about((0.0, 0.0), 20.0, 100.0, finest=100.0)
    angle = ring.step * (np.arange(ring.columns) + 0.5)
    shade = 1.0 + 0.9 * np.cos(angle - 1.0) + 0.5 * np.cos(2.0 * angle)
    true = 0.15 * np.arange(80) - 0.0002 * np.arange(80) ** 2
    profile = np.stack([shade * np.cos(12.0 * (angle - one)) ** 9 for one in true]).astype(np.float32)
    polars = np.repeat(profile[:, None], ring.rows, axis=1) * 40.0
    polars += np.random.default_rng(1).normal(0.0, 1.0, polars.shape).astype(np.float32)
    weight = np.broadcast_to(ring.area, polars.shape[1:]).astype(np.float32)
    found = follow(polars, weight, polars.mean(axis=0), ring, band="low")
    assert np.ptp(found) == pytest.approx(np.ptp(true), abs=0.1)


def test_a_flickering_lamp_is_compensated(tmp_path):
    """Against the same film without flicker: the gains are those that were drawn."""
    rng = np.random.default_rng(6)
    wall = np.tile(np.linspace(60.0, 210.0, 160, dtype=np.float32), (120, 1))
    gain = 1.0 + 0.04 * np.cos(2.0 * np.pi * 100.0 / 240.0 * np.arange(60) + 0.7)
    for name, light in (("even", np.ones(60)), ("flicker", gain)):
        seen = (
            cv2.circle(one * wall, (40 + k, 60), 18, 230.0 * one, -1) + rng.normal(0, 0.5, wall.shape)
            for k, one in enumerate(light)
        )
        encoded(tmp_path / f"{name}.mp4", seen, 240)
    assert not Film(tmp_path / "even.mp4").warnings
    film = Film(tmp_path / "flicker.mp4")
    assert any("flickers by 2.8 % rms" in text for text in film.warnings)
    corner = np.array([frame[:30].mean() for frame in film.frames()])
    assert corner.std() / corner.mean() < 0.002


def _polars(parts, angle):
    """Polar pictures of a body of equal parts that turns by `angle` (n,) columns of 240, with noise."""
    rng = np.random.default_rng(2)
    one = cv2.GaussianBlur(rng.normal(size=(24, 240 // parts)).astype(np.float32), (0, 0), 3) * 200
    body = np.tile(one, parts)
    return [rolled(body, a) + rng.normal(0, 1, body.shape).astype(np.float32) for a in angle]


@pytest.mark.parametrize("frame", [0, 1, 9, 19])
@pytest.mark.parametrize(("parts", "slips"), [(6, True), (1, False)])
def test_a_slip_by_an_equal_part_in_one_frame_is_removed_and_a_true_jump_is_kept(parts, slips, frame):
    ring = Ring((0.0, 0.0), 20.0, 44.0, 24, 240)
    turn = 1.7 * np.arange(20.0)
    jumped = turn.copy()
    jumped[frame] += 40.0  # a sixth of a turn
    polars = _polars(parts, turn if slips else jumped)
    allowed = np.ones((24, 240), dtype=bool)
    template = learn(polars, jumped * ring.step, allowed, ring, separate=False, plain=True)
    found = without_slips(polars, jumped * ring.step, np.arange(20), template) / ring.step
    assert np.abs(found - (turn if slips else jumped)).max() < 0.2


@pytest.mark.parametrize(("step", "kept"), [(7.0, False), (8.0, True)])
def test_a_jump_below_two_steps_is_a_motion(step, kept):
    """A body of sixteen parts of 15 columns each, in steps of a half of this."""
    ring = Ring((0.0, 0.0), 20.0, 44.0, 24, 240)
    turn = step * np.arange(20.0)
    jumped = turn.copy()
    jumped[9] += 15.0
    polars = _polars(16, turn)
    allowed = np.ones((24, 240), dtype=bool)
    template = learn(polars, jumped * ring.step, allowed, ring, separate=False, plain=True)
    found = without_slips(polars, jumped * ring.step, np.arange(20), template) / ring.step
    assert (abs(found[9] - jumped[9]) < 0.2) == kept


@pytest.mark.parametrize(("span", "rows", "samples"), [(TURN, 10, 40 * TURN), (1.0, 40, 160)])
def test_a_radius_has_the_finest_number_of_samples_and_a_row_of_an_arc_too(span, rows, samples):
    """100 px of 400 px: steps of 400 / 40 px, and of 100 / 40 px in an arc."""
    ring = Ring.about((0.0, 0.0), 300.0, 400.0, finest=40.0, span=span)
    assert ring.rows == rows
    assert samples - 1 <= ring.columns <= 1.1 * samples


def test_parts_of_a_body_seen_in_less_than_half_a_frame_have_the_mean_level_of_their_radius():
    """Half of the ring is in the picture; the body turns by a quarter after the first frame, whose weight is small."""
    body = np.outer(np.ones(4), 10.0 + np.arange(64) % 5).astype(np.float32)
    usable = np.tile(np.arange(64) < 32, (4, 1)).astype(np.float32)
    turns = np.array([0.0, 16.0, 16.0])
    polars = [np.roll(body, int(t), axis=1) for t in turns]
    for weight, seen in ((0.3, False), (0.7, True)):
        counted = np.array([weight, 1.0, 1.0])
        found = _registration._mean_body(polars, turns, counted, np.zeros_like(body), usable)
        first, later = slice(16, 32), np.arange(-16, 16)
        known = np.arange(-16, 32) if seen else later
        level = body[:, known].mean(axis=1)
        np.testing.assert_allclose(found[:, later], body[:, later], rtol=1e-4)
        expected = body[:, first] if seen else np.repeat(level[:, None], 16, axis=1)
        np.testing.assert_allclose(found[:, first], expected, rtol=1e-4)


def test_the_noise_of_a_picture_is_that_of_the_samples_in_most_frames():
    """A third of a ring is in the picture. The last frame alone shows another third, without a residual."""
    ring = Ring((0.0, 0.0), 20, 60, 12, 240)
    allowed = np.tile(np.arange(240) < 80, (12, 1))
    noise = np.random.default_rng(0).normal(0, 3.0, (20, 12, 240)).astype(np.float32)
    angles = np.zeros(20)
    angles[-1] = 80 * ring.step
    assert learn(noise, angles, allowed, ring, separate=False).noise > 5.0
