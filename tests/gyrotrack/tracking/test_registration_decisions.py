"""Formulas of rings, templates and registration, and of the errors of a tracked body, on small polar pictures."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrotrack.tracking import _registration as module
from gyrotrack.tracking._live_angles import FrameAngles, angles_sent_to, current_sink, report_angles
from gyrotrack.tracking._registration import TURN, Ring, Template, explained, follow, learn, register, rolled

RING = Ring((60.0, 50.0), 10.0, 26.0, 8, 64)


@pytest.mark.parametrize(
    ("inner", "outer", "finest", "span", "rows", "columns"),
    [
        (10.0, 50.0, 200.0, TURN, 40, 320),
        (10.0, 50.0, 25.0, TURN, 20, 160),
        (10.0, 50.0, 20.0, 1.0, 20, 64),  # an arc has at most 20 rows
        (10.0, 12.0, 200.0, TURN, 4, 75),
        (400.0, 440.0, 200.0, 0.5, 40, 225),
    ],
)
def test_a_ring_has_a_sample_per_pixel_or_the_finest_resolution(inner, outer, finest, span, rows, columns):
    ring = Ring.about((1.0, 2.0), inner, outer, finest=finest, start=0.3, span=span, stretch=(0.1, 0.2))
    assert (ring.rows, ring.columns) == (rows, columns)
    assert (ring.hub, ring.inner, ring.outer, ring.start, ring.span, ring.stretch) == (
        (1.0, 2.0), inner, outer, 0.3, span, (0.1, 0.2),
    )  # fmt: skip


def test_samples_of_a_ring_have_radii_angles_and_areas():
    ring = replace(RING, start=0.5, span=2.0)
    np.testing.assert_allclose(ring.radius, 11.0 + 2.0 * np.arange(8))
    assert ring.step == 2.0 / 64
    np.testing.assert_allclose(ring.angle, 0.5 + np.arange(64) / 32.0)
    np.testing.assert_allclose(ring.area[:, 0], 2.0 * ring.radius / 32.0)
    x, y = ring.grid((3.0, -1.0))
    np.testing.assert_allclose(x[2], 63.0 + 15.0 * np.cos(ring.angle), rtol=1e-6)
    np.testing.assert_allclose(y[2], 49.0 + 15.0 * np.sin(ring.angle), rtol=1e-6)
    x, y = replace(ring, stretch=(0.1, -0.2)).grid()
    u, v = 15.0 * np.cos(ring.angle), 15.0 * np.sin(ring.angle)
    np.testing.assert_allclose(x[2], 60.0 + 1.1 * u - 0.2 * v, rtol=1e-5)
    np.testing.assert_allclose(y[2], 50.0 - 0.2 * u + 0.9 * v, rtol=1e-5)


@pytest.mark.parametrize(
    ("stretch", "tilt", "short"),
    [
        ((0.1, 0.0), 0.9 / 1.1, 0.5),
        ((0.0, 0.1), 0.9 / 1.1, 0.25),
        ((-0.2, 0.0), 0.8 / 1.2, 0.0),
        ((0.0, -0.1), 0.9 / 1.1, 0.75),
    ],
)
def test_the_stretch_of_a_ring_shows_tilt_and_short_axis(stretch, tilt, short):
    found = replace(RING, stretch=stretch).tilt
    assert math.cos(found[0]) == pytest.approx(tilt)
    assert math.sin(found[1] - short * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert replace(RING, stretch=stretch, span=3.0).tilt is None
    assert replace(RING, stretch=(0.8, 0.6)).tilt is None


def test_samples_are_inside_an_area_less_the_margin_of_interpolation():
    ring = Ring((20.0, 20.0), 8.0, 12.0, 1, 4)  # samples at 10 px right, down, left and up
    for area, inside in (
        ((9, 9, 32, 32), [True] * 4),
        ((10, 9, 32, 32), [True, True, False, True]),
        ((9, 10, 32, 32), [True, True, True, False]),
        ((9, 9, 31, 32), [False, True, True, True]),
        ((9, 9, 32, 31), [True, False, True, True]),
    ):
        assert ring.inside(area)[0].tolist() == inside


def test_a_ring_is_unwrapped_also_beside_the_picture():
    y, x = np.mgrid[0:60, 0:80]
    picture = (2 * x + y).astype(np.uint8)
    for hub in ((40.0, 30.0), (10.0, 8.0), (-5.0, 30.0)):
        ring = Ring.about(hub, 5.0, 15.0)
        u, v = ring.grid()
        inside = (u >= 1) & (u <= 77) & (v >= 1) & (v <= 57)
        np.testing.assert_allclose(ring.unwrap(picture)[inside], (2 * u + v)[inside], atol=0.2)
        u, v = ring.grid((1.5, -0.5))
        inside = (u >= 1) & (u <= 77) & (v >= 1) & (v <= 57)
        np.testing.assert_allclose(ring.unwrap(picture, (1.5, -0.5))[inside], (2 * u + v)[inside], atol=0.2)


@pytest.mark.parametrize(("step", "value"), [(1.0, 90.0), (1.4, 90.0), (1.6, 90.0), (3.0, 10.0), (5.0, 3.6)])
def test_a_coarse_ring_averages_over_its_samples(step, value):
    """Steps of 3 and 5 px are averaged over 3 and 5 px in both directions."""
    picture = np.zeros((60, 90), np.uint8)
    picture[30, 50] = 90
    ring = Ring((40.0, 30.0), 10.0 - 0.5 * step, 10.0 + 3.5 * step, 4, 4)
    assert ring.unwrap(picture)[0, 0] == pytest.approx(value, abs=0.5)


@pytest.mark.parametrize(
    ("share", "inner", "outer"),
    [
        ([0, 0, 1, 1, 1, 1, 0, 0], 10.0, 26.0),
        ([1, 1, 1, 1, 0, 0, 0, 0], 8.0, 22.0),
        ([0, 0, 0, 0, 0, 0, 0, 1], 10.0, 26.0),
    ],
)
def test_a_ring_is_trimmed_to_its_explained_rows(share, inner, outer):
    """A row counts if the mean of three rows exceeds 0.3 of the best row; one more row is kept on either side."""
    found = RING.trimmed(np.array(share, float), finest=48.0)
    mean = np.convolve(share, np.ones(3) / 3, mode="same")
    good = np.flatnonzero(mean > 0.3)
    if len(good) < 4:
        assert found is RING
    else:
        assert (found.inner, found.outer) == (10.0 + 2.0 * (good[0] - 1), 10.0 + 2.0 * (good[-1] + 2))
        assert (inner, outer) == (found.inner, found.outer)


def _picture(ring=RING, shift=0.0):
    angle = ring.angle[None, :] - shift
    radius = ring.radius[:, None]
    wave = np.cos(3 * angle + 0.1 * radius) + 0.6 * np.sin(5 * angle) + 0.4 * np.cos(8 * angle - 0.2 * radius)
    return (100.0 + 20.0 * wave).astype(np.float32)


def test_a_polar_picture_is_rotated_and_differentiated_exactly():
    columns = 2.3
    np.testing.assert_allclose(rolled(_picture(), columns), _picture(shift=columns * RING.step), atol=1e-3)
    h = 1e-2
    expected = (_picture(shift=-h * RING.step).astype(float) - _picture(shift=h * RING.step)) / (2 * h)
    np.testing.assert_allclose(module._slope(_picture()), expected, atol=0.01)


def _template(ring=RING, variance=4.0, **change):
    full = np.full((ring.rows, ring.columns), variance, np.float32)
    body = _picture(ring)
    return replace(Template(ring, body, 0 * body, full, full, variance, full > 0), **change)


@pytest.mark.parametrize("shift", [0.0, 0.03, -0.6, 2.9])
def test_registration_finds_angle_gain_and_formal_uncertainty(shift):
    body = _picture(shift=shift)
    seen = 1.02 * (body - body.mean()) + body.mean() + 1.0
    pose = register(seen.astype(np.float32), _template(), shift + 0.01)
    assert pose.angle == pytest.approx(shift, abs=3e-4)
    assert pose.misfit < 0.01
    area = RING.area
    level = np.sum(area * body) / np.sum(area * np.ones_like(body))
    assert pose.gain == pytest.approx(0.02, abs=1e-3)
    slope = module._slope(_picture())
    columns = np.stack([-slope.ravel(), np.ones(slope.size), (_picture() - level).ravel()])
    weight = (area * np.ones_like(body) / 4.0).ravel()
    expected = math.sqrt(np.linalg.inv((columns * weight) @ columns.T)[0, 0]) * RING.step
    assert pose.formal == pytest.approx(expected, rel=0.03)
    assert pose.shift_sigma == math.inf


def test_the_misfit_is_the_weighted_mean_square_residual():
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 3.0, (RING.rows, RING.columns))

    def misfit(size, variance):
        shown = (_picture() + size * noise).astype(np.float32)
        return register(shown, _template(variance=variance), 0.0).misfit

    assert misfit(0.6, 4.0) == pytest.approx(4.0 * misfit(0.3, 4.0), rel=0.02)
    assert misfit(0.3, 4.0) == pytest.approx(4.0 * misfit(0.3, 16.0), rel=0.02)
    outlier = _picture().copy()
    outlier[3, 10] += 200.0
    assert abs(register(outlier, _template(), 0.0).angle) < 3e-3


def test_a_ring_outside_the_picture_has_no_angle():
    pose = register(_picture(), _template(allowed=np.zeros((8, 64), bool)), 0.7)
    assert (pose.angle, pose.formal, pose.misfit) == (0.7, math.inf, math.inf)


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_a_displacement_of_the_hub_is_fitted(turn):
    ring = Ring((60.0, 50.0), 10.0, 34.0, 24, 128)

    def shown(dx, dy):
        """The body about a displaced hub, in the polar grid about the first hub."""
        x = ring.radius[:, None] * np.cos(ring.angle) - dx
        y = ring.radius[:, None] * np.sin(ring.angle) - dy
        u, v = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
        return (100 + 30 * np.sin(0.22 * u + 0.4) * np.cos(0.2 * v) + 20 * np.cos(0.15 * (u - v))).astype(
            np.float32
        )

    still = shown(0.0, 0.0)
    full = np.full(still.shape, 4.0, np.float32)
    body = rolled(still, -turn / ring.step)
    template = Template(ring, body, 0 * body, full, full, 4.0, full > 0)
    pose = register(shown(0.5, -0.3), template, turn, move=True)
    assert pose.shift == pytest.approx((0.5, -0.3), abs=0.05)
    assert pose.angle == pytest.approx(turn, abs=3e-3)
    assert 0.0 < pose.shift_sigma < 0.2
    tight = register(shown(0.5, -0.3), replace(template, hub_sigma=1e-4), turn)
    assert np.abs(tight.shift).max() < 0.01


def test_the_information_of_rows_is_that_about_the_angle():
    template = _template()
    slope = module._slope(template.body)
    expected = (RING.area * slope**2 / 4.0).sum(axis=1)
    np.testing.assert_allclose(template.information(), expected, rtol=1e-4)
    part = replace(template, rows=slice(2, 5)).information()
    np.testing.assert_allclose(part, expected * np.isin(np.arange(8), [2, 3, 4]), rtol=1e-4)
    inner, outer = template.halves()
    assert (inner.rows.start, inner.rows.stop) == (0, outer.rows.start)
    assert outer.rows.stop is None
    assert inner.whole().rows == slice(None)


@pytest.mark.parametrize("separate", [False, True])
def test_body_and_fixed_picture_are_learnt(separate):
    angles = np.linspace(0.0, TURN, 40, endpoint=False)
    glare = np.zeros((8, 64), np.float32)
    glare[:, 5:9] = 30.0 if separate else 0.0
    polars = [_picture(shift=a) + glare for a in angles]
    allowed = np.ones((8, 64), bool)
    found = learn(polars, angles, allowed, RING, separate=separate)
    level = glare.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(found.body, _picture() + level, atol=0.5)
    np.testing.assert_allclose(found.fixed, glare - level if separate else 0.0, atol=0.5)
    assert found.noise == pytest.approx(0.05)
    counted = np.ones(40)
    counted[7] = 0.0
    polars[7] = polars[7] + 90.0
    again = learn(polars, angles, allowed, RING, separate=separate, counted=counted)
    np.testing.assert_allclose(again.body, _picture() + level, atol=1.0)


def test_variances_are_those_of_the_body_and_of_the_image():
    rng = np.random.default_rng(1)
    angles = np.linspace(0.0, 4 * TURN, 200)
    spread = np.full((8, 64), 1.0)
    spread[:, 20:32] = 5.0
    polars = [(_picture(shift=a) + rng.normal(0.0, spread)).astype(np.float32) for a in angles]
    found = learn(polars, angles, np.ones((8, 64), bool), RING, separate=False)
    assert found.fixed_variance[:, 23:29].mean() == pytest.approx(25.0, rel=0.1)
    assert found.fixed_variance[:, 40:60].mean() == pytest.approx(found.noise, rel=0.1)
    mean = (12 * 25.0 + 52 * 1.0) / 64
    assert found.body_variance.mean() == pytest.approx(mean, rel=0.1)
    plain = learn(polars, angles, np.ones((8, 64), bool), RING, separate=False, plain=True)
    np.testing.assert_allclose(plain.fixed_variance, plain.body_variance)
    assert plain.body_variance.std() < 1e-5


@pytest.mark.parametrize("band", ["low", "middle", "high"])
@pytest.mark.parametrize("speed", [0.07, -0.15])
def test_a_rotation_is_followed_in_each_band(band, speed):
    angles = speed * np.arange(30)
    polars = [_picture(shift=a) for a in angles]
    nothing = np.zeros((8, 64), np.float32)
    found = follow(polars, nothing + 1.0, nothing, RING, band=band)
    np.testing.assert_allclose(found, angles, atol=0.035)


def test_bands_select_orders():
    low, middle, high = (module._band(128, band) for band in ("low", "middle", "high"))
    k = np.arange(65)
    for found, expected in (
        (low, np.exp(-((k / 10.0) ** 2))),
        (middle, k**4.0 * np.exp(-((k / 8.0) ** 2))),
        (high, (k / 128) * np.exp(-((k / 128 / 0.2) ** 2))),
    ):
        expected[0] = 0.0
        np.testing.assert_allclose(found, expected[: len(found)], rtol=1e-5)
        assert (expected[len(found) :] < 1.2e-7 * expected.max()).all()


def test_an_occluded_frame_is_extrapolated():
    angles = 0.1 * np.arange(30)
    polars = [_picture(shift=a) for a in angles]
    rng = np.random.default_rng(0)
    polars[15] = rng.normal(100.0, 20.0, (8, 64)).astype(np.float32)
    nothing = np.zeros((8, 64), np.float32)
    np.testing.assert_allclose(follow(polars, nothing + 1.0, nothing, RING, band="low"), angles, atol=0.03)


@pytest.mark.parametrize(("k", "off"), [(0, -0.3), (2, 0.5), (4, 1.0)])
def test_an_angle_deviates_from_the_line_through_its_neighbours(k, off):
    at = np.array([0, 1, 3, 4, 6])
    angle = 0.2 * at
    angle[k] += off
    assert module._off_line(angle, at, k) == pytest.approx(off)


@pytest.mark.parametrize(("count", "step"), [(100, 1), (101, 2), (200, 2), (201, 3), (1, 1)])
def test_a_hundred_frames_are_compared(count, step):
    assert module.every(count) == step


@pytest.mark.parametrize(("factor", "share"), [(1.0, 1.0), (0.0, 0.0), (-1.0, None)])
def test_the_explained_share_is_that_of_the_change(factor, share):
    rng = np.random.default_rng(0)
    angles = 0.08 * np.arange(40)
    polars = [(_picture(shift=a) + rng.normal(0.0, 0.5, (8, 64))).astype(np.float32) for a in angles]
    template = _template(variance=0.25)
    found, rows = explained(polars, factor * angles, template)
    if share is None:
        assert found < -0.5
    else:
        assert found == pytest.approx(share, abs=0.03)
        np.testing.assert_allclose(rows, share, atol=0.05)


def test_half_of_the_change_may_be_explained():
    """Two bodies in the inner and the outer rows; the template turns with the outer one, which has more area."""
    angles = 0.08 * np.arange(40)
    polars = []
    for a in angles:
        polar = _picture(shift=a)
        polar[:4] = _picture(shift=-a)[:4]
        polars.append(polar)
    found, rows = explained(polars, angles, _template(variance=0.05))
    np.testing.assert_allclose(rows[4:], 1.0, atol=0.02)
    assert rows[:4].max() < 0.2
    assert 0.2 < found < 0.8


def test_angles_are_reported_sixteen_at_a_time():
    found = []
    with angles_sent_to(lambda *given: found.append(given)):
        angles = FrameAngles("rotor")
        for k in range(33):
            angles.add(k, 0.1 * k if k != 3 else math.nan)
        report_angles("casing", 2, np.array([5]), np.array([math.nan]))
    assert [(name, part, len(frames)) for name, part, frames, _ in found] == [
        ("rotor", 0, 15),
        ("rotor", 0, 16),
    ]
    assert found[1][2].tolist() == list(range(16, 32))
    assert current_sink() is None
